//! Every example of every `--help` is run as it stands there, but for what is exchanged below, in a folder that holds what
//! it names. Those that take minutes, or need files of others, are named with the test that runs the like.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::Command;

use crate::binary::{PROGRAM, outcome};

/// Beginnings of examples that are not run here, and what runs their command instead.
const ELSEWHERE: [(&str, &str); 16] = [
    ("all-cases --profile smoke", "scripts/test.sh"),
    ("ablate --only schedule", "the unit tests of bench/variant.rs"),
    ("ablate --file ours --only iterations", "the unit tests of bench/variant.rs"),
    ("ct-loop", "tests/all/simulate_ct.rs"),
    ("simulate-ct", "tests/all/simulate_ct.rs"),
    ("import breathing", "tests/all/import.rs"),
    ("import ct insp.nii.gz", "tests/all/import_ct.rs"),
    ("import ct --airway-mask", "tests/all/import_ct.rs"),
    ("import ct --meshes", "tests/all/import_ct.rs"),
    ("import mesh airway.ply", "tests/all/import.rs"),
    ("import mesh-pair", "tests/all/import.rs"),
    ("import tree", "tests/all/import.rs"),
    ("light-bias", "the unit tests of experiments/light_bias.rs"),
    ("pareto render", "the unit tests of experiments/pareto"),
    ("render scene.toml", "tests/all/render_command.rs"),
    ("stress", "the unit tests of experiments/stress"),
];

/// Words that are exchanged: for a smaller film or scene, a quicker method, a folder of the test.
const EXCHANGED: [(&str, &str); 8] = [
    ("--profile quick", "--profile tiny.toml"),
    ("--profile smoke", "--profile tiny.toml"),
    ("pareto phase", "pareto phase --profile tiny.toml"),
    ("pareto splat", "pareto splat --scenes 600x48 --repeat 1"),
    ("--method ours --profile", "--method pose-only --profile"),
    ("reports/reference/quick reports/latest/ideal", "reports/reference/quick reports/reference/quick"),
    ("~/", ""),
    ("/tmp/", "tmp/"),
];

fn program(folder: &Path) -> Command {
    let mut command = Command::new(PROGRAM);
    command.current_dir(folder);
    command
}

fn done(command: &mut Command) -> String {
    let (code, out, err) = outcome(command.output().unwrap());
    assert_eq!(code, 0, "{command:?}: {err}");
    out
}

/// The examples of a command and of those below it, without the program's name.
fn collect(command: &[String], found: &mut BTreeSet<String>) {
    let help = done(program(Path::new(".")).args(command).arg("--help"));
    // A name stands two columns in; what stands further in is a description's next line.
    let listed = help.split("Commands:").nth(1).unwrap_or("").lines().skip(1);
    let listed =
        listed.take_while(|line| !line.trim().is_empty()).filter(|line| line.trim_start().len() + 2 == line.len());
    let names: Vec<&str> =
        listed.filter_map(|line| line.split_whitespace().next()).filter(|name| *name != "help").collect();
    for name in names {
        collect(&[command, &[name.to_owned()]].concat(), found);
    }
    // An example that is wrapped goes on in the next line, which begins none.
    let Some(at) = help.find("Example") else { return };
    let text = help[at..].replace("Examples:", "Example:").replace("Example:", " ");
    let text = format!(" {}", text.split_whitespace().collect::<Vec<_>>().join(" "));
    found.extend(text.split(" respire-bench ").map(|example| example.trim().to_owned()).filter(|e| !e.is_empty()));
}

fn link(folder: &Path, name: &str, to: &Path) {
    let place = folder.join(name);
    fs::create_dir_all(place.parent().unwrap()).unwrap();
    std::os::unix::fs::symlink(to, place).unwrap();
}

/// The smallest run that has all that a run has.
const TINY: &str = "description = \"four frames\"\ncases = [\"case1\"]\nseeds = [1]\nimage_width_px = 32\n\
                    frames_per_second = 2.0\nminimum_frames = 4\nminimum_breaths = 0.0\nsamples_per_pixel = 4\n\
                    iteration_scale = 0.05\n";

/// What the examples name: a film under all of its names, answers of one's own, reports.
fn furnish(folder: &Path) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    fs::write(folder.join("tiny.toml"), TINY).unwrap();
    // The examples that say no cache find the film in the usual one.
    let words = "all-cases --profile tiny.toml --cases case1 --methods pose-only --out reports";
    done(program(folder).args(words.split(' ')));
    let film = fs::read_dir(folder.join(".cache/sequences")).unwrap().next().unwrap().unwrap().path().join("film");
    for name in
        ["films/case1", "my/film", ".cache/sequences/case1-0123456789ab/film", "tmp/films/case1", "tmp/films/case2"]
    {
        link(folder, name, &film);
    }
    fs::create_dir_all(folder.join("my-method/case1/color")).unwrap();
    fs::create_dir_all(folder.join("mine")).unwrap();
    for picture in fs::read_dir(film.join("images")).unwrap().map(|entry| entry.unwrap().path()) {
        fs::copy(&picture, folder.join("my-method/case1/color").join(picture.file_name().unwrap())).unwrap();
    }
    for name in ["case1", "case2"] {
        let words = format!(
            "evaluate --sequence films/case1 --predictions my-method/case1 --method {name}-s --out mine/{name}"
        );
        done(program(folder).args(words.split(' ')));
    }
    let own = fs::read_to_string(root.join("bench-cases/case5.toml")).unwrap();
    fs::write(folder.join("mine/own.toml"), own.replacen("id = \"case5\"", "id = \"own\"", 1)).unwrap();
    link(folder, "reports/reference", &root.join("reports/reference"));
    link(folder, "reports/baselines", &root.join("reports/baselines"));
    // The gate writes its verdict beside the results.
    fs::create_dir_all(folder.join("target/smoke/latest")).unwrap();
    for name in ["results.csv", "run.json"] {
        fs::copy(root.join("reports/baselines/ideal").join(name), folder.join("target/smoke/latest").join(name))
            .unwrap();
    }
    link(folder, "bench-cases", &root.join("bench-cases"));
    link(folder, "mine/trees", &root.join("bench-cases/trees"));
    fs::copy(root.join("fuzz/corpus/gaussians/ascii"), folder.join("scene.ply")).unwrap();
    fs::copy(film.join("transforms.json"), folder.join("transforms.json")).unwrap();
}

#[test]
fn every_example_of_the_help_runs() {
    let mut examples = BTreeSet::new();
    collect(&[], &mut examples);
    assert!(examples.len() >= 30, "{examples:?}");
    let folder = tempfile::tempdir().unwrap();
    furnish(folder.path());
    let mut elsewhere = BTreeSet::new();
    for example in &examples {
        if let Some((begin, _)) = ELSEWHERE.iter().find(|(begin, _)| example.starts_with(begin)) {
            elsewhere.insert(*begin);
            continue;
        }
        let line = EXCHANGED.iter().fold(format!("\"$0\" {example}"), |line, (from, to)| line.replace(from, to));
        // What is redirected, or comes after, is the shell's.
        let line = [" > ", " && ", " # "].iter().fold(&line[..], |line, end| line.split(end).next().unwrap());
        done(Command::new("bash").current_dir(folder.path()).args(["-c", line, PROGRAM]));
    }
    assert_eq!(elsewhere.len(), ELSEWHERE.len(), "an example that is no longer there is excused");
}
