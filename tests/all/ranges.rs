//! Whatever number stands in a file or on the command line: it is used, or refused in one sentence that names it. No
//! panic, no abort, no hang.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use respire_bench::airway::case::{AnatomySource, CameraSettings, Case, ClinicalSettings};
use respire_bench::airway::case_build::read_tree;
use respire_bench::base::estimate::ASK_RESUMABLE_SECONDS;
use respire_bench::base::{Progress, Result};
use respire_bench::bench::profile::Profile;
use respire_bench::bench::{Ablations, Catalogue, Pipeline, Wishes};
use respire_bench::formats::mesh;
use respire_bench::reconstruct::MethodFile;
use respire_bench::render::scene_file::SceneFile;
use respire_bench::render::{Light, Material, RenderSettings, Scene, render_watched};
use respire_bench::report::gate::read_thresholds;
use respire_bench::simulate;
use toml::Value;

use crate::binary::PROGRAM;
use crate::render::small_tube;

fn shipped() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases")
}

/// Numbers that no key may have, seeds included.
fn impossible() -> Vec<Value> {
    let floats = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300, 2f64.powi(63), -2f64.powi(63)];
    floats.into_iter().map(Value::Float).chain([Value::Integer(i64::MAX), Value::Integer(i64::MIN)]).collect()
}

/// Numbers that some keys may have.
fn doubtful() -> Vec<Value> {
    vec![Value::Integer(-1), Value::Integer(0), Value::Float(0.0), Value::Float(1e-300), Value::Float(-1e-9)]
}

/// Where a number stands: keys and places in arrays.
type NumberPath = Vec<String>;

/// Paths of the numbers of a table; of an array the first and the last element.
fn numbers(value: &Value, at: &NumberPath, found: &mut Vec<NumberPath>) {
    let below = |name: String| [at.clone(), vec![name]].concat();
    match value {
        Value::Integer(_) | Value::Float(_) => found.push(at.clone()),
        Value::Table(table) => table.iter().for_each(|(name, v)| numbers(v, &below(name.clone()), found)),
        Value::Array(items) => {
            for place in BTreeSet::from([0, items.len().saturating_sub(1)]) {
                items.get(place).into_iter().for_each(|v| numbers(v, &below(place.to_string()), found));
            }
        }
        _ => {}
    }
}

fn number_at<'a>(value: &'a mut Value, path: &[String]) -> &'a mut Value {
    path.iter().fold(value, |at, name| match at {
        Value::Array(items) => &mut items[name.parse::<usize>().unwrap()],
        other => other.get_mut(name.as_str()).unwrap(),
    })
}

/// The name by which an error must call a number: its last key that is a word. A sourced number is called by its key.
fn name_of(path: &NumberPath) -> &str {
    let words = path.iter().rev().filter(|word| word.parse::<usize>().is_err() && *word != "value");
    // A key of an ablation is a path with dots.
    words.filter_map(|word| word.rsplit('.').next()).next().unwrap()
}

/// Puts every number of `good` through all values. `file` is written each time; `load` reads it and plans.
fn try_all(good: &Value, file: &Path, load: impl Fn(&Path) -> Result<()>) -> usize {
    std::fs::write(file, toml::to_string(good).unwrap()).unwrap();
    load(file).unwrap_or_else(|e| panic!("as shipped: {e}"));
    let mut paths = Vec::new();
    numbers(good, &Vec::new(), &mut paths);
    for path in &paths {
        for (value, may_pass) in
            impossible().into_iter().map(|v| (v, false)).chain(doubtful().into_iter().map(|v| (v, true)))
        {
            let mut changed = good.clone();
            *number_at(&mut changed, path) = value.clone();
            std::fs::write(file, toml::to_string(&changed).unwrap()).unwrap();
            let start = Instant::now();
            let outcome = load(file);
            let label = format!("{} {path:?} = {value}", file.display());
            assert!(start.elapsed() < Duration::from_secs(5), "{label}: took {:?}", start.elapsed());
            let Err(error) = outcome else {
                assert!(may_pass, "{label}: is taken");
                continue;
            };
            let said = error.to_string();
            assert_eq!(error.kind().exit_code(), 4, "{label}: {said}");
            assert!(said.contains(name_of(path)), "{label}: the key is not named: {said}");
            let name = file.file_name().unwrap().to_str().unwrap();
            assert!(said.contains(name) && !said.contains('\n'), "{label}: {said}");
        }
    }
    paths.len()
}

