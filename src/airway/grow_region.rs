//! What a growing branch supplies: a part of the lungs, held as sample points, so that every part has a volume (their
//! number) and a middle, and a plane can split it.
//!
//! The lungs are two ellipsoids of adult size (LPS, mm, carina at the origin) less the mediastinum, the heart and the
//! dome of the diaphragm: a plausible thorax, not a patient's.

use std::rc::Rc;

use glam::DVec3;

use crate::base::random::{CounterRng, Stage};

/// Sample points of both lungs.
const SAMPLES: usize = 24_000;
/// Fewest samples whose middle still means something.
const FEWEST: usize = 12;

/// Shape of the two lungs.
#[derive(Debug)]
pub(super) struct Lungs {
    /// Scale of all lengths.
    size: f64,
}

impl Lungs {
    /// Whether a point lies in either lung.
    pub fn contain(&self, point: DVec3) -> bool {
        let p = point / self.size;
        let (middle, axes) = match p.x < 0.0 {
            true => (DVec3::new(-72.0, 12.0, -32.0), DVec3::new(60.0, 88.0, 125.0)),
            false => (DVec3::new(70.0, 12.0, -32.0), DVec3::new(56.0, 85.0, 122.0)),
        };
        let dome = -105.0 - 0.006 * (p - middle).with_z(0.0).length_squared();
        let heart = (p - DVec3::new(24.0, -42.0, -62.0)) / DVec3::new(48.0, 42.0, 52.0);
        p.x.abs() > 14.0 && p.z > dome && heart.length_squared() > 1.0 && ((p - middle) / axes).length_squared() < 1.0
    }
}

/// A part of the lungs.
#[derive(Clone, Debug)]
pub(super) struct GrowthRegion {
    lungs: Rc<Lungs>,
    samples: Vec<DVec3>,
}

impl GrowthRegion {
    /// Both lungs, sampled evenly at random.
    pub fn both_lungs(seed: u64, size: f64) -> Self {
        let lungs = Rc::new(Lungs { size });
        let mut rng = CounterRng::new(seed, Stage::Tree, &[0]);
        let mut samples = Vec::with_capacity(SAMPLES);
        while samples.len() < SAMPLES {
            let point = DVec3::new(rng.range(-135.0, 130.0), rng.range(-80.0, 105.0), rng.range(-160.0, 95.0)) * size;
            if lungs.contain(point) {
                samples.push(point);
            }
        }
        GrowthRegion { lungs, samples }
    }

    /// The lungs it is a part of.
    pub fn lungs(&self) -> &Lungs {
        &self.lungs
    }

    /// The two sides of the plane through `point` with normal `across`, the side it points to first; `None` when a
    /// side is next to empty.
    pub fn split(&self, point: DVec3, across: DVec3) -> Option<[GrowthRegion; 2]> {
        let (front, back): (Vec<_>, Vec<_>) = self.samples.iter().partition(|s| (**s - point).dot(across) > 0.0);
        let part = |samples: Vec<DVec3>| GrowthRegion { lungs: Rc::clone(&self.lungs), samples };
        (front.len() >= FEWEST && back.len() >= FEWEST).then(|| [part(front), part(back)])
    }

    /// Its share of the lungs' volume.
    pub fn share(&self) -> f64 {
        self.samples.len() as f64 / SAMPLES as f64
    }

    /// Its centre of volume in mm.
    pub fn middle(&self) -> DVec3 {
        self.samples.iter().sum::<DVec3>() / self.samples.len().max(1) as f64
    }
}
