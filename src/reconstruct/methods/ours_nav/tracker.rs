//! One frame after another: what is known before, the told pose, the picture; and what follows for the targets.

use glam::{DAffine3, DMat3, DVec3};

use crate::base::target_limits::{LOST_MM, UNSURE_MM};
use crate::base::{Image, mesh};
use crate::reconstruct::contract::{Observation, TrackState, WallMask};
use crate::reconstruct::estimate::navigation::state::{PHASE_AT, cross};
use crate::reconstruct::estimate::navigation::{NavigationState, wall_shares};
use crate::reconstruct::fitting::anchored::to_f32;
use crate::reconstruct::fitting::wall_picture::picture_levels;
use crate::reconstruct::geometry::breathing::BreathingMesh;
use crate::reconstruct::geometry::lit_wall::{GATHER_AGAIN_MM, NearWall, WallInReach};
use crate::reconstruct::geometry::targets::CarriedTargets;
use crate::reconstruct::settings::OursNavSettings;

/// Seconds without a picture that agrees after which an answer is lost.
const LOST_S: f64 = 0.5;

/// A frame as it arrives.
pub struct NavigationInput<'f> {
    /// The picture.
    pub image: &'f Image<u8>,
    /// Seconds since the first frame.
    pub time_s: f64,
    /// Told pose.
    pub world_from_camera: DAffine3,
}

/// The answer for a frame.
pub struct Navigated {
    /// How far it is to be relied on.
    pub state: TrackState,
    /// Pose.
    pub world_from_camera: DAffine3,
    /// Phase and its standard deviation.
    pub phase: [f64; 2],
    /// Targets, mm, world.
    pub targets_mm: Vec<DVec3>,
    /// Covariances of their places in the camera's axes, mm squared.
    pub covariance_mm2: Vec<DMat3>,
    /// Share of the picture that does not show the wall.
    pub masked_share: f64,
    /// How much each pixel counted.
    pub mask: WallMask,
}

/// The tracker, from the first frame on.
pub struct NavTracker<'a> {
    settings: &'a OursNavSettings,
    observation: &'a Observation,
    rest: Vec<[f32; 3]>,
    displacement: Vec<[f32; 3]>,
    targets: CarriedTargets,
    /// Motion of each target from inspiration to expiration, mm.
    travel_mm: Vec<DVec3>,
    wall: WallInReach,
    state: Option<NavigationState>,
    /// When a picture last agreed, s.
    agreed_s: f64,
}

impl<'a> NavTracker<'a> {
    /// Before the first frame.
    pub fn new(settings: &'a OursNavSettings, observation: &'a Observation) -> Self {
        let inspiration = &observation.inspiration;
        let expiration = observation.expiration.as_ref().unwrap_or(inspiration);
        let targets = CarriedTargets::new(&observation.targets_mm, inspiration);
        let [rest, moved] = [0.0, 1.0].map(|phase| targets.at_phase(observation, phase));
        NavTracker {
            settings,
            observation,
            rest: to_f32(&inspiration.vertices),
            displacement: mesh::displacement(inspiration, expiration),
            travel_mm: moved.iter().zip(&rest).map(|(moved, rest)| *moved - *rest).collect(),
            targets,
            wall: WallInReach::default(),
            state: None,
            agreed_s: 0.0,
        }
    }

