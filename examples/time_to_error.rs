//! Time against error on the reference scenes (`../shared/reference/pathtrace`), and the time of a refit.
//!
//! ```text
//! cargo run --release --example time_to_error [SCENE,.. [TRANSPORT,.. [SPP,..]]]
//! ```
//! Per scene (M1, M2, M3c: six scatterings; M1-unlimited, M2-unlimited, M3: as many as there are; M3-32: 32 in the
//! wall; all 256 x 256), transport (paths, vertices, gather; `gather+denoise` with the filter) and number of samples:
//! relMSE (mean of `(x - r)^2 / (r^2 + 1e-4)`), ratio of the image means less 1 per channel, median relative
//! difference of 16 x 16 blocks, CPU seconds of a first rendering over two (what two quiet cores would take), rays and
//! paths per core-second. M3c's reference is as noisy as what is measured: there the error is the product of the
//! differences from it and from paths of another seed. Then the least of a hundred refits of 99,840 triangles.

use std::f64::consts::PI;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};
use respire_bench::base::camera::world_from_camera_looking;
use respire_bench::base::{Camera, Error, Image, Result, TriangleMesh};
use respire_bench::experiments::{difference::relative_mse, timing};
use respire_bench::formats::{mesh, npy};
use respire_bench::render::{
    Boundary, Denoise, Light, Material, RenderSettings, RenderedFrame, Scene, Transport, WalkedVertices, render,
};

/// Albedo of the reference scenes' walls, per channel.
const RHO: [f64; 3] = [0.75, 0.40, 0.35];
/// Samples per pixel of the second reference of M3c.
const SECOND_REFERENCE_SPP: u32 = 96;

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let scenes = arguments.next().unwrap_or("M1,M2,M3c".into());
    let transports = arguments.next().unwrap_or("paths,vertices,gather".into());
    let samples = arguments.next().unwrap_or("1,4,16".into());
    let tube = mesh::read(&folder().join("tube.ply"))?;
    for name in scenes.split(',').filter(|s| !s.is_empty()) {
        let stage = Stage::of(name, &tube)?;
        for transport in transports.split(',') {
            for spp in samples.split(',') {
                let spp = spp.parse().map_err(|_| Error::usage(format!("`{spp}` is no number of samples")))?;
                stage.measure(transport, spp)?;
            }
        }
    }
    refit(&tube)
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/reference/pathtrace")
}

struct Stage<'a> {
    name: String,
    tube: &'a TriangleMesh,
    material: Material,
    /// 0: unlimited.
    max_scatterings: u32,
    /// Two independent images where one is too noisy (M3c), otherwise one image twice.
    references: [Image<f32>; 2],
}

