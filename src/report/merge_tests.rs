//! Runs are read back from their tables without loss, and put together cell by cell.

use std::collections::BTreeMap;
use std::fs;

use super::counted_run::CountedRun;
use super::differences::NeighbourDifference;
use super::merge::{Films, Part};
use super::read_back::PartEvidence;
use super::report_tests::sample_run;
use super::*;
use crate::base::NoProgress;
use crate::score::statistics::{FEWEST_TREES, MeanInterval};
use crate::score::{Goal, MetricScore, Status};

fn read_run(folder: &Path) -> Result<Run> {
    read_back::read_run(folder, PartEvidence::Needed)
}

/// The runs as parts `part-1`, `part-2` and so on.
fn merge(runs: Vec<Run>, films: Films) -> Result<Run> {
    let part = |(k, run)| Part { folder: format!("part-{}", k + 1).into(), run };
    merge::merge(runs.into_iter().enumerate().map(part).collect(), films)
}

/// Adds a third party's row `mine` on both cases: scores of `ours` under another seed, changed by case and metric.
fn add_mine(run: &mut Run, change: impl Fn(&str, &mut MetricScore)) {
    for case in ["case1", "case2"] {
        let mut mine = run.cells.iter().find(|c| c.case_id == case && c.method == "ours").unwrap().clone();
        (mine.method, mine.seed, mine.run_id) = ("mine".into(), 0, run::evaluated_id(case, "mine"));
        let Outcome::Scored(score) = &mut mine.outcome else { panic!("not scored") };
        score.metrics.iter_mut().for_each(|metric| change(case, metric));
        run.cells.push(mine);
    }
    run.methods.push(MethodInfo::of("mine"));
}

/// A row of fewer cases says so and is never the best.
#[test]
fn a_row_of_fewer_cases_is_marked_and_not_ranked() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = sample_run(folder.path(), 48, 6);
    // The best of all by far, on one case.
    let mut mine = run.cells.iter().find(|c| c.case_id == "case1" && c.method == "oracle-phase").unwrap().clone();
    mine.method = "mine".into();
    run.methods.push(MethodInfo::of("mine"));
    run.cells.push(mine);
    let table = table::ComparisonTable::new(table::TableKind::Ranking, &summary::summarise(&run));
    let titles: Vec<&str> = table.rows.iter().map(|r| r.method.title.as_str()).collect();
    assert!(
        titles.contains(&"mine (1 of 2 cases)") && titles.contains(&"BridgeSplat (1 of 2 cases; 1 of 2 runs failed)"),
        "{titles:?}"
    );
    let best = |id: &str| table.rows.iter().find(|r| r.method.id == id).unwrap().cells.iter().any(|c| c.best);
    assert!(!best("mine") && best("ours"));
}

/// By hand: two trees, the first with two cases.
#[test]
fn neighbours_are_compared_in_pairs() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = sample_run(folder.path(), 48, 9);
    run.cells.retain(|c| ["ours", "ours-nomesh", "static-ct"].contains(&c.method.as_str()));
    run.methods.retain(|m| ["ours", "ours-nomesh", "static-ct"].contains(&m.id.as_str()));
    let set = |run: &mut Run, case: &str, method: &str, value: f64| {
        let cell = run.cells.iter_mut().find(|c| c.case_id == case && c.method == method).unwrap();
        let Outcome::Scored(score) = &mut cell.outcome else { panic!("{case} {method} failed") };
        score.metrics.iter_mut().find(|m| m.metric == "phase_mae").unwrap().value = Some(value);
    };
    for (case, ours, nomesh) in [("case1", 0.10, 0.13), ("case2", 0.20, 0.21)] {
        set(&mut run, case, "ours", ours);
        set(&mut run, case, "ours-nomesh", nomesh);
        set(&mut run, case, "static-ct", 0.01);
    }
    let found = differences::neighbours(&run, &summary::summarise(&run));
    let phase: Vec<_> = found.iter().filter(|d| d.metric.id == "phase_mae").collect();
    // The bound is not ranked, so that there is one pair.
    let [pair] = phase[..] else { panic!("{phase:?}") };
    assert_eq!((pair.rank, pair.method.id.as_str(), pair.next.id.as_str()), (1, "ours", "ours-nomesh"));
    assert!((pair.ahead.mean - 0.02).abs() < 1e-12 && (pair.cases, pair.trees) == (2, 2));
    // Two cases: the ends are the two differences. Both are above 0, whatever the spread between cases.
    let [low, high] = pair.ahead.interval.unwrap();
    assert!((low - 0.01).abs() < 1e-12 && (high - 0.03).abs() < 1e-12);
    // Of two trees nobody can say whether that is clear.
    assert_eq!((pair.is_clear(), pair.word().as_str()), (None, "–"));
    let of_trees = |low: f64| {
        let ahead = MeanInterval { interval: Some([low, 0.03]), ..pair.ahead };
        NeighbourDifference { trees: FEWEST_TREES, ahead, ..pair.clone() }.is_clear()
    };
    assert_eq!((of_trees(0.01), of_trees(0.0)), (Some(true), Some(false)));
    write(&run, &folder.path().join("report"), &NoProgress).unwrap();
    let read = |name: &str| fs::read_to_string(folder.path().join("report").join(name)).unwrap();
    assert!(read("differences.csv").contains("phase_mae,1,ours,ours-nomesh,2,2,"), "{}", read("differences.csv"));
    assert!(read("report.md").contains("## Neighbours in the ranking") && read("report.html").contains("Ahead by"));
    assert!(read("run.json").contains("\"track\": \"ideal\"") && read("run.json").contains("tree of case1"));
}

