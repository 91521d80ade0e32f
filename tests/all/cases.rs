//! The nine cases of `bench-cases/`: whole, varied, free of folds, and passable for their scopes.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use glam::DVec3;
use rayon::prelude::*;
use respire_bench::airway::case::{AnatomySource, Case};
use respire_bench::airway::case_build::read_tree;
use respire_bench::airway::grow::grow;
use respire_bench::airway::tree::Tree;
use respire_bench::airway::{self, Anatomy, morphometry};
use respire_bench::base::{TriangleMesh, hash, mesh};
use respire_bench::simulate::film::Film;
use respire_bench::simulate::truth::TruthSet;
use respire_bench::simulate::{FilmLight, MeshOutput, RadianceOutput, SimulationSettings, material};

/// Hash of the nine cases and of every file that they name.
const SEAL: &str = "06f64d3a9f7ec3e09ffbbb657c485885ff116d86ad99670bb934d6dc34b07135";

pub fn case_path(number: usize) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("bench-cases/case{number}.toml"))
}

fn cases() -> Vec<Case> {
    (1..=9).map(|n| Case::load(&case_path(n)).unwrap()).collect()
}

/// Times that the ray from `point` along `direction` goes through the surface; odd means inside.
pub fn crossings(surface: &TriangleMesh, point: DVec3, direction: DVec3) -> usize {
    let hit = |f: usize| {
        let [a, b, c] = surface.corners(f);
        let (e1, e2) = (b - a, c - a);
        let p = direction.cross(e2);
        let determinant = e1.dot(p);
        if determinant.abs() < 1e-12 {
            return false;
        }
        let s = point - a;
        let u = s.dot(p) / determinant;
        let q = s.cross(e1);
        let v = direction.dot(q) / determinant;
        u >= 0.0 && v >= 0.0 && u + v <= 1.0 && e2.dot(q) / determinant > 0.0
    };
    (0..surface.faces.len()).filter(|&f| hit(f)).count()
}

#[test]
fn the_cases_span_what_the_paper_asks_for() {
    let cases = cases();
    let measured: BTreeSet<PathBuf> = cases
        .iter()
        .filter_map(|c| match &c.anatomy {
            AnatomySource::Tree { path, .. } => Some(path.clone()),
            _ => None,
        })
        .collect();
    let from_trees = cases.iter().filter(|c| matches!(c.anatomy, AnatomySource::Tree { .. })).count();
    assert!(measured.len() >= 4 && from_trees >= 5, "{measured:?}");
    assert!(measured.iter().all(|p| !p.to_string_lossy().contains("307")), "no table may be made of it");
    let patient = |c: &Case| c.breathing.as_ref().unwrap().field.source.split(' ').next().unwrap().to_string();
    let motions: BTreeSet<String> = cases.iter().map(patient).collect();
    assert!(motions.len() >= 5 && motions.iter().all(|m| m.starts_with("copd")), "{motions:?}");
    let spread = |values: Vec<f64>| {
        let sorted = values.iter().copied().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
        assert!(sorted.0.is_finite());
        sorted
    };
    assert_eq!(spread(cases.iter().map(|c| c.camera.fov_x_deg).collect()), (85.0, 120.0));
    let (fast, slow) = spread(cases.iter().map(|c| c.waveform.period_s()).collect());
    assert!(fast <= 3.5 && slow >= 4.5, "{fast} {slow}");
    let hashes: BTreeSet<String> = cases.iter().map(|c| c.hash().unwrap()).collect();
    assert_eq!(hashes.len(), 9);
}

/// Independent of the closed form that the builder uses: normals at 21 phases.
fn assert_no_face_turns(id: &str, anatomy: &Anatomy) {
    let rest: Vec<DVec3> = (0..anatomy.inspiration.faces.len()).map(|f| anatomy.inspiration.area_normal(f)).collect();
    for step in 0..=20 {
        let vertices =
            mesh::interpolate(&anatomy.inspiration.vertices, &anatomy.expiration.vertices, step as f64 / 20.0);
        let now = TriangleMesh { vertices, faces: anatomy.inspiration.faces.clone() };
        for (f, rest) in rest.iter().enumerate() {
            assert!(now.area_normal(f).dot(*rest) > 0.0, "{id}: face {f} turns over at phase {}", step as f64 / 20.0);
        }
    }
}

