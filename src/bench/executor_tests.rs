//! The executor with stages that write a line each: what is made, what is kept, what stops a run.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::*;
use crate::base::{Progress, files};
use crate::bench::plan::tests::small_plan;

/// Stages that write what they were given; a fault can be planted at the n-th call.
#[derive(Default)]
struct Fake {
    calls: AtomicUsize,
    log: Mutex<Vec<String>>,
    fault: Option<(usize, Fault)>,
    /// How long a stage takes.
    pause: Duration,
}

#[derive(Clone, Copy)]
enum Fault {
    Cell,
    Panic,
    Disk,
    Content,
    Interrupt,
}

impl Fake {
    fn with_fault(call: usize, fault: Fault) -> Self {
        Fake { fault: Some((call, fault)), ..Fake::default() }
    }

    fn call(&self, what: String, target: &Path) -> Result<()> {
        let number = self.calls.fetch_add(1, Ordering::SeqCst);
        self.log.lock().unwrap().push(what);
        std::thread::sleep(self.pause);
        match self.fault {
            Some((n, fault)) if n == number => match fault {
                Fault::Cell => Err(Error::new(ErrorKind::CellFailed, "planted")),
                Fault::Panic => panic!("planted panic"),
                Fault::Disk => Err(Error::io("writing", target, std::io::Error::other("No space left on device"))),
                Fault::Content => Err(Error::input("is not what it should be").at(target)),
                Fault::Interrupt => Err(Error::interrupted()),
            },
            _ => Ok(()),
        }
    }

    fn log(&self) -> Vec<String> {
        std::mem::take(&mut self.log.lock().unwrap())
    }
}

impl Stages for Fake {
    fn film(&self, case_id: &str, folder: &Path, _: &dyn Progress) -> Result<()> {
        files::write_bytes(&folder.join("first"), case_id.as_bytes())?;
        self.call(format!("film {case_id}"), &folder.join("second"))?;
        files::write_bytes(&folder.join("second"), case_id.as_bytes())
    }

    fn reconstruct(&self, cell: &Cell, sequence: &Path, prediction: &Path, _: &dyn Progress) -> Result<()> {
        // A method that sees what a failing disk did to the film, and others that need it once more at their end.
        let path = sequence.join("second");
        let seen = files::read_text(&path)?;
        if cell.method == "ours" && !seen.starts_with("case") {
            return Err(Error::input("is not the file that was filmed").at(path));
        }
        files::write_bytes(&prediction.join("color/000000.png"), seen.as_bytes())?;
        self.call(format!("reconstruct {}", cell.id()), &prediction.join("phase.csv"))?;
        files::read_text(&sequence.join("first"))?;
        files::write_bytes(&prediction.join("phase.csv"), cell.id().as_bytes())
    }

    fn score(&self, cell: &Cell, _: &Path, prediction: &Path, score: &Path) -> Result<()> {
        let phase = files::read_text(&prediction.join("phase.csv"))?;
        self.call(format!("score {}", cell.id()), score)?;
        files::write_bytes(score, format!("score of {phase}").as_bytes())
    }
}

/// Remembers the names of the events.
#[derive(Default)]
struct Events(Mutex<Vec<String>>);

impl Progress for Events {
    fn advance(&self, _: usize, _: usize) {}
    fn cancelled(&self) -> bool {
        false
    }
}

impl Watcher for Events {
    fn event(&self, event: &Event<'_>) {
        self.0.lock().unwrap().push(match event {
            Event::Discarded { reason, .. } => format!("discarded: {reason}"),
            Event::CellFailed { cell, error } => format!("{} failed: {error}", cell.id()),
            Event::Waiting { cell, .. } => format!("waits for {}", cell.id()),
            Event::CellFinished { cell, cache_use, done, total, .. } => {
                format!("{} {cache_use:?} {done}/{total}", cell.id())
            }
            _ => return,
        });
    }
}

fn run(root: &Path, plan: &Plan, fake: &Fake, freshness: Freshness) -> (Result<Vec<FinishedCell>>, Vec<String>) {
    let events = Events::default();
    let store = Store::open(root).unwrap();
    let outcome = execute(plan, fake, &store, freshness, &events);
    (outcome, events.0.into_inner().unwrap())
}

/// Scores of all cells, and the names of all files, as the user would see them.
fn picture(root: &Path, cells: &[FinishedCell]) -> (Vec<String>, Vec<String>) {
    let scores = cells.iter().map(|c| files::read_text(&c.score).unwrap_or_default()).collect();
    let mut stack = vec![root.to_path_buf()];
    let mut names = Vec::new();
    while let Some(folder) = stack.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                stack.push(path)
            } else {
                names.push(path.strip_prefix(root).unwrap().display().to_string())
            }
        }
    }
    names.sort();
    (scores, names)
}

