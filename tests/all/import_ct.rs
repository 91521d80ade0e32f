//! From scans, masks and fields to cases: a drawn chest whose truth is known, real masks, and a real registration.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use glam::DVec3;
use respire_bench::airway;
use respire_bench::airway::case::{AnatomySource, Case};
use respire_bench::airway::case_build::read_tree;
use respire_bench::airway::centerline_distance::SurfaceDistance;
use respire_bench::airway::field_check::flipped_faces;
use respire_bench::airway::surface_field::LumenField;
use respire_bench::base::random::{CounterRng, Stage};
use respire_bench::base::{NoProgress, Volume, VoxelGrid};
use respire_bench::bench::Catalogue;
use respire_bench::ct::lungs::on_grid;
use respire_bench::ct::motion_field::{carried, sampled_field, volume_change};
use respire_bench::ct::program::REMEDY;
use respire_bench::ct::registration::{RegistrationInput, elastix_version, register};
use respire_bench::formats::{nifti, volume};

use crate::binary::{PROGRAM, interrupt};
use crate::cases::case_path;
use crate::import::command;
use crate::skip::{shared, skip};

/// A chest with the lumen of case 1: its field, and the voxels it is seen on.
struct DrawnChest {
    lumen: LumenField,
    grid: VoxelGrid,
    carina: DVec3,
}

impl DrawnChest {
    fn new() -> DrawnChest {
        let case = Case::load(&case_path(1)).unwrap();
        let AnatomySource::Tree { path, .. } = &case.anatomy else { panic!("case 1 has a tree") };
        let tree = read_tree(&case.resolve(path)).unwrap().reachable(1.6, 5);
        let line = tree.to_centerline();
        let (low, high) = line
            .points
            .iter()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(p.position_mm), h.max(p.position_mm)));
        let (low, high) = (low - DVec3::new(45.0, 45.0, 30.0), high + DVec3::new(45.0, 45.0, 4.0));
        let spacing = DVec3::new(1.0, 1.0, 1.25);
        let size = ((high - low) / spacing).to_array().map(|n| n as usize);
        let carina = line.points.iter().rfind(|p| p.generation == 0).unwrap().position_mm;
        DrawnChest {
            lumen: LumenField::of_tree(&tree, 0.8, 0.5).unwrap(),
            grid: VoxelGrid::upright(size, low, spacing),
            carina,
        }
    }

    /// Signed distance to the lumen's wall at a place; far where nothing is near.
    fn distance(&self, place: DVec3) -> f64 {
        self.lumen.sample(place).map_or(100.0, |(value, _)| value)
    }

    fn mask(&self) -> Volume<u8> {
        let inside = |at: usize| u8::from(self.distance(self.grid.centre(at)) < 0.0);
        Volume { grid: self.grid, data: (0..self.grid.count()).map(inside).collect() }
    }

    /// HU: lumen, wall, two lungs beside the mediastinum, tissue.
    fn scan(&self) -> Volume<i16> {
        let mut rng = CounterRng::new(2, Stage::Test, &[]);
        let (low, high) = self.grid.bounds_mm();
        let value = |place: DVec3| {
            let from_wall = (place - low).min(high - place);
            let side = (place.x - self.carina.x).abs();
            match self.distance(place) {
                d if d < 0.0 => -1000.0,
                d if d < 1.5 => -100.0,
                _ if from_wall.truncate().min_element() > 12.0 && side > 14.0 && place.z < self.carina.z + 30.0 => {
                    -850.0
                }
                _ => 40.0,
            }
        };
        let data =
            (0..self.grid.count()).map(|at| (value(self.grid.centre(at)) + 20.0 * rng.normal()) as i16).collect();
        Volume { grid: self.grid, data }
    }

    /// A breath: up and a little forwards, more so below.
    fn motion(&self, place: DVec3) -> DVec3 {
        let depth = ((self.carina.z + 60.0 - place.z) / 150.0).clamp(0.0, 1.5);
        DVec3::new(0.01 * (place.x - self.carina.x), -2.0 * depth, 9.0 * depth * depth)
    }
}

