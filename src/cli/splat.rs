//! `respire-bench splat`: rasterises a standard 3DGS `.ply` from the cameras of a `transforms.json`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::Serialize;

use super::Terminal;
use crate::base::image::codes_from_unit;
use crate::base::{Error, Image, Result, files};
use crate::formats::gaussians_ply::{self, GaussianCloud};
use crate::formats::transforms::Transforms;
use crate::formats::{exr, npy, png};
use crate::splat::{
    DepthOutput, Gaussians, Gradients, ImageGradient, Isa, Rasterizer, Rendered, Settings, Shape, Stage, StageTimes,
    View, Wanted,
};

/// Stages of the forward pass.
const FORWARD: usize = 4;

/// Arguments of `splat`.
#[derive(Args)]
#[command(
    after_help = "Writes per frame NNNNNN.exr (R, G, B), NNNNNN.png, NNNNNN_depth.exr (Z: z-depth, 0 = nothing),\n\
    NNNNNN_alpha.exr (A) and timing.json into DIR; with --gradients also gradients.npz: d(sum of w * image)/d(means,\n\
    scales, quats, opacities, sh), summed over the frames, of the activated parameters (linear scales, unit quaternions\n\
    w x y z, opacities in [0, 1]), one row per Gaussian of the file.\n\
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
    let count = if with_backward { Stage::ALL.len() } else { FORWARD };
    let stages = (0..count).map(|k| {
        let timing = StageTiming { wall_ms: sum(|t| &t.wall_s, k..k + 1), cpu_ms: sum(|t| &t.cpu_s, k..k + 1) };
        (Stage::ALL[k].name(), timing)
    });
    let backward = FORWARD..Stage::ALL.len();
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

/// Weights of each frame, all in one array.
struct Weights {
    data: Vec<f32>,
    per_frame: usize,
}

impl Weights {
    fn read(path: &Path, [height, width]: [usize; 2], frames: usize) -> Result<Weights> {
        let array = npy::read(path)?;
        let one = [height, width, 3];
        if array.shape != one && array.shape != [frames, height, width, 3] {
            let message = format!("has shape {:?}; {one:?} is wanted, or one such image per frame", array.shape);
            return Err(Error::input(message).at(path));
        }
        Ok(Weights { data: array.data, per_frame: height * width * 3 })
    }

    fn of_frame(&self, frame: usize) -> &[f32] {
        let start = frame * self.per_frame;
        self.data.get(start..start + self.per_frame).unwrap_or(&self.data[..self.per_frame])
    }
}

/// Gradients summed over the frames, one row per Gaussian of the file (zeros for those left out).
struct Sums {
    groups: [(&'static str, Vec<f64>, Vec<usize>); 5],
}

impl Sums {
    fn new(n: usize, coefficients: usize) -> Sums {
        let group = |name, shape: &[usize]| (name, vec![0.0; shape.iter().product()], shape.to_vec());
        Sums {
            groups: [
                group("means", &[n, 3]),
                group("scales", &[n, 3]),
                group("quats", &[n, 4]),
                group("opacities", &[n]),
                group("sh", &[n, coefficients, 3]),
            ],
        }
    }

    fn add(&mut self, cloud: &GaussianCloud, gradients: &Gradients<f32>) {
        let values: [&[f32]; 5] = [
            gradients.positions.as_flattened(),
            gradients.scales.as_flattened(),
            gradients.rotations.as_flattened(),
            &gradients.opacities,
            &gradients.sh,
        ];
        for ((_, sums, shape), values) in self.groups.iter_mut().zip(values) {
            let each = shape[1..].iter().product::<usize>();
            for (row, &i) in values.chunks(each).zip(&cloud.index) {
                let place = &mut sums[i as usize * each..(i as usize + 1) * each];
                place.iter_mut().zip(row).for_each(|(sum, v)| *sum += f64::from(*v));
            }
        }
    }

    fn write(&self, path: &Path) -> Result<()> {
        let narrow: Vec<Vec<f32>> =
            self.groups.iter().map(|(_, sums, _)| sums.iter().map(|&v| v as f32).collect()).collect();
        let arrays: Vec<(&str, &[usize], &[f32])> = self
            .groups
            .iter()
            .zip(&narrow)
            .map(|((name, _, shape), data)| (*name, shape.as_slice(), data.as_slice()))
            .collect();
        npy::write_npz(path, &arrays)
    }
}

/// Runs the command.
pub fn run(arguments: Arguments, terminal: &Terminal) -> Result<()> {
    let cloud = gaussians_ply::read(&arguments.gaussians)?;
    let transforms = Transforms::read(&arguments.cameras)?;
    let camera = transforms.camera().map_err(|e| e.at(&arguments.cameras))?;
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
    };
    let settings = Settings { background, depth, ..Settings::default() };
    let mut rasterizer = Rasterizer::with_isa(arguments.isa.map_or_else(Isa::widest, Kernels::isa))?;
    rasterizer.measure_cpu();
    let mut sums = Sums::new(cloud.count_in_file, (cloud.sh_degree as usize + 1).pow(2));
    let mut frames = Vec::new();
    for (number, frame) in transforms.frames.iter().enumerate() {
        terminal.stage(format!("frame {number}"));
        let view = View::new(camera, frame.world_from_camera());
        let mut times = Vec::new();
        for _ in 0..arguments.repeat.max(1) {
            rasterizer.render(&scene, &view, &settings, None)?;
            if let Some(weights) = &weights {
                let image = ImageGradient { color: weights.of_frame(number), ..ImageGradient::default() };
                let groups = Wanted::POSITIONS | Wanted::SHAPES | Wanted::OPACITIES | Wanted::SH;
                rasterizer.backward(&scene, &image, groups)?;
            }
            times.push(rasterizer.stage_times());
        }
        if weights.is_some() {
            sums.add(&cloud, rasterizer.gradients());
        }
        write_images(&arguments.out, number, rasterizer.rendered())?;
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
