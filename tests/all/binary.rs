//! Runs the program as a user does.

use std::path::Path;
use std::process::{Command, Output};

/// The program that was built with these tests. What looks for it beside the running test finds an old one there.
pub const PROGRAM: &str = env!("CARGO_BIN_EXE_respire-bench");

/// The program, in the repository's root, with a small machine's threads.
pub fn program() -> Command {
    let mut command = Command::new(PROGRAM);
    command.current_dir(Path::new(env!("CARGO_MANIFEST_DIR")));
    command
}

/// Runs to the end: exit code, standard output, standard error.
pub fn run(arguments: &[&str]) -> (i32, String, String) {
    outcome(program().args(arguments).output().unwrap())
}

/// Exit code (a signal is -1), standard output, standard error.
pub fn outcome(output: Output) -> (i32, String, String) {
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.code().unwrap_or(-1), text(output.stdout), text(output.stderr))
}

/// Ctrl-C for a process, or for a group (its number with a minus), by the shell: a minimal system has no program `kill`.
pub fn interrupt(target: &str) {
    let told = Command::new("sh").args(["-c", "kill -s INT -- \"$0\"", target]).status().unwrap();
    assert!(told.success(), "{target}");
}
