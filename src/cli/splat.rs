//! `respire-bench splat`: rasterises a standard 3DGS `.ply` from the cameras of a `transforms.json`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::Terminal;
use super::splat_gradients::{GradientSums, Weights};
use super::splat_output::{Features, FrameTiming, GRADIENTS, SplatOutput, SplatTiming};
use crate::base::range::{LIGHT, NumberRange, REPETITIONS};
use crate::base::{Error, Progress, Result, files};
use crate::formats::gaussians_ply::{self, GaussianCloud};
use crate::formats::prediction;
use crate::formats::transforms::{Transforms, TransformsFrame};
use crate::splat::{
    DepthOutput, Filter, Footprint, GaussianSlices, Gaussians, ImageGradient, Isa, Rasterizer, Settings, Shape, View,
    Wanted,
};

/// Arguments of `splat`.
#[derive(Args)]
#[command(
    after_help = "Writes per frame NNNNNN.exr (R, G, B), NNNNNN.png, NNNNNN_depth.exr (Y: z-depth, 0 = nothing),\n\
    NNNNNN_alpha.exr (A) and timing.json into DIR; on request NNNNNN_normals.exr (R, G, B: x, y, z in OpenCV camera\n\
    axes), NNNNNN_contributors.exr (N), NNNNNN_channels.exr (C000, C001, ..).\n\
    With --gradients also gradients.npz: d(sum of w * image)/d(means, scales, quats, opacities, sh), summed over the\n\
    frames, of the activated parameters (linear scales, unit quaternions w x y z, opacities in [0, 1]), one row per\n\
    Gaussian of the file; pose: one row per frame, rotation vector (rad) and translation of\n\
    camera_from_world <- exp(xi) camera_from_world in OpenCV camera axes; with --lens also lens: fl_x, fl_y, cx, cy.\n\
    Example: respire-bench splat scene.ply --cameras transforms.json --out /tmp/views"
)]
pub struct SplatArguments {
    /// Gaussians as Inria's 3DGS writes them
    #[arg(value_name = "GAUSSIANS.ply")]
    gaussians: PathBuf,
    /// Cameras and frames in nerfstudio's layout; frames may have intrinsics of their own
    #[arg(long, value_name = "transforms.json")]
    cameras: PathBuf,
    /// Folder for images and timing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Least z-depth of a Gaussian's centre that is shown, in the scene's unit. A scene in metres or scaled to the unit
    /// cube needs a smaller one
    #[arg(long, default_value_t = Settings::default().near_mm, value_name = "N", value_parser = NEAR.parser::<f64>())]
    near: f64,
    /// Passes per frame; the timing is their median
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = REPETITIONS.parser::<usize>())]
    repeat: usize,
    /// Weights w of the image: (height, width, 3), or one such image per frame
    #[arg(long, value_name = "WEIGHTS.npy")]
    gradients: Option<PathBuf>,
    /// What the depth image shows
    #[arg(long, value_enum, default_value_t = DepthChoice::Expected)]
    depth: DepthChoice,
    /// How a Gaussian comes onto the screen
    #[arg(long, value_enum, default_value_t = FootprintChoice::Ewa)]
    mode: FootprintChoice,
    /// What the screen-space filter of 0.3 px^2 does
    #[arg(long, value_enum, default_value_t = FilterChoice::Dilate)]
    filter: FilterChoice,
    /// Write the normals too (shortest axes, weighted like the image, not divided by alpha)
    #[arg(long)]
    normals: bool,
    /// Write how many Gaussians each pixel blends
    #[arg(long)]
    contributors: bool,
    /// Features to composite too: (Gaussians of the file, channels)
    #[arg(long, value_name = "FEATURES.npy")]
    channels: Option<PathBuf>,
    /// With --gradients: those of the focal lengths and the principal point too
    #[arg(long, requires = "gradients")]
    lens: bool,
    /// Instruction set of the kernels; the widest that the processor has by default
    #[arg(long, value_enum)]
    isa: Option<KernelChoice>,
    /// Colour behind everything
    #[arg(long, num_args = 3, value_names = ["R", "G", "B"], default_values_t = [0.0, 0.0, 0.0],
        value_parser = LIGHT.parser::<f64>())]
    background: Vec<f64>,
}

/// Near planes of scenes in any unit.
const NEAR: NumberRange = NumberRange::new(1e-9, 1e9);

#[derive(Clone, Copy, ValueEnum)]
enum DepthChoice {
    /// Mean of the Gaussians' centres; of flat discs, of where the ray meets them
    Expected,
    /// Mean of where the ray meets them
    Surface,
    /// Where half of the light is gone
    Median,
}

#[derive(Clone, Copy, ValueEnum)]
enum FootprintChoice {
    /// Affine projection, as 3DGS
    Ewa,
    /// Flat discs that each ray meets exactly, as 2DGS (the shortest axis is left out)
    Disc,
}

