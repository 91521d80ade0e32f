//! The interpreter's thread as one of those that render.

use std::sync::OnceLock;

use rayon::{ThreadPool, ThreadPoolBuilder};

/// Makes the first thread that renders one of the threads of a pool. A pass then begins on it at once, while the others
/// are still being woken; otherwise it would sleep during the pass, two threads would have to be woken one after the
/// other for it to begin, and it itself in the end.
///
/// Threads that render later use rayon's global pool, which does not need this one.
pub fn join() {
    static POOL: OnceLock<Option<ThreadPool>> = OnceLock::new();
    // Where no pool can be made, this thread hands its passes to the global one, too.
    POOL.get_or_init(|| match rayon::current_thread_index() {
        None => ThreadPoolBuilder::new().use_current_thread().build().ok(),
        Some(_) => None,
    });
}