/// A shipped case with all that it could say said.
fn full_case(number: usize) -> Value {
    let mut case = Case::load(&shipped().join(format!("case{number}.toml"))).unwrap();
    case.camera = CameraSettings { fisheye: Some([-0.02, 0.001, 0.0, 0.0]), ..case.camera };
    case.waveform.hold_s = 0.5;
    case.registration_error_mm = 0.5;
    case.clinical = Some(ClinicalSettings::default());
    if let AnatomySource::Tree { path, .. } = &mut case.anatomy {
        *path = shipped().join(&path);
    }
    let look = Material { single_scattering_albedo: Some([0.9, 0.8, 0.7]), ..simulate::material(&case).unwrap() };
    case.material = toml::Table::try_from(look).unwrap();
    Value::try_from(&case).unwrap()
}

#[test]
fn every_number_of_a_case_is_used_or_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let profile = Profile::load(&shipped().join("profiles"), "paper").unwrap();
    // Of a measured tree and of a grown one; the others have the same keys.
    for number in [1, 9] {
        let tried = try_all(&full_case(number), &folder.path().join("case.toml"), |file| {
            let case = Case::load(file)?;
            simulate::material(&case).map_err(|e| e.at(file))?;
            let frames = profile.frames(case.waveform.period_s());
            assert!((0.0..=1.0).contains(&case.waveform.phase(frames as f64 / 25.0, case.seed)));
            Ok(())
        });
        assert!(tried > 60, "{tried} numbers");
    }
    for number in 1..=9 {
        Case::load(&shipped().join(format!("case{number}.toml"))).unwrap();
    }
}

#[test]
fn every_number_of_a_method_is_used_or_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    for id in ["ours", "ours-nomesh", "static-ct", "ours-gn", "bridgesplat", "bridgesplat-nomesh"] {
        let mut keys = MethodFile::load(&shipped().join(format!("methods/{id}.toml"))).unwrap().keys().clone();
        keys.remove("base");
        let tried = try_all(&Value::Table(keys), &folder.path().join(format!("{id}.toml")), |file| {
            MethodFile::load(file)?.method(1.0).map(drop)
        });
        assert!(tried > 15, "{id}: {tried} numbers");
    }
}

#[test]
fn every_number_of_a_profile_a_gate_a_tree_and_an_ablation_is_used_or_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let read =
        |name: &str| -> Value { toml::from_str(&std::fs::read_to_string(shipped().join(name)).unwrap()).unwrap() };
    for name in ["paper", "quick", "smoke"] {
        try_all(&read(&format!("profiles/{name}.toml")), &place("profile.toml"), |file| {
            let profile = Profile::load(file.parent().unwrap(), file.to_str().unwrap())?;
            assert!(profile.frames(4.0) >= 2);
            Ok(())
        });
    }
    assert!(try_all(&read("gate.toml"), &place("limits.toml"), |file| read_thresholds(file).map(drop)) >= 3);
    try_all(&read("trees/atm_224.toml"), &place("tree.toml"), |file| read_tree(file).map(drop));
    let all = read("ablations.toml");
    for line in all["ablation"].as_array().unwrap() {
        let mut one = all.clone();
        *number_at(&mut one, &["ablation".into()]) = Value::Array(vec![line.clone()]);
        try_all(&one, &place("ablations.toml"), |file| {
            let ablations = Ablations::load(file, None)?;
            // Where the command says which line it was.
            let of_file =
                |e: respire_bench::base::Error| respire_bench::base::Error::new(e.kind(), e.to_string()).at(file);
            for variant in &ablations.ablation {
                variant.method_file(&shipped().join("methods")).map_err(of_file)?;
                let changed = Case::load_changed(&shipped().join("case1.toml"), &variant.case);
                changed.map_err(of_file)?;
            }
            Ok(())
        });
    }
}

/// A scene file that says all that it can, around a small tube.
fn scene_folder(camera: &str, integrator: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    mesh::write_ply(&folder.path().join("tube.ply"), &small_tube(), &[]).unwrap();
    let text = format!(
        "[mesh]\npath = \"tube.ply\"\nexpiration = \"tube.ply\"\nphase = 0.5\n\
         [camera]\nworld_from_camera = [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]\n{camera}\n\
         [light]\nintensity = [400.0, 400.0, 400.0]\nposition = [0.0, 1.0, 0.0]\nemission_exponent = 1.0\n\
         [material]\nkind = \"lambert\"\n[integrator]\n{integrator}\n"
    );
    std::fs::write(folder.path().join("scene.toml"), text).unwrap();
    folder
}

