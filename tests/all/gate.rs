//! `gate`, `compare` and `explain` as a user and a CI job run them.

use std::fs;
use std::path::Path;

use crate::binary::run;

const HEADER: &str = "run_id,case_id,case_hash,config,seed,split,metric,definition,unit,direction,alignment,mask,value,sd,n,ci_low,ci_high,status,detail,film_content";

/// A run of two cases whose PSNR and depth error are given.
fn write_run(folder: &Path, psnr: [&str; 2], depth: [&str; 2]) {
    let mut text = format!("{HEADER}\n");
    for (case, (psnr, depth)) in ["case1", "case5"].iter().zip(psnr.iter().zip(depth)) {
        let status = |v: &str| if v.is_empty() { "degenerate" } else { "ok" };
        text += &format!(
            "smoke-1,{case},ab,ours,1,online,psnr_db,psnr_db/1,dB,higher,,none,{psnr},,12,,,{},,film of {case}\n",
            status(psnr)
        );
        text += &format!(
            "smoke-1,{case},ab,ours,1,online,depth_rmse_mm,depth_rmse_mm/2,mm,lower,none,true_depth,{depth},,12,,,{},,film of {case}\n",
            status(depth)
        );
    }
    fs::create_dir_all(folder).unwrap();
    fs::write(folder.join("results.csv"), text).unwrap();
}

const LIMITS: &str = "cases = [\"case1\", \"case5\"]\nmethods = [\"ours\"]\n\
    [[absolute]]\nmetric = \"psnr_db\"\nmethod = \"ours\"\nlimit = 20.0\n\
    [[relative]]\nmetric = \"psnr_db\"\nworse_by = 0.1\n\
    [[relative]]\nmetric = \"depth_rmse_mm\"\nworse_by_percent = 2.0\n";

/// Exit code, standard output and standard error of the gate on `results` against the folder's baseline.
fn gate(folder: &Path, results: &str) -> (i32, String, String) {
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    run(&["gate", "--results", &path(results), "--baseline", &path("baseline"), "--thresholds", &path("gate.toml")])
}

#[test]
fn an_injected_regression_ends_with_exit_code_3_and_its_reports_are_there() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("gate.toml"), LIMITS).unwrap();
    write_run(&at("baseline"), ["27.5", "26.5"], ["2.0", "3.0"]);

    write_run(&at("good"), ["27.45", "26.9"], ["2.02", "2.9"]);
    let (code, said, noted) = gate(folder.path(), "good");
    assert_eq!(code, 0, "{said}");
    assert!(said.contains("passed"));
    assert!(noted.contains("has no manifest.json") && noted.contains("has no run.json"), "{noted}");

    let injected = [
        ("psnr", ["27.3", "26.5"], ["2.0", "3.0"], "worse by 0.2"),
        ("depth", ["27.5", "26.5"], ["2.0", "3.1"], "depth_rmse_mm"),
        ("nan", ["NaN", "26.5"], ["2.0", "3.0"], "psnr_db"),
        ("empty", ["27.5", ""], ["2.0", "3.0"], "no value"),
        ("infinite", ["27.5", "26.5"], ["inf", "3.0"], "depth_rmse_mm"),
    ];
    for (name, psnr, depth, expected) in injected {
        write_run(&at(name), psnr, depth);
        let (code, said, complaint) = gate(folder.path(), name);
        assert_eq!(code, 3, "{name}: {said}{complaint}");
        assert!(said.contains(expected) && said.contains("FAIL"), "{name}: {said}");
        assert!(fs::read_to_string(at(name).join("gate.md")).unwrap().starts_with("# Gate: FAILED"));
        assert!(fs::read_to_string(at(name).join("gate.xml")).unwrap().contains("<failure"));
    }

    // A case that is gone.
    let whole = fs::read_to_string(at("good").join("results.csv")).unwrap();
    let fewer: Vec<&str> = whole.lines().filter(|l| !l.contains("case5")).collect();
    fs::write(at("good").join("results.csv"), fewer.join("\n")).unwrap();
    let (code, said, _) = gate(folder.path(), "good");
    assert_eq!(code, 3, "{said}");
    assert!(said.contains("case5"));
}

#[test]
fn broken_input_ends_with_exit_code_4_and_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("gate.toml"), LIMITS).unwrap();
    write_run(&at("baseline"), ["27.5", "26.5"], ["2.0", "3.0"]);
    // A table that was edited after its manifest was written.
    write_run(&at("edited"), ["27.5", "26.5"], ["2.0", "3.0"]);
    let hash = blake3::hash(&fs::read(at("edited").join("results.csv")).unwrap()).to_hex();
    fs::write(at("edited").join("manifest.json"), format!("{{\"files\": {{\"results.csv\": \"{hash}\"}}}}")).unwrap();
    assert_eq!(gate(folder.path(), "edited").0, 0);
    write_run(&at("edited"), ["29.5", "26.5"], ["2.0", "3.0"]);
    let (code, _, complaint) = gate(folder.path(), "edited");
    assert!(code == 4 && complaint.contains("results.csv: was changed since it was written"), "{code} {complaint}");
    let (code, _, complaint) = gate(folder.path(), "nowhere");
    assert!(code == 4 && complaint.contains("results.csv"), "{code} {complaint}");
    write_run(&at("broken"), ["a lot", "26.5"], ["2.0", "3.0"]);
    let (code, _, complaint) = gate(folder.path(), "broken");
    assert!(code == 4 && complaint.contains("line 2, column value"), "{code} {complaint}");
    fs::write(at("gate.toml"), "[[absolute]]\nmetric = \"psnr\"\nmethod = \"ours\"\nlimit = 1").unwrap();
    let (code, _, complaint) = gate(folder.path(), "baseline");
    assert!(code == 4 && complaint.contains("`psnr`"), "{code} {complaint}");
}

