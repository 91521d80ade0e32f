//! A test that skips something passes, and says so past the harness; where that is required, it fails.

use std::process::Command;

use crate::binary::outcome;
use crate::skip::skip;

/// Set where this test runs as its own child.
const CHILD: &str = "RESPIRE_SKIP_CHILD";

#[test]
fn what_is_skipped_is_seen_and_can_be_required() {
    if std::env::var_os(CHILD).is_some() {
        skip("elastix", "this is a test");
        println!("kept back");
        return;
    }
    let said = |required: &str| {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", "skip_is_seen::what_is_skipped_is_seen_and_can_be_required"]);
        command.env(CHILD, "1").env("RESPIRE_REQUIRE", required).env_remove("RUST_TEST_NOCAPTURE");
        outcome(command.output().unwrap())
    };
    for required in ["", "page,torch", "elastixes"] {
        let (code, out, err) = said(required);
        assert_eq!((code, err.as_str()), (0, "SKIPPED (elastix): this is a test\n"), "{required}: {out}");
        assert!(out.contains("1 passed") && !out.contains("kept back"), "{required}: {out}");
    }
    for required in ["elastix", "page,elastix", "all"] {
        let (code, out, err) = said(required);
        assert!(code != 0 && out.contains("asks for `elastix`: this is a test"), "{required}: {out}{err}");
    }
}
