//! Answers that nobody should be rewarded for: each is refused, marked, or earns nothing. (Names of own rows, exchanged
//! films, links, foreign cases, no time and edited tables: `third_parties.rs`. Phases in what participants get:
//! `blind.rs`.)

use std::fs;
use std::path::Path;

use respire_bench::base::{Image, TriangleMesh, mesh};
use respire_bench::formats::{exr, mesh as mesh_file, png};
use respire_bench::simulate::sequence::Sequence;

use crate::simulate::contents;
use crate::third_parties::{Place, accepted, column, copy, refused};

/// Frames of the film: two of them have a second camera and a rendering ahead.
const FRAMES: usize = 17;
const TARGETS: [&str; 3] = ["target_error_mm", "target_error_mean_mm", "target_error_p95_mm"];

/// The score of the prediction `name`.
struct Scored(serde_json::Value);

impl Scored {
    #[track_caller]
    fn of(place: &Place, name: &str) -> Self {
        let out =
            accepted(place.evaluate(&place.film(), name, &format!("scores-{name}"), &["--json", "--method", name]));
        Scored(serde_json::from_str(&out).unwrap())
    }

    #[track_caller]
    fn metric(&self, id: &str) -> &serde_json::Value {
        self.0["metrics"].as_array().unwrap().iter().find(|m| m["metric"] == id).unwrap()
    }

    #[track_caller]
    fn value(&self, id: &str) -> f64 {
        self.metric(id)["value"].as_f64().unwrap_or_else(|| panic!("{id}: {}", self.metric(id)))
    }

    #[track_caller]
    fn status(&self, id: &str) -> &str {
        self.metric(id)["status"].as_str().unwrap()
    }
}

/// The prediction of `ours` under another name, changed.
fn cheat(place: &Place, name: &str, change: impl Fn(&Path)) {
    let folder = place.path(name);
    copy(&place.path("mine"), &folder);
    fs::remove_file(folder.join("prediction.json")).unwrap();
    change(&folder);
}

fn surface(vertices: Vec<glam::DVec3>, faces: &[[u32; 3]]) -> TriangleMesh {
    TriangleMesh { vertices, faces: faces.to_vec() }
}

fn write_final(folder: &Path, surface: &TriangleMesh) {
    mesh_file::write_ply(&folder.join("mesh/final.ply"), surface, &[]).unwrap();
}

/// A row of `name` beside those of the run: its place by `metric`, that of `ours`, and the report.
#[track_caller]
fn ranked(place: &Place, name: &str, metric: &str) -> ([String; 2], String) {
    accepted(place.merge(&["reports/latest", &format!("scores-{name}")], &[]));
    let ranks = column(&place.path("table/summary.csv"), &format!("{metric}_rank"));
    let rank = |row: &str| ranks.iter().find(|(method, _)| method == row).unwrap().1.clone();
    ([rank(name), rank("ours")], fs::read_to_string(place.path("table/report.md")).unwrap())
}

