//! The numerical-stability table: a fixed matrix of scenes that go wrong in single precision (`scenes`), each rendered
//! and differentiated in f32 (fastest kernels) and in f64 (plain twin) (`precision`); what must be refused (`inputs`);
//! the metrics on frames, maps and contours at the edge of their definition, against closed forms (`metrics`);
//! gradients against central differences, and the seeded faults that this check must catch (`derivatives`).

mod derivatives;
mod inputs;
mod metrics;
mod precision;
mod row;
mod scenes;

pub use row::StressRow;

use crate::base::Result;
use crate::experiments::ExperimentWatcher;

/// How large the scenes get.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StressSize {
    /// With a million Gaussians, and with 4096x4096 pixels.
    Full,
    /// Without these two.
    Small,
}

/// All rows of the table.
pub fn rows(size: StressSize, watcher: &dyn ExperimentWatcher) -> Result<Vec<StressRow>> {
    let mut rows = Vec::new();
    let items = scenes::geometry().into_iter().chain(scenes::sizes(size == StressSize::Small));
    for item in items.chain(scenes::anchored()).chain(scenes::poisons()).chain(scenes::modes()) {
        watcher.proceed()?;
        watcher.stage_starts(&item.name);
        rows.push(precision::compare(&item)?);
    }
    rows.extend(inputs::refusals()?);
    rows.extend(metrics::rows()?);
    watcher.stage_starts("central differences");
    rows.extend(derivatives::rows()?);
    Ok(rows)
}

/// The table as CSV.
pub fn csv(rows: &[StressRow]) -> String {
    let mut text = "item,image_error,gradient_error,worst_group,not_finite,passed\n".to_string();
    for r in rows {
        let (image, gradient) = (r.image_error, r.gradient_error);
        text += &format!("{},{image:e},{gradient:e},{},{},{}\n", r.item, r.worst_group, r.not_finite, r.passed);
    }
    // Names of items hold commas, which no reader of the table should have to unquote.
    text.replace(", ", " ")
}

/// The table in a sentence: worst errors where accuracy is asked for, numbers that are not finite, faults caught.
pub fn summary(rows: &[StressRow]) -> String {
    let (faults, others): (Vec<&StressRow>, Vec<&StressRow>) =
        rows.iter().partition(|row| row.item.starts_with(derivatives::FAULT));
    let worst = |error: fn(&StressRow) -> f64| {
        let sound = others.iter().filter(|row| row.passed && row.accurate);
        let worst = sound.max_by(|a, b| error(a).total_cmp(&error(b)));
        worst.map_or_else(|| "none".into(), |row| format!("{:.1e} ({})", error(row), row.item))
    };
    format!(
        "{} items; worst image {}; worst gradients {}; {} numbers not finite; {} of {} seeded faults caught",
        others.len(),
        worst(|row| row.image_error),
        worst(|row| row.gradient_error),
        rows.iter().map(|row| row.not_finite).sum::<usize>(),
        faults.iter().filter(|row| row.passed).count(),
        faults.len()
    )
}
