//! The program away from its checkout: cases and methods are inside it, libraries are found beside it.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::binary::{PROGRAM, outcome};

/// The program alone in a folder of its own, and an empty folder to start it from.
fn moved(folder: &Path) -> (PathBuf, PathBuf) {
    let (program, elsewhere) = (folder.join("program/respire-bench"), folder.join("elsewhere"));
    std::fs::create_dir_all(program.parent().unwrap()).unwrap();
    std::fs::create_dir(&elsewhere).unwrap();
    std::fs::copy(PROGRAM, &program).unwrap();
    (program, elsewhere)
}

#[test]
fn a_moved_program_knows_its_cases_and_films_one() {
    let folder = tempfile::tempdir().unwrap();
    let (program, elsewhere) = moved(folder.path());
    let run = |words: &[&str]| outcome(Command::new(&program).current_dir(&elsewhere).args(words).output().unwrap());
    for (words, says) in [
        (&["list"][..], "case9-oracle-phase-s1"),
        (&["doctor"], "nothing is missing"),
        (&["all-cases", "--dry-run", "--profile", "smoke"], ""),
        (
            &["simulate", "case1", "--profile", "smoke", "--frames", "2", "--width", "16", "--spp", "1", "--out", "f"],
            "",
        ),
    ] {
        let (code, out, err) = run(words);
        assert!(code == 0 && out.contains(says), "{words:?}: {err}{out}");
        // Two frames are too short for a breath.
        assert_eq!(err.contains("ends at the phase 0.00 and not at"), words[0] == "simulate", "{err}");
    }
    assert!(elsewhere.join("f/case1/manifest.json").exists());
    // The gate has its limits with it: the folder has no results, and that is all that is wrong.
    let (code, _, err) = run(&["gate", "--results", "f"]);
    assert!(code == 4 && err.contains("f/") && !err.contains("gate.toml"), "{err}");
}

/// A folder named `bench-cases` where the program is started changes nothing; one that is asked for replaces all.
#[test]
fn a_folder_of_cases_counts_when_it_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let (program, elsewhere) = moved(folder.path());
    let run = |words: &[&str]| outcome(Command::new(&program).current_dir(&elsewhere).args(words).output().unwrap());
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases");
    std::fs::create_dir_all(elsewhere.join("bench-cases/profiles")).unwrap();
    for file in ["case9.toml", "profiles/smoke.toml"] {
        std::fs::copy(shipped.join(file), elsewhere.join("bench-cases").join(file)).unwrap();
    }
    assert_eq!(run(&["list"]).1.lines().filter(|line| line.starts_with("  case1-")).count(), 14 + 15);
    let (code, _, err) = run(&["list", "--profile", "smoke", "--cases", "case9", "--bench-cases", "bench-cases"]);
    assert!(code == 4 && err.contains("bench-cases/methods"), "nothing is mixed in: {err}");
    let (code, _, err) = run(&["list", "--bench-cases", "no-such"]);
    assert!(code == 4 && err.contains("no-such: there is no such folder"), "{err}");
    // An own row's id over another method is said, before any work.
    std::fs::create_dir_all(elsewhere.join("own")).unwrap();
    for folder in ["methods", "profiles"] {
        std::fs::create_dir_all(elsewhere.join("own").join(folder)).unwrap();
        for file in std::fs::read_dir(shipped.join(folder)).unwrap() {
            let file = file.unwrap();
            std::fs::copy(file.path(), elsewhere.join("own").join(folder).join(file.file_name())).unwrap();
        }
    }
    let case = shipped.join("case9.toml");
    let plan = ["all-cases", "--profile", "smoke", "--methods", "pose-only,mean-breath", "--dry-run"];
    let words = [&plan[..], &["--bench-cases", "own", "--cases", case.to_str().unwrap()]].concat();
    let (code, _, err) = run(&words);
    assert!(code == 0 && !err.contains("differ"), "{err}");
    let other = "id = \"mean-breath\"\nkind = \"pose-only\"\nbase = \"pose-only\"\ndescription = \"another\"\n";
    std::fs::write(elsewhere.join("own/methods/mean-breath.toml"), other).unwrap();
    let (code, _, err) = run(&words);
    assert!(code == 0 && err.contains("method files that differ from those of this program: `mean-breath`."), "{err}");
    // Both ways give the same cells.
    let carried = run(&["list", "--json"]);
    let on_disk = run(&["list", "--json", "--bench-cases", shipped.to_str().unwrap()]);
    assert!(carried.0 == 0 && carried == on_disk, "{}{}", carried.2, on_disk.2);
}

#[test]
fn libraries_beside_the_program_come_first() {
    let folder = tempfile::tempdir().unwrap();
    let (program, _) = moved(folder.path());
    let embree = |program: &Path| {
        let (code, out, err) = outcome(Command::new("ldd").arg(program).output().unwrap());
        assert_eq!(code, 0, "{err}");
        let line = out.lines().find(|line| line.trim_start().starts_with("libembree4")).unwrap().to_owned();
        PathBuf::from(line.split_whitespace().nth(2).unwrap())
    };
    let found = embree(&program);
    for place in ["lib", "."] {
        let beside = program.parent().unwrap().join(place).join(found.file_name().unwrap());
        std::fs::create_dir_all(beside.parent().unwrap()).unwrap();
        std::fs::copy(&found, &beside).unwrap();
        assert_eq!(embree(&program).canonicalize().unwrap(), beside.canonicalize().unwrap());
    }
}