/// A row is beaten only by one that sees no more: of two with one CT the better one leads, though one with two CTs is
/// first; a row that nothing can beat leads nobody.
#[test]
fn a_row_that_sees_less_leads_those_that_see_as_little() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = sample_run(folder.path(), 24, 5);
    let rows = [("ours", 0.1), ("bridgesplat", 0.4), ("bridgesplat-release", 0.3), ("pose-only", 0.2)];
    let template = run.cells.iter().filter(|c| c.method == "ours").cloned().collect::<Vec<_>>();
    run.methods = rows.map(|(id, _)| MethodInfo::of(id)).to_vec();
    run.cells.clear();
    for (id, value) in rows {
        for mut cell in template.clone() {
            cell.method = id.into();
            let Outcome::Scored(score) = &mut cell.outcome else { continue };
            score.metrics.iter_mut().find(|m| m.metric == "phase_mae").unwrap().value = Some(value);
            run.cells.push(cell);
        }
    }
    let summaries = summary::summarise(&run);
    let found = |id: &str| {
        let metric = *summaries.iter().find(|s| s.method.id == id).unwrap().metric("phase_mae").unwrap();
        (metric.rank, metric.leads_equals)
    };
    assert_eq!([found("ours"), found("pose-only")], [(Some(1), false), (Some(2), false)]);
    assert_eq!([found("bridgesplat-release"), found("bridgesplat")], [(Some(3), true), (Some(4), false)]);
    let pairs: Vec<_> =
        differences::neighbours(&run, &summaries).into_iter().filter(|d| d.metric.id == "phase_mae").collect();
    assert_eq!(pairs.iter().map(|d| d.sees_more()).collect::<Vec<_>>(), [true, true, false]);
    let written = write(&run, &folder.path().join("report"), &NoProgress).unwrap();
    assert!(written.table.contains("0.300 ‡") && !written.table.contains("0.400 ‡"), "{}", written.table);
    assert!(fs::read_to_string(&written.markdown).unwrap().contains("‡: best of the ranked rows that see no more"));
}

/// Four cases of one tree and one of another: every fourth resample holds the other tree alone, which cases drawn each for
/// itself would do once in three thousand.
#[test]
fn a_mean_over_cases_has_the_interval_of_their_trees() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = sample_run(folder.path(), 24, 5);
    let case = |k: usize| CaseInfo { id: format!("case{k}"), tree: format!("tree{}", k / 5), ..run.cases[0].clone() };
    run.cases = (1..=5).map(case).collect();
    let values = [("case1", 1.0), ("case2", 1.0), ("case3", 1.0), ("case4", 1.0), ("case5", 0.0)];
    assert_eq!(CountedRun::new(&run).mean(&values).unwrap().interval, Some([0.0, 1.0]));
}

/// What differs by less than tables show shares a place; and every seed counts in a case's value.
#[test]
fn equal_numbers_share_a_place_and_seeds_are_averaged() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = sample_run(folder.path(), 24, 5);
    let set = |cell: &mut CellRecord, value: f64| {
        let Outcome::Scored(score) = &mut cell.outcome else { panic!("not scored") };
        score.metrics.iter_mut().find(|m| m.metric == "phase_mae").unwrap().value = Some(value);
    };
    for cell in &mut run.cells {
        match cell.method.as_str() {
            "ours" => set(cell, 0.1001),
            "ours-nomesh" => set(cell, 0.1004),
            _ => {}
        }
    }
    let summaries = summary::summarise(&run);
    let rank =
        |method: &str| summaries.iter().find(|s| s.method.id == method).unwrap().metric("phase_mae").unwrap().rank;
    assert_eq!((rank("ours"), rank("ours-nomesh")), (Some(1), Some(1)));

    let mut second: Vec<CellRecord> = run.cells.iter().filter(|c| c.method == "ours").cloned().collect();
    second.iter_mut().for_each(|cell| {
        cell.seed += 1;
        set(cell, 0.3001);
    });
    run.cells.extend(second);
    let counted = CountedRun::new(&run);
    let values = counted.case_values("ours", "phase_mae");
    assert!(values.len() == 2 && values.iter().all(|(_, value)| (value - 0.2001).abs() < 1e-12), "{values:?}");
}

/// Two seeds in two cases and one in the third are not every seed in every case.
#[test]
fn a_row_that_lacks_a_seed_has_no_place() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = sample_run(folder.path(), 24, 5);
    let rank = |run: &Run| {
        summary::summarise(run).iter().find(|s| s.method.id == "ours").unwrap().metric("psnr_db").unwrap().rank
    };
    assert!(rank(&run).is_some());
    run.cases.push(CaseInfo { id: "case3".into(), ..run.cases[0].clone() });
    for cell in run.cells.clone().into_iter().filter(|cell| cell.case_id == "case1") {
        run.cells.push(CellRecord { case_id: "case3".into(), ..cell });
    }
    assert!(rank(&run).is_some());
    let mut second = |case: &str| {
        let mut cell = run.cells.iter().find(|c| c.case_id == case && c.method == "ours").unwrap().clone();
        cell.seed += 1;
        run.cells.push(cell);
        rank(&run)
    };
    assert!(second("case1").is_some(), "a seed of one case does not count");
    assert!(second("case2").is_none() && second("case3").is_some());
}

