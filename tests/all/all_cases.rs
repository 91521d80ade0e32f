//! The main job as a user sees it: exit codes, resuming after a kill, the same bytes however it was run.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use respire_bench::bench::store::MARKER;

use crate::binary::{interrupt, outcome, program};
use crate::skip::skip;

/// Smaller than `smoke`: the tests run it several times.
pub const TINY: &str = r#"
description = "as small as it gets"
cases = ["case1"]
methods = ["static-ct", "oracle-phase", "ours"]
seeds = [1]
image_width_px = 32
frames_per_second = 2.0
minimum_frames = 3
minimum_breaths = 0.0
samples_per_pixel = 1
iteration_scale = 0.05
light = "draft"
"#;

/// A folder of its own, with the tiny profile in it.
struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("tiny.toml"), TINY).unwrap();
        Place(folder)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn command(&self, extra: &[&str]) -> Command {
        self.command_with_cache(&self.path("cache"), extra)
    }

    fn command_with_cache(&self, cache: &Path, extra: &[&str]) -> Command {
        let mut command = program();
        command.arg("all-cases").arg("--profile").arg(self.path("tiny.toml"));
        command.arg("--out").arg(self.path("reports")).arg("--cache").arg(cache).args(extra);
        command
    }

    /// Runs to the end and must succeed.
    fn run(&self, extra: &[&str]) -> String {
        let (code, out, err) = outcome(self.command(extra).output().unwrap());
        assert_eq!(code, 0, "{err}");
        assert!(out.contains("report: "), "{out}");
        err
    }

    fn start(&self) -> Child {
        self.command(&[]).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
    }

    fn latest(&self, name: &str) -> Vec<u8> {
        fs::read(self.path("reports/latest").join(name)).unwrap()
    }

    /// How many files there are by now, finished or not.
    fn files(&self) -> usize {
        count_files(&self.path(""))
    }

    /// Every file of the cache by name, but for what tells times.
    fn products(&self) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut found = BTreeMap::new();
        collect(&self.path("cache"), &self.path("cache"), &mut found);
        let untimed = |path: &Path| {
            let name = path.file_name().unwrap().to_string_lossy();
            let told = name.ends_with("timing.json") || name == "score.json";
            !told && name != MARKER
        };
        found.retain(|path, _| untimed(path));
        found
    }
}

/// Of a folder that somebody else is working in: what is gone when it is looked at does not count.
fn count_files(folder: &Path) -> usize {
    let Ok(entries) = fs::read_dir(folder) else { return 0 };
    let count = |path: PathBuf| if path.is_dir() { count_files(&path) } else { 1 };
    entries.flatten().map(|entry| count(entry.path())).sum()
}

fn collect(root: &Path, folder: &Path, found: &mut BTreeMap<PathBuf, Vec<u8>>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            collect(root, &path, found);
        } else {
            found.insert(path.strip_prefix(root).unwrap().to_path_buf(), fs::read(&path).unwrap());
        }
    }
}

#[test]
fn the_same_bytes_on_one_thread_on_two_and_after_kills() {
    let two = Place::new();
    two.run(&["--threads", "2"]);
    let (results, products) = (two.latest("results.csv"), two.products());
    assert!(results.len() > 500 && products.len() > 15);

    let one = Place::new();
    one.run(&["--threads", "1"]);
    assert!(one.latest("results.csv") == results, "results.csv differs between one thread and two");
    assert_same(&one.products(), &products);

    // Killed over and over, whenever it has written some more files, until it gets through.
    let killed = Place::new();
    let mut kills = 0;
    loop {
        let (before, mut child) = (killed.files(), killed.start());
        let status = loop {
            match child.try_wait().unwrap() {
                None if killed.files() < before + 3 => std::thread::sleep(Duration::from_millis(1)),
                status => break status,
            }
        };
        if let Some(status) = status {
            assert!(status.success());
            break;
        }
        child.kill().unwrap();
        child.wait().unwrap();
        kills += 1;
    }
    assert!(kills >= 4, "the run was over after {kills} kills");
    assert!(killed.latest("results.csv") == results, "results.csv differs after {kills} kills");
    assert_same(&killed.products(), &products);

    // Everything is there: nothing is made again, and the answer is the same.
    let err = killed.run(&[]);
    assert!(err.contains("film is cached") && err.contains("[1/3] case1-ours-s1: cached"), "{err}");
    assert!(killed.latest("results.csv") == results);

    // A failing disk changes neither size nor time of a file. A score is read before it counts; a picture by the report,
    // which stops, and the next run makes it again.
    let rot = |name: &str| {
        let mut found = BTreeMap::new();
        collect(&killed.path("cache"), &killed.path("cache"), &mut found);
        let (file, mut bytes) = found.into_iter().find(|(path, _)| path.to_string_lossy().contains(name)).unwrap();
        let file = killed.path("cache").join(file);
        let written = file.metadata().unwrap().modified().unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        fs::write(&file, bytes).unwrap();
        fs::File::open(&file).unwrap().set_modified(written).unwrap();
    };
    rot("score/score.json");
    let err = killed.run(&[]);
    assert!(err.contains("its files are not what they were") && killed.latest("results.csv") == results, "{err}");
    rot("film/images/000000.png");
    // Who only reads removes nothing.
    let (code, _, err) = outcome(killed.command(&["--report-only"]).output().unwrap());
    assert!(code == 4 && err.contains("/film: was damaged in the cache: the same command without"), "{code} {err}");
    let (code, _, err) = outcome(killed.command(&[]).output().unwrap());
    assert!(code == 4 && err.contains("/film: was damaged in the cache and is removed now"), "{code} {err}");
    let err = killed.run(&[]);
    assert!(err.contains("[1/3] case1-ours-s1: cached") && killed.latest("results.csv") == results, "{err}");
    assert_same(&killed.products(), &products);
}