#[test]
fn a_drawn_chest_with_a_known_field_becomes_a_case_that_moves_as_the_field_says() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let chest = DrawnChest::new();
    nifti::write(&place("insp.nii.gz"), &chest.scan()).unwrap();
    nifti::write(&place("mask.nii.gz"), &chest.mask()).unwrap();
    let coarse = VoxelGrid {
        size: chest.grid.size.map(|n| n / 3 + 2),
        axes_mm: chest.grid.axes_mm * 3.0,
        origin_mm: chest.grid.origin_mm - 1.0,
    };
    let field = sampled_field(coarse, |p| chest.motion(p));
    nifti::write(&place("field.nii.gz"), &field).unwrap();
    let import = |scan: &str, mask: &str, field: &str, out: &str| {
        let mut command = command();
        command.args(["import", "ct"]).arg(place(scan)).arg("--airway-mask").arg(place(mask));
        command.arg("--field").arg(place(field)).args(["--id", "drawn", "--out"]).arg(place(out));
        let output = command.output().unwrap();
        (output.status.code().unwrap(), String::from_utf8_lossy(&output.stderr).to_string())
    };
    let (code, said) = import("insp.nii.gz", "mask.nii.gz", "field.nii.gz", "case");
    assert_eq!(code, 0, "{said}");
    for words in ["genus 0", "surface from mask", "folds: 0 of", "tree: "] {
        assert!(said.contains(words), "no `{words}` in {said}");
    }
    let built = airway::build(&Case::load(&place("case/drawn.toml")).unwrap()).unwrap();
    let mut wall: Vec<f64> = built.inspiration.vertices.iter().map(|v| chest.distance(*v).abs()).collect();
    wall.sort_by(f64::total_cmp);
    let (median, p95) = (wall[wall.len() / 2], wall[wall.len() * 95 / 100]);
    println!("wall {median:.2} {p95:.2} mm; {said}");
    assert!(median < 0.3 && p95 < 0.625, "half a voxel: {median} {p95}");
    let truth: Vec<DVec3> = built.inspiration.vertices.iter().map(|v| v + chest.motion(*v)).collect();
    let mut off: Vec<f64> = truth.iter().zip(&built.expiration.vertices).map(|(a, b)| a.distance(*b)).collect();
    off.sort_by(f64::total_cmp);
    assert!(off[off.len() / 2] < 0.05 && off[off.len() * 99 / 100] < 0.3, "{}", off[off.len() - 1]);
    let page = fs::read_to_string(place("case/drawn-import.html")).unwrap();
    assert!(page.matches("<svg").count() >= 8 && !page.contains("http://www.w3.org/1999") && !page.contains("<script"));
    let mut names: Vec<String> =
        fs::read_dir(place("case")).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    assert_eq!(
        names,
        ["drawn-centerline.csv", "drawn-expiration.ply", "drawn-import.html", "drawn-inspiration.ply", "drawn.toml"]
    );

    // What is wrong is said in one sentence with its cure, and nothing is left behind.
    let picture = chest.scan().map(|v| ((v.clamp(-1000, 200) + 1000) / 5) as u8);
    nifti::write(&place("picture.nii.gz"), &picture).unwrap();
    nifti::write(&place("far.nii.gz"), &sampled_field(coarse, |_| DVec3::X * 500.0)).unwrap();
    nifti::write(&place("metres.nii.gz"), &sampled_field(coarse, |p| chest.motion(p) * 1e-3)).unwrap();
    let mut labels = chest.mask();
    labels.data[0] = 2;
    nifti::write(&place("labels.nii.gz"), &labels).unwrap();
    for (scan, mask, field, sentence) in [
        ("picture.nii.gz", "mask.nii.gz", "field.nii.gz", "no Hounsfield units of a chest"),
        ("insp.nii.gz", "labels.nii.gz", "field.nii.gz", "holds 2 labels (1, 2): --label"),
        ("insp.nii.gz", "mask.nii.gz", "far.nii.gz", "moves tissue by 500 mm"),
        ("insp.nii.gz", "mask.nii.gz", "metres.nii.gz", "metres.nii.gz: does not move the airway"),
        // The field is looked at first.
        ("picture.nii.gz", "mask.nii.gz", "metres.nii.gz", "metres.nii.gz: does not move the airway"),
        ("insp.nii.gz", "mask.nii.gz", "mask.nii.gz", "a displacement has three"),
    ] {
        let (code, said) = import(scan, mask, field, "refused");
        assert_eq!(code, 4, "{said}");
        assert!(said.contains(sentence) && said.trim().lines().filter(|l| l.contains("error:")).count() == 1, "{said}");
        assert!(!place("refused").exists());
    }
    assert!(!fs::read_dir(folder.path()).unwrap().any(|e| e.unwrap().file_name().to_string_lossy().starts_with('.')));
}

