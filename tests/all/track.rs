//! `track`: live answers are those of the whole run, wherever the pictures come from.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use glam::DMat4;
use respire_bench::simulate::participant::{Given, GivenFrame};
use respire_bench::simulate::sequence::Sequence;

use crate::all_cases::TINY;
use crate::binary::{program, run};
use crate::third_parties::{accepted, refused};

pub const FRAMES: usize = 9;

pub struct Place(tempfile::TempDir);

impl Place {
    pub fn new() -> Self {
        let place = Place(tempfile::tempdir().unwrap());
        let profile = TINY.replace("minimum_frames = 3", &format!("minimum_frames = {FRAMES}"));
        fs::write(place.path("tiny.toml"), profile).unwrap();
        accepted(run(&["simulate", "case1", "--profile", &place.text("tiny.toml"), "--out", &place.text("films")]));
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    pub fn words(&self, more: &[&str]) -> Vec<String> {
        let (film, profile) = (self.text("films/case1"), self.text("tiny.toml"));
        let words = ["track", "--sequence", &film, "--profile", &profile];
        words.iter().chain(more).map(|word| (*word).to_owned()).collect()
    }

    fn track(&self, more: &[&str]) -> (i32, String, String) {
        let words = self.words(more);
        run(&words.iter().map(String::as_str).collect::<Vec<_>>())
    }

    fn image(&self, frame: usize) -> PathBuf {
        self.path(&format!("films/case1/images/{frame:06}.png"))
    }

    /// The film's pictures as ffmpeg's raw frames.
    pub fn raw(&self) -> Vec<u8> {
        (0..FRAMES).flat_map(|frame| image::open(self.image(frame)).unwrap().into_rgb8().into_raw()).collect()
    }

    /// `track` with `input` on standard input.
    fn piped(&self, input: &[u8], more: &[&str]) -> (i32, String, String) {
        let mut command = assert_cmd::Command::from_std(program());
        let output = command.args(self.words(more)).write_stdin(input).output().unwrap();
        let text = |bytes| String::from_utf8(bytes).unwrap();
        (output.status.code().unwrap(), text(output.stdout), text(output.stderr))
    }
}

/// The answers without their latencies.
fn answers(lines: &str) -> Vec<serde_json::Value> {
    let answer = |line: &str| {
        let mut value: serde_json::Value = serde_json::from_str(line).unwrap();
        assert!(value.as_object_mut().unwrap().remove("latency_ms").unwrap().as_f64().unwrap() > 0.0);
        value
    };
    lines.lines().map(answer).collect()
}

#[test]
fn live_answers_are_those_of_the_whole_run_wherever_pictures_come_from() {
    let place = Place::new();
    let (code, out, err) = place.track(&[]);
    assert_eq!(code, 0, "{err}");
    assert!(err.contains("9 frames answered, 0 left out; latency "), "{err}");
    let live = answers(&out);
    assert_eq!(live.len(), FRAMES);

    // The whole run's phases, written with fewer digits.
    let (film, profile, whole) = (place.text("films/case1"), place.text("tiny.toml"), place.text("whole"));
    let words = ["run", "--sequence", &film, "--method", "ours-gn", "--profile", &profile, "--out", &whole];
    accepted(run(&words));
    let table = fs::read_to_string(place.path("whole/phase.csv")).unwrap();
    let mut rows = csv::Reader::from_reader(table.as_bytes());
    let column = rows.headers().unwrap().iter().position(|name| name == "phase").unwrap();
    for (record, answer) in rows.records().zip(&live) {
        let phase: f64 = record.unwrap()[column].parse().unwrap();
        assert!((phase - answer["phase"].as_f64().unwrap()).abs() < 1e-6, "{answer}: {phase}");
    }

    // Targets move by the phase, and their covariance has the length of that motion.
    let [first, last] = [&live[0], &live[FRAMES - 1]];
    assert_eq!(first["state"], "tracking", "{first}");
    let trace = |answer: &serde_json::Value| {
        (0..3).map(|k| answer["target_covariance_mm2"][0][k][k].as_f64().unwrap()).sum::<f64>()
    };
    let deviation = |answer: &serde_json::Value| answer["phase_deviation"].as_f64().unwrap();
    let motion_mm = |answer| trace(answer).sqrt() / deviation(answer);
    assert!(motion_mm(first) > 0.1 && (motion_mm(first) - motion_mm(last)).abs() < 1e-6);

    // The same pictures through a pipe and in a folder.
    let (code, out, err) = place.piped(&place.raw(), &["--raw", "--every-frame"]);
    assert_eq!(code, 0, "{err}");
    assert!(answers(&out) == live, "a pipe gives other answers than the film");
    fs::create_dir(place.path("camera")).unwrap();
    let mut command = program();
    let folder = place.text("camera");
    command.args(place.words(&["--images", &folder, "--every-frame", "--patience-s", "5"]));
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    for frame in 0..FRAMES {
        std::thread::sleep(Duration::from_millis(20));
        // As a slow writer does it.
        let bytes = fs::read(place.image(frame)).unwrap();
        let target = place.path(&format!("camera/{frame:06}.png"));
        fs::write(&target, &bytes[..bytes.len() / 2]).unwrap();
        fs::write(&target, &bytes).unwrap();
    }
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(answers(std::str::from_utf8(&output.stdout).unwrap()) == live, "a folder gives other answers");

    // Frames that come faster than they are answered are left out, and the numbers say which.
    let (code, out, err) = place.piped(&place.raw(), &["--raw"]);
    assert_eq!(code, 0, "{err}");
    let some = answers(&out);
    let seen: u64 = some.iter().map(|answer| 1 + answer["left_out"].as_u64().unwrap()).sum();
    assert_eq!((some[0]["frame"].as_u64(), seen), (Some(0), FRAMES as u64), "{out}");
    assert_eq!(some.last().unwrap()["frame"], FRAMES - 1);

    // What cannot be is refused.
    let cut = &place.raw()[..10];
    refused(place.piped(cut, &["--raw"]), 4, &["frame 0", "10 of"]);
    refused(place.piped(&[], &["--raw"]), 4, &["standard input: no picture came"]);
    fs::create_dir(place.path("dark")).unwrap();
    let dark = place.text("dark");
    let in_dark = ["--images", &dark, "--patience-s", "0.2"];
    refused(place.track(&in_dark), 4, &["dark: no picture appeared in it"]);
    // By name, 10 stands before 2.
    for name in ["0", "1", "10", "2"] {
        fs::copy(place.image(0), place.path(&format!("dark/{name}.png"))).unwrap();
    }
    let (code, _, err) = place.track(&in_dark);
    assert!(code == 4 && err.contains("dark/10.png: comes before picture 2 by its name"), "{code} {err}");
    refused(place.track(&["--method", "ours"]), 2, &["`ours` takes whole films"]);
    fs::write(place.path("poses"), "{}\n").unwrap();
    refused(place.track(&["--poses", &place.text("poses")]), 4, &["poses", "line 1", "is no pose"]);
    refused(place.track(&["--poses", "/dev/zero"]), 4, &["/dev/zero: line 1: does not end within 64 KiB"]);

    // Glare is dark in the mask, and the wall beside it is not.
    let mut raw = place.raw();
    let shown = image::open(place.image(0)).unwrap();
    let (width, height) = (shown.width() as usize, shown.height() as usize);
    for y in 0..height / 4 {
        raw[3 * y * width..3 * (y * width + width / 4)].fill(255);
    }
    let masks = place.text("masks");
    let (code, _, err) = place.piped(&raw, &["--raw", "--every-frame", "--method", "ours-nav", "--masks", &masks]);
    assert_eq!(code, 0, "{err}");
    assert_eq!(fs::read_dir(&masks).unwrap().count(), FRAMES);
    let mask = image::open(place.path("masks/000000.png")).unwrap().into_luma8();
    assert_eq!((mask.width() as usize, mask.height() as usize), (width, height));
    let (mut glare, mut wall) = (0, 0);
    for (x, y, value) in mask.enumerate_pixels() {
        let is_glare = (x as usize) < width / 4 && (y as usize) < height / 4;
        *(if is_glare { &mut glare } else { &mut wall }) += usize::from(value.0[0] > 0);
    }
    assert!(glare == 0 && wall > width * height / 4, "{glare} pixels of glare, {wall} of the wall");
    refused(place.track(&["--masks", &masks]), 2, &["`ours-gn` does not tell the wall"]);

    // Poses through a pipe of their own.
    let film = Sequence::open(Path::new(&film)).unwrap();
    let line = |frame: &GivenFrame| {
        let rows = DMat4::from(frame.world_from_camera).transpose().to_cols_array_2d();
        serde_json::json!({ "time_s": frame.time_s, "world_from_camera": rows }).to_string() + "\n"
    };
    let lines: String = film.given_frames().iter().map(line).collect();
    let pipe = place.path("sensor");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let (code, out, err) = std::thread::scope(|scope| {
        scope.spawn(|| fs::write(&pipe, lines).unwrap());
        place.track(&["--poses", &place.text("sensor")])
    });
    assert_eq!(code, 0, "{err}");
    assert!(answers(&out) == live, "a pipe of poses gives other answers than the film");
}