/// Who starts a long run by `nohup` and logs out wants it to go on.
#[test]
fn a_run_under_nohup_outlives_its_terminal() {
    let place = Place::new();
    let real = place.command(&["--methods", "static-ct"]);
    let mut shell = Command::new("sh");
    shell.args(["-c", "trap '' HUP; exec \"$0\" \"$@\""]).arg(real.get_program()).args(real.get_args());
    shell.envs(real.get_envs().filter_map(|(name, value)| Some((name, value?))));
    let mut child = shell.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    while !place.path("cache").exists() && child.try_wait().unwrap().is_none() {
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(Command::new("kill").arg("-HUP").arg(child.id().to_string()).status().unwrap().success());
    assert!(child.wait().unwrap().success());
    assert!(!place.latest("results.csv").is_empty());
}

fn assert_same(a: &BTreeMap<PathBuf, Vec<u8>>, b: &BTreeMap<PathBuf, Vec<u8>>) {
    let names = |x: &BTreeMap<PathBuf, Vec<u8>>| x.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(a), names(b));
    for (path, bytes) in a {
        assert!(bytes == &b[path], "{} differs", path.display());
    }
}

#[test]
fn one_cell_as_json_names_its_method() {
    let place = Place::new();
    let mut command = program();
    command
        .args(["run", "--case", "case1", "--method", "static-ct", "--json", "--profile"])
        .arg(place.path("tiny.toml"));
    let (code, out, err) = outcome(command.arg("--cache").arg(place.path("cache")).output().unwrap());
    assert_eq!(code, 0, "{err}");
    let score: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!(score["method"], "static-ct", "{out}");
}

#[test]
fn a_dry_run_touches_nothing() {
    let place = Place::new();
    let (code, out, err) = outcome(place.command(&["--dry-run"]).output().unwrap());
    assert_eq!(code, 0, "{err}");
    assert!(out.contains("to do   film case1") && out.contains("to do   cell case1-ours-s1"), "{out}");
    assert_eq!(fs::read_dir(place.path("")).unwrap().count(), 1);
}

#[test]
fn folders_that_cannot_be_used_are_refused_before_any_work() {
    let place = Place::new();
    fs::write(place.path("reports"), "a file where a folder should be").unwrap();
    let (code, out, err) = outcome(place.command(&[]).output().unwrap());
    assert_eq!((code, out.as_str()), (4, ""), "{err}");
    assert!(err.contains("reports") && err.lines().count() == 1, "{err}");
    fs::remove_file(place.path("reports")).unwrap();

    // As a copy of reports leaves it that resolved the link.
    fs::create_dir_all(place.path("reports/latest")).unwrap();
    let (code, _, err) = outcome(place.command(&[]).output().unwrap());
    assert_eq!(code, 4, "{err}");
    assert!(err.contains("reports/latest: is no link") && err.lines().count() == 1, "{err}");
    fs::remove_dir_all(place.path("reports")).unwrap();

    let (code, _, err) = outcome(place.command_with_cache(Path::new("/proc/nowhere"), &[]).output().unwrap());
    assert_eq!(code, 4, "{err}");
    assert!(err.contains("/proc/nowhere") && err.lines().count() == 1, "{err}");
}

