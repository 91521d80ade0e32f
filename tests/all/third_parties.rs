//! What a third party hands in, by mistake or on purpose: exchanged films, names of own rows, links to the truth, edited
//! tables. Each is refused in one sentence that names the file, and none reaches a table.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use respire_bench::base::{Image, NoProgress};
use respire_bench::formats::png;
use respire_bench::simulate::simulate;

use crate::all_cases::TINY;
use crate::binary::run;
use crate::shared;
use crate::simulate::{case, contents, seal, small};

/// A tiny run of two own rows, and a third party's prediction of the same film, which is an own one's copy.
pub struct Place(tempfile::TempDir);

impl Place {
    pub fn new() -> Self {
        Place::of_frames(3)
    }

    /// With a film of so many frames.
    pub fn of_frames(frames: usize) -> Self {
        let made = shared::folder(&format!("tiny-{frames}"), |folder| Place::make(folder, frames));
        let place = Place(tempfile::tempdir().unwrap());
        let copied = Command::new("cp").arg("-a").arg(made.join(".")).arg(place.path("")).status().unwrap();
        assert!(copied.success());
        place
    }

    fn make(folder: &Path, frames: usize) {
        let profile = TINY
            .replace("methods = [\"static-ct\", \"oracle-phase\", \"ours\"]", "methods = [\"static-ct\", \"ours\"]");
        assert_ne!(profile, TINY);
        let profile = profile.replace("minimum_frames = 3", &format!("minimum_frames = {frames}"));
        fs::write(folder.join("tiny.toml"), profile).unwrap();
        let at = |name: &str| folder.join(name).to_str().unwrap().to_owned();
        let arguments = ["all-cases", "--profile", &at("tiny.toml"), "--out", &at("reports"), "--cache", &at("cache")];
        let (code, _, err) = run(&arguments);
        assert_eq!(code, 0, "{err}");
        copy(&first(&folder.join("cache/cells"), "case1-ours").join("prediction"), &folder.join("mine"));
        fs::write(folder.join("mine/prediction.json"), "{\"method\": \"mine\", \"case\": \"case1\"}").unwrap();
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    pub fn film(&self) -> PathBuf {
        first(&self.path("cache/sequences"), "case1-").join("film")
    }

    /// Scores the prediction folder `name` on `film` into the report folder `out`.
    pub fn evaluate(&self, film: &Path, name: &str, out: &str, more: &[&str]) -> (i32, String, String) {
        let (prediction, out) = (self.text(name), self.text(out));
        let fixed = ["evaluate", "--sequence", film.to_str().unwrap(), "--predictions", &prediction, "--out", &out];
        run(&[&fixed[..], more].concat())
    }

    pub fn merge(&self, parts: &[&str], more: &[&str]) -> (i32, String, String) {
        let folders: Vec<String> = parts.iter().map(|part| self.text(part)).collect();
        let out = self.text("table");
        let mut words = vec!["merge"];
        words.extend(folders.iter().map(String::as_str));
        words.extend(["--out", &out]);
        words.extend(more);
        run(&words)
    }
}

/// The folder in `folder` whose name begins so.
fn first(folder: &Path, start: &str) -> PathBuf {
    let mut found = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    found.find(|path| path.is_dir() && path.file_name().unwrap().to_str().unwrap().starts_with(start)).unwrap()
}

pub fn copy(from: &Path, to: &Path) {
    for (name, bytes) in contents(from) {
        let path = to.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }
}

pub fn edit(path: &Path, change: impl Fn(&str) -> String) {
    let before = fs::read_to_string(path).unwrap();
    let after = change(&before);
    assert_ne!(before, after, "nothing to change in {}", path.display());
    fs::write(path, after).unwrap();
}

/// The command was refused with `code` in one sentence that says all of `words`.
#[track_caller]
pub fn refused((code, out, err): (i32, String, String), wanted: i32, words: &[&str]) {
    assert_eq!((code, out.as_str()), (wanted, ""), "{err}");
    assert_eq!(err.lines().count(), 1, "{err}");
    for word in words {
        assert!(err.contains(word), "\"{word}\" is not said: {err}");
    }
}

#[track_caller]
pub fn accepted((code, out, err): (i32, String, String)) -> String {
    assert_eq!(code, 0, "{err}");
    out
}

/// A column of a table, one value per row, beside the first column.
pub fn column(path: &Path, name: &str) -> Vec<(String, String)> {
    let mut reader = csv::Reader::from_path(path).unwrap();
    let place = reader.headers().unwrap().iter().position(|h| h == name).unwrap_or_else(|| panic!("no {name}"));
    reader.records().map(|row| row.unwrap()).map(|row| (row[0].to_owned(), row[place].to_owned())).collect()
}

#[test]
fn a_third_party_stands_in_the_ranking_under_a_name_of_its_own() {
    let place = Place::new();
    let film = place.film();
    // An own row's name, in each of the places where a name can stand, and in disguise.
    fs::write(place.path("mine/prediction.json"), "{\"method\": \"ours\"}").unwrap();
    let words = ["prediction.json: method: `ours` is reserved", "another name"];
    refused(place.evaluate(&film, "mine", "scores", &[]), 4, &words);
    refused(run(&["check", &place.text("mine"), "--sequence", film.to_str().unwrap()]), 4, &words);
    refused(place.evaluate(&film, "mine", "scores", &["--method", "Static_CT"]), 2, &["--method", "`static-ct`"]);
    assert!(!place.path("scores").exists());
    accepted(place.evaluate(&film, "mine", "scores", &["--method", "mine"]));

    // Seeds differ (0 of a third party, 1 of the methods): still one ranking, in which equal predictions share a place.
    accepted(place.merge(&["reports/latest", "scores"], &[]));
    let summary = place.path("table/summary.csv");
    let rank = |metric: &str| column(&summary, &format!("{metric}_rank"));
    let pairs =
        |ours: &str, mine: &str| [("static-ct", ""), ("ours", ours), ("mine", mine)].map(|(a, b)| (a.into(), b.into()));
    let sorted = |mut rows: Vec<(String, String)>| {
        rows.sort();
        rows
    };
    assert_eq!(sorted(rank("psnr_db")), sorted(pairs("1", "1").to_vec()));
    // A worse picture: second to `ours`, where the rank by seed would have made both the first.
    png::write_rgb(&place.path("mine/color/000002.png"), &Image::filled(32, 32, 3, 0)).unwrap();
    accepted(place.evaluate(&film, "mine", "scores", &["--method", "mine"]));
    accepted(place.merge(&["reports/latest", "scores"], &[]));
    assert_eq!(sorted(rank("psnr_db")), sorted(pairs("1", "2").to_vec()));
    // A time that somebody states has no place among those that were measured, and none has none.
    fs::write(place.path("mine/timing.json"), "{\"time_total_s\": 0.001, \"time_cpu_s\": 0.001}").unwrap();
    accepted(place.evaluate(&film, "mine", "scores", &["--method", "mine"]));
    accepted(place.merge(&["reports/latest", "scores"], &[]));
    assert_eq!(sorted(rank("time_cpu_s")), sorted(pairs("1", "").to_vec()));
    let report = fs::read_to_string(place.path("table/report.md")).unwrap();
    assert!(report.contains("without a place: mine."), "{report}");
    fs::remove_file(place.path("mine/timing.json")).unwrap();
    accepted(place.evaluate(&film, "mine", "scores", &["--method", "mine"]));
    accepted(place.merge(&["reports/latest", "scores"], &[]));
    assert_eq!(sorted(rank("time_total_s")), sorted(pairs("1", "").to_vec()));

    // A report of an older version may hold an own row's name, or a method's rows may meet a prediction's.
    copy(&place.path("scores"), &place.path("older"));
    for table in ["results.csv", "comparison.csv", "frames.csv"] {
        edit(&place.path("older").join(table), |text| text.replace(",mine,", ",ours,"));
    }
    let words = ["older/results.csv", "row ours of case1", "is reserved"];
    refused(place.merge(&["reports/latest", "older"], &[]), 4, &words);
    copy(&place.path("reports/latest"), &place.path("theirs"));
    for table in ["results.csv", "comparison.csv", "frames.csv", "timings.csv"] {
        edit(&place.path("theirs").join(table), |text| text.replace(",ours,", ",mine,"));
    }
    seal(&place.path("theirs"));
    refused(
        place.merge(&["theirs", "scores"], &[]),
        4,
        &["`mine` is a method of tiny-", "a prediction in evaluate-case1-mine"],
    );
    // Two predictions of one name never replace each other; the same one twice is one.
    accepted(place.merge(&["reports/latest", "scores", "scores"], &[]));
    fs::copy(place.path("mine/color/000002.png"), place.path("mine/color/000001.png")).unwrap();
    accepted(place.evaluate(&film, "mine", "other", &["--method", "mine"]));
    refused(
        place.merge(&["reports/latest", "scores", "other"], &[]),
        4,
        &["`mine` has two different predictions of case1"],
    );
}

#[test]
fn an_exchanged_film_is_refused_by_everything_that_reads_it() {
    let place = Place::new();
    let film = place.path("film");
    copy(&place.film(), &film);
    let film_text = film.to_str().unwrap().to_owned();
    accepted(run(&["check", &film_text]));
    accepted(place.evaluate(&place.film(), "mine", "honest", &[]));

    // The prediction's own pictures in the film's place.
    let image = film.join("images/000001.png");
    let true_image = fs::read(&image).unwrap();
    fs::copy(place.path("mine/color/000001.png"), &image).unwrap();
    refused(run(&["check", &film_text]), 4, &["film/images/000001.png", "manifest.json"]);
    refused(place.evaluate(&film, "mine", "scores", &[]), 4, &["film/images/000001.png", "manifest.json"]);
    let prediction = place.text("mine");
    // Only what scoring reads is compared there, and that on every file of its kind.
    fs::write(&image, &true_image).unwrap();
    for name in ["depth/000002.exr", "mesh/expiration.ply", "transforms.json", "frames.csv"] {
        let before = fs::read(film.join(name)).unwrap();
        fs::write(film.join(name), [&before[..], b" "].concat()).unwrap();
        refused(run(&["check", &film_text]), 4, &[name, "does not have the hash"]);
        if name != "frames.csv" {
            refused(place.evaluate(&film, "mine", "scores", &[]), 4, &[name, "does not have the hash"]);
        }
        fs::write(film.join(name), before).unwrap();
    }
    accepted(run(&["check", &film_text]));

    // Forged with its manifest the film is sound, but another one: no table holds both.
    fs::copy(place.path("mine/color/000001.png"), &image).unwrap();
    seal(&film);
    accepted(run(&["check", &prediction, "--sequence", &film_text]));
    accepted(place.evaluate(&film, "mine", "scores", &[]));
    let words = ["case1 was filmed more than once", "--other-films"];
    refused(place.merge(&["reports/latest", "scores"], &[]), 4, &words);
    accepted(place.merge(&["reports/latest", "honest"], &[]));
    accepted(place.merge(&["reports/latest", "scores"], &["--other-films"]));
    assert!(fs::read_to_string(place.path("table/report.md")).unwrap().contains("case1 was filmed more than once"));
}

#[test]
fn changed_frames_of_a_finished_film_are_filmed_again() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("film");
    simulate(&case(), &small(), &out, &NoProgress).unwrap();
    let whole = contents(&out);
    fs::copy(out.join("images/000000.png"), out.join("images/000003.png")).unwrap();
    fs::write(out.join("depth/000004.exr"), "no depth").unwrap();
    fs::remove_file(out.join("mesh/expiration.ply")).unwrap();
    fs::write(out.join("transforms.json"), "{}").unwrap();
    simulate(&case(), &small(), &out, &NoProgress).unwrap().verify().unwrap();
    let again = contents(&out);
    assert_eq!(whole.keys().collect::<Vec<_>>(), again.keys().collect::<Vec<_>>());
    for (name, bytes) in &whole {
        assert!(bytes == &again[name], "{name} differs");
    }
}