#[test]
fn a_second_run_does_nothing_and_a_fresh_one_everything() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, fake) = (small_plan(), Fake::default());
    let (cells, _) = run(folder.path(), &plan, &fake, Freshness::Resume);
    let cells = cells.unwrap();
    assert_eq!(fake.log().len(), 2 + 8 + 8);
    assert_eq!(cells.len(), 8);
    assert!(cells.iter().all(|c| c.failure.is_none() && c.timings.len() == 3 && c.is_timed()));

    let (again, events) = run(folder.path(), &plan, &fake, Freshness::Resume);
    assert_eq!(fake.log(), [""; 0]);
    assert_eq!(events[7], "case2-static-ct-s2 Cached 8/8");
    assert_eq!(picture(folder.path(), &again.unwrap()), picture(folder.path(), &cells));

    run(folder.path(), &plan, &fake, Freshness::Fresh).0.unwrap();
    assert_eq!(fake.log().len(), 18);
}

/// Whatever a clock says, and whatever an ended process had begun.
#[test]
fn a_fresh_run_takes_nothing_of_before() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, fake) = (small_plan(), Fake::default());
    let cells = run(folder.path(), &plan, &fake, Freshness::Resume).0.unwrap();
    let tomorrow = std::time::SystemTime::now() + Duration::from_secs(86_400);
    for marked in cells.iter().flat_map(|c| [&c.prediction, &c.sequence]) {
        let marker = std::fs::File::options().append(true).open(marked.join(".finished.json")).unwrap();
        marker.set_modified(tomorrow).unwrap();
    }
    fake.log();
    run(folder.path(), &plan, &fake, Freshness::Fresh).0.unwrap();
    assert_eq!(fake.log().len(), 18);
}

/// What the report needs beside scores is looked at where nothing is made, too.
#[test]
fn what_is_not_whole_is_not_finished() {
    let whole = tempfile::tempdir().unwrap();
    let (plan, fake) = (small_plan(), Fake::default());
    let cells = run(whole.path(), &plan, &fake, Freshness::Resume).0.unwrap();
    let store = Store::look(whole.path());
    let unfinished = || finished(&plan, &store).unwrap().iter().filter(|cell| cell.failure.is_some()).count();
    assert_eq!(unfinished(), 0);
    std::fs::remove_dir_all(&cells[3].prediction).unwrap();
    assert_eq!(unfinished(), 1);
    // A link that leads nowhere is damage, in the way of what is made in its place.
    std::fs::remove_dir_all(&cells[0].sequence).unwrap();
    std::os::unix::fs::symlink("/nowhere/film", &cells[0].sequence).unwrap();
    assert_eq!(unfinished(), 4);
    // No result depends on times.
    std::fs::write(cells[6].prediction.with_file_name("timing.json"), "{").unwrap();
    run(whole.path(), &plan, &fake, Freshness::Resume).0.unwrap();
    assert_eq!(unfinished(), 0);
}

#[test]
fn only_what_changed_is_made_again() {
    let folder = tempfile::tempdir().unwrap();
    let (mut plan, fake) = (small_plan(), Fake::default());
    run(folder.path(), &plan, &fake, Freshness::Resume).0.unwrap();
    fake.log();

    plan.revisions.score.push('x');
    let (_, events) = run(folder.path(), &plan, &fake, Freshness::Resume);
    assert!(fake.log().iter().all(|c| c.starts_with("score")), "a new metric needs no new reconstruction");
    assert!(events[0].starts_with("discarded: it was made by another version"), "{events:?}");

    plan.methods[0].content.push('x');
    run(folder.path(), &plan, &fake, Freshness::Resume).0.unwrap();
    let log = fake.log();
    assert_eq!(log.len(), 8);
    assert!(log.iter().all(|call| call.contains("ours")), "{log:?}");
}

#[test]
fn damage_is_noticed_and_mended() {
    let folder = tempfile::tempdir().unwrap();
    let (plan, fake) = (small_plan(), Fake::default());
    let cells = run(folder.path(), &plan, &fake, Freshness::Resume).0.unwrap();
    let before = picture(folder.path(), &cells);
    fake.log();
    std::fs::write(cells[2].prediction.join("phase.csv"), "rubbish").unwrap();
    std::fs::remove_file(cells[5].sequence.join("first")).unwrap();
    let (cells, events) = run(folder.path(), &plan, &fake, Freshness::Resume);
    assert_eq!(fake.log(), ["reconstruct case1-static-ct-s1", "score case1-static-ct-s1", "film case2"]);
    assert_eq!(events.iter().filter(|e| e.contains("not what they were")).count(), 2);
    assert_eq!(picture(folder.path(), &cells.unwrap()), before);
}

