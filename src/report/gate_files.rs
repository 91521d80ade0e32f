//! The gate's verdicts as files: JUnit XML for CI, Markdown for people.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

use quick_junit::{NonSuccessKind, Report, TestCase, TestCaseStatus, TestSuite};

use super::gate::{Check, Verdict};
use super::markdown::escape;
use crate::base::{Error, Result, files};

/// CI summaries are cut off above a megabyte; the verdict must not be.
const MARKDOWN_BUDGET: usize = 900_000;

/// `gate.xml`: one test case per case x method, its failure text the sentences that failed.
pub fn write_junit(checks: &[Check], path: &Path) -> Result<()> {
    let mut report = Report::new("respire-bench gate");
    let mut suite = TestSuite::new("gate");
    let mut places: BTreeMap<(&str, &str), Vec<&Check>> = BTreeMap::new();
    for check in checks {
        places.entry((&check.case, &check.method)).or_default().push(check);
    }
    for ((case, method), of_place) in places {
        let failed = of_place.iter().filter(|c| c.verdict == Verdict::Fail);
        let failed: Vec<String> = failed.map(|c| named(c)).collect();
        let status = match failed.as_slice() {
            [] => TestCaseStatus::success(),
            sentences => {
                let mut status = TestCaseStatus::non_success(NonSuccessKind::Failure);
                status.set_message(sentences.join("; "));
                status.set_description(sentences.join("\n"));
                status
            }
        };
        let mut test = TestCase::new(if method.is_empty() { "run".to_owned() } else { method.to_owned() }, status);
        test.set_classname(if case.is_empty() { "run" } else { case });
        let line = |c: &&Check| format!("{} {}", c.verdict.word(), named(c));
        let lines: Vec<String> = of_place.iter().map(line).collect();
        test.set_system_out(lines.join("\n"));
        suite.add_test_case(test);
    }
    report.add_test_suite(suite);
    let text = report.to_string().map_err(|e| Error::input(format!("encoding as JUnit XML failed: {e}")).at(path))?;
    files::write_bytes(path, without_skipped(&text).as_bytes())
}

/// The same without the attribute `skipped` of the root, which the schema of Jenkins' plugin does not know there.
fn without_skipped(junit: &str) -> String {
    const NAME: &str = " skipped=\"";
    let cut = || {
        let end = junit.find("<testsuites").and_then(|root| Some(root + junit[root..].find('>')?))?;
        let start = junit[..end].find(NAME)?;
        let length = NAME.len() + junit[start + NAME.len()..].find('"')? + 1;
        Some(junit[..start].to_owned() + &junit[start + length..])
    };
    cut().unwrap_or_else(|| junit.to_owned())
}

/// The sentence of a check, behind the metric it is about, if it is about one.
fn named(check: &Check) -> String {
    let metric = if check.metric.is_empty() { String::new() } else { format!("{}: ", check.metric) };
    metric + &check.sentence
}

/// `gate.md`: the verdict first, then what failed, then the rest folded.
pub fn markdown(checks: &[Check]) -> String {
    let count = |verdict: Verdict| checks.iter().filter(|c| c.verdict == verdict).count();
    let failed = count(Verdict::Fail);
    let mut out = format!(
        "# Gate: {}\n\n{} checks, {failed} failed, {} notes.\n\n",
        if failed == 0 { "passed" } else { "FAILED" },
        checks.len(),
        count(Verdict::Note)
    );
    let table = |out: &mut String, verdict: Verdict| {
        let _ = writeln!(out, "| Verdict | Case | Method | Metric | |\n|---|---|---|---|---|");
        for c in checks.iter().filter(|c| c.verdict == verdict) {
            if out.len() > MARKDOWN_BUDGET {
                let _ = writeln!(out, "| | | | | the rest is left out; see gate.xml |");
                break;
            }
            let [case, method, metric, sentence] = [&c.case, &c.method, &c.metric, &c.sentence].map(|t| escape(t));
            let _ = writeln!(out, "| {} | {case} | {method} | {metric} | {sentence} |", verdict.word());
        }
        out.push('\n');
    };
    if failed > 0 {
        table(&mut out, Verdict::Fail);
    }
    for (verdict, name) in [(Verdict::Note, "Notes"), (Verdict::Pass, "Passed")] {
        if count(verdict) > 0 {
            let _ = writeln!(out, "<details><summary>{name}: {}</summary>\n", count(verdict));
            table(&mut out, verdict);
            out.push_str("</details>\n\n");
        }
    }
    out
}
