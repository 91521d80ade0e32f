//! Films of the clinical track: sound wall and camera at every frame, the same bytes however they are made, truth kept
//! from methods, and nothing of it on the ideal track.

use std::path::Path;

use glam::DVec3;
use respire_bench::airway::case::{Case, ClinicalSettings, Condition};
use respire_bench::airway::{self};
use respire_bench::base::{Image, NoProgress, TriangleMesh};
use respire_bench::formats::png;
use respire_bench::simulate::clinical::turned_faces;
use respire_bench::simulate::film::Film;
use respire_bench::simulate::participant::{self, Given, Participant};
use respire_bench::simulate::sequence::Sequence;
use respire_bench::simulate::truth::TruthMap;
use respire_bench::simulate::{MeshOutput, RadianceOutput, SimulationSettings, material, simulate};

use crate::cases::case_path;
use crate::simulate::{assert_same, case, small};

fn clinical(case: Case, change: impl FnOnce(&mut ClinicalSettings)) -> Case {
    let mut case = case.on_clinical_track();
    change(case.clinical.as_mut().unwrap());
    case
}

fn only(rows: &[Condition]) -> Case {
    clinical(case(), |settings| settings.only = Some(rows.to_vec()))
}

fn images(film: &Path, frames: usize) -> Vec<Image<u8>> {
    (0..frames).map(|i| png::read_rgb(&film.join(format!("images/{i:06}.png"))).unwrap()).collect()
}

fn mean_difference(a: &[Image<u8>], b: &[Image<u8>]) -> f64 {
    let all = a.iter().zip(b).flat_map(|(a, b)| a.data.iter().zip(&b.data));
    let (sum, count) = all.fold((0.0, 0), |(sum, n), (a, b)| (sum + (f64::from(*a) - f64::from(*b)).abs(), n + 1));
    sum / f64::from(count)
}

#[test]
fn the_bytes_do_not_depend_on_threads_or_interruptions() {
    let wanted = SimulationSettings { truth: TruthMap::ALL.into_iter().collect(), ..small() };
    let folder = tempfile::tempdir().unwrap();
    let (whole, single) = (folder.path().join("a"), folder.path().join("b"));
    let case = case().on_clinical_track();
    simulate(&case, &wanted, &whole, &NoProgress).unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| simulate(&case, &wanted, &single, &NoProgress)).unwrap();
    assert_same(&whole, &single);
    // Resumed: two frames and what is made at the end are missing.
    for name in ["images/000001.png", "images/000004.png", "manifest.json", "clinical.csv", "told/transforms.json"] {
        std::fs::remove_file(single.join(name)).unwrap();
    }
    simulate(&case, &wanted, &single, &NoProgress).unwrap();
    assert_same(&whole, &single);
}

/// Wall, camera, second cameras and lamps of the shipped cases, as the ideal ones are checked (`cases.rs`).
#[test]
fn every_frame_is_sound() {
    for number in [1, 3, 5, 8] {
        let case = Case::load(&case_path(number)).unwrap().on_clinical_track();
        let anatomy = airway::build(&case).unwrap();
        let settings = SimulationSettings {
            frames_per_second: 6.0,
            frames: 72,
            meshes: MeshOutput::EndStates,
            radiance: RadianceOutput::None,
            ..small()
        };
        let film = Film::plan(&case, &anatomy, &settings, &material(&case).unwrap()).unwrap();
        let clinical = film.clinical().unwrap();
        let mut farthest = 0.0f64;
        for (index, frame) in film.frames.iter().enumerate() {
            let vertices = clinical.wall_at(frame.time_s);
            assert_eq!(turned_faces(&anatomy.inspiration, &vertices), 0, "case{number} frame {index}");
            let ideal = |i: usize| anatomy.inspiration.vertices[i].lerp(anatomy.expiration.vertices[i], frame.phase);
            farthest = (0..vertices.len()).map(|i| vertices[i].distance(ideal(i))).fold(farthest, f64::max);
            assert!(film.clearance_mm[index] >= 0.25, "case{number} frame {index}: {} mm", film.clearance_mm[index]);
            let now = TriangleMesh { vertices, faces: anatomy.inspiration.faces.clone() };
            let lamp = frame.world_from_camera.transform_point3(film.conditions[index].lamp_mm);
            let views = film.novel_views.iter().filter(|view| view.frame == index);
            let places = views.map(|view| view.world_from_camera.translation);
            let direction = DVec3::new(0.317, 0.523, 0.791).normalize();
            for place in places.chain([frame.world_from_camera.translation, lamp]) {
                let through = crate::cases::crossings(&now, place, direction);
                assert_eq!(through % 2, 1, "case{number} frame {index}: {place} is outside");
            }
            let r = frame.world_from_camera.matrix3;
            assert!((r.determinant() - 1.0).abs() < 1e-9);
        }
        assert!(farthest > 1.0, "case{number}: tissue is never more than {farthest} mm from where one phase has it");
        assert!(film.conditions.iter().any(|c| c.contact == 1.0), "case{number} never touches the wall");
    }
}