#[test]
fn every_number_of_a_scene_is_used_or_refused_by_name() {
    let fisheye = "width = 24\nheight = 20\nfl_x = 20.0\nfl_y = 20.0\ncx = 12.0\ncy = 10.0\nk1 = 0.1\n\
                   k2 = 0.0\nk3 = 0.0\nk4 = 0.0\nmodel = \"OPENCV_FISHEYE\"";
    let all = "max_scatterings = 2\nspp = 4\ntarget_relmse = 0.01\ntransport = \"gather\"\nrays_per_face = 32\nseed = 1\n\
               background = [0.1, 0.1, 0.1]";
    for camera in [fisheye, "width = 24\nheight = 20\nfov_x_deg = 90.0"] {
        let folder = scene_folder(camera, all);
        let file = folder.path().join("scene.toml");
        let mut scene: Value = toml::from_str(&std::fs::read_to_string(&file).unwrap()).unwrap();
        let look = Material { single_scattering_albedo: Some([0.9, 0.8, 0.7]), ..Material::default() };
        *number_at(&mut scene, &["material".into()]) = Value::try_from(look).unwrap();
        let tried = try_all(&scene, &file, |file| SceneFile::load(file).map(drop));
        assert!(tried > 30, "{tried} numbers");
    }
}

/// Runs the program with a time limit of 20 s: exit code and what it says.
fn limited(folder: &Path, words: &[&str]) -> (i32, String) {
    let start = Instant::now();
    let output = assert_cmd::Command::new(PROGRAM)
        .current_dir(folder)
        .args(words)
        .timeout(Duration::from_secs(20))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let Some(code) = output.status.code() else { panic!("{words:?}: no exit after {:?}: {said}", start.elapsed()) };
    assert!([0, 2, 4].contains(&code) && !said.contains("panicked"), "{words:?}: exit {code}: {said}");
    (code, said)
}

/// Words of a command whose inputs are missing, and its options that are numbers. What passes the options ends with the
/// sentence about the input.
const NUMBERS: [(&str, &[&str]); 17] = [
    ("doctor", &["--threads"]),
    ("track --sequence no --bench-cases {cases}", &["--seed", "--patience-s"]),
    ("run --case no.toml --method ours --bench-cases {cases}", &["--seed"]),
    ("all-cases --dry-run --cases no.toml --bench-cases {cases}", &["--seeds"]),
    ("list --cases no.toml --bench-cases {cases}", &["--seeds"]),
    ("ablate --cases no.toml --bench-cases {cases}", &["--at-once"]),
    ("simulate no.toml --out out --bench-cases {cases}", &["--frames", "--width", "--spp"]),
    ("splat no.ply --cameras no.json --out out", &["--repeat", "--background", "--near"]),
    (
        "import mesh no.ply --landmarks no.csv --id x --out out",
        &["--fov-x-deg", "--scope-radius-mm", "--seed", "--end-motion-mm", "--scale"],
    ),
    ("slurm --scripts out --cases no.toml --bench-cases {cases}", &["--seeds", "--at-once", "--processors"]),
    ("export no --format tum --out out", &["--scale"]),
    (
        "import ct --airway-mask no.nii.gz --motion copd05 --id x --out out",
        &["--label", "--fov-x-deg", "--scope-radius-mm", "--seed", "--end-motion-mm", "--scale"],
    ),
    ("import mesh-pair no.ply no.ply --id x --out out", &["--fov-x-deg", "--scope-radius-mm", "--seed", "--scale"]),
    ("import breathing no.toml --landmarks no.csv", &["--end-motion-mm"]),
    ("import tree no.csv --source s --out out.toml", &["--least-radius-mm", "--deepest", "--scale"]),
    (
        "pareto render --out out --cases no.toml --bench-cases {cases}",
        &["--width", "--reference-spp", "--most-spp", "--phase"],
    ),
    (
        "light-bias --out out --cases no.toml --bench-cases {cases}",
        &["--places", "--phases", "--width", "--reference-spp"],
    ),
];

