//! The clinical track (PROTOCOL 5): what a hospital's film has beyond the ideal one. `docs/clinical.md` has each effect's
//! equation, size and source; the sizes are `[clinical]` of a case ([`ClinicalSettings`]).
//!
//! Every effect is a function of the seed and of the time or the frame alone, so that a film can be resumed and is the
//! same on every number of threads. Nothing here is computed for a film of the ideal track.

pub mod contact;
pub mod focus;
pub mod lens_film;
pub mod optics;
pub mod pose_sensor;
pub mod table;
pub mod tissue_motion;
pub mod wall_drops;

use glam::DVec3;

use crate::airway::Anatomy;
use crate::airway::case::{Case, ClinicalSettings, ScopeSettings};
use crate::airway::waveform::Waveform;
use crate::base::{Camera, TriangleMesh};
use contact::WallContact;
use lens_film::LensFilm;
use optics::TrueOptics;
use pose_sensor::PoseSensor;
use tissue_motion::{TissueMotion, TissuePoint};
use wall_drops::WallDrops;

/// Factors on the motion beyond one phase that are tried until no face turns over.
const SHARES: [f64; 5] = [1.0, 0.7, 0.5, 0.3, 0.0];

/// Everything that one film of the clinical track has beyond the ideal one.
#[derive(Clone, Debug)]
pub struct ClinicalFilm {
    /// The film's own sizes.
    pub settings: ClinicalSettings,
    /// Lens and lamp.
    pub optics: TrueOptics,
    /// Motion of the tissue.
    pub motion: TissueMotion,
    /// The wall's vertices.
    pub wall: Vec<TissuePoint>,
    /// The touch of the wall.
    pub contact: Option<WallContact>,
    /// What tells the pose.
    pub sensor: PoseSensor,
    /// Secretions and bubbles.
    pub drops: WallDrops,
    /// The film on the lens.
    pub lens_film: LensFilm,
}

/// The breathing of a film of `case`: its own, less regular where `settings` say so.
pub fn waveform(case: &Case, settings: &ClinicalSettings) -> Waveform {
    Waveform { irregularity: case.waveform.irregularity.max(settings.breathing.irregularity), ..case.waveform.clone() }
}

impl ClinicalFilm {
    /// For a film of `times_s`, breathing by `waveform`, of the lens `nominal`, along `route_mm` (points at
    /// inspiration). `settings` are the film's own.
    pub fn new(
        case: &Case,
        anatomy: &Anatomy,
        settings: &ClinicalSettings,
        nominal: &Camera,
        waveform: &Waveform,
        times_s: &[f64],
        route_mm: &[DVec3],
    ) -> ClinicalFilm {
        let duration_s = times_s.last().copied().unwrap_or_default();
        let frames_per_second = (times_s.len() - 1) as f64 / duration_s.max(1e-9);
        let mut motion = TissueMotion::new(anatomy, waveform, settings, duration_s, case.seed);
        let wall = motion.points(&anatomy.inspiration.vertices, &anatomy.expiration.vertices);
        motion.share = sound_share(&motion, &wall, &anatomy.inspiration, times_s);
        ClinicalFilm {
            optics: TrueOptics::new(case, nominal, settings),
            contact: WallContact::new(settings.picture.contact_s, duration_s, frames_per_second, case.seed),
            sensor: PoseSensor::new(settings, duration_s, case.seed),
            drops: WallDrops::new(anatomy, route_mm, settings, case.seed),
            lens_film: LensFilm::new(settings, duration_s, case.seed),
            settings: settings.clone(),
            motion,
            wall,
        }
    }

    /// Lens and sensor of the film, `case` being filmed.
    pub fn scope(&self, case: &Case) -> ScopeSettings {
        let picture = &self.settings.picture;
        let or_own = |size: f64, own: f64| if size > 0.0 { size } else { own };
        ScopeSettings {
            emission_half_angle_deg: self.optics.half_angle_deg,
            vignette: self.optics.vignette,
            shot_noise: or_own(picture.shot_noise, case.scope.shot_noise),
            read_noise: or_own(picture.read_noise, case.scope.read_noise),
            shutter_s: or_own(picture.shutter_s, case.scope.shutter_s),
            ..case.scope
        }
    }

    /// Factor on the gain that the automatic exposure finds.
    pub fn overexposure(&self) -> f64 {
        if self.settings.picture.exposure > 0.0 { self.settings.picture.exposure } else { 1.0 }
    }

    /// The wall `time_s` after the start.
    pub fn wall_at(&self, time_s: f64) -> Vec<DVec3> {
        self.motion.places(&self.wall, &self.motion.state(time_s))
    }
}

/// The largest factor on the motion beyond one phase with which no face of the wall turns over at any frame.
fn sound_share(motion: &TissueMotion, wall: &[TissuePoint], rest: &TriangleMesh, times_s: &[f64]) -> f64 {
    let is_sound = |share: &f64| {
        let motion = motion.with_share(*share);
        times_s.iter().all(|&time_s| turned_faces(rest, &motion.places(wall, &motion.state(time_s))) == 0)
    };
    // The last needs no test: the wall on the way between two ends that were checked.
    SHARES.into_iter().find(|share| *share == 0.0 || is_sound(share)).unwrap_or(0.0)
}

/// Faces of `rest` whose normal, with the vertices at `moved`, is no longer on the side of its rest normal.
pub fn turned_faces(rest: &TriangleMesh, moved: &[DVec3]) -> usize {
    let is_turned = |f: &usize| {
        let [a, b, c] = rest.corners(*f);
        let [p, q, r] = rest.faces[*f].map(|v| moved[v as usize]);
        (b - a).cross(c - a).dot((q - p).cross(r - p)) <= 0.0
    };
    (0..rest.faces.len()).filter(is_turned).count()
}
