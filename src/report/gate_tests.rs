//! The gate on tables of a real report: what is good passes, every kind of damage fails.

use std::fs;
use std::path::Path;

use super::compare::{Change, compare, differences_of_work, only_in_first};
use super::gate::{Check, Thresholds, Verdict, judge, read_thresholds, with_limits_of};
use super::gate_limits::{LimitSource, limits_from, write_limits};
use super::read::{CaseFacts, Results, read};
use super::run::{CaseInfo, CellRecord, MethodInfo, Outcome, Run};
use super::{gate_files, report_tests, tables};
use crate::base::image::Image;
use crate::formats::{mesh, png};
use crate::score::fixture::{Distortion, TubeTruth, write_prediction};
use crate::score::{ScoreSettings, Truth, score};
use crate::simulate::track::Track;

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
        // And each value for itself, whatever the limits.
        let broken = if bad.is_some() { 2 } else { 0 };
        assert_eq!(verdict(&changed(&good, "ours", "psnr_db", |_| bad)).len(), 4 + broken, "{bad:?}");
    }
    assert_eq!(verdict(&changed(&good, "ours", "depth_rmse_mm", |_| Some(f64::NAN))).len(), 5);
    assert_eq!(verdict(&changed(&good, "ours", "ssim", |_| Some(1.5))).len(), 2);
    // No error at all is better than any number by PSNR alone.
    let identical = |metric: &str| {
        let mut results = changed(&good, "ours", metric, |_| None);
        let of_metric = results.entries.iter_mut().filter(|(k, _)| k.method == "ours" && k.metric == metric);
        of_metric.for_each(|(_, entry)| entry.status = "identical".into());
        verdict(&results).len()
    };
    assert_eq!((identical("psnr_db"), identical("depth_rmse_mm")), (0, 3));
    // In a mean, too.
    let mut of_mean = thresholds();
    of_mean.absolute[0].over = of_mean.absolute[1].over;
    let mut results = changed(&good, "ours", "psnr_db", |_| None);
    let mut rows = results.entries.iter_mut().filter(|(k, _)| k.method == "ours" && k.metric == "psnr_db");
    rows.next().unwrap().1.status = "identical".into();
    assert_eq!(failures(&judge(&results, &of_mean, None)).len(), 1, "another case has no value");
    let rows = results.entries.iter_mut().filter(|(k, _)| k.method == "ours" && k.metric == "psnr_db");
    rows.for_each(|(_, entry)| entry.status = "identical".into());
    assert!(failures(&judge(&results, &of_mean, None)).is_empty());
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
    // Without a baseline a method must have run in every case that must be there, and each limit wants its rows.
    let alone = |results: &Results| failures(&judge(results, &limits, None));
    assert_eq!(alone(&good), Vec::<String>::new());
    let in_one = alone(&without(&|k| k.method != "ours" || k.case != "case2"));
    assert!(in_one.iter().any(|f| f == "case2/ours/: the method did not run"), "{in_one:?}");
    assert!(in_one.iter().any(|f| f == "case2/ours/psnr_db: no row"), "{in_one:?}");
    assert!(in_one.iter().any(|f| f.starts_with("mean/ours/depth_rmse_mm: not every case")), "{in_one:?}");
    let row = alone(&without(&|k| k.method != "ours" || k.case != "case2" || k.metric != "psnr_db"));
    assert_eq!(row, ["case2/ours/psnr_db: no row"]);
    let fewer = without(&|k| k.case != "case2");
    let checks = judge(&good, &limits, Some(&fewer));
    assert!(failures(&checks).is_empty());
    assert!(checks.iter().any(|c| c.verdict == Verdict::Note && c.case == "case2"));
    // A limit that no row meets, and no limit at all, check nothing.
    for limit in ["metric = 'psnr_db'\nmethod = 'ours-gm'", "metric = 'psnr_ahead_db'\nmethod = 'mean-breath'"] {
        let limits: Thresholds = toml::from_str(&format!("[[relative]]\n{limit}\nworse_by = 0.1")).unwrap();
        for (baseline, whose) in [(Some(&good), "baseline"), (None, "results")] {
            let failed = failures(&judge(&good, &limits, baseline));
            assert!(failed[0].contains(&format!("no row of the {whose} meets this limit")), "{failed:?}");
        }
    }
    let nothing = failures(&judge(&good, &Thresholds::default(), Some(&good)));
    assert!(nothing.len() == 1 && nothing[0].contains("nothing was checked"), "{nothing:?}");
    // A case whose film nobody knows, or whose rows are of several.
    for (contents, words) in
        [(&[""][..], "no row tells"), (&["", "a"], "not all of one film"), (&["a", "b"], "not all of")]
    {
        let mut results = good.clone();
        let films = contents.iter().map(|film| film.to_string()).collect();
        results.facts.get_mut("case1").unwrap().film_contents = films;
        let failed = verdict(&results);
        assert!(failed.len() == 1 && failed[0].contains(words), "{failed:?}");
    }
    // A baseline is of the same films, which are known, and of the same track.
    assert!(good.is_of_films_of(&good));
    let altered = |change: &dyn Fn(&mut Results)| {
        let mut other = good.clone();
        change(&mut other);
        other
    };
    for other in [
        altered(&|r| r.facts.get_mut("case1").unwrap().film_contents = [String::new()].into()),
        altered(&|r| r.facts.get_mut("case1").unwrap().film_contents = ["other".to_owned()].into()),
        altered(&|r| r.facts = [("case7".to_owned(), r.facts["case1"].clone())].into()),
        altered(&|r| r.track = Track::Clinical),
    ] {
        assert!(!good.is_of_films_of(&other) && !other.is_of_films_of(&good));
    }
    // A case in which everything failed has no film, and keeps no other from telling.
    let failed = altered(&|r| {
        r.facts.insert("case7".to_owned(), CaseFacts { film_contents: [].into(), ..r.facts["case1"].clone() });
    });
    let with_it = altered(&|r| drop(r.facts.insert("case7".to_owned(), r.facts["case1"].clone())));
    assert!(failed.is_of_films_of(&with_it) && !with_it.is_of_films_of(&failed));
    // Words that this program writes nowhere.
    for (status, words) in [("bogus", "`bogus` is no status"), ("not_applicable", "the status says `not_applicable`")] {
        let mut results = good.clone();
        results.entries.values_mut().find(|entry| entry.value.is_some()).unwrap().status = status.into();
        let failed = verdict(&results);
        assert!(failed.iter().any(|f| f.contains(words)), "{failed:?}");
    }
    // The table of times speaks of the same cells.
    let path = folder.path().join("results.csv");
    let all = fs::read_to_string(&path).unwrap();
    let left: Vec<&str> = all.lines().filter(|line| !line.contains(",static-ct,")).collect();
    fs::write(&path, left.join("\n") + "\n").unwrap();
    let said = read(folder.path()).unwrap_err().to_string();
    assert!(said.contains("comparison.csv") && said.contains("has no row of this case, method and seed"), "{said}");
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
    // Jenkins' schema knows it in a suite and not above.
    let (root, suites) = xml.split_once("<testsuite ").unwrap();
    assert!(root.contains("<testsuites ") && !root.contains("skipped") && suites.contains("skipped=\"0\""), "{root}");
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
    assert!((depth.difference - 0.5).abs() < 1e-12 && depth.change == Change::Few && depth.cases == 2);
    let psnr = found.iter().find(|c| c.method == "ours" && c.metric == "psnr_db").unwrap();
    assert_eq!(psnr.change, Change::Same);
    // A value that has gone is not the same; a surface that cannot be measured counts with its case's worst row.
    let mut lost = a.clone();
    let mut worse = a.clone();
    for (results, metric, status) in
        [(&mut lost, "depth_rmse_mm", "degenerate"), (&mut worse, "target_error_mm", "no_contour")]
    {
        let of_case = |k: &super::read::Key| k.method == "ours" && k.metric == metric && k.case == "case2";
        for (_, entry) in results.entries.iter_mut().filter(|(k, _)| of_case(k)) {
            (entry.value, entry.status) = (None, status.into());
        }
    }
    let change = |b: &Results, metric: &str| {
        let found = compare(&a, b);
        let one = found.iter().find(|c| c.method == "ours" && c.metric == metric).unwrap();
        (one.change, one.cases, one.difference)
    };
    assert_eq!(change(&lost, "depth_rmse_mm").0, Change::Lost);
    let (change, cases, difference) = change(&worse, "target_error_mm");
    assert!(change != Change::Same && cases == 2 && difference > 0.0, "{change:?} {cases} {difference}");
}