/// A row of each of the tables of cases in docs/cases.md: anatomy and breathing; view and route of the scope.
fn rows(case: &Case, anatomy: &Anatomy, film: &Film) -> [String; 2] {
    let tree = match &case.anatomy {
        AnatomySource::Tree { path, .. } => {
            format!("measured: {}", path.file_stem().unwrap().to_string_lossy().replace('_', " "))
        }
        AnatomySource::Grown { seed, .. } => format!("grown, seed {seed}"),
        _ => String::from("mesh"),
    };
    let field = &case.breathing.as_ref().unwrap().field;
    let t = &case.trajectory;
    let w = &case.waveform;
    let region = format!("{:?}", t.region).replace("Lower", ", lower").replace("Upper", ", upper").to_lowercase();
    let irregular = if w.irregularity > 0.0 { ", irregular" } else { "" };
    let lens = if case.camera.fisheye.is_some() { " (fisheye)" } else { "" };
    [
        format!(
            "| {} | {tree} | {} | {:.0} ({:.2}) | {:.1} | {}-{:.2}{irregular} |",
            case.id,
            field.source.split(' ').next().unwrap(),
            film.end_motion_mm,
            field.scale,
            60.0 / w.period_s(),
            w.offset,
            w.offset + w.amplitude,
        ),
        format!(
            "| {} | {:.0}{lens} | {:.1} | {region} | {:.0} | {} |",
            case.id,
            case.camera.fov_x_deg,
            2.0 * t.scope_radius_mm,
            film.route_mm,
            anatomy.inspiration.faces.len() / 1000,
        ),
    ]
}

/// Median inscribed diameters of the trees by generation, beside the literature's.
fn diameters(trees: &[(String, Tree)]) -> String {
    let rows: Vec<_> = trees.iter().map(|(_, tree)| morphometry::rows(tree)).collect();
    let names: Vec<&str> = trees.iter().map(|t| t.0.as_str()).collect();
    let mut text = format!("| generation | {} | Weibel A | Horsfield |\n|", names.join(" | "));
    text += &"---:|".repeat(trees.len() + 3);
    for generation in 0..=7u32 {
        let cell = |value: Option<f64>| value.map_or(String::from("-"), |v| format!("{v:.1}"));
        let of = |rows: &Vec<morphometry::GenerationRow>| {
            cell(rows.iter().find(|r| r.generation == generation).map(|r| r.diameter_mm))
        };
        let cells: Vec<String> = rows.iter().map(of).collect();
        let known = morphometry::literature(generation);
        text += &format!(
            "\n| {generation} | {} | {} | {} |",
            cells.join(" | "),
            cell(known.map(|l| l.weibel_diameter_mm)),
            cell(known.and_then(|l| l.horsfield_diameter_mm))
        );
    }
    text
}

/// The part of docs/cases.md between its marks must be `wanted`; with UPDATE_DOCS=1 it is written.
fn assert_documented(mark: &str, wanted: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/cases.md");
    let text = std::fs::read_to_string(&path).unwrap();
    let (open, close) = (format!("<!-- {mark} -->\n"), format!("\n<!-- end of {mark} -->"));
    let start = text.find(&open).unwrap() + open.len();
    let end = start + text[start..].find(&close).unwrap();
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::write(&path, format!("{}{wanted}{}", &text[..start], &text[end..])).unwrap();
    } else {
        assert_eq!(&text[start..end], wanted, "rerun with UPDATE_DOCS=1");
    }
}

#[test]
fn the_documented_diameters_are_those_of_the_trees() {
    let tree = |case: &Case| match &case.anatomy {
        AnatomySource::Tree { path, .. } => read_tree(&case.resolve(path)).unwrap(),
        AnatomySource::Grown { seed, growth, .. } => grow(*seed, growth).unwrap(),
        _ => panic!("{} has no tree", case.id),
    };
    let cases = cases();
    let trees: Vec<(String, Tree)> =
        [(1, "ATM_384"), (2, "ATM_224"), (3, "Chaste"), (7, "case7"), (8, "case8"), (9, "case9")]
            .map(|(n, name)| (name.to_string(), tree(&cases[n - 1])))
            .to_vec();
    assert_documented("diameters", &diameters(&trees[..3]));
    assert_documented("grown diameters", &diameters(&trees[3..]));
}

#[test]
fn every_case_breathes_without_folds_and_its_scope_stays_in_the_lumen() {
    let (anatomies, routes): (Vec<String>, Vec<String>) =
        cases().par_iter().map(checked_rows).collect::<Vec<_>>().into_iter().map(|[a, b]| (a, b)).unzip();
    let head = "| case | tree | motion | end moves (mm), of full motion | breaths/min | phases |\n\
        |---|---|---|---:|---:|---|";
    assert_documented("cases", &format!("{head}\n{}", anatomies.join("\n")));
    let head = "| case | view (deg) | scope (mm) | route ends | route (mm) | faces (k) |\n\
        |---|---|---:|---|---:|---:|";
    assert_documented("routes", &format!("{head}\n{}", routes.join("\n")));
}

