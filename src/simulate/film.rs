//! The plan of a film: which frame is where, at which phase, with which exposure. Everything but the pixels.

use glam::{DAffine3, DVec3};

use crate::airway::Anatomy;
use crate::airway::case::{Case, ScopeSettings};
use crate::airway::waveform::Waveform;
use crate::base::statistics::upper_median;
use crate::base::{Camera, Error, Mask, NoProgress, Progress, Result, mesh};
use crate::render::{Light, Material, Scene};

use super::clinical::optics::lens_note;
use super::clinical::table::FrameConditions;
use super::clinical::{self, ClinicalFilm};
use super::exposure;
use super::novel_view::beside;
use super::sensor::{Sensor, mask_radius_px};
use super::sequence::{self, FrameRecord, NovelView};
use super::settings::SimulationSettings;
use super::steering::Steering;
use super::trajectory::{Route, nearest_mm};
use super::truth::VisibleWall;

/// The room about the route is measured at five phases; between them the lumen may be narrower by this factor.
const LEAST_CLEARANCE: f64 = 0.9;
/// How far from the wanted phase a film may end that says nothing of it.
const END_TOLERANCE: f64 = 0.01;
/// Share of the values that the automatic exposure may expect to clip, in the middle frame.
const MOST_CLIPPED: f64 = 0.25;
/// Largest albedo of a wall of which nothing is said; looks have up to .64.
const MOST_ALBEDO: f64 = 0.9;
/// On the clinical track the lumen moves otherwise than when it was measured: this part of the room is used.
const CLINICAL_ROOM: f64 = 0.85;
/// Least distance in mm of its camera from the wall.
const LEAST_CLINICAL_MM: f64 = 0.25;
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
    /// Lens, lamp and sensor.
    pub scope: ScopeSettings,
    /// Truth of the clinical track's effects at each frame; empty on the ideal track.
    pub conditions: Vec<FrameConditions>,
    /// What methods of the clinical track are told of the second cameras; empty on the ideal track.
    pub told_views: Vec<NovelView>,
    way: Way,
}

/// Where the scope is at any time.
#[derive(Clone, Debug)]
struct Way {
    route: Route,
    waveform: Waveform,
    seed: u64,
    steering: Steering,
    start_mm: f64,
    clinical: Option<ClinicalFilm>,
}

impl Way {
    fn state_at(&self, time_s: f64) -> (DAffine3, f64) {
        if let Some(clinical) = &self.clinical {
            return self.clinical_state_at(clinical, time_s);
        }
        let phase = self.waveform.phase(time_s.max(0.0), self.seed);
        let arc_mm = self.start_mm + self.steering.way_mm(time_s);
        let (on_route, room_mm) = (self.route.pose(arc_mm, phase), self.route.clearance_mm(arc_mm, phase));
        (self.steering.steered(&on_route, room_mm, time_s), phase)
    }

    /// [`Way::state_at`] of the clinical track.
    fn clinical_state_at(&self, clinical: &ClinicalFilm, time_s: f64) -> (DAffine3, f64) {
        let (on_route, phase) = self.on_route(clinical, time_s);
        let part = if clinical.motion.is_beyond_phase() { CLINICAL_ROOM } else { 1.0 };
        let room_mm = part * self.route.clearance_mm(self.arc_mm(time_s), phase);
        let steered = self.steering.steered(&on_route, room_mm, time_s);
        (clinical.contact.as_ref().map_or(steered, |contact| contact.touched(&on_route, &steered, time_s)), phase)
    }

    fn arc_mm(&self, time_s: f64) -> f64 {
        self.start_mm + self.steering.way_mm(time_s)
    }

    /// The pose on the middle of the airway, and the phase.
    fn on_route(&self, clinical: &ClinicalFilm, time_s: f64) -> (DAffine3, f64) {
        let motion = &clinical.motion;
        let body = motion.state(time_s);
        let carried = |rest, other| motion.place(&motion.point(rest, other), &body);
        (self.route.pose_carried(self.arc_mm(time_s), carried), body.phase)
    }

    /// The wall at a moment and its phase.
    fn wall(&self, anatomy: &Anatomy, time_s: f64, phase: f64) -> Vec<DVec3> {
        match &self.clinical {
            None => mesh::interpolate(&anatomy.inspiration.vertices, &anatomy.expiration.vertices, phase),
            Some(clinical) => clinical.wall_at(time_s),
        }
    }