/// A report that is handed in may hold one more case, or one more seed, of a row of this program: neither takes the others
/// their places, nor that row its own.
#[test]
fn more_cases_and_seeds_of_few_rows_take_nobody_a_place() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = sample_run(folder.path(), 48, 6);
    run.cells.retain(|cell| cell.score().is_some());
    for cell in run.cells.clone().iter().filter(|cell| cell.case_id == "case1") {
        run.cells.push(CellRecord { case_id: "case3".into(), ..cell.clone() });
    }
    let case = |id: &str| CaseInfo { id: id.into(), ..run.cases[0].clone() };
    run.cases.push(case("case3"));
    let places = |run: &Run| -> Vec<(String, Option<usize>, Option<MeanInterval>)> {
        let summaries = summary::summarise(run).into_iter();
        summaries.map(|s| (s.method.id.clone(), s.metric("psnr_db").unwrap().rank, s.mean("psnr_db"))).collect()
    };
    let before = places(&run);
    assert!(before.iter().filter(|(_, rank, _)| rank.is_some()).count() >= 3, "{before:?}");
    let extra = |run: &mut Run, method: &str, case: &str, seed: u64| {
        let cell = run.cells.iter().find(|cell| cell.method == method).unwrap().clone();
        run.cells.push(CellRecord { case_id: case.into(), seed, ..cell });
    };
    let mut seeded = run.clone();
    extra(&mut seeded, "ours", "case1", 7);
    assert_eq!(places(&seeded), before);
    let mut wider = run.clone();
    wider.cases.push(CaseInfo { id: "case4".into(), ..run.cases[0].clone() });
    extra(&mut wider, "ours", "case4", 1);
    assert_eq!(places(&wider), before);
    // Of two third parties alone, one hands in a case more.
    let mut foreign = run.clone();
    foreign.cells.retain(|cell| ["ours", "ours-nomesh"].contains(&cell.method.as_str()));
    for cell in &mut foreign.cells {
        cell.method = if cell.method == "ours" { "good" } else { "other" }.into();
        cell.run_id = run::evaluated_id(&cell.case_id, &cell.method);
    }
    foreign.methods = ["good", "other"].map(MethodInfo::of).to_vec();
    let before = places(&foreign);
    foreign.cases.push(CaseInfo { id: "case4".into(), ..run.cases[0].clone() });
    extra(&mut foreign, "other", "case4", 1);
    assert_eq!(places(&foreign), before);
}

/// Two rows of a table must not look like one, whoever they are of.
#[test]
fn third_parties_whose_names_look_alike_are_not_merged() {
    let folder = tempfile::tempdir().unwrap();
    let run = sample_run(folder.path(), 48, 6);
    let with = |name: &str| {
        let mut run = run.clone();
        run.cells.retain(|cell| cell.method == "ours");
        for cell in &mut run.cells {
            (cell.method, cell.seed, cell.run_id) = (name.into(), 0, run::evaluated_id(&cell.case_id, name));
        }
        run.methods = vec![MethodInfo::of(name)];
        run
    };
    let refused =
        merge(vec![run.clone(), with("EndoGSLAM"), with("EndoGSIAM")], Films::Same).err().unwrap().to_string();
    assert!(refused.contains("`EndoGSIAM`") && refused.contains("look alike"), "{refused}");
    assert!(merge(vec![run.clone(), with("EndoGSLAM"), with("net")], Films::Same).is_ok());
}

/// The best of three seeds is another number than the mean of three, and its row says so.
#[test]
fn a_row_of_fewer_seeds_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = sample_run(folder.path(), 48, 6);
    run.cells.retain(|cell| cell.score().is_some());
    let of = |method: &str, seed: u64| -> Vec<CellRecord> {
        let own = run.cells.iter().filter(|cell| cell.method == method);
        own.map(|cell| CellRecord { seed, ..cell.clone() }).collect()
    };
    let more = [of("bridgesplat-nomesh", 2), of("bridgesplat-nomesh", 3)].concat();
    run.cells.extend(more);
    let table = table::ComparisonTable::new(table::TableKind::Ranking, &summary::summarise(&run));
    let titles: Vec<&str> = table.rows.iter().map(|row| row.method.title.as_str()).collect();
    assert!(titles.contains(&"Ours (no mesh) (1 of 3 seeds)"), "{titles:?}");
    assert!(titles.contains(&"BridgeSplat (no mesh)") && titles.contains(&"Ours"), "{titles:?}");
}

/// Pictures that equal the truth have no place by any metric of pictures; a mean over fewer cases says so.
#[test]
fn what_equals_the_truth_has_no_place_by_any_of_its_metrics() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = sample_run(folder.path(), 24, 5);
    add_mine(&mut run, |case, metric| match metric.metric.as_str() {
        "novel_psnr_db" => (metric.value, metric.status) = (None, Status::Identical),
        "novel_ssim" | "novel_depth_delta_1_25" => (metric.value, metric.status) = (Some(1.0), Status::Ok),
        "novel_depth_rmse_mm" => (metric.value, metric.status) = (Some(0.0), Status::Ok),
        "phase_mae" if case == "case2" => metric.value = None,
        _ => {}
    });
    let summaries = summary::summarise(&run);
    let mine = summaries.iter().find(|s| s.method.id == "mine").unwrap();
    for metric in ["novel_psnr_db", "novel_ssim", "novel_depth_rmse_mm", "novel_depth_delta_1_25"] {
        let found = mine.metric(metric).unwrap();
        assert!(found.rank.is_none() && found.is_perfect, "{metric}: {found:?}");
    }
    assert!(mine.metric("ssim").unwrap().rank.is_some(), "other pictures are not the truth's");
    let table = table::ComparisonTable::new(table::TableKind::Ranking, &summaries);
    let row = table.rows.iter().find(|row| row.method.id == "mine").unwrap();
    let fewer = row.cells.iter().filter(|cell| cell.value.ends_with("(1 of 2)")).count();
    assert_eq!(fewer, 1, "the phase: {:?}", row.cells);
}

