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

/// A Gaussian that a frame has shown.
#[derive(Clone, Copy, Debug)]
pub struct Lender {
    /// Its centre in mm.
    pub position: [f32; 3],
    /// Its encoded colour as shown.
    pub color: [f32; 3],
    /// The shade contained in that.
    pub shade: f32,
}

/// The encoded colour at shade 1 of Gaussians at the positions `unseen`, in mm: what the nearest lenders show, over the
/// shade in which they show it. A dark lender, whose colour is uncertain, has less of a say.
pub fn lent_colors(lenders: &[Lender], unseen: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let at = |p: &[f32; 3]| Vec3::from(*p).as_dvec3();
    let from: Vec<DVec3> = lenders.iter().map(|lender| at(&lender.position)).collect();
    let to: Vec<DVec3> = unseen.iter().map(at).collect();
    let mean = |near: &Vec<(u32, f64)>| {
        let (mut sum, mut shades) = (DVec3::ZERO, 0.0);
        for &(i, distance_mm) in near {
            let lender = &lenders[i as usize];
            let weight = 1.0 / (distance_mm + ALIKE_MM);
            sum += weight * at(&lender.color);
            shades += weight * lender.shade as f64;
        }
        if shades > 0.0 { (sum / shades).as_vec3().to_array() } else { GREY }
    };
    neighbours::nearest(&from, &to, LENDERS).iter().map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wall_beside_lends_its_colour_whatever_light_fell_on_it() {
        // Two walls of one colour each, 50 mm apart, every disc in a light of its own.
        let [red, grey] = [[0.6, 0.3, 0.2], [0.4, 0.4, 0.4]];
        let lender = |k: usize| {
            let (wall, shade) = (k % 2, 0.2 + 0.1 * (k % 7) as f32);
            let color = if wall == 0 { red } else { grey };
            Lender { position: [50.0 * wall as f32, 0.3 * k as f32, 0.0], color: color.map(|v: f32| v * shade), shade }
        };
        let lenders: Vec<Lender> = (0..40).map(lender).collect();
        let lent = lent_colors(&lenders, &[[2.0, 4.0, 1.0], [47.0, 9.0, 0.0]]);
        for (lent, color) in lent.iter().zip([red, grey]) {
            assert!(lent.iter().zip(color).all(|(a, b)| (a - b).abs() < 1e-5), "{lent:?}");
        }
    }

    #[test]
    fn nothing_seen_is_grey() {
        assert_eq!(lent_colors(&[], &[[0.0; 3], [1.0; 3]]), [GREY; 2]);
    }
}
