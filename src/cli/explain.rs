//! `explain`: what a metric is.

use super::Terminal;
use crate::base::{Error, Result};
use crate::score::{Metric, Split, metric, registry};

/// Arguments of `explain`.
#[derive(clap::Args)]
#[command(after_help = "Without a metric: all of them, one line each.\nExample: respire-bench explain contour_rmse_mm")]
pub struct ExplainArguments {
    /// Metric id
    #[arg(value_name = "METRIC")]
    metric: Option<String>,
    /// Write JSON
    #[arg(long)]
    json: bool,
}

/// Prints definition, unit, range, direction and applicability.
pub fn run(arguments: ExplainArguments, terminal: &Terminal) -> Result<()> {
    let Some(id) = &arguments.metric else {
        if arguments.json {
            return terminal.json(&registry());
        }
        for m in registry() {
            terminal.line(format_args!("{:<29}{:<5}{:<8}{}", m.id, m.unit, m.direction.word(), m.label));
        }
        return Ok(());
    };
    let m = metric(id).ok_or_else(|| {
        let known: Vec<&str> = registry().iter().map(|m| m.id).collect();
        Error::usage(format!("there is no metric `{id}`; there are {}", known.join(", ")))
    })?;
    if arguments.json {
        return terminal.json(m);
    }
    print(m, terminal);
    Ok(())
}

fn print(m: &Metric, terminal: &Terminal) {
    let bound = |v: Option<f64>, without: &str| v.map_or_else(|| without.to_owned(), |v| v.to_string());
    let perfect = match m.perfect {
        Some(value) => value.to_string(),
        None if m.unit != "dB" => "none".to_owned(),
        None if m.split == Split::Novel => "no number: status `identical`".to_owned(),
        None => "no number: status `copied`, since methods are given these pictures".to_owned(),
    };
    let lines = [
        ("metric", format!("{} ({}), definition {}", m.id, m.label, m.definition_id())),
        ("unit", if m.unit.is_empty() { "none".to_owned() } else { m.unit.to_owned() }),
        ("better", m.direction.word().to_owned()),
        ("range", format!("{} to {}", bound(m.range[0], "unbounded"), bound(m.range[1], "unbounded"))),
        ("perfect", perfect),
        ("taken over", m.split.word().to_owned()),
        ("applies to", m.applies_to.words().to_owned()),
        ("definition", m.definition.to_owned()),
    ];
    for (name, value) in lines {
        terminal.line(format_args!("{name:<12}{value}"));
    }
}
