use std::f64::consts::TAU;

use glam::DVec3;

use super::*;
use crate::base::random::{CounterRng, Stage};

/// Radius in mm of the axis' quarter circle and of the tube.
const BEND_MM: f64 = 30.0;
const TUBE_MM: f64 = 4.0;

/// A quarter of a torus with flat caps: from (30, 0, 0) down to (0, 0, -30), normals outwards.
fn bent_tube() -> TriangleMesh {
    tube(BEND_MM, |_, _| TUBE_MM)
}

/// The same with an axis of radius `bend_mm` and a wall that is as far from it as `radius_mm` says, by ring and angle.
fn tube(bend_mm: f64, radius_mm: impl Fn(u32, f64) -> f64) -> TriangleMesh {
    let (rings, sides) = (60u32, 40u32);
    let mut mesh = TriangleMesh::default();
    let axis = |ring: u32| {
        let angle = TAU / 4.0 * f64::from(ring) / f64::from(rings);
        DVec3::new(angle.cos(), 0.0, -angle.sin())
    };
    for ring in 0..=rings {
        for side in 0..sides {
            let angle = TAU * f64::from(side) / f64::from(sides);
            let (radius_mm, (sin, cos)) = (radius_mm(ring, angle), angle.sin_cos());
            mesh.vertices.push(axis(ring) * (bend_mm + radius_mm * cos) + DVec3::Y * (radius_mm * sin));
        }
    }
    let at = |ring: u32, side: u32| ring * sides + side % sides;
    for side in 0..sides {
        for ring in 0..rings {
            let [a, b, c, d] = [at(ring, side), at(ring, side + 1), at(ring + 1, side + 1), at(ring + 1, side)];
            mesh.faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    for (ring, flipped) in [(0, true), (rings, false)] {
        let middle = mesh.vertices.len() as u32;
        mesh.vertices.push(axis(ring) * bend_mm);
        for side in 0..sides {
            let (a, b) = (at(ring, side), at(ring, side + 1));
            mesh.faces.push(if flipped { [middle, b, a] } else { [middle, a, b] });
        }
    }
    mesh.validate_closed().unwrap();
    mesh
}

#[test]
fn bent_tube_has_its_axis_and_radius() {
    let mut mesh = bent_tube();
    let centerline = extract(&mesh, &CenterlineSettings::default()).unwrap();
    let points = &centerline.points;
    assert!(points.iter().all(|p| p.branch == 0 && p.generation == 0), "one tube, one branch");
    assert!(points[0].position_mm.distance(DVec3::X * BEND_MM) < 1.3 * TUBE_MM, "the inlet is the upper end");
    let length: f64 = points.windows(2).map(|w| w[0].position_mm.distance(w[1].position_mm)).sum();
    let expected = TAU / 4.0 * BEND_MM;
    assert!(length > expected - 2.5 * TUBE_MM && length < expected, "{length} of {expected}");
    let mut checked = 0;
    for point in points {
        let p = point.position_mm;
        let to_caps = p.x.min(-p.z);
        let off_axis = (DVec3::new(p.x, 0.0, p.z).length() - BEND_MM).hypot(p.y);
        if to_caps > 1.2 * TUBE_MM {
            assert!(off_axis < 0.15 * TUBE_MM, "{p} is {off_axis} mm off the axis");
            assert!((point.radius_mm / TUBE_MM - 1.0).abs() < 0.08, "{p}: radius {}", point.radius_mm);
            checked += 1;
        }
    }
    assert!(checked > 30, "only {checked} points away from the caps");
    mesh.flip();
    let flipped = extract(&mesh, &CenterlineSettings::default()).unwrap().points;
    assert_eq!(flipped.len(), points.len());
    for (a, b) in flipped.iter().zip(points) {
        assert!(a.position_mm.distance(b.position_mm) < 1e-6, "either orientation gives the same");
    }
}

/// A line that is smoothed after it was centred cuts a narrow bend, and its spheres are too small.
#[test]
fn a_narrow_bend_has_its_radius() {
    let (bend_mm, tube_mm) = (8.0, 1.3);
    let centerline = extract(&tube(bend_mm, |_, _| tube_mm), &CenterlineSettings::default()).unwrap();
    let inner = centerline.points.iter().filter(|p| p.position_mm.x.min(-p.position_mm.z) > 1.5 * tube_mm);
    let shares: Vec<f64> = inner.map(|p| p.radius_mm / tube_mm).collect();
    assert!(shares.len() > 5 && shares.iter().all(|share| (0.97..1.0).contains(share)), "{shares:?}");
}

/// The wall of a scan is rough: each ring's middle lies elsewhere. Every point is to be near its own, and the line is not
/// to wiggle from each to the next.
#[test]
fn a_rough_tube_is_followed_without_wiggles() {
    let tube_mm = 1.5;
    let roughness = |ring: u32, angle: f64| {
        let mut rng = CounterRng::new(5, Stage::Test, &[ring.into()]);
        (1..4).map(|k| 0.05 * rng.range(-1.0, 1.0) * (f64::from(k) * angle + rng.range(0.0, TAU)).cos()).sum::<f64>()
    };
    let mesh = tube(BEND_MM, |ring, angle| tube_mm * (1.0 + roughness(ring, angle)));
    let points = extract(&mesh, &CenterlineSettings::default()).unwrap().points;
    let surface = SurfaceDistance::new(&mesh);
    let (mut missing, mut turns) = (Vec::new(), Vec::new());
    for k in 4..points.len() - 4 {
        let place = |k: usize| points[k].position_mm;
        let (u, v) = (place(k + 3) - place(k - 3)).normalize().any_orthonormal_pair();
        let near = (-12..=12).flat_map(|i| (-12..=12).map(move |j| (f64::from(i), f64::from(j))));
        let greatest = near.map(|(i, j)| surface.distance(place(k) + 0.02 * (u * i + v * j))).fold(0.0, f64::max);
        missing.push(1.0 - points[k].radius_mm / greatest);
        turns.push((place(k + 1) - place(k)).angle_between(place(k) - place(k - 1)).to_degrees());
    }
    missing.sort_by(f64::total_cmp);
    turns.sort_by(f64::total_cmp);
    let of = |sorted: &[f64], share: f64| sorted[(share * sorted.len() as f64) as usize];
    let (missing, turns) = ([0.5, 0.95].map(|s| of(&missing, s)), [0.5, 0.95].map(|s| of(&turns, s)));
    println!("the radius misses {missing:.4?}, the line turns by {turns:.1?} degrees");
    assert!(missing[0] < 0.015 && missing[1] < 0.03, "{missing:?}");
    assert!(turns[0] < 6.0 && turns[1] < 18.0, "{turns:?}");
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let mesh = bent_tube();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| extract(&mesh, &CenterlineSettings::default()).unwrap())
    };
    let one = on(1);
    assert_eq!(one, on(2));
    assert_eq!(one, on(8));
}

