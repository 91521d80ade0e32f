//! The breathing field: a smooth displacement u(x) from full inspiration to full expiration.
//!
//!   u(x) = scale * ( a + A x + sum_j w_j phi(|x - c_j|) ),   phi(r) = -sqrt(r^2 + s^2)
//!
//! a + A x is an affine part; phi is the 3D thin-plate (biharmonic) kernel -r, softened over s so that it is smooth at
//! the centres too (Hardy's multiquadric); the weights are orthogonal to affine functions, so far from the centres only
//! the affine part remains. Lengths inside are in units of [`UNIT_MM`] to keep the numbers of a case file readable.
//! [`super::field_fit`] fits it to landmark pairs. x in the frame of the airway mesh at inspiration, mm.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use crate::base::Result;
use crate::base::range::{COORDINATE_MM, KeyRanges, NumberRange};

/// Ranges of `[breathing.field]`. Affine rows and weights are in mm per [`UNIT_MM`].
const RANGES: KeyRanges = KeyRanges(&[
    ("scale", NumberRange::new(0.0, 100.0)),
    ("softening_mm", NumberRange::new(1e-3, 1e4)),
    ("origin_mm", COORDINATE_MM),
    ("affine", NumberRange::new(-1e6, 1e6)),
    ("centers", NumberRange::new(-1e6, 1e6)),
]);

/// One unit of the kernel's coordinates in mm.
pub const UNIT_MM: f64 = 100.0;

/// Displacement field in a case file. See the module's formula.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BreathingField {
    /// Where the motion was measured and how it was brought to this airway.
    pub source: String,
    /// Factor on the measured motion; 1 is the patient's full excursion.
    pub scale: f64,
    /// Softening length s in mm.
    pub softening_mm: f64,
    /// The point in mm that is the origin of the coordinates x and c below.
    pub origin_mm: [f64; 3],
    /// Three rows `[a, A_x, A_y, A_z]`: displacement in mm at the origin and per unit along each axis.
    pub affine: [[f64; 4]; 3],
    /// One row `[c_x, c_y, c_z, w_x, w_y, w_z]` per centre: position relative to the origin in mm, weight in mm per
    /// unit.
    pub centers: Vec<[f64; 6]>,
}

impl BreathingField {
    /// Rejects coefficients that no lung's motion has; the element names the key.
    pub fn validate(&self) -> Result<()> {
        RANGES.check("breathing.field", self)
    }

    /// Displacement in mm of the point `x_mm` from full inspiration to full expiration.
    pub fn displacement(&self, x_mm: DVec3) -> DVec3 {
        let x = (x_mm - DVec3::from_array(self.origin_mm)) / UNIT_MM;
        let soft2 = (self.softening_mm / UNIT_MM).powi(2);
        let mut u = DVec3::from_array(self.affine.map(|[a, x_, y_, z_]| a + x_ * x.x + y_ * x.y + z_ * x.z));
        for &[cx, cy, cz, wx, wy, wz] in &self.centers {
            let r2 = (x - DVec3::new(cx, cy, cz) / UNIT_MM).length_squared();
            u -= DVec3::new(wx, wy, wz) * (r2 + soft2).sqrt();
        }
        u * self.scale
    }

    /// Gradient of the displacement at `x_mm`: column k is du/dx_k, without unit.
    pub fn gradient(&self, x_mm: DVec3) -> DMat3 {
        let x = (x_mm - DVec3::from_array(self.origin_mm)) / UNIT_MM;
        let soft2 = (self.softening_mm / UNIT_MM).powi(2);
        let [r0, r1, r2] = self.affine;
        let mut g = DMat3::from_cols(
            DVec3::new(r0[1], r1[1], r2[1]),
            DVec3::new(r0[2], r1[2], r2[2]),
            DVec3::new(r0[3], r1[3], r2[3]),
        );
        for &[cx, cy, cz, wx, wy, wz] in &self.centers {
            let d = x - DVec3::new(cx, cy, cz) / UNIT_MM;
            let direction = d / (d.length_squared() + soft2).sqrt();
            let w = DVec3::new(wx, wy, wz);
            g -= DMat3::from_cols(w * direction.x, w * direction.y, w * direction.z);
        }
        g * (self.scale / UNIT_MM)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field() -> BreathingField {
        BreathingField {
            source: "test".into(),
            scale: 0.8,
            softening_mm: 12.0,
            origin_mm: [10.0, -20.0, 5.0],
            affine: [[1.0, 2.0, -3.0, 0.5], [0.0, 4.0, 1.0, 0.0], [12.0, 0.0, 1.0, -9.0]],
            centers: vec![[30.0, 10.0, -70.0, 3.0, -4.0, 8.0], [-30.0, 0.0, -20.0, -1.0, 6.0, 2.0]],
        }
    }

    #[test]
    fn gradient_is_the_derivative_of_the_displacement() {
        let f = field();
        for x in [DVec3::ZERO, DVec3::new(40.0, -10.0, -64.0), DVec3::new(-300.0, 20.0, 9.0)] {
            let g = f.gradient(x);
            for (axis, column) in [(DVec3::X, g.x_axis), (DVec3::Y, g.y_axis), (DVec3::Z, g.z_axis)] {
                let h = 1e-3;
                let numeric = (f.displacement(x + axis * h) - f.displacement(x - axis * h)) / (2.0 * h);
                assert!((numeric - column).length() < 1e-8, "{numeric} {column}");
            }
        }
    }

    #[test]
    fn scale_is_linear_and_bad_rows_are_named() {
        let f = field();
        let x = DVec3::new(3.0, 4.0, 5.0);
        let half = BreathingField { scale: 0.4, ..f.clone() };
        assert!((f.displacement(x) - 2.0 * half.displacement(x)).length() < 1e-12);
        let mut broken = f;
        broken.centers[1][4] = f64::NAN;
        assert!(broken.validate().unwrap_err().to_string().contains("centers[1]"));
    }
}
