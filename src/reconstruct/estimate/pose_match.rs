//! The pose of a virtual bronchoscope, where poses are measured: the one near the measured pose whose virtual view
//! correlates best with the frame, by Gauss-Newton (Merritt et al., IEEE Trans Med Imaging 32:1434, 2013).
//!
//! With the gain that fits best eliminated, the sum of squared differences of two local contrasts is
//! `|C|^2 (1 - correlation^2)`, so that [`PictureLevel::equations`] climb the correlation. Where a tube looks alike all
//! along, they say little: every step is damped (Marquardt 1963), and the pose stays within reach of the measured one.

use glam::{DAffine3, DMat3, DQuat, DVec3};
use nalgebra::{SMatrix, SVector};

use crate::reconstruct::contract::Observation;
use crate::reconstruct::fitting::wall_picture::{LONGEST_STEPS, PictureEquations, PictureLevel, picture_levels};
use crate::reconstruct::geometry::breathing::BreathingMesh;
use crate::reconstruct::geometry::lit_wall::{GATHER_AGAIN_MM, LitView, NearWall, PHASE, WallInReach, in_sight};
use crate::reconstruct::geometry::rigid::{POSE, motion};
use crate::reconstruct::settings::PoseSearch;
use crate::splat::View;

/// Unknowns: the pose and the phase.
const UNKNOWNS: usize = POSE + 1;
/// Share of its own diagonal that is added to a system.
const DAMPING: f64 = 0.1;

/// A pose (world from camera) and a phase.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseAndPhase {
    /// Pose.
    pub world_from_camera: DAffine3,
    /// Phase.
    pub phase: f64,
}

/// Looks for poses, one frame after another.
pub struct PoseMatcher<'a> {
    settings: &'a PoseSearch,
    observation: &'a Observation,
    /// Farthest wall in sight, mm.
    range_mm: f64,
    wall: WallInReach,
    /// What the last pose that was found is off the measured one by: a turn and a shift in the room.
    correction: (DQuat, DVec3),
}

impl<'a> PoseMatcher<'a> {
    /// For the frames of `observation`, whose walls are seen up to `range_mm`.
    pub fn new(settings: &'a PoseSearch, range_mm: f64, observation: &'a Observation) -> Self {
        let correction = (DQuat::IDENTITY, DVec3::ZERO);
        PoseMatcher { settings, observation, range_mm, wall: WallInReach::default(), correction }
    }

    /// The measured pose of `frame`, corrected as that of the frame before was.
    pub fn expected(&self, frame: usize) -> DAffine3 {
        let told = self.observation.world_from_camera[frame];
        let (turn, shift) = self.correction;
        DAffine3::from_mat3_translation(DMat3::from_quat(turn) * told.matrix3, told.translation + shift)
    }

    /// Pose and phase of `frame`, from the phase that `phase_at` says is best at a pose. The search starts at the measured
    /// pose and at the expected one; where no picture agrees, it is the measured pose and its phase.
    pub fn find(
        &mut self,
        frame: usize,
        airway: BreathingMesh<'_>,
        phase_at: impl Fn(&DAffine3) -> f64,
    ) -> PoseAndPhase {
        let observation = self.observation;
        let told = observation.world_from_camera[frame];
        let image = &observation.images[frame];
        let shown = observation.pixel_weights().unwrap_or_else(|| vec![1.0; image.width * image.height]);
        let levels = picture_levels(&self.settings.picture, &observation.camera, image, &shown);
        let expected = self.expected(frame);
        let wall = self.wall.around(airway, told.translation, self.range_mm, GATHER_AGAIN_MM);
        let search = FrameSearch { settings: self.settings, levels: &levels, wall, told };
        let start = |pose: DAffine3| PoseAndPhase { world_from_camera: pose, phase: phase_at(&pose) };
        let measured = start(told);
        let mut best = (search.correlation(&measured), measured);
        for start in [Some(measured), (expected != told).then(|| start(expected))].into_iter().flatten() {
            let found = search.refine(start);
            let correlation = search.correlation(&found);
            if correlation > best.0 {
                best = (correlation, found);
            }
        }
        if best.0 < *self.settings.least_correlation {
            return measured;
        }
        let pose = best.1.world_from_camera;
        let turn = DQuat::from_mat3(&(pose.matrix3 * told.matrix3.transpose())).normalize();
        self.correction = (turn, pose.translation - told.translation);
        best.1
    }
}

/// The search of one frame.
struct FrameSearch<'a> {
    settings: &'a PoseSearch,
    levels: &'a [PictureLevel],
    wall: &'a NearWall,
    told: DAffine3,
}