    /// Finds how far the tip can go across the lumen at the frames of the touch.
    fn plan_contact(&mut self, scene: &mut Scene, times_s: &[f64]) -> Result<()> {
        let Some(clinical) = &self.clinical else { return Ok(()) };
        let Some(mut contact) = clinical.contact.clone() else { return Ok(()) };
        for (index, &time_s) in times_s.iter().enumerate() {
            // Between frames the way is interpolated, so that the frame before and after the touch count too.
            let about = [index.saturating_sub(1), index, (index + 1).min(times_s.len() - 1)];
            let mut wall_mm = 0.0;
            if about.iter().any(|&i| contact.weight(times_s[i]) > 0.0) {
                scene.deform(&clinical.wall_at(time_s))?;
                let (on_route, _) = self.on_route(clinical, time_s);
                let direction = contact.direction(&on_route);
                wall_mm = f64::from(scene.distances(&[on_route.translation], &[direction])?[0]);
            }
            contact.record(wall_mm);
        }
        self.clinical.iter_mut().for_each(|clinical| clinical.contact = Some(contact.clone()));
        Ok(())
    }
}

/// Refuses a camera that is not within sight of the middle of the airway.
fn check_inside(scene: &Scene, middle_mm: DVec3, camera_mm: DVec3) -> Result<()> {
    let way = camera_mm - middle_mm;
    if way.length() < 1e-9 {
        return Ok(());
    }
    let free_mm = f64::from(scene.distances(&[middle_mm], &[way.normalize()])?[0]);
    if free_mm > way.length() {
        return Ok(());
    }
    Err(Error::input(format!("the camera is {:.2} mm off the middle, the wall {free_mm:.2} mm", way.length())))
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
        let nominal = case.camera.camera(settings.width_px, settings.height_px);
        let duration_s = (settings.frames - 1) as f64 / settings.frames_per_second;
        let time_s: Vec<f64> = (0..settings.frames).map(|i| i as f64 / settings.frames_per_second).collect();
        let mut notes = Vec::new();
        let pace = Pace::on(&route, case, duration_s);
        if pace.speed_mm_per_s < case.trajectory.speed_mm_per_s {
            notes.push(format!(
                "the route of {:.0} mm is too short for {duration_s:.1} s at {} mm/s: the scope goes {:.2} mm/s",
                route.length_mm(),
                case.trajectory.speed_mm_per_s,
                pace.speed_mm_per_s
            ));
        }
        let (route_mm, end_motion_mm) = (route.length_mm(), route.end_motion_mm());
        let mut scene = Scene::new(&anatomy.inspiration, &anatomy.vertex_generation, flat(material), case.seed)?;
        let drawn = case.clinical.as_ref().map(|settings| settings.drawn(case.seed));
        let breathing = drawn.as_ref().map_or_else(|| case.waveform.clone(), |drawn| clinical::waveform(case, drawn));
        let waveform = breathing.ending(duration_s, case.seed);
        let (end, wanted) = (waveform.phase(duration_s, case.seed), breathing.wanted_end(case.seed));
        if (end - wanted).abs() > END_TOLERANCE {
            notes.push(format!(
                "the film of {duration_s:.1} s ends at the phase {end:.2} and not at {wanted:.2}: it is too short for its breaths"
            ));
        }
        let start_mm = route_mm - pace.farthest_mm;
        let clinical = drawn.as_ref().map(|drawn| {
            let points = route.points_between(start_mm, start_mm + pace.extent_mm);
            ClinicalFilm::new(case, anatomy, drawn, &nominal, &waveform, &time_s, points)
        });
        let camera = clinical.as_ref().map_or(nominal, |clinical| clinical.optics.camera);
        let scope = clinical.as_ref().map_or(case.scope, |clinical| clinical.scope(case));
        notes.extend(drawn.as_ref().and_then(|drawn| lens_note(&nominal, drawn)));
        notes.extend(bright_wall_note(material));
        if let Some(mask) = Sensor::new(&camera, &scope, case.seed).mask(&camera) {
            // Less one pixel at its rim, as it is scored.
            let hides = |e: Error| e.element("scope.mask_radius");
            Mask::from_image(&mask).and_then(|mask| mask.eroded(1)).map_err(hides)?;
        }
        let mut way = Way { route, waveform, seed: case.seed, steering: pace.steering, start_mm, clinical };
        way.plan_contact(&mut scene, &time_s)?;
        notes.extend(way.clinical.iter().filter(|c| c.motion.share < 1.0).map(|c| {
            format!(
                "faces would turn over: lag, hysteresis, heartbeat and shake are {} of what was drawn",
                c.motion.share
            )
        }));
        let light = scope_light(case);
        let planner = Planner { case, anatomy, albedo: material.albedo, camera, scope, light, way: &way };
        let mut planned = Vec::with_capacity(time_s.len());
        for (index, &now_s) in time_s.iter().enumerate() {
            progress.proceed()?;
            progress.advance(index, time_s.len());
            planned.push(planner.frame(&mut scene, index, now_s)?);
        }
        let wanted_gain: Vec<f64> = planned.iter().map(|frame| frame.wanted_gain).collect();
        let mut frames: Vec<FrameRecord> = planned.iter().map(|frame| frame.record).collect();
        for (frame, set) in frames.iter_mut().zip(exposure::follow(&wanted_gain, &time_s, &case.exposure, case.seed)) {
            frame.gain = set.gain * way.clinical.as_ref().map_or(1.0, ClinicalFilm::overexposure);
            frame.white_balance = set.white_balance;
        }
        let clipped = upper_median(planned.iter().map(|frame| frame.clipped_share)).unwrap_or(0.0);
        if clipped > MOST_CLIPPED {
            notes.push(format!(
                "the exposure expects to clip {:.0} % of the picture, and the film may come out brighter than exposure.target: \
                 a lower target, or a lamp that lights more of what the lens sees, mends it",
                100.0 * clipped
            ));
        }
        let middle_gain = upper_median(frames.iter().map(|f| f.gain)).unwrap_or(0.0);
        let arc_mm: Vec<f64> = time_s.iter().map(|&t| way.arc_mm(t)).collect();
        Ok(Film {
            camera,
            generation: arc_mm.iter().map(|&arc| way.route.generation(arc)).collect(),
            wanted_gain,
            amplification: frames.iter().map(|f| f.gain / middle_gain).collect(),
            blur_px: planned.iter().map(|frame| frame.blur_px).collect(),
            frames,
            novel_views: planned.iter().filter_map(|frame| frame.novel_view).collect(),
            arc_mm,
            off_route_mm: planned.iter().map(|frame| frame.off_route_mm).collect(),
            clearance_mm: planned.iter().map(|frame| frame.clearance_mm).collect(),
            speed_mm_per_s: pace.speed_mm_per_s,
            end_motion_mm,
            route_mm,
            notes,
            scope,
            told_views: planned.iter().filter_map(|frame| frame.told_view).collect(),
            conditions: planned.into_iter().filter_map(|frame| frame.conditions).collect(),
            way,
        })
    }

    /// True pose and phase at any time, between frames too.
    pub fn state_at(&self, time_s: f64) -> (DAffine3, f64) {
        self.way.state_at(time_s)
    }

    /// What the film has beyond the ideal one; `None` on the ideal track.
    pub fn clinical(&self) -> Option<&ClinicalFilm> {
        self.way.clinical.as_ref()
    }

    /// The wall of `anatomy` at any time, between frames too.
    pub fn wall_at(&self, anatomy: &Anatomy, time_s: f64) -> Vec<DVec3> {
        self.way.wall(anatomy, time_s, self.way.state_at(time_s).1)
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

/// How fast the scope goes, and how far that takes it.
struct Pace {
    steering: Steering,
    speed_mm_per_s: f64,
    /// From the least to the farthest that it gets.
    extent_mm: f64,
    /// The farthest, counted from where it starts.
    farthest_mm: f64,
}

impl Pace {
    /// As fast as the case says, or as slowly as a short route asks for.
    fn on(route: &Route, case: &Case, duration_s: f64) -> Pace {
        let at_speed = |speed_mm_per_s: f64| {
            let seed = case.trajectory.seed ^ case.seed;
            let steering = Steering::new(case.trajectory.steering, speed_mm_per_s, duration_s, seed);
            let [back, on] = steering.extent_mm(duration_s);
            Pace { steering, speed_mm_per_s, extent_mm: on - back, farthest_mm: on }
        };
        let pace = at_speed(case.trajectory.speed_mm_per_s);
        if pace.extent_mm <= route.length_mm() {
            return pace;
        }
        let slowed = at_speed(pace.speed_mm_per_s * (route.length_mm() / pace.extent_mm));
        debug_assert!(slowed.extent_mm <= route.length_mm() * (1.0 + 1e-9));
        slowed
    }
}

/// What the plan of one frame is.
struct PlannedFrame {
    /// Without its gain and white balance, which follow from all frames.
    record: FrameRecord,
    wanted_gain: f64,
    /// Of the picture as the exposure knows it.
    clipped_share: f64,
    clearance_mm: f64,
    off_route_mm: f64,
    blur_px: f64,
    /// On the clinical track.
    conditions: Option<FrameConditions>,
    novel_view: Option<NovelView>,
    told_view: Option<NovelView>,
}

/// What all frames are planned with.
struct Planner<'a> {
    case: &'a Case,
    anatomy: &'a Anatomy,
    albedo: [f64; 3],
    camera: Camera,
    scope: ScopeSettings,
    light: Light,
    way: &'a Way,
}

