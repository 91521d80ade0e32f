//! Films: same bytes for any number of threads, in one go or resumed; truth that agrees with itself; damage that is named.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use glam::{DVec2, DVec3};
use respire_bench::airway::case::Case;
use respire_bench::base::{ErrorKind, NoProgress, Progress, TriangleMesh, mesh};
use respire_bench::simulate::sequence::Sequence;
use respire_bench::simulate::truth::{TruthMap, TruthSet};
use respire_bench::simulate::{FilmLight, MeshOutput, RadianceOutput, SimulationSettings, simulate};

use crate::cases::case_path;

pub fn small() -> SimulationSettings {
    SimulationSettings {
        width_px: 32,
        height_px: 32,
        frames_per_second: 2.0,
        frames: 6,
        samples_per_pixel: 2,
        meshes: MeshOutput::EveryFrame,
        radiance: RadianceOutput::Exr,
        truth: TruthSet::default(),
        light: FilmLight::Draft,
    }
}

pub fn case() -> Case {
    Case::load(&case_path(1)).unwrap()
}

/// Writes the hashes of the files as they are now into the manifest, as somebody would who forges a film.
pub fn seal(film: &Path) {
    let path = film.join("manifest.json");
    let mut manifest: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    for (name, hash) in manifest["files"].as_object_mut().unwrap() {
        *hash = respire_bench::base::hash::of_file(&film.join(name)).unwrap().into();
    }
    fs::write(&path, serde_json::to_vec(&manifest).unwrap()).unwrap();
}

pub fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut open = vec![folder.to_path_buf()];
    while let Some(next) = open.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                found.insert(path.strip_prefix(folder).unwrap().display().to_string(), fs::read(&path).unwrap());
            }
        }
    }
    found
}

pub fn assert_same(a: &Path, b: &Path) {
    let (a, b) = (contents(a), contents(b));
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    for (name, bytes) in &a {
        assert!(bytes == &b[name], "{name} differs");
    }
}

/// Distance from `point` to the nearest triangle, by trying them all (Ericson, Real-Time Collision Detection, 5.1.5, by
/// way of the plane and the three edges).
pub fn off_surface(surface: &TriangleMesh, point: DVec3) -> f64 {
    let to_edge = |a: DVec3, b: DVec3| {
        let t = ((point - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
        point.distance(a.lerp(b, t))
    };
    let to_face = |f: usize| {
        let [a, b, c] = surface.corners(f);
        let normal = (b - a).cross(c - a).normalize();
        let inside = [(a, b), (b, c), (c, a)].iter().all(|(p, q)| (*q - *p).cross(point - *p).dot(normal) >= 0.0);
        if inside { (point - a).dot(normal).abs() } else { to_edge(a, b).min(to_edge(b, c)).min(to_edge(c, a)) }
    };
    (0..surface.faces.len()).map(to_face).fold(f64::INFINITY, f64::min)
}

/// Stops the work after a number of frames, planned or filmed.
struct StopAfter(AtomicUsize);

impl Progress for StopAfter {
    fn advance(&self, _done: usize, _total: usize) {}

    fn cancelled(&self) -> bool {
        self.0.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |left| left.checked_sub(1)).is_err()
    }
}

#[test]
fn the_bytes_do_not_depend_on_threads_or_interruptions() {
    let wanted = SimulationSettings { truth: TruthMap::ALL.into_iter().collect(), ..small() };
    let folder = tempfile::tempdir().unwrap();
    let (whole, single, resumed) = (folder.path().join("a"), folder.path().join("b"), folder.path().join("c"));
    simulate(&case(), &wanted, &whole, &NoProgress).unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| simulate(&case(), &wanted, &single, &NoProgress)).unwrap();
    assert_same(&whole, &single);

    // All are planned, and two filmed.
    let stop = StopAfter(AtomicUsize::new(wanted.frames + 2));
    let stopped = simulate(&case(), &wanted, &resumed, &stop).unwrap_err();
    assert_eq!(stopped.kind(), ErrorKind::Interrupted);
    assert!(Sequence::open(&resumed).unwrap_err().to_string().contains("not finished"));
    // A frame whose image is missing counts as not made, whatever else of it is there.
    fs::remove_file(resumed.join("images/000001.png")).unwrap();
    // And what a kill leaves of a file that was being written is no part of the film.
    fs::write(resumed.join("depth/.Ab12cd.tmp"), "half").unwrap();
    simulate(&case(), &wanted, &resumed, &NoProgress).unwrap();
    assert_same(&whole, &resumed);

    // Nothing is done twice: the same call writes no file again.
    let written = || {
        let names = contents(&resumed).into_keys();
        names.map(|name| resumed.join(name).metadata().unwrap().modified().unwrap()).collect::<Vec<_>>()
    };
    let before = written();
    simulate(&case(), &wanted, &resumed, &NoProgress).unwrap();
    assert_eq!(written(), before);
    // Another content replaces the folder whole.
    let shorter = SimulationSettings { frames: 3, meshes: MeshOutput::EndStates, ..small() };
    assert_eq!(simulate(&case(), &shorter, &resumed, &NoProgress).unwrap().frames.len(), 3);
    assert!(!resumed.join("images/000005.png").exists());
}