impl FrameSearch<'_> {
    fn lit(&self, at: &PoseAndPhase, level: &PictureLevel) -> LitView {
        LitView { view: View::new(level.camera, at.world_from_camera), phase: at.phase, lamp_mm: DVec3::ZERO }
    }

    /// Correlation at the finest resolution; 0 without any.
    fn correlation(&self, at: &PoseAndPhase) -> f64 {
        self.levels.last().map_or(0.0, |level| level.correlation(self.wall, &self.lit(at, level)))
    }

    /// Gauss-Newton from `start`, coarse to fine.
    fn refine(&self, start: PoseAndPhase) -> PoseAndPhase {
        let mut at = start;
        for level in self.levels {
            let near = in_sight(self.wall, &self.lit(&at, level));
            for _ in 0..level.steps {
                let lit = self.lit(&at, level);
                let Some(equations) = level.equations(&self.settings.picture, 1.0, &near, &lit) else { return at };
                let Some(step) = self.step(&equations) else { return at };
                let camera_from_world = motion(std::array::from_fn(|k| step[k])) * lit.view.camera_from_world;
                at = PoseAndPhase {
                    world_from_camera: self.within_reach(camera_from_world.inverse()),
                    phase: (at.phase + step[POSE]).clamp(0.0, 1.0),
                };
            }
        }
        at
    }

    /// The damped step, shortened as a whole so that no part of it is too long.
    fn step(&self, equations: &PictureEquations) -> Option<SVector<f64, UNKNOWNS>> {
        // Phase comes after the pose among the unknowns of a picture, too.
        const { assert!(PHASE == POSE) };
        let mut system = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::from_fn(|a, b| equations.hessian[(a, b)]);
        let right = SVector::<f64, UNKNOWNS>::from_fn(|a, _| equations.gradient[a]);
        (0..UNKNOWNS).for_each(|k| system[(k, k)] *= 1.0 + DAMPING);
        let step = system.cholesky()?.solve(&right);
        let limit = |k: usize| LONGEST_STEPS[k / 3];
        let share = (0..UNKNOWNS).map(|k| limit(k) / step[k].abs().max(1e-300)).fold(1.0, f64::min);
        Some(step * share)
    }

    /// `pose`, brought back to the farthest that it may be from the measured one.
    fn within_reach(&self, pose: DAffine3) -> DAffine3 {
        let [most_rad, most_mm] = *self.settings.reach;
        let turn = DQuat::from_mat3(&(pose.matrix3 * self.told.matrix3.transpose())).normalize().to_scaled_axis();
        let turn = DQuat::from_scaled_axis(turn.clamp_length_max(most_rad));
        let shift = (pose.translation - self.told.translation).clamp_length_max(most_mm);
        DAffine3::from_mat3_translation(DMat3::from_quat(turn) * self.told.matrix3, self.told.translation + shift)
    }
}

#[cfg(test)]
mod tests {
    use super::super::navigation::tests::World;
    use super::*;
    use crate::base::Image;
    use crate::reconstruct::library::MethodFile;
    use crate::reconstruct::settings::VirtualBronchoscopySettings;

    const PHASE_SHOWN: f64 = 0.35;

    /// Frames of the world from `poses`, of which `told` are measured.
    fn film(world: &World, poses: &[DAffine3], told: Vec<DAffine3>) -> Observation {
        let images = poses.iter().enumerate().map(|(k, pose)| world.picture(pose, PHASE_SHOWN, k as u64)).collect();
        Observation {
            world_from_camera: told,
            poses_are_measured: true,
            images,
            ..Observation::bare(world.camera, world.surface())
        }
    }

    fn settings(reach: [f64; 2]) -> PoseSearch {
        let path =
            std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases/methods/virtual-bronchoscopy.toml");
        let file: VirtualBronchoscopySettings = MethodFile::load(&path).unwrap().settings().unwrap();
        let mut pose = file.pose;
        pose.reach.value = reach;
        pose
    }

    /// mm and degrees between two poses.
    fn apart(a: &DAffine3, b: &DAffine3) -> [f64; 2] {
        let turn = DQuat::from_mat3(&(a.matrix3 * b.matrix3.transpose())).normalize();
        [a.translation.distance(b.translation), turn.to_scaled_axis().length().to_degrees()]
    }

    #[test]
    fn a_measured_pose_is_corrected_by_its_picture_and_the_next_one_starts_there() {
        let world = World::new();
        let poses: Vec<DAffine3> = (0..4).map(|k| world.pose(10.0 + f64::from(k))).collect();
        let off = DQuat::from_scaled_axis(DVec3::new(0.01, -0.012, 0.0));
        let wrong = |pose: &DAffine3| {
            let turned = DMat3::from_quat(off) * pose.matrix3;
            DAffine3::from_mat3_translation(turned, pose.translation + DVec3::new(0.5, -0.4, 0.7))
        };
        let film = film(&world, &poses, poses.iter().map(wrong).collect());
        let mut settings = settings([0.1, 4.0]);
        settings.picture.steps.value = [0, 12, 12];
        let mut matcher = PoseMatcher::new(&settings, 90.0, &film);
        for (frame, pose) in poses.iter().enumerate() {
            if frame > 0 {
                let [mm, degrees] = apart(&matcher.expected(frame), pose);
                assert!(mm < 0.4 && degrees < 0.4, "{frame}: expected {mm} mm, {degrees} degrees off");
            }
            let found = matcher.find(frame, world.mesh(), |_| 0.3);
            let [mm, degrees] = apart(&found.world_from_camera, pose);
            assert!(mm < 0.4 && degrees < 0.4, "{frame}: {mm} mm, {degrees} degrees; told .95 mm, .9 degrees");
            assert!((found.phase - PHASE_SHOWN).abs() < 0.06, "{frame}: {}", found.phase);
        }
    }

    #[test]
    fn no_pose_is_farther_than_the_reach_and_none_is_moved_by_what_shows_no_wall() {
        let world = World::new();
        let pose = world.pose(12.0);
        let told = DAffine3 { translation: pose.translation + DVec3::new(1.2, 0.0, 0.9), ..pose };
        let mut film = film(&world, &[pose], vec![told]);
        let reach = [0.005, 0.3];
        let settings = settings(reach);
        let found = PoseMatcher::new(&settings, 90.0, &film).find(0, world.mesh(), |_| PHASE_SHOWN);
        let [mm, degrees] = apart(&found.world_from_camera, &told);
        assert!(mm > 0.2 && mm < reach[1] + 1e-9 && degrees < reach[0].to_degrees() + 1e-9, "{mm} {degrees}");
        film.images[0] = Image::filled(64, 64, 3, 90);
        let found = PoseMatcher::new(&settings, 90.0, &film).find(0, world.mesh(), |_| 0.8);
        assert_eq!(found, PoseAndPhase { world_from_camera: told, phase: 0.8 });
    }
}
