//! Nearest neighbours with a fixed order: by distance, ties by index.

use std::num::NonZero;

use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;

/// For each query the `count` nearest of `points` (fewer when there are fewer): (index, distance), nearest first.
pub fn nearest(points: &[DVec3], queries: &[DVec3], count: usize) -> Vec<Vec<(u32, f64)>> {
    let count = count.min(points.len());
    let (Some(wanted), Ok(tree)) = (
        NonZero::new(count),
        ImmutableKdTree::<f64, 3>::new_from_slice(&points.iter().map(|p| p.to_array()).collect::<Vec<_>>()),
    ) else {
        return vec![Vec::new(); queries.len()];
    };
    queries
        .par_iter()
        .with_min_len(256)
        .map(|q| {
            let found = tree.query(&q.to_array()).nearest_n::<SquaredEuclidean<f64>>(wanted).execute();
            let mut list: Vec<(u32, f64)> = found.into_iter().map(|r| (r.item, r.distance.sqrt())).collect();
            list.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
            list
        })
        .collect()
}

/// Root mean square distance of each point to its three nearest others, at least 1e-4 mm: the initial spread of
/// Gaussians in 3DGS and its successors.
pub fn spacing(points: &[DVec3]) -> Vec<f64> {
    nearest(points, points, 4)
        .iter()
        .map(|list| {
            let others = &list[1.min(list.len())..];
            let sum: f64 = others.iter().map(|(_, d)| d * d).sum();
            (sum / others.len().max(1) as f64).sqrt().max(1e-4)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{CounterRng, Stage};

    #[test]
    fn equals_brute_force() {
        let mut rng = CounterRng::new(1, Stage::Test, &[7]);
        let points: Vec<DVec3> = (0..300).map(|_| DVec3::new(rng.uniform(), rng.uniform(), rng.uniform())).collect();
        for (q, list) in points.iter().zip(nearest(&points, &points, 5)) {
            let mut all: Vec<(u32, f64)> =
                points.iter().map(|p| p.distance(*q)).enumerate().map(|(i, d)| (i as u32, d)).collect();
            all.sort_by(|a, b| a.1.total_cmp(&b.1));
            assert_eq!(list.iter().map(|l| l.0).collect::<Vec<_>>(), all[..5].iter().map(|l| l.0).collect::<Vec<_>>());
        }
        assert!(nearest(&[], &points, 3).iter().all(|l| l.is_empty()));
    }
}
