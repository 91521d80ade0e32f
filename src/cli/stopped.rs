//! What an error of work that the user stopped promises: each command knows what it keeps.

use crate::base::{Error, ErrorKind, Result};

fn promising<T>(outcome: Result<T>, sentence: &str) -> Result<T> {
    outcome.map_err(|error| match error.kind() {
        ErrorKind::Interrupted => Error::new(ErrorKind::Interrupted, sentence),
        _ => error,
    })
}

/// The outcome of work that finds what it has finished.
pub(super) fn resumable<T>(outcome: Result<T>) -> Result<T> {
    promising(outcome, "stopped; the same command resumes")
}

/// The outcome of work that keeps nothing when it is stopped, so that nothing resumes.
pub(super) fn all_or_nothing<T>(outcome: Result<T>) -> Result<T> {
    promising(outcome, "stopped; nothing was kept")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_was_stopped_gets_a_promise() {
        let said = |outcome: Result<()>| outcome.unwrap_err().to_string();
        assert_eq!(Error::interrupted().to_string(), "stopped");
        assert_eq!(said(resumable(Err(Error::interrupted()))), "stopped; the same command resumes");
        assert_eq!(said(all_or_nothing(Err(Error::interrupted()))), "stopped; nothing was kept");
        assert_eq!(said(resumable(Err(Error::input("is no film")))), "is no film");
    }
}
