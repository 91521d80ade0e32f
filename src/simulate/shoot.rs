//! The pixels of a film: one frame at a time, every frame a function of case, settings and its number alone.

use std::path::Path;

use glam::{DAffine3, DVec3};

use crate::airway::Anatomy;
use crate::airway::case::Case;
use crate::base::{Error, Image, Progress, Result, TriangleMesh, mesh};
use crate::formats::{exr, jpeg, mesh as mesh_file, png};
use crate::render::{Light, Material, RenderSettings, RenderedFrame, Scene, Shading, Transport, render};

use super::clinical::tissue_motion::TissueMotion;
use super::clinical::{ClinicalFilm, focus};
use super::film::{Film, scope_light};
use super::sensor::{Exposed, Sensor};
use super::sequence::{self, NovelView};
use super::settings::{FilmLight, MOMENTS, MeshOutput, RadianceOutput, SimulationSettings};
use super::truth::{TruthMap, VisibleWall};

/// Marks the random numbers of a second camera.
const NOVEL_KEY: u64 = 1 << 48;
/// Half the step in phase of the central difference: moves the wall by at most a tenth of a millimetre.
const PHASE_STEP: f64 = 0.005;

/// Everything that filming needs, set up once.
pub(super) struct Studio<'a> {
    case: &'a Case,
    anatomy: &'a Anatomy,
    film: &'a Film,
    settings: &'a SimulationSettings,
    scene: Scene,
    light: Light,
    sensor: Sensor,
}

/// A frame that is not on disk yet.
struct Shot {
    index: usize,
    depth_mm: Image<f32>,
    radiance: Option<Image<f32>>,
    image: Image<u8>,
    /// How much of the wall drops hide, 0 to 255; on the clinical track.
    covered: Option<Image<u8>>,
    /// Picture and depth of the second camera.
    novel: Option<(Image<u8>, Image<f32>)>,
}

impl Shot {
    fn write(&self, out: &Path) -> Result<()> {
        exr::write_depth(&out.join(sequence::depth_name(self.index)), &self.depth_mm)?;
        if let Some(radiance) = &self.radiance {
            exr::write_rgb(&out.join(sequence::radiance_name(self.index)), radiance)?;
        }
        if let Some((image, depth_mm)) = &self.novel {
            exr::write_depth(&out.join(sequence::novel_depth_name(self.index)), depth_mm)?;
            png::write_rgb(&out.join(sequence::novel_image_name(self.index)), image)?;
        }
        if let Some(covered) = &self.covered {
            png::write_grey(&out.join(sequence::covered_name(self.index)), covered)?;
        }
        png::write_rgb(&out.join(sequence::image_name(self.index)), &self.image)
    }
}

/// Renders every frame that is missing. A frame's image is written last, so an image means a whole frame; it is written
/// while the next one is rendered.
pub(super) fn shoot(
    case: &Case,
    anatomy: &Anatomy,
    film: &Film,
    material: &Material,
    settings: &SimulationSettings,
    out: &Path,
    progress: &dyn Progress,
) -> Result<()> {
    let mut studio = None;
    let mut last: Option<Shot> = None;
    for index in 0..film.frames.len() {
        progress.advance(index, film.frames.len());
        if out.join(sequence::image_name(index)).is_file() {
            continue;
        }
        if progress.cancelled() {
            last.map_or(Ok(()), |shot| shot.write(out))?;
            return Err(Error::interrupted());
        }
        let studio = match &mut studio {
            Some(studio) => studio,
            None => studio.insert(Studio::new(case, anatomy, film, material, settings)?),
        };
        let (shot, written) =
            rayon::join(|| studio.shoot(index, out), || last.as_ref().map_or(Ok(()), |shot| shot.write(out)));
        written?;
        last = Some(shot?);
    }
    last.map_or(Ok(()), |shot| shot.write(out))?;
    progress.advance(film.frames.len(), film.frames.len());
    Ok(())
}

