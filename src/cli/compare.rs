//! `compare`: two runs side by side, with intervals.

use std::path::PathBuf;

use super::Terminal;
use crate::base::{Error, Progress, Result};
use crate::report::compare::{Change, Comparison, compare, differences_of_work, only_in_first};
use crate::report::read;
use crate::score::metric;

/// Arguments of `compare`.
#[derive(clap::Args)]
#[command(
    after_help = "Differences are B - A over the cases that both runs have, paired, with 95 % bootstrap bounds. Cases \
    whose films differ are named.\n\
    Example: respire-bench compare reports/reference/quick reports/latest/ideal --method ours"
)]
pub struct CompareArguments {
    /// First report folder
    #[arg(value_name = "A")]
    a: PathBuf,
    /// Second report folder
    #[arg(value_name = "B")]
    b: PathBuf,
    /// Only this method
    #[arg(long, value_name = "ID")]
    method: Option<String>,
    /// Write JSON
    #[arg(long)]
    json: bool,
}

/// Prints one line per method and metric.
pub fn run(arguments: CompareArguments, terminal: &Terminal) -> Result<()> {
    terminal.stage("reading the runs");
    let (a, b) = (read::read(&arguments.a)?, read::read(&arguments.b)?);
    a.check_track(&b).map_err(|e| e.at(&arguments.b))?;
    let others = a.other_films(&b);
    if !others.is_empty() {
        let sentence = "are of other films in B, so that differences there are not of the methods alone";
        terminal.note(&format!("{} {sentence}", others.join(", ")));
    }
    differences_of_work(&a, &b).iter().chain(&only_in_first(&a, &b)).for_each(|sentence| terminal.note(sentence));
    let mut found = compare(&a, &b);
    if let Some(wanted) = &arguments.method {
        for (run, folder) in [(&a, &arguments.a), (&b, &arguments.b)] {
            if !run.methods().contains(&wanted.as_str()) {
                let sentence = format!("has no method `{wanted}`; there are {}", run.methods().join(", "));
                return Err(Error::input(sentence).at(folder));
            }
        }
        found.retain(|c| c.method == *wanted);
    }
    if found.is_empty() {
        return Err(Error::input("the two runs share no case and method with a value").at(&arguments.b));
    }
    if arguments.json {
        return terminal.json(&found);
    }
    terminal.line(format_args!(
        "{:<20} {:<22} {:>5} {:>10} {:>10} {:>10} {:<24} change",
        "method", "metric", "cases", "A", "B", "B - A", "95 % interval"
    ));
    for c in &found {
        terminal.line(line(c).trim_end());
    }
    Ok(())
}

fn line(c: &Comparison) -> String {
    let show = |v: f64| match metric(c.metric) {
        Some(m) if v.is_finite() => m.format(v),
        _ => "-".to_owned(),
    };
    let interval = c.interval.map_or_else(String::new, |[low, high]| format!("{} to {}", show(low), show(high)));
    let change = match c.change {
        Change::Better => "better",
        Change::Worse => "worse",
        Change::Unclear => "unclear",
        Change::Same => "same",
        Change::Lost => "lost a value",
        Change::Single => "one case",
        Change::Few => "too few cases",
        Change::Machines => "another machine",
        Change::Redefined => "definition changed",
    };
    format!(
        "{:<20} {:<22} {:>5} {:>10} {:>10} {:>10} {interval:<24} {change}",
        c.method,
        c.metric,
        c.cases,
        show(c.a),
        show(c.b),
        show(c.difference)
    )
}