/// What says nothing of a volume was ignored; an option that takes two files swallowed a scan.
#[test]
fn options_that_do_not_go_with_scans_are_refused_before_any_file_is_read() {
    for (words, says) in [
        (&["no.nii", "no.nii", "--axes", "ras"][..], "--axes is for --meshes alone"),
        (&["--airway-mask", "no.nii", "--motion", "copd05", "--scale", "10"], "--scale is for --meshes alone"),
        (&["no.nii", "no.nii", "--keep-largest"], "--keep-largest is for --meshes alone"),
        (&["no.nii", "--airway-mask", "no.nii"], "one scan has no motion: give the expiration, or --field"),
        (&["--airway-mask", "mask.nii", "insp.nii", "exp.nii"], "took insp.nii as the mask at expiration"),
        (&["--airway-mask", "mask.nii", "insp.nii", "--motion", "copd05"], "took insp.nii as the mask at expiration"),
    ] {
        let output = command().args(["import", "ct", "--id", "a", "--out", "out"]).args(words).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).to_string();
        assert!(output.status.code() == Some(2) && said.contains(says), "{words:?}: {said}");
    }
}

#[test]
fn a_mask_becomes_a_case_with_a_named_motion() {
    let folder = tempfile::tempdir().unwrap();
    let mask = folder.path().join("mask.nii.gz");
    nifti::write(&mask, &DrawnChest::new().mask()).unwrap();
    let run = |motion: &str| {
        let mut command = command();
        command.args(["import", "ct", "--airway-mask"]).arg(&mask).args(["--motion", motion, "--id", "mine", "--out"]);
        command.arg(folder.path().join("out")).output().unwrap()
    };
    let refused = run("copd10");
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("copd01, copd02"));
    let output = run("copd05");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let case = Case::load(&folder.path().join("out/mine.toml")).unwrap();
    assert!(case.breathing.unwrap().field.source.starts_with("copd05 "));
}

/// Whether tests that take minutes were asked for; `what` is not tested where they were not.
fn minutes_wanted(what: &str) -> bool {
    let wanted = std::env::var("RESPIRE_CT").is_ok_and(|wish| wish == "all");
    if !wanted {
        skip("ct", &format!("{what} would take minutes; RESPIRE_CT=all runs it"));
    }
    wanted
}

fn has_elastix() -> bool {
    let found = elastix_version().is_some();
    if !found {
        skip("elastix", &format!("elastix is not installed ({REMEDY})"));
    }
    found
}

/// The raw masks of five teams, unsmoothed, as networks write them: one of them unless all are asked for.
#[test]
fn every_real_mask_is_imported_at_the_first_try() {
    let Some(masks) = shared("data/atm22/masks") else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut count = 0;
    for team in ["SanmedAI", "YangLab", "deeptree_damo", "neu204", "timi"] {
        for (patient, motion) in [("ATM_307_0000", "copd05"), ("ATM_384_0000", "copd01")] {
            let mut command = command();
            command.args(["import", "ct", "--airway-mask"]).arg(masks.join(team).join(format!("{patient}.nii.gz")));
            command.args(["--motion", motion, "--id", &format!("{team}-{patient}"), "--out"]).arg(folder.path());
            let output = command.output().unwrap();
            let said = String::from_utf8_lossy(&output.stderr).to_string();
            println!("{team} {patient}: {said}");
            assert!(output.status.success(), "{team} {patient}: {said}");
            count += 1;
            if count == 1 && !minutes_wanted("the import of the other nine masks") {
                return;
            }
        }
    }
    assert_eq!(count, 10);
}

