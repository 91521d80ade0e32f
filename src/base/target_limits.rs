//! How far off the targets may be, as two rooms judge it that do not know each other: a tracker while it runs, by its
//! own error bar (it says `lost`), and the score afterwards, by the true error (`lost_pct`). The limits are the same, so
//! that what a tracker says of itself can be held against what was.
//!
//! A change is a new definition of the metrics `lost_pct`, `silent_pct` and `recovered_pct`.

/// Error in mm, mean over the targets, beyond which the answer for a frame is of no use.
pub const LOST_MM: f64 = 5.0;
/// Error bar in mm, mean over the targets, beyond which an answer is unsure: half of [`LOST_MM`], so that two standard
/// deviations stay within it.
pub const UNSURE_MM: f64 = 2.5;