impl Stage<'_> {
    fn of<'a>(name: &str, tube: &'a TriangleMesh) -> Result<Stage<'a>> {
        let medium = Material {
            single_scattering_albedo: Some([0.9855396, 0.8529496, 0.8111069]),
            ..Material::subsurface(RHO, [1.0, 0.4, 0.25], Boundary::Mixed, WalkedVertices::First)
        };
        let (lambert, coated) = (Material::lambert(RHO), Material::coated(RHO, 0.15, 1.4));
        let matched = Material { boundary: Boundary::Matched, walk: WalkedVertices::Every, ..medium };
        let (material, max_scatterings, file) = match name {
            "M1" => (lambert, 6, "best_M1_n6.npy"),
            "M1-unlimited" => (lambert, 0, "mitsuba_M1_unl.npy"),
            "M2" => (coated, 6, "best_M2_n6.npy"),
            "M2-unlimited" => (coated, 0, "mitsuba_M2_unl.npy"),
            "M3" => (matched, 0, "minipt_M3_unl.npy"),
            "M3-32" => (matched, 32, "mitsuba_M3_n32.npy"),
            "M3c" => (medium, 6, "minipt_M3c_n6.npy"),
            _ => {
                return Err(Error::usage(format!(
                    "`{name}` is no scene: M1, M2, M3, M3-32, M3c, M1-unlimited or M2-unlimited"
                )));
            }
        };
        let array = npy::read(&folder().join("refs").join(file))?;
        let first = Image { width: array.shape[1], height: array.shape[0], channels: 3, data: array.data };
        let mut stage =
            Stage { name: name.into(), tube, material, max_scatterings, references: [first.clone(), first] };
        if name == "M3c" {
            stage.references[1] = stage.picture(Transport::Paths, SECOND_REFERENCE_SPP, 4711, Denoise::Off)?.0.radiance;
        }
        Ok(stage)
    }

    /// A first rendering and its CPU seconds.
    fn picture(
        &self,
        transport: Transport,
        samples_per_pixel: u32,
        seed: u64,
        denoise: Denoise,
    ) -> Result<(RenderedFrame, f64)> {
        let scene = Scene::new(self.tube, &[], self.material, 1)?;
        let origin = DVec3::new(0.4, -0.3, 0.0);
        let pose: DAffine3 = world_from_camera_looking(origin, DVec3::new(3.0, 0.6, 40.0) - origin, DVec3::Y);
        let camera = Camera::pinhole(256, 256, PI / 2.0);
        let settings = RenderSettings {
            max_scatterings: self.max_scatterings,
            samples_per_pixel,
            transport,
            seed,
            denoise,
            ..RenderSettings::default()
        };
        let light = Light::at_camera([400.0; 3]);
        let (frame, cost) = timing::measure(|| render(&scene, &camera, &pose, &light, &settings));
        Ok((frame?, cost.cpu_s))
    }

    fn measure(&self, transport: &str, spp: u32) -> Result<()> {
        let (name, denoise) = match transport.strip_suffix("+denoise") {
            Some(name) => (name, Denoise::On),
            None => (transport, Denoise::Off),
        };
        let kind = match name {
            "paths" => Transport::Paths,
            "vertices" => Transport::VERTICES,
            "gather" => Transport::GATHER,
            _ => return Err(Error::usage(format!("`{transport}` is none of paths, vertices, gather"))),
        };
        let (frame, cpu) = self.picture(kind, spp, 5, denoise)?;
        let image = &frame.radiance;
        let [a, b] = self.references.each_ref().map(|r| r.data.iter().map(|&v| f64::from(v)).collect::<Vec<f64>>());
        let truth: Vec<f64> = a.iter().zip(&b).map(|(a, b)| 0.5 * (a + b)).collect();
        let error = relative_mse(&image.data, [&a, &b], 1e-4);
        let sum = |values: &mut dyn Iterator<Item = f64>, c: usize| values.skip(c).step_by(3).sum::<f64>();
        let bias: [f64; 3] = std::array::from_fn(|c| {
            let found = sum(&mut image.data.iter().map(|&v| f64::from(v)), c);
            100.0 * (found / sum(&mut truth.iter().copied(), c) - 1.0)
        });
        println!(
            "{} {transport} {spp} spp: relMSE {error:.5}, mean {:+.2} {:+.2} {:+.2} %, blocks {:.2} %, {:.3} s, {:.1} rays \
             per path, {:.3} M paths per core-second",
            self.name,
            bias[0],
            bias[1],
            bias[2],
            100.0 * block_median(image, &truth),
            0.5 * cpu,
            frame.statistics.rays as f64 / frame.statistics.paths as f64,
            1e-6 * frame.statistics.paths as f64 / cpu,
        );
        Ok(())
    }
}

fn block_median(image: &Image<f32>, truth: &[f64]) -> f64 {
    const SIDE: usize = 16;
    let block = |x: usize, y: usize, c: usize, value: &dyn Fn(usize) -> f64| -> f64 {
        (0..SIDE * SIDE).map(|k| value(((y + k / SIDE) * image.width + x + k % SIDE) * 3 + c)).sum()
    };
    let mut errors = Vec::new();
    for y in (0..image.height).step_by(SIDE) {
        for x in (0..image.width).step_by(SIDE) {
            for c in 0..3 {
                let found = block(x, y, c, &|k| f64::from(image.data[k]));
                errors.push((found / block(x, y, c, &|k| truth[k]) - 1.0).abs());
            }
        }
    }
    errors.sort_by(f64::total_cmp);
    errors[errors.len() / 2]
}

/// Two tubes side by side.
fn refit(tube: &TriangleMesh) -> Result<()> {
    let mut both = tube.clone();
    both.vertices.extend(tube.vertices.iter().map(|&v| v + DVec3::new(40.0, 0.0, 0.0)));
    let count = tube.vertices.len() as u32;
    both.faces.extend(tube.faces.iter().map(|f| f.map(|v| v + count)));
    let mut scene = Scene::new(&both, &[], Material::lambert(RHO), 1)?;
    let (seconds, cost) = timing::measure(|| (0..100).map(|_| scene.refit_seconds()).collect::<Result<Vec<f64>>>());
    let (wall, cpu) = (timing::Spread::of(&seconds?).least_s, cost.cpu_s / 100.0);
    println!(
        "refit of {} triangles: {:.3} ms at best, {:.3} ms of CPU on the mean",
        both.faces.len(),
        1e3 * wall,
        1e3 * cpu
    );
    Ok(())
}
