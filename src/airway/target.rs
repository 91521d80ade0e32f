//! One target of a navigation; where a case's targets are is decided in `targets.rs`.

use glam::DVec3;

/// One target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Place in mm at full inspiration, as planned on the CT.
    pub inspiration_mm: DVec3,
    /// Place in mm at full expiration: truth.
    pub expiration_mm: DVec3,
}

impl Target {
    /// Place in mm at `phase`.
    pub fn at(&self, phase: f64) -> DVec3 {
        self.inspiration_mm.lerp(self.expiration_mm, phase)
    }
}
