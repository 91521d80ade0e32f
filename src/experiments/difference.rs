//! Differences between images and between gradients: the errors that the experiments report.

use crate::splat::{Gradients, Real};

/// `|found - truth| / |truth|`, L2; 0 where the two are equal, infinite where a value is no number.
pub fn relative_l2(found: &[f64], truth: &[f64]) -> f64 {
    let norm = truth.iter().map(|v| v * v).sum::<f64>().sqrt();
    let difference = found.iter().zip(truth).map(|(x, y)| (x - y).powi(2)).sum::<f64>().sqrt();
    let relative = if difference == 0.0 { 0.0 } else { difference / norm };
    // A maximum over errors would pass over a NaN.
    if relative.is_nan() { f64::INFINITY } else { relative }
}

/// relMSE of an image against a noisy reference, free of the reference's noise in the numerator: the mean of
/// `(x - a)(x - b) / (r^2 + floor)`, with a and b independent halves of the reference and `r = (a + b) / 2`, whose noise
/// makes it larger where it is not far below `r`. With `a = b` the plain relMSE.
pub fn relative_mse(image: &[f32], halves: [&[f64]; 2], floor: f64) -> f64 {
    let [a, b] = halves;
    let term = |((&x, a), b): ((&f32, &f64), &f64)| {
        let x = f64::from(x);
        (x - a) * (x - b) / ((0.5 * (a + b)).powi(2) + floor)
    };
    image.iter().zip(a).zip(b).map(term).sum::<f64>() / image.len() as f64
}

/// Values in double precision.
pub fn widened<T: Real>(values: &[T]) -> Vec<f64> {
    values.iter().map(|v| v.to_f64()).collect()
}

/// The gradients of a scene and of the camera's pose, group by group with their names.
pub fn gradient_groups<T: Real>(gradients: &Gradients<T>) -> Vec<(&'static str, Vec<f64>)> {
    vec![
        ("positions", widened(gradients.positions.as_flattened())),
        ("axes", widened(gradients.axes.as_flattened().as_flattened())),
        ("opacities", widened(&gradients.opacities)),
        ("sh", widened(&gradients.sh)),
        ("rotations", widened(gradients.rotations.as_flattened())),
        ("scales", widened(gradients.scales.as_flattened())),
        ("pose", gradients.pose.to_vec()),
    ]
}
