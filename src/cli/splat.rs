//! `respire-bench splat`: rasterises a standard 3DGS `.ply` from the cameras of a `transforms.json`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::Serialize;

use super::Terminal;
use super::splat_gradients::{Sums, Weights};
use crate::base::image::codes_from_unit;
use crate::base::{Error, Image, Result, files};
use crate::formats::gaussians_ply::{self, GaussianCloud};
use crate::formats::transforms::Transforms;
use crate::formats::{exr, npy, png};
use crate::splat::{
    DepthOutput, Filter, Footprint, Gaussians, ImageGradient, Isa, PassStage, Rasterizer, Rendered, Settings, Shape,
    StageTimes, View, Wanted,
};

/// Stages of the forward pass.
const FORWARD: usize = 4;

/// Arguments of `splat`.
#[derive(Args)]
#[command(
    after_help = "Writes per frame NNNNNN.exr (R, G, B), NNNNNN.png, NNNNNN_depth.exr (Z: z-depth, 0 = nothing),\n\
    NNNNNN_alpha.exr (A) and timing.json into DIR; on request NNNNNN_normals.exr (R, G, B: x, y, z in OpenCV camera\n\
    axes), NNNNNN_contributors.exr (N), NNNNNN_channels.exr (C000, C001, ..).\n\
    With --gradients also gradients.npz: d(sum of w * image)/d(means, scales, quats, opacities, sh), summed over the\n\
    frames, of the activated parameters (linear scales, unit quaternions w x y z, opacities in [0, 1]), one row per\n\
    Gaussian of the file; pose: one row per frame, rotation vector (rad) and translation of\n\
    camera_from_world <- exp(xi) camera_from_world in OpenCV camera axes; with --lens also lens: fl_x, fl_y, cx, cy.\n\
    Example: respire-bench splat scene.ply --cameras transforms.json --out /tmp/views"
)]
pub struct Arguments {
    /// Gaussians as Inria's 3DGS writes them
    #[arg(value_name = "GAUSSIANS.ply")]
    gaussians: PathBuf,
    /// Cameras and frames in nerfstudio's layout
    #[arg(long, value_name = "transforms.json")]
    cameras: PathBuf,
    /// Folder for images and timing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Passes per frame; the timing is their median
    #[arg(long, default_value_t = 1, value_name = "N")]
    repeat: usize,
    /// Weights w of the image: (height, width, 3), or one such image per frame
    #[arg(long, value_name = "WEIGHTS.npy")]
    gradients: Option<PathBuf>,
    /// What the depth image shows
    #[arg(long, value_enum, default_value_t = Depth::Expected)]
    depth: Depth,
    /// How a Gaussian comes onto the screen
    #[arg(long, value_enum, default_value_t = Mode::Ewa)]
    mode: Mode,
    /// What the screen-space filter of 0.3 px^2 does
    #[arg(long, value_enum, default_value_t = ScreenFilter::Dilate)]
    filter: ScreenFilter,
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
    /// Kernels to use; the widest that the processor has by default
    #[arg(long, value_enum)]
    isa: Option<Kernels>,
    /// Colour behind everything
    #[arg(long, num_args = 3, value_names = ["R", "G", "B"], default_values_t = [0.0, 0.0, 0.0])]
    background: Vec<f64>,
}

#[derive(Clone, Copy, ValueEnum)]
enum Depth {
    /// Mean of the Gaussians' centres
    Expected,
    /// Mean of where the ray meets them
    Surface,
    /// Where half of the light is gone
    Median,
}

#[derive(Clone, Copy, ValueEnum)]
enum Mode {
    /// Affine projection, as 3DGS
    Ewa,
    /// Flat discs that each ray meets exactly, as 2DGS (the shortest axis is left out)
    Disc,
}

#[derive(Clone, Copy, ValueEnum)]
enum ScreenFilter {
    /// Grow and keep the opacity, as 3DGS
    Dilate,
    /// Grow and keep the weight, as Mip-Splatting
    Compensate,
}

#[derive(Clone, Copy, ValueEnum)]
enum Kernels {
    /// Plain Rust
    Scalar,
    /// Any x86-64
    Sse2,
    /// AVX2 with FMA
    Avx2,
    /// AVX-512
    Avx512,
}

impl Kernels {
    fn isa(self) -> Isa {
        match self {
            Kernels::Scalar => Isa::Scalar,
            Kernels::Sse2 => Isa::Baseline,
            Kernels::Avx2 => Isa::Avx2,
            Kernels::Avx512 => Isa::Avx512,
        }
    }
}