#[derive(Clone, Copy, ValueEnum)]
enum FilterChoice {
    /// Grow and keep the opacity, as 3DGS
    Dilate,
    /// Grow and keep the weight, as Mip-Splatting
    Compensate,
}

#[derive(Clone, Copy, ValueEnum)]
enum KernelChoice {
    /// Plain Rust
    Scalar,
    /// Any x86-64
    Sse2,
    /// AVX2 with FMA
    Avx2,
    /// AVX-512
    Avx512,
}

impl KernelChoice {
    fn isa(self) -> Isa {
        match self {
            KernelChoice::Scalar => Isa::Scalar,
            KernelChoice::Sse2 => Isa::Baseline,
            KernelChoice::Avx2 => Isa::Avx2,
            KernelChoice::Avx512 => Isa::Avx512,
        }
    }
}

fn scene_of(cloud: &GaussianCloud) -> Gaussians<f32> {
    Gaussians {
        positions: cloud.positions.clone(),
        shape: Shape::Ellipsoids { rotations: cloud.rotations.clone(), scales: cloud.scales.clone() },
        opacities: cloud.opacities.clone(),
        sh: cloud.sh.clone(),
        sh_degree: cloud.sh_degree,
    }
}

impl SplatArguments {
    fn settings(&self) -> Settings {
        Settings {
            background: [self.background[0], self.background[1], self.background[2]],
            depth: match self.depth {
                DepthChoice::Expected => DepthOutput::Expected,
                DepthChoice::Surface => DepthOutput::Surface,
                DepthChoice::Median => DepthOutput::Median,
            },
            footprint: if self.is_disc() { Footprint::Disc } else { Footprint::Ewa },
            filter: match self.filter {
                FilterChoice::Dilate => Filter::Dilate,
                FilterChoice::Compensate => Filter::Compensate,
            },
            near_mm: self.near,
            ..Settings::default()
        }
    }

    /// The views of all frames, each with its own intrinsics, and the number of the first of the largest. Errors name the
    /// frame that cannot be rasterised as asked for.
    fn views(&self) -> Result<(Vec<View>, usize)> {
        let transforms = Transforms::read(&self.cameras)?;
        let view = |(number, frame): (usize, &TransformsFrame)| {
            Ok(View::new(transforms.frame_camera(number)?, frame.world_from_camera()))
        };
        let views: Result<Vec<View>> = transforms.frames.iter().enumerate().map(view).collect();
        let views = views.map_err(|e| e.at(&self.cameras))?;
        let pixels = |view: &View| u64::from(view.camera.width) * u64::from(view.camera.height);
        let Some((largest, _)) = views.iter().enumerate().rev().max_by_key(|(_, view)| pixels(view)) else {
            return Err(Error::input("there is none").element("frames").at(&self.cameras));
        };
        let is_fisheye = |view: &View| view.camera.fisheye.is_some();
        match views.iter().position(|view| self.lens && self.is_disc() && is_fisheye(view)) {
            Some(frame) => {
                Err(self.of_frame(frame, Error::input("is a fisheye, whose --lens has no gradient with --mode disc")))
            }
            None => Ok((views, largest)),
        }
    }

    /// The weights of --gradients, for images of one `size`.
    fn weights(&self, views: &[View], size: [usize; 2]) -> Result<Option<Weights>> {
        let Some(path) = &self.gradients else { return Ok(None) };
        let weights = Weights::read(path, size, views.len())?;
        match views.iter().position(|view| size_of(view) != size) {
            Some(frame) => {
                let sentence = "has another size than other frames: --gradients wants images of one size";
                Err(self.of_frame(frame, Error::input(sentence)))
            }
            None => Ok(Some(weights)),
        }
    }

    /// What is wrong with a frame of the cameras' file.
    fn of_frame(&self, number: usize, error: Error) -> Error {
        error.element(format!("frame {number}")).at(&self.cameras)
    }

    fn is_disc(&self) -> bool {
        matches!(self.mode, FootprintChoice::Disc)
    }

    fn wanted(&self) -> Wanted {
        let of_gaussians = Wanted::POSITIONS | Wanted::SHAPES | Wanted::OPACITIES | Wanted::SH;
        of_gaussians | Wanted::POSE | if self.lens { Wanted::LENS } else { Wanted::NONE }
    }
}

