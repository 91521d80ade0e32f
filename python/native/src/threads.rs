//! On which threads a call computes: the interpreter's own is one of those that render, and a forked child has a pool
//! of its own.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::failure::refused;

/// Makes the first thread that renders one of the threads of a pool. A pass then begins on it at once, while the others
/// are still being woken; otherwise it would sleep during the pass, two threads would have to be woken one after the
/// other for it to begin, and it itself in the end.
///
/// Threads that render later use rayon's global pool, which does not need this one.
pub fn join() {
    static POOL: OnceLock<Option<ThreadPool>> = OnceLock::new();
    if is_forked() {
        return;
    }
    // Where no pool can be made, this thread hands its passes to the global one, too.
    POOL.get_or_init(|| match rayon::current_thread_index() {
        None => ThreadPoolBuilder::new().use_current_thread().build().ok(),
        Some(_) => None,
    });
}

/// Runs `work` without holding the interpreter. A forked child has no threads but the one that forked: what is handed
/// to the pools of its parent would never begin, so that a pool of the child runs it.
pub fn run<T: Send>(py: Python<'_>, work: impl FnOnce() -> PyResult<T> + Send) -> PyResult<T> {
    py.detach(|| {
        if !is_forked() {
            return work();
        }
        let pool = pool_of_child()?;
        // The thread that forked may still count as one of the parent's pool, and would look for work there.
        if rayon::current_thread_index().is_none() {
            return pool.install(work);
        }
        let done = std::thread::scope(|scope| scope.spawn(|| pool.install(work)).join());
        done.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

/// Whether this is a fork of the process that computed first, whose pools are rayon's global one and that of [`join`].
fn is_forked() -> bool {
    static FIRST: OnceLock<u32> = OnceLock::new();
    let this = std::process::id();
    *FIRST.get_or_init(|| this) != this
}

/// The pool of this process.
fn pool_of_child() -> PyResult<Arc<ThreadPool>> {
    static POOL: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);
    let (this, mut held) = (std::process::id(), POOL.lock().unwrap_or_else(PoisonError::into_inner));
    if let Some((owner, pool)) = &*held
        && *owner == this
    {
        return Ok(pool.clone());
    }
    let made = ThreadPoolBuilder::new().build().map_err(|e| refused(format!("no thread can be started: {e}")))?;
    let pool = Arc::new(made);
    // The pool of a parent that is itself a fork has no threads here that could be told to end.
    std::mem::forget(held.replace((this, pool.clone())));
    Ok(pool)
}
