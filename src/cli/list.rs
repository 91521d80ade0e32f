//! `list`: cases, methods, metrics, and the cells of a plan.

use serde_json::json;

use super::Terminal;
use super::selection::Selection;
use crate::base::Result;
use crate::score;
use crate::simulate::track::Track;

/// Arguments of `list`.
#[derive(clap::Args)]
#[command(after_help = "Example: respire-bench list --json --profile smoke")]
pub struct ListArguments {
    #[command(flatten)]
    selection: Selection,
    /// Write JSON: {"cases": [..], "methods": [..], "metrics": [..], "cells": [..]}
    #[arg(long)]
    json: bool,
}

/// Prints the lists.
pub fn run(arguments: ListArguments, terminal: &Terminal) -> Result<()> {
    let pipeline = arguments.selection.pipeline(Track::Ideal)?;
    let plan = pipeline.plan()?;
    let cells = plan.cells();
    if arguments.json {
        let cases: Vec<_> = pipeline.cases().iter().map(|c| json!({"id": c.id, "title": c.title})).collect();
        let methods: Vec<_> = pipeline.method_infos().iter().map(|m| json!({"id": m.id, "title": m.title})).collect();
        let cells: Vec<_> = cells
            .iter()
            .map(|c| json!({"id": c.id(), "case_id": c.case_id, "method": c.method, "seed": c.seed}))
            .collect();
        let metrics = score::registry();
        return terminal.json(&json!({"cases": cases, "methods": methods, "metrics": metrics, "cells": cells}));
    }
    terminal.line("cases");
    for case in pipeline.cases() {
        terminal.line(format_args!("  {:<22}{}", case.id, case.title));
    }
    terminal.line("methods");
    for method in pipeline.method_infos() {
        terminal.line(format_args!("  {:<22}{}", method.id, method.title));
    }
    terminal.line("metrics");
    for metric in score::registry() {
        let direction = format!("{} is better", metric.direction.word());
        terminal.line(format_args!("  {:<29}{:<8}{direction}", metric.id, metric.unit));
    }
    terminal.line(format_args!("cells of profile {}: {}", plan.profile, cells.len()));
    for cell in cells {
        terminal.line(format_args!("  {}", cell.id()));
    }
    Ok(())
}