/// A limit is met by what equals it, and of two allowances the larger holds, not their sum.
#[test]
fn the_ends_of_the_allowances() {
    let folder = tempfile::tempdir().unwrap();
    let with_psnr = {
        let tables = tables_in(folder.path());
        move |psnr: f64| changed(&tables, "ours", "psnr_db", |_| Some(psnr))
    };
    let limits: Thresholds = toml::from_str(
        "[[absolute]]\nmetric = \"psnr_db\"\nmethod = \"ours\"\nlimit = 25.0\n\
         [[relative]]\nmetric = \"psnr_db\"\nworse_by = 0.1\nworse_by_percent = 1.0",
    )
    .unwrap();
    let failed = |psnr: f64, baseline: f64| {
        let failed = failures(&judge(&with_psnr(psnr), &limits, Some(&with_psnr(baseline))));
        failed.iter().filter(|f| f.contains("/ours/psnr_db:")).count()
    };
    assert_eq!((failed(25.0, 25.0), failed(24.999, 24.999)), (0, 2));
    // 1 % of 30 dB, and 0.1 dB.
    assert_eq!((failed(29.71, 30.0), failed(29.69, 30.0)), (0, 2));
}

/// Seven cases, then six of them with one tree: alike differences there say little of other trees.
#[test]
fn runs_are_compared_over_trees() {
    let folder = tempfile::tempdir().unwrap();
    let mut a = tables_in(folder.path());
    a.entries.retain(|key, _| key.case == "case1" && key.method == "ours" && key.metric == "depth_rmse_mm");
    let (key, entry) = a.entries.first_key_value().map(|(key, entry)| (key.clone(), entry.clone())).unwrap();
    for case in 1..=7 {
        let case = format!("case{case}");
        a.facts.entry(case.clone()).or_default().tree = case.clone();
        a.entries.insert(super::read::Key { case, ..key.clone() }, entry.clone());
    }
    let mut b = a.clone();
    for (_, entry) in b.entries.iter_mut().filter(|(key, _)| key.case != "case7") {
        entry.value = entry.value.map(|v| v + 0.5);
    }
    let change = |a: &Results, b: &Results| compare(a, b)[0].change;
    assert_eq!(change(&a, &b), Change::Worse);
    let mut both_ways = b.clone();
    for (key, entry) in both_ways.entries.iter_mut().filter(|(key, _)| ["case1", "case2"].contains(&key.case.as_str()))
    {
        entry.value = entry.value.map(|v| v - 1.0 - f64::from(key.case == "case2"));
    }
    assert_eq!(change(&a, &both_ways), Change::Unclear);
    // A case that the second run has of other methods alone is lost; one that it has not at all is not shared.
    let mut lost = b.clone();
    lost.entries.retain(|key, _| key.case != "case3");
    assert_eq!(change(&a, &lost), Change::Lost);
    lost.facts.remove("case3");
    assert_eq!(change(&a, &lost), Change::Worse);
    assert_eq!(only_in_first(&a, &lost), ["cases of A that B has not: case3"]);
    a.facts.iter_mut().filter(|(case, _)| *case != "case7").for_each(|(_, facts)| facts.tree = "shared".into());
    assert_eq!(change(&a, &b), Change::Few);
}

