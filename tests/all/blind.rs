//! A blind comparison: what participants get holds what a method may see and nothing else, and its scores are those of
//! the whole film.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use respire_bench::simulate::sequence::Sequence;

use crate::all_cases::TINY;
use crate::binary::run;
use crate::simulate::contents;
use crate::third_parties::{accepted, refused};

/// Frames of the film: two of them have a second camera.
const FRAMES: usize = 17;

struct Place(tempfile::TempDir);

impl Place {
    /// Case 1, filmed apart.
    fn new() -> Self {
        let place = Place(tempfile::tempdir().unwrap());
        let profile = TINY.replace("minimum_frames = 3", &format!("minimum_frames = {FRAMES}"));
        fs::write(place.path("tiny.toml"), profile).unwrap();
        accepted(place.film());
        place
    }

    fn film(&self) -> (i32, String, String) {
        run(&["simulate", "case1", "--profile", &self.text("tiny.toml"), "--blind", &self.text("blind")])
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    fn answer(&self, method: &str, film: &str, out: &str) -> (i32, String, String) {
        let (profile, film, out) = (self.text("tiny.toml"), self.text(film), self.text(out));
        run(&["run", "--sequence", &film, "--method", method, "--profile", &profile, "--out", &out])
    }
}

/// Value and status of each metric but the times.
fn numbers(json: &str) -> BTreeMap<String, (Option<f64>, String)> {
    let score: serde_json::Value = serde_json::from_str(json).unwrap();
    let metrics = score["metrics"].as_array().unwrap().iter();
    let of = |m: &serde_json::Value| {
        let text = |key: &str| m[key].as_str().unwrap().to_owned();
        (text("metric"), (m["value"].as_f64(), text("status")))
    };
    metrics.map(of).filter(|(metric, _)| !metric.starts_with("time")).collect()
}

fn without_times(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    contents(folder).into_iter().filter(|(name, _)| name != "timing.json").collect()
}

#[test]
fn methods_answer_the_participants_folder_as_they_answer_the_film() {
    let place = Place::new();
    let profile = place.text("tiny.toml");
    for method in ["ours", "ours-gn-pose", "pose-only"] {
        let answer = format!("{method}-blind");
        accepted(place.answer(method, "blind/participant", &answer));
        accepted(place.answer(method, "blind/truth", method));
        let (blind, seeing) = (without_times(&place.path(&answer)), without_times(&place.path(method)));
        assert_eq!(blind.keys().collect::<Vec<_>>(), seeing.keys().collect::<Vec<_>>());
        for (name, bytes) in &blind {
            assert!(bytes == &seeing[name], "{method}: {name} differs");
        }
        let folders = ["--truth", &place.text("blind/truth"), "--predictions", &place.text(&answer), "--json"];
        let scored = accepted(run(&[&["evaluate"][..], &folders].concat()));
        let cell = ["run", "--case", "case1", "--method", method, "--profile", &profile, "--json", "--cache"];
        let whole = accepted(run(&[&cell[..], &[&place.text("cache")]].concat()));
        let (blind, whole) = (numbers(&scored), numbers(&whole));
        assert_eq!(blind, whole, "{method}");
        assert!(blind["novel_psnr_db"].0.is_some() && blind["target_mean_mm"].0.is_some(), "{blind:?}");
    }
    // A participant checks an answer without the truth, and what is told the truth cannot answer.
    let check = |answer: &str| run(&["check", &place.text(answer), "--sequence", &place.text("blind/participant")]);
    assert!(accepted(check("ours-blind")).contains("17 frames"));
    fs::remove_file(place.path("ours-blind/novel/000015.png")).unwrap();
    refused(check("ours-blind"), 4, &["novel/000015.png", "is missing"]);
    refused(place.answer("oracle-phase", "blind/participant", "oracle"), 4, &["true phase", "participant"]);
    refused(place.answer("ours", "blind/participant", "ours"), 4, &["is not empty"]);
    let folders = ["--truth", &place.text("blind/participant"), "--predictions", &place.text("ours")];
    refused(run(&[&["evaluate"][..], &folders].concat()), 4, &["holds no truth"]);
    let two = ["simulate", "case1", "case2", "--profile", &profile, "--blind", &place.text("two")];
    refused(run(&two), 2, &["--blind takes one case"]);
}

#[test]
fn the_participants_folder_tells_nothing_of_the_truth() {
    let place = Place::new();
    let (participant, truth) = (place.path("blind/participant"), place.path("blind/truth"));
    let given = contents(&participant);
    let fixed = [
        "participant.json",
        "FORMAT.md",
        "transforms.json",
        "transforms_novel.json",
        "centerline.csv",
        "targets.csv",
        "mesh/inspiration.ply",
        "mesh/expiration.ply",
        "depth/000000.exr",
    ];
    let images = (0..FRAMES).map(|frame| format!("images/{frame:06}.png"));
    let allowed: BTreeSet<String> = fixed.iter().map(|name| name.to_string()).chain(images).collect();
    let names: BTreeSet<String> = given.keys().cloned().collect();
    assert_eq!(names, allowed, "and mask.png, were there a mask");

    // No file of the truth but those that are given on purpose, and no word or number of it.
    let film = contents(&truth);
    let shared = |name: &str| allowed.contains(name) && !name.ends_with(".json");
    for (name, bytes) in film.iter().filter(|(name, _)| !shared(name)) {
        assert!(given.values().all(|other| other != bytes), "{name} is among what participants get");
    }
    let manifest: serde_json::Value = serde_json::from_slice(&film["manifest.json"]).unwrap();
    let sequence = Sequence::open(&truth).unwrap();
    let mut secrets: Vec<String> = ["breathing_phase", ",phase,", "\"phase\"", "exposure", "white_balance", "gain"]
        .into_iter()
        .map(str::to_owned)
        .collect();
    secrets.extend(["case_id", "\"seed\"", "case1", "simulator"].map(str::to_owned));
    secrets.extend(["hash", "case_hash", "film_hash"].map(|key| manifest[key].as_str().unwrap().to_owned()));
    secrets.extend(sequence.frames.iter().map(|f| f.phase.to_string()).filter(|text| text.len() > 6));
    secrets.extend(sequence.frames.iter().map(|f| f.gain.to_string()).filter(|text| text.len() > 6));
    // Whoever knows the waveform's formula could read the phase from all digits of its period.
    let head: serde_json::Value = serde_json::from_slice(&given["participant.json"]).unwrap();
    let [told, period] = [&head, &manifest].map(|json| json["breathing_period_s"].as_f64().unwrap());
    assert!((told * 10.0).fract() == 0.0 && (told / period - 1.0).abs() < 0.05, "{told} {period}");
    secrets.push(period.to_string());
    for target in &sequence.targets {
        secrets.extend(target.expiration_mm.to_array().map(|v| v.to_string()));
    }
    assert!(secrets.len() > 30);
    let hidden = manifest["files"].as_object().unwrap().iter().filter(|(name, _)| !shared(name));
    secrets.extend(hidden.map(|(_, hash)| hash.as_str().unwrap().to_owned()));
    for (name, bytes) in &given {
        for secret in &secrets {
            let is_there = bytes.windows(secret.len()).any(|window| window == secret.as_bytes());
            assert!(!is_there, "{name} holds {secret}");
        }
    }

    // Times of change tell no order, and the same film gives the same bytes.
    let mut times = BTreeSet::new();
    let mut open = vec![participant.clone()];
    while let Some(path) = open.pop() {
        times.insert(path.metadata().unwrap().modified().unwrap());
        if path.is_dir() {
            open.extend(fs::read_dir(&path).unwrap().map(|entry| entry.unwrap().path()));
        }
    }
    assert_eq!(times.len(), 1, "{times:?}");
    accepted(place.film());
    assert!(contents(&participant) == given);

    // Soundness is checked, and what does not belong there is refused.
    let check = || run(&["check", &place.text("blind/participant")]);
    assert!(accepted(check()).contains("a sound participant's folder of 17 frames"));
    fs::write(participant.join("phase.csv"), "frame,phase\n").unwrap();
    refused(check(), 4, &["participant/phase.csv", "is no file of a participant's folder"]);
    refused(place.film(), 4, &["participant/phase.csv", "move it elsewhere"]);
    fs::remove_file(participant.join("phase.csv")).unwrap();
    fs::copy(participant.join("images/000001.png"), participant.join("images/000002.png")).unwrap();
    refused(check(), 4, &["images/000002.png", "participant.json"]);
    refused(place.answer("pose-only", "blind/participant", "p"), 4, &["images/000002.png"]);
    // A folder of somebody else's is not written over.
    fs::remove_file(participant.join("participant.json")).unwrap();
    refused(place.film(), 4, &["blind/participant", "nothing is overwritten"]);
}
