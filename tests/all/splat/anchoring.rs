//! Anchored discs: placement by its definition, pullbacks against central differences, forward mode against both.

use glam::{DMat3, DVec3};
use respire_bench::splat::{
    Anchors, Carrier, Direction, DiscFrame, Gaussians, Gradients, Motion, Rasterizer, Settings, Shape, Wanted,
};

use super::scenes::{Lens, Weights, relative, rng, view, world_from_camera};

struct Patch {
    rest: Vec<[f64; 3]>,
    displacement: Vec<[f64; 3]>,
    faces: Vec<[u32; 3]>,
    anchors: Anchors<f64>,
    look: Gaussians<f64>,
}

/// A bumpy 4x4 patch before the camera, two discs per triangle.
fn patch(frame: DiscFrame, seed: u64) -> Patch {
    let r = &mut rng(&[7, seed]);
    let side = 5;
    let rest: Vec<[f64; 3]> = (0..side * side)
        .map(|k| {
            let local = DVec3::new((k % side) as f64 - 2.0, (k / side) as f64 - 2.0, 4.0 + 0.4 * r.normal());
            world_from_camera().transform_point3(local).to_array()
        })
        .collect();
    let displacement = (0..rest.len()).map(|_| [0, 1, 2].map(|_| 0.4 * r.normal())).collect();
    let mut faces = Vec::new();
    for y in 0..side as u32 - 1 {
        for x in 0..side as u32 - 1 {
            let a = y * side as u32 + x;
            let b = a + side as u32;
            faces.extend([[a, b, a + 1], [b, b + 1, a + 1]]);
        }
    }
    let n = 2 * faces.len();
    let mut anchors = Anchors::new(
        frame,
        (0..n as u32).map(|k| k / 2).collect(),
        (0..n).map(|_| [0, 1, 2].map(|_| r.normal())).collect(),
        (0..n).map(|_| [0, 1].map(|_| (0.25f64).ln() + 0.4 * r.normal())).collect(),
        Carrier { vertices: &rest, faces: &faces },
    )
    .unwrap();
    if frame == DiscFrame::NormalOnly {
        anchors.log_scale_limits = anchors.log_scales.iter().map(|s| s.map(|v| v + 2f64.ln())).collect();
        anchors.log_scales[3][0] += 1.0;
        anchors.log_scales[8][1] += 0.9;
    }
    let mut look = Gaussians::discs(n, 1, 0.8);
    look.sh.iter_mut().for_each(|v| *v = 0.4 * r.normal());
    Patch { rest, displacement, faces, anchors, look }
}

impl Patch {
    fn carrier(&self) -> Carrier<'_, f64> {
        Carrier { vertices: &self.rest, faces: &self.faces }
    }

    fn loss(&self, weights: &Weights<f64>, active: &[u32]) -> f64 {
        let mut discs = self.look.clone();
        self.anchors.clone().place(self.carrier(), Some(active), &mut discs).unwrap();
        let mut rasterizer = Rasterizer::new();
        weights.loss(rasterizer.render(&discs, &view(Lens::Pinhole), &Settings::default(), Some(active)).unwrap())
    }

    fn gradients(&self, weights: &Weights<f64>, active: &[u32]) -> Gradients<f64> {
        let mut discs = self.look.clone();
        self.anchors.clone().place(self.carrier(), Some(active), &mut discs).unwrap();
        let mut rasterizer = Rasterizer::new();
        rasterizer.render(&discs, &view(Lens::Pinhole), &Settings::default(), Some(active)).unwrap();
        rasterizer.backward(&discs, &weights.gradient(), Wanted::POSITIONS | Wanted::SHAPES).unwrap().clone()
    }
}

