//! The plan of a film: which frame is where, at which phase, with which exposure. Everything but the pixels.

use glam::DAffine3;

use crate::airway::Anatomy;
use crate::airway::case::{Case, ScopeSettings};
use crate::airway::waveform::Waveform;
use crate::base::{Camera, Error, NoProgress, Progress, Result, mesh};
use crate::render::{Light, Material, Scene};

use super::exposure;
use super::novel_view::beside;
use super::sensor::mask_radius_px;
use super::sequence::{self, FrameRecord, NovelView};
use super::settings::SimulationSettings;
use super::steering::Steering;
use super::trajectory::{Route, nearest_mm};
use super::truth::VisibleWall;

/// The room about the route is measured at five phases; between them the lumen may be narrower by this factor.
const LEAST_CLEARANCE: f64 = 0.9;
/// Rays per image side that measure motion blur.
const BLUR_RAYS: f64 = 24.0;

/// Frames and what goes beside them into tables.
#[derive(Clone, Debug)]
pub struct Film {
    /// Intrinsics.
    pub camera: Camera,
    /// Truth of every frame.
    pub frames: Vec<FrameRecord>,
    /// Second cameras, in order of their frames.
    pub novel_views: Vec<NovelView>,
    /// Distance travelled along the route to each frame, mm at inspiration.
    pub arc_mm: Vec<f64>,
    /// Distance from the camera to the middle of the airway at each frame, mm.
    pub off_route_mm: Vec<f64>,
    /// Distance from the camera to the nearest vertex of the wall at each frame, mm.
    pub clearance_mm: Vec<f64>,
    /// Airway generation at each frame.
    pub generation: Vec<u32>,
    /// Gain that the automatic exposure aimed for at each frame.
    pub wanted_gain: Vec<f64>,
    /// Gain over the film's middle gain at each frame: drives the noise.
    pub amplification: Vec<f64>,
    /// Median motion of the image in pixels while the shutter is open, at each frame; 0 without motion blur.
    pub blur_px: Vec<f64>,
    /// Speed of the scope before rests and retreats, mm/s.
    pub speed_mm_per_s: f64,
    /// Motion of the route's end between the breath holds, mm.
    pub end_motion_mm: f64,
    /// Length of the whole route, mm.
    pub route_mm: f64,
    /// Sentences for the user.
    pub notes: Vec<String>,
    way: Way,
    scope: ScopeSettings,
}

/// Where the scope is at any time.
#[derive(Clone, Debug)]
struct Way {
    route: Route,
    waveform: Waveform,
    seed: u64,
    steering: Steering,
    start_mm: f64,
}

impl Way {
    fn state_at(&self, time_s: f64) -> (DAffine3, f64) {
        let phase = self.waveform.phase(time_s.max(0.0), self.seed);
        let arc_mm = self.start_mm + self.steering.way_mm(time_s);
        let (on_route, room_mm) = (self.route.pose(arc_mm, phase), self.route.clearance_mm(arc_mm, phase));
        (self.steering.steered(&on_route, room_mm, time_s), phase)
    }
}

impl Film {
    /// [`Film::plan_watched`] without reports of progress.
    pub fn plan(case: &Case, anatomy: &Anatomy, settings: &SimulationSettings, material: &Material) -> Result<Film> {
        Film::plan_watched(case, anatomy, settings, material, &NoProgress)
    }

