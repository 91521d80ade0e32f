//! The metrics at the limits of their definitions: frames without contrast, identical frames, depth that is absent
//! or true nowhere, phases that do not move, contours that miss the camera. Each against its closed form in double.

use glam::{DAffine3, DVec3};

use super::row::StressRow;
use crate::base::{Image, Result, TriangleMesh};
use crate::reconstruct::loss::photometric::Photometric;
use crate::score::contour::target_errors;
use crate::score::depth::depth_errors;
use crate::score::image_quality::{Psnr, psnr, psnr_ceiling, ssim};
use crate::score::statistics::{bootstrap_series, pearson};

/// Size of the test frames in pixels, and the largest error that passes.
const WIDTH: usize = 32;
const HEIGHT: usize = 24;
const LIMIT: f64 = 1e-6;

fn frame(code: u8) -> Image<u8> {
    Image { width: WIDTH, height: HEIGHT, channels: 3, data: vec![code; WIDTH * HEIGHT * 3] }
}

/// All rows.
pub(super) fn rows() -> Result<Vec<StressRow>> {
    let mut rows = Vec::new();
    for (a, b) in [(0, 0), (255, 255), (0, 255), (128, 128), (1, 0), (254, 255)] {
        rows.extend(constant_frames(a, b)?);
    }
    rows.extend(tiny_frames()?);
    rows.extend(depths());
    rows.extend(phases());
    rows.extend(contours()?);
    Ok(rows)
}

/// SSIM `(2ab + C1) / (a^2 + b^2 + C1)`, PSNR `-20 log10 |a - b|`, and the loss of the methods with its gradient.
fn constant_frames(a: u8, b: u8) -> Result<Vec<StressRow>> {
    let (x, y) = (f64::from(a) / 255.0, f64::from(b) / 255.0);
    let similar = (2.0 * x * y + 1e-4) / (x * x + y * y + 1e-4);
    let found = ssim(&frame(a), &frame(b))?.valid.unwrap_or(f64::NAN);
    let mut rows = vec![StressRow::of_value(format!("SSIM of constant frames {a} and {b}"), found, similar, LIMIT)];
    let decibel = match psnr(&frame(a), &frame(b)) {
        Psnr::Decibel(value) => value,
        Psnr::Identical => psnr_ceiling(WIDTH * HEIGHT * 3),
    };
    let truth = if a == b { psnr_ceiling(WIDTH * HEIGHT * 3) } else { -20.0 * (x - y).abs().log10() };
    rows.push(StressRow::of_value(format!("PSNR of constant frames {a} and {b}"), decibel, truth, LIMIT));
    rows.push(loss_row(format!("L1 and SSIM loss of constant frames {a} and {b}"), x, y));
    Ok(rows)
}

/// The loss of two constant frames and its gradient, vectorised in single precision against the plain code in double.
fn loss_row(item: String, x: f64, y: f64) -> StressRow {
    let values = WIDTH * HEIGHT * 3;
    let target = vec![y as f32; values];
    let rendered = vec![x as f32; values];
    let mut gradient = vec![0.0f32; values];
    let mut single = Photometric::new(&target, WIDTH, HEIGHT, 0.2, None);
    let loss = single.evaluate(&rendered, &mut gradient);
    let (wide_target, wide_rendered) = (vec![y; values], vec![x; values]);
    let mut wide_gradient = vec![0.0f64; values];
    let mut double = Photometric::new(&wide_target, WIDTH, HEIGHT, 0.2, None);
    let truth = double.evaluate(&wide_rendered, &mut wide_gradient);
    // Where the images are equal the gradient is 0 but for rounding: the error is measured in a hundredth of the
    // gradient of a mean absolute difference at least.
    let square = wide_gradient.iter().map(|v| v * v).sum::<f64>().max(1e-4 / values as f64);
    let difference: f64 = gradient.iter().zip(&wide_gradient).map(|(g, w)| (f64::from(*g) - w).powi(2)).sum();
    let gradient_error = if difference == 0.0 { 0.0 } else { (difference / square).sqrt() };
    let row = StressRow::of_value(item, loss, truth, 1e-4);
    let not_finite = row.not_finite + gradient.iter().filter(|v| !v.is_finite()).count();
    let passed = row.passed && not_finite == 0 && gradient_error <= 2e-2;
    StressRow { gradient_error, worst_group: "image", not_finite, passed, ..row }
}

/// Frames smaller than the window of SSIM.
fn tiny_frames() -> Result<Vec<StressRow>> {
    let tiny = |code: u8| Image { width: 1, height: 1, channels: 3, data: vec![code; 3] };
    let found = ssim(&tiny(7), &tiny(9))?;
    let mut rows = vec![StressRow::of_claim("SSIM of 1x1 pixel has no valid window", found.valid.is_none())];
    rows.push(StressRow {
        not_finite: usize::from(!found.padded.is_finite()),
        ..StressRow::of_claim("SSIM of 1x1 pixel, padded", found.padded.is_finite())
    });
    Ok(rows)
}