/// Target registration error on landmarks of experts: the two visits of `pair_visits`.
#[test]
fn a_registration_meets_its_target_on_landmarks() {
    let Some(data) = shared("data/ct/pair_visits") else { return };
    if !has_elastix() || !minutes_wanted("a registration of two visits") {
        return;
    }
    let input = |name: &str| {
        let scan = volume::read_scan(&data.join(format!("{name}.mha"))).unwrap();
        let labels = volume::read_labels(&data.join(format!("{name}_mask.mha"))).unwrap();
        let lungs = on_grid(&labels.map(|v| u8::from(v > 0)), &scan);
        RegistrationInput::new(&scan, &lungs, None)
    };
    let (fixed, moving) = (input("baseline"), input("followup"));
    let folder = tempfile::tempdir().unwrap();
    let field = register(&fixed, &moving, folder.path(), &NoProgress).unwrap();
    let text = fs::read_to_string(data.join("landmarks.csv")).unwrap();
    let rows: Vec<Vec<f64>> =
        text.lines().skip(1).map(|line| line.split(',').map(|v| v.parse().unwrap()).collect()).collect();
    let from: Vec<DVec3> = rows.iter().map(|r| DVec3::new(r[0], r[1], r[2])).collect();
    let there = carried(&field, &from);
    let mut off: Vec<f64> = rows.iter().zip(there).map(|(r, p)| DVec3::new(r[3], r[4], r[5]).distance(p)).collect();
    off.sort_by(f64::total_cmp);
    let (mean, median) = (off.iter().sum::<f64>() / off.len() as f64, off[off.len() / 2]);
    let change = volume_change(&field, &fixed.lungs);
    println!("{} landmarks: mean {mean:.2}, median {median:.2} mm; {change:?}", off.len());
    assert!(mean <= 1.4 && median <= 1.0, "{mean} {median}");
    assert_eq!(change.folded, 0);
}

/// The case whose anatomy and motion are one person's is carried with the licence of its scans, moves as a tidal breath
/// does and folds nowhere. Where the scans are at hand and time is, an import makes it again.
#[test]
fn the_patient_is_a_case_that_an_import_makes_again() {
    let catalogue = Catalogue::open(None).unwrap();
    let built = airway::build(&Case::load(&catalogue.case_file("patient1").unwrap()).unwrap()).unwrap();
    let (rest, moved) = (&built.inspiration, &built.expiration);
    rest.validate_closed().unwrap();
    assert!(flipped_faces(rest, &moved.vertices).is_empty());
    let mut motion: Vec<f64> = rest.vertices.iter().zip(&moved.vertices).map(|(a, b)| a.distance(*b)).collect();
    motion.sort_by(f64::total_cmp);
    let (median, most) = (motion[motion.len() / 2], motion[motion.len() - 1]);
    println!("motion {median:.1}, at most {most:.1} mm");
    assert!((0.5..8.0).contains(&median) && most < 25.0, "{median} {most}");
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases/patients");
    let licence = fs::read_to_string(folder.join("patient1-licence.txt")).unwrap();
    assert!(licence.contains("Plastimatch Software License"));

    let Some(data) = shared("data/ct/pair_tidal") else { return };
    if !has_elastix() || !minutes_wanted("the import of the patient") {
        return;
    }
    let again = tempfile::tempdir().unwrap();
    let mut command = command();
    command.args(["import", "ct"]).arg(data.join("t0.mha")).arg(data.join("t5.mha"));
    command.args(["--id", "patient1", "--out"]).arg(again.path());
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let case = Case::load(&again.path().join("patient1.toml")).unwrap();
    let found = airway::build(&case).unwrap();
    // The surface has no chance in it; the field of another version of elastix differs by some tenths of a millimetre.
    let surface = SurfaceDistance::new(rest);
    assert!(found.inspiration.vertices.iter().all(|v| surface.distance(*v) < 0.05));
    let surface = SurfaceDistance::new(moved);
    let mut off: Vec<f64> = found.expiration.vertices.iter().map(|v| surface.distance(*v)).collect();
    off.sort_by(f64::total_cmp);
    assert!(off[off.len() / 2] < 0.3, "{}", off[off.len() / 2]);
}

