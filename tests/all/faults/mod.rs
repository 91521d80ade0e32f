//! A disk that fails: the n-th call that opens, writes, syncs or renames a file below the run's folders fails (`fail.c`,
//! preloaded). For every n: exit code 4 and one sentence that names the file, nothing finished that is not whole, and
//! the same command, run again, gives the bytes of a run without faults.
//!
//! A run makes some hundred such calls; some of them are tried here, with `RESPIRE_FAULTS=N` all from the N-th on
//! (`RESPIRE_FAULTS=1`: ten minutes).

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use glam::DVec3;
use respire_bench::airway::case_centerline;
use respire_bench::airway::centerline::{Centerline, CenterlinePoint};
use respire_bench::base::TriangleMesh;
use respire_bench::base::files;
use respire_bench::bench::store::{FinishMarker, MARKER, ProductState, Scrutiny, Store};
use respire_bench::formats::mesh;
use respire_bench::simulate::sequence::{MANIFEST, Sequence};

use crate::binary::{outcome, program};
use crate::skip::skip;

/// How many calls fail, one in each run, unless all are asked for.
const TRIED: usize = 12;
const ENOSPC: i32 = 28;
const EIO: i32 = 5;

const CASE: &str = r#"
id = "tube"
title = "a tube"
seed = 1
camera = { fov_x_deg = 90.0 }
trajectory = { speed_mm_per_s = 10.0, scope_radius_mm = 1.9, seed = 1 }
[anatomy]
kind = "mesh-pair"
inspiration = "inspiration.ply"
expiration = "expiration.ply"
centerline = "centerline.csv"
"#;

const PROFILE: &str = r#"
description = "as cheap as it gets"
methods = ["static-ct"]
seeds = [1]
image_width_px = 16
frames_per_second = 2.0
minimum_frames = 2
minimum_breaths = 0.0
samples_per_pixel = 1
light = "draft"
iteration_scale = 0.01
"#;

/// A closed tube of 60 mm, whose axis bends by `bend_mm` in all.
fn tube(radius_mm: f64, bend_mm: f64) -> TriangleMesh {
    let (around, rings) = (16u32, 24u32);
    let axis = |part: f64| DVec3::new(bend_mm * part * part, 0.0, -60.0 * part);
    let mut surface = TriangleMesh::default();
    for ring in 0..rings {
        for k in 0..around {
            let angle = TAU * f64::from(k) / f64::from(around);
            let spoke = DVec3::new(angle.cos(), angle.sin(), 0.0) * radius_mm;
            surface.vertices.push(axis(f64::from(ring) / f64::from(rings - 1)) + spoke);
        }
    }
    surface.vertices.extend([axis(0.0), axis(1.0)]);
    let (top, bottom, last) = (around * rings, around * rings + 1, around * (rings - 1));
    for k in 0..around {
        let next = (k + 1) % around;
        for ring in 0..rings - 1 {
            let (here, there) = (around * ring, around * (ring + 1));
            surface.faces.push([here + k, here + next, there + next]);
            surface.faces.push([here + k, there + next, there + k]);
        }
        surface.faces.push([top, next, k]);
        surface.faces.push([bottom, last + k, last + next]);
    }
    surface
}

/// A case and a profile that take half a second, and the library that makes calls fail.
struct Workshop {
    folder: tempfile::TempDir,
}

impl Workshop {
    /// Nothing where there is no C compiler.
    fn new() -> Option<Workshop> {
        let workshop = Workshop { folder: tempfile::tempdir().unwrap() };
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/all/faults/fail.c");
        let mut compiler = Command::new("cc");
        compiler.args(["-O1", "-shared", "-fPIC", "-o"]).arg(workshop.path("fail.so")).arg(source).arg("-ldl");
        match compiler.status() {
            Ok(status) => assert!(status.success()),
            Err(_) => {
                skip("compiler", "there is no C compiler");
                return None;
            }
        }
        mesh::write_ply(&workshop.path("inspiration.ply"), &tube(6.0, 0.0), &[]).unwrap();
        mesh::write_ply(&workshop.path("expiration.ply"), &tube(5.4, 5.0), &[]).unwrap();
        let point = |k: u32| CenterlinePoint {
            position_mm: DVec3::new(0.0, 0.0, -1.0 - f64::from(k)),
            radius_mm: 6.0,
            branch: 0,
            generation: 0,
            parent: k.checked_sub(1),
        };
        let line = case_centerline::to_csv(&Centerline { points: (0..58).map(point).collect() });
        for (name, text) in [("centerline.csv", line.as_str()), ("tube.toml", CASE), ("tiny.toml", PROFILE)] {
            fs::write(workshop.path(name), text).unwrap();
        }
        Some(workshop)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The main job in `place`; call number `at` below it fails with `error` (0: none does).
    fn run(&self, place: &Path, at: usize, error: i32) -> Output {
        let mut command = program();
        command.args(["all-cases", "--threads", "1", "--cases"]).arg(self.path("tube.toml"));
        command.arg("--profile").arg(self.path("tiny.toml"));
        command.arg("--out").arg(place.join("reports")).arg("--cache").arg(place.join("cache"));
        command.env("LD_PRELOAD", self.path("fail.so")).env("FAULT_FOLDER", place);
        command.env("FAULT_AT", at.to_string()).env("FAULT_ERROR", error.to_string());
        command.env("FAULT_COUNT", self.path("count")).output().unwrap()
    }

    /// The calls that the last run has made.
    fn calls(&self) -> usize {
        fs::read_to_string(self.path("count")).unwrap().trim().parse().unwrap()
    }
}

fn files_below(folder: &Path, found: &mut Vec<PathBuf>) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries {
        let entry = entry.unwrap();
        match entry.file_type().unwrap().is_dir() {
            true => files_below(&entry.path(), found),
            false => found.push(entry.path()),
        }
    }
}