impl<'a> Studio<'a> {
    fn new(
        case: &'a Case,
        anatomy: &'a Anatomy,
        film: &'a Film,
        material: &Material,
        settings: &'a SimulationSettings,
    ) -> Result<Self> {
        let mut scene = Scene::new(&anatomy.inspiration, &anatomy.vertex_generation, *material, case.seed)?;
        scene.set_other_end(&anatomy.expiration.vertices)?;
        Ok(Studio {
            case,
            anatomy,
            film,
            settings,
            scene,
            light: scope_light(case),
            sensor: Sensor::new(&film.camera, &film.scope, case.seed),
        })
    }

    /// Renders a frame; writes what was asked for besides it.
    fn shoot(&mut self, index: usize, out: &Path) -> Result<Shot> {
        let record = self.film.frames[index];
        let novel = self.film.novel_views.iter().find(|view| view.frame == index);
        let novel = novel.map(|view| self.novel(view)).transpose()?;
        let (frame, covered) = match self.film.clinical() {
            None => (self.exposed_frame(index, &DAffine3::IDENTITY, index as u64)?, None),
            Some(clinical) => {
                let (frame, covered) = self.clinical_frame(clinical, index)?;
                (frame, Some(covered))
            }
        };
        if self.settings.meshes == MeshOutput::EveryFrame {
            let deformed =
                TriangleMesh { vertices: self.wall(record.time_s), faces: self.anatomy.inspiration.faces.clone() };
            mesh_file::write_ply(&out.join(sequence::frame_mesh_name(index)), &deformed, &["units mm", "space LPS"])?;
        }
        self.write_surface_truth(index, out)?;
        let image = self.sensor.image(&frame.radiance, &self.exposed(index), index as u64);
        let image = match self.film.clinical() {
            None => image,
            Some(clinical) => recorded(image, clinical)?,
        };
        if self.settings.truth.has(TruthMap::PhaseSensitivity) {
            let sensitivity = self.phase_sensitivity(index, PHASE_STEP)?;
            exr::write_rgb(&out.join(sequence::sensitivity_name(index)), &sensitivity)?;
        }
        let radiance = (self.settings.radiance == RadianceOutput::Exr).then_some(frame.radiance);
        Ok(Shot { index, depth_mm: frame.depth_mm, radiance, image, covered, novel })
    }

    fn exposed(&self, index: usize) -> Exposed {
        let record = self.film.frames[index];
        Exposed {
            gain: record.gain,
            amplification: self.film.amplification[index],
            white_balance: record.white_balance,
        }
    }

    fn wall(&self, time_s: f64) -> Vec<DVec3> {
        self.film.wall_at(self.anatomy, time_s)
    }

    /// What the second camera sees, which moves with the first: picture, with its frame's exposure, and depth.
    fn novel(&mut self, view: &NovelView) -> Result<(Image<u8>, Image<f32>)> {
        let first = self.film.frames[view.frame].world_from_camera;
        let key = view.frame as u64 | NOVEL_KEY;
        let frame = match self.film.clinical() {
            None => self.exposed_frame(view.frame, &(first.inverse() * view.world_from_camera), key)?,
            Some(clinical) => self.scene_view(clinical, view.frame, &view.world_from_camera, key)?.0,
        };
        Ok((self.sensor.image(&frame.radiance, &self.exposed(view.frame), key), frame.depth_mm))
    }

    /// The radiance that the sensor gathers while the shutter is open, and the depth at the frame's own time, of the
    /// camera at `first_from_camera` beside the frame's. Leaves the scene at that time. `key` picks the random numbers.
    fn exposed_frame(&mut self, index: usize, first_from_camera: &DAffine3, key: u64) -> Result<RenderedFrame> {
        let record = self.film.frames[index];
        let world_from_camera = record.world_from_camera * *first_from_camera;
        let shutter_s = self.case.scope.shutter_s;
        if shutter_s <= 0.0 {
            let (wall, light) = (self.wall(record.time_s), self.light);
            return self.moment(&world_from_camera, &wall, &light, key);
        }
        let (light, samples) = (self.light, self.settings.samples_per_pixel.div_ceil(MOMENTS as u32));
        let middle = MOMENTS / 2;
        let mut sum: Option<Image<f32>> = None;
        for moment in (0..MOMENTS).filter(|&m| m != middle) {
            let offset_s = ((moment as f64 + 0.5) / MOMENTS as f64 - 0.5) * shutter_s;
            let (pose, _) = self.film.state_at(record.time_s + offset_s);
            let key = key | (moment + 1) << 32;
            let wall = self.wall(record.time_s + offset_s);
            let frame = self.rendered(&(pose * *first_from_camera), &wall, &light, (key, samples))?;
            add(&mut sum, &frame.radiance);
        }
        let wall = self.wall(record.time_s);
        let mut frame = self.rendered(&world_from_camera, &wall, &light, (key, samples))?;
        add(&mut sum, &frame.radiance);
        if let Some(sum) = sum {
            frame.radiance = sum.map(|v| v / MOMENTS as f32);
        }
        Ok(frame)
    }

