//! Runs a program of others to its end, or until the user stops it.

use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::base::{Error, ErrorKind, Progress, Result};

/// What installs elastix and dcm2niix.
pub const REMEDY: &str = "scripts/setup.sh --ct";
/// How often the program is looked after.
const POLL: Duration = Duration::from_millis(100);
/// The signal of Ctrl-C, on every Unix.
const INTERRUPT: i32 = 2;

/// Runs `command`, whose words go to the file `log`.
///
/// Errors: it cannot be started; it fails (its last words are told); the user stopped the work, which ends the program,
/// too.
pub fn run(mut command: Command, log: &Path, progress: &dyn Progress) -> Result<()> {
    let name = command.get_program().to_string_lossy().to_string();
    let output = std::fs::File::create(log).map_err(|e| Error::io("writing", log, e))?;
    let errors = output.try_clone().map_err(|e| Error::io("writing", log, e))?;
    command.stdin(Stdio::null()).stdout(output).stderr(errors);
    let mut child = command
        .spawn()
        .map_err(|e| Error::new(ErrorKind::Environment, format!("{name} cannot be started ({e}): run {REMEDY}")))?;
    let status = loop {
        if progress.cancelled() {
            // Its files go with the folder.
            let _ = child.kill();
            let _ = child.wait();
            return Err(Error::interrupted());
        }
        match child.try_wait().map_err(|e| Error::input(format!("{name} cannot be waited for: {e}")))? {
            Some(status) => break status,
            None => std::thread::sleep(POLL),
        }
    };
    if status.success() {
        return Ok(());
    }
    // A terminal sends Ctrl-C to both, and the program may end before this one has noticed.
    if progress.cancelled() || status.signal() == Some(INTERRUPT) {
        return Err(Error::interrupted());
    }
    let text = std::fs::read(log).unwrap_or_default();
    let text = String::from_utf8_lossy(&text);
    let words = text.lines().map(str::trim).rfind(|l| l.contains("rror") || l.contains("xception"));
    let words = words.or_else(|| text.lines().map(str::trim).rfind(|l| !l.is_empty())).unwrap_or("it said nothing");
    Err(Error::input(format!("{name} failed ({status}): {words}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::NoProgress;

    /// Runs a line of the shell.
    fn outcome(line: &str) -> Error {
        let folder = tempfile::tempdir().unwrap();
        let mut command = Command::new("sh");
        command.args(["-c", line]);
        run(command, &folder.path().join("log"), &NoProgress).unwrap_err()
    }

    #[test]
    fn a_failure_tells_the_last_words_and_an_interrupt_is_none() {
        let said = outcome("echo begun; echo 'Error: no slices' >&2; echo done; exit 2").to_string();
        assert!(said.contains("sh failed (exit status: 2): Error: no slices"), "{said}");
        assert!(outcome("exit 1").to_string().contains("it said nothing"));
        // A job in the background ignores the signal, and so would what it starts.
        let interrupted = outcome("exec env --default-signal=INT sh -c 'kill -INT $$'");
        assert_eq!(interrupted.kind(), ErrorKind::Interrupted);
        assert_eq!(outcome("kill -TERM $$").kind(), ErrorKind::InputOutput);
    }

    #[test]
    fn a_stop_ends_the_program() {
        struct Stopped;
        impl Progress for Stopped {
            fn advance(&self, _done: usize, _total: usize) {}
            fn cancelled(&self) -> bool {
                true
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let mut command = Command::new("sleep");
        command.arg("60");
        let begun = std::time::Instant::now();
        let error = run(command, &folder.path().join("log"), &Stopped).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Interrupted);
        assert!(begun.elapsed() < Duration::from_secs(30));
    }
}