/// The shipped limits are read, and an empty run does not pass them.
#[test]
fn the_shipped_thresholds_are_sound() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("results.csv"), format!("{HEADER}\n")).unwrap();
    let (code, said, complaint) = run(&["gate", "--results", folder.path().to_str().unwrap()]);
    assert_eq!(code, 3, "{said}{complaint}");
    assert!(said.contains("no row") && said.contains("oracle-phase"));
}

#[test]
fn two_runs_are_compared() {
    let folder = tempfile::tempdir().unwrap();
    let (a, b) = (folder.path().join("a"), folder.path().join("b"));
    write_run(&a, ["27.5", "26.5"], ["2.0", "3.0"]);
    write_run(&b, ["28.5", "27.0"], ["2.0", "3.0"]);
    let (a, b) = (a.to_str().unwrap(), b.to_str().unwrap());
    let (code, said, _) = run(&["compare", a, b]);
    assert_eq!(code, 0);
    let line = |id: &str| said.lines().find(|l| l.contains(id)).unwrap().to_owned();
    assert!(line("psnr_db").ends_with("too few cases") && line("psnr_db").contains("0.75"), "{said}");
    assert!(line("depth_rmse_mm").ends_with("same"), "{said}");
    let (code, said, _) = run(&["compare", a, b, "--json"]);
    let found: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!((code, &found[0]["difference"]), (0, &serde_json::json!(0.75)));
    // A difference between films is not one between methods alone.
    let (code, _, complaint) = run(&["compare", a, b]);
    assert!(code == 0 && !complaint.contains("other films"), "{complaint}");
    let results = Path::new(b).join("results.csv");
    fs::write(&results, fs::read_to_string(&results).unwrap().replace("film of case5", "another")).unwrap();
    let (code, _, complaint) = run(&["compare", a, b]);
    assert!(code == 0 && complaint.contains("case5 are of other films in B"), "{complaint}");
    let (code, _, complaint) = run(&["compare", a, b, "--method", "theirs"]);
    assert!(code == 4 && complaint.contains("has no method `theirs`; there are ours"), "{complaint}");
}

#[test]
fn a_metric_is_explained() {
    let (code, said, _) = run(&["explain", "contour_rmse_mm"]);
    assert!(code == 0 && said.contains("mm") && said.contains("lower") && said.contains("0.05 mm"), "{said}");
    let (code, _, complaint) = run(&["explain", "psnr"]);
    assert!(code == 2 && complaint.contains("psnr_db"), "{complaint}");
    let (_, said, _) = run(&["explain", "--json"]);
    let all: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!(all[0]["id"], "psnr_db");
    assert_eq!(all[0]["direction"], "higher");
}

