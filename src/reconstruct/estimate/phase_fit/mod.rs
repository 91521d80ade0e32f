//! The paper's online loop, shared by every method that has one breathing phase per frame: per frame (i) theta alone,
//! (ii) appearance alone, (iii) both, under `w_c [(1 - w_s) L1 + w_s (1 - SSIM)] + w_t (alpha_t - alpha_{t-1})^2`
//! (Eq. 3 and 4). What carries the Gaussians (a mesh, or nothing) is behind [`Carried`].
//!
//! Ours where the paper is silent, each with its number in the TOML: the guess of a frame's phase continues part of the
//! last change; a few candidates around it are rendered before stage (i); after it the frame is placed among keyframes,
//! since what is painted alone lets the phase drift ([`crate::reconstruct::estimate::window`]); an exposure gain per channel and frame in
//! closed form; brightness carried from frame to frame by the law of the light at the scope.

mod stages;

use glam::Vec3;
use rayon::prelude::*;

use crate::base::{Image, Progress, Result, TriangleMesh, mesh};
use crate::reconstruct::fitting::schedule::scaled_iterations;
use crate::reconstruct::online::depth_image;
use crate::splat::{DepthOutput, Gaussians, Gradients, ImageGradient, Rasterizer, Settings, View, Wanted};

use crate::reconstruct::activation::PhaseActivation;
use crate::reconstruct::contract::{FramePrediction, Observation, Reconstruction};
use crate::reconstruct::fitting::anchored::{SH_C0, SH_VALUES};
use crate::reconstruct::fitting::grid_search::{depth_error_mm, grid_search};
use crate::reconstruct::fitting::loss::photometric::Photometric;
use crate::reconstruct::fitting::memory::{Memory, Shown, shift};
use crate::reconstruct::fitting::scope_light::{ScopeLight, Shade};
use crate::reconstruct::geometry::pyramid::Level;
use crate::reconstruct::online::{color_image, fit_in_order, held_out};
use crate::reconstruct::settings::{FrameFitSettings, PhaseEstimation};

/// How far a frame's phase may be from its guess.
pub const REACH: f64 = 0.15;
/// Darkest colour that a Gaussian keeps after a frame: one below zero is shown as zero and has no gradient, and would stay
/// black for ever.
const DARKEST: f32 = 0.01;
/// Largest change of colour with the direction that it keeps, as a share of its colour, per axis. What is learned at a grazing
/// look is small there and wild from elsewhere.
const LARGEST_CHANGE: f32 = 0.3;
/// Linear spherical harmonics of the unit directions.
const SH_C1: f32 = 0.488_602_5;

/// Gaussians that a phase moves.
pub trait Carried {
    /// Makes the compact copy of what `view` can see while the phase stays within `phases`.
    fn enter(&mut self, view: &View, phases: [f64; 2]) -> Result<()>;
    /// Moves them to `phase`.
    fn place(&mut self, phase: f64) -> Result<()>;
    /// The compact copy, as placed.
    fn gaussians(&self) -> &Gaussians<f32>;
    /// Spherical harmonics of the compact copy, and what is remembered of them.
    fn colors(&mut self) -> (&mut [f32], &mut Memory);
    /// Velocity of each centre, mm per unit of phase.
    fn velocities(&self, out: &mut Vec<[f32; 3]>) -> Result<()>;
    /// dL/dphase from the gradients of centres and spread.
    fn phase_derivative(&self, gradients: &Gradients<f32>) -> Result<f64>;
    /// Zero moments.
    fn begin_appearance(&mut self);
    /// Groups that [`Carried::step_appearance`] needs.
    fn appearance_groups(&self) -> Wanted;
    /// One optimiser step of appearance of what is `visible` (one flag per Gaussian of the compact copy).
    fn step_appearance(&mut self, gradients: &Gradients<f32>, visible: &[bool]) -> Result<()>;
    /// The phase by the pictures of past frames, near what is `expected`; that itself where no surface carries pictures.
    fn place_among_keyframes(&mut self, _frame: Level, expected: f64) -> f64 {
        expected
    }
    /// Takes the compact copy back.
    fn leave(&mut self);
}

/// Where the phase comes from.
#[derive(Clone, Debug)]
pub enum PhaseSource<'a> {
    /// Estimated from RGB; the first one by depth.
    Estimated(&'a PhaseEstimation),
    /// Given for every frame (`static-ct`: zeros; `oracle-phase`: the truth).
    Given(Vec<f64>),
}

