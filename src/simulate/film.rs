//! The plan of a film: which frame is where, at which phase, with which exposure. Everything but the pixels.

use crate::airway::Anatomy;
use crate::airway::case::Case;
use crate::base::{Camera, Error, Result, mesh};
use crate::render::{Material, Scene};

use super::SimulationSettings;
use super::exposure;
use super::sequence::FrameRecord;
use super::trajectory::{Route, nearest_mm};

/// Frames and what goes beside them into tables.
#[derive(Clone, Debug)]
pub struct Film {
    /// Intrinsics.
    pub camera: Camera,
    /// Truth of every frame.
    pub frames: Vec<FrameRecord>,
    /// Way travelled from the start of the route to each frame, mm at inspiration.
    pub arc_mm: Vec<f64>,
    /// Distance from the camera to the nearest vertex of the wall at each frame, mm.
    pub clearance_mm: Vec<f64>,
    /// Airway generation at each frame.
    pub generation: Vec<u32>,
    /// Speed of the scope, mm/s.
    pub speed_mm_per_s: f64,
    /// Motion of the route's end between the breath holds, mm.
    pub end_motion_mm: f64,
    /// Length of the whole route, mm.
    pub route_mm: f64,
    /// Sentences for the user.
    pub notes: Vec<String>,
}

impl Film {
    /// Plans the last part of the route, so that the film ends where the scope cannot go further.
    ///
    /// Errors: no way for the scope; a camera that would leave the lumen (names the frame).
    pub fn plan(case: &Case, anatomy: &Anatomy, settings: &SimulationSettings, material: &Material) -> Result<Film> {
        let route = Route::plan(anatomy, &case.trajectory)?;
        let camera = case.camera.camera(settings.width_px, settings.height_px);
        let duration_s = (settings.frames - 1) as f64 / settings.frames_per_second;
        let mut notes = Vec::new();
        let mut speed = case.trajectory.speed_mm_per_s;
        if speed * duration_s > route.length_mm() {
            speed = route.length_mm() / duration_s;
            notes.push(format!(
                "the route of {:.0} mm is too short for {duration_s:.1} s at {} mm/s: the scope goes {speed:.2} mm/s",
                route.length_mm(),
                case.trajectory.speed_mm_per_s
            ));
        }
        let start = route.length_mm() - speed * duration_s;
        let time_s: Vec<f64> = (0..settings.frames).map(|i| i as f64 / settings.frames_per_second).collect();
        let arc_mm: Vec<f64> = time_s.iter().map(|t| start + speed * t).collect();
        let phases: Vec<f64> = time_s.iter().map(|&t| case.waveform.phase(t, case.seed)).collect();
        let mut scene = Scene::new(&anatomy.inspiration, &anatomy.vertex_generation, flat(material), case.seed)?;
        let (mut frames, mut wanted, mut clearance_mm) = (Vec::new(), Vec::new(), Vec::new());
        for (index, (&arc, &phase)) in arc_mm.iter().zip(&phases).enumerate() {
            let world_from_camera = route.pose(arc, phase);
            let wall = mesh::interpolate(&anatomy.inspiration.vertices, &anatomy.expiration.vertices, phase);
            let clearance = nearest_mm(&wall, world_from_camera.translation);
            // The route was checked at five phases; between them the lumen may be a little narrower.
            if clearance < 0.9 * case.trajectory.scope_radius_mm {
                let sentence = format!("the wall is {clearance:.2} mm from the camera, less than the scope's radius");
                return Err(Error::input(sentence).element(format!("frame {index}")));
            }
            clearance_mm.push(clearance);
            scene.deform(&wall)?;
            let proxy =
                exposure::proxy_radiance(&scene, &camera, &world_from_camera, case.light_intensity, material.albedo)?;
            wanted.push(exposure::wanted_gain(&proxy, case.exposure.target));
            frames.push(FrameRecord {
                time_s: time_s[index],
                phase,
                gain: 1.0,
                white_balance: [1.0; 3],
                world_from_camera,
            });
        }
        for (frame, set) in frames.iter_mut().zip(exposure::follow(&wanted, &time_s, &case.exposure, case.seed)) {
            frame.gain = set.gain;
            frame.white_balance = set.white_balance;
        }
        Ok(Film {
            camera,
            generation: arc_mm.iter().map(|&arc| route.generation(arc)).collect(),
            frames,
            arc_mm,
            clearance_mm,
            speed_mm_per_s: speed,
            end_motion_mm: route.end_motion_mm(),
            route_mm: route.length_mm(),
            notes,
        })
    }

    /// `frames.csv`.
    pub(super) fn frames_csv(&self) -> String {
        let mut text = String::from(
            "frame,time_s,phase,gain,white_balance_red,white_balance_green,white_balance_blue,\
             way_mm,clearance_mm,generation,camera_x_mm,camera_y_mm,camera_z_mm\n",
        );
        for (i, f) in self.frames.iter().enumerate() {
            let [red, green, blue] = f.white_balance;
            let c = f.world_from_camera.translation;
            text += &format!(
                "{i},{},{},{},{red},{green},{blue},{},{},{},{},{},{}\n",
                f.time_s, f.phase, f.gain, self.arc_mm[i], self.clearance_mm[i], self.generation[i], c.x, c.y, c.z
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

/// The proxy needs geometry alone: no texture is made for it.
fn flat(material: &Material) -> Material {
    Material::lambert(material.albedo)
}