/// What a run must have made to the byte: everything but times and machines, by name.
fn products(place: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut paths = Vec::new();
    files_below(place, &mut paths);
    let timed = [
        "timing",
        "/plots/",
        "/films/",
        "environment.json",
        "report.",
        "score.json",
        MARKER,
        "comparison",
        "summary",
        "latest",
    ];
    let name = |path: &Path| path.strip_prefix(place).unwrap().to_path_buf();
    let told = |path: &&PathBuf| {
        let name = name(path).to_string_lossy().into_owned();
        // The hashes of a report's tables cover seconds, too.
        let seals_times = name.starts_with("reports/") && name.ends_with("manifest.json");
        !timed.iter().any(|word| name.contains(word)) && !name.ends_with(".tex") && !seals_times
    };
    paths.iter().filter(told).map(|path| (name(path), fs::read(path).unwrap())).collect()
}

/// What has a finish marker is whole, and so is a film with a manifest.
fn assert_nothing_half_finished(cache: &Path, what: &str) {
    let mut found = Vec::new();
    files_below(cache, &mut found);
    let store = Store::look(cache);
    // A marker in a folder that is still being made says nothing.
    let published = found.iter().filter(|path| path.ends_with(MARKER) && !path.to_string_lossy().contains("/.making-"));
    for path in published {
        let marker: FinishMarker = files::read_json(path).unwrap();
        let product = path.parent().unwrap().strip_prefix(cache).unwrap().to_str().unwrap();
        assert_eq!(
            store.state(product, &marker.key, Scrutiny::Content).unwrap(),
            ProductState::Whole,
            "{what}: {product}"
        );
    }
    let Ok(films) = fs::read_dir(cache.join("sequences")) else { return };
    for film in films.map(|entry| entry.unwrap().path()).filter(|path| path.join("film").join(MANIFEST).exists()) {
        let film = Sequence::open(&film.join("film")).unwrap();
        for frame in 0..film.frames.len() {
            film.image(frame).and(film.depth_mm(frame)).unwrap();
        }
    }
}

#[test]
fn every_failing_call_is_one_sentence_and_the_same_command_resumes() {
    let Some(workshop) = Workshop::new() else { return };
    let whole = workshop.path("whole");
    fs::create_dir(&whole).unwrap();
    let (code, _, err) = outcome(workshop.run(&whole, 0, EIO));
    assert_eq!(code, 0, "{err}");
    let (calls, expected) = (workshop.calls(), products(&whole));
    assert!(calls > 200 && expected.len() > 15, "{calls} calls, {} files", expected.len());
    let asked: Option<usize> = std::env::var("RESPIRE_FAULTS").ok().map(|from| from.parse().unwrap());
    // Odd, so that calls of every kind come up.
    let (first, step) = asked.map_or((1, (calls / TRIED) | 1), |from| (from, 1));
    for at in (first..=calls).step_by(step) {
        let error = if at % 2 == 0 { ENOSPC } else { EIO };
        let place = workshop.path(&format!("place-{at}"));
        fs::create_dir(&place).unwrap();
        let (code, out, err) = outcome(workshop.run(&place, at, error));
        let what = format!("call {at} of {calls} fails with {error}");
        let sentences: Vec<&str> = err.lines().filter(|line| line.starts_with("error: ")).collect();
        assert_eq!((code, out.as_str(), sentences.len()), (4, "", 1), "{what}: {err}");
        assert!(sentences[0].contains(place.to_str().unwrap()), "{what}: {err}");
        assert_nothing_half_finished(&place.join("cache"), &what);
        assert!(!place.join("reports/latest").exists(), "{what}: an unfinished report is the latest");

        let (code, _, err) = outcome(workshop.run(&place, 0, EIO));
        assert_eq!(code, 0, "after {what}: {err}");
        let made = products(&place);
        assert_eq!(made.keys().collect::<Vec<_>>(), expected.keys().collect::<Vec<_>>(), "after {what}");
        for (name, bytes) in &expected {
            assert!(&made[name] == bytes, "after {what}: {} differs", name.display());
        }
        fs::remove_dir_all(&place).unwrap();
    }
}
