//! Words in, words out: help, exit codes, one sentence for every mistake.

use std::io::Read;
use std::os::unix::fs::PermissionsExt;
use std::process::{Command, Stdio};

use crate::binary::{PROGRAM, program, run};

#[test]
fn help_and_version_are_no_errors_and_mistakes_are_usage() {
    for good in [vec!["--help"], vec!["--version"], vec!["help"], vec!["doctor", "--help"], vec!["all-cases", "--help"]]
    {
        let (code, out, err) = run(&good);
        assert_eq!(code, 0, "{good:?}: {err}");
        assert!(!out.is_empty() && err.is_empty(), "{good:?}");
    }
    let bad = [
        vec![],
        vec!["frobnicate"],
        vec!["doctor", "--no-such-option"],
        vec!["doctor", "surplus"],
        vec!["--threads", "many", "doctor"],
        vec!["all-cases", "--profile", "huge"],
        vec!["all-cases", "--cases", "case99"],
        vec!["all-cases", "--methods", "magic"],
        vec!["all-cases", "--cases", "case1,case1"],
        vec!["all-cases", "--seeds", "1,x"],
        vec!["all-cases", "--track", "lunar"],
        vec!["run", "--case", "case1"],
        // Their films would lie in one folder.
        vec!["simulate", "case3", "case3", "--out", "films"],
        vec!["light-bias", "--places", "0.5,0.2,0.5"],
        vec!["run", "--case", "case1", "--method", "ours", "--track", "both"],
        // The film says of which track it is.
        vec!["run", "--sequence", "film", "--out", "answer", "--method", "ours", "--track", "clinical"],
    ];
    for words in bad {
        let (code, out, err) = run(&words);
        assert_eq!((code, out.as_str()), (2, ""), "{words:?}: {err}");
        assert!(!err.is_empty(), "{words:?} says nothing");
    }
}

#[test]
fn a_list_has_the_cells_of_every_track_of_its_profile() {
    let cells = |extra: &[&str]| {
        let (code, out, err) = run(&[&["list", "--json", "--profile", "quick", "--cases", "case1"], extra].concat());
        assert_eq!(code, 0, "{err}");
        let all: serde_json::Value = serde_json::from_str(&out).unwrap();
        let of = |track: &str| all["cells"].as_array().unwrap().iter().filter(|cell| cell["track"] == track).count();
        (of("ideal"), of("clinical"))
    };
    let (ideal, clinical) = cells(&[]);
    assert!(ideal > 0 && clinical > 0);
    assert_eq!(cells(&["--track", "clinical"]), (0, clinical));
}

#[test]
fn threads_of_the_environment_have_the_same_limits() {
    let output = program().env("RAYON_NUM_THREADS", "70000").arg("doctor").output().unwrap();
    let err = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{err}");
    assert!(err.contains("RAYON_NUM_THREADS: 70000 must lie in 0 to 512"), "{err}");
}

#[test]
fn doctor_tells_versions_to_people_and_to_machines() {
    let (code, out, err) = run(&["doctor"]);
    assert_eq!(code, 0, "{err}");
    for word in ["Embree", "OpenCV", "avx2", "cores", "nothing is missing"] {
        assert!(out.contains(word), "no {word} in\n{out}");
    }
    let (_, json, _) = run(&["doctor", "--json"]);
    let found: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert!(found["embree_runtime"].as_str().unwrap().starts_with("4."));
    assert!(found["opencv"].as_str().unwrap().starts_with('4'));
    assert!(found["cores"].as_u64().unwrap() > 0);
    assert_eq!(found["missing"].as_array().unwrap().len(), 0);
}

#[test]
fn a_reader_that_goes_away_is_no_error() {
    for words in [["doctor"].as_slice(), &["doctor", "--json"], &["--help"], &["list"]] {
        let mut child = program().args(words).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        let mut said = String::new();
        child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        assert!(child.wait().unwrap().success(), "{words:?}: {said}");
        assert!(!said.contains("panicked"), "{said}");
    }
}

#[test]
fn a_log_on_a_full_disk_changes_no_exit_code() {
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let status = program().args(["gate", "--results", "/nowhere"]).stderr(full).status().unwrap();
    assert_eq!(status.code(), Some(4));
}

/// A log may be lost; what was asked for may not.
#[test]
fn output_on_a_full_disk_is_an_error() {
    for arguments in [&["list", "--json"][..], &["explain", "psnr_db"]] {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let done = program().args(arguments).stdout(full).output().unwrap();
        let said = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.code() == Some(4) && said.contains("standard output: writing failed"), "{said}");
    }
}

