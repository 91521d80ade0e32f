//! A whole report from graded predictions of two cases.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::*;
use crate::base::NoProgress;
use crate::score::fixture::{Distortion, TubeTruth, write_prediction};
use crate::score::{ScoreSettings, Truth, score};
use crate::simulate::track::Track;

fn quality(method: &str) -> Distortion {
    let d = Distortion::default();
    match method {
        "ours" => Distortion { noise: 8.0, depth_scale: 0.02, lag: 1, surface_shift_mm: 0.4, seconds: 3.0, ..d },
        "ours-nomesh" => Distortion { noise: 6.0, depth_scale: 0.05, dropout: 0.02, lag: 2, seconds: 4.0, ..d },
        "bridgesplat" => Distortion { blur_px: 2, depth_scale: 0.6, surface_shift_mm: 3.5, seconds: 40.0, ..d },
        "bridgesplat-nomesh" => {
            Distortion { blur_px: 1, noise: 5.0, depth_scale: 0.4, dropout: 0.2, seconds: 11.0, ..d }
        }
        "static-ct" => Distortion { shift_px: 4, depth_scale: 0.3, surface_shift_mm: 6.0, seconds: 1.0, ..d },
        _ => Distortion { noise: 4.0, depth_scale: 0.01, seconds: 2.0, ..d },
    }
}

/// Two cases, six methods, one failed cell; predictions live in `folder`.
pub(super) fn sample_run(folder: &Path, side: u32, frames: usize) -> Run {
    let methods = ["bridgesplat", "bridgesplat-nomesh", "ours-nomesh", "ours", "static-ct", "oracle-phase"];
    let truths: Vec<Arc<TubeTruth>> =
        [("case1", frames), ("case2", frames - 1)].map(|(id, n)| Arc::new(TubeTruth::new(id, side, n))).to_vec();
    let mut cells = Vec::new();
    for (index, truth) in truths.iter().enumerate() {
        for method in methods {
            let prediction: PathBuf = folder.join(format!("{}-{method}", truth.case_id()));
            let mut distortion = quality(method);
            distortion.noise += 2.0 * index as f64;
            write_prediction(truth.as_ref(), &prediction, &distortion);
            if method.starts_with("bridgesplat") {
                fs::remove_file(prediction.join("phase.csv")).unwrap();
            }
            if method.ends_with("nomesh") {
                fs::remove_file(prediction.join("mesh/final.ply")).unwrap();
            }
            let settings = ScoreSettings { method: Some(method.into()), seed: 1, ..Default::default() };
            let outcome = if index == 1 && method == "bridgesplat" {
                Outcome::Failed("=the mesh folded, at frame 3 | see <log>".into())
            } else {
                Outcome::Scored(Box::new(score(truth.as_ref(), &prediction, &settings).unwrap()))
            };
            let timings = vec![StageCost {
                stage: "reconstruct".into(),
                wall_s: 1.5,
                cpu_s: 2.5,
                peak_memory_mib: 100.0,
                threads: 2,
                machine_id: "machine".into(),
            }];
            let case_id = truth.case_id().to_owned();
            let run_id = "smoke-01234567".into();
            cells.push(CellRecord { run_id, case_id, method: method.into(), seed: 1, prediction, outcome, timings });
        }
    }
    let case = |t: &Arc<TubeTruth>| CaseInfo {
        id: t.case_id().to_owned(),
        title: format!("A breathing tube, {} frames", t.frames().len()),
        tree: format!("tree of {}", t.case_id()),
        truth: Some(t.clone() as Arc<dyn Truth>),
    };
    Run {
        id: "smoke-01234567".into(),
        profile: "smoke".into(),
        track: Track::Ideal,
        conditions: Vec::new(),
        notes: Vec::new(),
        cases: truths.iter().map(case).collect(),
        methods: methods.map(MethodInfo::of).to_vec(),
        cells,
        scenes: Default::default(),
        read_from: Vec::new(),
    }
}

fn columns(path: &Path) -> Vec<String> {
    csv::Reader::from_path(path).unwrap().headers().unwrap().iter().map(str::to_owned).collect()
}

/// LaTeX stops at a row with more cells than its `tabular` declares.
fn assert_columns_fit(latex: &str) {
    let tables = latex.split("\\begin{tabular}{@{}").skip(1).map(|rest| rest.split_once("@{}}").unwrap());
    for (declared, rest) in tables {
        let columns = declared.chars().filter(|letter| "lc".contains(*letter)).count();
        let rows = rest.split("\\end{tabular}").next().unwrap().lines().filter(|line| line.ends_with("\\\\"));
        let cells = |row: &str| {
            let wide = row.split("\\multicolumn{").skip(1).map(|rest| rest.split('}').next().unwrap());
            let more: usize = wide.map(|count| count.parse::<usize>().unwrap() - 1).sum();
            row.replace("\\&", "").matches('&').count() + 1 + more
        };
        for row in rows {
            assert_eq!(cells(row), columns, "{row}");
        }
    }
}