#[test]
fn discs_follow_an_affine_motion_of_the_mesh() {
    let patch = patch(DiscFrame::InheritStretch, 1);
    let mut before = patch.look.clone();
    patch.anchors.clone().place(patch.carrier(), None, &mut before).unwrap();
    let map = DMat3::from_cols_array(&[1.3, 0.2, -0.1, 0.4, 0.7, 0.3, -0.2, 0.1, 1.1]);
    let shift = DVec3::new(3.0, -1.0, 2.0);
    let vertices: Vec<[f64; 3]> = patch.rest.iter().map(|&v| (map * DVec3::from(v) + shift).to_array()).collect();
    let mut after = patch.look.clone();
    patch.anchors.clone().place(Carrier { vertices: &vertices, faces: &patch.faces }, None, &mut after).unwrap();
    let (Shape::Discs { axes: old }, Shape::Discs { axes: new }) = (&before.shape, &after.shape) else {
        unreachable!()
    };
    for i in 0..before.len() {
        let expected = map * DVec3::from(before.positions[i]) + shift;
        assert!(expected.distance(after.positions[i].into()) < 1e-12);
        // At rest: perpendicular axes in the triangle's plane, as long as their scales say.
        let [a, b] = old[i].map(DVec3::from);
        assert!(a.dot(b).abs() < 1e-12);
        assert!((a.length() - patch.anchors.log_scales[i][0].exp()).abs() < 1e-12);
        assert!((b.length() - patch.anchors.log_scales[i][1].exp()).abs() < 1e-12);
        for k in 0..2 {
            assert!((map * DVec3::from(old[i][k])).distance(new[i][k].into()) < 1e-12);
        }
    }
}

#[test]
fn normal_only_discs_face_along_the_normal_and_keep_their_size() {
    let patch = patch(DiscFrame::NormalOnly, 2);
    let mut discs = patch.look.clone();
    patch.anchors.clone().place(patch.carrier(), None, &mut discs).unwrap();
    let Shape::Discs { axes } = &discs.shape else { unreachable!() };
    for (i, &face) in patch.anchors.faces().iter().enumerate() {
        let [a, b, c] = patch.faces[face as usize].map(|v| DVec3::from(patch.rest[v as usize]));
        let n = (b - a).cross(c - a).normalize();
        let arc = glam::DQuat::from_rotation_arc(DVec3::Z, n);
        for (k, unit) in [DVec3::X, DVec3::Y].into_iter().enumerate() {
            let size = patch.anchors.log_scales[i][k].min(patch.anchors.log_scale_limits[i][k]).exp();
            assert!((arc * unit * size).distance(axes[i][k].into()) < 1e-9);
        }
    }
}

#[test]
fn pullbacks_equal_central_differences() {
    const STEP: f64 = 1e-6;
    for (frame, seed) in [(DiscFrame::InheritStretch, 3), (DiscFrame::NormalOnly, 4)] {
        let patch = patch(frame, seed);
        let weights = Weights::new(43 * 29, seed);
        let active: Vec<u32> = (0..patch.anchors.len() as u32).filter(|i| i % 5 != 2).collect();
        let gradients = patch.gradients(&weights, &active);
        let (mut logits, mut log_scales, mut vertices) = (Vec::new(), Vec::new(), Vec::new());
        let carrier = patch.carrier();
        patch.anchors.pullback(&gradients, carrier, Some(&active), &mut logits, &mut log_scales).unwrap();
        patch.anchors.vertex_pullback(&gradients, carrier, Some(&active), &mut vertices).unwrap();
        let phase = patch.anchors.phase_pullback(&gradients, carrier, Some(&active), &patch.displacement).unwrap();

        let numeric = |change: &dyn Fn(&mut Patch, f64)| {
            let side = |step: f64| {
                let mut moved = self::patch(frame, seed);
                change(&mut moved, step);
                moved.loss(&weights, &active)
            };
            (side(STEP) - side(-STEP)) / (2.0 * STEP)
        };
        let by_logits: Vec<f64> = (0..3 * active.len())
            .map(|k| numeric(&|p, s| p.anchors.logits[active[k / 3] as usize][k % 3] += s))
            .collect();
        let by_scales: Vec<f64> = (0..2 * active.len())
            .map(|k| numeric(&|p, s| p.anchors.log_scales[active[k / 2] as usize][k % 2] += s))
            .collect();
        let by_vertices: Vec<f64> =
            (0..3 * patch.rest.len()).map(|k| numeric(&|p, s| p.rest[k / 3][k % 3] += s)).collect();
        let by_phase = numeric(&|p, s| {
            for (v, d) in p.rest.iter_mut().zip(&p.displacement) {
                (0..3).for_each(|k| v[k] += s * d[k]);
            }
        });
        for (name, analytic, numeric) in [
            ("logits", logits.as_flattened().to_vec(), by_logits),
            ("log scales", log_scales.as_flattened().to_vec(), by_scales),
            ("vertices", vertices.as_flattened().to_vec(), by_vertices),
            ("phase", vec![phase], vec![by_phase]),
        ] {
            let error = relative(&analytic, &numeric);
            assert!(error <= 1e-6, "{frame:?}: {name} off by {error:e}");
        }
    }
}

