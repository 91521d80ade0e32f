//! Medians and quantiles. Recorded results depend on which of two middle values a median takes, so each convention has
//! a function of its own name.

/// Numbers with an order in which NaN has a place, too.
pub trait TotalOrder: Copy {
    /// As `f64::total_cmp`.
    fn order(&self, other: &Self) -> std::cmp::Ordering;
}

impl TotalOrder for f32 {
    fn order(&self, other: &Self) -> std::cmp::Ordering {
        self.total_cmp(other)
    }
}

impl TotalOrder for f64 {
    fn order(&self, other: &Self) -> std::cmp::Ordering {
        self.total_cmp(other)
    }
}

/// The middle value, of an even number the upper one of the two; `None` without values.
pub fn upper_median<T: TotalOrder>(values: impl IntoIterator<Item = T>) -> Option<T> {
    let mut values: Vec<T> = values.into_iter().collect();
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, T::order).1)
}

/// The middle value, of an even number the mean of the two; `None` without values.
pub fn mean_median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = values.into_iter().collect();
    sorted.sort_by(f64::total_cmp);
    let upper = *sorted.get(sorted.len() / 2)?;
    Some(if sorted.len().is_multiple_of(2) { 0.5 * (sorted[sorted.len() / 2 - 1] + upper) } else { upper })
}

/// The `share` quantile (0 to 1), linear between ranks (type 7 of Hyndman and Fan, NumPy's default).
pub fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().checked_sub(1)?;
    let rank = share.clamp(0.0, 1.0) * last as f64;
    let low = rank.floor() as usize;
    let high = (low + 1).min(last);
    Some(sorted[low] + (sorted[high] - sorted[low]) * (rank - low as f64))
}

/// Standard deviation of normal numbers over their median absolute deviation: one over the normal distribution's
/// quantile of 3/4.
pub const DEVIATION_OF_MEDIAN: f32 = 1.4826;

/// The standard deviation that normal numbers of these absolute deviations have, by their upper median; `None` without
/// any.
pub fn robust_deviation(absolute_deviations: impl IntoIterator<Item = f32>) -> Option<f32> {
    upper_median(absolute_deviations).map(|median| DEVIATION_OF_MEDIAN * median)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_differ_by_which_of_two_middle_values_they_take() {
        assert_eq!((upper_median([4.0, 1.0, 3.0, 2.0]), mean_median([4.0, 1.0, 3.0, 2.0])), (Some(3.0), Some(2.5)));
        assert_eq!((upper_median([3.0, 1.0, 2.0f32]), mean_median([3.0, 1.0, 2.0])), (Some(2.0), Some(2.0)));
        assert_eq!((upper_median::<f32>([]), mean_median([]), robust_deviation([])), (None, None, None));
        assert_eq!(robust_deviation([1.0, 0.0, 2.0]), Some(1.4826));
    }

    #[test]
    fn quantiles_equal_tabulated_values() {
        let values = [3.0, 1.0, 4.0, 1.0, 5.0, 9.0, 2.0, 6.0];
        // numpy.quantile(values, [.25, .5, .95])
        assert_eq!(quantile(&values, 0.25), Some(1.75));
        assert_eq!(quantile(&values, 0.5), Some(3.5));
        assert!((quantile(&values, 0.95).unwrap() - 7.95).abs() < 1e-12);
        assert_eq!(quantile(&[], 0.5), None);
    }
}