impl Planner<'_> {
    /// Plans the frame `index` at `now_s`; `scene` is left in its shape. Errors: the camera would leave the lumen.
    fn frame(&self, scene: &mut Scene, index: usize, now_s: f64) -> Result<PlannedFrame> {
        let Planner { case, anatomy, camera, scope, way, .. } = self;
        let named = |e: Error| e.element(format!("frame {index}"));
        let (world_from_camera, phase) = way.state_at(now_s);
        let wall = way.wall(anatomy, now_s, phase);
        let clearance_mm = self.clearance_mm(&wall, world_from_camera.translation).map_err(named)?;
        let middle = match &way.clinical {
            None => way.route.pose(way.arc_mm(now_s), phase),
            Some(clinical) => way.on_route(clinical, now_s).0,
        };
        scene.deform(&wall)?;
        check_inside(scene, middle.translation, world_from_camera.translation).map_err(named)?;
        let conditions = match &way.clinical {
            None => None,
            Some(clinical) => {
                let fault = clinical.sensor.told(index, now_s, |time_s| way.state_at(time_s).0);
                let lamp = clinical.optics.light(case, scene, &world_from_camera)?.position_mm;
                Some(FrameConditions {
                    body: clinical.motion.state(now_s),
                    contact: clinical.contact.as_ref().map_or(0.0, |contact| contact.weight(now_s)),
                    fault,
                    lamp_mm: lamp.map_or(DVec3::ZERO, |lamp| world_from_camera.inverse().transform_point3(lamp)),
                    lens_film: clinical.lens_film.scattered(now_s),
                })
            }
        };
        let proxy = exposure::proxy_radiance(scene, camera, &world_from_camera, &self.light, scope, self.albedo)?;
        let wanted_gain = exposure::wanted_gain(&proxy, case.exposure.target)?;
        let blur_px = blur(scene, camera, anatomy, way, now_s, scope.shutter_s)?;
        let novel_view = if sequence::held_out(index) {
            let world_from_camera = beside(scene, &wall, &world_from_camera, case.seed, index)?;
            Some(NovelView { frame: index, world_from_camera })
        } else {
            None
        };
        // A second camera is known relative to the first: what is told of it is off by as much.
        let told_view = novel_view.as_ref().zip(conditions.as_ref()).map(|(view, told)| NovelView {
            frame: index,
            world_from_camera: told.fault.told * world_from_camera.inverse() * view.world_from_camera,
        });
        Ok(PlannedFrame {
            record: FrameRecord { time_s: now_s, phase, gain: 1.0, white_balance: [1.0; 3], world_from_camera },
            wanted_gain,
            clipped_share: exposure::clipped_share(&proxy, wanted_gain),
            clearance_mm,
            off_route_mm: middle.translation.distance(world_from_camera.translation),
            blur_px,
            conditions,
            novel_view,
            told_view,
        })
    }

    /// Distance from the camera to the nearest vertex of the wall in mm. Errors: less than the scope needs.
    fn clearance_mm(&self, wall: &[DVec3], camera_mm: DVec3) -> Result<f64> {
        let trajectory = &self.case.trajectory;
        let least_mm = match self.way.clinical {
            None => LEAST_CLEARANCE * (1.0 - trajectory.steering.sideways) * trajectory.scope_radius_mm,
            Some(_) => LEAST_CLINICAL_MM,
        };
        let clearance_mm = nearest_mm(wall, camera_mm);
        if clearance_mm < least_mm {
            let sentence = format!("the wall is {clearance_mm:.2} mm from the camera: too close for this scope");
            return Err(Error::input(sentence));
        }
        Ok(clearance_mm)
    }
}