#[test]
fn tables_for_latex_declare_the_columns_that_they_have() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = sample_run(folder.path(), 16, 3);
    for track in [Track::Ideal, Track::Clinical] {
        run.track = track;
        let tables = table::ComparisonTable::all(track, &summary::summarise(&run));
        assert!(tables.len() >= 2);
        tables.iter().for_each(|table| assert_columns_fit(&latex::table(table, &run.id)));
    }
}

#[test]
fn the_whole_report_is_written_and_says_what_it_should() {
    let folder = tempfile::tempdir().unwrap();
    // `RESPIRE_BENCH_REPORT=<folder>` keeps a larger report there, for a look at its images.
    let kept = std::env::var_os("RESPIRE_BENCH_REPORT").map(PathBuf::from);
    let (side, frames) = if kept.is_some() { (64, 41) } else { (24, 9) };
    let run = sample_run(folder.path(), side, frames);
    let out = kept.unwrap_or_else(|| folder.path().join("report"));
    let written = write(&run, &out, &NoProgress).unwrap();

    let comparison = columns(&out.join("comparison.csv"));
    let fixed = "case_id, method, seed, psnr_db, ssim, depth_rmse_mm, depth_delta_1_25, phase_mae, phase_pearson_r, \
        contour_rmse_mm, target_error_mm, time_total_s, time_per_frame_s, frames, status";
    assert_eq!(comparison[..15].join(", "), fixed);
    assert_eq!(columns(&out.join("results.csv")), tables::RESULTS_COLUMNS);
    let summary = columns(&out.join("summary.csv"));
    for id in ["psnr_db", "psnr_db_ci_low", "psnr_db_ci_high", "time_per_frame_s_ci_high"] {
        assert!(summary.iter().any(|c| c == id), "{id}");
    }
    for file in ["results.csv", "comparison.csv", "summary.csv", "frames.csv", "timings.csv"] {
        let text = fs::read_to_string(out.join(file)).unwrap();
        assert!(!text.contains("NaN") && !text.contains("inf,") && !text.contains('\r'), "{file}");
    }
    let results = fs::read_to_string(out.join("results.csv")).unwrap();
    assert!(!results.contains("time_total_s") && !results.contains("machine"));
    assert!(results.contains("'=the mesh folded"), "a spreadsheet would run this text");

    let markdown = fs::read_to_string(&written.markdown).unwrap();
    assert!(
        markdown.contains("(1.22)")
            && markdown.contains("**")
            && markdown.contains("the mesh folded, at frame 3 \\| see &lt;log>")
    );
    let html = fs::read_to_string(&written.html).unwrap();
    assert!(html.contains("<svg") && html.contains("data-method=\"ours\"") && html.contains("\"airway\":{\"low_mm\""));
    for external in ["src=\"http", "href=\"http", "<script src", "url(", "@import", "fetch(", "XMLHttpRequest"] {
        assert!(!html.contains(external), "{external}");
    }
    let kept = scene::Scenes::read(&out).unwrap();
    assert_eq!((kept.films.len(), kept.rows.len()), (2, 11), "a failed cell has nothing to show");
    let whole = fs::read_to_string(out.join("films/case1.html")).unwrap();
    assert_eq!(whole.matches("class=\"case\"").count(), 1);
    let latex = fs::read_to_string(out.join("table.tex")).unwrap();
    assert_eq!(latex.matches("\\begin{").count(), latex.matches("\\end{").count());
    assert_columns_fit(&latex);
    for picture in ["plots/methods", "plots/phase", "plots/contours", "plots/error-against-time", "plots/frames-case1"]
    {
        assert!(
            out.join(format!("{picture}.svg")).is_file() && out.join(format!("{picture}.png")).is_file(),
            "{picture}"
        );
    }
    assert!(out.join("panels/images-case2.png").is_file() && out.join("panels/depth-case1.png").is_file());
}

#[test]
fn the_same_scores_give_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let run = sample_run(folder.path(), 16, 3);
    for name in ["a", "b"] {
        tables::write_results(&run, &folder.path().join(name)).unwrap();
    }
    assert_eq!(fs::read(folder.path().join("a")).unwrap(), fs::read(folder.path().join("b")).unwrap());
}

