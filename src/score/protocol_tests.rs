//! The whole protocol on folders: truth is perfect, graded distortions are told apart, damage is named.

use std::fs;
use std::path::Path;

use super::contour::target_errors;
use super::fixture::{BeyondPhase, Distortion, PHASE_SD, TARGET_SD_MM, TubeTruth, write_prediction};
use super::{CellScore, Goal, Question, ScoreSettings, Status, Truth, check_prediction, metric, registry, score};
use crate::base::{TriangleMesh, files};
use crate::formats::{exr, mesh, png};

fn scored(truth: &TubeTruth, distortion: &Distortion) -> CellScore {
    let folder = tempfile::tempdir().unwrap();
    write_prediction(truth, folder.path(), distortion);
    score(truth, folder.path(), &ScoreSettings::default()).unwrap()
}

#[test]
fn truth_as_prediction_is_perfect() {
    let truth = TubeTruth::new("tube", 40, 17);
    let found = scored(&truth, &Distortion::default());
    for m in registry() {
        let score = found.metric(m.id).unwrap();
        match m.perfect {
            _ if ["psnr_db", "psnr_ahead_db", "ssim", "ssim_padded"].contains(&m.id) => {
                assert_eq!((score.value, score.status), (None, Status::Copied), "{}: the input handed back", m.id);
            }
            Some(perfect) => {
                let value = score.value.unwrap_or_else(|| panic!("{} has no value: {score:?}", m.id));
                assert!((value - perfect).abs() < 1e-9, "{}: {value}", m.id);
                assert_eq!(score.status, Status::Ok);
            }
            None if m.is_runtime() => assert!(score.value.is_some()),
            None if m.id.starts_with("phase_coverage") => assert_eq!(score.value, Some(100.0)),
            None if m.id.starts_with("navigation_coverage") => assert_eq!(score.value, Some(100.0)),
            None if m.id == "navigation_sd_mm" => {
                assert!((score.value.unwrap() - TARGET_SD_MM * 3f64.sqrt()).abs() < 1e-12);
            }
            None if m.id == "phase_sd_mean" => assert!((score.value.unwrap() - PHASE_SD).abs() < 1e-12),
            None => assert_eq!((score.value, score.status), (None, Status::Identical), "{}", m.id),
        }
    }
    assert_eq!(found.value("time_per_frame_s"), Some(2.0 / 17.0));
    assert_eq!(found.value("time_cpu_s"), Some(4.0));
}

/// Error bars cover what lies within them, and are empty where none are stated.
#[test]
fn error_bars_are_held_to_the_errors() {
    let truth = TubeTruth::new("tube", 24, 17);
    let offset = |sds: f64| Distortion { noise: 6.0, phase_offset: sds * PHASE_SD, ..Default::default() };
    for (sds, one, two) in [(0.9, 100.0, 100.0), (1.1, 0.0, 100.0), (2.1, 0.0, 0.0)] {
        let found = scored(&truth, &offset(sds));
        let values = ["phase_coverage_1sd_pct", "phase_coverage_2sd_pct"].map(|id| found.value(id).unwrap());
        assert_eq!(values, [one, two], "{sds} standard deviations off");
        assert!((found.value("phase_sd_mean").unwrap() - PHASE_SD).abs() < 1e-12);
    }
    let folder = tempfile::tempdir().unwrap();
    write_prediction(&truth, folder.path(), &offset(0.0));
    let table = fs::read_to_string(folder.path().join("phase.csv")).unwrap();
    let bare = table.replace(",phase_sd", "").replace(&format!(",{PHASE_SD}\n"), "\n");
    fs::write(folder.path().join("phase.csv"), bare).unwrap();
    let found = score(&truth, folder.path(), &ScoreSettings::default()).unwrap();
    assert_eq!(found.metric("phase_coverage_2sd_pct").unwrap().status, Status::NotApplicable);
    assert!(found.value("phase_mae").is_some());
}

