//! Means, correlation and bootstrap intervals. Sums run in the order of the input, in f64, so that the
//! same numbers give the same bits on any number of threads.

use crate::base::random::{CounterRng, Stage};
use crate::base::statistics::quantile;

/// Seed of the interval of a mean over cases: fixed, so that the same scores give the same bounds.
const CASES_SEED: u64 = 1;
/// Resamples of a bootstrap: enough for two digits of a 95 % bound.
const RESAMPLES: usize = 2000;

/// A mean with its spread and its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeanInterval {
    /// Mean.
    pub mean: f64,
    /// Sample standard deviation; `None` for one value.
    pub deviation: Option<f64>,
    /// How many values.
    pub count: usize,
    /// Bounds of the 95 % interval; `None` for one value.
    pub interval: Option<[f64; 2]>,
}

/// Mean of a non-empty slice.
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Sample standard deviation (n - 1) of two values or more.
pub fn deviation(values: &[f64]) -> Option<f64> {
    let centre = mean(values)?;
    let squares: f64 = values.iter().map(|v| (v - centre) * (v - centre)).sum();
    (values.len() > 1).then(|| (squares / (values.len() - 1) as f64).sqrt())
}

/// Pearson's correlation; `None` when one side has no variance, or for fewer than two pairs.
pub fn pearson(a: &[f64], b: &[f64]) -> Option<f64> {
    let (centre_a, centre_b) = (mean(a)?, mean(b)?);
    let (mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0);
    for (x, y) in a.iter().zip(b) {
        aa += (x - centre_a) * (x - centre_a);
        bb += (y - centre_b) * (y - centre_b);
        ab += (x - centre_a) * (y - centre_b);
    }
    // A spread below 1e-9 of a breath is rounding, not motion.
    let least = 1e-18 * a.len() as f64;
    (a.len() > 1 && aa > least && bb > least).then(|| (ab / (aa.sqrt() * bb.sqrt())).clamp(-1.0, 1.0))
}

/// Mean of independent `values` (one per case) with the percentile bootstrap interval (Efron 1979).
pub fn bootstrap(values: &[f64], seed: u64) -> Option<MeanInterval> {
    blocks(values, 1, seed)
}

/// Mean of one value per case, each with the tree of its case, with the interval of `bootstrap_groups`: what all
/// reports say of several cases.
pub fn mean_over_cases<'a>(of_cases: impl IntoIterator<Item = (f64, &'a str)>) -> Option<MeanInterval> {
    let (values, trees): (Vec<f64>, Vec<&str>) = of_cases.into_iter().unzip();
    bootstrap_groups(&values, &trees, CASES_SEED)
}

/// Fewest trees of which a difference is called clear: even if all six agree, a sign test's chance is 2/64. Of two cases an
/// interval is their two values, and holds 0 half as often as not where nothing differs.
pub const FEWEST_TREES: usize = 6;

/// Mean of `values` (one per case) with a percentile interval that draws groups first, then as many values of each as it
/// has (Davison and Hinkley 1997, section 3.8): values of one group are alike, so that more of them say little more.
/// Where every value has a group of its own this is [`bootstrap`], but for the numbers drawn. `groups` has one per value.
fn bootstrap_groups(values: &[f64], groups: &[&str], seed: u64) -> Option<MeanInterval> {
    let centre = mean(values)?;
    let mut names: Vec<&str> = groups.to_vec();
    names.sort_unstable();
    names.dedup();
    let members = |name: &&str| -> Vec<f64> {
        values.iter().zip(groups).filter(|(_, group)| *group == name).map(|(value, _)| *value).collect()
    };
    let members: Vec<Vec<f64>> = names.iter().map(members).collect();
    let resampled = |resample: usize| {
        let mut random = CounterRng::new(seed, Stage::Score, &[2, resample as u64]);
        let mut drawn = Vec::new();
        for _ in 0..members.len() {
            let group = &members[random.index(members.len())];
            (0..group.len()).for_each(|_| drawn.push(group[random.index(group.len())]));
        }
        mean(&drawn)
    };
    let mut interval = None;
    if values.len() > 1 {
        let means: Vec<f64> = (0..RESAMPLES).filter_map(resampled).collect();
        interval = quantile(&means, 0.025).zip(quantile(&means, 0.975)).map(|(low, high)| [low, high]);
    }
    Some(MeanInterval { mean: centre, deviation: deviation(values), count: values.len(), interval })
}

