//! The gate on tables of a real report: what is good passes, every kind of damage fails.

use std::fs;
use std::path::Path;

use super::compare::{Change, compare};
use super::gate::{Check, Thresholds, Verdict, judge, read_thresholds};
use super::read::{Results, read};
use super::{gate_files, report_tests, tables};

/// Tables of a run in which nothing failed.
fn tables_in(folder: &Path) -> Results {
    let mut run = report_tests::sample_run(folder, 24, 4);
    run.cells.retain(|c| c.score().is_some());
    tables::write_results(&run, &folder.join("results.csv")).unwrap();
    tables::write_comparison(&run, &folder.join("comparison.csv")).unwrap();
    read(folder).unwrap()
}

fn thresholds() -> Thresholds {
    toml::from_str(
        r#"
        cases = ["case1", "case2"]
        methods = ["ours"]
        [[absolute]]
        metric = "psnr_db"
        method = "ours"
        limit = 25.0
        [[absolute]]
        metric = "depth_rmse_mm"
        method = "ours"
        over = "mean"
        limit = 1.0
        [[relative]]
        metric = "psnr_db"
        worse_by = 0.1
        [[relative]]
        metric = "depth_rmse_mm"
        worse_by_percent = 2.0
        [[relative]]
        metric = "time_total_s"
        worse_by_percent = 25.0
        advisory = true
        "#,
    )
    .unwrap()
}

fn failures(checks: &[Check]) -> Vec<String> {
    let failed = checks.iter().filter(|c| c.verdict == Verdict::Fail);
    failed.map(|c| format!("{}/{}/{}: {}", c.case, c.method, c.metric, c.sentence)).collect()
}

/// The results with every value of (`method`, `metric`) replaced.
fn changed(results: &Results, method: &str, metric: &str, change: impl Fn(f64) -> Option<f64>) -> Results {
    let mut results = results.clone();
    let mut touched = 0;
    for (key, entry) in &mut results.entries {
        if key.method == method && key.metric == metric {
            entry.value = entry.value.and_then(&change);
            touched += 1;
        }
    }
    assert!(touched > 0);
    results
}

#[test]
fn verdicts() {
    let folder = tempfile::tempdir().unwrap();
    let good = tables_in(folder.path());
    let limits = thresholds();
    let verdict = |results: &Results| failures(&judge(results, &limits, Some(&good)));
    assert_eq!(verdict(&good), Vec::<String>::new());

    // Within the allowance and better both pass; beyond it fails, absolutely or against the baseline.
    assert!(verdict(&changed(&good, "ours", "psnr_db", |v| Some(v - 0.05))).is_empty());
    assert!(verdict(&changed(&good, "ours", "psnr_db", |v| Some(v + 5.0))).is_empty());
    assert_eq!(verdict(&changed(&good, "ours", "psnr_db", |v| Some(v - 0.2))).len(), 2);
    assert_eq!(verdict(&changed(&good, "ours", "psnr_db", |_| Some(3.0))).len(), 4);
    assert_eq!(verdict(&changed(&good, "bridgesplat-nomesh", "depth_rmse_mm", |v| Some(v * 1.03))).len(), 2);
    // NaN, infinity and an empty value fail each limit that applies to them.
    for bad in [Some(f64::NAN), Some(f64::NEG_INFINITY), None] {
        assert_eq!(verdict(&changed(&good, "ours", "psnr_db", |_| bad)).len(), 4, "{bad:?}");
    }
    assert_eq!(verdict(&changed(&good, "ours", "depth_rmse_mm", |_| Some(f64::NAN))).len(), 3);
    // Times are advisory.
    let slow = judge(&changed(&good, "ours", "time_total_s", |v| Some(v * 9.0)), &limits, Some(&good));
    assert!(failures(&slow).is_empty() && slow.iter().any(|c| c.verdict == Verdict::Note));
}

