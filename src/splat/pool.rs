//! How a pass shares its work among threads.

/// Runs a whole pass inside the thread pool: a caller from outside would otherwise sleep and be woken once for every
/// stage, and the threads with it.
pub(super) fn in_pool<R: Send>(pass: impl FnOnce() -> R + Send) -> R {
    if rayon::current_thread_index().is_some() { pass() } else { rayon::scope(|_| pass()) }
}

/// Chunks of Gaussians, or rows of tiles, that one thread takes at a time: what is seen lies together, so that two halves
/// of a scene are seldom the same amount of work.
pub(super) const PIECE: usize = 1;

/// Tiles that one thread takes at a time.
pub(super) const TILES: usize = 2;
