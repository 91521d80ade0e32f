//! Import of real airway surfaces with real motion, and of what is wrong with them.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::Stdio;

use assert_cmd::Command;
use glam::DVec3;
use respire_bench::airway::case::Case;
use respire_bench::airway::field_check::flipped_faces;
use respire_bench::airway::{self, import_breathing::LungBox};
use respire_bench::base::TriangleMesh;
use respire_bench::formats::{landmarks, mesh};
use respire_bench::simulate::trajectory::Route;

use crate::binary::{PROGRAM, interrupt};
use crate::cases::case_path;
use crate::skip::shared;

pub fn command() -> Command {
    Command::new(PROGRAM)
}

/// Landmark pairs of an invented motion, as a file.
fn invented_landmarks(folder: &Path) -> PathBuf {
    let mut text = String::from("insp_x,insp_y,insp_z,exp_x,exp_y,exp_z\n");
    for i in 0..6 {
        for j in 0..5 {
            for k in 0..6 {
                let (x, y, z) = (40.0 * i as f64, 40.0 * j as f64, 45.0 * k as f64);
                let up = 20.0 * (1.0 - z / 260.0) + 2.0 * (x / 70.0).sin();
                text += &format!("{x},{y},{z},{x},{},{}\n", y + 4.0, z + up);
            }
        }
    }
    let path = folder.join("invented.csv");
    fs::write(&path, text).unwrap();
    path
}

#[test]
fn real_surfaces_become_cases_without_folds() {
    let (Some(meshes), Some(data)) = (shared("data/atm22/meshes"), shared("data/dirlab_copd")) else { return };
    let folder = tempfile::tempdir().unwrap();
    for (name, motion) in [("ATM_305", "copd03"), ("ATM_307", "copd05")] {
        command()
            .args(["import", "mesh", "--axes", "ras", "--region", "right-lower", "--end-motion-mm", "12", "--id", name])
            .arg(meshes.join(format!("{name}.ply")))
            .arg("--landmarks")
            .arg(data.join(format!("{motion}.csv")))
            .arg("--lung-boxes")
            .arg(data.join("lung_boxes.csv"))
            .arg("--out")
            .arg(folder.path())
            .assert()
            .success();
        let case = Case::load(&folder.path().join(format!("{name}.toml"))).unwrap();
        let anatomy = airway::build(&case).unwrap();
        assert!(anatomy.inspiration.faces.len() > 200_000);
        assert!(anatomy.inspiration.signed_volume() < 0.0);
        assert!(flipped_faces(&anatomy.inspiration, &anatomy.expiration.vertices).is_empty());
        let route = Route::plan(&anatomy, &case.trajectory).unwrap();
        assert!(route.length_mm() > 100.0, "{}", route.length_mm());
        assert!((route.end_motion_mm() - 12.0).abs() < 0.2, "{}", route.end_motion_mm());
        assert!(case.breathing.unwrap().field.source.contains("not of this airway's patient"));
    }
}

#[test]
fn a_pair_of_meshes_becomes_a_case_that_moves_as_they_do() {
    let folder = tempfile::tempdir().unwrap();
    let anatomy = airway::build(&Case::load(&case_path(3)).unwrap()).unwrap();
    let (rest, other) = (folder.path().join("in.ply"), folder.path().join("out.ply"));
    mesh::write_ply(&rest, &anatomy.inspiration, &[]).unwrap();
    mesh::write_ply(&other, &anatomy.expiration, &[]).unwrap();
    let out = folder.path().join("case");
    let import = |second: &Path| {
        let mut command = command();
        command.args(["import", "mesh-pair", "--id", "pair"]).arg(&rest).arg(second).arg("--out").arg(&out);
        command
    };
    import(&other).assert().success();
    let back = airway::build(&Case::load(&out.join("pair.toml")).unwrap()).unwrap();
    assert_eq!(back.inspiration.faces, anatomy.inspiration.faces);
    let worst = back.expiration.vertices.iter().zip(&anatomy.expiration.vertices);
    assert!(worst.map(|(a, b)| a.distance(*b)).fold(0.0, f64::max) < 1e-4);
    let mut unrelated = anatomy.expiration.clone();
    unrelated.faces.rotate_left(1);
    mesh::write_ply(&other, &unrelated, &[]).unwrap();
    fails(&mut import(&other), &["out.ply", "not registered"]);
}

