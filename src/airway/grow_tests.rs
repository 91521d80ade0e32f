use super::*;
use crate::airway::surface::{SurfaceSettings, surface_from_tree};

#[test]
fn rule_six_gives_the_published_values() {
    // Closed form: r = .5 -> 34.9 degrees, r = .3 -> 46.9 / 23.5, r = .1 -> 62.7 / 10.7 (62 here: the limit).
    for (share, degrees) in [(0.5, 34.9), (0.3, 46.9), (0.7, 23.5), (0.1, 62.0), (0.9, 10.7)] {
        let angle = branching_angle(share, 2.8).to_degrees();
        assert!((angle - degrees).abs() < 0.1, "share {share}: {angle}");
    }
}

#[test]
fn same_seed_same_tree_other_seed_other_tree() {
    let settings = GrowthSettings::default();
    assert_eq!(grow(4, &settings).unwrap(), grow(4, &settings).unwrap());
    assert_ne!(grow(4, &settings).unwrap().branches, grow(5, &settings).unwrap().branches);
}

#[test]
fn a_tree_is_whole_and_like_lungs() {
    for seed in 0..12 {
        let tree = grow(seed, &GrowthSettings::default()).unwrap();
        tree.validate().unwrap();
        let deepest = tree.branches.iter().map(|b| b.generation).max().unwrap();
        assert!(tree.branches.len() >= 31 && deepest >= 5, "seed {seed}: {} branches", tree.branches.len());
        for (index, branch) in tree.branches.iter().enumerate().skip(1) {
            let parent = &tree.branches[branch.parent.unwrap() as usize];
            assert_eq!(branch.generation, parent.generation + 1);
            assert!(branch.radius(0) < parent.radius(0), "branch {index} is wider than its parent");
            assert_eq!(branch.position(0), parent.position(parent.points_mm.len() - 1));
        }
        let children_of = |b: u32| tree.branches.iter().filter(|c| c.parent == Some(b)).count();
        assert!((0..tree.branches.len() as u32).all(|b| matches!(children_of(b), 0 | 2)), "seed {seed}: dichotomous");
        // Right main bronchus (x < 0 in LPS): wider, shorter, steeper than the left.
        let (right, left) = (&tree.branches[1], &tree.branches[2]);
        let end = |b: &Branch| b.position(b.points_mm.len() - 1);
        assert!(end(right).x < 0.0 && end(left).x > 0.0);
        assert!(right.length_mm() < left.length_mm());
        assert!(end(right).x.abs() / end(right).z.abs() < end(left).x.abs() / end(left).z.abs());
    }
}

#[test]
fn the_surface_of_a_tree_is_one_closed_sphere() {
    for seed in 0..6 {
        let tree = grow(seed, &GrowthSettings::default()).unwrap();
        let (mesh, _) = surface_from_tree(&tree, &SurfaceSettings::default())
            .unwrap_or_else(|e| panic!("seed {seed}, {} branches: {e}", tree.branches.len()));
        mesh.validate_closed().unwrap();
        let euler = mesh.vertices.len() as i64 - mesh.edges().len() as i64 + mesh.faces.len() as i64;
        assert_eq!(euler, 2, "seed {seed}");
        assert!(mesh.signed_volume() < 0.0, "normals point into the lumen");
    }
}

#[test]
fn a_senseless_setting_is_named() {
    let settings = GrowthSettings { lung_size: f64::NAN, ..Default::default() };
    assert!(grow(1, &settings).unwrap_err().to_string().starts_with("anatomy.growth.lung_size: NaN"));
}
