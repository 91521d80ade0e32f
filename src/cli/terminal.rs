//! The terminal: bars where a person watches, plain lines elsewhere, results on standard output, Ctrl-C.

use std::fmt::Display;
use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

use crate::base::{Error, ErrorKind, Estimate, Progress, Result};
use crate::bench::environment::{hang_up_is_ignored, ignore_hang_up};

/// Least time between two progress lines of a stage when there is no terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(10);

/// How often the seconds of a stage that counts nothing are drawn.
const TICK: Duration = Duration::from_secs(1);

/// Whether large work begins without a question.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Consent {
    /// `--yes`.
    Given,
    /// The user is told what it would take, and has to say so.
    Asked,
}

/// Where a command reports. Progress and notes go to standard error, results to standard output.
pub struct Terminal {
    interrupted: Arc<AtomicBool>,
    watched: bool,
    consent: Consent,
    state: Mutex<TerminalState>,
}

#[derive(Default)]
struct TerminalState {
    label: String,
    bar: Option<ProgressBar>,
    /// Whether the bar counts; until then it shows the stage and its seconds.
    counts: bool,
    last_line: Option<Instant>,
    /// Nothing more can be written to standard output.
    output_closed: bool,
    /// Why, unless its reader has gone away.
    output_failure: Option<std::io::Error>,
}

/// One line on standard error. Where that cannot be written (a log on a full disk) it is dropped: the exit code
/// stays what it is, where `eprintln!` would panic.
pub(super) fn complain(text: impl Display) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

impl Terminal {
    /// Takes over Ctrl-C: the first asks the work to stop at the next safe point, the second ends the process.
    pub fn new() -> Result<Self> {
        let interrupted = Arc::new(AtomicBool::new(false));
        let token = Arc::clone(&interrupted);
        let goes_on = hang_up_is_ignored();
        ctrlc::set_handler(move || {
            if token.swap(true, Ordering::SeqCst) {
                // Files are written atomically; a folder that was not finished is removed by the next run.
                std::process::exit(i32::from(ErrorKind::Interrupted.exit_code()));
            }
            complain("stopping at the next safe point; press Ctrl-C again to stop at once");
        })
        .map_err(|e| Error::new(ErrorKind::Environment, format!("cannot take over Ctrl-C: {e}")))?;
        // The handler is for hang-ups, too; a run under nohup outlives its terminal.
        if goes_on {
            ignore_hang_up();
        }
        Ok(Terminal {
            interrupted,
            watched: std::io::stderr().is_terminal(),
            consent: Consent::Asked,
            state: Mutex::default(),
        })
    }

    /// `--yes`: large work begins without a question.
    pub fn give_consent(&mut self) {
        self.consent = Consent::Given;
    }

    /// Starts a stage: what `advance` counts from now on, for instance `case1: filming`. Where a person watches, the
    /// stage and its seconds show until there is something to count.
    pub fn stage(&self, label: impl Display) {
        let mut state = self.state();
        if let Some(bar) = state.bar.take() {
            bar.finish_and_clear();
        }
        state.label = label.to_string();
        state.last_line = None;
        state.counts = false;
        if self.watched && !state.label.is_empty() {
            let bar = styled("{msg} {elapsed}", &state.label);
            bar.enable_steady_tick(TICK);
            state.bar = Some(bar);
        }
    }

    /// One line on standard output. A reader that has gone away (`| head -1`) is no error: the rest is dropped. Any other
    /// failure is that of the command ([`Terminal::output`]).
    pub fn line(&self, text: impl Display) {
        let mut state = self.state();
        let write = || {
            let mut output = std::io::stdout().lock();
            writeln!(output, "{text}").and_then(|()| output.flush())
        };
        if state.output_closed {
            return;
        }
        let outcome = match &state.bar {
            Some(bar) => bar.suspend(write),
            None => write(),
        };
        if let Err(failure) = outcome {
            state.output_closed = true;
            state.output_failure = (failure.kind() != std::io::ErrorKind::BrokenPipe).then_some(failure);
        }
    }

    /// Whether all lines could be written, once the command is done.
    pub fn output(&self) -> Result<()> {
        match self.state().output_failure.take() {
            Some(failure) => Err(Error::input(format!("standard output: writing failed: {failure}"))),
            None => Ok(()),
        }
    }

    /// A value as JSON on standard output.
    pub fn json(&self, value: &impl serde::Serialize) -> Result<()> {
        self.line(serde_json::to_string_pretty(value).map_err(|e| Error::input(format!("cannot be written: {e}")))?);
        Ok(())
    }

    /// Removes the bar.
    pub fn finish(&self) {
        self.stage("");
    }

    /// A panic elsewhere leaves nothing in here half done, so a poisoned lock is as good as a whole one.
    fn state(&self) -> MutexGuard<'_, TerminalState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn styled(template: &str, label: &str) -> ProgressBar {
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::no_length().with_style(style).with_message(label.to_owned())
}

impl Progress for Terminal {
    fn advance(&self, done: usize, total: usize) {
        let mut state = self.state();
        if self.watched {
            if !std::mem::replace(&mut state.counts, true) {
                if let Some(waiting) = state.bar.take() {
                    waiting.finish_and_clear();
                }
                state.bar = Some(styled("{msg:40!} {wide_bar} {pos}/{len} {elapsed} (eta {eta})", &state.label));
            }
            let Some(bar) = &state.bar else { return };
            bar.set_length(total as u64);
            bar.set_position(done as u64);
            return;
        }
        let now = Instant::now();
        // The first interval starts with the stage: what is quicker needs no line.
        let last = *state.last_line.get_or_insert(now);
        if now.duration_since(last) >= LINE_INTERVAL {
            state.last_line = Some(now);
            complain(format_args!("{}: {done}/{total}", state.label));
        }
    }

    fn accepts(&self, estimate: &Estimate) -> Result<()> {
        match estimate.question() {
            Some(question) if self.consent == Consent::Asked => Err(Error::usage(question)),
            _ => Ok(()),
        }
    }

    fn cancelled(&self) -> bool {
        self.interrupted.load(Ordering::SeqCst)
    }

    fn note(&self, sentence: &str) {
        match &self.state().bar {
            Some(bar) => bar.suspend(|| complain(sentence)),
            None => complain(sentence),
        }
    }
}