#[test]
fn pictures_that_are_the_input_or_the_truth_are_marked() {
    let place = Place::of_frames(FRAMES);
    let film = place.film();
    let whole = Sequence::open(&film).unwrap();
    let picture = |frame: usize| whole.image(frame).unwrap();
    // Every file that there is a truth of, copied, not linked.
    cheat(&place, "everything", |folder| {
        for (name, bytes) in contents(&film) {
            let to = match name.split_once('/') {
                Some(("images", file)) => format!("color/{file}"),
                Some(("depth" | "novel" | "novel_depth", _)) => name.clone(),
                _ => continue,
            };
            fs::write(folder.join(to), bytes).unwrap();
        }
        for frame in [7, 15] {
            fs::copy(film.join(format!("images/{frame:06}.png")), folder.join(format!("ahead/{frame:06}.png")))
                .unwrap();
        }
        let (mut phases, mut targets) = ("frame,phase\n".to_owned(), "frame,target,x_mm,y_mm,z_mm\n".to_owned());
        for (frame, record) in whole.frames.iter().enumerate() {
            phases += &format!("{frame},{}\n", record.phase);
            for (target, place) in whole.targets.iter().map(|t| t.at(record.phase)).enumerate() {
                targets += &format!("{frame},{target},{},{},{}\n", place.x, place.y, place.z);
            }
        }
        fs::write(folder.join("phase.csv"), phases).unwrap();
        fs::write(folder.join("targets.csv"), targets).unwrap();
        let (from, to) = (whole.inspiration().unwrap(), whole.expiration().unwrap());
        let last = mesh::interpolate(&from.vertices, &to.vertices, whole.frames[FRAMES - 1].phase);
        write_final(folder, &surface(last, &from.faces));
    });
    let found = Scored::of(&place, "everything");
    for id in ["psnr_db", "ssim"] {
        assert_eq!((found.status(id), found.metric(id)["value"].as_f64()), ("copied", None));
    }
    assert_eq!(found.status("psnr_ahead_db"), "copied");
    assert_eq!((found.status("novel_psnr_db"), found.value("phase_mae")), ("identical", 0.0));
    assert_eq!((found.value("target_error_mm"), found.value("novel_depth_rmse_mm")), (0.0, 0.0));
    let (ranks, report) = ranked(&place, "everything", "psnr_db");
    assert_eq!(ranks, ["", "1"], "copied pictures have no place");
    assert!(report.contains("0.000 ★") && report.contains("★: equal to the truth"), "{report}");

    // The input with one bit changed in each picture, and in one picture of a hundred at most it may happen.
    cheat(&place, "one-bit", |folder| {
        for frame in 0..FRAMES {
            let mut image = picture(frame);
            image.data[100 * 3] ^= 1;
            png::write_rgb(&folder.join(format!("color/{frame:06}.png")), &image).unwrap();
        }
    });
    assert_eq!(Scored::of(&place, "one-bit").status("psnr_db"), "copied");
    cheat(&place, "one-novel-bit", |folder| {
        for view in &whole.novel_views {
            let mut image = whole.novel_image(view.frame).unwrap();
            image.data[100 * 3] ^= 1;
            png::write_rgb(&folder.join(format!("novel/{:06}.png", view.frame)), &image).unwrap();
        }
    });
    for id in ["novel_psnr_db", "novel_ssim"] {
        assert_eq!(Scored::of(&place, "one-novel-bit").status(id), "copied");
    }
    // What the first camera saw, with one bit changed.
    cheat(&place, "beside", |folder| {
        for view in &whole.novel_views {
            let mut image = picture(view.frame);
            image.data[100 * 3] ^= 1;
            png::write_rgb(&folder.join(format!("novel/{:06}.png", view.frame)), &image).unwrap();
        }
    });
    for id in ["novel_psnr_db", "novel_ssim"] {
        assert_eq!(Scored::of(&place, "beside").status(id), "copied");
    }
    cheat(&place, "one-frame", |folder| {
        png::write_rgb(&folder.join("color/000003.png"), &picture(3)).unwrap();
    });
    assert_eq!(Scored::of(&place, "one-frame").status("ssim"), "copied");

    // Pixels that are left out, as transparent or as black, are no better than what stands there.
    let honest = Scored::of(&place, "mine");
    cheat(&place, "transparent", |folder| {
        for frame in 0..FRAMES {
            let path = folder.join(format!("color/{frame:06}.png"));
            let image = png::read_rgb(&path).unwrap();
            let half = |k: usize| if k < image.data.len() / 6 { 0 } else { 255 };
            let rgba = image.data.chunks(3).enumerate().flat_map(|(k, p)| [p[0], p[1], p[2], half(k)]).collect();
            let with_alpha = image::RgbaImage::from_raw(image.width as u32, image.height as u32, rgba).unwrap();
            with_alpha.save(&path).unwrap();
        }
    });
    assert_eq!(Scored::of(&place, "transparent").value("psnr_db"), honest.value("psnr_db"));
    cheat(&place, "black", |folder| {
        for frame in 0..FRAMES {
            let path = folder.join(format!("color/{frame:06}.png"));
            let mut image = png::read_rgb(&path).unwrap();
            let half = image.data.len() / 2;
            image.data[..half].fill(0);
            png::write_rgb(&path, &image).unwrap();
        }
    });
    assert!(Scored::of(&place, "black").value("psnr_db") < honest.value("psnr_db") - 3.0);
}

#[test]
fn depth_that_is_left_out_or_out_of_all_bounds_never_pays() {
    let place = Place::of_frames(FRAMES);
    let honest = Scored::of(&place, "mine");
    // In the half of each picture that is farthest in the prediction itself, where errors are largest.
    let far = |value: f32| {
        move |folder: &Path| {
            for frame in 0..FRAMES {
                let path = folder.join(format!("depth/{frame:06}.exr"));
                let mut depth: Image<f32> = exr::read(&path).unwrap();
                let mut sorted = depth.data.clone();
                sorted.sort_by(f32::total_cmp);
                let median = sorted[sorted.len() / 2];
                depth.data.iter_mut().filter(|d| **d > median).for_each(|d| *d = value);
                exr::write_depth(&path, &depth).unwrap();
            }
        }
    };
    for (name, value) in
        [("zero", 0.0), ("nan", f32::NAN), ("negative", -1.0), ("infinite", f32::INFINITY), ("huge", 9e5)]
    {
        cheat(&place, name, far(value));
        let found = Scored::of(&place, name);
        assert_eq!(found.status("depth_rmse_mm"), "ok", "{name}");
        assert!(found.value("depth_rmse_mm") > honest.value("depth_rmse_mm"), "{name}");
        assert!(found.value("depth_delta_1_25") <= honest.value("depth_delta_1_25"), "{name}");
        let (ranks, _) = ranked(&place, name, "depth_rmse_mm");
        assert_eq!(ranks, ["2", "1"], "{name}");
    }
}

