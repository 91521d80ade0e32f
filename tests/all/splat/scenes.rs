//! Scenes, losses and measures of the splat tests.

use std::io::Read;
use std::path::Path;

use glam::{DAffine3, DVec3};
use respire_bench::base::Camera;
use respire_bench::base::camera::world_from_camera_looking;
use respire_bench::base::random::{CounterRng, Stage};
use respire_bench::splat::{Gaussians, ImageGradient, Rendered, Shape, SplatKernels, View};

use crate::skip::shared;

pub fn rng(keys: &[u64]) -> CounterRng {
    CounterRng::new(4711, Stage::Test, keys)
}

/// Which spread a random scene has.
#[derive(Clone, Copy, PartialEq)]
pub enum Kind {
    Ellipsoids,
    Discs,
}

/// Which lens.
#[derive(Clone, Copy, PartialEq)]
pub enum Lens {
    Pinhole,
    Fisheye,
}

fn vector(r: &mut CounterRng, scale: f64) -> [f64; 3] {
    [0, 1, 2].map(|_| scale * r.normal())
}

/// `n` Gaussians before the camera of [`view`], some half outside the image, some in one another's way.
pub fn random(n: usize, kind: Kind, sh_degree: u8, seed: u64) -> Gaussians<f64> {
    let r = &mut rng(&[1, seed]);
    let world = world_from_camera();
    let positions = (0..n)
        .map(|_| {
            let z = r.range(2.0, 9.0);
            let local = DVec3::new(z * r.range(-1.3, 1.3), z * r.range(-1.0, 1.0), z);
            world.transform_point3(local).to_array()
        })
        .collect();
    let shape = match kind {
        Kind::Ellipsoids => Shape::Ellipsoids {
            rotations: (0..n).map(|_| [0, 1, 2, 3].map(|_| r.normal())).collect(),
            scales: (0..n).map(|_| [r.range(0.05, 0.9), r.range(0.05, 0.9), r.range(0.01, 0.3)]).collect(),
        },
        Kind::Discs => Shape::Discs { axes: (0..n).map(|_| [vector(r, 0.4), vector(r, 0.4)]).collect() },
    };
    let coefficients = n * (sh_degree as usize + 1).pow(2) * 3;
    Gaussians {
        positions,
        shape,
        opacities: (0..n).map(|_| r.range(0.05, 1.0)).collect(),
        sh: (0..coefficients).map(|_| 0.3 * r.normal()).collect(),
        sh_degree,
    }
}

pub fn world_from_camera() -> DAffine3 {
    world_from_camera_looking(DVec3::new(3.0, -2.0, 5.0), DVec3::new(0.4, 0.3, 1.0), DVec3::new(0.1, -1.0, 0.0))
}

/// 43x29 pixels: no side is a multiple of a tile.
pub fn view(lens: Lens) -> View {
    let mut camera = Camera::pinhole(43, 29, 80f64.to_radians());
    camera.cx += 0.7;
    camera.cy -= 0.4;
    if lens == Lens::Fisheye {
        camera.fisheye = Some([0.05, -0.02, 0.01, -0.003]);
    }
    View::new(camera, world_from_camera())
}

/// Fixed weights of a loss that is linear in the three images.
pub struct Weights<T> {
    pub color: Vec<T>,
    pub depth: Vec<T>,
    pub alpha: Vec<T>,
}

impl<T: SplatKernels> Weights<T> {
    pub fn new(pixels: usize, seed: u64) -> Self {
        let r = &mut rng(&[2, seed]);
        let mut plane = |n: usize| (0..n).map(|_| T::of((r.normal() as f32) as f64)).collect();
        Weights { color: plane(3 * pixels), depth: plane(pixels), alpha: plane(pixels) }
    }