/// More iterations would hide a regression; another method file or fewer seeds are said.
#[test]
fn runs_under_other_conditions_are_no_baseline() {
    let folder = tempfile::tempdir().unwrap();
    let baseline = tables_in(folder.path());
    let with = |profile: &str, conditions: &[&str], changed: &[&str]| {
        let owned = |words: &[&str]| words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>();
        let (profile, conditions, changed) = (profile.to_owned(), owned(conditions), owned(changed));
        Results { profile, conditions, changed, ..baseline.clone() }
    };
    let gate = |results: &Results, baseline: &Results| judge(results, &thresholds(), Some(baseline));
    let known = with("tiny", &["30 %."], &[]);
    assert_eq!(failures(&gate(&known, &known)), [""; 0]);
    for other in [with("tiny", &["90 %."], &[]), with("tiny", &[], &[])] {
        let failed = failures(&gate(&other, &known));
        assert!(
            failed.len() == 1 && failed[0].contains("other conditions") && failed[0].contains("30 %"),
            "{failed:?}"
        );
        assert!(differences_of_work(&known, &other)[0].contains("other conditions"));
    }
    // A run of an older version does not tell, and scores of predictions have none.
    for untold in [with("", &[], &[]), with("evaluate", &[], &[])] {
        assert_eq!(failures(&gate(&untold, &known)), [""; 0]);
    }
    let changed = with("tiny", &["30 %."], &["ours"]);
    let checks = gate(&changed, &known);
    assert_eq!(failures(&checks), [""; 0]);
    assert!(checks.iter().any(|c| c.verdict == Verdict::Note && c.method == "ours" && c.sentence.contains("settings")));
    let settings = |a: &Results, b: &Results| differences_of_work(a, b).join(" ").contains("settings in one of both");
    assert!(settings(&known, &changed) && settings(&changed, &known) && !settings(&changed, &changed));
    let mut more = known.clone();
    for (key, entry) in &known.entries {
        more.entries.insert(super::read::Key { seed: 2, ..key.clone() }, entry.clone());
    }
    let said = differences_of_work(&more, &known);
    assert!(said.iter().any(|sentence| sentence == "`ours` has the seeds 1, 2 in A and 1 in B"), "{said:?}");
}