#[test]
fn surfaces_that_cannot_be_matched_count_with_the_worst_row() {
    let place = Place::of_frames(3);
    let whole = Sequence::open(&place.film()).unwrap();
    let (from, to) = (whole.inspiration().unwrap(), whole.expiration().unwrap());
    let at = |phase: f64| mesh::interpolate(&from.vertices, &to.vertices, phase);
    let marked = |name: &str, id: &str, status: &str| {
        let found = Scored::of(&place, name);
        assert_eq!((found.status(id), found.metric(id)["value"].as_f64()), (status, None), "{name} {id}");
        let (ranks, report) = ranked(&place, name, id);
        let places: Vec<u32> = ranks.iter().map(|rank| rank.parse().unwrap()).collect();
        assert!(places[0] > places[1], "{name} {id}: {ranks:?}");
        assert!(report.contains("†: a surface that misses the plane") && report.contains(status), "{report}");
    };

    // 21 phases in one file: whatever the truth is, one of them is near.
    cheat(&place, "stacked", |folder| {
        let mut all = surface(Vec::new(), &[]);
        for step in 0..=20 {
            let offset = all.vertices.len() as u32;
            all.vertices.extend(at(f64::from(step) / 20.0));
            all.faces.extend(from.faces.iter().map(|face| face.map(|v| v + offset)));
        }
        write_final(folder, &all);
    });
    TARGETS.iter().for_each(|id| marked("stacked", id, "no_correspondence"));
    // The true surface, faces in another order, so that no point is held to be another one by its number.
    let last = at(whole.frames[2].phase);
    cheat(&place, "permuted", |folder| {
        let mut faces = from.faces.clone();
        faces.reverse();
        write_final(folder, &surface(last.clone(), &faces));
    });
    TARGETS.iter().for_each(|id| marked("permuted", id, "no_correspondence"));
    // The same with vertices exchanged: these are the truth's faces, and every point is somewhere else.
    cheat(&place, "exchanged", |folder| {
        write_final(folder, &surface(last.iter().rev().copied().collect(), &from.faces));
    });
    assert!(Scored::of(&place, "exchanged").value("target_error_mean_mm") > 5.0);
    // A million slivers at the place of the truth.
    cheat(&place, "slivers", |folder| {
        let mut slivers = surface(last.clone(), &from.faces);
        let [a, b, _] = from.faces[0].map(|v| last[v as usize]);
        for k in 0..1_000_000u32 {
            slivers.vertices.push(a.lerp(b, f64::from(k) * 1e-6));
            slivers.faces.push([from.faces[0][0], from.faces[0][1], last.len() as u32 + k]);
        }
        write_final(folder, &slivers);
    });
    TARGETS.iter().for_each(|id| marked("slivers", id, "no_correspondence"));
    // Out of the plane: no contour, and the material points are as far off as they are.
    cheat(&place, "moved", |folder| {
        let away = last.iter().map(|&v| v + glam::DVec3::splat(5000.0)).collect();
        write_final(folder, &surface(away, &from.faces));
    });
    marked("moved", "contour_rmse_mm", "no_contour");
    assert!(Scored::of(&place, "moved").value("target_error_mm") > 5000.0);
    // The CT at expiration, handed back: as wrong as the film's last phase is from 1.
    cheat(&place, "expiration", |folder| write_final(folder, &surface(to.vertices.clone(), &from.faces)));
    let found = Scored::of(&place, "expiration");
    assert_eq!(found.status("target_error_mean_mm"), "ok");
    assert!(found.value("target_error_mean_mm") > 0.2, "{}", found.value("target_error_mean_mm"));
}

#[test]
fn folders_of_chosen_frames_are_all_or_nothing() {
    let place = Place::of_frames(FRAMES);
    for (folder, ending) in [("ahead", "png"), ("novel", "png"), ("novel_depth", "exr")] {
        let name = format!("chosen-{folder}");
        cheat(&place, &name, |prediction| {
            fs::remove_file(prediction.join(format!("{folder}/000015.{ending}"))).unwrap();
        });
        let words = [&format!("{folder}/000015.{ending}")[..], "is missing"];
        refused(place.evaluate(&place.film(), &name, "scores", &["--method", &name]), 4, &words);
    }
    // The phase as a link to the film's table, which has columns of these names.
    cheat(&place, "linked", |prediction| {
        let phases = prediction.join("phase.csv");
        fs::remove_file(&phases).unwrap();
        std::os::unix::fs::symlink(place.film().join("frames.csv"), phases).unwrap();
    });
    refused(place.evaluate(&place.film(), "linked", "scores", &["--method", "linked"]), 4, &["is a link to the truth"]);
    // No CPU time that is none.
    cheat(&place, "timeless", |prediction| {
        fs::write(prediction.join("timing.json"), "{\"time_total_s\": 1, \"time_cpu_s\": 0}").unwrap();
    });
    let words = ["timing.json: time_cpu_s: is 0"];
    refused(place.evaluate(&place.film(), "timeless", "scores", &["--method", "timeless"]), 4, &words);
}