/// Films may come from elsewhere: their machine is not that of the methods' times.
#[test]
fn the_machines_of_a_report_are_those_of_its_methods() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = sample_run(folder.path(), 16, 3);
    for cell in &mut run.cells {
        let (stage, machine_id) = ("simulate".to_owned(), "another machine".to_owned());
        cell.timings.push(StageCost { stage, machine_id, ..cell.timings[0].clone() });
    }
    write(&run, &folder.path().join("report"), &NoProgress).unwrap();
    let read = read::read(&folder.path().join("report")).unwrap();
    assert_eq!(read.machines.iter().collect::<Vec<_>>(), [&("machine".to_owned(), "2".to_owned())]);
}

/// Nothing scored, nothing to draw: still a report.
#[test]
fn a_run_in_which_everything_failed_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = sample_run(folder.path(), 16, 3);
    for cell in &mut run.cells {
        cell.outcome = Outcome::Failed("disk full".into());
    }
    let written = write(&run, &folder.path().join("report"), &NoProgress).unwrap();
    assert!(fs::read_to_string(&written.markdown).unwrap().contains("disk full"));
}

/// Scenes whose pictures are `bytes` long, for some cases and fourteen rows, with a run to go with them.
fn large_run(folder: &Path, cases: usize, bytes: usize) -> (Run, scene::Scenes) {
    let small = sample_run(folder, 16, 3);
    let (film, row) = {
        let kept = gather::gather(&small, &NoProgress).unwrap();
        (kept.films[0].clone(), kept.rows[0].clone())
    };
    let mut run = Run { cases: Vec::new(), methods: Vec::new(), cells: Vec::new(), ..small.clone() };
    let mut scenes = scene::Scenes::default();
    let pictures = |seed: usize| {
        let jpeg = |k: usize| (0..bytes).map(|i| (i * (k + seed) % 251) as u8).collect();
        let jpeg = (0..48).map(|k| scene::Packed(jpeg(k))).collect();
        scene::Pictures { frames: (0..48).collect(), width: 128, height: 128, jpeg }
    };
    let vertices = 12_000usize;
    let airway = scene::AirwayScene {
        low_mm: [0.0; 3],
        step_mm: 0.01,
        inspiration: scene::Packed((0..3 * vertices).map(|v| v as u16).collect()),
        expiration: scene::Packed((0..3 * vertices).map(|v| (v * 7) as u16).collect()),
        last: None,
        faces: scene::Packed((0..6 * vertices).map(|v| (v / 6) as u16).collect()),
    };
    run.methods = (0..14).map(|k| MethodInfo::of(&format!("method {k}"))).collect();
    for case in 0..cases {
        let case_id = format!("case{case}");
        let key = scene::FilmKey { case_id: case_id.clone(), ..film.film.clone() };
        let frames = |values: &scene::Packed<f32>, each: usize| scene::Packed(values.0[..each].repeat(48));
        scenes.films.push(scene::FilmScene {
            film: key.clone(),
            times_s: frames(&film.times_s, 1),
            phases: frames(&film.phases, 1),
            poses: frames(&film.poses, 12),
            // Of many, making them smaller takes long, and is tested elsewhere.
            airway: (cases < 10).then(|| airway.clone()),
            pictures: pictures(case),
            ..film.clone()
        });
        run.cases.push(CaseInfo { id: case_id.clone(), title: String::new(), tree: String::new(), truth: None });
        for method in &run.methods {
            let mut cell = small.cells[0].clone();
            (cell.case_id, cell.method) = (case_id.clone(), method.id.clone());
            if let Outcome::Scored(score) = &mut cell.outcome {
                (score.case_id, score.method) = (case_id.clone(), method.id.clone());
            }
            scenes.rows.push(scene::RowScene {
                film: key.clone(),
                method: method.id.clone(),
                pictures: pictures(case + 20),
                targets_mm: scene::Packed(vec![1.0; 48 * 30]),
                ..row.clone()
            });
            run.cells.push(cell);
        }
    }
    (run, scenes)
}

/// The page of a run with these scenes, and a plot of `plot` bytes for each case.
fn page_of(run: &Run, scenes: &scene::Scenes, plot: usize) -> String {
    // Intervals of many cases take long, and their tables are of the same size.
    let cells = run.cells[..9 * run.methods.len()].to_vec();
    let few = Run { cases: run.cases[..9].to_vec(), cells, ..run.clone() };
    let tables = table::ComparisonTable::all(few.track, &summary::summarise(&few));
    let of_case = |case: &CaseInfo| {
        let svg = Some(format!("<svg>{}</svg>", "x".repeat(plot)));
        let (title, caption) = ("A plot".to_owned(), "of this case".to_owned());
        (case.id.clone(), vec![plots::ReportImage { title, caption, png: "a.png".into(), svg }])
    };
    let by_case = run.cases.iter().map(of_case).collect();
    let pictures = plots::ReportImages { by_case, ..plots::ReportImages::default() };
    let whole_films = &run.cases.iter().map(|case| case.id.clone()).collect();
    let track = html::TrackReport {
        run,
        place: "",
        tables: &tables,
        differences: &[],
        pictures: &pictures,
        scenes,
        whole_films,
    };
    html::report(&[track])
}