/// Hears what it is told.
#[derive(Default)]
struct Listener {
    notes: Mutex<Vec<String>>,
}

impl Progress for Listener {
    fn advance(&self, _done: usize, _total: usize) {}

    fn cancelled(&self) -> bool {
        false
    }

    fn note(&self, sentence: &str) {
        self.notes.lock().unwrap().push(sentence.to_owned());
    }
}

/// How many frames a film took from its neighbours, by what it said.
fn copied(listener: &Listener) -> usize {
    let notes = listener.notes.lock().unwrap();
    let number = |note: &String| note.split_once(" frames are those of")?.0.rsplit(' ').next()?.parse::<usize>().ok();
    notes.iter().filter_map(number).sum()
}

#[test]
fn another_registration_of_a_film_renders_no_frame_again() {
    let settings = SimulationSettings { truth: TruthMap::ALL.into_iter().collect(), ..small() };
    let wrong = Case { registration_error_mm: 1.0, ..case() };
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    simulate(&case(), &settings, &at("case1-exact"), &NoProgress).unwrap();
    // Elsewhere there is nothing to copy.
    simulate(&wrong, &settings, &at("elsewhere/case1-wrong"), &NoProgress).unwrap();

    let listener = Listener::default();
    simulate(&wrong, &settings, &at("case1-wrong"), &listener).unwrap();
    assert_eq!(copied(&listener), 6);
    assert_same(&at("elsewhere/case1-wrong"), &at("case1-wrong"));

    // A frame that is no longer what it was is rendered, and so are all of another film.
    fs::remove_dir_all(at("case1-exact")).unwrap();
    fs::write(at("case1-wrong/depth/000002.exr"), "damaged").unwrap();
    let listener = Listener::default();
    let worse = Case { registration_error_mm: 2.0, ..case() };
    simulate(&worse, &settings, &at("case1-worse"), &listener).unwrap();
    assert_eq!(copied(&listener), 5);
    assert_eq!(
        contents(&at("case1-worse"))["depth/000002.exr"],
        contents(&at("elsewhere/case1-wrong"))["depth/000002.exr"]
    );
    let listener = Listener::default();
    let darker = Case { light_intensity: case().light_intensity.map(|v| 0.5 * v), ..case() };
    simulate(&darker, &small(), &at("case1-darker"), &listener).unwrap();
    assert_eq!(copied(&listener), 0);
}