    pub fn gradient(&self) -> ImageGradient<'_, T> {
        ImageGradient { color: &self.color, depth: &self.depth, alpha: &self.alpha, ..ImageGradient::default() }
    }

    pub fn loss(&self, image: &Rendered<T>) -> f64 {
        let sum = |a: &[T], b: &[T]| a.iter().zip(b).map(|(x, y)| x.to_f64() * y.to_f64()).sum::<f64>();
        sum(&self.color, &image.color) + sum(&self.depth, &image.depth) + sum(&self.alpha, &image.alpha)
    }
}

/// `|a - b| / |b|` (L2 over all values).
pub fn relative(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let difference: f64 = a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum();
    let norm: f64 = b.iter().map(|y| y * y).sum();
    assert!(norm > 0.0, "nothing to compare with");
    (difference / norm).sqrt()
}

pub fn flat<T: SplatKernels, const N: usize>(values: &[[T; N]]) -> Vec<f64> {
    values.iter().flatten().map(|v| v.to_f64()).collect()
}

pub fn wide<T: SplatKernels>(values: &[T]) -> Vec<f64> {
    values.iter().map(|v| v.to_f64()).collect()
}

/// The array `name` of a `.npz`, as the file that it is.
pub fn member(npz: &Path, name: &str) -> Vec<u8> {
    let mut archive = zip::ZipArchive::new(std::fs::File::open(npz).unwrap()).unwrap();
    let mut bytes = Vec::new();
    archive.by_name(&format!("{name}.npy")).unwrap().read_to_end(&mut bytes).unwrap();
    bytes
}

/// The values of the array `name` of a `.npz`, as they lie in it.
fn bytes(npz: &Path, name: &str) -> Vec<u8> {
    let file = member(npz, name);
    npyz::NpyFile::new(&file[..]).unwrap().into_inner().to_vec()
}

fn half(bits: u16) -> f32 {
    let sign = if bits >> 15 == 1 { -1.0 } else { 1.0 };
    let (exponent, mantissa) = ((bits >> 10) & 31, (bits & 1023) as f32);
    sign * if exponent == 0 {
        mantissa * 2f32.powi(-24)
    } else {
        (1.0 + mantissa / 1024.0) * 2f32.powi(exponent as i32 - 15)
    }
}

/// The tube of `../shared/reference/splat` with its camera; `None` when it is absent, which is said.
pub fn tube(name: &str, width: u32) -> Option<(Gaussians<f32>, View)> {
    let path = shared(&format!("reference/splat/{name}"))?;
    let f32s = |b: Vec<u8>| b.chunks_exact(4).map(|c| f32::from_le_bytes(c.try_into().unwrap())).collect::<Vec<_>>();
    let f16s = |b: Vec<u8>| b.chunks_exact(2).map(|c| half(u16::from_le_bytes([c[0], c[1]]))).collect::<Vec<_>>();
    let means = f32s(bytes(&path, "means"));
    let scales = f16s(bytes(&path, "scales_f16"));
    let quats = f16s(bytes(&path, "quats_f16"));
    let dc = f16s(bytes(&path, "sh_dc_f16"));
    let sh1: Vec<f32> = bytes(&path, "sh1_i8").iter().map(|&b| b as i8 as f32 / 256.0).collect();
    let n = means.len() / 3;
    let gaussians = Gaussians {
        positions: means.as_chunks::<3>().0.to_vec(),
        shape: Shape::Ellipsoids {
            rotations: quats.as_chunks::<4>().0.to_vec(),
            scales: scales.as_chunks::<3>().0.to_vec(),
        },
        opacities: vec![0.95; n],
        sh: (0..n).flat_map(|i| [&dc[3 * i..3 * i + 3], &sh1[9 * i..9 * i + 9]].concat()).collect(),
        sh_degree: 1,
    };
    let forward = DVec3::new(12f64.to_radians().sin(), 6f64.to_radians().sin(), 1.0);
    let world = world_from_camera_looking(DVec3::new(1.0, -0.5, 10.0), forward, DVec3::NEG_Y);
    Some((gaussians, View::new(Camera::pinhole(width, width, 90f64.to_radians()), world)))
}