/// However many cases there are, the page stays below its bound, says where the rest is, and keeps the comparison.
#[test]
fn many_cases_say_less_each_and_stay_below_fifteen_megabytes() {
    let folder = tempfile::tempdir().unwrap();
    let plots = |page: &str| page.matches("of this case").count();
    let players = |page: &str| page.matches("class=\"player\"").count();
    for (cases, plot, shown, played) in [(9, 1_000, 9, 9), (60, 300_000, 0, 60), (500, 300_000, 0, 0)] {
        let (run, scenes) = large_run(folder.path(), cases, 50);
        let page = page_of(&run, &scenes, plot);
        assert!(page.len() <= html::PAGE_BYTES, "{cases} cases: {} bytes", page.len());
        assert_eq!((plots(&page), players(&page)), (shown, played), "{cases} cases");
        assert_eq!(page.contains("Too many cases"), cases > 9);
        assert_eq!(page.matches("<details class=\"case\"").count(), cases);
    }
}

/// However large the pictures are, the page stays below its bound, and each row keeps some.
#[test]
fn nine_films_with_fourteen_rows_stay_below_fifteen_megabytes() {
    let folder = tempfile::tempdir().unwrap();
    for (bytes, least) in [(2_500, 15), (9_000, 4)] {
        let (run, scenes) = large_run(folder.path(), 9, bytes);
        let page = page_of(&run, &scenes, 0);
        assert!(page.len() <= html::PAGE_BYTES && page.len() > html::PAGE_BYTES * 3 / 4, "{} bytes", page.len());
        let each = page.matches("\"frames\":[").count();
        assert_eq!(each, 9 * 15);
        let first = page.split("\"frames\":[").nth(1).unwrap().split(']').next().unwrap();
        assert!(first.split(',').count() >= least, "{first}");
    }
}

/// Two reports under one page: each is whole in its folder, and the page's links lead there.
#[test]
fn a_page_of_two_tracks_switches_between_whole_reports() {
    let folder = tempfile::tempdir().unwrap();
    let run = sample_run(folder.path(), 24, 4);
    let out = folder.path().join("out");
    let written = write_named(&[(&run, "first"), (&run, "second")], &out, &NoProgress).unwrap();
    assert_eq!((written.html, written.markdown), (out.join("report.html"), out.join("first/report.md")));
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert_eq!(page.matches("<section class=\"track\"").count(), 2);
    for name in ["first", "second"] {
        let own = fs::read_to_string(out.join(name).join("report.html")).unwrap();
        assert_eq!(own.matches("<section class=\"track\"").count(), 1);
        read::read(&out.join(name)).unwrap();
        for link in ["films/case1.html", "films/case2.html"] {
            assert!(out.join(name).join(link).exists());
            assert!(page.contains(&format!("href=\"{name}/{link}\"")) && own.contains(&format!("href=\"{link}\"")));
        }
    }
    for link in page.split("href=\"").skip(1).map(|rest| rest.split('"').next().unwrap()) {
        assert!(link.starts_with("data:") || out.join(link).exists(), "{link}");
    }
    // One track has one run.
    let refused = write_tracks(&[run.clone(), run.clone()], &folder.path().join("no"), &NoProgress).unwrap_err();
    assert!(refused.to_string().contains("these are of: ideal, ideal"), "{refused}");
    assert!(write_tracks(&[], &folder.path().join("no"), &NoProgress).is_err() && !folder.path().join("no").exists());
    // One run lies where it always did.
    let alone = write_tracks(&[run], &folder.path().join("one"), &NoProgress).unwrap();
    assert_eq!(alone.html, folder.path().join("one/report.html"));
}

/// What `ours-window` adds stands below the first table that has the row, and below no other.
#[test]
fn a_table_says_what_a_row_adds_to_the_paper() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = sample_run(folder.path(), 24, 5);
    let additions = |run: &Run| -> Vec<String> {
        let tables = table::ComparisonTable::all(run.track, &summary::summarise(run));
        tables.iter().flat_map(table::ComparisonTable::additions).collect()
    };
    assert!(additions(&run).is_empty());
    for cell in run.cells.iter_mut().filter(|cell| cell.method == "ours") {
        cell.method = "ours-window".into();
        let Outcome::Scored(score) = &mut cell.outcome else { panic!("ours is scored in both cases") };
        score.method = "ours-window".into();
    }
    run.methods.push(MethodInfo::of("ours-window"));
    let said = additions(&run);
    assert!(
        said.len() == 1 && said[0].starts_with("Ours + keyframes adds to the paper's equations: keyframes,"),
        "{said:?}"
    );
}