#[test]
fn links_to_the_truth_foreign_cases_and_no_time_are_refused() {
    let place = Place::new();
    let film = place.film();
    let depth = place.path("mine/depth/000001.exr");
    let predicted = fs::read(&depth).unwrap();
    let truth = film.join("depth/000001.exr");
    let said = ["mine/depth/000001.exr", "is a link to the truth"];
    fs::remove_file(&depth).unwrap();
    std::os::unix::fs::symlink(&truth, &depth).unwrap();
    refused(place.evaluate(&film, "mine", "scores", &[]), 4, &said);
    let check = |place: &Place| run(&["check", &place.text("mine"), "--sequence", film.to_str().unwrap()]);
    refused(check(&place), 4, &said);
    fs::remove_file(&depth).unwrap();
    fs::hard_link(&truth, &depth).unwrap();
    refused(place.evaluate(&film, "mine", "scores", &[]), 4, &said);
    fs::remove_file(&depth).unwrap();
    fs::write(&depth, predicted).unwrap();
    // The folder as a whole.
    fs::rename(place.path("mine/color"), place.path("color")).unwrap();
    std::os::unix::fs::symlink(film.join("images"), place.path("mine/color")).unwrap();
    refused(place.evaluate(&film, "mine", "scores", &[]), 4, &["mine/color/000000.png", "is a link to the truth"]);
    fs::remove_file(place.path("mine/color")).unwrap();
    fs::rename(place.path("color"), place.path("mine/color")).unwrap();
    accepted(check(&place));

    // A report has names that films and predictions have, and must not land among them.
    let manifest = fs::read(film.join("manifest.json")).unwrap();
    let in_film = ["evaluate", "--sequence", film.to_str().unwrap(), "--predictions", &place.text("mine"), "--out"];
    refused(run(&[&in_film[..], &[film.to_str().unwrap()]].concat()), 4, &["holds other files than a report's"]);
    refused(run(&[&in_film[..], &[&place.text("mine")]].concat()), 4, &["mine: holds other files than a report's"]);
    accepted(run(&[&in_film[..], &[&place.text("scores")]].concat()));
    accepted(run(&[&in_film[..], &[&place.text("scores")]].concat()));
    let into_film = ["merge", &place.text("scores"), "--out", film.to_str().unwrap()];
    refused(run(&into_film), 4, &["holds other files than a report's"]);
    assert_eq!(fs::read(film.join("manifest.json")).unwrap(), manifest);

    fs::write(place.path("mine/timing.json"), "{\"time_total\": 3}").unwrap();
    let said = accepted(check(&place));
    assert!(said.contains("timing.json: `time_total` is not read; keys are time_total_s, time_cpu_s"), "{said}");
    let about = place.path("mine/prediction.json");
    edit(&about, |text| text.replace("case1", "case2"));
    refused(check(&place), 4, &["prediction.json: case: is `case2`, but the film is of `case1`"]);
    edit(&about, |text| text.replace("case2", "case1"));
    for seconds in ["0", "-1", "0.0"] {
        fs::write(place.path("mine/timing.json"), format!("{{\"time_total_s\": {seconds}}}")).unwrap();
        refused(check(&place), 4, &["timing.json: time_total_s: "]);
    }
}