    /// The airway.
    pub fn mesh(&self) -> BreathingMesh<'_> {
        let faces = &self.observation.inspiration.faces;
        BreathingMesh { rest: &self.rest, displacement: &self.displacement, faces }
    }

    /// Goes on to a frame and takes in its told pose. Returns pose (world from camera) and phase before the picture.
    pub fn expect(&mut self, time_s: f64, told: &DAffine3) -> (DAffine3, f64) {
        let state = match self.state.take() {
            Some(mut state) => {
                state.advance(self.settings, time_s);
                state.take_pose(self.settings, told);
                state
            }
            None => NavigationState::new(self.settings, *told, time_s, self.observation.breathing_period_s),
        };
        let expected = (state.camera_from_world.inverse(), state.mean[PHASE_AT]);
        self.state = Some(state);
        expected
    }

    /// Takes in the picture of the frame that [`NavTracker::expect`] went on to.
    pub fn look(&mut self, image: &Image<u8>, time_s: f64) -> Navigated {
        let place = self.state.as_ref().map_or(DVec3::ZERO, |state| state.camera_from_world.inverse().translation);
        let shares = wall_shares(image, self.observation.mask.as_ref());
        let levels = picture_levels(&self.settings.matching.picture, &self.observation.camera, image, &shares);
        let faces = &self.observation.inspiration.faces;
        let mesh = BreathingMesh { rest: &self.rest, displacement: &self.displacement, faces };
        let wall = self.wall.around(mesh, place, *self.settings.visibility.range_mm, GATHER_AGAIN_MM);
        let Some(state) = &mut self.state else { unreachable!("a frame is expected before its picture is looked at") };
        let look = state.look(&self.settings.matching, &levels, wall);
        if look.agrees {
            self.agreed_s = time_s;
        }
        let shown = (0..shares.len()).filter(|&i| self.observation.shows(i)).count().max(1) as f64;
        let masked_share = 1.0 - f64::from(shares.iter().sum::<f32>()) / shown;
        let coarse = levels.last().map_or(1, |level| level.camera.width as usize);
        let agrees = look.agrees;
        let mask = WallMask { width: image.width, shares, weights: look.weights, weights_width: coarse };
        self.answer(agrees, masked_share, mask, time_s)
    }

    /// The pose (world from camera) of the scope in the breath hold of the first CT, by a picture alone, from `start`, which
    /// is off by about `deviation` (rad and mm, each about or along one axis).
    pub fn find_pose(&mut self, image: &Image<u8>, start: DAffine3, deviation: [f64; 2]) -> DAffine3 {
        let period_s = self.observation.breathing_period_s;
        let mut state = NavigationState::new(self.settings, start, 0.0, period_s);
        let wall = NearWall::around(self.mesh(), start.translation, *self.settings.visibility.range_mm);
        let shares = wall_shares(image, self.observation.mask.as_ref());
        let levels = picture_levels(&self.settings.matching.picture, &self.observation.camera, image, &shares);
        state.find_pose(&self.settings.matching, &levels, &wall, deviation);
        state.camera_from_world.inverse()
    }

    fn answer(&self, agrees: bool, masked_share: f64, mask: WallMask, time_s: f64) -> Navigated {
        let Some(state) = &self.state else { unreachable!("an answer follows a frame") };
        let factor = *self.settings.deviation_factor;
        let phase = state.mean[PHASE_AT];
        let phase_deviation = factor * state.covariance[(PHASE_AT, PHASE_AT)].max(1e-12).sqrt();
        let targets_mm = self.targets.at_phase(self.observation, phase);
        let covariance_mm2: Vec<DMat3> =
            (0..targets_mm.len()).map(|k| self.covariance_mm2(state, targets_mm[k], self.travel_mm[k])).collect();
        let bars: f64 = covariance_mm2.iter().map(|c| (c.x_axis.x + c.y_axis.y + c.z_axis.z).sqrt()).sum();
        // Square root of the covariance's trace, mean over targets.
        let bar_mm = bars / covariance_mm2.len().max(1) as f64;
        let track_state = if bar_mm > LOST_MM || time_s - self.agreed_s > LOST_S {
            TrackState::Lost
        } else if bar_mm > UNSURE_MM || !agrees {
            TrackState::Unsure
        } else {
            TrackState::Tracking
        };
        Navigated {
            state: track_state,
            world_from_camera: state.camera_from_world.inverse(),
            phase: [phase, phase_deviation],
            targets_mm,
            covariance_mm2,
            masked_share,
            mask,
        }
    }

    /// Covariance in camera axes of a target at `place_mm` (world) that breathes by `travel_mm`. With `Y` its place in the
    /// camera's axes, `dY = omega x Y + tau + R d dp + e`; `e` is what the field between scope and target is off by.
    fn covariance_mm2(&self, state: &NavigationState, place_mm: DVec3, travel_mm: DVec3) -> DMat3 {
        let seen = state.camera_from_world.transform_point3(place_mm);
        let along = state.camera_from_world.transform_vector3(travel_mm);
        let block = |row: usize, column: usize| {
            DMat3::from_cols_array(&std::array::from_fn(|i| state.covariance[(row + i % 3, column + i / 3)]))
        };
        let (turn, both, shift) = (block(0, 0), block(0, 3), block(3, 3));
        let by_turn = -cross(seen);
        let mut sum = by_turn * turn * by_turn.transpose() + shift;
        let mixed = by_turn * both;
        sum += mixed + mixed.transpose();
        // The phase, with the pose and alone.
        let column = |first: usize| {
            DVec3::new(
                state.covariance[(first, PHASE_AT)],
                state.covariance[(first + 1, PHASE_AT)],
                state.covariance[(first + 2, PHASE_AT)],
            )
        };
        let with_phase = by_turn * column(0) + column(3);
        let outer = |a: DVec3, b: DVec3| DMat3::from_cols(a * b.x, a * b.y, a * b.z);
        sum += outer(with_phase, along) + outer(along, with_phase);
        let (phase, variance) = (state.mean[PHASE_AT], state.covariance[(PHASE_AT, PHASE_AT)]);
        sum += outer(along, along) * variance;
        // The field.
        let tissue = &self.settings.tissue;
        let field = tissue.registration_mm.powi(2) * (phase * phase + variance)
            + (*tissue.loop_mm * state.flow()).powi(2)
            + tissue.rest_mm.powi(2);
        let total = (sum + DMat3::from_diagonal(DVec3::splat(field))) * self.settings.deviation_factor.powi(2);
        (total + total.transpose()) * 0.5
    }
}

