//! What cannot be tested on this machine: said where everybody sees it, and a failure where it is asked for. The unit
//! tests of the library share this file (`src/lib.rs`).

use std::io::Write;
use std::path::{Path, PathBuf};

/// Says that something is not tested: `what` is missing ("elastix"), `why` is the sentence.
///
/// It goes to standard error by itself, since the test harness keeps back what a passing test prints by `println!` and
/// `eprintln!`. Panics where `RESPIRE_REQUIRE`, names with commas between, has `what` or "all" (CONTRIBUTING.md lists
/// the names; the scripts read the same variable, `scripts/packages.sh`).
pub fn skip(what: &str, why: &str) {
    let required = std::env::var("RESPIRE_REQUIRE").unwrap_or_default();
    let is_required = required.split(',').any(|name| name == what || name == "all");
    assert!(!is_required, "not tested, and RESPIRE_REQUIRE={required} asks for `{what}`: {why}");
    // In one call, so that lines of tests that run at once do not mix. A closed standard error fails no test.
    let _ = std::io::stderr().write_all(format!("SKIPPED ({what}): {why}\n").as_bytes());
}

/// A file or folder below `../shared`, reference data that is not part of the repository; `None` where it is absent,
/// which is said.
pub fn shared(part: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared").join(part);
    if !path.exists() {
        skip("shared", &format!("{} is absent", path.display()));
        return None;
    }
    Some(path)
}