#[test]
fn graded_distortions_are_told_apart() {
    let truth = TubeTruth::new("tube", 40, 24);
    let none = Distortion::default();
    type Kind = (&'static str, &'static [&'static str], fn(f64) -> Distortion);
    let kinds: [Kind; 10] = [
        ("noise", &["psnr_db", "ssim", "ssim_padded", "psnr_ahead_db", "novel_psnr_db", "novel_ssim"], |g| {
            Distortion { noise: 6.0 * g, ..Default::default() }
        }),
        ("blur", &["psnr_db", "ssim", "psnr_ahead_db"], |g| Distortion { blur_px: g as usize, ..Default::default() }),
        ("shift", &["psnr_db", "ssim"], |g| Distortion { shift_px: g as usize, ..Default::default() }),
        ("scale", &["depth_rmse_mm", "depth_delta_1_25", "novel_depth_rmse_mm"], |g| Distortion {
            depth_scale: 0.24 + 0.1 * (g - 0.5),
            ..Default::default()
        }),
        ("dropout", &["depth_rmse_mm", "depth_coverage", "novel_depth_rmse_mm", "novel_depth_delta_1_25"], |g| {
            Distortion { dropout: 0.1 * g, ..Default::default() }
        }),
        ("targets", &["target_mean_mm", "target_p95_mm", "navigation_error_mm", "navigation_error_p95_mm"], |g| {
            Distortion { surface_shift_mm: 0.5 * g, ..Default::default() }
        }),
        ("lag", &["phase_mae", "phase_pearson_r"], |g| Distortion { lag: 2 * g as usize, ..Default::default() }),
        ("offset", &["phase_mae"], |g| Distortion { phase_offset: -0.1 * g, ..Default::default() }),
        ("pose", &["pose_error_mm", "pose_error_deg"], |g| Distortion { pose_shift: 0.4 * g, ..Default::default() }),
        ("surface", &["contour_rmse_mm", "target_error_mm", "target_error_mean_mm", "target_error_p95_mm"], |g| {
            Distortion { surface_shift_mm: 0.5 * g, ..Default::default() }
        }),
    ];
    for (kind, metrics, distortion) in kinds {
        let grades: Vec<CellScore> = (1..=3).map(|g| scored(&truth, &distortion(f64::from(g)))).collect();
        for id in metrics {
            let values: Vec<f64> = grades.iter().map(|s| s.value(id).unwrap()).collect();
            let m = metric(id).unwrap();
            let perfect = m.perfect.unwrap_or(match m.direction {
                Goal::Higher => f64::INFINITY,
                Goal::Lower => 0.0,
            });
            let worse =
                |a: f64, b: f64| m.direction.better(a, b) || (kind == "scale" && *id == "depth_delta_1_25" && a == b);
            assert!(
                worse(perfect, values[0]) && worse(values[0], values[1]) && worse(values[1], values[2]),
                "{kind}: {id} from {perfect} to {values:?}"
            );
        }
    }
    // A surface moved by 0.5 mm has a target error of just that.
    let moved = scored(&truth, &Distortion { surface_shift_mm: 0.5, ..none });
    assert!((moved.value("target_error_mm").unwrap() - 0.5).abs() < 1e-9);
    assert!((moved.value("target_mean_mm").unwrap() - 0.5).abs() < 1e-9);
    assert!((moved.value("navigation_error_mm").unwrap() - 0.5).abs() < 1e-9);
    // A camera that is elsewhere than said is an error of navigation, and none of the targets.
    let along = scored(&truth, &Distortion { pose_shift: 0.4, ..none });
    assert!(along.value("navigation_error_mm").unwrap() > 0.3 && along.value("target_mean_mm").unwrap() < 1e-9);
    assert!(["pose_error_mm", "pose_error_deg"].iter().all(|id| (along.value(id).unwrap() - 0.4).abs() < 1e-9));
    // Ten millimetres off, and an error bar of 2.1 mm: lost in silence.
    let lost = scored(&truth, &Distortion { surface_shift_mm: 10.0, ..none });
    let values = |cell: &CellScore| ["lost_pct", "silent_pct", "recovered_pct"].map(|id| cell.value(id).unwrap());
    assert_eq!((values(&moved), values(&lost)), ([0.0, 0.0, 100.0], [100.0, 100.0, 0.0]));
    assert!(lost.value("navigation_coverage_2sd_pct").unwrap() < 70.0);
    assert!((moved.value("depth_rmse_mm").unwrap()).abs() < 1e-9);
}

/// Codes of which one bit is turned are off by just that: 8, 16 and 32 of 255.
#[test]
fn each_kind_of_picture_is_compared_with_its_own_truth() {
    let truth = TubeTruth::new("tube", 24, 17);
    let folder = tempfile::tempdir().unwrap();
    write_prediction(&truth, folder.path(), &Distortion::default());
    for (kind, bit) in [("color", 8), ("ahead", 16), ("novel", 32)] {
        for entry in fs::read_dir(folder.path().join(kind)).unwrap() {
            let path = entry.unwrap().path();
            let mut image = png::read_rgb(&path).unwrap();
            image.data.iter_mut().for_each(|code| *code ^= bit);
            png::write_rgb(&path, &image).unwrap();
        }
    }
    let found = score(&truth, folder.path(), &ScoreSettings::default()).unwrap();
    for (id, off) in [("psnr_db", 8.0f64), ("psnr_ahead_db", 16.0), ("novel_psnr_db", 32.0)] {
        let expected = 20.0 * (255.0 / off).log10();
        assert!((found.value(id).unwrap() - expected).abs() < 1e-9, "{id}: {:?} {expected}", found.value(id));
    }
}

/// Targets off by 0.1, 0.2 and 0.3 mm in every frame: their 95th percentile is that of the worst, and no frame's mean.
#[test]
fn percentiles_are_of_single_targets() {
    let truth = TubeTruth::new("tube", 24, 9);
    let folder = tempfile::tempdir().unwrap();
    write_prediction(&truth, folder.path(), &Distortion::default());
    write_targets(&truth, folder.path(), |target| 0.1 * (target + 1) as f64);
    let found = score(&truth, folder.path(), &ScoreSettings::default()).unwrap();
    for (id, mm) in [
        ("target_mean_mm", 0.2),
        ("target_p95_mm", 0.3),
        ("navigation_error_mm", 0.2),
        ("navigation_error_p95_mm", 0.3),
    ] {
        assert!((found.value(id).unwrap() - mm).abs() < 1e-9, "{id}: {:?}", found.value(id));
    }
}

/// `targets.csv` with the truth, each target moved along x by `off_mm`.
fn write_targets(truth: &dyn Truth, folder: &Path, off_mm: impl Fn(usize) -> f64) {
    let mut rows = "frame,target,x_mm,y_mm,z_mm\n".to_owned();
    for frame in 0..truth.frames().len() {
        for target in 0..truth.targets().len() {
            let place = truth.target_mm(target, frame);
            rows.push_str(&format!("{frame},{target},{},{},{}\n", place.x + off_mm(target), place.y, place.z));
        }
    }
    fs::write(folder.join("targets.csv"), rows).unwrap();
}

/// A prediction with poses is navigated by them, one without by those that it was told, and neither by the true ones.
#[test]
fn navigation_is_by_the_poses_that_a_prediction_has() {
    let truth = BeyondPhase(TubeTruth::new("tube", 24, 9));
    let folder = tempfile::tempdir().unwrap();
    write_prediction(&truth, folder.path(), &Distortion::default());
    write_targets(&truth, folder.path(), |_| 0.0);
    let error_mm = || {
        let found = score(&truth, folder.path(), &ScoreSettings::default()).unwrap();
        found.value("navigation_error_mm").unwrap()
    };
    assert!(error_mm() < 1e-9);
    fs::remove_file(folder.path().join("poses.csv")).unwrap();
    assert!((error_mm() - BeyondPhase::TOLD_OFF_MM).abs() < 1e-9, "{}", error_mm());
}

/// A surface that grows wider along the tube: what it is off says which frame, phase and plane it was compared at.
#[test]
fn the_final_surface_is_compared_at_the_last_frame() {
    let truth = TubeTruth::new("tube", 24, 9);
    let folder = tempfile::tempdir().unwrap();
    write_prediction(&truth, folder.path(), &Distortion::default());
    let last = &truth.frames()[8];
    let (mut exact, other) = (truth.inspiration().unwrap(), truth.expiration().unwrap());
    exact.vertices.iter_mut().zip(&other.vertices).for_each(|(v, there)| *v = v.lerp(*there, last.phase));
    let mut wide = exact.clone();
    wide.vertices.iter_mut().for_each(|v| v.x *= 1.0 + 0.01 * v.z);
    mesh::write_ply(&folder.path().join("mesh/final.ply"), &wide, &[]).unwrap();
    let found = score(&truth, folder.path(), &ScoreSettings::default()).unwrap();
    let expected = target_errors(&exact, &wide, None, &last.world_from_camera, 1).unwrap().unwrap();
    let wanted = [expected.contour_rmse_mm, expected.target_mm, expected.mean_mm, expected.p95_mm];
    let ids = ["contour_rmse_mm", "target_error_mm", "target_error_mean_mm", "target_error_p95_mm"];
    for (id, wanted) in ids.into_iter().zip(wanted) {
        let off = found.value(id).unwrap() - wanted.unwrap();
        assert!(off.abs() < 1e-9 && wanted.unwrap() > 0.1, "{id}: {off} of {wanted:?}");
    }
}

#[test]
fn what_is_not_claimed_is_not_applicable_and_constant_phase_has_no_correlation() {
    let truth = TubeTruth::new("tube", 24, 9);
    let folder = tempfile::tempdir().unwrap();
    write_prediction(&truth, folder.path(), &Distortion { noise: 6.0, ..Default::default() });
    for gone in ["depth", "mesh", "ahead", "novel", "novel_depth"] {
        fs::remove_dir_all(folder.path().join(gone)).unwrap();
    }
    fs::remove_file(folder.path().join("timing.json")).unwrap();
    fs::remove_file(folder.path().join("targets.csv")).unwrap();
    fs::remove_file(folder.path().join("target_covariance.csv")).unwrap();
    let rows: String = (0..9).map(|f| format!("{f},0\n")).collect();
    fs::write(folder.path().join("phase.csv"), format!("frame,phase\n{rows}")).unwrap();
    let found = score(&truth, folder.path(), &ScoreSettings::default()).unwrap();
    let metrics = ["depth_rmse_mm", "contour_rmse_mm", "target_error_p95_mm", "time_total_s", "psnr_ahead_db"];
    let of_views = ["novel_psnr_db", "novel_ssim", "novel_depth_rmse_mm", "target_mean_mm", "target_p95_mm"];
    let of_navigation = [
        "navigation_error_mm",
        "navigation_error_p95_mm",
        "lost_pct",
        "silent_pct",
        "recovered_pct",
        "navigation_sd_mm",
    ];
    let of_views = of_views.into_iter().chain(of_navigation);
    for id in metrics.into_iter().chain(of_views) {
        let score = found.metric(id).unwrap();
        assert_eq!((score.value, score.status), (None, Status::NotApplicable), "{id}");
    }
    let r = found.metric("phase_pearson_r").unwrap();
    assert_eq!((r.value, r.status), (None, Status::Degenerate));
    assert!(found.value("phase_mae").unwrap() > 0.0);
    assert_eq!(found.metric("ssim").unwrap().status, Status::Ok);
}

#[test]
fn each_kind_of_depth_in_metres_is_warned_of_and_our_own_notes_on_time_are_not() {
    let truth = TubeTruth::new("tube", 24, 9);
    let folder = tempfile::tempdir().unwrap();
    let warnings = |gone: &str, depth_scale: f64| {
        write_prediction(&truth, folder.path(), &Distortion { depth_scale, ..Default::default() });
        fs::remove_dir_all(folder.path().join(gone)).unwrap();
        let timing = r#"{"time_total_s": 1, "time_per_frame_s": 0.1, "frames": 9}"#;
        fs::write(folder.path().join("timing.json"), timing).unwrap();
        check_prediction(&Question::of(&truth), folder.path()).unwrap().warnings
    };
    assert!(warnings("mesh", 0.0).is_empty());
    for (gone, left) in [("depth", "novel_depth"), ("novel_depth", "depth")] {
        let said = warnings(gone, 1e-3 - 1.0);
        assert!(said.len() == 1 && said[0].starts_with(&format!("{left}: the median is 0.0")), "{said:?}");
    }
}

#[test]
fn scores_do_not_depend_on_threads_and_survive_json() {
    let truth = TubeTruth::new("tube", 32, 12);
    let folder = tempfile::tempdir().unwrap();
    write_prediction(
        &truth,
        folder.path(),
        &Distortion { noise: 9.0, lag: 2, surface_shift_mm: 0.7, ..Default::default() },
    );
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| score(&truth, folder.path(), &ScoreSettings::default()).unwrap())
    };
    let one = on(1);
    assert_eq!(one, on(2));
    assert_eq!(one, on(8));
    let path = folder.path().join("score.json");
    files::write_json(&path, &one).unwrap();
    assert_eq!(files::read_json::<CellScore>(&path).unwrap(), one);
}