/// The running estimate.
struct Fitter<'a> {
    settings: &'a FrameFitSettings,
    /// `None` where the phase is given.
    estimation: Option<&'a PhaseEstimation>,
    observation: &'a Observation,
    scale: f64,
    rasterizer: Rasterizer<f32>,
    gradient: Vec<f32>,
    gain: [f64; 3],
    phases: Vec<f64>,
    mean_color: [f32; 3],
    velocities: Vec<[f32; 3]>,
    shades: Vec<Shade>,
}

/// Runs the loop over all frames.
pub fn run(
    settings: &FrameFitSettings,
    iteration_scale: f64,
    source: &PhaseSource<'_>,
    observation: &Observation,
    carried: &mut dyn Carried,
    emit: &mut dyn FnMut(FramePrediction) -> Result<()>,
    progress: &dyn Progress,
) -> Result<(f64, Reconstruction)> {
    let mut fitter = Fitter {
        settings,
        estimation: match source {
            PhaseSource::Estimated(estimation) => Some(estimation),
            PhaseSource::Given(_) => None,
        },
        observation,
        scale: iteration_scale,
        rasterizer: Rasterizer::new(),
        gradient: Vec::new(),
        gain: [1.0; 3],
        phases: Vec::new(),
        mean_color: [0.0; 3],
        velocities: Vec::new(),
        shades: Vec::new(),
    };
    let frames = observation.images.len();
    let seconds = fit_in_order(frames, |frame| fitter.fit(frame, source, carried), emit, progress)?;
    let last = fitter.phases.last().copied().unwrap_or(0.0);
    Ok((last, Reconstruction { final_mesh: None, seconds }))
}

/// `rest + phase * displacement`, vertex by vertex.
pub fn at_phase(rest: &[[f32; 3]], displacement: &[[f32; 3]], phase: f32, out: &mut Vec<[f32; 3]>) {
    let moved = rest.par_iter().zip(displacement).with_min_len(4096);
    moved.map(|(r, d)| [0, 1, 2].map(|k| r[k] + phase * d[k])).collect_into_vec(out);
}

/// The airway at `phase` by the two CTs.
pub fn mesh_at(observation: &Observation, phase: f64) -> TriangleMesh {
    let vertices = match &observation.expiration {
        Some(expiration) => mesh::interpolate(&observation.inspiration.vertices, &expiration.vertices, phase),
        None => observation.inspiration.vertices.clone(),
    };
    TriangleMesh { vertices, faces: observation.inspiration.faces.clone() }
}