/// A cell that failed costs the place, even by a metric that no other row has there.
#[test]
fn a_row_with_a_failed_cell_has_no_place() {
    let folder = tempfile::tempdir().unwrap();
    let run = sample_run(folder.path(), 48, 6);
    let summaries = summary::summarise(&run);
    let ranks = |id: &str| {
        let summary = summaries.iter().find(|s| s.method.id == id).unwrap();
        summary.metrics.iter().filter(|m| m.rank.is_some()).count()
    };
    assert!(ranks("bridgesplat") == 0 && ranks("ours") > 5);
}

#[test]
fn a_table_holds_one_track() {
    let folder = tempfile::tempdir().unwrap();
    write(&sample_run(folder.path(), 24, 4), &folder.path().join("a"), &NoProgress).unwrap();
    let results = folder.path().join("a/results.csv");
    let text = fs::read_to_string(&results).unwrap();
    assert!(text.lines().skip(1).all(|line| line.contains(",ideal,tree of case")), "{text}");
    fs::write(&results, text.replacen(",ideal,", ",lunar,", 1)).unwrap();
    for refused in [read_run(&folder.path().join("a")).err(), read::read(&folder.path().join("a")).err()] {
        let said = refused.unwrap().to_string();
        assert!(said.contains("column track") && said.contains("`lunar`"), "{said}");
    }
}

/// All tables of a run, as bytes.
fn tables_of(folder: &Path) -> Vec<(&'static str, Vec<u8>)> {
    let names =
        ["results.csv", "frames.csv", "timings.csv", "comparison.csv", "summary.csv", "differences.csv", "table.tex"];
    names.map(|name| (name, fs::read(folder.join(name)).unwrap())).to_vec()
}

#[test]
fn a_run_that_is_read_back_writes_the_same_tables() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (folder.path().join("first"), folder.path().join("second"));
    write(&sample_run(folder.path(), 48, 6), &first, &NoProgress).unwrap();
    let back = read_run(&first).unwrap();
    assert_eq!(back.profile, "smoke");
    write(&back, &second, &NoProgress).unwrap();
    for ((name, a), (_, b)) in tables_of(&first).iter().zip(&tables_of(&second)) {
        assert!(a == b, "{name} is another after reading it back");
    }
}

#[test]
fn the_last_run_that_has_a_cell_gives_it() {
    let folder = tempfile::tempdir().unwrap();
    let mut whole = sample_run(folder.path(), 48, 6);
    whole.conditions = vec!["Every method runs 40 % of its iterations.".into()];
    let only = |methods: &[&str], id: &str| {
        let mut run = whole.clone();
        run.id = id.into();
        run.cells.retain(|c| methods.contains(&c.method.as_str()));
        run.cells.iter_mut().for_each(|c| c.run_id = id.into());
        run.methods.retain(|m| methods.contains(&m.id.as_str()));
        let place = folder.path().join(id);
        write(&run, &place, &NoProgress).unwrap();
        read_run(&place).unwrap()
    };
    let (old, new) = (only(&["ours", "static-ct"], "quick-00000001"), only(&["ours", "bridgesplat"], "quick-00000002"));
    let merged = merge(vec![old, new], Films::Same).unwrap();
    let found: Vec<(&str, &str, &str)> =
        merged.cells.iter().map(|c| (c.case_id.as_str(), c.method.as_str(), c.run_id.as_str())).collect();
    let (first, second) = ("quick-00000001", "quick-00000002");
    let of_case = |case| [(case, "ours", second), (case, "static-ct", first), (case, "bridgesplat", second)];
    assert_eq!(found, [of_case("case1"), of_case("case2")].concat());
    assert!(merged.notes[0].contains(first) && merged.notes[0].contains(second));
    // Put together once more, it still knows where its cells come from.
    let place = folder.path().join("merged");
    write(&merged, &place, &NoProgress).unwrap();
    let again = merge(vec![read_run(&place).unwrap()], Films::Same).unwrap();
    assert!(again.notes[0].contains(first) && again.notes[0].contains(second));
    // What holds for both, and what a case is, stays; where one of two says it, it is said of that one.
    assert_eq!(again.conditions, whole.conditions);
    assert_eq!(again.cases[0].title, whole.cases[0].title);
    let parts = [first, second].map(|id| read_run(&folder.path().join(id)).unwrap());
    let [mut plain, conditioned] = parts;
    plain.conditions.clear();
    let merged = merge(vec![plain, conditioned], Films::Same).unwrap();
    assert_eq!(merged.conditions, ["quick-00000002: Every method runs 40 % of its iterations."]);
    // The numbers are those of the whole run.
    for cell in &merged.cells {
        let is_same = |c: &&CellRecord| c.case_id == cell.case_id && c.method == cell.method;
        let before = whole.cells.iter().find(is_same).unwrap();
        assert_eq!(cell.score().map(|s| s.value("psnr_db")), before.score().map(|s| s.value("psnr_db")));
        assert_eq!(cell.score().map(|s| s.value("time_total_s")), before.score().map(|s| s.value("time_total_s")));
    }
}