#[test]
fn with_every_row_off_the_film_is_the_ideal_one() {
    let folder = tempfile::tempdir().unwrap();
    let (ideal, off) = (folder.path().join("ideal"), folder.path().join("off"));
    let film = simulate(&case(), &small(), &ideal, &NoProgress).unwrap();
    let none = simulate(&only(&[]), &small(), &off, &NoProgress).unwrap();
    // The same up to the rounding of another formula for the same motion.
    assert!(mean_difference(&images(&ideal, 6), &images(&off, 6)) < 0.05);
    assert!(film.clinical.is_none() && none.clinical.is_some());
    for (a, b) in film.given_frames().iter().zip(none.given_frames()) {
        assert!(a.world_from_camera.abs_diff_eq(b.world_from_camera, 1e-9));
    }
    assert_eq!(film.given_camera(), none.given_camera());
    assert_eq!(film.given_expiration().unwrap(), none.given_expiration().unwrap());
    for frame in 0..6 {
        for target in 0..film.targets.len() {
            assert!(film.target_mm(target, frame).distance(none.target_mm(target, frame)) < 1e-9);
        }
    }
    // A `[clinical]` in the case file changes nothing on the ideal track, its name in the cache included.
    let mut other = case();
    other.clinical_table.sensor.drift_mm = 17.0;
    assert_eq!(other.hash().unwrap(), case().hash().unwrap());
    assert_ne!(other.on_clinical_track().hash().unwrap(), case().on_clinical_track().hash().unwrap());
}

/// Each row of the picture, alone, changes the pictures and leaves the geometry.
#[test]
fn every_row_of_the_picture_is_seen() {
    let folder = tempfile::tempdir().unwrap();
    let wanted = SimulationSettings { meshes: MeshOutput::EndStates, radiance: RadianceOutput::None, ..small() };
    let film = |name: &str, case: &Case| {
        let out = folder.path().join(name);
        simulate(case, &wanted, &out, &NoProgress).unwrap();
        out
    };
    let none = film("none", &only(&[]));
    let depth = |film: &Path, frame: usize| std::fs::read(film.join(format!("depth/{frame:06}.exr"))).unwrap();
    for row in [
        Condition::LampOffset,
        Condition::LampProfile,
        Condition::Vignette,
        Condition::Noise,
        Condition::Compression,
        Condition::Clipping,
        Condition::LensFilm,
        Condition::Secretions,
        Condition::Bubbles,
        Condition::Defocus,
    ] {
        // In so small a picture few bubbles are seen, and no circle of confusion: more of both, and less is asked of them.
        let strong = clinical(case(), |settings| {
            settings.only = Some(vec![row]);
            settings.picture.bubbles_per_cm *= 20.0;
            settings.picture.aperture_mm *= 10.0;
        });
        let alone = film(row.name(), &strong);
        let off = mean_difference(&images(&none, 6), &images(&alone, 6));
        let least = if matches!(row, Condition::Bubbles | Condition::Defocus) { 0.02 } else { 0.2 };
        assert!(off > least, "{}: {off} codes", row.name());
        assert_eq!(depth(&none, 3), depth(&alone, 3), "{}", row.name());
    }
}