/// dL/dphase by forward mode (velocities of the discs, then of the image) and by backward mode.
#[test]
fn forward_mode_equals_backward_mode() {
    let patch = patch(DiscFrame::InheritStretch, 5);
    let mut weights = Weights::new(43 * 29, 5);
    weights.depth.fill(0.0);
    weights.alpha.fill(0.0);
    let active: Vec<u32> = (0..patch.anchors.len() as u32).collect();
    let mut discs = patch.look.clone();
    patch.anchors.clone().place(patch.carrier(), Some(&active), &mut discs).unwrap();
    let (mut positions, mut axes) = (Vec::new(), Vec::new());
    patch.anchors.place_tangent(patch.carrier(), &patch.displacement, None, &mut positions, &mut axes).unwrap();
    let motion = Direction::Motion(Motion { positions: &positions, axes: &axes, ..Motion::default() });
    let mut rasterizer = Rasterizer::new();
    let (view, settings) = (view(Lens::Pinhole), Settings::default());
    let images = rasterizer.render_tangent(&discs, &view, &settings, Some(&active), &[motion]).unwrap();
    let forward: f64 = images[0].iter().zip(&weights.color).map(|(velocity, weight)| velocity * weight).sum();
    let gradients = patch.gradients(&weights, &active);
    let backward =
        patch.anchors.phase_pullback(&gradients, patch.carrier(), Some(&active), &patch.displacement).unwrap();
    assert!((forward - backward).abs() <= 1e-10 * forward.abs(), "{forward} forward, {backward} backward");
}

#[test]
fn velocities_of_discs_equal_differences() {
    const STEP: f64 = 1e-6;
    for frame in [DiscFrame::InheritStretch, DiscFrame::NormalOnly] {
        let patch = patch(frame, 6);
        let placed = |phase: f64| {
            let vertices: Vec<[f64; 3]> = patch
                .rest
                .iter()
                .zip(&patch.displacement)
                .map(|(v, d)| [0, 1, 2].map(|k| v[k] + phase * d[k]))
                .collect();
            let mut discs = patch.look.clone();
            patch
                .anchors
                .clone()
                .place(Carrier { vertices: &vertices, faces: &patch.faces }, None, &mut discs)
                .unwrap();
            let Shape::Discs { axes } = discs.shape else { unreachable!("discs stay discs") };
            [discs.positions.into_flattened(), axes.into_flattened().into_flattened()]
        };
        let (plus, minus) = (placed(STEP), placed(-STEP));
        let (mut positions, mut axes) = (Vec::new(), Vec::new());
        patch.anchors.place_tangent(patch.carrier(), &patch.displacement, None, &mut positions, &mut axes).unwrap();
        for (k, found) in [positions.into_flattened(), axes.into_flattened().into_flattened()].iter().enumerate() {
            let numeric: Vec<f64> = plus[k].iter().zip(&minus[k]).map(|(p, m)| (p - m) / (2.0 * STEP)).collect();
            let error = relative(found, &numeric);
            assert!(error <= 1e-8, "{frame:?}: off by {error:e}");
        }
    }
}
