//! The nearest of many points.

use std::num::NonZeroUsize;

use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};

use crate::base::{Error, Result};

/// Points of a set, ready to be asked for the nearest.
pub struct NearestPoints {
    tree: ImmutableKdTree<f64, 3>,
}

impl NearestPoints {
    /// Sorts the points, of which there must be one at least.
    pub fn new(points: &[DVec3]) -> Result<Self> {
        let keys: Vec<[f64; 3]> = points.iter().map(|v| v.to_array()).collect();
        let tree = ImmutableKdTree::new_from_slice(&keys)
            .map_err(|e| Error::input(format!("its points cannot be searched: {e:?}")))?;
        Ok(NearestPoints { tree })
    }

    /// The nearest point and its distance in mm.
    pub fn nearest(&self, place: DVec3) -> (usize, f64) {
        self.several(place, 1).first().copied().unwrap_or((0, f64::INFINITY))
    }

    /// The `count` nearest points and their distances in mm, nearest first.
    pub fn several(&self, place: DVec3, count: usize) -> Vec<(usize, f64)> {
        let Some(count) = NonZeroUsize::new(count) else { return Vec::new() };
        let found = self.tree.query(&place.to_array()).nearest_n::<SquaredEuclidean<f64>>(count).execute();
        let mut found: Vec<(usize, f64)> = found.iter().map(|n| (n.item as usize, n.distance.sqrt())).collect();
        // Of equally near ones the first: the order of the search must not tell.
        found.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::random::{CounterRng, Stage};

    /// Distances are those of going through all points, to the last bit.
    #[test]
    fn distances_are_those_of_brute_force() {
        let mut rng = CounterRng::new(3, Stage::Test, &[21]);
        let mut place = || 40.0 * DVec3::new(rng.uniform(), rng.uniform(), rng.uniform());
        let points: Vec<DVec3> = (0..2000).map(|_| place()).collect();
        let tree = NearestPoints::new(&points).unwrap();
        for at in (0..500).map(|_| place()) {
            let least = points.iter().map(|p| p.distance_squared(at)).fold(f64::INFINITY, f64::min).sqrt();
            let (index, distance) = tree.nearest(at);
            assert_eq!((distance, points[index].distance_squared(at).sqrt()), (least, least));
        }
    }
}