#[test]
fn open_and_empty_meshes_are_refused() {
    let mut mesh = bent_tube();
    mesh.faces.truncate(mesh.faces.len() / 2);
    assert!(extract(&mesh, &CenterlineSettings::default()).unwrap_err().to_string().contains("not closed"));
    assert!(extract(&TriangleMesh::default(), &CenterlineSettings::default()).is_err());
    let settings = CenterlineSettings { point_spacing_mm: 0.0, ..CenterlineSettings::default() };
    assert!(extract(&bent_tube(), &settings).is_err());
}

#[test]
fn the_inlet_can_be_chosen() {
    let end = DVec3::NEG_Z * BEND_MM;
    let settings = CenterlineSettings { inlet_mm: Some(end), ..CenterlineSettings::default() };
    let centerline = extract(&bent_tube(), &settings).unwrap();
    assert!(centerline.points[0].position_mm.distance(end) < TUBE_MM);
}

/// Median diameter in mm over the points of one generation.
fn median_diameter(centerline: &Centerline, generation: u32) -> f64 {
    let of_generation = centerline.points.iter().filter(|p| p.generation == generation);
    let mut diameters: Vec<f64> = of_generation.map(|p| 2.0 * p.radius_mm).collect();
    diameters.sort_by(f64::total_cmp);
    diameters[diameters.len() / 2]
}

/// Expected diameters: the README of the shared data.
#[test]
fn real_airways_have_the_published_diameters() {
    let (name, expected) = ("ATM_384", [13.0, 8.9, 6.3, 4.6]);
    let Some(path) = crate::skip::shared(&format!("data/atm22/meshes/{name}.ply")) else { return };
    let mesh = crate::formats::mesh::read(&path).unwrap();
    let start = std::time::Instant::now();
    let centerline = extract(&mesh, &CenterlineSettings::default()).unwrap();
    println!("{name}: {:.2} s", start.elapsed().as_secs_f64());
    let branches = centerline.points.last().unwrap().branch + 1;
    let measured = [0, 1, 2, 3].map(|g| median_diameter(&centerline, g));
    println!("{name}: {} points, {branches} branches, diameters {measured:.2?}", centerline.points.len());
    for (i, point) in centerline.points.iter().enumerate() {
        assert!(point.radius_mm > 0.0, "point {i} lies on the wall");
        assert_eq!(point.parent.is_none(), i == 0);
        assert!(point.parent.is_none_or(|p| (p as usize) < i), "point {i} comes before its parent");
    }
    assert!(branches > 50, "{branches} branches");
    for (measured, expected) in measured.iter().zip(expected) {
        assert!((measured / expected - 1.0).abs() < 0.15, "{measured} mm instead of {expected} mm");
    }
}