#[test]
fn every_number_of_the_command_line_is_used_or_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let cases = shipped();
    let values =
        ["nan", "inf", "-inf", "-1", "0", "1e-300", "1e300", "70000", "9223372036854775808", "18446744073709551615"];
    let try_option = |words: &str, option: &str| {
        for value in values {
            let words = words.replace("{cases}", cases.to_str().unwrap());
            let mut words: Vec<&str> = words.split(' ').collect();
            let option_is = format!("{option}={value}");
            match option {
                "--background" => words.extend(["--background", "0", "0", value]),
                _ => words.push(&option_is),
            }
            let (code, said) = limited(folder.path(), &words);
            if ["nan", "inf", "-inf", "1e300", "-1"].contains(&value) {
                assert_eq!(code, 2, "{words:?}: {said}");
            }
            // A colour below 0 looks like an option.
            if code == 2 && !(option == "--background" && value.starts_with('-')) {
                assert!(said.contains(option), "{words:?}: {said}");
            }
        }
    };
    for (words, options) in NUMBERS {
        options.iter().for_each(|option| try_option(words, option));
    }
    // Their other words would start the work itself.
    for scene in ["0x8", "8x0", "nanxnan", "-1x8", "1e300x8", "18446744073709551615x8", "8x18446744073709551615"] {
        let (code, said) = limited(folder.path(), &["pareto", "splat", "--out", "out", "--scenes", scene]);
        assert_eq!(code, 2, "{scene}: {said}");
    }
    for repeat in ["nan", "0", "1e300", "18446744073709551615", "2.5"] {
        let (code, said) = limited(folder.path(), &["pareto", "splat", "--out", "out", "--repeat", repeat]);
        assert_eq!(code, 2, "{repeat}: {said}");
    }
}

/// The table above has every option whose value name says that it is a number (`src/cli/mod.rs` holds the names to be
/// right).
#[test]
fn the_table_of_numbers_is_complete() {
    let folder = tempfile::tempdir().unwrap();
    let help = |words: &[&str]| {
        let output = assert_cmd::Command::new(PROGRAM).args(words).arg("--help").output().unwrap();
        String::from_utf8(output.stdout).unwrap()
    };
    let subcommands = |text: &str| -> Vec<String> {
        let listed = text.split("Commands:").nth(1).unwrap_or_default().lines().skip(1);
        let names = listed.take_while(|line| !line.trim().is_empty()).filter(|line| line.starts_with("  "));
        let names = names.filter(|line| !line.starts_with("   ")).filter_map(|line| line.split_whitespace().next());
        names.filter(|name| *name != "help").map(str::to_owned).collect()
    };
    let mut commands: Vec<Vec<String>> = subcommands(&help(&[])).into_iter().map(|name| vec![name]).collect();
    let (mut looked_at, mut missing) = (0, Vec::new());
    while let Some(words) = commands.pop() {
        let text = help(&words.iter().map(String::as_str).collect::<Vec<_>>());
        commands.extend(subcommands(&text).into_iter().map(|name| [words.clone(), vec![name]].concat()));
        for line in text.lines().map(str::trim).filter(|line| line.starts_with("--")) {
            let (option, rest) = line.split_once(' ').unwrap_or((line, ""));
            let value = rest.trim_start_matches('<').split('>').next().unwrap_or_default();
            if !["N", "N,..", "PX", "MM", "DEG", "PHASE", "R", "GENERATION"].contains(&value) || option == "--threads" {
                continue;
            }
            looked_at += 1;
            let begins = format!("{} ", words.join(" "));
            let known =
                NUMBERS.iter().any(|(command, options)| command.starts_with(&begins) && options.contains(&option));
            if !known && begins != "pareto splat " {
                missing.push(format!("{begins}{option}"));
            }
        }
    }
    assert!(looked_at >= 20 && missing.is_empty(), "{looked_at} options, not in the table: {missing:?}");
    drop(folder);
}