#[test]
fn the_tuning_cases_are_as_sound_as_the_nine_and_none_of_them() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases/tuning");
    let tuning: Vec<Case> = (1..=4).map(|n| Case::load(&folder.join(format!("tune{n}.toml"))).unwrap()).collect();
    tuning.par_iter().for_each(|case| drop(checked_rows(case)));
    let tree = |case: &Case| serde_json::to_value(&case.anatomy).unwrap();
    let motion = |case: &Case| serde_json::to_value(case.breathing.as_ref().unwrap().field.affine).unwrap();
    for scored in cases() {
        assert!(tuning.iter().all(|case| tree(case) != tree(&scored) && motion(case) != motion(&scored)));
    }
}

/// The nine are frozen: whoever changes one of them changes every number that was ever reported on it, and says so
/// here.
#[test]
fn the_nine_are_sealed() {
    let hashes: Vec<String> = cases().iter().map(|case| case.hash().unwrap()).collect();
    assert_eq!(hash::of_value(&hashes).unwrap(), SEAL);
}

/// Checks everything about a case and gives its rows of the tables.
fn checked_rows(case: &Case) -> [String; 2] {
    let anatomy = airway::build(case).unwrap();
    let id = &case.id;
    anatomy.inspiration.validate_closed().unwrap();
    let faces = anatomy.inspiration.faces.len();
    assert!((15_000..=50_000).contains(&faces), "{id}: {faces} faces");
    for surface in [&anatomy.inspiration, &anatomy.expiration] {
        assert!(surface.signed_volume() < 0.0, "{id}: normals must point into the lumen");
    }
    assert_no_face_turns(id, &anatomy);
    let settings = SimulationSettings {
        width_px: 64,
        height_px: 64,
        frames_per_second: 10.0,
        frames: (case.waveform.period_s() * 10.0).ceil() as usize,
        samples_per_pixel: 1,
        meshes: MeshOutput::EndStates,
        radiance: RadianceOutput::None,
        truth: TruthSet::default(),
        light: FilmLight::Full,
    };
    let film = Film::plan(case, &anatomy, &settings, &material(case).unwrap()).unwrap();
    assert!((4.9..=20.1).contains(&film.end_motion_mm), "{id}: the end moves {} mm", film.end_motion_mm);
    assert!(film.notes.is_empty(), "{id}: {:?}", film.notes);
    let phases = film.frames.iter().map(|f| f.phase);
    let (low, high) = phases.fold((1.0f64, 0.0f64), |(l, h), p| (l.min(p), h.max(p)));
    assert!(low < 0.3 && high > 0.8, "{id}: a breath spans {low} to {high}");
    for (index, frame) in film.frames.iter().enumerate() {
        let room = 1.0 - case.trajectory.steering.sideways;
        assert!(film.clearance_mm[index] >= 0.9 * room * case.trajectory.scope_radius_mm, "{id} frame {index}");
        if index % 8 == 0 {
            let vertices = mesh::interpolate(&anatomy.inspiration.vertices, &anatomy.expiration.vertices, frame.phase);
            let now = TriangleMesh { vertices, faces: anatomy.inspiration.faces.clone() };
            let direction = DVec3::new(0.317, 0.523, 0.791).normalize();
            let through = crossings(&now, frame.world_from_camera.translation, direction);
            assert_eq!(through % 2, 1, "{id} frame {index}: the camera is outside");
        }
        if let Some(view) = film.novel_views.iter().find(|view| view.frame == index) {
            let vertices = mesh::interpolate(&anatomy.inspiration.vertices, &anatomy.expiration.vertices, frame.phase);
            let now = TriangleMesh { vertices, faces: anatomy.inspiration.faces.clone() };
            let direction = DVec3::new(0.317, 0.523, 0.791).normalize();
            let through = crossings(&now, view.world_from_camera.translation, direction);
            assert_eq!(through % 2, 1, "{id} frame {index}: the second camera is outside");
            let (first, second) = (frame.world_from_camera, view.world_from_camera);
            let distance = first.translation.distance(second.translation);
            let turn = first.matrix3.z_axis.dot(second.matrix3.z_axis).acos().to_degrees();
            assert!(distance <= 2.0 && (7.9..=12.1).contains(&turn), "{id} frame {index}: {distance} mm, {turn} deg");
        }
        let r = frame.world_from_camera.matrix3;
        assert!((r.determinant() - 1.0).abs() < 1e-9, "{id} frame {index}");
    }
    // The camera's way is smooth: no frame turns by more than 25 degrees or jumps.
    for pair in film.frames.windows(2) {
        let (a, b) = (pair[0].world_from_camera, pair[1].world_from_camera);
        let turn = a.matrix3.z_axis.dot(b.matrix3.z_axis).clamp(-1.0, 1.0).acos().to_degrees();
        assert!(turn < 25.0, "{id}: turns by {turn} degrees");
        assert!(a.translation.distance(b.translation) < 5.0, "{id}");
    }
    rows(case, &anatomy, &film)
}
