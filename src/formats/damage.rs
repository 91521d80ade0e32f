//! Decoders of other people that panic on some damaged files.

use std::cell::Cell;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Once;

use crate::base::{Error, Result};

thread_local! {
    /// Whether this thread runs a decoder whose panic is caught.
    static GUARDED: Cell<bool> = const { Cell::new(false) };
}

/// Runs `decode`; a panic in it becomes the error "is a damaged `kind` file", and the words of the panic are not
/// printed: the user gets one sentence.
pub(super) fn guarded<T>(kind: &str, decode: impl FnOnce() -> Result<T>) -> Result<T> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let before = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if !GUARDED.get() {
                before(info);
            }
        }));
    });
    GUARDED.set(true);
    // The decoder sees the bytes of a file and nothing else that a panic could leave half done.
    let outcome = panic::catch_unwind(AssertUnwindSafe(decode));
    GUARDED.set(false);
    outcome.unwrap_or_else(|_| Err(Error::input(format!("is a damaged {kind} file: the decoder gave up"))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_an_error_and_the_next_one_is_heard_again() {
        let broken = guarded::<()>("XYZ", || panic!("index out of range"));
        assert_eq!(broken.unwrap_err().to_string(), "is a damaged XYZ file: the decoder gave up");
        assert!(!GUARDED.get());
        assert_eq!(guarded("XYZ", || Ok(7)).unwrap(), 7);
    }
}