/// Times are compared where one machine took both.
#[test]
fn times_of_two_machines_are_not_judged() {
    let folder = tempfile::tempdir().unwrap();
    let mut a = tables_in(folder.path());
    let mut b = changed(&a, "ours", "time_total_s", |v| Some(2.0 * v));
    let change = |a: &Results, b: &Results| {
        compare(a, b).iter().find(|c| c.method == "ours" && c.metric == "time_total_s").unwrap().change
    };
    assert_eq!(change(&a, &b), Change::Machines, "nobody knows of which");
    for (results, machine) in [(&mut a, "0123abcd"), (&mut b, "0123abcd")] {
        results.machines.insert((machine.into(), "2".into()));
    }
    assert_eq!(change(&a, &b), Change::Few);
    b.machines = [("another".to_owned(), "2".to_owned())].into();
    assert_eq!(change(&a, &b), Change::Machines);
}

/// By hand: seeds that are 0.04 apart in one case and 0.10 in the other have deviations of 0.028 and 0.071, whose mean
/// square is that of 0.054.
#[test]
fn deviations_of_seeds_are_pooled_by_their_squares() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = tables_in(folder.path());
    run.entries.retain(|key, _| key.method == "ours" && ["phase_mae", "psnr_db"].contains(&key.metric.as_str()));
    let first = run.entries.clone();
    for (key, entry) in first.into_iter().map(|(key, entry)| (super::read::Key { seed: key.seed + 1, ..key }, entry)) {
        run.entries.insert(key, entry);
    }
    for (key, entry) in run.entries.iter_mut().filter(|(key, _)| key.metric == "phase_mae") {
        let apart = if key.case == "case1" { 0.04 } else { 0.10 };
        entry.value = Some(0.2 + apart * (key.seed % 2) as f64);
    }
    let limits = limits_from(&[run]).unwrap();
    let of = |metric: &str| limits.iter().find(|l| l.limit.metric == metric).unwrap();
    let deviation = ((0.04f64.powi(2) + 0.10f64.powi(2)) / 4.0).sqrt();
    assert!((of("phase_mae").deviation - deviation).abs() < 1e-12, "{:?}", of("phase_mae"));
    assert_eq!(of("phase_mae").limit.worse_by, 0.22);
    // No seed changes the PSNR: half of the last decimal that tables show.
    assert_eq!((of("psnr_db").deviation, of("psnr_db").limit.worse_by), (0.0, 0.005));
}