impl<'a> Fitter<'a> {
    fn estimation(&self) -> &'a PhaseEstimation {
        self.estimation.expect("nothing asks how the phase is estimated where it is given")
    }

    fn activation(&self) -> PhaseActivation {
        let estimation = self.estimation();
        PhaseActivation { kind: *estimation.activation, leak: *estimation.phase_leak }
    }

    fn view(&self, frame: usize) -> View {
        View::new(self.observation.camera, self.observation.world_from_camera[frame])
    }

    fn render_settings(&self, depth: DepthOutput) -> Settings {
        Settings { gain: self.gain, depth, ..Settings::default() }
    }

    /// What the phase of `frame` will be if the breath goes on as it went.
    fn guess(&self, frame: usize) -> f64 {
        match *self.phases.as_slice() {
            [] => 0.0,
            [only] => only,
            [.., before, last] if frame > 1 => (last + *self.estimation().velocity * (last - before)).clamp(0.0, 1.0),
            [.., last] => last,
        }
    }

    fn iterations(&self, stage: usize, frame: usize) -> usize {
        let factor = if frame == 0 && stage > 0 { *self.settings.first_frame_factor } else { 1.0 };
        scaled_iterations(self.settings.iterations[stage] as f64 * factor, self.scale)
    }

    fn fit(&mut self, frame: usize, source: &PhaseSource<'_>, carried: &mut dyn Carried) -> Result<FramePrediction> {
        let view = self.view(frame);
        let (width, height) = (view.camera.width as usize, view.camera.height as usize);
        let estimated = self.estimation.is_some();
        let mut phase = match source {
            PhaseSource::Given(phases) => phases[frame],
            PhaseSource::Estimated(_) => self.guess(frame),
        };
        let reach = match (estimated, frame) {
            (true, 0) => [0.0, 1.0],
            (true, _) => [(phase - REACH).max(0.0), (phase + REACH).min(1.0)],
            (false, _) => [phase, phase],
        };
        carried.enter(&view, reach)?;
        self.place(&view, carried, phase)?;
        if estimated && frame == 0 {
            phase = self.search_by_depth(&view, carried)?;
            self.place(&view, carried, phase)?;
        }
        let ahead = if held_out(frame) {
            self.rasterizer.render(carried.gaussians(), &view, &self.render_settings(DepthOutput::Skip), None)?;
            Some(color_image(&self.rasterizer))
        } else {
            None
        };
        // From here on the frame's image may be looked at.
        let image = self.observation.images[frame].to_unit();
        let of_all = *self.settings.ssim_weight;
        let of_phase = self.estimation.map_or(of_all, |estimation| *estimation.phase_ssim_weight);
        let weights = self.observation.pixel_weights();
        let mut loss = Photometric::new(&image.data, width, height, of_phase.max(of_all), weights.as_deref());
        if estimated {
            if frame > 0 {
                loss.set_ssim_weight(of_phase);
                phase = self.measure_phase(&view, carried, &mut loss, &image, phase, frame)?;
            }
            let weights = weights.unwrap_or_default();
            phase = carried.place_among_keyframes(Level { view, image: image.clone(), weights }, phase);
            self.place(&view, carried, phase)?;
        }
        if frame > 0 {
            self.fit_gain(&view, carried, &image)?;
        }
        self.color_the_unseen(&view, carried, &image);
        let (sh, memory) = carried.colors();
        let before = memory.set_aside(sh);
        loss.set_ssim_weight(of_all);
        phase = self.optimise_appearance(&view, carried, &mut loss, phase, frame, estimated)?;
        self.place(&view, carried, phase)?;
        self.rasterizer.render(carried.gaussians(), &view, &self.render_settings(DepthOutput::Surface), None)?;
        let color = color_image(&self.rasterizer);
        let depth_mm = depth_image(self.rasterizer.rendered(), width, height);
        self.mark_fitted(&view, carried, &image, &before);
        carried.leave();
        self.phases.push(phase);
        Ok(FramePrediction {
            frame,
            color,
            depth_mm,
            phase: estimated.then_some(phase),
            phase_deviation: None,
            world_from_camera: None,
            ahead,
        })
    }

    /// First frame: the phase whose rendered depth is nearest to the given one.
    fn search_by_depth(&mut self, view: &View, carried: &mut dyn Carried) -> Result<f64> {
        let Some(truth) = &self.observation.first_depth_mm else { return Ok(0.0) };
        let settings = self.render_settings(DepthOutput::Surface);
        grid_search(*self.estimation().grid_steps, |phase| {
            self.place(view, carried, phase)?;
            Ok(depth_error_mm(self.rasterizer.render(carried.gaussians(), view, &settings, None)?, truth))
        })
    }

    fn light(&self, view: &View) -> ScopeLight {
        ScopeLight::new(view, *self.settings.falloff_exponent, *self.settings.indirect_share)
    }

    /// Moves the Gaussians to `phase`; what was seen before is shown as the light at the scope shows it there.
    fn place(&mut self, view: &View, carried: &mut dyn Carried, phase: f64) -> Result<()> {
        carried.place(phase)?;
        if *self.settings.falloff_exponent != 0.0 {
            self.light(view).shades(carried.gaussians(), &[], &mut self.shades);
            let (sh, memory) = carried.colors();
            for ((sh, at), shade) in sh.chunks_exact_mut(SH_VALUES).zip(&mut memory.contained_shade).zip(&self.shades) {
                if *at > 0.0 {
                    let ratio = shade.value / *at;
                    for (i, value) in sh.iter_mut().enumerate() {
                        *value = (*value + shift(i)) * ratio - shift(i);
                    }
                    *at = shade.value;
                }
            }
        }
        Ok(())
    }

    /// dL/dphase of the photometric loss: Gaussians move, and the light on them changes.
    fn phase_derivative(&mut self, view: &View, carried: &mut dyn Carried) -> Result<f64> {
        let mut sum = carried.phase_derivative(self.rasterizer.gradients())?;
        if *self.settings.falloff_exponent != 0.0 {
            carried.velocities(&mut self.velocities)?;
            self.light(view).shades(carried.gaussians(), &self.velocities, &mut self.shades);
            let by_sh = &self.rasterizer.gradients().sh;
            let (sh, memory) = carried.colors();
            let discs = sh.chunks_exact(SH_VALUES).zip(by_sh.chunks_exact(SH_VALUES));
            for (((sh, by_sh), at), shade) in discs.zip(&memory.contained_shade).zip(&self.shades) {
                if *at > 0.0 {
                    let along: f32 = sh.iter().zip(by_sh).enumerate().map(|(i, (v, g))| (v + shift(i)) * g).sum();
                    sum += (along * shade.relative_slope) as f64;
                }
            }
        }
        Ok(sum)
    }

    /// Gain per channel that brings the prediction nearest to the image in the least-squares sense, within the limit.
    fn fit_gain(&mut self, view: &View, carried: &mut dyn Carried, image: &Image<f32>) -> Result<()> {
        let limit = *self.settings.exposure_limit;
        if limit <= 0.0 {
            return Ok(());
        }
        self.gain = [1.0; 3];
        let rendered =
            self.rasterizer.render(carried.gaussians(), view, &self.render_settings(DepthOutput::Skip), None)?;
        for c in 0..3 {
            let pairs = rendered.color.iter().zip(&image.data).skip(c).step_by(3).enumerate();
            let (mut cross, mut square) = (0.0f64, 1e-9f64);
            for (_, (&r, &i)) in pairs.filter(|(pixel, _)| self.observation.shows(*pixel)) {
                cross += (r * i) as f64;
                square += (r * r) as f64;
            }
            self.gain[c] = (cross / square).clamp(1.0 - limit, 1.0 / (1.0 - limit));
        }
        Ok(())
    }

    /// Discs that no frame has shown yet start with the colour of the pixel they fall on, or the mean colour.
    fn color_the_unseen(&mut self, view: &View, carried: &mut dyn Carried, image: &Image<f32>) {
        let gain = self.gain;
        let pixels = self.pixels(view, carried);
        let mean = self.mean_color;
        let (sh, memory) = carried.colors();
        for ((sh, at), pixel) in sh.chunks_exact_mut(SH_VALUES).zip(&memory.contained_shade).zip(pixels) {
            if *at == 0.0 {
                for c in 0..3 {
                    let value = pixel.map_or(mean[c], |[x, y]| image.pixel(x, y)[c] / gain[c] as f32);
                    sh[c] = (value - 0.5) / SH_C0;
                }
            }
        }
    }

    /// Remembers the shade that the colour of each visible disc contains. Visible: not behind the rendered surface.
    /// The others take back their colours of `before`: what the image shows of them through the
    /// wall is too little to learn from, and enough to run wild on.
    fn mark_fitted(&mut self, view: &View, carried: &mut dyn Carried, image: &Image<f32>, before: &Shown) {
        let pixels = self.pixels(view, carried);
        self.light(view).shades(carried.gaussians(), &[], &mut self.shades);
        let depths = depths(view, carried.gaussians());
        let rendered = self.rasterizer.rendered();
        let width = rendered.width;
        let (sh, memory) = carried.colors();
        sh.chunks_exact_mut(SH_VALUES).for_each(bound);
        let frames = self.estimation.map_or(0.0, |estimation| *estimation.memory_frames as f32);
        for (k, ((pixel, shade), depth)) in pixels.into_iter().zip(&self.shades).zip(depths).enumerate() {
            if let Some([x, y]) = pixel
                && depth < 1.1 * rendered.depth[y * width + x] + 1.0
            {
                memory.contained_shade[k] = shade.value;
                if frames > 0.0 {
                    memory.add(k, &sh[k * SH_VALUES..][..SH_VALUES], frames);
                }
            } else {
                memory.put_back(k, &mut sh[k * SH_VALUES..][..SH_VALUES], before);
            }
        }
        let shown: Vec<usize> = (0..image.width * image.height).filter(|&i| self.observation.shows(i)).collect();
        for c in 0..3 {
            let sum: f64 = shown.iter().map(|i| image.data[3 * i + c] as f64).sum();
            self.mean_color[c] = (sum / shown.len() as f64 / self.gain[c]) as f32;
        }
    }

    /// The pixel on which each centre falls, if it holds a picture.
    fn pixels(&self, view: &View, carried: &dyn Carried) -> Vec<Option<[usize; 2]>> {
        let width = view.camera.width as usize;
        let shown = |pixel: &[usize; 2]| self.observation.shows(pixel[1] * width + pixel[0]);
        pixels(view, carried.gaussians()).into_iter().map(|pixel| pixel.filter(shown)).collect()
    }

    /// Photometric loss and its image gradient at the present placement.
    fn evaluate(&mut self, view: &View, carried: &dyn Carried, loss: &mut Photometric<f32>) -> Result<f64> {
        let settings = self.render_settings(DepthOutput::Skip);
        let rendered = self.rasterizer.render(carried.gaussians(), view, &settings, None)?;
        self.gradient.resize(rendered.color.len(), 0.0);
        Ok(loss.evaluate(&rendered.color, &mut self.gradient))
    }

    fn backward(&mut self, carried: &dyn Carried, wanted: Wanted) -> Result<()> {
        let image = ImageGradient { color: &self.gradient, ..ImageGradient::default() };
        self.rasterizer.backward(carried.gaussians(), &image, wanted).map(|_| ())
    }

    /// Groups that [`Fitter::phase_derivative`] needs.
    fn phase_groups(&self) -> Wanted {
        let carried = Wanted::POSITIONS | Wanted::SHAPES;
        if *self.settings.falloff_exponent == 0.0 { carried } else { carried | Wanted::SH }
    }
}