/// Cells that read a film while another one finds it damaged, and has it removed and made again.
#[test]
fn a_film_that_is_made_again_under_its_readers_costs_none_of_them() {
    let whole = tempfile::tempdir().unwrap();
    let plan = small_plan();
    run(whole.path(), &plan, &Fake::default(), Freshness::Resume).0.unwrap();
    for (lanes, processes) in [(1, 1), (2, 1), (4, 1), (1, 2), (1, 3)] {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let cells = run(root, &plan, &Fake::default(), Freshness::Resume).0.unwrap();
        std::fs::remove_dir_all(root.join("cells")).unwrap();
        // A failing disk changes neither size nor time.
        let rotten = cells[0].sequence.join("second");
        let written = rotten.metadata().unwrap().modified().unwrap();
        std::fs::write(&rotten, "Case1").unwrap();
        std::fs::File::open(&rotten).unwrap().set_modified(written).unwrap();
        let fake = Fake { pause: Duration::from_millis(20), ..Fake::default() };
        let store = Store::open(root).unwrap();
        let one = || execute_at_once(&plan, &fake, &store, lanes, &Events::default()).unwrap();
        std::thread::scope(|scope| {
            for run in (0..processes).map(|_| scope.spawn(one)).collect::<Vec<_>>() {
                let cells = run.join().unwrap();
                let failed: Vec<_> = cells.iter().filter_map(|cell| cell.failure.as_ref()).collect();
                assert!(failed.is_empty(), "{lanes} lanes, {processes} processes: {failed:?}");
            }
        });
        assert_eq!(fake.log().iter().filter(|call| *call == "film case1").count(), 1);
    }
}

#[test]
fn one_failed_cell_does_not_stop_the_others() {
    let whole = tempfile::tempdir().unwrap();
    let (plan, sound) = (small_plan(), Fake::default());
    let cells = run(whole.path(), &plan, &sound, Freshness::Resume).0.unwrap();
    let expected = picture(whole.path(), &cells);

    for (fault, sentence) in [(Fault::Cell, "planted"), (Fault::Panic, "a bug in the program: planted panic")] {
        for call in 0..18 {
            let folder = tempfile::tempdir().unwrap();
            let fake = Fake::with_fault(call, fault);
            let (cells, events) = run(folder.path(), &plan, &fake, Freshness::Resume);
            let cells = cells.unwrap();
            let failed = cells.iter().filter(|c| c.failure.is_some()).count();
            assert_eq!(failed, if call % 9 == 0 { 4 } else { 1 }, "call {call}: a sequence costs four cells");
            assert!(events.iter().any(|e| e.ends_with(sentence)), "{events:?}");
            // The next run makes only what is missing, and ends where an undisturbed one would have.
            let (cells, _) = run(folder.path(), &plan, &Fake::default(), Freshness::Resume);
            assert_eq!(picture(folder.path(), &cells.unwrap()), expected);
        }
    }
}

/// A film or prediction that its own reader refuses: the others have theirs, although the file lies in the cache.
#[test]
fn wrong_content_in_the_cache_fails_its_cells_alone() {
    for call in 0..3 {
        let folder = tempfile::tempdir().unwrap();
        let plan = small_plan();
        let cells = run(folder.path(), &plan, &Fake::with_fault(call, Fault::Content), Freshness::Resume).0.unwrap();
        let failed = cells.iter().filter(|cell| cell.failure.is_some()).count();
        assert!(cells.len() == 8 && (1..=4).contains(&failed), "call {call}: {failed} failed");
    }
}

#[test]
fn a_full_disk_or_the_user_stops_the_run_and_nothing_is_lost() {
    let whole = tempfile::tempdir().unwrap();
    let (plan, sound) = (small_plan(), Fake::default());
    let cells = run(whole.path(), &plan, &sound, Freshness::Resume).0.unwrap();
    let expected = picture(whole.path(), &cells);

    for (fault, kind) in [(Fault::Disk, ErrorKind::InputOutput), (Fault::Interrupt, ErrorKind::Interrupted)] {
        for call in 0..18 {
            let folder = tempfile::tempdir().unwrap();
            let fake = Fake::with_fault(call, fault);
            let stopped = run(folder.path(), &plan, &fake, Freshness::Resume).0.unwrap_err();
            assert_eq!(stopped.kind(), kind);
            assert_eq!(fake.log().len(), call + 1, "nothing runs after the stop");
            let rest = Fake::default();
            let (cells, _) = run(folder.path(), &plan, &rest, Freshness::Resume);
            assert_eq!(rest.log().len(), 18 - call, "what was finished is not made again");
            assert_eq!(picture(folder.path(), &cells.unwrap()), expected);
        }
    }
}

