//! Worlds whose truth is known: a winding tube with folds that breathes, seen under its own model of the light.

use glam::{DAffine3, DQuat, DVec3};

use super::state::{NavigationState, PHASE_AT, STATE};
use super::wall_mask::wall_shares;
use crate::base::color::srgb8_from_linear;
use crate::base::random::{CounterRng, Stage};
use crate::base::{Camera, Image, TriangleMesh};
use crate::reconstruct::fitting::wall_picture::picture_levels;
use crate::reconstruct::geometry::breathing::BreathingMesh;
use crate::reconstruct::geometry::lit_wall::{LAMP, LENS, LitView, NearWall, PHASE, PICTURE, lit_picture};
use crate::reconstruct::geometry::rigid::{POSE, moved};
use crate::reconstruct::library::MethodFile;
use crate::reconstruct::settings::OursNavSettings;
use crate::splat::View;

const AROUND: usize = 48;
const ALONG: usize = 160;

pub(in crate::reconstruct::estimate) struct World {
    rest: Vec<[f32; 3]>,
    displacement: Vec<[f32; 3]>,
    faces: Vec<[u32; 3]>,
    pub camera: Camera,
}

fn middle(z: f64) -> DVec3 {
    DVec3::new(9.0 * (z / 22.0).sin(), 6.0 * (z / 31.0).cos(), z)
}

impl World {
    pub fn new() -> World {
        let (mut rest, mut displacement, mut faces) = (Vec::new(), Vec::new(), Vec::new());
        for i in 0..=ALONG {
            let z = 0.75 * i as f64 - 20.0;
            for k in 0..AROUND {
                let angle = std::f64::consts::TAU * k as f64 / AROUND as f64;
                let fold = 0.6 * (z / 1.3).sin().powi(3)
                    + 0.7 * (2.0 * angle + z / 9.0).cos()
                    + 0.4 * (5.0 * angle - z / 6.0).sin();
                let out = DVec3::new(angle.cos(), angle.sin(), 0.0);
                let place = middle(z) + (6.0 + fold) * out;
                let motion = DVec3::new(1.5, -2.0, 7.0) * (0.5 + z / 100.0) - 1.2 * out;
                rest.push(place.as_vec3().to_array());
                displacement.push(motion.as_vec3().to_array());
            }
        }
        let at = |i: usize, k: usize| (i * AROUND + k % AROUND) as u32;
        for i in 0..ALONG {
            for k in 0..AROUND {
                // Normals point into the lumen.
                faces.push([at(i, k), at(i + 1, k), at(i, k + 1)]);
                faces.push([at(i, k + 1), at(i + 1, k), at(i + 1, k + 1)]);
            }
        }
        World { rest, displacement, faces, camera: Camera::pinhole(64, 64, 1.7) }
    }

    pub fn mesh(&self) -> BreathingMesh<'_> {
        BreathingMesh { rest: &self.rest, displacement: &self.displacement, faces: &self.faces }
    }

    /// The surface at inspiration.
    pub fn surface(&self) -> TriangleMesh {
        let vertices = self.rest.iter().map(|v| glam::Vec3::from(*v).as_dvec3()).collect();
        TriangleMesh { vertices, faces: self.faces.clone() }
    }

    pub fn wall(&self, place: DVec3) -> NearWall {
        NearWall::around(self.mesh(), place, 90.0)
    }

    /// World from camera on the middle of the tube, a little beside it.
    pub fn pose(&self, z: f64) -> DAffine3 {
        let ahead = (middle(z + 6.0) - middle(z)).normalize();
        let turn = DQuat::from_rotation_arc(DVec3::Z, ahead);
        DAffine3::from_rotation_translation(turn, middle(z) + DVec3::new(0.8, -0.5, 0.0))
    }

    /// The picture at a pose (world from camera) and phase, by the model of the light, with a little noise.
    pub fn picture(&self, pose: &DAffine3, phase: f64, seed: u64) -> Image<u8> {
        let view = View::new(self.camera, *pose);
        let lit = LitView { view, phase, lamp_mm: DVec3::ZERO };
        let shown = lit_picture(&self.wall(pose.translation), &lit, false).brightness;
        let mean = shown.iter().sum::<f32>() / shown.len() as f32;
        let mut random = CounterRng::new(seed, Stage::Test, &[3]);
        let data = shown.iter().flat_map(|v| {
            let light = (0.35 * v / mean).powf(2.2) * (1.0 + 0.02 * random.normal() as f32);
            [light * 1.5, light, light * 0.8].map(|v| srgb8_from_linear(v.clamp(0.0, 0.85)))
        });
        Image { width: 64, height: 64, channels: 3, data: data.collect() }
    }
}