/// Milliseconds of one stage.
#[derive(Serialize)]
struct StageTiming {
    wall_ms: f64,
    cpu_ms: f64,
}

#[derive(Serialize)]
struct FrameTiming {
    forward_ms: f64,
    backward_ms: Option<f64>,
    forward_cpu_ms: f64,
    backward_cpu_ms: Option<f64>,
    visible: usize,
    intersections: usize,
    stages: BTreeMap<&'static str, StageTiming>,
}

#[derive(Serialize)]
struct Timing {
    frames: Vec<FrameTiming>,
    threads: usize,
    isa: String,
    gaussians: usize,
    dropped: usize,
    sh_degree: u8,
    repeat: usize,
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

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2] * 1e3
}

/// Medians over the repetitions; stages that did not run are left out.
fn frame_timing(times: &[StageTimes], with_backward: bool, image: &Rendered<f32>) -> FrameTiming {
    let sum = |of: fn(&StageTimes) -> &[f64; 6], range: std::ops::Range<usize>| {
        median(times.iter().map(|t| of(t)[range.clone()].iter().sum()).collect())
    };
    let count = if with_backward { PassStage::ALL.len() } else { FORWARD };
    let stages = (0..count).map(|k| {
        let timing = StageTiming { wall_ms: sum(|t| &t.wall_s, k..k + 1), cpu_ms: sum(|t| &t.cpu_s, k..k + 1) };
        (PassStage::ALL[k].name(), timing)
    });
    let backward = FORWARD..PassStage::ALL.len();
    FrameTiming {
        forward_ms: sum(|t| &t.wall_s, 0..FORWARD),
        backward_ms: with_backward.then(|| sum(|t| &t.wall_s, backward.clone())),
        forward_cpu_ms: sum(|t| &t.cpu_s, 0..FORWARD),
        backward_cpu_ms: with_backward.then(|| sum(|t| &t.cpu_s, backward.clone())),
        visible: image.visible_count,
        intersections: image.intersections,
        stages: stages.collect(),
    }
}

/// Features of the Gaussians that are kept.
struct Features {
    data: Vec<f32>,
    count: usize,
}

impl Features {
    fn read(path: &Path, cloud: &GaussianCloud) -> Result<Features> {
        let array = npy::read(path)?;
        let &[n, count] = array.shape.as_slice() else {
            return Err(Error::input(format!("has shape {:?}; (Gaussians, channels) is wanted", array.shape)).at(path));
        };
        if n != cloud.count_in_file || count == 0 {
            let message = format!("has shape [{n}, {count}]; the file has {} Gaussians", cloud.count_in_file);
            return Err(Error::input(message).at(path));
        }
        let of = |&i: &u32| &array.data[i as usize * count..(i as usize + 1) * count];
        Ok(Features { data: cloud.index.iter().flat_map(of).copied().collect(), count })
    }
}

/// What was asked for beyond colour, depth and alpha.
fn write_more(
    arguments: &Arguments,
    number: usize,
    scene: &Gaussians<f32>,
    view: &View,
    features: Option<&Features>,
    rasterizer: &mut Rasterizer<f32>,
) -> Result<()> {
    let (width, height) = (view.camera.width as usize, view.camera.height as usize);
    let name = |ending: &str| arguments.out.join(format!("{number:06}{ending}"));
    let image = |channels: usize, data: Vec<f32>| Image { width, height, channels, data };
    if arguments.contributors {
        let counts = rasterizer.contributors()?.into_iter().map(|count| count as f32).collect();
        exr::write_channel(&name("_contributors.exr"), "N", &image(1, counts))?;
    }
    if arguments.normals {
        let normals = rasterizer.render_channels(&scene.normals(view), 3)?.to_vec();
        exr::write_rgb(&name("_normals.exr"), &image(3, normals))?;
    }
    if let Some(features) = features {
        let found = rasterizer.render_channels(&features.data, features.count)?.to_vec();
        let names: Vec<String> = (0..features.count).map(|k| format!("C{k:03}")).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        exr::write(&name("_channels.exr"), &image(features.count, found), &names)?;
    }
    Ok(())
}