/// Every damage gives one sentence that names the file.
#[test]
fn damage_is_named() {
    let truth = TubeTruth::new("tube", 24, 9);
    type Damage = (&'static str, fn(&Path));
    let damages: [Damage; 15] = [
        ("color/000003.png", |f| fs::remove_file(f.join("color/000003.png")).unwrap()),
        ("color/000002.png", |f| fs::write(f.join("color/000002.png"), b"not a picture").unwrap()),
        ("color/000001.png", |f| {
            png::write_rgb(&f.join("color/000001.png"), &crate::base::Image::filled(9, 9, 3, 0)).unwrap()
        }),
        ("depth/000008.exr", |f| fs::remove_file(f.join("depth/000008.exr")).unwrap()),
        ("depth/000004.exr", |f| {
            let bytes = fs::read(f.join("depth/000004.exr")).unwrap();
            fs::write(f.join("depth/000004.exr"), &bytes[..bytes.len() / 2]).unwrap();
        }),
        ("depth/000002.exr", |f| {
            let path = f.join("depth/000002.exr");
            let mut depth = exr::read(&path).unwrap();
            depth.data[5] = 3e38;
            exr::write_depth(&path, &depth).unwrap();
        }),
        ("ahead/000007.png", |f| fs::write(f.join("ahead/000007.png"), b"").unwrap()),
        ("novel/000007.png", |f| fs::remove_file(f.join("novel/000007.png")).unwrap()),
        ("novel_depth", |f| fs::remove_file(f.join("novel_depth/000007.exr")).unwrap()),
        ("targets.csv", |f| fs::write(f.join("targets.csv"), b"frame,target,x_mm,y_mm,z_mm\n0,0,1,2,3\n").unwrap()),
        ("phase.csv", |f| fs::write(f.join("phase.csv"), b"frame,phase\n0,0\n1,inf\n").unwrap()),
        ("timing.json", |f| fs::write(f.join("timing.json"), b"{\"time_total_s\": -1}").unwrap()),
        ("mesh/final.ply", |f| fs::write(f.join("mesh/final.ply"), b"ply\nformat ascii 1.0\n").unwrap()),
        ("correspondence.csv", |f| {
            fs::remove_file(f.join("mesh/final.ply")).unwrap();
            fs::write(f.join("correspondence.csv"), b"anything").unwrap();
        }),
        ("color", |f| fs::remove_dir_all(f.join("color")).unwrap()),
    ];
    for (file, damage) in damages {
        let folder = tempfile::tempdir().unwrap();
        write_prediction(&truth, folder.path(), &Distortion::default());
        damage(folder.path());
        let said = score(&truth, folder.path(), &ScoreSettings::default()).unwrap_err().to_string();
        assert!(said.contains(file) && !said.contains('\n'), "{file}: {said}");
        // What scoring refuses, checking refuses.
        let checked = check_prediction(&Question::of(&truth), folder.path()).unwrap_err().to_string();
        assert!(checked.contains(file), "{file}: {checked}");
    }
}

#[test]
fn a_vertex_that_is_no_number_is_named() {
    let truth = TubeTruth::new("tube", 24, 3);
    let folder = tempfile::tempdir().unwrap();
    write_prediction(&truth, folder.path(), &Distortion::default());
    let path = folder.path().join("mesh/final.ply");
    let mut surface = mesh::read(&path).unwrap();
    surface.vertices[1].y = f64::NAN;
    mesh::write_ply(&path, &surface, &[]).unwrap();
    let said = score(&truth, folder.path(), &ScoreSettings::default()).unwrap_err().to_string();
    assert!(said.contains("final.ply") && said.contains("vertex 1"), "{said}");
}

/// A surface with other faces (here: every face split in three): its contour is measured, its targets where a table says
/// which point is which.
#[test]
fn another_topology_is_scored_by_its_table() {
    let truth = TubeTruth::new("tube", 24, 3);
    let folder = tempfile::tempdir().unwrap();
    write_prediction(&truth, folder.path(), &Distortion::default());
    let path = folder.path().join("mesh/final.ply");
    let whole = mesh::read(&path).unwrap();
    let mut split = TriangleMesh { vertices: whole.vertices.clone(), faces: Vec::new() };
    for (face, &[a, b, c]) in whole.faces.iter().enumerate() {
        let centre = split.vertices.len() as u32;
        let [p, q, r] = whole.corners(face);
        split.vertices.push((p + q + r) / 3.0);
        split.faces.extend([[a, b, centre], [b, c, centre], [c, a, centre]]);
    }
    mesh::write_ply(&path, &split, &[]).unwrap();
    let targets = ["target_error_mm", "target_error_mean_mm", "target_error_p95_mm"];
    let found = score(&truth, folder.path(), &ScoreSettings::default()).unwrap();
    assert!(found.value("contour_rmse_mm").unwrap() < 1e-6);
    for id in targets {
        let target = found.metric(id).unwrap();
        assert_eq!((target.value, target.status), (None, Status::NoCorrespondence), "{id}");
        assert!(target.detail.contains("correspondence.csv") && target.status.counts_as_worst());
    }
    let table = folder.path().join("correspondence.csv");
    let rows: String = (0..whole.vertices.len()).map(|v| format!("{v},{v}\n")).collect();
    fs::write(&table, format!("vertex,predicted_vertex\n{rows}")).unwrap();
    let found = score(&truth, folder.path(), &ScoreSettings::default()).unwrap();
    for id in targets {
        assert!(found.value(id).unwrap() < 1e-6, "{id}");
    }
    // Fewer vertices than the sequence's meshes have, and a place that is not on the surface.
    for (text, word) in
        [("vertex,predicted_vertex\n0,0\n", "has 1 vertices"), ("vertex,face,b0,b1,b2\n0,0,2,-1,0\n", "line 2")]
    {
        fs::write(&table, text).unwrap();
        let said = score(&truth, folder.path(), &ScoreSettings::default()).unwrap_err().to_string();
        assert!(said.contains("correspondence.csv") && said.contains(word), "{said}");
    }
}
