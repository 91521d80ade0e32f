//! `list`: cases, methods, metrics, and the cells of a plan, of every track that it runs.

use serde_json::json;

use super::Terminal;
use super::selection::{Selection, TracksChoice};
use crate::base::Result;
use crate::bench::Cell;
use crate::report::MethodInfo;
use crate::score;
use crate::simulate::track::Track;

/// Arguments of `list`.
#[derive(clap::Args)]
#[command(after_help = "Example: respire-bench list --json --profile smoke")]
pub struct ListArguments {
    #[command(flatten)]
    selection: Selection,
    #[command(flatten)]
    tracks: TracksChoice,
    /// Write JSON: {"cases": [..], "methods": [..], "metrics": [..], "cells": [..]}
    #[arg(long)]
    json: bool,
}

/// Prints the lists.
pub fn run(arguments: ListArguments, terminal: &Terminal) -> Result<()> {
    let tracks = arguments.tracks.tracks(&arguments.selection)?;
    let mut methods: Vec<MethodInfo> = Vec::new();
    let (mut cases, mut cells) = (Vec::new(), Vec::new());
    for &track in &tracks {
        let pipeline = arguments.selection.pipeline(track)?;
        let is_new = |info: &MethodInfo| methods.iter().all(|known| known.id != info.id);
        let new: Vec<MethodInfo> = pipeline.method_infos().into_iter().filter(is_new).collect();
        methods.extend(new);
        cells.extend(pipeline.plan()?.cells().into_iter().map(|cell| (track, cell)));
        // Those of every track.
        cases = pipeline.cases().to_vec();
    }
    if arguments.json {
        let cases: Vec<_> = cases.iter().map(|c| json!({"id": c.id, "title": c.title})).collect();
        let methods: Vec<_> = methods.iter().map(|m| json!({"id": m.id, "title": m.title})).collect();
        let cell = |(track, c): &(Track, Cell)| json!({"id": c.id(), "track": track.word(), "case_id": c.case_id, "method": c.method, "seed": c.seed});
        let cells: Vec<_> = cells.iter().map(cell).collect();
        let metrics = score::registry();
        return terminal.json(&json!({"cases": cases, "methods": methods, "metrics": metrics, "cells": cells}));
    }
    terminal.line("cases");
    for case in &cases {
        terminal.line(format_args!("  {:<22}{}", case.id, case.title));
    }
    terminal.line("methods");
    for method in &methods {
        terminal.line(format_args!("  {:<22}{}", method.id, method.title));
    }
    terminal.line("metrics");
    for metric in score::registry() {
        let direction = format!("{} is better", metric.direction.word());
        terminal.line(format_args!("  {:<29}{:<8}{direction}", metric.id, metric.unit));
    }
    terminal.line(format_args!("cells of profile {}: {}", arguments.selection.profile_name(), cells.len()));
    for (track, cell) in &cells {
        match tracks.len() {
            1 => terminal.line(format_args!("  {}", cell.id())),
            _ => terminal.line(format_args!("  {:<36}{}", cell.id(), track.word())),
        }
    }
    Ok(())
}