/// Without elastix the sentence names the command that installs it, before any work, and the exit code is that of the
/// environment.
#[test]
fn without_elastix_the_cure_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let chest = folder.path().join("a.nii.gz");
    let grid = VoxelGrid::upright([4, 4, 4], DVec3::ZERO, DVec3::splat(2.0));
    nifti::write(&chest, &Volume::filled(grid, 0i16)).unwrap();
    let mut command = command();
    command.args(["import", "ct"]).arg(&chest).arg(&chest).args(["--id", "a", "--out"]).arg(folder.path().join("out"));
    let output = command.env("PATH", Path::new("/nowhere")).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).to_string();
    assert_eq!(output.status.code(), Some(5), "{said}");
    assert!(said.contains("scripts/setup.sh --ct") && said.contains("--field"), "{said}");
}

/// A folder of one compressed slice and the program that would unpack it, which here never ends: it makes `started` and
/// waits.
fn unending_conversion(folder: &Path) {
    let element = |number: u8, kind: &str, value: &[u8]| {
        let head = [&[2, 0, number, 0], kind.as_bytes(), &[value.len() as u8, 0]].concat();
        [head, value.to_vec()].concat()
    };
    let elements = [
        element(2, "UI", b"1.2.840.10008.5.1.4.1.1.2\0"),
        // Run lengths.
        element(0x10, "UI", b"1.2.840.10008.1.2.5\0"),
    ]
    .concat();
    let length = element(0, "UL", &(elements.len() as u32).to_le_bytes());
    fs::create_dir(folder.join("slices")).unwrap();
    fs::write(folder.join("slices/a"), [vec![0; 128], b"DICM".to_vec(), length, elements].concat()).unwrap();
    let program = folder.join("dcm2niix");
    let started = folder.join("started");
    let script = format!(
        "#!/bin/sh\nif [ \"$1\" = --version ]; then echo v1.0.20220720; exit 3; fi\n: > '{}'\nexec sleep 60\n",
        started.display()
    );
    fs::write(&program, script).unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
}

/// Ctrl-C in a terminal goes to the program and to what it started, `kill -INT` to the program alone. Either stops the
/// conversion of a DICOM folder, and is no failure of dcm2niix.
#[test]
fn a_conversion_that_is_interrupted_says_so() {
    for to_whole_group in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        unending_conversion(folder.path());
        let mut command = std::process::Command::new(PROGRAM);
        command.args(["import", "ct"]).arg(folder.path().join("slices")).args(["--motion", "copd05", "--id", "a"]);
        command.arg("--out").arg(folder.path().join("out"));
        command.env("PATH", format!("{}:/usr/bin:/bin", folder.path().display())).stdin(Stdio::null());
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).process_group(0).spawn().unwrap();
        let begun = Instant::now();
        while !folder.path().join("started").exists() {
            assert!(child.try_wait().unwrap().is_none(), "it ended before the conversion began");
            assert!(begun.elapsed() < Duration::from_secs(60), "the conversion did not begin");
            std::thread::sleep(Duration::from_millis(20));
        }
        let target = format!("{}{}", if to_whole_group { "-" } else { "" }, child.id());
        interrupt(&target);
        let told = Instant::now();
        let output = child.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).to_string();
        assert_eq!(output.status.code(), Some(130), "{said}");
        assert!(told.elapsed() < Duration::from_secs(30), "it waited for the conversion to end");
        assert!(!folder.path().join("out/a.toml").exists());
    }
}
