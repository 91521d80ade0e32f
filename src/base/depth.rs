//! Z-depth in mm as predictions and films hold it, with 0 for none.

use super::range::PREDICTED_DEPTH_MM;
use super::{Error, Image, Result};

/// A depth that is there: finite and above 0.
pub fn present(depth_mm: f32) -> Option<f64> {
    (depth_mm.is_finite() && depth_mm > 0.0).then_some(f64::from(depth_mm))
}

/// Refuses depths in mm that no prediction may have; what is not [`present`] is none. The element is the pixel.
pub fn check_predicted_depth(depth_mm: &Image<f32>) -> Result<()> {
    let is_beyond = |depth: &f32| present(*depth).is_some_and(|depth| !PREDICTED_DEPTH_MM.contains(depth));
    let Some(at) = depth_mm.data.iter().position(is_beyond) else { return Ok(()) };
    let sentence = format!("{:e} must lie in {PREDICTED_DEPTH_MM}; 0 where there is no depth", depth_mm.data[at]);
    Err(Error::input(sentence).element(format!("pixel ({}, {})", at % depth_mm.width, at / depth_mm.width)))
}