/// Mean of a time series (one value per frame, in order) with an interval that respects that neighbours are alike:
/// circular block bootstrap (Politis and Romano 1992) with blocks of the cube root of the length, rounded up.
pub fn bootstrap_series(values: &[f64], seed: u64) -> Option<MeanInterval> {
    blocks(values, (values.len() as f64).cbrt().ceil() as usize, seed)
}

fn blocks(values: &[f64], length: usize, seed: u64) -> Option<MeanInterval> {
    let centre = mean(values)?;
    let count = values.len();
    let mut interval = None;
    if count > 1 {
        let means: Vec<f64> = (0..RESAMPLES).map(|r| resampled_mean(values, length, seed, r as u64)).collect();
        interval = quantile(&means, 0.025).zip(quantile(&means, 0.975)).map(|(low, high)| [low, high]);
    }
    Some(MeanInterval { mean: centre, deviation: deviation(values), count, interval })
}

fn resampled_mean(values: &[f64], length: usize, seed: u64, resample: u64) -> f64 {
    let mut random = CounterRng::new(seed, Stage::Score, &[1, resample]);
    let count = values.len();
    let (mut sum, mut taken) = (0.0, 0);
    while taken < count {
        let start = random.index(count);
        for step in 0..length.min(count - taken) {
            sum += values[(start + step) % count];
            taken += 1;
        }
    }
    sum / count as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deviation_equals_a_tabulated_value() {
        let values = [3.0, 1.0, 4.0, 1.0, 5.0, 9.0, 2.0, 6.0];
        // numpy.std(values, ddof=1)
        assert!((deviation(&values).unwrap() - 2.748_376_143_938_713).abs() < 1e-12);
    }

    #[test]
    fn correlation_of_lines_and_of_constants() {
        let a = [0.0, 0.1, 0.5, 0.9];
        let b: Vec<f64> = a.iter().map(|v| 3.0 - 2.0 * v).collect();
        assert!((pearson(&a, &b).unwrap() + 1.0).abs() < 1e-12);
        assert_eq!(pearson(&a, &[0.3; 4]), None);
        assert_eq!(pearson(&[1.0], &[1.0]), None);
    }

    /// Nominal 95 % intervals of means of 30 normal numbers hold the true mean in roughly that share of trials.
    #[test]
    fn intervals_cover_the_true_mean() {
        let trials = 300;
        let mut covered = 0;
        for trial in 0..trials {
            let mut random = CounterRng::new(trial, Stage::Test, &[7]);
            let values: Vec<f64> = (0..30).map(|_| 5.0 + random.normal()).collect();
            let [low, high] = bootstrap(&values, 1).unwrap().interval.unwrap();
            covered += usize::from(low <= 5.0 && 5.0 <= high);
        }
        let share = covered as f64 / trials as f64;
        assert!((0.90..=0.98).contains(&share), "{share}");
    }

    /// Nine cases of seven trees, as the bench has them, with trees that differ twice as much as cases of one tree.
    #[test]
    fn groups_are_drawn_before_their_values() {
        let groups = ["a", "b", "c", "d", "b", "c", "e", "f", "g"];
        let (trials, mut covered, mut covered_by_cases) = (300, 0, 0);
        for trial in 0..trials {
            let mut random = CounterRng::new(trial, Stage::Test, &[8]);
            let trees: Vec<f64> = (0..3).map(|_| 2.0 * random.normal()).collect();
            // Three trees with ten cases each: what cases alone would call thirty draws.
            let values: Vec<f64> = (0..30).map(|k| trees[k / 10] + random.normal()).collect();
            let names: Vec<&str> = (0..30).map(|k| groups[k / 10]).collect();
            let holds = |m: Option<MeanInterval>| m.and_then(|m| m.interval).is_some_and(|[l, h]| l <= 0.0 && 0.0 <= h);
            covered += usize::from(holds(bootstrap_groups(&values, &names, 1)));
            covered_by_cases += usize::from(holds(bootstrap(&values, 1)));
        }
        assert!(covered > covered_by_cases + 60, "{covered} and {covered_by_cases} of {trials}");

        let values = [1.0, 4.0, 2.0, 8.0, 5.0, 3.0, 9.0, 0.0, 6.0];
        let found = bootstrap_groups(&values, &groups, 1).unwrap();
        assert_eq!((found.count, found.mean), (9, mean(&values).unwrap()));
        let [low, high] = found.interval.unwrap();
        assert!(low < found.mean && found.mean < high && low >= 0.0 && high <= 9.0);
        // A tree of its own for each case: as many draws as cases, and nearly the same interval.
        let own: Vec<String> = (0..9).map(|k| k.to_string()).collect();
        let own: Vec<&str> = own.iter().map(String::as_str).collect();
        let (alone, plain) = (bootstrap_groups(&values, &own, 1).unwrap(), bootstrap(&values, 1).unwrap());
        let ends = alone.interval.unwrap().into_iter().zip(plain.interval.unwrap());
        assert!(ends.into_iter().all(|(a, b)| (a - b).abs() < 0.35));
        assert_eq!(bootstrap_groups(&[2.0], &["a"], 1).unwrap().interval, None);
    }

    /// 400 values spread evenly over 0 to 1, of variance 1 / 12: by the central limit theorem the interval reaches 1.96
    /// standard errors to either side, be the values cases of their own or all of one group.
    #[test]
    fn intervals_are_as_wide_as_the_normal_law_has_them() {
        let values: Vec<f64> = (0..400).map(|i| (f64::from(i) * 0.618_033_988_749_895).fract()).collect();
        let expected = 2.0 * 1.96 / (12.0f64 * 400.0).sqrt();
        for found in [bootstrap(&values, 1), bootstrap_groups(&values, &["tree"; 400], 1)] {
            let [low, high] = found.unwrap().interval.unwrap();
            assert!(((high - low) / expected - 1.0).abs() < 0.06, "{} for {expected}", high - low);
        }
    }

    /// Blocks go on at the first frame, so that every frame is drawn as often. Of 64 frames, in blocks of four, each is in
    /// one of sixteen blocks with the probability 1 / 16: it is drawn at most 0 times in 36 % and at most 3 times in 98.5 %
    /// of the resamples, at most twice in 92.6 %.
    #[test]
    fn the_last_frame_weighs_as_much_as_any_other() {
        for place in [0, 31, 63] {
            let values: Vec<f64> = (0..64).map(|frame| if frame == place { 1.0 } else { 0.0 }).collect();
            assert_eq!(bootstrap_series(&values, 1).unwrap().interval, Some([0.0, 3.0 / 64.0]), "frame {place}");
        }
    }

    #[test]
    fn blocks_widen_the_interval_of_a_slow_series() {
        let values: Vec<f64> = (0..100).map(|i| (i as f64 * 0.06).sin()).collect();
        let width = |m: MeanInterval| m.interval.map(|[low, high]| high - low).unwrap();
        let (independent, series) = (bootstrap(&values, 3).unwrap(), bootstrap_series(&values, 3).unwrap());
        assert!(width(series) > 1.5 * width(independent));
        assert_eq!(bootstrap(&[2.0], 1).unwrap().interval, None);
    }
}