/// Sizes and times that used to end in an abort or in nothing at all.
#[test]
fn what_would_never_end_is_refused_in_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let cases = shipped();
    let cases = cases.to_str().unwrap();
    let refused = |words: &[&str], code: i32, says: &str| {
        let (found, said) = limited(folder.path(), words);
        assert_eq!(found, code, "{words:?}: {said}");
        assert!(said.contains(says), "{words:?}: {said}");
    };
    refused(&["doctor", "--threads", "70000"], 2, "70000 must lie in 0 to 512");
    for frames in ["2000000000", "18446744073709551615"] {
        refused(&["simulate", "case1", "--bench-cases", cases, "--out", "out", "--frames", frames], 2, "2 to 100000");
    }
    let quick = std::fs::read_to_string(shipped().join("profiles/quick.toml")).unwrap();
    for (from, to, says) in [
        ("frames_per_second = 10.0", "frames_per_second = 1e18", "frames_per_second: 1e18"),
        ("frames_per_second = 10.0", "frames_per_second = 1e-300", "frames_per_second: 1e-300"),
        ("iteration_scale = 0.4", "iteration_scale = 1e300", "iteration_scale: 1e300"),
        // Each in range, and four million frames together.
        ("minimum_breaths = 1.0", "minimum_breaths = 1000.0\nframes_per_second = 1000.0", "must lie in 2 to 100000"),
    ] {
        let text = if to.contains("minimum_breaths") {
            quick.replace("frames_per_second = 10.0\n", "")
        } else {
            quick.clone()
        };
        std::fs::write(place("mine.toml"), text.replace(from, to)).unwrap();
        refused(&["list", "--bench-cases", cases, "--profile", &place("mine.toml")], 4, says);
    }
    for (from, to, says) in [
        ("period_scale = 1.0", "period_scale = 1e-300", "waveform.period_scale: 1e-300"),
        ("period_scale = 1.0", "start_hold_s = 1e12", "waveform.start_hold_s: 1e12"),
        ("[breathing.calibre]", "[anatomy.surface]\nshortest_edge_mm = 1e-9\n[breathing.calibre]", "shortest_edge_mm"),
        ("[breathing.calibre]", "[anatomy.surface]\nrounds = 9223372036854775807\n[breathing.calibre]", "rounds"),
        ("[breathing.calibre]", "[anatomy.surface]\nspacing_mm = nan\n[breathing.calibre]", "spacing_mm: NaN"),
        ("[breathing.calibre]", "[anatomy.surface]\nlongest_edge_mm = -1\n[breathing.calibre]", "longest_edge_mm: -1"),
        // Each in range, and a hundred million faces together.
        (
            "[breathing.calibre]",
            "[anatomy.surface]\nshortest_edge_mm = 0.05\nedge_per_radius = 0.01\n[breathing.calibre]",
            "the surface would have about",
        ),
    ] {
        let text = std::fs::read_to_string(shipped().join("case1.toml")).unwrap();
        assert!(text.contains(from));
        let text = text.replace("trees/", &format!("{cases}/trees/")).replace(from, to);
        std::fs::write(place("mine.toml"), text).unwrap();
        let words = ["simulate", &place("mine.toml"), "--bench-cases", cases, "--out", "out", "--profile", "smoke"];
        refused(&words, 4, says);
    }
    let table = "id,x_mm,y_mm,z_mm,radius_mm,branch,generation,parent_id\n0,0,0,0,5,0,0,-1\n1,0,0,-10,5,0,0,0\n";
    for (out, row, code, says) in [
        ("last.toml", "2,0,0,-20,5,4294967294,1,1\n3,0,0,-30,5,4294967294,1,2\n", 0, ""),
        ("far.toml", "2,0,1000000000,-20,4,1,1,1\n3,0,0,-30,4,1,1,2\n", 4, "id 2, coordinates: 1e9"),
    ] {
        std::fs::write(place("tree.csv"), format!("{table}{row}")).unwrap();
        refused(&["import", "tree", &place("tree.csv"), "--unusual", "--source", "s", "--out", out], code, says);
    }
}

#[test]
fn large_stills_are_asked_about_and_small_targets_refused() {
    for (size, integrator, code, says) in [
        ([24, 20], "spp = 1\ntarget_relmse = 1e-300", 4, "integrator.target_relmse: 1e-300"),
        ([4096, 4096], "spp = 65536", 2, "say --yes, or make it smaller"),
        ([16_777_216, 1], "spp = 65536", 2, "say --yes, or make it smaller"),
        ([16_777_216, 2], "spp = 1", 4, "is too large"),
        ([4096, 4096], "spp = 16\ntarget_relmse = 1e-8", 2, "say --yes, or make it smaller"),
        ([24, 20], "spp = 1\ntarget_relmse = 1e-3\nmax_scatterings = 1", 0, ""),
    ] {
        let folder = scene_folder(&format!("width = {}\nheight = {}\nfov_x_deg = 90.0", size[0], size[1]), integrator);
        let (found, said) = limited(folder.path(), &["render", "scene.toml", "--out", "view"]);
        assert_eq!(found, code, "{size:?} {integrator}: {said}");
        assert!(said.contains(says), "{size:?} {integrator}: {said}");
    }
}