#[test]
fn scores_of_different_films_are_merged_only_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let run = sample_run(folder.path(), 48, 6);
    let mut other = run.clone();
    other.id = "smoke-89abcdef".into();
    other.cells.retain(|c| c.method == "ours");
    for cell in &mut other.cells {
        cell.method = "mine".into();
        if let Outcome::Scored(score) = &mut cell.outcome {
            score.case_hash = "f".repeat(64);
        }
    }
    let refused = merge(vec![run.clone(), other.clone()], Films::Same).err().unwrap().to_string();
    assert!(
        refused.contains("case1 was filmed more than once") && refused.contains("ffffffffffff (mine)"),
        "{refused}"
    );
    let merged = merge(vec![run, other], Films::Other).unwrap();
    assert!(merged.methods.iter().any(|m| m.id == "mine"));
    assert_eq!(merged.notes.iter().filter(|note| note.contains("was filmed more than once")).count(), 2);
    let place = folder.path().join("merged");
    let written = write(&merged, &place, &NoProgress).unwrap();
    assert!(fs::read_to_string(written.markdown).unwrap().contains("ffffffffffff (mine)"));
    assert!(fs::read_to_string(written.html).unwrap().contains("ffffffffffff (mine)"));
}

#[test]
fn a_table_that_does_not_fit_is_refused_by_line_and_column() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("run");
    write(&sample_run(folder.path(), 48, 6), &place, &NoProgress).unwrap();
    let path = place.join("results.csv");
    let good = fs::read_to_string(&path).unwrap();
    for (from, to, words) in [
        (",psnr_db,", ",loudness,", ["line 2", "\"loudness\" is no metric"]),
        (",ok,", ",fine,", ["line 2, column status", "\"fine\" is no status"]),
        ("run_id,", "run,", ["column run_id", "is missing"]),
    ] {
        fs::write(&path, good.replacen(from, to, 1)).unwrap();
        let refused = read_run(&place).err().unwrap().to_string();
        assert!(words.iter().all(|w| refused.contains(w)) && refused.contains("results.csv"), "{refused}");
    }
    fs::write(&path, good.lines().next().unwrap()).unwrap();
    assert!(read_run(&place).err().unwrap().to_string().contains("has no rows"));
    // Counts count, and the other tables speak of the same cells.
    fs::write(&path, &good).unwrap();
    for (name, column, value, words) in [
        ("results.csv", "n", "2.5", "column n: 2.5 is no whole number"),
        ("results.csv", "n", "-5", "column n: -5 must lie in 0"),
        ("comparison.csv", "seed", "99", "results.csv has no row of this case, method and seed"),
        ("comparison.csv", "frames", "nan", "column frames"),
        ("timings.csv", "wall_s", "-3", "column wall_s: -3 must lie in 0"),
        ("timings.csv", "threads", "1e300", "column threads"),
    ] {
        let file = place.join(name);
        let sound = fs::read_to_string(&file).unwrap();
        let mut lines: Vec<String> = sound.lines().map(str::to_owned).collect();
        let at = lines[0].split(',').position(|head| head == column).unwrap();
        let mut cells: Vec<&str> = lines[1].split(',').collect();
        cells[at] = value;
        lines[1] = cells.join(",");
        fs::write(&file, lines.join("\n") + "\n").unwrap();
        let refused = read_run(&place).err().unwrap().to_string();
        assert!(refused.contains(words) && refused.contains(name), "{refused}");
        fs::write(&file, &sound).unwrap();
    }
}

/// One ranking over cases and seeds: a row that lacks a value of a case has no place, whatever its mean; and what
/// equals the truth is starred.
#[test]
fn places_are_of_the_whole_table_and_the_truth_is_starred() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = sample_run(folder.path(), 24, 5);
    // A third party on both cases, under another seed, a little better than `ours` in the phase and without a mesh in
    // one.
    add_mine(&mut run, |case, metric| match metric.metric.as_str() {
        "phase_mae" => metric.value = Some(0.0),
        "target_error_mm" if case == "case2" => metric.value = None,
        "target_error_mm" => metric.value = Some(0.01),
        _ => {}
    });
    let summaries = summary::summarise(&run);
    let rank = |method: &str, metric: &str| {
        summaries.iter().find(|s| s.method.id == method).unwrap().metric(metric).unwrap().rank
    };
    // What equals the truth takes nobody's place.
    assert_eq!((rank("mine", "phase_mae"), rank("ours", "phase_mae")), (None, Some(1)));
    assert_eq!((rank("mine", "psnr_db"), rank("ours", "psnr_db")), (rank("ours", "psnr_db"), rank("mine", "psnr_db")));
    assert_eq!((rank("mine", "target_error_mm"), rank("ours", "target_error_mm")), (None, Some(1)));
    assert_eq!((rank("oracle-phase", "psnr_db"), rank("bridgesplat", "psnr_db")), (None, None));
    let table = table::ComparisonTable::new(table::TableKind::Paper, &summaries);
    let starred: Vec<&str> =
        table.rows.iter().filter(|r| r.cells.iter().any(|c| c.perfect)).map(|r| r.method.id.as_str()).collect();
    assert_eq!(starred, ["mine"]);
    let written = write(&run, &folder.path().join("report"), &NoProgress).unwrap();
    assert!(written.table.contains("| 0.000 ★ |"), "{}", written.table);
    assert!(fs::read_to_string(&written.markdown).unwrap().contains("★: equal to the truth"));
    assert!(fs::read_to_string(folder.path().join("report/table.tex")).unwrap().contains("0.000 $\\star$"));
}