#[test]
fn methods_are_told_what_a_hospital_knows_and_evaluation_the_truth() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("film");
    let film = simulate(&case().on_clinical_track(), &small(), &out, &NoProgress).unwrap();
    let (told, truth) = (film.given_frames(), &film.frames);
    let off: Vec<f64> = told
        .iter()
        .zip(truth)
        .map(|(a, b)| a.world_from_camera.translation.distance(b.world_from_camera.translation))
        .collect();
    assert!(off.iter().all(|&mm| (0.05..8.0).contains(&mm)), "{off:?}");
    let (a, b) = (film.given_camera(), film.camera);
    assert!(a != b && (a.fl_x / b.fl_x - 1.0).abs() < 0.05 && a.fisheye.is_none() && b.fisheye.is_some());
    assert_ne!(film.given_expiration().unwrap().vertices, film.expiration().unwrap().vertices);
    // With hysteresis and lag no phase says where a target is.
    let by_phase = |target: usize, frame: usize| film.targets[target].at(truth[frame].phase);
    let farthest = |frame: usize| {
        (0..film.targets.len()).map(|t| film.target_mm(t, frame).distance(by_phase(t, frame))).fold(0.0, f64::max)
    };
    assert!((0..6).map(farthest).fold(0.0, f64::max) > 0.3);
    let last = film.last_surface().unwrap().unwrap();
    assert_eq!(last.faces, film.inspiration().unwrap().faces);

    // The participant's folder holds what is told and nothing of the truth.
    let handed = participant::write(&film, &folder.path().join("participant")).unwrap();
    handed.check().unwrap();
    assert_eq!(handed.given_camera(), film.given_camera());
    for (a, b) in handed.given_frames().iter().zip(&told) {
        assert!(a.world_from_camera.abs_diff_eq(b.world_from_camera, 1e-9));
    }
    assert_eq!(handed.given_expiration().unwrap(), film.given_expiration().unwrap());
    let names = respire_bench::base::files::all_in(&folder.path().join("participant")).unwrap();
    let hidden = ["clinical", "covered", "told", "by_frame", "last_frame"];
    assert!(names.iter().all(|n| {
        let name = n.strip_prefix(folder.path()).unwrap().to_string_lossy().into_owned();
        hidden.iter().all(|word| !name.contains(word))
    }));
    assert!(Participant::open(&folder.path().join("participant")).is_ok());
    // Damage to what is told is seen.
    std::fs::write(out.join("told/transforms.json"), "{}").unwrap();
    assert!(Sequence::open(&out).unwrap_err().to_string().contains("told/transforms.json"));
}

/// The surfaces of a named folder are what methods are given.
#[test]
fn surfaces_of_an_import_are_handed_out() {
    let folder = tempfile::tempdir().unwrap();
    let surfaces = folder.path().join("import");
    let anatomy = airway::build(&case()).unwrap();
    let moved = |mesh: &TriangleMesh| TriangleMesh {
        vertices: mesh.vertices.iter().map(|v| *v + DVec3::X).collect(),
        faces: mesh.faces.clone(),
    };
    for (name, mesh) in [("inspiration.ply", &anatomy.inspiration), ("expiration.ply", &anatomy.expiration)] {
        respire_bench::formats::mesh::write_ply(&surfaces.join(name), &moved(mesh), &[]).unwrap();
    }
    let case = clinical(case(), |settings| {
        settings.surfaces.folder = Some(surfaces.clone());
        settings.spread = 0.0;
    });
    let film = simulate(&case, &small(), &folder.path().join("film"), &NoProgress).unwrap();
    let given = film.given_inspiration().unwrap();
    assert!((given.vertices[7].x - film.inspiration().unwrap().vertices[7].x - 1.0).abs() < 1e-5);
    // So is its centreline, and not that of the airway as it is.
    let line = film.given_centerline_mm().unwrap();
    let truth = film.centerline().unwrap().points;
    let off = |shift: DVec3| {
        let nearest =
            |p: &DVec3| truth.iter().map(|t| (t.position_mm + shift).distance(*p)).fold(f64::INFINITY, f64::min);
        line.iter().map(nearest).sum::<f64>() / line.len() as f64
    };
    let (own, other) = (off(DVec3::X), off(DVec3::ZERO));
    assert!(own < 0.6 && other > own + 0.1, "{own} {other}");
    // The error of registration comes on top.
    let imported = moved(&anatomy.expiration).vertices;
    let other = film.given_expiration().unwrap().vertices;
    let square = other.iter().zip(&imported).map(|(a, b)| a.distance_squared(*b)).sum::<f64>() / other.len() as f64;
    assert!((square.sqrt() - 1.5).abs() < 0.01, "{}", square.sqrt());
    let hash = case.hash().unwrap();
    respire_bench::formats::mesh::write_ply(&surfaces.join("expiration.ply"), &anatomy.expiration, &[]).unwrap();
    assert_ne!(case.hash().unwrap(), hash, "the hash is of their content");
}