#[test]
fn what_is_wrong_is_said_in_one_sentence_with_exit_code_4() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let anatomy = airway::build(&Case::load(&case_path(3)).unwrap()).unwrap();
    let good = anatomy.inspiration;
    mesh::write_ply(&at("good.ply"), &good, &[]).unwrap();
    let mut open = good.clone();
    open.faces.pop();
    mesh::write_ply(&at("open.ply"), &open, &[]).unwrap();
    let doubled = TriangleMesh { faces: [good.faces.clone(), vec![good.faces[0]]].concat(), ..good.clone() };
    mesh::write_ply(&at("doubled.ply"), &doubled, &[]).unwrap();
    let head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
        element face 4\nproperty list uchar int vertex_indices\nend_header\n";
    let body = "0 0 0\n1 0 0\n0 nan 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n";
    fs::write(at("nan.ply"), format!("{head}{body}")).unwrap();
    let fine = invented_landmarks(folder.path());
    fs::write(at("empty.csv"), "").unwrap();
    fs::write(at("header.csv"), "insp_x,insp_y,insp_z,exp_x,exp_y,exp_z\n").unwrap();
    let few: Vec<String> = fs::read_to_string(&fine).unwrap().lines().take(5).map(String::from).collect();
    fs::write(at("few.csv"), few.join("\n")).unwrap();
    let fine = fine.file_name().unwrap().to_str().unwrap().to_string();
    for (surface, landmarks, said) in [
        ("none.ply", fine.as_str(), vec!["none.ply"]),
        ("open.ply", &fine, vec!["open.ply", "edge ", "not closed"]),
        ("doubled.ply", &fine, vec!["doubled.ply", "edge ", "not manifold"]),
        ("nan.ply", &fine, vec!["nan.ply", "vertex 2"]),
        ("good.ply", "none.csv", vec!["none.csv"]),
        ("good.ply", "empty.csv", vec!["empty.csv", "empty"]),
        ("good.ply", "header.csv", vec!["header.csv", "no landmark pair"]),
        ("good.ply", "few.csv", vec!["few.csv", "4 landmark pairs are too few"]),
    ] {
        let mut command = command();
        command.args(["import", "mesh", "--id", "x"]).arg(at(surface)).arg("--landmarks").arg(at(landmarks));
        fails(command.arg("--out").arg(at("out")), &said);
        assert!(!at("out").exists(), "{surface} with {landmarks} left something behind");
    }
}