/// The reference report, taken apart by methods and put together again, is the reference report. It was kept without its
/// frames, and has metrics of definitions that were changed since.
#[test]
fn runs_are_merged() {
    let folder = tempfile::tempdir().unwrap();
    let whole = Path::new(env!("CARGO_MANIFEST_DIR")).join("reports/reference/paper-7");
    let part = |name: &str, keep: &dyn Fn(&str) -> bool| {
        let place = folder.path().join(name);
        fs::create_dir_all(&place).unwrap();
        for (table, column) in [("results.csv", 3), ("comparison.csv", 1), ("timings.csv", 2)] {
            let text = fs::read_to_string(whole.join(table)).unwrap();
            let kept = |(k, line): &(usize, &str)| *k == 0 || keep(line.split(',').nth(column).unwrap());
            let lines: Vec<&str> = text.lines().enumerate().filter(kept).map(|(_, line)| line).collect();
            fs::write(place.join(table), lines.join("\n") + "\n").unwrap();
        }
        place.to_str().unwrap().to_owned()
    };
    let (all, mine, others) =
        (part("all", &|_| true), part("mine", &|m| m.starts_with("ours")), part("others", &|m| !m.starts_with("ours")));
    let out = folder.path().join("merged").to_str().unwrap().to_owned();
    let (code, _, complaint) = run(&["merge", &others, &mine, "--out", &out]);
    assert!(code == 4 && complaint.contains("the definition changed from "), "{complaint}");
    let (code, said, complaint) = run(&["merge", &others, &mine, "--unchecked", "--out", &out]);
    assert_eq!(code, 0, "{complaint}");
    assert!(said.contains("Static CT") && said.contains("report.html"), "{said}");
    let rows = |path: &Path| {
        let text = fs::read_to_string(path).unwrap();
        let mut rows: Vec<String> = text.lines().map(str::to_owned).collect();
        rows.sort();
        rows
    };
    // The committed report is of a version that knew no places and no contents of films: it is read, and written anew.
    let anew = folder.path().join("anew").to_str().unwrap().to_owned();
    let (code, _, complaint) = run(&["merge", &all, "--unchecked", "--out", &anew]);
    assert_eq!(code, 0, "{complaint}");
    for table in ["results.csv", "comparison.csv", "summary.csv", "timings.csv"] {
        let (merged, whole) = (rows(&folder.path().join("merged").join(table)), rows(&Path::new(&anew).join(table)));
        assert!(merged.len() > 8 && merged == whole, "{table} is another");
    }
    let values = |path: &Path| {
        let mut reader = csv::Reader::from_path(path.join("results.csv")).unwrap();
        let header = reader.headers().unwrap().clone();
        let column = |name: &str| header.iter().position(|h| h == name).unwrap();
        let wanted =
            ["case_id", "config", "seed", "metric", "value", "sd", "n", "ci_low", "ci_high", "status"].map(column);
        let mut rows: Vec<Vec<String>> =
            reader.records().map(|row| wanted.map(|c| row.as_ref().unwrap()[c].to_owned()).to_vec()).collect();
        // The committed report is older than the metrics of second cameras, of targets in all frames and of error bars.
        let later = ["novel_", "target_mean_mm", "target_p95_mm", "phase_coverage_", "phase_sd_mean"];
        let later =
            later.into_iter().chain(["navigation_", "lost_pct", "silent_pct", "recovered_pct"]).collect::<Vec<_>>();
        let redefined = ["contour_rmse_mm", "depth_rmse_mm", "target_error_"];
        let is_later = |metric: &str| later.iter().chain(&redefined).any(|start| metric.starts_with(start));
        rows.retain(|row| !is_later(&row[3]));
        rows.sort();
        rows
    };
    assert_eq!(values(Path::new(&anew)), values(&whole));
    let report = fs::read_to_string(folder.path().join("merged/report.md")).unwrap();
    for sentence in ["were not checked, for want of manifest.json, frames.csv: ", "defined otherwise now: "] {
        assert!(report.contains(sentence), "{sentence}");
    }
    for picture in ["report.md", "plots/methods.png", "plots/error-against-time.png", "environments.json"] {
        assert!(folder.path().join("merged").join(picture).exists(), "{picture}");
    }

    let (code, _, complaint) = run(&["merge", &all, "--unchecked", "--out", &all]);
    assert!(code == 2 && complaint.contains("--out is one of the runs"), "{complaint}");
    let (code, _, complaint) = run(&["merge", "nothing-here", "--out", &out]);
    assert!(code == 4 && complaint.contains("nothing-here/results.csv"), "{complaint}");
}

/// What github-action-benchmark and Bencher read, by the rules of their documentation.
#[test]
fn means_are_written_for_programs_that_draw_them_over_commits() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("gate.toml"), LIMITS).unwrap();
    write_run(&at("bad"), ["27.5", "12.5"], ["2.0", ""]);
    let path = |name: &str| at(name).to_str().unwrap().to_owned();
    let words = ["gate", "--results", &path("bad"), "--thresholds", &path("gate.toml"), "--benchmark-json"];
    let (code, said, _) = run(&words);
    assert_eq!(code, 3, "the verdict stands: {said}");

    let read =
        |name: &str| -> serde_json::Value { serde_json::from_slice(&fs::read(at("bad").join(name)).unwrap()).unwrap() };
    let bigger = read("benchmark-bigger-is-better.json");
    let entry = &bigger.as_array().unwrap()[0];
    assert_eq!((entry["name"].as_str(), entry["unit"].as_str()), (Some("ours: psnr_db"), Some("dB")));
    assert_eq!(entry["value"].as_f64(), Some(20.0));
    let range = entry["range"].as_str().unwrap();
    assert!(range.starts_with("12.5") && range.contains(" to 27.5"), "{range}");
    assert_eq!(entry["extra"], "track ideal, 2 cases, psnr_db/1");
    // One case has no depth: its mean is of the other, and one value has no interval.
    let smaller = read("benchmark-smaller-is-better.json");
    let entry = &smaller.as_array().unwrap()[0];
    assert_eq!((entry["name"].as_str(), entry["value"].as_f64()), (Some("ours: depth_rmse_mm"), Some(2.0)));
    assert!(entry.get("range").is_none() && entry["extra"].as_str().unwrap().contains(", 1 case,"), "{entry}");

    let bencher = read("benchmark-bencher.json");
    let psnr = &bencher["ours"]["psnr_db"];
    let number = |key: &str| psnr[key].as_f64().unwrap();
    assert_eq!((number("lower_value"), number("value"), number("upper_value")), (12.5, 20.0, 27.5));
    assert_eq!(bencher["ours"]["depth_rmse_mm"].as_object().unwrap().keys().collect::<Vec<_>>(), ["value"]);
}