#[test]
fn list_has_the_keys_that_scripts_rely_on() {
    let (code, out, err) = run(&["list", "--json"]);
    assert_eq!(code, 0, "{err}");
    let listed: serde_json::Value = serde_json::from_str(&out).unwrap();
    let entries = |key: &str| listed[key].as_array().unwrap().clone();
    assert_eq!((entries("cases").len(), entries("methods").len(), entries("cells").len()), (9, 15, 261));
    for key in ["cases", "methods", "metrics", "cells"] {
        assert!(entries(key).iter().all(|entry| !entry["id"].as_str().unwrap().is_empty()), "{key}");
    }
    for metric in entries("metrics") {
        assert!(["higher", "lower"].contains(&metric["direction"].as_str().unwrap()), "{metric}");
        assert!(metric["unit"].is_string() && !metric["definition"].as_str().unwrap().is_empty(), "{metric}");
    }
    let first = ["bridgesplat", "bridgesplat-release", "bridgesplat-nomesh", "ours-nomesh", "ours"];
    let methods: Vec<String> = entries("methods").iter().map(|m| m["id"].as_str().unwrap().to_owned()).collect();
    assert_eq!(methods[..5], first);
}

#[test]
fn one_cell_runs_alone_and_says_where_its_files_are() {
    let folder = tempfile::tempdir().unwrap();
    let profile = folder.path().join("tiny.toml");
    std::fs::write(&profile, crate::all_cases::TINY).unwrap();
    let (profile, cache) = (profile.to_str().unwrap(), folder.path().join("cache"));
    let words =
        ["run", "--case", "case1", "--method", "static-ct", "--profile", profile, "--cache", cache.to_str().unwrap()];
    let (code, out, err) = run(&words);
    assert_eq!(code, 0, "{err}");
    assert!(out.contains("psnr_db") && out.contains("prediction: "), "{out}");
    let (_, json, _) = run(&[&words[..], &["--json"]].concat());
    let score: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert!(score.is_object(), "{json}");
}

/// Bash itself says what it would complete: a command, an option of a command, a value.
#[test]
fn bash_completes_commands_options_and_values() {
    let (code, script, err) = run(&["completions", "bash"]);
    assert_eq!(code, 0, "{err}");
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("respire-bench");
    std::fs::write(&file, script).unwrap();
    let asked = "source \"$1\"; shift; function=$(complete -p respire-bench | sed 's/.*-F \\([^ ]*\\).*/\\1/')\n\
        COMP_WORDS=(\"$@\") COMP_CWORD=$(($# - 1)); \"$function\" respire-bench \"${@: -1}\" \"${@: -2:1}\"\n\
        echo \"${COMPREPLY[@]}\"";
    for (words, wanted) in [
        (&["respire-bench", "sim"][..], "simulate simulate-ct"),
        (&["respire-bench", "gate", "--ba"], "--baseline"),
        (&["respire-bench", "import", "mesh-"], "mesh-pair"),
        (&["respire-bench", "splat", "--isa", "avx"], "avx2 avx512"),
    ] {
        let mut bash = Command::new("bash");
        let output = bash.args(["-c", asked, "-"]).arg(&file).args(words).output().unwrap();
        let said = String::from_utf8(output.stdout).unwrap();
        assert_eq!(said.trim(), wanted, "{words:?}: {}", String::from_utf8_lossy(&output.stderr));
    }
    for (shell, word) in [("zsh", "#compdef respire-bench"), ("fish", "complete -c respire-bench")] {
        let (code, script, err) = run(&["completions", shell]);
        assert!(code == 0 && script.contains(word), "{err}");
    }
}

/// Imports of scans are of patients: who keeps others out keeps them out of results, too.
#[test]
fn files_are_for_whom_the_users_mask_lets_in() {
    for (mask, mode) in [("077", 0o600), ("022", 0o644), ("002", 0o664)] {
        let folder = tempfile::tempdir().unwrap();
        let mut shell = Command::new("sh");
        shell.args(["-c", "umask $1; exec \"$2\" man --out \"$3\"", "-", mask, PROGRAM]);
        assert!(shell.arg(folder.path()).status().unwrap().success());
        let page = std::fs::metadata(folder.path().join("respire-bench.1")).unwrap();
        assert_eq!(page.permissions().mode() & 0o777, mode, "umask {mask}");
    }
}

#[test]
fn every_command_has_a_manual_page() {
    let folder = tempfile::tempdir().unwrap();
    let (code, _, err) = run(&["man", "--out", folder.path().to_str().unwrap()]);
    assert_eq!(code, 0, "{err}");
    let page = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap();
    let (_, help, _) = run(&["simulate", "--help"]);
    // Hyphens are escaped in pages.
    let simulate = page("respire-bench-simulate.1").replace("\\-", "-");
    for option in help.split_whitespace().filter(|word| word.starts_with("--") && word.len() > 2) {
        let option = option.trim_end_matches([',', '.']);
        assert!(simulate.contains(option), "{option} is missing in\n{simulate}");
    }
    assert!(page("respire-bench.1").contains("130 interrupted"));
    assert!(page("respire-bench-import-mesh-pair.1").starts_with(".ie"), "a page of a command of a command");
}