#[test]
fn units_axes_and_loose_parts_are_noticed_and_their_cure_works() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let good = airway::build(&Case::load(&case_path(1)).unwrap()).unwrap().inspiration;
    let landmarks = invented_landmarks(folder.path());
    let mapped = |name: &str, map: &dyn Fn(DVec3) -> DVec3| {
        let mut mesh = good.clone();
        mesh.vertices.iter_mut().for_each(|v| *v = map(*v));
        mesh::write_ply(&at(name), &mesh, &[]).unwrap();
    };
    mapped("centimetres.ply", &|v| v / 10.0);
    mapped("metres.ply", &|v| v / 1000.0);
    mapped("ras.ply", &|v| DVec3::new(-v.x, -v.y, v.z));
    mapped("upside.ply", &|v| DVec3::new(v.x, -v.y, -v.z));
    mapped("y_up.ply", &|v| DVec3::new(v.x, v.z, -v.y));
    let mut debris = good.clone();
    let first = debris.vertices.len() as u32;
    debris.vertices.extend([DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|v| v * 3.0 + DVec3::splat(60.0)));
    debris.faces.extend([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]].map(|face: [u32; 3]| face.map(|v| v + first)));
    mesh::write_ply(&at("debris.ply"), &debris, &[]).unwrap();
    let import = |surface: &str, more: &[&str]| {
        let mut command = command();
        command.args(["import", "mesh", "--id", "x", "--end-motion-mm", "8"]).arg(at(surface)).arg("--landmarks");
        command.arg(&landmarks).arg("--other-patient").args(more).arg("--out").arg(at("out"));
        command
    };
    for (surface, said, cure) in [
        ("centimetres.ply", "longest side is", vec!["--scale", "10"]),
        ("metres.ply", "longest side is", vec!["--scale", "1000"]),
        ("ras.ply", "as if the file's axes were `ras`", vec!["--axes", "ras"]),
        ("upside.ply", "as if the file's axes were `lai`", vec!["--axes", "lai"]),
        ("y_up.ply", "as if the file's axes were `lsa`", vec!["--axes", "lsa"]),
        ("debris.ply", "holds 2 loose parts", vec!["--keep-largest"]),
    ] {
        fails(&mut import(surface, &[]), &[surface, said, &cure.join(" ")]);
        assert!(!at("out").exists(), "{surface} left something behind");
        import(surface, &cure).assert().success();
        let back = airway::build(&Case::load(&at("out/x.toml")).unwrap()).unwrap().inspiration;
        assert_eq!(back.faces.len(), good.faces.len(), "{surface}");
        let worst = back.vertices.iter().zip(&good.vertices).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        assert!(worst < 1e-6, "{surface}: {worst} mm off");
        assert_eq!(fs::read_dir(at("out")).unwrap().count(), 3);
        fs::remove_dir_all(at("out")).unwrap();
    }
    // `import tree` asks the same.
    let tree = |surface: &str| {
        let mut command = command();
        command.args(["import", "tree", "--source", "invented"]).arg(at(surface)).arg("--out").arg(at("tree.toml"));
        command
    };
    fails(&mut tree("centimetres.ply"), &["centimetres.ply", "--scale 10"]);
    fails(&mut tree("ras.ply"), &["ras.ply", "--axes ras"]);
    assert!(!at("tree.toml").exists());
    tree("ras.ply").args(["--axes", "ras"]).assert().success();
    fails(tree("ras.ply").args(["--axes", "ras"]), &["tree.toml: is there already", "nothing is overwritten"]);
    // Landmarks in other units, and a pair of which one file is.
    let metres: String = fs::read_to_string(&landmarks)
        .unwrap()
        .lines()
        .enumerate()
        .map(|(row, line)| match row {
            0 => format!("{line}\n"),
            _ => {
                line.split(',').map(|v| format!("{}", v.parse::<f64>().unwrap() / 1000.0)).collect::<Vec<_>>().join(",")
                    + "\n"
            }
        })
        .collect();
    fs::write(at("metres.csv"), metres).unwrap();
    mapped("good.ply", &|v| v);
    let mut command = command();
    command.args(["import", "mesh", "--id", "x"]).arg(at("good.ply")).arg("--landmarks").arg(at("metres.csv"));
    fails(command.arg("--out").arg(at("out")), &["metres.csv", "landmarks are in mm (LPS)"]);
    // Those of a mouse are taken on request, by `import breathing` as well.
    let mouse = |more: &[&str]| {
        let mut command = self::command();
        command.args(["import", "breathing"]).arg(at("none.toml")).arg("--landmarks").arg(at("metres.csv")).args(more);
        String::from_utf8(command.output().unwrap().stderr).unwrap()
    };
    assert!(mouse(&[]).contains("--unusual"), "{}", mouse(&[]));
    // These in metres do not move, which is asked next.
    assert!(mouse(&["--unusual"]).contains("no landmark moves"), "{}", mouse(&["--unusual"]));
    mapped("far.ply", &|v| v + DVec3::splat(100.0));
    let mut command = self::command();
    command.args(["import", "mesh-pair", "--id", "x"]).arg(at("good.ply")).arg(at("far.ply"));
    fails(command.arg("--out").arg(at("out")), &["far.ply", "173 mm between the breath holds"]);
    mapped("grown.ply", &|v| v * 1.1);
    let mut command = self::command();
    command.args(["import", "mesh-pair", "--id", "x"]).arg(at("good.ply")).arg(at("grown.ply"));
    fails(command.arg("--out").arg(at("out")), &["grown.ply", "1.33 times as large at expiration", "swapped"]);
    let (low, high) = good.bounds();
    let middle = low.midpoint(high);
    mapped("half.ply", &|v| middle + (v - middle) * 0.6);
    let mut command = self::command();
    command.args(["import", "mesh-pair", "--id", "x"]).arg(at("good.ply")).arg(at("half.ply"));
    fails(command.arg("--out").arg(at("out")), &["half.ply", "has 0.22 of its volume"]);
    assert!(!at("out").exists());
}

