//! Every reader answers every input: the corpus of the fuzzer (`fuzz/`), findings included, goes through the fuzzer's own
//! targets, and then changed inputs for some seconds (`RESPIRE_FUZZ_SECONDS`, 1 unless `scripts/test.sh` says 2).
//! `scripts/fuzz.sh` searches with the compiler's help and for longer.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use respire_bench::base::random::{CounterRng, Stage};

use targets::{Scratch, TARGETS, mutate};

#[path = "../../fuzz/src/targets.rs"]
mod targets;

/// An input takes a hundredth of this, unless the machine is very busy.
const MOST_TIME: Duration = Duration::from_secs(5);
/// After this a reader hangs.
const HANGS: Duration = Duration::from_secs(120);
const MOST_BYTES: usize = 4000;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The input that a reader has in hand, for the watch that reports a hang.
struct InHand(Mutex<Option<(Instant, Vec<u8>)>>);

impl InHand {
    fn set(&self, input: Option<(Instant, Vec<u8>)>) {
        *self.0.lock().unwrap() = input;
    }

    /// Ends the process with the input's place when the reader does not come back.
    fn watch(&self, name: &str) {
        if let Some((_, input)) = self.0.lock().unwrap().as_ref().filter(|(since, _)| since.elapsed() > HANGS) {
            eprintln!("the reader `{name}` hangs: {}", keep(name, input).display());
            std::process::abort();
        }
    }
}

/// Keeps a finding for a look and for the corpus.
fn keep(name: &str, input: &[u8]) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("finding-{name}"));
    std::fs::write(&path, input).unwrap();
    path
}

fn replay(name: &str) {
    let target = TARGETS.iter().find(|t| t.name == name).unwrap();
    let scratch = Scratch::new(root(), &format!("replay-{name}")).unwrap();
    let in_hand = InHand(Mutex::new(None));
    let read = |input: &[u8], what: &str| {
        let start = Instant::now();
        in_hand.set(Some((start, input.to_vec())));
        let outcome = catch_unwind(AssertUnwindSafe(|| (target.run)(input, &scratch)));
        in_hand.set(None);
        let took = start.elapsed();
        assert!(outcome.is_ok(), "the reader `{name}` panics on {what}: {}", keep(name, input).display());
        assert!(took < MOST_TIME, "`{name}` takes {took:?} for {what}: {}", keep(name, input).display());
    };
    let mut paths: Vec<PathBuf> =
        std::fs::read_dir(root().join("fuzz/corpus").join(name)).unwrap().map(|e| e.unwrap().path()).collect();
    paths.sort();
    let corpus: Vec<Vec<u8>> = paths.iter().map(|path| std::fs::read(path).unwrap()).collect();
    assert!(!corpus.is_empty());
    let seconds = std::env::var("RESPIRE_FUZZ_SECONDS").map_or(1.0, |s| s.parse().unwrap());
    std::thread::scope(|scope| {
        let (done, finished) = std::sync::mpsc::channel::<()>();
        let in_hand = &in_hand;
        scope.spawn(move || {
            // Ends with the sender, which goes when the work below ends or panics.
            while finished.recv_timeout(Duration::from_secs(1)) == Err(std::sync::mpsc::RecvTimeoutError::Timeout) {
                in_hand.watch(name);
            }
        });
        let _done = done;
        for (path, input) in paths.iter().zip(&corpus) {
            read(input, &path.file_name().unwrap().to_string_lossy());
        }
        let start = Instant::now();
        let mut rng = CounterRng::new(1, Stage::Test, &[]);
        while start.elapsed().as_secs_f64() < seconds {
            let [one, other] = [0; 2].map(|_| rng.index(corpus.len()));
            read(&mutate(&corpus[one], &corpus[other], MOST_BYTES, &mut rng), "a changed input");
        }
    });
}

/// A test for each reader, so that they run side by side.
macro_rules! readers {
    ($($name:ident)*) => {
        const NAMES: &[&str] = &[$(stringify!($name)),*];
        $(#[test]
        fn $name() {
            replay(stringify!($name));
        })*
    };
}

readers! {
    ablations case centerline clinical depth_png dicom environments exr gate gaussians http landmarks live_poses loop_result
    lung_box marker merge metaimage method nifti npy obj participant ply png
    prediction profile results scene scenes score sequence stl timings transforms tree tree_table
}

#[test]
fn every_target_of_the_fuzzer_is_replayed() {
    let names: Vec<&str> = TARGETS.iter().map(|t| t.name).collect();
    assert_eq!(names, NAMES);
}
