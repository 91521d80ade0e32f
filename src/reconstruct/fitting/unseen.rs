//! Colours of a wall that no frame has shown, where there is no image to take them from: those of the nearest wall that
//! one has shown, free of the light that fell on it. Ours, not the paper's.

use glam::{DVec3, Vec3};

use crate::reconstruct::geometry::neighbours;

/// How many neighbours lend their colour. Tuning cases, novel views of `oracle-phase`: the mean of all 27.5 dB, of 8, 32
/// and 200 neighbours 27.9, 27.8 and 27.8 dB.
const LENDERS: usize = 8;
/// Distance in mm below which neighbours count alike: about that between discs.
const ALIKE_MM: f64 = 0.2;
/// The colour where nothing has been seen.
const GREY: [f32; 3] = [0.5; 3];

/// How a frame has shown a Gaussian.
#[derive(Clone, Copy, Debug)]
pub struct Shown {
    /// Its encoded colour as shown.
    pub color: [f32; 3],
    /// The shade contained in that.
    pub shade: f32,
}

/// Number and encoded colour at shade 1 of each Gaussian that no frame has shown: what the nearest others show, over the
/// shade in which they show it. A dark one, whose colour is uncertain, has less of a say. `positions` are in mm, one per
/// Gaussian; `shown` is `None` where no frame has shown it.
pub fn lent_colors(positions: &[[f32; 3]], shown: impl Fn(usize) -> Option<Shown>) -> Vec<(usize, [f32; 3])> {
    let (mut lenders, mut from) = (Vec::new(), Vec::new());
    let (mut unseen, mut to) = (Vec::new(), Vec::new());
    for (k, position) in positions.iter().enumerate() {
        let position = Vec3::from(*position).as_dvec3();
        match shown(k) {
            Some(lender) => {
                lenders.push(lender);
                from.push(position);
            }
            None => {
                unseen.push(k);
                to.push(position);
            }
        }
    }
    let mean = |near: Vec<(u32, f64)>| {
        let (mut sum, mut shades) = (DVec3::ZERO, 0.0);
        for (i, distance_mm) in near {
            let Shown { color, shade } = lenders[i as usize];
            let weight = 1.0 / (distance_mm + ALIKE_MM);
            sum += weight * Vec3::from(color).as_dvec3();
            shades += weight * shade as f64;
        }
        if shades > 0.0 { (sum / shades).as_vec3().to_array() } else { GREY }
    };
    unseen.into_iter().zip(neighbours::nearest(&from, &to, LENDERS).into_iter().map(mean)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wall_beside_lends_its_colour_whatever_light_fell_on_it() {
        // Two walls of one colour each, 50 mm apart, every disc in a light of its own.
        let [red, grey] = [[0.6, 0.3, 0.2], [0.4, 0.4, 0.4]];
        let mut positions: Vec<[f32; 3]> = (0..40).map(|k| [50.0 * (k % 2) as f32, 0.3 * k as f32, 0.0]).collect();
        positions.extend([[2.0, 4.0, 1.0], [47.0, 9.0, 0.0]]);
        let shown = |k: usize| {
            let shade = 0.2 + 0.1 * (k % 7) as f32;
            let color = [red, grey][k % 2];
            (k < 40).then(|| Shown { color: color.map(|v: f32| v * shade), shade })
        };
        let lent = lent_colors(&positions, shown);
        assert_eq!([lent[0].0, lent[1].0, lent.len()], [40, 41, 2]);
        for ((_, lent), color) in lent.iter().zip([red, grey]) {
            assert!(lent.iter().zip(color).all(|(a, b)| (a - b).abs() < 1e-5), "{lent:?}");
        }
    }

    #[test]
    fn near_walls_lend_more() {
        let positions = [[1.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0; 3]];
        let lent = lent_colors(&positions, |k| (k < 2).then(|| Shown { color: [[0.2; 3], [0.8; 3]][k], shade: 1.0 }));
        let expected = (0.2 / 1.2 + 0.8 / 4.2) / (1.0 / 1.2 + 1.0 / 4.2);
        assert!(lent[0].0 == 2 && (lent[0].1[0] - expected as f32).abs() < 1e-6, "{lent:?} {expected}");
    }

    #[test]
    fn nothing_seen_is_grey() {
        assert_eq!(lent_colors(&[[0.0; 3], [1.0; 3]], |_| None), [(0, GREY), (1, GREY)]);
    }
}
