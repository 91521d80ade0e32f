//! The one error type: what went wrong, in one sentence that names file and element.

use std::fmt;
use std::path::{Path, PathBuf};

/// Result with the crate's [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What kind of failure it is; decides the exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ErrorKind {
    /// A cell of the benchmark failed.
    CellFailed,
    /// The command line cannot be understood.
    Usage,
    /// A metric is worse than its threshold allows.
    Regression,
    /// A file cannot be read, violates its format, or cannot be written.
    InputOutput,
    /// The machine lacks something (a library, an instruction set).
    Environment,
    /// The user stopped the work.
    Interrupted,
}

impl ErrorKind {
    /// The documented exit code of the process (README, "Exit codes").
    pub fn exit_code(self) -> u8 {
        match self {
            ErrorKind::CellFailed => 1,
            ErrorKind::Usage => 2,
            ErrorKind::Regression => 3,
            ErrorKind::InputOutput => 4,
            ErrorKind::Environment => 5,
            ErrorKind::Interrupted => 130,
        }
    }
}

/// One sentence, with the file and the element in it that is at fault where there is one.
#[derive(Clone, Debug, PartialEq)]
pub struct Error(Box<Inner>);

#[derive(Clone, Debug, PartialEq)]
struct Inner {
    kind: ErrorKind,
    path: Option<PathBuf>,
    element: Option<String>,
    message: String,
    /// The operating system said no, not the content of a file.
    of_system: bool,
}

impl Error {
    /// An error of `kind` that says `message`.
    pub fn new(kind: ErrorKind, message: impl Into<String>) -> Self {
        Error(Box::new(Inner { kind, path: None, element: None, message: message.into(), of_system: false }))
    }

    /// Input that contradicts its format or its meaning.
    pub fn input(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::InputOutput, message)
    }

    /// A command line that cannot be understood.
    pub fn usage(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::Usage, message)
    }

    /// The user stopped the work. Whether it can be resumed, the command knows.
    pub fn interrupted() -> Self {
        Self::new(ErrorKind::Interrupted, "stopped")
    }

    /// An operating-system error while doing `what` ("reading", "writing") with `path`.
    pub fn io(what: &str, path: &Path, source: std::io::Error) -> Self {
        let mut error = Self::input(format!("{what} failed: {source}")).at(path);
        error.0.of_system = true;
        error
    }

    /// Names the file at fault, unless one is named already.
    pub fn at(mut self, path: impl AsRef<Path>) -> Self {
        self.0.path.get_or_insert_with(|| path.as_ref().to_path_buf());
        self
    }

    /// Names the element at fault (a line, a key, a vertex), unless one is named already.
    pub fn element(mut self, element: impl fmt::Display) -> Self {
        self.0.element.get_or_insert_with(|| element.to_string());
        self
    }

    /// What kind of failure it is.
    pub fn kind(&self) -> ErrorKind {
        self.0.kind
    }

    /// Whether the operating system said no, and not the content of a file.
    pub fn is_of_system(&self) -> bool {
        self.0.of_system
    }

    /// The file at fault, if one is known.
    pub fn path(&self) -> Option<&Path> {
        self.0.path.as_deref()
    }
}

/// Most characters of the words that an error shows: an input may be one line of a megabyte.
const MAX_SHOWN: usize = 2000;

/// Writes `text` as one line: what moves the cursor or colours a terminal is written as its escape.
fn write_line(f: &mut fmt::Formatter<'_>, text: &str) -> fmt::Result {
    for (count, c) in text.chars().enumerate() {
        match c {
            _ if count == MAX_SHOWN => return f.write_str(" ..."),
            c if c.is_control() => write!(f, "{}", c.escape_default())?,
            c => fmt::Write::write_char(f, c)?,
        }
    }
    Ok(())
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(path) = &self.0.path {
            write_line(f, &path.to_string_lossy())?;
            f.write_str(": ")?;
        }
        if let Some(element) = &self.0.element {
            write_line(f, element)?;
            f.write_str(": ")?;
        }
        write_line(f, &self.0.message)
    }
}

impl std::error::Error for Error {}

#[cfg(test)]
mod tests {
    use super::*;

    /// Found by fuzzing: a message that quotes its input can hold line ends, terminal colours or a megabyte.
    #[test]
    fn the_sentence_is_one_line_of_readable_length() {
        let e = Error::input("\"a\u{1b}[31m\nb\" is no number").element("key\r").at("a\tb.csv");
        assert_eq!(e.to_string(), "a\\tb.csv: key\\r: \"a\\u{1b}[31m\\nb\" is no number");
        assert!(Error::input("x".repeat(1_000_000)).to_string().len() < 2100);
    }

    #[test]
    fn the_sentence_names_file_and_element() {
        let e = Error::input("x is NaN").element("vertex 7").at("airway.ply").at("other.ply");
        assert_eq!(e.to_string(), "airway.ply: vertex 7: x is NaN");
        assert_eq!(e.kind().exit_code(), 4);
    }
}