/// A surface that cannot be measured neither drops out nor wins: it counts with the case's worst row, behind it.
#[test]
fn a_surface_that_cannot_be_measured_counts_with_the_worst_row() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = sample_run(folder.path(), 24, 5);
    for (method, status) in [("lost", Status::NoContour), ("stacked", Status::NoCorrespondence)] {
        for case in ["case1", "case2"] {
            let mut mine = run.cells.iter().find(|c| c.case_id == case && c.method == "ours").unwrap().clone();
            (mine.method, mine.seed, mine.run_id) = (method.into(), 0, run::evaluated_id(case, method));
            let Outcome::Scored(score) = &mut mine.outcome else { panic!("not scored") };
            let target = score.metrics.iter_mut().find(|m| m.metric == "target_error_mm").unwrap();
            // `lost` is good in one case and cannot be measured in the other.
            (target.value, target.status) =
                if method == "lost" && case == "case1" { (Some(0.01), Status::Ok) } else { (None, status) };
            run.cells.push(mine);
        }
        run.methods.push(MethodInfo::of(method));
    }
    let worst = |case: &str| {
        let of_case = run.cells.iter().filter(|c| c.case_id == case).filter_map(CellRecord::score);
        of_case.filter_map(|s| s.value("target_error_mm")).fold(0.0, f64::max)
    };
    let summaries = summary::summarise(&run);
    let found =
        |method: &str| summaries.iter().find(|s| s.method.id == method).unwrap().metric("target_error_mm").unwrap();
    assert!((found("stacked").mean.unwrap().mean - 0.5 * (worst("case1") + worst("case2"))).abs() < 1e-12);
    assert!((found("lost").mean.unwrap().mean - 0.5 * (0.01 + worst("case2"))).abs() < 1e-12);
    assert_eq!((found("ours").rank, found("lost").rank, found("stacked").rank), (Some(1), Some(2), Some(3)));
    // However good it is where it can be measured, it stands behind every row that always can.
    for s in summaries.iter().filter(|s| s.method.role == Role::Ranked) {
        let m = s.metric("target_error_mm").unwrap();
        assert!(
            m.is_marked
                || !MethodInfo::is_own(&s.method.id)
                || m.rank.is_none_or(|rank| rank < found("lost").rank.unwrap()),
            "{}",
            s.method.id
        );
    }
    assert!(found("lost").is_marked && found("stacked").is_marked && !found("ours").is_marked);
    let written = write(&run, &folder.path().join("report"), &NoProgress).unwrap();
    let report = fs::read_to_string(&written.markdown).unwrap();
    assert!(report.contains("†: a surface that misses the plane") && report.contains("no_correspondence"), "{report}");
    assert!(fs::read_to_string(folder.path().join("report/table.tex")).unwrap().contains("$\\dagger$"));
    let read = read_run(&folder.path().join("report")).unwrap();
    assert_eq!(
        summary::summarise(&read).iter().map(|s| s.mean("target_error_mm").map(|m| m.mean)).collect::<Vec<_>>(),
        summaries.iter().map(|s| s.mean("target_error_mm").map(|m| m.mean)).collect::<Vec<_>>()
    );
    // Alone with the worst row it is equal to, it stands behind it.
    run.methods.retain(|m| ["ours", "stacked"].contains(&m.id.as_str()));
    run.cells.retain(|c| ["ours", "stacked"].contains(&c.method.as_str()));
    let summaries = summary::summarise(&run);
    let ranks: Vec<Option<usize>> = summaries.iter().map(|s| s.metric("target_error_mm").unwrap().rank).collect();
    assert_eq!(ranks, [Some(1), Some(2)]);
}