#[cfg(test)]
mod tests {
    use glam::DQuat;
    use nalgebra::DMatrix;

    use super::*;
    use crate::base::random::{CounterRng, Stage};
    use crate::base::{Camera, TriangleMesh};
    use crate::reconstruct::estimate::navigation::state::STATE;
    use crate::reconstruct::geometry::rigid::{POSE, motion};
    use crate::reconstruct::library::MethodFile;

    /// Whatever is uncertain together: against the place's derivatives in the camera's axes, by differences.
    #[test]
    fn the_covariance_of_a_target_is_that_of_its_place() {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases/methods/ours-nav.toml");
        let mut settings: OursNavSettings = MethodFile::load(&path).unwrap().settings().unwrap();
        settings.deviation_factor.value = 1.5;
        let surface = TriangleMesh { vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y], faces: vec![[0, 1, 2]] };
        let observation = Observation::bare(Camera::pinhole(8, 8, 1.5), surface);
        let tracker = NavTracker::new(&settings, &observation);
        let pose = DAffine3::from_rotation_translation(DQuat::from_rotation_x(0.7), DVec3::new(4.0, 1.0, -8.0));
        let mut state = NavigationState::new(&settings, pose, 0.0, 4.0);
        let mut random = CounterRng::new(3, Stage::Test, &[11]);
        let root = DMatrix::from_fn(STATE, STATE, |_, _| 0.05 * random.normal());
        state.covariance = &root * root.transpose();
        state.mean[PHASE_AT] = 0.4;
        let (rest, travel) = (DVec3::new(3.0, -2.0, 30.0), DVec3::new(1.0, -4.0, 6.0));
        let seen = |xi: [f64; POSE], phase: f64| {
            (motion(xi) * state.camera_from_world).transform_point3(rest + travel * phase)
        };
        let slope = |unknown: usize| {
            let place = |by: f64| match unknown {
                PHASE_AT => seen([0.0; POSE], 0.4 + by),
                _ => seen(std::array::from_fn(|k| if k == unknown { by } else { 0.0 }), 0.4),
            };
            (place(1e-5) - place(-1e-5)) / 2e-5
        };
        let unknowns = [0, 1, 2, 3, 4, 5, PHASE_AT];
        let mut expected = DMat3::ZERO;
        for (a, b) in unknowns.into_iter().flat_map(|a| unknowns.map(|b| (a, b))) {
            let (by_a, by_b) = (slope(a), slope(b));
            expected += DMat3::from_cols(by_a * by_b.x, by_a * by_b.y, by_a * by_b.z) * state.covariance[(a, b)];
        }
        // The registration's error grows with the phase, what nothing describes is always there; no air flows.
        let tissue = &settings.tissue;
        let square = 0.4 * 0.4 + state.covariance[(PHASE_AT, PHASE_AT)];
        let field = tissue.registration_mm.powi(2) * square + tissue.rest_mm.powi(2);
        expected = (expected + DMat3::from_diagonal(DVec3::splat(field))) * 1.5 * 1.5;
        let found = tracker.covariance_mm2(&state, rest + travel * 0.4, travel);
        let wrong = (found - expected).to_cols_array().into_iter().map(f64::abs).fold(0.0, f64::max);
        assert!(wrong < 1e-6 * expected.x_axis.length(), "{found} {expected}");
    }
}