pub(super) fn settings() -> OursNavSettings {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases/methods/ours-nav.toml");
    MethodFile::load(&path).unwrap().settings().unwrap()
}

#[test]
fn slopes_are_the_difference_quotients_of_the_picture() {
    let world = World::new();
    let pose = world.pose(12.0);
    let wall = world.wall(pose.translation);
    let camera = Camera::pinhole(96, 96, 1.5);
    let lit = LitView { view: View::new(camera, pose), phase: 0.4, lamp_mm: DVec3::new(0.5, -0.3, 0.0) };
    let slopes = lit_picture(&wall, &lit, true).slopes;
    let changed = |unknown: usize, by: f64| {
        let mut other = lit;
        let mut xi = [0.0; POSE];
        match unknown {
            k if k < POSE => {
                xi[k] = by;
                other.view = moved(&lit.view, xi);
            }
            PHASE => other.phase += by,
            k if k == LENS => other.view.camera.cx += by * 96.0,
            k if k == LENS + 1 => other.view.camera.cy += by * 96.0,
            k if k == LENS + 2 => {
                other.view.camera.fl_x *= by.exp();
                other.view.camera.fl_y *= by.exp();
            }
            k if k == LAMP => other.lamp_mm.x += by,
            _ => other.lamp_mm.y += by,
        }
        lit_picture(&wall, &other, false).brightness
    };
    // About a pixel: slopes of a picture are differences of neighbouring pixels.
    let steps = [0.016, 0.016, 0.03, 0.16, 0.16, 0.16, 0.03, 0.01, 0.01, 0.01, 0.08, 0.08];
    let mut wrong = Vec::new();
    for unknown in 0..PICTURE {
        let (up, down) = (changed(unknown, steps[unknown]), changed(unknown, -steps[unknown]));
        let numeric: Vec<f32> = up.iter().zip(&down).map(|(a, b)| (a - b) / (2.0 * steps[unknown] as f32)).collect();
        let (mut both, mut own, mut other) = (0.0, 0.0, 0.0);
        for y in 4..92 {
            for x in 4..92 {
                let (n, s) = (f64::from(numeric[y * 96 + x]), f64::from(slopes[unknown][y * 96 + x]));
                (both, own, other) = (both + n * s, own + n * n, other + s * s);
            }
        }
        let (likeness, size) = (both / (own * other).sqrt(), both / own);
        if likeness < 0.9 || !(0.8..1.2).contains(&size) {
            wrong.push(format!("unknown {unknown}: {likeness:.3} {size:.3}"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}

/// Follows a film of the world; `told` is the told pose of each frame. Returns the states.
fn follow(
    world: &World,
    frames: usize,
    truth: impl Fn(usize) -> (DAffine3, f64),
    told: impl Fn(usize) -> DAffine3,
    spoil: impl Fn(usize, &mut Image<u8>),
) -> Vec<(NavigationState, bool)> {
    // Light and wall are exactly those of the model here, which no film's are.
    let mut settings = settings();
    settings.matching.shade.value = [0.003, 0.15];
    settings.matching.together_px.value = 20.0;
    let mut state = NavigationState::new(&settings, told(0), 0.0, 4.0);
    let mut states = Vec::new();
    for frame in 0..frames {
        if frame > 0 {
            state.advance(&settings, 0.1 * frame as f64);
            state.take_pose(&settings, &told(frame));
        }
        let (pose, phase) = truth(frame);
        let mut image = world.picture(&pose, phase, frame as u64);
        spoil(frame, &mut image);
        let levels = picture_levels(&settings.matching.picture, &world.camera, &image, &wall_shares(&image, None));
        let look = state.look(&settings.matching, &levels, &world.wall(pose.translation));
        assert!(state.mean.len() == STATE && state.covariance.iter().all(|v| v.is_finite()));
        states.push((state.clone(), look.agrees));
    }
    states
}

/// Distance in mm and angle in degrees.
fn pose_error(state: &NavigationState, truth: &DAffine3) -> [f64; 2] {
    let off = state.camera_from_world * *truth;
    let angle = DQuat::from_mat3(&off.matrix3).to_scaled_axis().length().to_degrees();
    [state.camera_from_world.inverse().translation.distance(truth.translation), angle]
}

fn breath(frame: usize) -> f64 {
    0.5 - 0.5 * (std::f64::consts::TAU * 0.1 * frame.saturating_sub(5) as f64 / 4.0).cos()
}

#[test]
fn a_drift_of_the_sensor_is_recovered_from_the_pictures() {
    let world = World::new();
    let truth = |frame: usize| (world.pose(5.0 + 0.8 * frame as f64), breath(frame));
    let drift = |frame: usize| {
        let share = frame as f64 / 39.0;
        let turn = DQuat::from_scaled_axis(DVec3::new(0.02, -0.025, 0.015) * share);
        let pose = truth(frame).0;
        DAffine3 {
            matrix3: glam::DMat3::from_quat(turn) * pose.matrix3,
            translation: pose.translation + DVec3::new(1.2, -1.0, 1.2) * share,
        }
    };
    let states = follow(&world, 40, truth, drift, |_, _| ());
    let [mm, degrees] = pose_error(&states[39].0, &truth(39).0);
    assert!(states.iter().all(|(_, agrees)| *agrees));
    assert!(mm < 0.9 && degrees < 0.8, "{mm} mm, {degrees} degrees; told: 2 mm, 2 degrees");
    let phase_error: f64 =
        states.iter().enumerate().map(|(f, (s, _))| (s.mean[PHASE_AT] - breath(f)).abs()).sum::<f64>() / 40.0;
    assert!(phase_error < 0.08, "{phase_error}");
}

#[test]
fn a_black_out_is_noticed_and_the_phase_is_found_again_without_being_told() {
    let world = World::new();
    // While nothing is seen the breath stops and goes elsewhere: a cough.
    let phase = |frame: usize| if frame < 15 { breath(frame) } else { 0.8 };
    let truth = |frame: usize| (world.pose(5.0 + 0.5 * frame as f64), phase(frame));
    let states = follow(
        &world,
        24,
        truth,
        |frame| truth(frame).0,
        |frame, image| {
            if (12..18).contains(&frame) {
                image
                    .data
                    .chunks_exact_mut(3)
                    .enumerate()
                    .for_each(|(i, p)| p.copy_from_slice(&[180, 30 + (i % 7) as u8, 25]));
            }
        },
    );
    let agrees: Vec<bool> = states.iter().map(|s| s.1).collect();
    assert!(agrees[..12].iter().all(|a| *a) && agrees[12..18].iter().all(|a| !a), "{agrees:?}");
    let deviation = |frame: usize| states[frame].0.covariance[(PHASE_AT, PHASE_AT)].sqrt();
    assert!(deviation(17) > 3.0 * deviation(11), "{} {}", deviation(17), deviation(11));
    assert!(agrees[20..].iter().all(|a| *a), "{agrees:?}");
    let off = (states[23].0.mean[PHASE_AT] - 0.8).abs();
    assert!(off < 0.12, "{off}");
}