/// Before any file is read.
#[test]
fn options_that_would_change_nothing_are_refused() {
    for (words, says) in [
        (&["--meshes", "a.ply", "b.ply", "--end-motion-mm", "3"][..], "--end-motion-mm is for --landmarks"),
        (&["--meshes", "a.ply", "b.ply", "--source", "me"], "--source says where --landmarks come from"),
        (&["--meshes", "a.ply", "b.ply", "--label", "7"], "--label is of an --airway-mask"),
        (&["a.nii", "--lung-masks", "c.nii", "--motion", "copd05"], "--lung-masks are for a registration"),
    ] {
        let outcome = command().args(["import", "ct", "--id", "x", "--out", "nowhere"]).args(words).assert().code(2);
        let said = String::from_utf8(outcome.get_output().stderr.clone()).unwrap();
        assert!(said.contains(says), "{said}");
    }
}

#[test]
fn a_case_that_cannot_be_filmed_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let anatomy = airway::build(&Case::load(&case_path(3)).unwrap()).unwrap();
    mesh::write_ply(&at("good.ply"), &anatomy.inspiration, &[]).unwrap();
    let landmarks = invented_landmarks(folder.path());
    let mut command = command();
    command.args(["import", "mesh", "--id", "x", "--scope-radius-mm", "40"]).arg(at("good.ply"));
    command.arg("--landmarks").arg(&landmarks).arg("--other-patient").arg("--out").arg(at("new/out"));
    fails(&mut command, &["scope"]);
    let mut left: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    left.sort();
    assert_eq!(left, ["good.ply", "invented.csv"]);
}

#[test]
fn without_real_files_a_mesh_and_invented_motion_become_a_case() {
    let folder = tempfile::tempdir().unwrap();
    let anatomy = airway::build(&Case::load(&case_path(3)).unwrap()).unwrap();
    let mut turned = anatomy.inspiration;
    turned.flip();
    let surface = folder.path().join("airway.stl");
    write_stl(&surface, &turned);
    let landmarks = invented_landmarks(folder.path());
    let mut command = command();
    command.args(["import", "mesh", "--id", "mine", "--end-motion-mm", "8"]).arg(&surface).arg("--landmarks");
    command.arg(&landmarks).arg("--other-patient").arg("--out").arg(folder.path()).assert().success();
    // What was edited since is not overwritten.
    let file = folder.path().join("mine.toml");
    let edited = fs::read_to_string(&file).unwrap().replace("fov_x_deg = 100.0", "fov_x_deg = 77.0");
    fs::write(&file, &edited).unwrap();
    fails(&mut command, &["mine.toml: is there already", "another --id"]);
    // Nor is a surface that has no case.
    fs::rename(&file, folder.path().join("other.toml")).unwrap();
    fails(&mut command, &["mine-airway.ply: is there already", "another --id"]);
    fs::rename(folder.path().join("other.toml"), &file).unwrap();
    assert_eq!(fs::read_to_string(&file).unwrap(), edited);
    let case = Case::load(&file).unwrap();
    let source = &case.breathing.as_ref().unwrap().field.source;
    assert!(source.starts_with("invented.csv: real motion, but not of this airway's patient"), "{source}");
    let built = airway::build(&case).unwrap();
    assert!(built.inspiration.signed_volume() < 0.0, "normals must point into the lumen");
    assert!(flipped_faces(&built.inspiration, &built.expiration.vertices).is_empty());
    let route = Route::plan(&built, &case.trajectory).unwrap();
    assert!((route.end_motion_mm() - 8.0).abs() < 0.1, "{}", route.end_motion_mm());
}