    /// A frame of the clinical track, up to the sensor, and how much of the wall drops hide. Leaves the scene at the
    /// frame's own time.
    fn clinical_frame(&mut self, clinical: &ClinicalFilm, index: usize) -> Result<(RenderedFrame, Image<u8>)> {
        let record = self.film.frames[index];
        let pose = record.world_from_camera;
        let (mut frame, covered, visible) = self.scene_view(clinical, index, &pose, index as u64)?;
        let (camera, picture) = (&self.film.camera, &clinical.settings.picture);
        // Near walls first, since light is out of focus before it is spread by motion; then the glass before the lens.
        if picture.aperture_mm > 0.0 {
            let radius = |&z: &f32| focus::circle_px(camera, f64::from(z), picture.aperture_mm, picture.sharp_from_mm);
            let radius_px: Vec<f64> = frame.depth_mm.data.iter().map(radius).collect();
            frame.radiance = focus::defocused(frame.radiance, &radius_px);
        }
        let shutter_s = self.film.scope.shutter_s;
        if shutter_s > 0.0 {
            let [open, close] = [-0.5, 0.5].map(|part| {
                let time_s = record.time_s + part * shutter_s;
                (self.film.state_at(time_s).0, self.wall(time_s))
            });
            let ways = visible.image_ways_px(camera, (&open.0, &open.1), (&close.0, &close.1));
            frame.radiance = focus::moved(&frame.radiance, &ways);
        }
        frame.radiance = clinical.lens_film.seen_through(frame.radiance, record.time_s);
        Ok((frame, covered))
    }

    /// What a camera at `pose` sees in a frame of the clinical track, drops and all, before lens and sensor; how much of
    /// the wall they hide; the wall that it sees.
    fn scene_view(
        &mut self,
        clinical: &ClinicalFilm,
        index: usize,
        pose: &DAffine3,
        key: u64,
    ) -> Result<(RenderedFrame, Image<u8>, VisibleWall<'a>)> {
        let wall = self.wall(self.film.frames[index].time_s);
        self.scene.deform(&wall)?;
        let light = clinical.optics.light(self.case, &self.scene, pose)?;
        let mut frame = self.moment(pose, &wall, &light, key)?;
        let (rest, other) = (&self.anatomy.inspiration, &self.anatomy.expiration.vertices);
        let visible = VisibleWall::new(&self.scene, &self.film.camera, pose, rest, other)?;
        let eye = pose.translation;
        let covered = clinical.drops.cover(&mut frame.radiance, visible.points(), (rest, &wall), eye, &light);
        Ok((frame, covered, visible))
    }

    /// A rendering with the film's samples.
    fn moment(&mut self, pose: &DAffine3, wall: &[DVec3], light: &Light, key: u64) -> Result<RenderedFrame> {
        self.rendered(pose, wall, light, (key, self.settings.samples_per_pixel))
    }

    fn rendered(
        &mut self,
        pose: &DAffine3,
        wall: &[DVec3],
        light: &Light,
        (key, samples_per_pixel): (u64, u32),
    ) -> Result<RenderedFrame> {
        self.scene.deform(wall)?;
        let settings = RenderSettings {
            samples_per_pixel,
            transport: match self.settings.light {
                FilmLight::Full => Transport::VERTICES,
                FilmLight::Draft => Transport::DRAFT,
            },
            shading: Shading::Smooth,
            seed: self.case.seed,
            frame: key,
            ..RenderSettings::default()
        };
        render(&self.scene, &self.film.camera, pose, light, &settings)
    }