/// Changes cells of a table: what `change` makes of a column's value in a row.
fn edit_cells(path: &Path, change: impl Fn(&str, &BTreeMap<&str, &str>) -> Option<&'static str>) {
    let text = fs::read_to_string(path).unwrap();
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let names: Vec<String> = reader.headers().unwrap().iter().map(str::to_owned).collect();
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(&names).unwrap();
    for record in reader.records().map(Result::unwrap) {
        let row: BTreeMap<&str, &str> = names.iter().map(String::as_str).zip(record.iter()).collect();
        writer.write_record(names.iter().map(|name| change(name, &row).unwrap_or(row[name.as_str()]))).unwrap();
    }
    let changed = String::from_utf8(writer.into_inner().unwrap()).unwrap();
    edit(path, |_| changed.clone());
}

#[test]
fn forged_reports_are_refused_by_file_and_element() {
    let place = Place::new();
    let film = place.film();
    accepted(place.evaluate(&film, "mine", "scores", &[]));
    // The film's own pictures: copies, whatever a table says.
    copy(&place.path("mine"), &place.path("copies"));
    for frame in 0..3 {
        let name = format!("{frame:06}.png");
        fs::copy(film.join("images").join(&name), place.path("copies/color").join(&name)).unwrap();
    }
    accepted(place.evaluate(&film, "copies", "copied", &[]));
    let refused_after = |report: &str, forge: &dyn Fn(&Path), words: &[&str]| {
        let forged = place.path("forged");
        let _ = fs::remove_dir_all(&forged);
        copy(&place.path(report), &forged);
        forge(&forged);
        seal(&forged);
        refused(place.merge(&["reports/latest", "forged"], &[]), 4, words);
    };
    // An id that would name files outside of the report.
    let elsewhere = |folder: &Path| {
        for table in ["results.csv", "comparison.csv", "frames.csv"] {
            edit_cells(&folder.join(table), |column, _| (column == "case_id").then_some("../../elsewhere"));
        }
    };
    refused_after("scores", &elsewhere, &["forged/results.csv", "line 2, column case_id", "letters, digits"]);
    // A film that nobody can tell.
    let unknown = |folder: &Path| {
        edit_cells(&folder.join("results.csv"), |column, _| (column == "film_content").then_some(""));
    };
    refused_after("scores", &unknown, &["forged/results.csv", "column film_content", "--unchecked"]);
    // A copy as an estimate.
    let honest = |folder: &Path| {
        edit_cells(&folder.join("results.csv"), |column, row| match (row["metric"], column) {
            ("psnr_db", "status") => Some("ok"),
            ("psnr_db", "value") => Some("60"),
            _ => None,
        });
    };
    refused_after("copied", &honest, &["forged/results.csv", "psnr_db", "the pictures are the input or the truth"]);
    // Numbers that no axis ends at.
    for (name, metric) in [("time_s", "psnr_db"), ("phase", "psnr_db"), ("value", "phase_predicted")] {
        let endless = |folder: &Path| {
            edit_cells(&folder.join("frames.csv"), |column, row| {
                (column == name && row["metric"] == metric).then_some("inf")
            });
        };
        refused_after("scores", &endless, &["forged/frames.csv", &format!("column {name}"), "must lie in"]);
    }
    let long = |folder: &Path| {
        edit_cells(&folder.join("comparison.csv"), |column, _| (column == "time_total_s").then_some("1e308"));
    };
    refused_after("scores", &long, &["forged/comparison.csv", "time_total_s"]);
    // Contours of nothing, and two columns of one name.
    let bare = |folder: &Path| {
        let path = folder.join("scenes.json");
        let mut scenes: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        scenes["rows"][0]["contours"]["truth"] = serde_json::json!([]);
        fs::write(&path, scenes.to_string()).unwrap();
    };
    refused_after("scores", &bare, &["forged/scenes.json", "row mine of case1", "contours need a true one"]);
    let twice = |folder: &Path| edit(&folder.join("results.csv"), |text| text.replacen(",ci_low,", ",value,", 1));
    refused_after("scores", &twice, &["forged/results.csv", "column value", "is there twice"]);
    accepted(place.merge(&["reports/latest", "scores"], &[]));

    // A film of such a case is none, and a prediction's table of times has keys.
    copy(&film, &place.path("film"));
    edit(&place.path("film/manifest.json"), |text| text.replace("\"case1\"", "\"../../elsewhere\""));
    let words = ["film/manifest.json: case_id: must be letters, digits"];
    refused(run(&["check", &place.text("film")]), 4, &words);
    refused(place.evaluate(&place.path("film"), "mine", "scores", &[]), 4, &words);
    fs::write(place.path("mine/timing.json"), "[1, 2]").unwrap();
    refused(place.evaluate(&film, "mine", "scores", &[]), 4, &["mine/timing.json"]);
    fs::remove_file(place.path("mine/timing.json")).unwrap();
    fs::remove_file(place.path("mine/phase.csv")).unwrap();
    std::os::unix::fs::symlink("nowhere", place.path("mine/phase.csv")).unwrap();
    refused(place.evaluate(&film, "mine", "scores", &[]), 4, &["mine/phase.csv: is no file"]);
}