/// A run that is read back shows what it kept; a third party's prediction stands beside it, contour and film included.
#[test]
fn a_merged_report_keeps_films_airways_and_contours() {
    let folder = tempfile::tempdir().unwrap();
    let run = sample_run(folder.path(), 48, 6);
    let mut mine = run.clone();
    mine.cells.retain(|c| c.method == "ours" && c.case_id == "case1");
    mine.cases.retain(|c| c.id == "case1");
    let cell = &mut mine.cells[0];
    (cell.method, cell.run_id) = ("mine".into(), run::evaluated_id("case1", "mine"));
    if let Outcome::Scored(score) = &mut cell.outcome {
        score.method = "mine".into();
    }
    (mine.id, mine.methods) = (cell.run_id.clone(), vec![MethodInfo::of("mine")]);
    let [first, second, merged] = ["first", "second", "merged"].map(|name| folder.path().join(name));
    write(&run, &first, &NoProgress).unwrap();
    write(&mine, &second, &NoProgress).unwrap();
    // What comes last is a film of the same case with fewer rows: nothing of the first is lost.
    let both = merge(vec![read_run(&first).unwrap(), read_run(&second).unwrap()], Films::Same).unwrap();
    let written = write(&both, &merged, &NoProgress).unwrap();
    let kept = scene::Scenes::read(&merged).unwrap();
    let rows: Vec<&str> = kept.rows.iter().filter(|r| r.film.case_id == "case1").map(|r| r.method.as_str()).collect();
    assert!(rows.contains(&"mine") && rows.contains(&"ours") && kept.films.len() == 2, "{rows:?}");
    assert!(kept.rows.iter().all(|row| row.pictures.frames.len() >= 5));
    let page = fs::read_to_string(written.html).unwrap();
    assert!(page.contains("\"method\":\"mine\"") && page.contains("A breathing tube"), "the film's title");
    // The whole film, with the renderings of both; of the first part's rows none is lost, and what was renewed is not shown.
    let film_of = |place: &Path| fs::read_to_string(place.join(html::film_page("case1"))).unwrap();
    let shown = |page: &str| {
        let all = page_data::kept_scenes(page, |_, _, _| true).unwrap().unwrap();
        let rows: BTreeMap<String, usize> =
            all.rows.iter().map(|r| (r.method.clone(), r.pictures.frames.len())).collect();
        (all.films[0].clone(), rows)
    };
    let (before, after) = (shown(&film_of(&first)), shown(&film_of(&merged)));
    assert_eq!((before.0.pictures.jpeg, before.0.poses), (after.0.pictures.jpeg, after.0.poses));
    assert_eq!(after.1.len(), before.1.len() + 1);
    assert!(after.1["mine"] == 6 && before.1.iter().all(|(method, frames)| after.1[method] == *frames));
    let mut renewed = read_run(&first).unwrap();
    renewed.cells.iter_mut().for_each(|cell| cell.run_id = "smoke-89abcdef".into());
    let film = gather::whole_film(&renewed, &renewed.cases[0]).unwrap().unwrap();
    assert!(film.rows.is_empty() && film.films.len() == 1);
    assert!(fs::read_to_string(merged.join("report.html")).unwrap().contains("href=\"films/case1.html\""));
    // A film that was changed, and one that is gone.
    let page = second.join(html::film_page("case1"));
    fs::write(&page, film_of(&second) + " ").unwrap();
    let said = write(&both, &folder.path().join("third"), &NoProgress).err().unwrap().to_string();
    assert!(said.contains("case1.html") && said.contains("was changed"), "{said}");
    fs::remove_file(&page).unwrap();
    write(&both, &folder.path().join("third"), &NoProgress).unwrap();
    assert!(!shown(&film_of(&folder.path().join("third"))).1.contains_key("mine"));
    let contours = |place: &Path| fs::read_to_string(place.join("plots/contours.svg")).unwrap();
    assert!(contours(&merged).contains("\nmine\n") && !contours(&first).contains("\nmine\n"));
    // Scenes that were changed are refused like tables.
    let path = first.join(scene::SCENES);
    fs::write(&path, fs::read_to_string(&path).unwrap().replacen("\"seed\":1", "\"seed\":2", 1)).unwrap();
    let said = read_run(&first).err().unwrap().to_string();
    assert!(said.contains("scenes.json") && said.contains("was changed"), "{said}");
}

/// A case of bounds alone, or of less than half of the rows that rank, takes no place from rows that lack it; rows with other
/// seeds are named.
#[test]
fn few_rows_open_no_ranking_case() {
    let folder = tempfile::tempdir().unwrap();
    let run = sample_run(folder.path(), 24, 5);
    let rank = |run: &Run| {
        let summaries = summary::summarise(run);
        summaries.iter().find(|s| s.method.id == "ours").unwrap().metric("psnr_db").unwrap().rank
    };
    assert!(rank(&run).is_some());
    let copied = |of: &str, change: &dyn Fn(&mut CellRecord)| {
        let mut run = run.clone();
        let mut cell = run.cells.iter().find(|c| c.case_id == "case1" && c.method == of).unwrap().clone();
        change(&mut cell);
        if run.cases.iter().all(|case| case.id != cell.case_id) {
            let id = cell.case_id.clone();
            run.cases.push(CaseInfo { id, title: String::new(), tree: String::new(), truth: None });
        }
        run.cells.push(cell);
        run
    };
    assert_eq!(rank(&copied("static-ct", &|cell| cell.case_id = "case9".into())), rank(&run));
    let mut wider = copied("ours-nomesh", &|cell| cell.case_id = "case9".into());
    assert_eq!(rank(&wider), rank(&run));
    wider.cells.extend(copied("bridgesplat-nomesh", &|cell| cell.case_id = "case9".into()).cells.pop());
    assert_eq!(rank(&wider), None);
    let seeds = merge(vec![copied("ours", &|cell| cell.seed = 7)], Films::Other).unwrap();
    assert_eq!(rank(&seeds), rank(&run));
    let is_named = |note: &String| note.starts_with("Seeds that a row has") && note.ends_with(": ours (7).");
    assert!(seeds.notes.iter().any(is_named), "{:?}", seeds.notes);
}

/// A row with other settings keeps its mark, and is not mixed with the one that comes with the program.
#[test]
fn a_changed_method_stays_changed() {
    let folder = tempfile::tempdir().unwrap();
    let mut changed = sample_run(folder.path(), 24, 5);
    let shipped = changed.clone();
    changed.mark_changed(["ours"].into_iter());
    let place = folder.path().join("changed");
    write(&changed, &place, &NoProgress).unwrap();
    let back = read_run(&place).unwrap();
    let title = |run: &Run| run.methods.iter().find(|m| m.id == "ours").unwrap().title.clone();
    assert_eq!(title(&back), "Ours, changed");
    assert_eq!(title(&merge(vec![back.clone()], Films::Same).unwrap()), "Ours, changed");
    let said = merge(vec![back, shipped], Films::Same).err().unwrap().to_string();
    assert!(said.contains("other settings in part-1 than in part-2"), "{said}");
    // What `run.json` says is sealed.
    let path = place.join(run::RUN_FACTS);
    fs::write(&path, fs::read_to_string(&path).unwrap().replace("\"ours\"", "\"ours-gn\"")).unwrap();
    let said = read_run(&place).err().unwrap().to_string();
    assert!(said.contains("run.json") && said.contains("was changed"), "{said}");
}