/// Rasterises every frame; writes images, timing and gradients.
pub fn run(arguments: SplatArguments, terminal: &Terminal) -> Result<()> {
    let cloud = gaussians_ply::read(&arguments.gaussians)?;
    let (views, largest) = arguments.views()?;
    let count = views.len();
    let size = size_of(&views[largest]);
    let weights = arguments.weights(&views, size)?;
    say_what_is_not_shown(&cloud, terminal);
    let (scene, settings, wanted) = (scene_of(&cloud), arguments.settings(), arguments.wanted());
    let output = SplatOutput {
        folder: arguments.out.clone(),
        normals: arguments.normals,
        contributors: arguments.contributors,
        features: arguments.channels.as_deref().map(|path| Features::read(path, &cloud)).transpose()?,
    };
    prediction::refuse_timing_in(&output.folder)?;
    output.check_replaceable()?;
    let mut rasterizer = Rasterizer::with_isa(arguments.isa.map_or_else(Isa::widest, KernelChoice::isa))?;
    rasterizer.measure_cpu();
    let repeat = arguments.repeat;
    let pass = rasterizer.estimate(&scene, &views[largest], &settings, weights.is_some());
    let pass = pass.map_err(|e| arguments.of_frame(largest, e))?;
    terminal.accepts(&output.with_files(pass, size, count, repeat))?;
    output.remove_earlier()?;
    let coefficients = (cloud.sh_degree as usize + 1).pow(2);
    let mut sums = GradientSums::new(cloud.count_in_file, coefficients, count, wanted);
    let mut frames = Vec::new();
    terminal.stage("rasterising");
    // A step is a pass, and the files of a frame are one more.
    let mut steps = 0..count * (repeat + 1);
    let advance = |steps: &mut std::ops::Range<usize>| {
        terminal.advance(steps.start, steps.end);
        steps.next();
        terminal.proceed()
    };
    for (number, view) in views.iter().enumerate() {
        let mut times = Vec::new();
        for _ in 0..repeat {
            advance(&mut steps)?;
            let named = |e: Error| arguments.of_frame(number, e);
            rasterizer.render(&scene, view, &settings, None).map_err(named)?;
            if let Some(weights) = &weights {
                let image = ImageGradient { color: weights.of_frame(number), ..ImageGradient::default() };
                rasterizer.backward(&scene, &image, wanted).map_err(named)?;
            }
            times.push(rasterizer.stage_times());
        }
        if weights.is_some() {
            sums.add(&cloud, number, rasterizer.gradients());
        }
        frames.push(FrameTiming::new(&times, weights.is_some(), rasterizer.rendered()));
        advance(&mut steps)?;
        output.write(number, &scene, view, &mut rasterizer)?;
    }
    terminal.finish();
    if weights.is_some() {
        sums.write(&output.folder.join(GRADIENTS))?;
    }
    let empty: Vec<usize> = (0..count).filter(|&number| frames[number].visible == 0).collect();
    let timing = SplatTiming {
        frames,
        threads: rayon::current_num_threads(),
        isa: rasterizer.isa().to_string(),
        gaussians: cloud.len(),
        dropped: dropped(&cloud),
        sh_degree: cloud.sh_degree,
        repeat,
    };
    files::write_json(&output.folder.join("timing.json"), &timing)?;
    terminal.line(format!("{}: {count} frames of {} Gaussians", output.folder.display(), cloud.len()));
    if let Some(&number) = empty.first() {
        let why = match cloud.len() {
            0 if cloud.count_in_file == 0 => format!("{} holds none", arguments.gaussians.display()),
            0 => format!("all of {} are left out", arguments.gaussians.display()),
            _ => emptiness(&scene, &views[number], &settings, number),
        };
        terminal.note(&format!("no Gaussian is visible in {} of {count} frames: {why}", empty.len()));
    }
    Ok(())
}

/// Height and width in px.
fn size_of(view: &View) -> [usize; 2] {
    [view.camera.height as usize, view.camera.width as usize]
}

/// Gaussians of the file that cannot be shown.
fn dropped(cloud: &GaussianCloud) -> usize {
    cloud.count_in_file - cloud.len()
}

fn say_what_is_not_shown(cloud: &GaussianCloud, terminal: &Terminal) {
    let (dropped, count) = (dropped(cloud), cloud.count_in_file);
    if dropped > 0 {
        terminal.line(format!("{dropped} of {count} Gaussians are not finite, or have no rotation: they are left out"));
    }
    if cloud.degree_in_file > cloud.sh_degree {
        terminal.line(format!("SH of degree {} are shown up to degree {}", cloud.degree_in_file, cloud.sh_degree));
    }
}

/// Why nothing is to be seen in frame `number`, the first of those.
fn emptiness(scene: &Gaussians<f32>, view: &View, settings: &Settings, number: usize) -> String {
    let [before, beyond] = GaussianSlices::from(scene).before_camera(view, settings.near_mm);
    let advice = match (before, beyond) {
        (0, _) => "all lie behind the camera: are its axes OpenGL's (x right, y up, z backwards)?",
        (_, 0) => "give a smaller --near, which is in the scene's unit",
        _ => "these lie beside the image, or are transparent",
    };
    format!(
        "in frame {number}, {before} of {} centres lie before the camera and {beyond} of them beyond --near {}; \
         {advice}",
        scene.len(),
        settings.near_mm
    )
}