/// Landmarks of a known motion around the airway `rest`, down from a height: as a file, and the motion.
fn own_landmarks(path: &Path, rest: &TriangleMesh, top_share: f64) -> impl Fn(DVec3) -> DVec3 + use<> {
    let (low, high) = rest.bounds();
    let size = high - low;
    let motion = move |p: DVec3| DVec3::new(0.0, 2.0, 12.0 * (high.z - p.z) / size.z);
    let mut text = String::from("insp_x,insp_y,insp_z,exp_x,exp_y,exp_z\n");
    for k in 0..216 {
        let part = DVec3::new((k % 6) as f64, (k / 6 % 6) as f64, (k / 36) as f64) / 5.0 * 1.1 - 0.05;
        let place = low + size * part * DVec3::new(1.0, 1.0, top_share);
        let moved = place + motion(place);
        let cells = [place.to_array(), moved.to_array()].concat();
        text += &(cells.iter().map(f64::to_string).collect::<Vec<_>>().join(",") + "\n");
    }
    fs::write(path, text).unwrap();
    motion
}

/// They were taken for another patient's, moved and stretched, and called DIR-Lab's.
#[test]
fn landmarks_of_the_airways_own_patient_stay_where_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut rest = airway::build(&Case::load(&case_path(3)).unwrap()).unwrap().inspiration;
    // Scanners put the origin anywhere.
    rest.vertices.iter_mut().for_each(|v| *v += DVec3::new(120.0, -310.0, -900.0));
    mesh::write_ply(&at("good.ply"), &rest, &[]).unwrap();
    let import = |out: &str| {
        let mut command = command();
        command.args(["import", "mesh", "--id", "mine"]).arg(at("good.ply")).arg("--landmarks").arg(at("own.csv"));
        command.arg("--out").arg(at(out));
        command
    };
    let motion = own_landmarks(&at("own.csv"), &rest, 1.0);
    let told = String::from_utf8(import("out").assert().success().get_output().stderr.clone()).unwrap();
    assert!(!told.contains("landmarks' box"), "{told}");
    let field = Case::load(&at("out/mine.toml")).unwrap().breathing.unwrap().field;
    assert!(field.source.starts_with("own.csv: landmarks in the airway's own frame"), "{}", field.source);
    let off = rest.vertices.iter().map(|v| field.displacement(*v).distance(motion(*v))).fold(0.0, f64::max);
    assert!(off < 0.1, "{off} mm off the known motion");
    // Of the lower part only: the trachea reaches beyond them.
    let _ = own_landmarks(&at("own.csv"), &rest, 0.6);
    let told = String::from_utf8(import("lower").assert().success().get_output().stderr.clone()).unwrap();
    assert!(told.contains("of the airway lies outside of the landmarks' box"), "{told}");
    // In another frame.
    invented_landmarks(folder.path());
    fs::rename(at("invented.csv"), at("own.csv")).unwrap();
    fails(&mut import("other"), &["own.csv", "100 % of the airway lies outside", "--other-patient"]);
}