    /// Plans the last part of the route, so that the film gets to where the scope cannot go further.
    ///
    /// Errors: no route for the scope; a camera that would leave the lumen (names the frame); stopped by the user.
    pub fn plan_watched(
        case: &Case,
        anatomy: &Anatomy,
        settings: &SimulationSettings,
        material: &Material,
        progress: &dyn Progress,
    ) -> Result<Film> {
        let route = Route::plan(anatomy, &case.trajectory)?;
        let camera = case.camera.camera(settings.width_px, settings.height_px);
        let duration_s = (settings.frames - 1) as f64 / settings.frames_per_second;
        let mut notes = Vec::new();
        let mut speed = case.trajectory.speed_mm_per_s;
        let steer = |speed| {
            let steering = Steering::new(case.trajectory.steering, speed, duration_s, case.trajectory.seed ^ case.seed);
            let [back, on] = steering.extent_mm(duration_s);
            (steering, on - back, on)
        };
        let (mut steering, mut way_mm, mut farthest_mm) = steer(speed);
        if way_mm > route.length_mm() {
            speed *= route.length_mm() / way_mm;
            (steering, way_mm, farthest_mm) = steer(speed);
            notes.push(format!(
                "the route of {:.0} mm is too short for {duration_s:.1} s at {} mm/s: the scope goes {speed:.2} mm/s",
                route.length_mm(),
                case.trajectory.speed_mm_per_s
            ));
        }
        debug_assert!(way_mm <= route.length_mm() * (1.0 + 1e-9));
        let start = route.length_mm() - farthest_mm;
        let time_s: Vec<f64> = (0..settings.frames).map(|i| i as f64 / settings.frames_per_second).collect();
        let arc_mm: Vec<f64> = time_s.iter().map(|&t| start + steering.way_mm(t)).collect();
        let (route_mm, end_motion_mm) = (route.length_mm(), route.end_motion_mm());
        let generation = arc_mm.iter().map(|&arc| route.generation(arc)).collect();
        let waveform = case.waveform.ending(duration_s, case.seed);
        let way = Way { route, waveform, seed: case.seed, steering, start_mm: start };
        let light = scope_light(case);
        let mut scene = Scene::new(&anatomy.inspiration, &anatomy.vertex_generation, flat(material), case.seed)?;
        let (mut frames, mut wanted, mut clearance_mm) = (Vec::new(), Vec::new(), Vec::new());
        let (mut blur_px, mut novel_views, mut off_route_mm) = (Vec::new(), Vec::new(), Vec::new());
        for (index, &now_s) in time_s.iter().enumerate() {
            if progress.cancelled() {
                return Err(Error::interrupted());
            }
            progress.advance(index, time_s.len());
            let (world_from_camera, phase) = way.state_at(now_s);
            let wall = mesh::interpolate(&anatomy.inspiration.vertices, &anatomy.expiration.vertices, phase);
            let clearance = nearest_mm(&wall, world_from_camera.translation);
            let least_mm =
                LEAST_CLEARANCE * (1.0 - case.trajectory.steering.sideways) * case.trajectory.scope_radius_mm;
            if clearance < least_mm {
                let sentence = format!("the wall is {clearance:.2} mm from the camera: too close for this scope");
                return Err(Error::input(sentence).element(format!("frame {index}")));
            }
            clearance_mm.push(clearance);
            off_route_mm.push(way.route.pose(arc_mm[index], phase).translation.distance(world_from_camera.translation));
            scene.deform(&wall)?;
            let proxy = exposure::proxy_radiance(
                &scene,
                &camera,
                &world_from_camera,
                &light,
                case.scope.vignette,
                material.albedo,
            )?;
            wanted.push(exposure::wanted_gain(&proxy, case.exposure.target));
            blur_px.push(blur(&scene, &camera, anatomy, &way, now_s, case.scope.shutter_s)?);
            if sequence::held_out(index) {
                let world_from_camera = beside(&scene, &wall, &world_from_camera, case.seed, index)?;
                novel_views.push(NovelView { frame: index, world_from_camera });
            }
            frames.push(FrameRecord { time_s: now_s, phase, gain: 1.0, white_balance: [1.0; 3], world_from_camera });
        }
        for (frame, set) in frames.iter_mut().zip(exposure::follow(&wanted, &time_s, &case.exposure, case.seed)) {
            frame.gain = set.gain;
            frame.white_balance = set.white_balance;
        }
        let middle_gain = exposure::median(frames.iter().map(|f| f.gain));
        Ok(Film {
            camera,
            generation,
            wanted_gain: wanted,
            amplification: frames.iter().map(|f| f.gain / middle_gain).collect(),
            blur_px,
            frames,
            novel_views,
            arc_mm,
            off_route_mm,
            clearance_mm,
            speed_mm_per_s: speed,
            end_motion_mm,
            route_mm,
            notes,
            way,
            scope: case.scope,
        })
    }