fn write_images(folder: &Path, number: usize, image: &Rendered<f32>) -> Result<()> {
    let plane = |channels: usize, data: &[f32]| Image {
        width: image.width,
        height: image.height,
        channels,
        data: data.to_vec(),
    };
    let color = plane(3, &image.color);
    let name = |ending: &str| folder.join(format!("{number:06}{ending}"));
    exr::write_rgb(&name(".exr"), &color)?;
    png::write_rgb(&name(".png"), &codes_from_unit(&color))?;
    exr::write_channel(&name("_depth.exr"), "Z", &plane(1, &image.depth))?;
    exr::write_channel(&name("_alpha.exr"), "A", &plane(1, &image.alpha))
}

/// Runs the command.
pub fn run(arguments: Arguments, terminal: &Terminal) -> Result<()> {
    let cloud = gaussians_ply::read(&arguments.gaussians)?;
    let transforms = Transforms::read(&arguments.cameras)?;
    let camera = transforms.camera().map_err(|e| e.at(&arguments.cameras))?;
    if transforms.frames.is_empty() {
        return Err(Error::input("there is none").element("frames").at(&arguments.cameras));
    }
    let size = [camera.height as usize, camera.width as usize];
    let weights =
        arguments.gradients.as_deref().map(|p| Weights::read(p, size, transforms.frames.len())).transpose()?;
    let dropped = cloud.count_in_file - cloud.len();
    if dropped > 0 {
        terminal.line(format!("{dropped} of {} Gaussians are not finite and left out", cloud.count_in_file));
    }
    if cloud.degree_in_file > cloud.sh_degree {
        terminal.line(format!("SH of degree {} are shown up to degree {}", cloud.degree_in_file, cloud.sh_degree));
    }
    let scene = scene_of(&cloud);
    let background = [arguments.background[0], arguments.background[1], arguments.background[2]];
    let depth = match arguments.depth {
        Depth::Expected => DepthOutput::Expected,
        Depth::Surface => DepthOutput::Surface,
        Depth::Median => DepthOutput::Median,
    };
    let footprint = match arguments.mode {
        Mode::Ewa => Footprint::Ewa,
        Mode::Disc => Footprint::Disc,
    };
    let filter = match arguments.filter {
        ScreenFilter::Dilate => Filter::Dilate,
        ScreenFilter::Compensate => Filter::Compensate,
    };
    let settings = Settings { background, depth, footprint, filter, ..Settings::default() };
    let features = arguments.channels.as_deref().map(|path| Features::read(path, &cloud)).transpose()?;
    let mut rasterizer = Rasterizer::with_isa(arguments.isa.map_or_else(Isa::widest, Kernels::isa))?;
    rasterizer.measure_cpu();
    let of_gaussians = Wanted::POSITIONS | Wanted::SHAPES | Wanted::OPACITIES | Wanted::SH;
    let wanted = of_gaussians | Wanted::POSE | if arguments.lens { Wanted::LENS } else { Wanted::NONE };
    let coefficients = (cloud.sh_degree as usize + 1).pow(2);
    let mut sums = Sums::new(cloud.count_in_file, coefficients, transforms.frames.len(), wanted);
    let mut frames = Vec::new();
    for (number, frame) in transforms.frames.iter().enumerate() {
        terminal.stage(format!("frame {number}"));
        let view = View::new(camera, frame.world_from_camera());
        let mut times = Vec::new();
        for _ in 0..arguments.repeat.max(1) {
            let named = |e: Error| e.element(format!("frame {number}")).at(&arguments.cameras);
            rasterizer.render(&scene, &view, &settings, None).map_err(named)?;
            if let Some(weights) = &weights {
                let image = ImageGradient { color: weights.of_frame(number), ..ImageGradient::default() };
                rasterizer.backward(&scene, &image, wanted)?;
            }
            times.push(rasterizer.stage_times());
        }
        if weights.is_some() {
            sums.add(&cloud, number, rasterizer.gradients());
        }
        write_images(&arguments.out, number, rasterizer.rendered())?;
        write_more(&arguments, number, &scene, &view, features.as_ref(), &mut rasterizer)?;
        frames.push(frame_timing(&times, weights.is_some(), rasterizer.rendered()));
    }
    if weights.is_some() {
        sums.write(&arguments.out.join("gradients.npz"))?;
    }
    let count = frames.len();
    let timing = Timing {
        frames,
        threads: rayon::current_num_threads(),
        isa: rasterizer.isa().to_string(),
        gaussians: cloud.len(),
        dropped,
        sh_degree: cloud.sh_degree,
        repeat: arguments.repeat.max(1),
    };
    files::write_json(&arguments.out.join("timing.json"), &timing)?;
    terminal.line(format!("{}: {count} frames of {} Gaussians", arguments.out.display(), cloud.len()));
    Ok(())
}