#[test]
fn numbers_that_do_not_follow_from_the_frames_are_not_merged() {
    let place = Place::new();
    accepted(place.evaluate(&place.film(), "mine", "scores", &[]));
    accepted(place.merge(&["reports/latest", "scores"], &[]));
    let results = place.path("scores/results.csv");
    let honest = fs::read_to_string(&results).unwrap();
    for metric in ["psnr_db", "ssim", "depth_rmse_mm", "phase_mae", "phase_pearson_r"] {
        let value = |row: &str| row.split(',').nth(12).unwrap().to_owned();
        let row = honest.lines().find(|row| row.contains(&format!(",{metric},{metric}/"))).unwrap();
        let better = row.replacen(&format!(",{},", value(row)), ",0.987654,", 1);
        fs::write(&results, honest.replace(row, &better)).unwrap();
        refused(place.merge(&["reports/latest", "scores"], &[]), 4, &["scores/results.csv", metric, "frames.csv"]);
    }
    let twice = honest.lines().find(|row| row.contains(",ssim,")).unwrap();
    fs::write(&results, format!("{honest}{twice}\n")).unwrap();
    refused(
        place.merge(&["reports/latest", "scores"], &[]),
        4,
        &["scores/results.csv", "\"ssim\" of this cell is there twice"],
    );
    fs::write(&results, &honest).unwrap();
    // What leaves no trace in the frames is noticed by the hash of the table; and a report without hashes is none.
    for metric in ["contour_rmse_mm", "target_error_mm", "target_p95_mm"] {
        let row = honest.lines().find(|row| row.contains(&format!(",{metric},{metric}/"))).unwrap();
        let value = row.split(',').nth(12).unwrap().to_owned();
        fs::write(&results, honest.replace(row, &row.replacen(&format!(",{value},"), ",0.001,", 1))).unwrap();
        refused(
            place.merge(&["reports/latest", "scores"], &[]),
            4,
            &["scores/results.csv", "was changed", "manifest.json"],
        );
    }
    fs::write(&results, &honest).unwrap();
    edit(&place.path("scores/comparison.csv"), |text| {
        let (head, row) = text.trim_end().split_once('\n').unwrap();
        let cpu = head.split(',').position(|name| name == "time_cpu_s").unwrap();
        let mut cells: Vec<&str> = row.split(',').collect();
        cells[cpu] = "0.001";
        format!("{head}\n{}\n", cells.join(","))
    });
    refused(place.merge(&["reports/latest", "scores"], &[]), 4, &["scores/comparison.csv", "was changed"]);
    accepted(place.evaluate(&place.film(), "mine", "scores", &[]));
    let manifest = place.path("scores/manifest.json");
    let kept = fs::read(&manifest).unwrap();
    fs::remove_file(&manifest).unwrap();
    refused(place.merge(&["reports/latest", "scores"], &[]), 4, &["scores/manifest.json", "is missing"]);
    // Nor do other words in the table help.
    let forged = honest.replace("evaluate-case1-mine", "tiny-01234567");
    fs::write(&results, &forged).unwrap();
    refused(place.merge(&["reports/latest", "scores"], &[]), 4, &["scores/manifest.json", "is missing"]);
    fs::write(&results, &honest).unwrap();
    fs::write(&manifest, kept).unwrap();
    accepted(place.merge(&["reports/latest", "scores"], &[]));
    fs::remove_file(place.path("scores/run.json")).unwrap();
    refused(place.merge(&["reports/latest", "scores"], &[]), 4, &["scores/run.json", "manifest.json has its hash"]);
    accepted(place.evaluate(&place.film(), "mine", "scores", &[]));
    // Without its frames nothing can be told of a prediction.
    fs::remove_file(place.path("scores/frames.csv")).unwrap();
    refused(place.merge(&["reports/latest", "scores"], &[]), 4, &["scores/frames.csv"]);
    // A report that was kept without its long tables takes a prediction beside its rows where that is wanted, and says so.
    accepted(place.evaluate(&place.film(), "mine", "scores", &[]));
    ["frames.csv", "timings.csv"]
        .iter()
        .for_each(|table| fs::remove_file(place.path("reports/latest").join(table)).unwrap());
    refused(place.merge(&["reports/latest", "scores"], &[]), 4, &["latest/frames.csv: is missing", "--unchecked"]);
    accepted(place.merge(&["reports/latest", "scores"], &["--unchecked"]));
    let report = fs::read_to_string(place.path("table/report.md")).unwrap();
    assert!(report.contains("were not checked, for want of frames.csv, timings.csv: ours, static-ct."), "{report}");
}