#[test]
fn runs_beside_each_other_share_the_work_and_end_with_the_same_bytes() {
    let alone = Place::new();
    alone.run(&[]);
    let shared = Place::new();
    let start = || shared.command(&["--threads", "1"]).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let runs: Vec<Child> = (0..3).map(|_| start()).collect();
    let mut made = 0;
    for run in runs {
        let (code, _, err) = outcome(run.wait_with_output().unwrap());
        assert_eq!(code, 0, "{err}");
        made += err.lines().filter(|line| line.contains("filmed in")).count();
    }
    assert_eq!(made, 1, "one of them films, the others wait");
    assert!(shared.latest("results.csv") == alone.latest("results.csv"));
    assert_same(&shared.products(), &alone.products());
}

#[test]
fn broken_input_is_one_sentence_that_names_file_and_key() {
    let place = Place::new();
    let profile = place.path("tiny.toml");
    let broken = [
        (TINY.replace("seeds = [1]", "seeds = []"), "seeds"),
        (TINY.replace("seeds = [1]", "seeds = [1"), "line"),
        (TINY.replace("minimum_frames", "minimal_frames"), "minimal_frames"),
        (TINY.replace("= 0.05", "= nan"), "iteration_scale"),
        (TINY.replace("= 32", "= -32"), "image_width_px"),
    ];
    for (text, word) in broken {
        fs::write(&profile, text).unwrap();
        let (code, out, err) = outcome(place.command(&[]).output().unwrap());
        assert_eq!((code, out.as_str()), (4, ""), "{err}");
        assert!(err.contains("tiny.toml") && err.contains(word), "no {word} in: {err}");
        assert_eq!(err.lines().count(), 1, "{err}");
    }
    assert_eq!(fs::read_dir(place.path("")).unwrap().count(), 1, "nothing is written for broken input");
}

