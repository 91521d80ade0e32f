//! Points that navigation is after: the tips of peripheral branches, and tissue a centimetre beside them. Planned on the
//! inspiration CT and carried by the true motion.

use glam::DVec3;

use super::Anatomy;
use super::case::Breathing;
use super::target::Target;

/// Branch tips, spread over the lungs; each has a companion in the tissue beside it.
const TIPS: usize = 5;
/// Distance of the tissue targets from their tip, mm.
const BESIDE_MM: f64 = 10.0;
/// A tissue target that lies nearer to a wall than this, or in an airway, is moved further out, mm.
const CLEAR_MM: f64 = 2.0;
/// How far out it may be, and in which steps, mm.
const FARTHEST_MM: f64 = 60.0;
const STEP_MM: f64 = 2.0;
/// Directions around the branch among which the one that leads away from the airways is taken.
const DIRECTIONS: usize = 16;

/// The targets of a case: tips first, then the tissue beside each. Fewer than ten where the tree has fewer tips.
pub fn targets(anatomy: &Anatomy, breathing: Option<&Breathing>) -> Vec<Target> {
    let points = &anatomy.centerline.points;
    let mut has_child = vec![false; points.len()];
    points.iter().filter_map(|p| p.parent).for_each(|parent| has_child[parent as usize] = true);
    let leaves: Vec<usize> = (1..points.len()).filter(|&i| !has_child[i]).collect();
    let tips = spread(&leaves, |i| points[i].position_mm, points[0].position_mm);
    let tip =
        |&i: &usize| Target { inspiration_mm: points[i].position_mm, expiration_mm: anatomy.centerline_expiration[i] };
    let beside = |&i: &usize| {
        let place = beside_tip(anatomy, i);
        // Where only the wall's motion is known, the tissue next to a tip moves with it.
        let motion = match breathing {
            Some(breathing) => breathing.field.displacement(place),
            None => anatomy.centerline_expiration[i] - points[i].position_mm,
        };
        Target { inspiration_mm: place, expiration_mm: place + motion }
    };
    tips.iter().map(tip).chain(tips.iter().map(beside)).collect()
}

/// The leaf farthest from the inlet, then again and again the one farthest from those taken.
fn spread(leaves: &[usize], place: impl Fn(usize) -> DVec3, inlet: DVec3) -> Vec<usize> {
    let mut taken: Vec<usize> = Vec::new();
    let mut distance: Vec<f64> = leaves.iter().map(|&i| place(i).distance(inlet)).collect();
    while taken.len() < TIPS.min(leaves.len()) {
        let farthest = (0..leaves.len()).fold(0, |best, k| if distance[k] > distance[best] { k } else { best });
        let next = leaves[farthest];
        for (d, &i) in distance.iter_mut().zip(leaves) {
            let to_next = place(i).distance(place(next));
            *d = if taken.is_empty() { to_next } else { d.min(to_next) };
        }
        taken.push(next);
    }
    taken
}

/// A place in the tissue across the branch that ends at point `tip`: in the direction that leads farthest from all airways,
/// and as far out as wide ones need.
fn beside_tip(anatomy: &Anatomy, tip: usize) -> DVec3 {
    let points = &anatomy.centerline.points;
    let here = points[tip].position_mm;
    let before = points[tip].parent.map_or(here, |parent| points[parent as usize].position_mm);
    let along = (here - before).try_normalize().unwrap_or(DVec3::NEG_Z);
    let (across, other) = along.any_orthonormal_pair();
    let directions: [DVec3; DIRECTIONS] = std::array::from_fn(|k| {
        let (sine, cosine) = (std::f64::consts::TAU * k as f64 / DIRECTIONS as f64).sin_cos();
        across * cosine + other * sine
    });
    let farthest = |distance_mm: f64, room: &dyn Fn(DVec3) -> f64| {
        let places = directions.map(|direction| here + distance_mm * direction);
        places.into_iter().fold(places[0], |best, next| if room(next) > room(best) { next } else { best })
    };
    let from_points =
        |place: DVec3| points.iter().map(|p| p.position_mm.distance_squared(place)).fold(f64::INFINITY, f64::min);
    let from_walls =
        |place: DVec3| points.iter().map(|p| p.position_mm.distance(place) - p.radius_mm).fold(f64::INFINITY, f64::min);
    let mut place = farthest(BESIDE_MM, &from_points);
    let mut distance_mm = BESIDE_MM;
    while from_walls(place) < CLEAR_MM && distance_mm < FARTHEST_MM {
        place = farthest(distance_mm, &from_walls);
        distance_mm += STEP_MM;
    }
    place
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::airway::centerline::{Centerline, CenterlinePoint};
    use crate::airway::field::BreathingField;
    use crate::base::TriangleMesh;

    #[test]
    fn tips_are_spread_and_tissue_lies_beside_them_away_from_the_airways() {
        let point = |x: f64, y: f64, z: f64, parent| CenterlinePoint {
            position_mm: DVec3::new(x, y, z),
            radius_mm: 2.0,
            branch: 0,
            generation: 0,
            parent,
        };
        let points = vec![
            point(0.0, 0.0, 0.0, None),
            point(0.0, 0.0, -50.0, Some(0)),
            point(30.0, 0.0, -80.0, Some(1)),
            point(-30.0, 0.0, -80.0, Some(1)),
            point(-31.0, 0.0, -79.0, Some(1)),
        ];
        let shift = DVec3::new(0.0, 1.0, 5.0);
        let anatomy = Anatomy {
            inspiration: TriangleMesh::default(),
            expiration: TriangleMesh::default(),
            vertex_generation: Vec::new(),
            centerline_expiration: points.iter().map(|p| p.position_mm + shift).collect(),
            radius_expiration_mm: Vec::new(),
            centerline: Centerline { points },
        };
        let found = targets(&anatomy, None);
        assert_eq!(found.len(), 6, "three tips, each with its companion");
        assert!(found[0].inspiration_mm.distance(found[1].inspiration_mm) > 50.0, "the two sides come first");
        for (tip, beside) in found[..3].iter().zip(&found[3..]) {
            assert!((tip.inspiration_mm.distance(beside.inspiration_mm) - BESIDE_MM).abs() < 1e-9);
            assert_eq!(beside.expiration_mm - beside.inspiration_mm, shift);
            assert_eq!(tip.at(0.5), tip.inspiration_mm + 0.5 * shift);
        }
        // Beside a wide airway a centimetre is not enough.
        let mut wide = anatomy.clone();
        wide.centerline.points.iter_mut().for_each(|point| point.radius_mm = 12.0);
        for beside in &targets(&wide, None)[3..] {
            let walls =
                wide.centerline.points.iter().map(|p| p.position_mm.distance(beside.inspiration_mm) - p.radius_mm);
            assert!(walls.fold(f64::INFINITY, f64::min) >= CLEAR_MM);
        }
        // Where the motion of all tissue is known, a companion moves as the tissue where it is.
        let field = BreathingField {
            source: String::new(),
            scale: 1.0,
            softening_mm: 10.0,
            origin_mm: [0.0; 3],
            affine: [[0.0, 9.0, 2.0, 0.0], [1.0, -4.0, 7.0, 3.0], [5.0, 0.0, 6.0, 8.0]],
            centers: Vec::new(),
        };
        let breathing = Breathing { calibre: Default::default(), field };
        for beside in &targets(&anatomy, Some(&breathing))[3..] {
            let motion = breathing.field.displacement(beside.inspiration_mm);
            assert!((beside.expiration_mm - beside.inspiration_mm).distance(motion) < 1e-12);
        }
    }
}
