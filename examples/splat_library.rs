//! The splat core as a library: three Gaussian discs before a camera, their image, and the gradient of its mean.
//! `cargo run --release --no-default-features --example splat_library`. `scripts/check-library.sh` builds this file in a
//! crate of its own, on a path where Embree, OpenCV and clang are not to be found.

use glam::DAffine3;
use respire_bench::base::{Camera, Result};
use respire_bench::splat::{Gaussians, ImageGradient, Rasterizer, Settings, Shape, View, Wanted};

fn main() -> Result<()> {
    // Lengths in mm; the camera looks along +z, x is right, y is down.
    let discs = Gaussians::<f32> {
        positions: vec![[0.0, 0.0, 10.0], [1.0, 0.5, 12.0], [-1.5, 0.0, 14.0]],
        shape: Shape::Discs { axes: vec![[[2.0, 0.0, 0.0], [0.0, 1.0, 0.0]]; 3] },
        opacities: vec![0.9, 0.8, 0.7],
        // One coefficient per channel: colour = 0.282 * sh + 0.5.
        sh: vec![1.2, -0.5, -0.8, -0.8, 0.9, -0.3, 0.1, 0.2, 1.0],
        sh_degree: 0,
    };
    let view = View::new(Camera::pinhole(128, 96, 60f64.to_radians()), DAffine3::IDENTITY);
    let mut rasterizer = Rasterizer::new();
    let image = rasterizer.render(&discs, &view, &Settings::default(), None)?;
    let (pixels, mean) = (image.alpha.len(), image.color.iter().sum::<f32>() / image.color.len() as f32);
    println!("{} of 3 discs visible, mean colour {mean:.4}", image.visible_count);

    let weights = vec![1.0 / (3 * pixels) as f32; 3 * pixels];
    let loss = ImageGradient { color: &weights, ..ImageGradient::default() };
    let gradients = rasterizer.backward(&discs, &loss, Wanted::POSITIONS | Wanted::OPACITIES)?;
    println!("d(mean)/d(position) {:?}", gradients.positions);
    println!("d(mean)/d(opacity) {:?}", gradients.opacities);
    Ok(())
}