/// Options that are each in range may ask for a year together.
#[test]
fn a_long_comparison_of_light_is_asked_about() {
    let folder = tempfile::tempdir().unwrap();
    let long = ["light-bias", "--width", "1024", "--reference-spp", "65536", "--out", "out"];
    let (code, said) = limited(folder.path(), &long);
    assert!(code == 2 && said.contains("years; say --yes, or make it smaller"), "{code}: {said}");
    assert!(!folder.path().join("out").exists());
}

/// Whoever runs what is shipped, on a machine with one core, is asked nothing.
#[test]
fn shipped_profiles_are_not_asked_about() {
    let catalogue = Catalogue::open(Some(&shipped())).unwrap();
    for profile in ["smoke", "quick", "paper"] {
        let estimate = Pipeline::new(&catalogue, profile, Wishes::default()).unwrap().estimate();
        let seconds = estimate.seconds * rayon::current_num_threads() as f64;
        assert!(estimate.resumable && (1.0..ASK_RESUMABLE_SECONDS).contains(&seconds), "{profile}: {estimate}");
        assert!(estimate.memory_bytes < 1e9, "{profile}: {estimate}");
    }
}

/// Counts reports.
struct Reports(std::sync::Mutex<Vec<(usize, usize)>>);

impl Progress for Reports {
    fn advance(&self, done: usize, total: usize) {
        self.0.lock().unwrap().push((done, total));
    }

    fn cancelled(&self) -> bool {
        false
    }
}

#[test]
fn a_still_reports_its_progress_within_a_round_of_samples() {
    let scene = Scene::new(&small_tube(), &[], Material::lambert([0.5; 3]), 1).unwrap();
    let camera = respire_bench::base::Camera::pinhole(1024, 800, 1.5);
    let settings = RenderSettings { samples_per_pixel: 1, max_scatterings: 1, ..RenderSettings::default() };
    let reports = Reports(std::sync::Mutex::default());
    let light = Light::at_camera([100.0; 3]);
    render_watched(&scene, &camera, &glam::DAffine3::IDENTITY, &light, &settings, &reports).unwrap();
    let reports = reports.0.into_inner().unwrap();
    assert!(reports.len() >= 5, "{reports:?}");
    assert_eq!(reports.last(), Some(&(64 * 50, 64 * 50)));
}

/// Meshes whose faces coincide: rings of vertices that repeat every face used to take 9.8 GB, and crossings of every
/// ray with every face ended in an abort.
#[test]
fn coincident_faces_take_little_memory() {
    let integrator = "spp = 1\ntransport = \"vertices\"\nrays_per_face = 1";
    let folder = scene_folder("width = 8\nheight = 8\nfov_x_deg = 60.0", integrator);
    let write = |name: &str, vertices: &str, faces: &str, copies: usize| {
        let (n, m) = (vertices.lines().count(), faces.lines().count() * copies);
        let head =
            format!("element vertex {n}\nproperty float x\nproperty float y\nproperty float z\nelement face {m}");
        let head = format!("ply\nformat ascii 1.0\n{head}\nproperty list uchar int vertex_indices\nend_header");
        std::fs::write(folder.path().join(name), format!("{head}\n{vertices}{}", faces.repeat(copies))).unwrap();
    };
    write("tube.ply", "-5 -5 9\n5 -5 9\n0 5 9\n", "3 0 2 1\n", 200_000);
    write("solid.ply", "0 0 0\n60 0 0\n0 60 0\n0 0 60\n", "3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n", 50_000);
    let file = folder.path().join("scene.toml");
    let scene = std::fs::read_to_string(&file).unwrap();
    let walls = "kind = \"subsurface\"\nmean_free_path_mm = [1.0, 1.0, 1.0]";
    std::fs::write(&file, scene.replace("kind = \"lambert\"", walls)).unwrap();
    for (words, code) in [("render scene.toml --out view", 0), ("import tree solid.ply --source s --out tree.toml", 4)]
    {
        // 4 GB of addresses, shared libraries included.
        let command = format!("ulimit -v 4000000; exec {PROGRAM} {words}");
        let limited = assert_cmd::Command::new("sh")
            .args(["-c", &command])
            .current_dir(folder.path())
            .timeout(Duration::from_secs(60))
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&limited.stderr).into_owned();
        assert_eq!(limited.status.code(), Some(code), "{words}: {:?}: {said}", limited.status);
    }
}
