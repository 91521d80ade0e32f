//! A line of the numerical-stability table.

use serde::Serialize;

/// One item and its outcome.
#[derive(Clone, Debug, Serialize)]
pub struct StressRow {
    /// What was tried.
    pub item: String,
    /// Relative error of the image, or of the number in question.
    pub image_error: f64,
    /// Relative error of the worst group of gradients.
    pub gradient_error: f64,
    /// That group.
    pub worst_group: &'static str,
    /// Numbers that are not finite.
    pub not_finite: usize,
    /// Whether the item came out as it must.
    pub passed: bool,
    /// Whether its errors were asked to be small (not for values that overflow in single precision).
    #[serde(skip)]
    pub accurate: bool,
}

impl StressRow {
    /// A row of one number with its true value.
    pub fn of_value(item: impl Into<String>, found: f64, truth: f64, limit: f64) -> StressRow {
        let image_error = if found == truth { 0.0 } else { (found - truth).abs() / truth.abs().max(1.0) };
        let not_finite = usize::from(!found.is_finite());
        let passed = not_finite == 0 && image_error <= limit;
        let item = item.into();
        StressRow { item, image_error, gradient_error: 0.0, worst_group: "-", not_finite, passed, accurate: true }
    }

    /// A row of something that must hold.
    pub fn of_claim(item: impl Into<String>, holds: bool) -> StressRow {
        StressRow { passed: holds, ..StressRow::of_value(item, 0.0, 0.0, 0.0) }
    }
}
