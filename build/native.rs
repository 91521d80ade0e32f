//! Runs the native part of the build only when something native changed: this script runs for every changed source file
//! (`revision.rs`), and a changed comment must not recompile the C++ kernels.
//!
//! `cc` writes its instructions for cargo to standard output, which a program cannot read back. So the script calls
//! itself for the native part, keeps the output, and repeats it when nothing native changed.

use std::env;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

/// Set in the call that does the native part.
const INNER: &str = "RESPIRE_BENCH_BUILD_NATIVE";

/// True in the call that does the native part.
pub fn is_inner_call() -> bool {
    env::var_os(INNER).is_some()
}

/// Does the native part, or repeats its output when it was last done for the same `state`.
pub fn once(state: &str, out: &Path) {
    let (kept_state, kept_words) = (out.join("native.state"), out.join("native.words"));
    if fs::read_to_string(&kept_state).is_ok_and(|kept| kept == state)
        && let Ok(words) = fs::read_to_string(&kept_words)
    {
        print!("{words}");
        return;
    }
    let program = env::current_exe().expect("a running program has a path");
    let inner = Command::new(program).env(INNER, "1").stderr(Stdio::inherit()).output().expect("this program runs");
    let words = String::from_utf8_lossy(&inner.stdout);
    print!("{words}");
    assert!(inner.status.success(), "the native part of the build failed; its words stand above");
    fs::write(kept_words, words.as_bytes()).expect("OUT_DIR is writable");
    fs::write(kept_state, state).expect("OUT_DIR is writable");
}