#[test]
fn two_at_once_leave_what_one_after_the_other_leaves() {
    let at_once = |root: &Path, plan: &Plan, fake: &Fake| {
        let store = Store::open(root).unwrap();
        execute_at_once(plan, fake, &store, 2, &Events::default())
    };
    let whole = tempfile::tempdir().unwrap();
    let plan = small_plan();
    let cells = run(whole.path(), &plan, &Fake::default(), Freshness::Resume).0.unwrap();
    // What a cell cost beside another one is not kept.
    let products = |root: &Path, cells: &[FinishedCell]| {
        let (scores, mut names) = picture(root, cells);
        names.retain(|name| !name.starts_with("cells/") || !name.ends_with("timing.json"));
        (scores, names)
    };
    let expected = products(whole.path(), &cells);
    let folder = tempfile::tempdir().unwrap();
    let fake = Fake::default();
    let cells = at_once(folder.path(), &plan, &fake).unwrap();
    assert_eq!(products(folder.path(), &cells), expected);
    assert!(cells.iter().all(|cell| !cell.is_timed()), "seconds beside others are no measurement");
    assert_eq!(fake.log()[..2], ["film case1", "film case2"]);
    assert!(at_once(folder.path(), &plan, &fake).unwrap().len() == 8 && fake.log().is_empty());
    for (call, fault) in [(4, Fault::Disk), (9, Fault::Interrupt), (0, Fault::Interrupt)] {
        let folder = tempfile::tempdir().unwrap();
        at_once(folder.path(), &plan, &Fake::with_fault(call, fault)).unwrap_err();
        let cells = at_once(folder.path(), &plan, &Fake::default()).unwrap();
        assert_eq!(products(folder.path(), &cells), expected, "resumed after call {call}");
    }
    let folder = tempfile::tempdir().unwrap();
    let cells = at_once(folder.path(), &plan, &Fake::with_fault(5, Fault::Panic)).unwrap();
    assert_eq!(cells.iter().filter(|c| c.failure.is_some()).count(), 1);
}

/// Two processes that share a cache: what one has claimed the other one leaves to it, and takes when it is done.
#[test]
fn two_runs_share_the_work_and_both_have_all_of_it() {
    let alone = tempfile::tempdir().unwrap();
    let plan = small_plan();
    let cells = run(alone.path(), &plan, &Fake::default(), Freshness::Resume).0.unwrap();
    let expected = picture(alone.path(), &cells);

    for freshness in [Freshness::Resume, Freshness::Fresh] {
        let folder = tempfile::tempdir().unwrap();
        let fakes: Vec<Fake> = (0..3).map(|_| Fake { pause: Duration::from_millis(5), ..Fake::default() }).collect();
        let runs: Vec<_> = std::thread::scope(|scope| {
            let started: Vec<_> = fakes
                .iter()
                .map(|fake| scope.spawn(|| run(folder.path(), &plan, fake, freshness).0.unwrap()))
                .collect();
            started.into_iter().map(|run| run.join().unwrap()).collect()
        });
        let logs: Vec<Vec<String>> = fakes.iter().map(Fake::log).collect();
        for cells in runs {
            assert_eq!(picture(folder.path(), &cells), expected);
        }
        if freshness == Freshness::Resume {
            assert_eq!(logs.iter().map(Vec::len).sum::<usize>(), 18, "{logs:?}");
            assert!(logs.iter().filter(|log| !log.is_empty()).count() > 1, "one did it all: {logs:?}");
        }
    }
}

/// A run that was killed holds its claims no longer; one that lives on another machine does, and is waited for.
#[test]
fn a_claim_of_the_living_is_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let plan = small_plan();
    let store = Store::open(folder.path()).unwrap();
    let cell = plan.cells().remove(1);
    let work = store.claim(&cell_folder(&plan, &cell).unwrap(), &[]).unwrap().unwrap();
    let (fake, events) = (Fake::default(), Events::default());
    std::thread::scope(|scope| {
        let waiting = scope.spawn(|| execute(&plan, &fake, &store, Freshness::Resume, &events));
        while !events.0.lock().unwrap().iter().any(|event| event.starts_with("waits")) {
            std::thread::sleep(Duration::from_millis(5));
        }
        assert_eq!(fake.log().len(), 16, "all but the claimed cell is done by now");
        work.release().unwrap();
        assert!(waiting.join().unwrap().unwrap().iter().all(|cell| cell.failure.is_none()));
    });
    assert_eq!(fake.log(), ["reconstruct case1-ours-s2", "score case1-ours-s2"]);
    assert_eq!(events.0.into_inner().unwrap().iter().filter(|event| event.starts_with("waits")).count(), 1);
}