/// Waits for the finished film, so that the interruption comes in the midst of work.
fn wait_for_film(place: &Place) {
    let deadline = Instant::now() + Duration::from_secs(120);
    let finished = |film: fs::DirEntry| film.path().join("film").join(MARKER).exists();
    while !fs::read_dir(place.path("cache/sequences")).is_ok_and(|mut films| films.any(|f| f.is_ok_and(finished))) {
        assert!(Instant::now() < deadline, "nothing was finished in two minutes");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn an_interrupt_stops_in_order_and_the_same_command_resumes() {
    let place = Place::new();
    let child = place.command(&[]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    wait_for_film(&place);
    interrupt(&child.id().to_string());
    let (code, out, err) = outcome(child.wait_with_output().unwrap());
    assert_eq!((code, out.as_str()), (130, ""), "{err}");
    assert!(err.contains("the same command resumes"), "{err}");
    let err = place.run(&[]);
    assert!(err.contains("film is cached"), "{err}");
}

/// Runs twice in a mount namespace of its own: with a cache too small for the work, then, after it has grown, again.
const SMALL_DISK: &str = r#"
cache=$1; shift
mount -t tmpfs -o size=60k tmpfs "$cache" || exit 99
"$@"; echo "first $?"
mount -o remount,size=200m "$cache" || exit 99
"$@"; echo "second $?"
"#;

#[test]
fn a_full_disk_is_one_sentence_and_nothing_is_lost() {
    let place = Place::new();
    fs::create_dir(place.path("cache")).unwrap();
    let mut command = Command::new("unshare");
    command.args(["--user", "--map-root-user", "--mount", "sh", "-c", SMALL_DISK, "sh"]).arg(place.path("cache"));
    let run = place.command(&[]);
    command.arg(run.get_program()).args(run.get_args()).current_dir(env!("CARGO_MANIFEST_DIR"));
    let answer = command.output();
    let Some((code, out, err)) = answer.ok().map(outcome).filter(|(code, _, _)| *code == 0) else {
        skip("small-disk", "this system lets nobody mount a small disk of his own");
        return;
    };
    let sentences: Vec<&str> = err.lines().filter(|line| line.starts_with("error:")).collect();
    assert_eq!((code, sentences.len()), (0, 1), "{err}");
    assert!(sentences[0].contains("cache/") && sentences[0].contains("No space left"), "{err}");
    assert!(out.starts_with("first 4\n") && out.ends_with("second 0\n"), "{out}");

    let whole = Place::new();
    whole.run(&[]);
    assert!(place.latest("results.csv") == whole.latest("results.csv"));
}

/// A cluster may limit the size of files; the system then ends who writes more, unless he has asked for an error.
#[test]
fn a_limit_of_file_sizes_is_one_sentence_and_nothing_is_lost() {
    let place = Place::new();
    let run = place.command(&["--methods", "pose-only"]);
    let mut limited = Command::new("sh");
    limited.args(["-c", "ulimit -f 8; exec \"$@\"", "sh"]).arg(run.get_program()).args(run.get_args());
    let (code, _, err) = outcome(limited.current_dir(env!("CARGO_MANIFEST_DIR")).output().unwrap());
    let sentences: Vec<&str> = err.lines().filter(|line| line.starts_with("error:")).collect();
    assert_eq!((code, sentences.len()), (4, 1), "{err}");
    assert!(sentences[0].contains("cache/") && sentences[0].contains("File too large"), "{err}");
    place.run(&["--methods", "pose-only"]);
}

/// What the profile asks for: both tracks, each with a whole report, the same as alone; one page; and what reads a report
/// takes it or says which ones there are.
#[test]
fn both_tracks_lie_side_by_side() {
    let place = Place::new();
    let alone = place.run(&["--track", "ideal", "--methods", "pose-only"]);
    let ideal = place.latest("results.csv");
    fs::write(place.path("tiny.toml"), format!("tracks = [\"ideal\", \"clinical\"]{TINY}")).unwrap();
    place.run(&["--methods", "pose-only"]);
    assert!(place.latest("ideal/results.csv") == ideal, "{alone}");
    assert_eq!(String::from_utf8(place.latest("report.html")).unwrap().matches("<section class=\"track\"").count(), 2);
    for name in ["run.json", "environment.json", "manifest.json", "report.html", "report.md"] {
        assert!(
            !place.latest(&format!("ideal/{name}")).is_empty() && !place.latest(&format!("clinical/{name}")).is_empty()
        );
    }
    assert!(String::from_utf8(place.latest("clinical/report.md")).unwrap().contains("track `clinical`"));
    let latest = place.path("reports/latest");
    let on_latest = |words: &[&str]| outcome(program().args(words).current_dir(place.path("")).output().unwrap());
    let (code, _, err) = on_latest(&["gate", "--results", latest.to_str().unwrap()]);
    assert!(code == 4 && err.contains("holds a report for each track") && err.contains("latest/ideal"), "{code} {err}");
    let (code, out, err) = on_latest(&["merge", latest.to_str().unwrap(), "--out", "merged"]);
    assert!(code == 0 && out.contains("track clinical"), "{err}");
    assert!(place.path("merged/ideal/results.csv").exists() && place.path("merged/clinical/results.csv").exists());
    // One is asked for: its report is where it always was.
    place.run(&["--track", "clinical", "--methods", "pose-only"]);
    assert!(!place.latest("results.csv").is_empty());
}

/// The scripts for Slurm, here without it: each task by its number, then the report. They make what the profile asks for.
#[test]
fn a_job_array_makes_both_tracks_as_the_main_job_does() {
    let place = Place::new();
    fs::write(place.path("tiny.toml"), format!("tracks = [\"ideal\", \"clinical\"]{TINY}")).unwrap();
    let write_scripts = || {
        let mut slurm = program();
        slurm.args(["slurm", "--array", "--methods", "pose-only", "--processors", "1", "--profile"]);
        slurm.arg(place.path("tiny.toml")).arg("--scripts").arg(place.path("scripts"));
        slurm.arg("--out").arg(place.path("array")).arg("--cache").arg(place.path("other cache"));
        outcome(slurm.output().unwrap())
    };
    let bash = |script: &str, task: &str| {
        let mut bash = Command::new("bash");
        bash.arg(place.path("scripts").join(script)).env("SLURM_ARRAY_TASK_ID", task).current_dir(place.path(""));
        let (code, _, err) = outcome(bash.output().unwrap());
        assert_eq!(code, 0, "{script} {task}: {err}");
    };
    let (code, out, err) = write_scripts();
    assert!(code == 0 && out.contains("2 of 2 cells to do in 2 tasks"), "{out} {err}");
    bash("task.sh", "1");
    assert!(write_scripts().1.contains("1 of 2 cells to do in 1 tasks"));
    bash("task.sh", "1");
    bash("report.sh", "");
    place.run(&["--methods", "pose-only"]);
    for name in ["ideal/results.csv", "clinical/results.csv"] {
        assert!(fs::read(place.path("array/latest").join(name)).unwrap() == place.latest(name), "{name}");
    }
    assert!(write_scripts().1.contains("every cell is finished"));

    // A comma parts cases; and a profile's list, which may be longer than a command line, stays in the profile.
    assert!(!fs::read_to_string(place.path("scripts").join("report.sh")).unwrap().contains("--cases"));
    fs::create_dir(place.path("a,b")).unwrap();
    let mut slurm = program();
    slurm.args(["slurm", "--cases", "own.toml", "--scripts", "s", "--out", "o", "--cache", "c"]);
    let (code, _, err) = outcome(slurm.current_dir(place.path("a,b")).output().unwrap());
    assert!(code == 2 && err.contains("a,b/own.toml: a case file with a comma"), "{code} {err}");
}