    /// True pose and phase at any time, between frames too.
    pub fn state_at(&self, time_s: f64) -> (DAffine3, f64) {
        self.way.state_at(time_s)
    }

    /// Mean duration of a breath in seconds.
    pub fn breathing_period_s(&self) -> f64 {
        self.way.waveform.period_s()
    }

    /// `frames.csv`.
    pub(super) fn frames_csv(&self) -> String {
        let mut text = String::from(
            "frame,time_s,phase,gain,white_balance_red,white_balance_green,white_balance_blue,\
             way_mm,off_route_mm,clearance_mm,generation,camera_x_mm,camera_y_mm,camera_z_mm,\
             wanted_gain,shot_noise,read_noise,emission_half_angle_deg,vignette,shutter_s,blur_px,mask_radius_px,\
             k1,k2,k3,k4\n",
        );
        let scope = &self.scope;
        let mask_px = mask_radius_px(&self.camera, scope).unwrap_or(0.0);
        let [k1, k2, k3, k4] = self.camera.fisheye.unwrap_or([0.0; 4]);
        for (i, f) in self.frames.iter().enumerate() {
            let [red, green, blue] = f.white_balance;
            let c = f.world_from_camera.translation;
            text += &format!(
                "{i},{},{},{},{red},{green},{blue},{},{},{},{},{},{},{},",
                f.time_s,
                f.phase,
                f.gain,
                self.arc_mm[i],
                self.off_route_mm[i],
                self.clearance_mm[i],
                self.generation[i],
                c.x,
                c.y,
                c.z
            );
            let k = self.amplification[i];
            text += &format!(
                "{},{},{},{},{},{},{},{mask_px},{k1},{k2},{k3},{k4}\n",
                self.wanted_gain[i],
                scope.shot_noise * k.sqrt(),
                scope.read_noise * k,
                scope.emission_half_angle_deg,
                scope.vignette,
                scope.shutter_s,
                self.blur_px[i]
            );
        }
        text
    }

    /// Figures for the manifest.
    pub(super) fn summary(&self) -> serde_json::Value {
        serde_json::json!({
            "speed_mm_per_s": self.speed_mm_per_s,
            "end_motion_mm": self.end_motion_mm,
            "route_mm": self.route_mm,
            "least_clearance_mm": self.clearance_mm.iter().copied().fold(f64::INFINITY, f64::min),
            "notes": self.notes,
        })
    }
}

/// Median motion of the image in pixels while the shutter is open around `time_s`, by rays of a coarse image.
fn blur(scene: &Scene, camera: &Camera, anatomy: &Anatomy, way: &Way, time_s: f64, shutter_s: f64) -> Result<f64> {
    if shutter_s <= 0.0 {
        return Ok(0.0);
    }
    let factor = BLUR_RAYS / camera.width as f64;
    let coarse = Camera { height: BLUR_RAYS as u32, ..camera.scaled(factor) };
    let [open, now, close] = [-0.5, 0.0, 0.5].map(|part| way.state_at(time_s + part * shutter_s));
    let visible = VisibleWall::new(scene, &coarse, &now.0, &anatomy.inspiration, &anatomy.expiration.vertices)?;
    Ok(visible.image_motion_px(camera, (&open.0, open.1), (&close.0, close.1)))
}

/// The proxy needs geometry alone: no texture is made for it.
fn flat(material: &Material) -> Material {
    Material::lambert(material.albedo)
}

/// The light at the tip of the scope.
pub fn scope_light(case: &Case) -> Light {
    let half_angle_deg = case.scope.emission_half_angle_deg;
    let emission_exponent = if half_angle_deg > 0.0 { Light::exponent_of_half_angle(half_angle_deg) } else { 0.0 };
    Light { emission_exponent, ..Light::at_camera(case.light_intensity) }
}