/// What runs until Ctrl-C is asked to stop while it waits for its landmarks, and gets them then.
#[test]
fn an_import_that_is_stopped_publishes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let rest = airway::build(&Case::load(&case_path(3)).unwrap()).unwrap().inspiration;
    mesh::write_ply(&at("good.ply"), &rest, &[]).unwrap();
    let _ = own_landmarks(&at("own.csv"), &rest, 1.0);
    assert!(std::process::Command::new("mkfifo").arg(at("pipe.csv")).status().unwrap().success());
    // A folder that a kill left behind.
    fs::create_dir_all(at(".unfinished-Ab12Cd/work")).unwrap();
    let start = |landmarks: &Path| {
        let mut command = std::process::Command::new(PROGRAM);
        command.args(["import", "mesh", "--id", "x"]).arg(at("good.ply")).arg("--landmarks").arg(landmarks);
        command.arg("--out").arg(at("new/out")).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let mut child = start(&at("pipe.csv"));
    // Opens once the import reads it.
    let mut pipe = fs::OpenOptions::new().write(true).open(at("pipe.csv")).unwrap();
    interrupt(&child.id().to_string());
    let mut told = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    told.read_line(&mut line).unwrap();
    assert!(line.contains("stopping at the next safe point"), "{line}");
    pipe.write_all(&fs::read(at("own.csv")).unwrap()).unwrap();
    drop(pipe);
    line.clear();
    told.read_to_string(&mut line).unwrap();
    assert_eq!((child.wait().unwrap().code(), line.trim()), (Some(130), "error: stopped; nothing was kept"));
    assert!(!at("new").exists());
    assert!(start(&at("own.csv")).wait().unwrap().success());
    assert!(at("new/out/x.toml").exists() && !at(".unfinished-Ab12Cd").exists());
}

/// The files of a case were written under its name before the name was looked at.
#[test]
fn a_name_that_no_file_may_have_is_refused_first() {
    for kind in [&["mesh", "no.ply", "--motion", "copd05"][..], &["mesh-pair", "no.ply", "no.ply"], &["ct", "no.nii"]] {
        for id in ["../evil", "a/b", ""] {
            let output = command().arg("import").args(kind).args(["--id", id, "--out", "out"]).assert().code(2);
            assert!(String::from_utf8_lossy(&output.get_output().stderr).contains("letters, digits, `-` and `_`"));
        }
    }
}

#[test]
fn the_shipped_fields_describe_the_measured_motion() {
    let Some(data) = shared("data/dirlab_copd") else { return };
    for (number, most_mm) in [(1, 3.0), (3, 2.5), (4, 3.0), (5, 4.0)] {
        let case = Case::load(&case_path(number)).unwrap();
        let anatomy = airway::build(&case).unwrap();
        let pairs = landmarks::read(&data.join(format!("copd0{number}.csv"))).unwrap();
        let lungs = LungBox::read(&data.join("lung_boxes.csv"), &format!("copd0{number}")).unwrap();
        let placement = airway::import_breathing::Placement::fit(&anatomy.centerline, &lungs).unwrap();
        let mut field = case.breathing.unwrap().field;
        field.scale = 1.0;
        let placed = pairs.iter().map(|p| placement.to_airway(p));
        let sum: f64 = placed.map(|p| (field.displacement(p.inspiration_mm) - p.motion_mm()).length()).sum();
        let mean = sum / pairs.len() as f64;
        assert!(mean < most_mm, "case{number}: the field misses its landmarks by {mean} mm on average");
        // No coefficient is a landmark.
        for center in &field.centers {
            let at = DVec3::new(center[0], center[1], center[2]) + DVec3::from_array(field.origin_mm);
            let copied = pairs.iter().map(|p| placement.to_airway(p)).any(|p| p.inspiration_mm.distance(at) < 1e-3);
            assert!(!copied, "case{number}: a centre is a landmark");
        }
    }
}

/// Runs a command that must fail with exit code 4 and one sentence that says all of `parts`.
fn fails(command: &mut Command, parts: &[&str]) {
    let output = command.assert().code(4).get_output().clone();
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(text.trim_end().lines().count(), 1, "{text}");
    for part in parts {
        assert!(text.contains(part), "\"{part}\" is missing in: {text}");
    }
}

fn write_stl(path: &Path, surface: &TriangleMesh) {
    let mut bytes = vec![0u8; 80];
    bytes.extend((surface.faces.len() as u32).to_le_bytes());
    for f in 0..surface.faces.len() {
        bytes.extend([0u8; 12]);
        for corner in surface.corners(f) {
            for value in corner.to_array() {
                bytes.extend((value as f32).to_le_bytes());
            }
        }
        bytes.extend([0u8; 2]);
    }
    fs::write(path, bytes).unwrap();
}