#[test]
fn truth_agrees_with_itself_and_the_picture_is_exposed() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("film");
    let sequence = simulate(&case(), &small(), &out, &NoProgress).unwrap();
    assert_eq!((sequence.frames.len(), sequence.case_id.as_str()), (6, "case1"));
    let (rest, other) = (sequence.inspiration().unwrap(), sequence.expiration().unwrap());
    assert_eq!(rest.faces, other.faces);
    for (index, frame) in sequence.frames.iter().enumerate() {
        let image = sequence.image(index).unwrap();
        let mean = image.data.iter().map(|&v| v as f64 / 255.0).sum::<f64>() / image.data.len() as f64;
        assert!((0.25..0.65).contains(&mean), "frame {index} has mean brightness {mean}");
        let washed_out = image.data.iter().filter(|&&v| v == 255).count() as f64 / image.data.len() as f64;
        assert!(washed_out < 0.2, "frame {index}: {washed_out} of the values are at the limit");
        // Every point of the depth image lies on the deformed surface.
        let depth = sequence.depth_mm(index).unwrap();
        let now = TriangleMesh {
            vertices: mesh::interpolate(&rest.vertices, &other.vertices, frame.phase),
            faces: rest.faces.clone(),
        };
        for row in (0..32).step_by(5) {
            for column in (0..32).step_by(5) {
                let z = depth.pixel(column, row)[0] as f64;
                assert!(z > 0.0, "frame {index}: a ray leaves the closed airway");
                let ray = sequence.camera.direction(DVec2::new(column as f64 + 0.5, row as f64 + 0.5));
                let world = frame.world_from_camera.transform_point3(ray * (z / ray.z));
                let miss = off_surface(&now, world);
                assert!(miss < 2e-3, "frame {index}, pixel {column} {row}: {miss} mm off the surface");
            }
        }
        let frame_mesh = respire_bench::formats::mesh::read(&out.join(format!("mesh/frame_{index:06}.ply"))).unwrap();
        let worst = frame_mesh.vertices.iter().zip(&now.vertices).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        assert!(worst < 1e-4, "{worst}");
    }
    assert!(sequence.centerline().unwrap().points.len() > 100);
    let manifest: serde_json::Value = serde_json::from_slice(&fs::read(out.join("manifest.json")).unwrap()).unwrap();
    assert_eq!(manifest["files"].as_object().unwrap().len(), 11 + 4 * 6);
    assert_eq!(manifest["hash"], sequence.hash);
}

#[test]
fn damaged_or_foreign_folders_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("film");
    let settings = SimulationSettings { frames: 2, meshes: MeshOutput::EndStates, ..small() };
    let sequence = simulate(&case(), &settings, &out, &NoProgress).unwrap();
    fs::remove_file(out.join("depth/000001.exr")).unwrap();
    assert!(sequence.depth_mm(1).unwrap_err().to_string().contains("000001.exr"));
    fs::write(out.join("images/000000.png"), "no image").unwrap();
    assert!(sequence.image(0).unwrap_err().to_string().contains("000000.png"));
    let text = fs::read_to_string(out.join("transforms.json")).unwrap();
    fs::write(out.join("transforms.json"), text.replacen("breathing_phase", "phase", 1)).unwrap();
    let error = Sequence::open(&out).unwrap_err().to_string();
    assert!(error.contains("transforms.json") && error.contains("manifest.json"), "{error}");
    fs::write(out.join("depth/000001.exr"), "no depth").unwrap();
    seal(&out);
    let error = Sequence::open(&out).unwrap_err().to_string();
    assert!(error.contains("transforms.json") && error.contains("frame 0"), "{error}");
    assert!(Sequence::open(&folder.path().join("no")).unwrap_err().to_string().contains("no such folder"));
    let foreign = folder.path().join("holiday");
    fs::create_dir(&foreign).unwrap();
    fs::write(foreign.join("photo.jpg"), "x").unwrap();
    assert!(Sequence::open(&foreign).unwrap_err().to_string().contains("not a sequence folder"));
    let refused = simulate(&case(), &settings, &foreign, &NoProgress).unwrap_err();
    assert!(refused.to_string().contains("nothing is overwritten"), "{refused}");
    assert!(foreign.join("photo.jpg").exists());
    // A case that cannot be filmed leaves nothing behind.
    let mut wide = case();
    wide.trajectory.scope_radius_mm = 20.0;
    let nowhere = folder.path().join("nowhere");
    simulate(&wide, &settings, &nowhere, &NoProgress).unwrap_err();
    assert!(!nowhere.exists());
}

/// An old manifest over new frames would say that they are of the old film.
#[test]
fn a_manifest_that_cannot_be_removed_stops_the_filming() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path();
    fs::write(out.join("plan.json"), r#"{"hash": "of another film"}"#).unwrap();
    // Nobody, root neither, removes a folder as a file.
    fs::create_dir(out.join("manifest.json")).unwrap();
    let error = simulate(&case(), &small(), out, &NoProgress).unwrap_err().to_string();
    assert!(error.contains("manifest.json: removing failed"), "{error}");
    assert!(!out.join("images").exists());
}