/// Median motion of the image in pixels while the shutter is open around `time_s`, by rays of a coarse image.
fn blur(scene: &Scene, camera: &Camera, anatomy: &Anatomy, way: &Way, time_s: f64, shutter_s: f64) -> Result<f64> {
    if shutter_s <= 0.0 {
        return Ok(0.0);
    }
    let coarse = camera.scaled(BLUR_RAYS / camera.width as f64);
    let [open, now, close] = [-0.5, 0.0, 0.5].map(|part| way.state_at(time_s + part * shutter_s));
    let visible = VisibleWall::new(scene, &coarse, &now.0, &anatomy.inspiration, &anatomy.expiration.vertices)?;
    if way.clinical.is_some() {
        let [before, after] = [-0.5, 0.5].map(|part| way.wall(anatomy, time_s + part * shutter_s, 0.0));
        let ways = visible.image_ways_px(camera, (&open.0, &before), (&close.0, &after));
        return Ok(upper_median(ways.iter().map(|way| way.length())).unwrap_or(0.0));
    }
    Ok(visible.image_motion_px(camera, (&open.0, open.1), (&close.0, close.1)))
}

/// What is said of walls so bright that light is thrown back and forth between them: the exposure's proxy knows one bounce.
fn bright_wall_note(material: &Material) -> Option<String> {
    let most = material.albedo.into_iter().fold(0.0, f64::max);
    (most > MOST_ALBEDO).then(|| {
        format!(
            "walls of albedo {most} throw back more light than the exposure expects: above {MOST_ALBEDO} the film may come \
             out brighter than exposure.target"
        )
    })
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
