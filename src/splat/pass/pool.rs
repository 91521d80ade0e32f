//! How a pass shares its work among threads.
//!
//! A pass has ten stages of some ten to some hundred microseconds each. A thread that sleeps between two of them is
//! woken too late for the second; one that polls for work gets it at once. So while a pass runs, the other threads
//! stay awake ([`stay`]).

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use rayon::Yield;

/// Runs a whole pass inside the thread pool: otherwise a caller from outside, and the pool's threads, would sleep and
/// be woken once per stage.
pub fn in_pool<R: Send>(pass: impl FnOnce() -> R + Send) -> R {
    let run = || {
        let _awake = Awake::new();
        pass()
    };
    if rayon::current_thread_index().is_some() { run() } else { rayon::scope(|_| run()) }
}

/// Gaussians per task; the gradients of the camera are summed in these chunks.
pub const CHUNK: usize = 1024;

/// Rows of tiles that one thread takes at a time.
pub const PIECE: usize = 1;

/// Number of chunks of Gaussians, out of `chunks`, that one thread takes at a time: few, since visible Gaussians lie
/// together and two halves of a scene are seldom the same amount of work, but enough that a scene is not cut into
/// hundreds of empty tasks.
pub fn piece_of(chunks: usize) -> usize {
    (chunks / 64).max(1)
}

/// Tiles that one thread takes at a time.
pub const TILES: usize = 2;

/// Cuts `slice` into pieces of the given lengths.
pub fn cut<V>(mut slice: &mut [V], lengths: impl Iterator<Item = usize>) -> Vec<&mut [V]> {
    lengths
        .map(|length| {
            let (head, tail) = std::mem::take(&mut slice).split_at_mut(length);
            slice = tail;
            head
        })
        .collect()
}

/// Rounds without work (some 100 ns each) after which a thread goes to sleep: longer than a thread is idle in any
/// stage.
const IDLE_ROUNDS: usize = 500;

/// Whether a pass keeps the threads awake. Only one does at a time, since concurrent passes keep the threads busy
/// anyway.
static TAKEN: AtomicBool = AtomicBool::new(false);

/// Keeps the other threads of the pool awake until it is dropped.
struct Awake(Option<Arc<AtomicBool>>);

impl Awake {
    fn new() -> Self {
        static CORES: OnceLock<usize> = OnceLock::new();
        let cores = *CORES.get_or_init(|| std::thread::available_parallelism().map_or(1, usize::from));
        let others = rayon::current_num_threads().min(cores) - 1;
        if others == 0 || TAKEN.swap(true, Ordering::AcqRel) {
            return Awake(None);
        }
        let (done, owner) = (Arc::new(AtomicBool::new(false)), rayon::current_thread_index());
        for _ in 0..others {
            let done = done.clone();
            // The thread of the pass itself must not wait for its own end.
            rayon::spawn(move || {
                if rayon::current_thread_index() != owner {
                    stay(&done);
                }
            });
        }
        Awake(Some(done))
    }
}

impl Drop for Awake {
    fn drop(&mut self) {
        if let Some(done) = &self.0 {
            done.store(true, Ordering::Release);
            TAKEN.store(false, Ordering::Release);
        }
    }
}

/// Executes pending work until `done`, or until there has been none for [`IDLE_ROUNDS`].
fn stay(done: &AtomicBool) {
    let mut idle = 0;
    while idle < IDLE_ROUNDS && !done.load(Ordering::Acquire) {
        if rayon::yield_now() == Some(Yield::Executed) {
            idle = 0;
        } else {
            idle += 1;
            std::hint::spin_loop();
        }
    }
}