#[test]
fn what_is_missing_fails_and_what_is_new_is_noted() {
    let folder = tempfile::tempdir().unwrap();
    let good = tables_in(folder.path());
    let limits = thresholds();
    let without = |keep: &dyn Fn(&super::read::Key) -> bool| {
        let mut results = good.clone();
        results.entries.retain(|k, _| keep(k));
        results
    };
    let verdict = |results: &Results| failures(&judge(results, &limits, Some(&good)));
    assert!(!verdict(&without(&|k| k.case != "case2")).is_empty());
    assert!(!verdict(&without(&|k| k.method != "ours")).is_empty());
    assert!(!verdict(&without(&|k| k.metric != "psnr_db")).is_empty());
    assert!(!verdict(&without(&|_| false)).is_empty());
    // Without a baseline too.
    assert!(!failures(&judge(&without(&|k| k.metric != "psnr_db"), &limits, None)).is_empty());
    let fewer = without(&|k| k.case != "case2");
    let checks = judge(&good, &limits, Some(&fewer));
    assert!(failures(&checks).is_empty());
    assert!(checks.iter().any(|c| c.verdict == Verdict::Note && c.case == "case2"));
    // A renamed definition is not compared.
    let mut renamed = good.clone();
    for (_, entry) in renamed.entries.iter_mut().filter(|(k, _)| k.metric == "psnr_db") {
        entry.definition = "psnr_db/2".into();
    }
    assert!(verdict(&renamed).iter().all(|f| f.contains("definition changed")) && !verdict(&renamed).is_empty());
    // A failed cell fails, whatever its limits.
    let mut failed = good.clone();
    for (_, entry) in failed.entries.iter_mut().filter(|(k, _)| k.method == "static-ct") {
        entry.status = "failed".into();
        entry.value = None;
    }
    assert!(failures(&judge(&failed, &Thresholds::default(), None)).iter().any(|f| f.contains("the cell failed")));
}

#[test]
fn verdicts_become_files() {
    let folder = tempfile::tempdir().unwrap();
    let good = tables_in(folder.path());
    let bad = changed(&good, "ours", "psnr_db", |_| Some(3.0));
    let checks = judge(&bad, &thresholds(), Some(&good));
    let path = folder.path().join("gate.xml");
    gate_files::write_junit(&checks, &path).unwrap();
    let xml = fs::read_to_string(&path).unwrap();
    assert!(xml.contains("failures=\"2\"") && xml.contains("classname=\"case1\"") && xml.contains("at least 25"));
    let markdown = gate_files::markdown(&checks);
    assert!(markdown.starts_with("# Gate: FAILED"));
    assert!(gate_files::markdown(&judge(&good, &thresholds(), Some(&good))).starts_with("# Gate: passed"));
}

#[test]
fn damaged_tables_and_thresholds_are_named() {
    let folder = tempfile::tempdir().unwrap();
    tables_in(folder.path());
    let path = folder.path().join("results.csv");
    let text = fs::read_to_string(&path).unwrap();
    let first_value = text.lines().nth(1).and_then(|row| row.split(',').nth(12)).unwrap();
    fs::write(&path, text.replacen(first_value, "abc", 1)).unwrap();
    let read_error = || read(folder.path()).map(|_| ()).unwrap_err().to_string();
    let said = read_error();
    assert!(said.contains("results.csv") && said.contains("line 2") && said.contains("value"), "{said}");
    fs::write(&path, text.replacen("case_id", "case", 1)).unwrap();
    assert!(read_error().contains("column case_id"));
    fs::remove_file(&path).unwrap();
    assert!(read_error().contains("results.csv"));
    let limits = folder.path().join("gate.toml");
    for (text, expected) in [
        ("[[absolute]]\nmetric = \"psnr\"\nmethod = \"ours\"\nlimit = 1.0", "psnr"),
        ("[[absolute]]\nmetric = \"psnr_db\"\nmethod = \"ours\"\nlimit = nan", "absolute[0].limit: NaN"),
        ("[[relative]]\nmetric = \"psnr_db\"\nworse_by = -1.0", "relative[0].worse_by: -1"),
        ("[[relatively]]\nmetric = \"psnr_db\"", "relatively"),
    ] {
        fs::write(&limits, text).unwrap();
        let said = read_thresholds(&limits).unwrap_err().to_string();
        assert!(said.contains(expected) && said.contains("gate.toml"), "{said}");
    }
}

#[test]
fn two_runs_are_compared_in_pairs() {
    let folder = tempfile::tempdir().unwrap();
    let a = tables_in(folder.path());
    assert!(compare(&a, &a).iter().all(|c| c.change == Change::Same && c.difference == 0.0));
    let b = changed(&a, "ours", "depth_rmse_mm", |v| Some(v + 0.5));
    let found = compare(&a, &b);
    let depth = found.iter().find(|c| c.method == "ours" && c.metric == "depth_rmse_mm").unwrap();
    assert!((depth.difference - 0.5).abs() < 1e-12 && depth.change == Change::Worse && depth.cases == 2);
    let psnr = found.iter().find(|c| c.method == "ours" && c.metric == "psnr_db").unwrap();
    assert_eq!(psnr.change, Change::Same);
}
