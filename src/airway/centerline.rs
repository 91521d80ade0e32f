//! The centreline of a lumen: a tree of points with inscribed radii, ordered from the trachea's inlet outwards.

use glam::DVec3;

/// Longest sum of all branches in mm: a kilometre, some fifty times what CT shows.
pub(super) const MOST_LENGTH_MM: f64 = 1e6;

/// One point of the medial axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CenterlinePoint {
    /// Position in mm.
    pub position_mm: DVec3,
    /// Radius in mm of the largest sphere around the point that stays in the lumen.
    pub radius_mm: f64,
    /// Index of the branch (0 trachea).
    pub branch: u32,
    /// Generation of the branch (0 trachea).
    pub generation: u32,
    /// Index of the next point towards the inlet; `None` only for the inlet. Always smaller than the point's own index.
    pub parent: Option<u32>,
}

/// A tree of points; point 0 is the inlet of the trachea.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Centerline {
    /// Points, parents first.
    pub points: Vec<CenterlinePoint>,
}

/// The lung of one side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LungSide {
    /// The patient's right: smaller x.
    Right,
    /// The patient's left.
    Left,
}

impl Centerline {
    /// Positions in mm along the trachea, inlet first.
    pub fn trachea_mm(&self) -> impl DoubleEndedIterator<Item = DVec3> + '_ {
        self.points.iter().filter(|p| p.generation == 0).map(|p| p.position_mm)
    }

    /// Where the trachea divides, mm; none without points of generation 0.
    pub fn carina_mm(&self) -> Option<DVec3> {
        self.trachea_mm().next_back()
    }

    /// The side of the only lung, where all ends lie on one side of the middle of the trachea: without the other lung the
    /// trachea ends nowhere, and its end says nothing of sides.
    pub fn only_lung(&self) -> Option<LungSide> {
        let trachea: Vec<DVec3> = self.trachea_mm().collect();
        let middle = trachea.get(trachea.len() / 2)?.x;
        let (mut right, mut left) = (false, false);
        for leaf in self.leaves() {
            if self.points[leaf].position_mm.x < middle { right = true } else { left = true }
        }
        match (right, left) {
            (true, false) => Some(LungSide::Right),
            (false, true) => Some(LungSide::Left),
            _ => None,
        }
    }

    /// Indices of the points that none follows, in order.
    pub fn leaves(&self) -> Vec<usize> {
        let mut has_child = vec![false; self.points.len()];
        self.points.iter().filter_map(|p| p.parent).for_each(|parent| has_child[parent as usize] = true);
        (0..self.points.len()).filter(|&i| !has_child[i]).collect()
    }
}

/// How [`super::centerline_extract::extract`] works.
#[derive(Clone, Debug, PartialEq)]
pub struct CenterlineSettings {
    /// Point in mm near the inlet; by default the upper (largest z) end of the widest airway.
    pub inlet_mm: Option<DVec3>,
    /// End branches with a smaller mean radius in mm are cut back to their longest beginning that has it, or left out
    /// where that is too short to be a branch.
    pub minimal_radius_mm: f64,
    /// Distance in mm between neighbouring points.
    pub point_spacing_mm: f64,
    /// Edge length in mm of the voxels; by default 0.6 of the minimal radius. It grows where the bounding box would
    /// take more than 60 million voxels.
    pub voxel_mm: Option<f64>,
}

impl Default for CenterlineSettings {
    fn default() -> Self {
        Self { inlet_mm: None, minimal_radius_mm: 1.0, point_spacing_mm: 1.0, voxel_mm: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A trachea that runs on into the right main bronchus, as without a left lung, and one with two lungs.
    #[test]
    fn an_airway_with_one_lung_has_one_side() {
        let point = |x: f64, z: f64, generation: u32, parent: Option<u32>| CenterlinePoint {
            position_mm: DVec3::new(x, 0.0, z),
            radius_mm: 5.0,
            branch: generation,
            generation,
            parent,
        };
        let of = |ends_x: &[f64]| {
            let step = |k: u32| point(0.0, 90.0 - 10.0 * f64::from(k), 0, k.checked_sub(1));
            let run_on = [point(-8.0, -10.0, 0, Some(9)), point(-13.0, -18.0, 0, Some(10))];
            let ends = ends_x.iter().map(|&x| point(x, -60.0, 1, Some(11)));
            Centerline { points: (0..10).map(step).chain(run_on).chain(ends).collect() }
        };
        // One branch of the right lung lies left of where the trachea's points end, and right of the trachea.
        assert_eq!(of(&[-40.0, -30.0, -9.0]).only_lung(), Some(LungSide::Right));
        assert_eq!(of(&[-40.0, 30.0]).only_lung(), None);
        assert_eq!(of(&[25.0, 30.0]).only_lung(), Some(LungSide::Left));
        assert_eq!(of(&[25.0]).carina_mm(), Some(DVec3::new(-13.0, 0.0, -18.0)));
        assert_eq!(of(&[25.0, 30.0]).leaves(), [12, 13]);
        assert_eq!((Centerline::default().carina_mm(), Centerline::default().only_lung()), (None, None));
    }
}