/// What is wrong with the predictions of a build.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Planted {
    Nothing,
    /// The mesh of the first CT in every frame, and the targets where they lie on it.
    NeverDeforms,
    /// The phase of two frames before.
    Lags,
    /// All pictures have 3 % less light.
    TooDark,
}

/// Of a small run: how many cases, which seeds, and which sampling of the films.
struct Build<'a> {
    cases: usize,
    seeds: &'a [u64],
    sampling: u64,
    planted: Planted,
}

/// Errors of a method that draws (`ours`), and of one that does not (`ours-gn`): what changes with seed, case and
/// sampling is what a sound build may change.
fn errors(method: &str, case: usize, seed: u64, sampling: u64) -> Distortion {
    let draw = |key: u64, size: f64| {
        let seed = if method == "ours" { seed } else { 0 };
        let key = [key, case as u64, seed, sampling];
        size * crate::base::random::CounterRng::new(5, crate::base::random::Stage::Test, &key).normal()
    };
    Distortion {
        noise: 5.0 + draw(1, 0.02),
        depth_scale: 0.02 + draw(2, 0.001),
        phase_offset: 0.02 + draw(3, 0.002),
        surface_shift_mm: 0.3 + draw(4, 0.02),
        ..Distortion::default()
    }
}

fn plant(truth: &TubeTruth, prediction: &Path, planted: Planted) {
    match planted {
        Planted::Nothing => {}
        Planted::NeverDeforms => {
            mesh::write_ply(&prediction.join("mesh/final.ply"), &truth.inspiration().unwrap(), &[]).unwrap();
            let mut rows = "frame,target,x_mm,y_mm,z_mm\n".to_owned();
            for frame in 0..truth.frames().len() {
                for (k, target) in truth.targets().iter().enumerate() {
                    let place = target.inspiration_mm;
                    rows.push_str(&format!("{frame},{k},{},{},{}\n", place.x, place.y, place.z));
                }
            }
            fs::write(prediction.join("targets.csv"), rows).unwrap();
        }
        Planted::Lags => {
            let path = prediction.join("phase.csv");
            let text = fs::read_to_string(&path).unwrap();
            let phases: Vec<&str> = text.lines().skip(1).map(|row| row.split_once(',').unwrap().1).collect();
            let late = (0..phases.len()).map(|frame| format!("{frame},{}\n", phases[frame.saturating_sub(2)]));
            let head = text.lines().next().unwrap();
            fs::write(path, format!("{head}\n{}", late.collect::<String>())).unwrap();
        }
        Planted::TooDark => {
            for folder in ["color", "ahead", "novel"] {
                for entry in fs::read_dir(prediction.join(folder)).unwrap() {
                    let path = entry.unwrap().path();
                    let mut image: Image<u8> = png::read_rgb(&path).unwrap();
                    // 3 % of the light: what the codes lose through the sRGB curve.
                    let code = 0.97f64.powf(1.0 / 2.2);
                    image.data.iter_mut().for_each(|v| *v = (f64::from(*v) * code).round() as u8);
                    png::write_rgb(&path, &image).unwrap();
                }
            }
        }
    }
}

