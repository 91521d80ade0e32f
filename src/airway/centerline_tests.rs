use std::f64::consts::TAU;
use std::path::Path;

use glam::DVec3;

use super::*;

/// Radius in mm of the axis' quarter circle and of the tube.
const BEND_MM: f64 = 30.0;
const TUBE_MM: f64 = 4.0;

/// A quarter of a torus with flat caps: from (30, 0, 0) down to (0, 0, -30), normals outwards.
fn bent_tube() -> TriangleMesh {
    let (rings, sides) = (60u32, 40u32);
    let mut mesh = TriangleMesh::default();
    let axis = |ring: u32| {
        let angle = TAU / 4.0 * f64::from(ring) / f64::from(rings);
        DVec3::new(angle.cos(), 0.0, -angle.sin())
    };
    for ring in 0..=rings {
        for side in 0..sides {
            let (sin, cos) = (TAU * f64::from(side) / f64::from(sides)).sin_cos();
            mesh.vertices.push(axis(ring) * (BEND_MM + TUBE_MM * cos) + DVec3::Y * (TUBE_MM * sin));
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
        mesh.vertices.push(axis(ring) * BEND_MM);
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
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../shared/data/atm22/meshes/{name}.ply"));
    if !path.exists() {
        println!("SKIPPED: {} is absent", path.display());
        return;
    }
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