fn in_camera(view: &View, gaussians: &Gaussians<f32>) -> Vec<Vec3> {
    let transform = view.camera_from_world.as_affine3();
    let centres = gaussians.positions.par_iter().with_min_len(4096);
    centres.map(|p| transform.transform_point3(Vec3::from(*p))).collect()
}

fn depths(view: &View, gaussians: &Gaussians<f32>) -> Vec<f32> {
    in_camera(view, gaussians).iter().map(|p| p.z).collect()
}

/// Keeps the colours of one Gaussian within what a wall can show.
fn bound(sh: &mut [f32]) {
    let (constant, linear) = sh.split_at_mut(3);
    for (c, value) in constant.iter_mut().enumerate() {
        *value = value.max((DARKEST - 0.5) / SH_C0);
        let most = LARGEST_CHANGE * (*value * SH_C0 + 0.5) / SH_C1;
        linear.iter_mut().skip(c).step_by(3).for_each(|v| *v = v.clamp(-most, most));
    }
}

/// The pixel on which each centre falls.
pub fn pixels(view: &View, gaussians: &Gaussians<f32>) -> Vec<Option<[usize; 2]>> {
    let (width, height) = (view.camera.width as f64, view.camera.height as f64);
    in_camera(view, gaussians)
        .par_iter()
        .with_min_len(1024)
        .map(|p| {
            let pixel = view.camera.project(p.as_dvec3())?;
            let inside = p.z > 0.2 && pixel.x >= 0.0 && pixel.y >= 0.0 && pixel.x < width && pixel.y < height;
            inside.then_some([pixel.x as usize, pixel.y as usize])
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_colour_changes_with_the_direction_by_a_share_of_itself() {
        let mut sh = vec![0.0f32; SH_VALUES];
        sh[..3].copy_from_slice(&[(0.4 - 0.5) / SH_C0, (-0.2 - 0.5) / SH_C0, (0.8 - 0.5) / SH_C0]);
        sh[3..].copy_from_slice(&[5.0, 5.0, 0.1, -5.0, -5.0, -0.1, 0.01, 0.001, 0.0]);
        bound(&mut sh);
        let colors = [0, 1, 2].map(|c| sh[c] * SH_C0 + 0.5);
        for (color, expected) in colors.into_iter().zip([0.4, DARKEST, 0.8]) {
            assert!((color - expected).abs() < 1e-6, "{colors:?}");
        }
        for (i, value) in sh[3..].iter().enumerate() {
            assert!((value * SH_C1).abs() <= LARGEST_CHANGE * colors[i % 3] * 1.0001, "{sh:?}");
        }
        assert_eq!([sh[5], sh[8], sh[9]], [0.1, -0.1, 0.01], "what is small stays");
    }
}