    /// The truth that follows from where each pixel's ray meets the wall.
    fn write_surface_truth(&self, index: usize, out: &Path) -> Result<()> {
        let wanted = self.settings.truth;
        if ![TruthMap::Normals, TruthMap::Albedo, TruthMap::Motion].iter().any(|&map| wanted.has(map)) {
            return Ok(());
        }
        let record = self.film.frames[index];
        let (rest, other) = (&self.anatomy.inspiration, &self.anatomy.expiration.vertices);
        let visible = VisibleWall::new(&self.scene, &self.film.camera, &record.world_from_camera, rest, other)?;
        let clinical = self.film.clinical();
        let wall = clinical.map(|clinical| clinical.wall_at(record.time_s));
        if wanted.has(TruthMap::Normals) {
            let normals = match &wall {
                None => visible.normals(record.phase, &record.world_from_camera),
                Some(wall) => visible.normals_of(wall, &record.world_from_camera),
            };
            exr::write_rgb(&out.join(sequence::normal_name(index)), &normals)?;
        }
        if wanted.has(TruthMap::Albedo) {
            exr::write_rgb(&out.join(sequence::albedo_name(index)), &visible.albedo())?;
        }
        if wanted.has(TruthMap::Motion) {
            let to = |other: usize| {
                let other = self.film.frames[other];
                match (&wall, clinical) {
                    (Some(wall), Some(clinical)) => visible.motion_between(wall, &clinical.wall_at(other.time_s)),
                    _ => visible.motion(record.phase, other.phase),
                }
            };
            if index + 1 < self.film.frames.len() {
                let motion = to(index + 1);
                exr::write_rgb(&out.join(sequence::forward_motion_name(index)), &motion)?;
            }
            if index > 0 {
                let motion = to(index - 1);
                exr::write_rgb(&out.join(sequence::backward_motion_name(index)), &motion)?;
            }
        }
        Ok(())
    }

    /// |dI/dphase| per channel of the encoded image without noise: central difference of two renderings with the same
    /// random numbers, camera and exposure as the frame's.
    fn phase_sensitivity(&mut self, index: usize, step: f64) -> Result<Image<f32>> {
        let record = self.film.frames[index];
        let exposed = self.exposed(index);
        let mut side = |change: f64| -> Result<Image<f32>> {
            let (rest, other) = (&self.anatomy.inspiration.vertices, &self.anatomy.expiration.vertices);
            let (wall, light) = match self.film.clinical() {
                None => (mesh::interpolate(rest, other, record.phase + change), self.light),
                Some(clinical) => {
                    let body = TissueMotion::with_phase_moved(&clinical.motion.state(record.time_s), change);
                    let wall = clinical.motion.places(&clinical.wall, &body);
                    self.scene.deform(&wall)?;
                    (wall, clinical.optics.light(self.case, &self.scene, &record.world_from_camera)?)
                }
            };
            let frame = self.moment(&record.world_from_camera, &wall, &light, index as u64)?;
            Ok(self.sensor.clean_encoded(&frame.radiance, &exposed))
        };
        let (low, high) = (side(-step)?, side(step)?);
        let mut difference = high;
        for (h, l) in difference.data.iter_mut().zip(&low.data) {
            *h = (*h - l).abs() / (2.0 * step) as f32;
        }
        Ok(difference)
    }
}

/// `image` as the film's recorder keeps it.
fn recorded(image: Image<u8>, clinical: &ClinicalFilm) -> Result<Image<u8>> {
    match clinical.settings.picture.jpeg_quality.round() as u8 {
        0 => Ok(image),
        quality => jpeg::decode_rgb(&jpeg::encode_recording(&image, quality)?),
    }
}

fn add(sum: &mut Option<Image<f32>>, image: &Image<f32>) {
    match sum {
        Some(sum) => sum.data.iter_mut().zip(&image.data).for_each(|(s, v)| *s += v),
        None => *sum = Some(image.clone()),
    }
}
