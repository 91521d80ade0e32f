//! Predictions of many films at once: a row per film, and a film that fails loses no other. And what `check` warns of.

use std::fs;
use std::path::{Path, PathBuf};

use respire_bench::airway::case::Case;
use respire_bench::base::{Image, NoProgress};
use respire_bench::formats::{exr, mesh, png};
use respire_bench::simulate::sequence::Sequence;
use respire_bench::simulate::{MeshOutput, RadianceOutput, SimulationSettings, simulate};

use crate::binary::run;
use crate::cases::case_path;
use crate::simulate::small;
use crate::third_parties::{accepted, column, refused};

/// Films of three cases in one folder, and a prediction of each in another.
struct Place(tempfile::TempDir);

const CASES: [usize; 3] = [1, 2, 5];

impl Place {
    fn new() -> Self {
        let place = Place(tempfile::tempdir().unwrap());
        for number in CASES {
            let settings = SimulationSettings {
                frames: 2,
                meshes: MeshOutput::EndStates,
                radiance: RadianceOutput::None,
                ..small()
            };
            let case = Case::load(&case_path(number)).unwrap();
            let film = simulate(&case, &settings, &place.path(&format!("films/{}", case.id)), &NoProgress).unwrap();
            answer(&film, &place.path(&format!("mine/{}", case.id)));
        }
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    fn check(&self) -> String {
        accepted(run(&["check", &self.text("mine/case1"), "--sequence", &self.text("films/case1")]))
    }
}

/// Grey pictures, the true depth, the true phase.
fn answer(film: &Sequence, folder: &Path) {
    let camera = film.camera;
    let mut phases = "frame,phase\n".to_owned();
    for (frame, record) in film.frames.iter().enumerate() {
        let grey = Image::filled(camera.width as usize, camera.height as usize, 3, 90 + frame as u8);
        png::write_rgb(&folder.join(format!("color/{frame:06}.png")), &grey).unwrap();
        exr::write_depth(&folder.join(format!("depth/{frame:06}.exr")), &film.depth_mm(frame).unwrap()).unwrap();
        phases += &format!("{frame},{}\n", record.phase);
    }
    fs::write(folder.join("phase.csv"), phases).unwrap();
    fs::write(folder.join("prediction.json"), "{\"method\": \"mine\"}").unwrap();
}

#[test]
fn many_films_give_a_row_each_and_one_that_fails_is_named() {
    let place = Place::new();
    let evaluate = |films: &[&str], predictions: &[&str], more: &[&str]| {
        let films: Vec<String> = films.iter().map(|name| place.text(name)).collect();
        let predictions: Vec<String> = predictions.iter().map(|name| place.text(name)).collect();
        let mut words = vec!["evaluate", "--sequence"];
        words.extend(films.iter().map(String::as_str));
        words.push("--predictions");
        words.extend(predictions.iter().map(String::as_str));
        words.extend(more);
        run(&words)
    };
    let rows = |folder: &str| column(&place.path(folder).join("comparison.csv"), "case_id");
    let cases = |folder: &str| rows(folder).into_iter().map(|(_, case)| case).collect::<Vec<_>>();
    let out = place.text("report");
    let said = accepted(evaluate(&["films"], &["mine"], &["--out", &out]));
    assert_eq!(cases("report"), ["case1", "case2", "case5"]);
    for case in ["case1", "case2", "case5", "mean of 3 cases"] {
        assert!(said.contains(case), "{said}");
    }
    // One by one, in any order, each with its own folder: the same numbers.
    let films = ["films/case5", "films/case1", "films/case2"];
    accepted(evaluate(&films, &["mine/case5", "mine/case1", "mine/case2"], &["--out", &place.text("again")]));
    let numbers = |folder: &str| {
        let mut values = column(&place.path(folder).join("comparison.csv"), "psnr_db");
        values.sort();
        values
    };
    assert_eq!(numbers("report"), numbers("again"));
    let all: serde_json::Value = serde_json::from_str(&accepted(evaluate(&["films"], &["mine"], &["--json"]))).unwrap();
    assert_eq!(all.as_array().unwrap().len(), 3);
    // What one film alone gives is what it was: one object.
    let one = accepted(evaluate(&["films/case2"], &["mine/case2"], &["--json"]));
    let one: serde_json::Value = serde_json::from_str(&one).unwrap();
    assert_eq!((one["case_id"].as_str(), one["metrics"] == all[1]["metrics"]), (Some("case2"), true));
    assert_eq!(
        serde_json::from_str::<serde_json::Value>(&accepted(evaluate(&["films/case2"], &["mine"], &["--json"])))
            .unwrap(),
        one
    );

    // A link to a film goes by its own name.
    fs::create_dir(place.path("links")).unwrap();
    std::os::unix::fs::symlink(place.path("films/case2"), place.path("links/mine2")).unwrap();
    fs::create_dir(place.path("by-link")).unwrap();
    std::os::unix::fs::symlink(place.path("mine/case2"), place.path("by-link/mine2")).unwrap();
    let linked = accepted(evaluate(&["links/mine2"], &["by-link"], &["--json"]));
    assert_eq!(serde_json::from_str::<serde_json::Value>(&linked).unwrap(), one);

    // One fails: it is named, the others have their rows, and the exit code says so.
    fs::remove_file(place.path("mine/case2/color/000001.png")).unwrap();
    let (code, said, err) = evaluate(&["films"], &["mine"], &["--out", &place.text("partly")]);
    assert_eq!(code, 1, "{err}");
    assert!(err.contains("case2/color/000001.png: is missing") && err.contains("1 of 3 films failed, first "), "{err}");
    let words: Vec<Vec<&str>> = said.lines().map(|line| line.split_whitespace().collect()).collect();
    assert!(words.contains(&vec!["case2", "failed"]), "{said}");
    assert_eq!(cases("partly"), ["case1", "case2", "case5"]);
    let sound = |folder: &str| numbers(folder).into_iter().filter(|(_, v)| !v.is_empty()).collect::<Vec<_>>();
    assert_eq!((sound("partly").len(), sound("report").len()), (2, 3));
    // Twice the film that fails would be twice its case.
    let twice = evaluate(&["films/case2", "films/case1", "films/case2"], &["mine"], &[]);
    refused(twice, 4, &["is of case2", "one film of a case"]);
    // A film that is none at all, and a missing folder.
    fs::remove_dir_all(place.path("mine/case2")).unwrap();
    let (code, _, err) = evaluate(&["films/case1", "nowhere"], &["mine"], &[]);
    assert_eq!(code, 1);
    assert!(err.contains("nowhere: there is no such folder") && err.contains("1 of 2 films failed"), "{err}");
    refused(
        evaluate(&["films/case1", "films/case5"], &["mine/case1", "mine/case5", "mine"], &[]),
        2,
        &["3 folders for 2"],
    );
    refused(evaluate(&["films/case1", "films/case1"], &["mine"], &[]), 4, &["is of case1", "one film of a case"]);
    // Two methods on one film are two rows of one case.
    answer(&Sequence::open(&place.path("films/case1")).unwrap(), &place.path("other/case1"));
    fs::write(place.path("other/case1/prediction.json"), "{\"method\": \"other\"}").unwrap();
    let said = accepted(evaluate(
        &["films/case1", "films/case1"],
        &["mine/case1", "other/case1"],
        &["--out", &place.text("two")],
    ));
    assert!(said.contains("Comparison (one case)") && said.contains("case1 other"), "{said}");
    assert_eq!(cases("two"), ["case1", "case1"]);
    // A table holds one track.
    let clinical = Case::load(&case_path(2)).unwrap().on_clinical_track();
    let film = simulate(&clinical, &small(), &place.path("clinical"), &NoProgress).unwrap();
    answer(&film, &place.path("mine/clinical"));
    let both = evaluate(&["films/case1", "clinical"], &["mine/case1", "mine/clinical"], &[]);
    refused(both, 4, &["clinical: is of the track `clinical`", "of `ideal`"]);
}

#[test]
fn other_units_and_other_names_are_warned_of() {
    let place = Place::new();
    let film = Sequence::open(&place.path("films/case1")).unwrap();
    assert!(!place.check().contains("warning"), "{}", place.check());
    let mine = place.path("mine/case1");
    fs::write(mine.join("phase.csv"), "frame,phase\n0,12\n1,87.5\n").unwrap();
    let said = place.check();
    assert!(said.contains("warning: phase.csv: a phase is 87.5, as if in percent"), "{said}");
    for frame in 0..2 {
        let metres = film.depth_mm(frame).unwrap().map(|d| d * 1e-3);
        exr::write_depth(&mine.join(format!("depth/{frame:06}.exr")), &metres).unwrap();
    }
    let mut surface = film.inspiration().unwrap();
    mesh::write_ply(&mine.join("mesh/airway.ply"), &surface, &[]).unwrap();
    fs::write(mine.join("phases.csv"), "frame,phase\n").unwrap();
    let said = place.check();
    for warning in
        ["depth: the median is 0.0", "as if in metres", "mesh/airway.ply: is not read", "phases.csv: is not read"]
    {
        assert!(said.contains(warning), "\"{warning}\" is not said: {said}");
    }
    fs::remove_file(mine.join("mesh/airway.ply")).unwrap();
    surface.vertices.iter_mut().for_each(|v| *v *= 1e-3);
    mesh::write_ply(&mine.join("mesh/final.ply"), &surface, &[]).unwrap();
    let said = place.check();
    assert!(said.contains("mesh/final.ply: spans 0.") && !said.contains("airway.ply"), "{said}");
    let words = ["check", &place.text("mine/case1"), "--sequence", &place.text("films/case1"), "--json"];
    let json: serde_json::Value = serde_json::from_str(&accepted(run(&words))).unwrap();
    assert_eq!(json["warnings"].as_array().unwrap().len(), 4, "{json}");
}