fn depths() -> Vec<StressRow> {
    let map = |value: f32| Image { width: WIDTH, height: HEIGHT, channels: 1, data: vec![value; WIDTH * HEIGHT] };
    let mut rows =
        vec![StressRow::of_claim("depth without truth has no error", depth_errors(&map(5.0), &map(0.0)).is_none())];
    for poison in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, -3.0] {
        let found = depth_errors(&map(poison), &map(10.0));
        let (rmse, right) = found.map_or((f64::NAN, f64::NAN), |f| (f.rmse_mm, f.delta_1_25));
        rows.push(StressRow::of_value(format!("depth RMSE of a map of {poison}"), rmse, 10.0, LIMIT));
        rows.push(StressRow::of_value(format!("depth delta of a map of {poison}"), right, 0.0, LIMIT));
    }
    let found = depth_errors(&map(1e-40), &map(1e-40));
    rows.push(StressRow::of_value(
        "depth delta of denormal maps",
        found.map_or(f64::NAN, |f| f.delta_1_25),
        1.0,
        LIMIT,
    ));
    let found = depth_errors(&map(3e38), &map(1e-3));
    rows.push(StressRow::of_value(
        "depth RMSE of a map of 3e38",
        found.map_or(f64::NAN, |f| f.rmse_mm) / 3e38,
        f64::from(3e38f32) / 3e38,
        LIMIT,
    ));
    rows
}

/// Phases at exactly 0 and 1, and series that do not move.
fn phases() -> Vec<StressRow> {
    let series: Vec<f64> = (0..40).map(|k| f64::from(k % 2)).collect();
    let opposite: Vec<f64> = series.iter().map(|p| 1.0 - p).collect();
    let correlation = |a: &[f64], b: &[f64]| pearson(a, b).unwrap_or(f64::NAN);
    let interval = bootstrap_series(&[1.0; 40], 1).and_then(|m| m.interval).unwrap_or([f64::NAN; 2]);
    vec![
        StressRow::of_value("correlation of phases 0 and 1 with themselves", correlation(&series, &series), 1.0, LIMIT),
        StressRow::of_value(
            "correlation of phases 0 and 1 with their opposite",
            correlation(&series, &opposite),
            -1.0,
            LIMIT,
        ),
        StressRow::of_claim("a phase that stays at 0 has no correlation", pearson(&[0.0; 40], &series).is_none()),
        StressRow::of_claim("a phase that stays at 1 has no correlation", pearson(&[1.0; 40], &series).is_none()),
        StressRow::of_value("interval of a constant series", interval[1] - interval[0], 0.0, LIMIT),
    ]
}

/// A tube of `radius` mm along z around the camera, moved by `shift`.
fn tube(radius: f64, shift: DVec3) -> TriangleMesh {
    let (around, along) = (48u32, 8u32);
    let vertices = (0..=along).flat_map(|j| {
        (0..around).map(move |i| {
            let angle = std::f64::consts::TAU * f64::from(i) / f64::from(around);
            DVec3::new(radius * angle.cos(), radius * angle.sin(), f64::from(j) * 2.0 - 7.9) + shift
        })
    });
    let faces = (0..along).flat_map(|j| {
        (0..around).flat_map(move |i| {
            let (a, b) = (j * around + i, j * around + (i + 1) % around);
            [[a, b, a + around], [b, b + around, a + around]]
        })
    });
    TriangleMesh { vertices: vertices.collect(), faces: faces.collect() }
}

fn contours() -> Result<Vec<StressRow>> {
    let eye = DAffine3::IDENTITY;
    let truth = tube(5.0, DVec3::ZERO);
    let mut rows = Vec::new();
    let errors = |predicted: &TriangleMesh| target_errors(&truth, predicted, None, &eye, 1);
    for (name, shift) in [("itself", 0.0), ("the same, 1 mm aside", 1.0)] {
        let found = errors(&tube(5.0, DVec3::X * shift))?.and_then(|e| e.mean_mm).unwrap_or(f64::NAN);
        rows.push(StressRow::of_value(format!("target error of a tube against {name}"), found, shift, LIMIT));
    }
    let away = errors(&tube(5.0, DVec3::Z * 500.0))?;
    rows.push(StressRow::of_claim(
        "a surface that misses the camera's plane has no contour",
        away.is_some_and(|e| e.contour_rmse_mm.is_none()),
    ));
    let missing = target_errors(&tube(5.0, DVec3::X * 50.0), &truth, None, &eye, 1)?;
    rows.push(StressRow::of_claim("a camera outside the true surface has no target", missing.is_none()));
    let mut flat = truth.clone();
    flat.vertices.iter_mut().for_each(|v| v.x = 0.0);
    let found = errors(&flat)?.and_then(|e| e.mean_mm);
    rows.push(StressRow::of_claim("a surface pressed flat has finite errors", found.is_some_and(f64::is_finite)));
    Ok(rows)
}