/// Stages whose claim another process takes in the middle of one call, as from a process that stood still for long, and
/// whose work that process finishes before this one wakes up.
struct Slept<'a> {
    fake: Fake,
    at: &'static str,
    root: &'a Path,
    plan: &'a Plan,
    other: Fake,
}

impl Slept<'_> {
    /// Where this is the call: writes a half, and sleeps while the other process takes the folder and ends its run.
    fn sleep(&self, what: &str, half: &Path) -> Result<()> {
        if what == self.at && self.other.calls.load(Ordering::SeqCst) == 0 {
            files::write_bytes(half, b"half")?;
            let claimed = half.ancestors().find(|folder| folder.join(".claim").exists()).unwrap();
            std::fs::remove_dir_all(claimed.join(".claim")).unwrap();
            run(self.root, self.plan, &self.other, Freshness::Resume).0.unwrap();
        }
        Ok(())
    }
}

impl Stages for Slept<'_> {
    fn film(&self, case_id: &str, folder: &Path, progress: &dyn Progress) -> Result<()> {
        // Of a film the other process takes on what is there.
        self.sleep("film", &folder.join("first"))?;
        self.fake.film(case_id, folder, progress)
    }

    fn reconstruct(&self, cell: &Cell, sequence: &Path, prediction: &Path, progress: &dyn Progress) -> Result<()> {
        self.sleep("reconstruct", &prediction.join("color/000001.png"))?;
        self.fake.reconstruct(cell, sequence, prediction, progress)
    }

    fn score(&self, cell: &Cell, sequence: &Path, prediction: &Path, score: &Path) -> Result<()> {
        self.sleep("score", &score.with_file_name("half"))?;
        self.fake.score(cell, sequence, prediction, score)
    }
}

#[test]
fn a_run_that_was_taken_for_dead_takes_what_the_other_one_has_made() {
    let plan = small_plan();
    for at in ["film", "reconstruct", "score"] {
        let folder = tempfile::tempdir().unwrap();
        let (fake, other) = (Fake::default(), Fake::default());
        let slept = Slept { fake, at, root: folder.path(), plan: &plan, other };
        let store = Store::open(folder.path()).unwrap();
        let cells = execute(&plan, &slept, &store, Freshness::Resume, &Events::default()).unwrap();
        assert!(cells.iter().all(|cell| cell.failure.is_none()), "{at}");
        assert!(!slept.other.log().is_empty());
        // All of it is whole and as a run alone leaves it: nothing of the half that was written goes in.
        let again = Fake::default();
        let (cells, _) = run(folder.path(), &plan, &again, Freshness::Resume);
        assert_eq!(again.log(), [""; 0], "{at}");
        let alone = tempfile::tempdir().unwrap();
        let expected = run(alone.path(), &plan, &Fake::default(), Freshness::Resume).0.unwrap();
        assert_eq!(picture(folder.path(), &cells.unwrap()), picture(alone.path(), &expected), "{at}");
    }
}

/// What a plan of the size of a cluster's costs by itself (`docs/cluster.md`): run it by name with `--ignored
/// --nocapture`; it asserts no times.
#[test]
#[ignore = "takes a minute, and prints times"]
fn twelve_thousand_cells() {
    let folder = tempfile::tempdir().unwrap();
    let planned = |id: String| Planned { content: format!("content of {id}"), id, draws: true };
    let plan = Plan {
        cases: (0..1000).map(|k| planned(format!("case{k}"))).collect(),
        methods: (0..12).map(|k| planned(format!("method{k}"))).collect(),
        seeds: vec![1],
        ..small_plan()
    };
    let fake = Fake::default();
    for what in ["made", "resumed"] {
        let started = std::time::Instant::now();
        let cells = run(folder.path(), &plan, &fake, Freshness::Resume).0.unwrap();
        println!("{} cells {what} in {:.1} s", cells.len(), started.elapsed().as_secs_f64());
    }
    assert_eq!(fake.log().len(), 1000 + 2 * 12_000);
    let store = Store::look(folder.path());
    let started = std::time::Instant::now();
    let missing = plan.cells().iter().filter(|cell| !is_finished(&plan, &store, cell).unwrap()).count();
    println!("looked through in {:.1} s", started.elapsed().as_secs_f64());
    assert_eq!(missing, 0);
}