/// The tables of a build, read back.
fn results_of(build: &Build<'_>) -> (tempfile::TempDir, Results) {
    let folder = tempfile::tempdir().unwrap();
    let mut cells = Vec::new();
    for case in 1..=build.cases {
        let truth = TubeTruth::new(&format!("case{case}"), 24, 17);
        for method in ["ours", "ours-gn"] {
            for &seed in build.seeds {
                let prediction = folder.path().join(format!("{case}-{method}-{seed}"));
                write_prediction(&truth, &prediction, &errors(method, case, seed, build.sampling));
                plant(&truth, &prediction, build.planted);
                let settings = ScoreSettings { method: Some(method.into()), seed, ..Default::default() };
                let mut scored = score(&truth, &prediction, &settings).unwrap();
                scored.film_content = format!("film {}", build.sampling);
                cells.push(CellRecord {
                    run_id: "smoke-00000001".into(),
                    case_id: truth.case_id().into(),
                    method: method.into(),
                    seed,
                    prediction,
                    outcome: Outcome::Scored(Box::new(scored)),
                    timings: Vec::new(),
                });
            }
        }
    }
    let case = |k: usize| CaseInfo { id: format!("case{k}"), title: String::new(), tree: String::new(), truth: None };
    let run = Run {
        id: "smoke-00000001".into(),
        profile: "smoke".into(),
        track: Track::Ideal,
        conditions: Vec::new(),
        notes: Vec::new(),
        cases: (1..=build.cases).map(case).collect(),
        methods: ["ours", "ours-gn"].map(MethodInfo::of).to_vec(),
        cells,
        scenes: Default::default(),
        read_from: Vec::new(),
    };
    tables::write_results(&run, &folder.path().join("results.csv")).unwrap();
    let results = read(folder.path()).unwrap();
    (folder, results)
}