/// What a third party adds, of its own cases or as a measure of the worst, changes no place of other rows.
#[test]
fn a_third_party_ranks_nobody_out() {
    let folder = tempfile::tempdir().unwrap();
    let run = sample_run(folder.path(), 24, 5);
    let ranks = |run: &Run| -> Vec<(String, Vec<Option<usize>>, Option<f64>)> {
        let of = |s: summary::MethodSummary| {
            let mean = s.mean("target_mean_mm").map(|m| m.mean);
            (s.method.id.clone(), s.metrics.iter().map(|m| m.rank).collect(), mean)
        };
        summary::summarise(run).into_iter().map(of).filter(|(id, ..)| id != "mine").collect()
    };
    let mut worse = run.clone();
    // `ours` has a surface that cannot be measured in case1; a foreign row that is far off there sets no measure.
    let unmeasured = |run: &mut Run| {
        let ours = run.cells.iter_mut().find(|c| c.case_id == "case1" && c.method == "ours").unwrap();
        let Outcome::Scored(score) = &mut ours.outcome else { panic!("not scored") };
        let target = score.metrics.iter_mut().find(|m| m.metric == "target_error_mm").unwrap();
        (target.value, target.status) = (None, Status::NoContour);
        ours.clone()
    };
    let mut own = run.clone();
    unmeasured(&mut own);
    let ours = unmeasured(&mut worse);
    worse.methods.push(MethodInfo::of("mine"));
    for case in ["case1", "case2", "case9"] {
        let mut mine = ours.clone();
        (mine.case_id, mine.method, mine.run_id) = (case.into(), "mine".into(), run::evaluated_id(case, "mine"));
        let Outcome::Scored(score) = &mut mine.outcome else { panic!("not scored") };
        for m in &mut score.metrics {
            let is_higher = crate::score::metric(&m.metric).unwrap().direction == Goal::Higher;
            (m.value, m.status) = (Some(if is_higher { -900.0 } else { 900.0 }), Status::Ok);
        }
        worse.cells.push(mine);
    }
    worse.cases.push(CaseInfo { id: "case9".into(), title: String::new(), tree: String::new(), truth: None });
    assert_eq!(ranks(&own), ranks(&worse));
    let mine = &summary::summarise(&worse).pop().unwrap();
    assert!(mine.cases == 2 && mine.metric("psnr_db").unwrap().rank.is_some());
    let merged = merge(vec![worse], Films::Other).unwrap();
    assert!(merged.notes.iter().any(|note| note.ends_with("count in no mean or place: case9.")), "{:?}", merged.notes);
}

/// Times rank where they were measured beside the others.
#[test]
fn times_of_another_machine_have_no_place() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = sample_run(folder.path(), 24, 4);
    let rank = |run: &Run, method: &str| {
        let summaries = summary::summarise(run);
        summaries.iter().find(|s| s.method.id == method).unwrap().metric("time_total_s").unwrap().rank
    };
    assert!(rank(&run, "ours").is_some() && rank(&run, "ours-nomesh").is_some());
    for cell in run.cells.iter_mut().filter(|c| c.method == "ours") {
        cell.timings[0].machine_id = "a faster one".into();
    }
    assert!(rank(&run, "ours").is_none() && rank(&run, "ours-nomesh").is_some());
    let merged = merge(vec![run], Films::Same).unwrap();
    assert!(merged.notes.iter().any(|note| note.ends_with("without a place: ours.")), "{:?}", merged.notes);
}

/// Numbers of another definition, or that the metric cannot have, are not this version's; and a renewed row says where
/// it is from.
#[test]
fn what_a_table_cannot_hold_is_refused_and_a_renewed_row_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let run = sample_run(folder.path(), 24, 4);
    let place = folder.path().join("run");
    write(&run, &place, &NoProgress).unwrap();
    let path = place.join("results.csv");
    let good = fs::read_to_string(&path).unwrap();
    let row = good.lines().find(|row| row.contains(",ours,") && row.contains(",target_p95_mm,")).unwrap();
    let value = row.split(',').nth(12).unwrap();
    let edited = |from: &str, to: &str| {
        fs::write(&path, good.replace(row, &row.replacen(from, to, 1))).unwrap();
        read_run(&place).err().unwrap().to_string()
    };
    for unfit in ["-3", "NaN", "inf"] {
        let said = edited(&format!(",{value},"), &format!(",{unfit},"));
        assert!(said.contains("column value") && said.contains("is no value of target_p95_mm"), "{said}");
    }
    let said = edited("target_p95_mm/", "target_p95_mm/9");
    assert!(
        said.contains("column definition") && said.contains("the definition changed from target_p95_mm/9"),
        "{said}"
    );
    fs::write(&path, &good).unwrap();

    let mut renewed = run.clone();
    renewed.cells.retain(|c| c.method == "ours" && c.case_id == "case1");
    let Outcome::Scored(score) = &mut renewed.cells[0].outcome else { panic!("not scored") };
    score.metrics.iter_mut().find(|m| m.metric == "target_p95_mm").unwrap().value = Some(0.5);
    let notes = merge(vec![run.clone(), renewed], Films::Same).unwrap().notes;
    assert!(notes.contains(&"`ours` of case1 is that of part-2, in place of an earlier one.".to_owned()), "{notes:?}");
    let notes = merge(vec![run.clone(), run], Films::Same).unwrap().notes;
    // Where the parts are from, and that a row failed in one of the cases; nothing is renewed.
    assert!(
        notes.len() == 2
            && notes[1]
                == "Without a place, since not scored in every case that counts with the same seeds: bridgesplat.",
        "{notes:?}"
    );
}