/// The rule of the limits, on nine cases and their seeds, and what it must catch in a run of two.
#[test]
fn planted_regressions_are_refused_and_sound_builds_are_not() {
    let sound = Build { cases: 2, seeds: &[1], sampling: 1, planted: Planted::Nothing };
    let (folder, baseline) = results_of(&sound);
    let (_kept, seeds) = results_of(&Build { seeds: &[1, 2, 3], ..sound });
    let (_kept, nine) = results_of(&Build { cases: 9, ..sound });
    let (_kept, resampled) = results_of(&Build { cases: 9, sampling: 2, ..sound });
    let limits = limits_from(&[seeds.clone(), nine.clone(), resampled.clone()]).unwrap();
    for (method, source) in [("ours", LimitSource::Seeds), ("ours-gn", LimitSource::SingleCases)] {
        let of_method = || limits.iter().filter(|l| l.limit.method.as_deref() == Some(method));
        assert!(of_method().count() > 10 && of_method().any(|l| l.source == source), "{method}");
        let psnr = of_method().find(|l| l.limit.metric == "psnr_db").unwrap();
        assert!(psnr.source == source && (psnr.limit.worse_by / (4.0 * psnr.deviation) - 1.0).abs() < 0.05, "{psnr:?}");
    }
    let too_few = limits_from(&[seeds, baseline.clone()]).unwrap_err().to_string();
    assert!(too_few.contains("ours-gn has no spread") && too_few.contains("9 are needed"), "{too_few}");

    let file =
        "[[relative]]\nmetric = 'psnr_db'\nworse_by = 0.0\n[[relative]]\nmetric = 'time_total_s'\nadvisory = true";
    write_limits(&limits, &folder.path().join("limits.toml")).unwrap();
    // Limits of a row that the baseline does not have are of the runs that they are computed from.
    let path = folder.path().join("limits.toml");
    let more = "[[relative]]\nmetric = 'psnr_db'\nmethod = 'ours-nav'\n";
    fs::write(&path, fs::read_to_string(&path).unwrap() + more).unwrap();
    let limits = with_limits_of(toml::from_str(file).unwrap(), &baseline, folder.path()).unwrap();
    assert!(limits.relative[1].advisory && limits.relative.iter().filter(|l| l.metric == "psnr_db").count() == 3);

    // The same bytes on every machine: ten more runs of the same build are ten times the same table.
    for _ in 0..10 {
        let (_kept, again) = results_of(&sound);
        assert_eq!(failures(&judge(&again, &limits, Some(&baseline))), [""; 0]);
    }
    for (planted, metrics) in [
        (Planted::NeverDeforms, ["target_mean_mm", "contour_rmse_mm"]),
        (Planted::Lags, ["phase_mae", "phase_pearson_r"]),
        (Planted::TooDark, ["psnr_db", "novel_psnr_db"]),
    ] {
        let (_kept, broken) = results_of(&Build { planted, ..sound });
        let failed = failures(&judge(&broken, &limits, Some(&baseline)));
        for method in ["ours", "ours-gn"] {
            let is_refused = |metric: &str| failed.iter().any(|f| f.contains(&format!("/{method}/{metric}:")));
            assert!(metrics.iter().all(|metric| is_refused(metric)), "{planted:?} {method}: {failed:?}");
        }
        // And for nothing else: a dark picture has no other surface.
        let touched = |f: &&String| match planted {
            Planted::TooDark => f.contains("target") || f.contains("phase") || f.contains("depth"),
            _ => f.contains("psnr") || f.contains("ssim") || f.contains("depth"),
        };
        assert_eq!(failed.iter().find(touched), None, "{planted:?}");
    }
    // A film that was made anew is not compared as if it were the old one.
    let (_kept, other) = results_of(&Build { sampling: 2, ..sound });
    let failed = failures(&judge(&other, &limits, Some(&baseline)));
    assert!(failed.iter().filter(|f| f.contains("the film is another")).count() == 2, "{failed:?}");
}

/// The sanity limits of short runs say nothing of long ones; another program's row beside them is of no profile.
#[test]
fn limits_of_another_profile_are_refused() {
    let of = |profile: &str| Results { profile: profile.into(), ..Results::default() };
    let limits = Thresholds { profile: Some("smoke".into()), ..thresholds() };
    for fits in ["smoke", "smoke + evaluate", "evaluate", ""] {
        limits.check_profile(&of(fits)).unwrap();
    }
    for other in ["quick", "smoke + evaluate + quick"] {
        let said = limits.check_profile(&of(other)).unwrap_err().to_string();
        assert!(said.contains("`smoke`") && said.contains("`quick`"), "{said}");
        thresholds().check_profile(&of(other)).unwrap();
    }
}

/// A number that is missing for another reason is no number that is missing as before.
#[test]
fn another_reason_for_no_value_fails() {
    let folder = tempfile::tempdir().unwrap();
    let without = |status: &str| {
        let mut results = changed(&tables_in(folder.path()), "ours", "psnr_db", |_| None);
        let of_ours = results.entries.iter_mut().filter(|(key, _)| key.method == "ours" && key.metric == "psnr_db");
        of_ours.for_each(|(_, entry)| entry.status = status.into());
        results
    };
    let relative = Thresholds { absolute: Vec::new(), ..thresholds() };
    let verdict = |now: &Results, before: &Results| {
        let checks = judge(now, &relative, Some(before));
        let of_ours = checks.iter().filter(|c| c.method == "ours" && c.metric == "psnr_db" && c.case == "case1");
        of_ours.map(|c| c.verdict).collect::<Vec<_>>()
    };
    let (before, same) = (without("not_applicable"), without("not_applicable"));
    assert_eq!(verdict(&same, &before), [Verdict::Pass]);
    assert_eq!(verdict(&without("copied"), &before), [Verdict::Fail]);
}
