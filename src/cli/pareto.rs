//! `respire-bench pareto`: cost against error of many settings, with the front marked and the default on it. One file
//! per kind: `pareto_<kind>.rs` with its arguments and `run`, and two lines here.

use clap::{Args, Subcommand};

use super::Terminal;
use crate::base::Result;
use crate::experiments::pareto::{phase as pareto_phase, render as pareto_render, splat as pareto_splat};

/// Arguments of `pareto`.
#[derive(Args)]
#[command(after_help = "Each kind writes pareto-KIND.csv, .svg and .png into DIR.\n\
    Example: respire-bench pareto render --out /tmp/pareto")]
pub struct Arguments {
    #[command(subcommand)]
    kind: Kind,
}

#[derive(Subcommand)]
enum Kind {
    /// Path tracer: time against relative error of its modes, on a frame of each of three cases
    Render(pareto_render::Arguments),
    /// Tracking: time against phase error of Adam and Gauss-Newton, on three cases
    Phase(pareto_phase::Arguments),
    /// Rasteriser: time against error of kernels, threads, precisions, footprints, filters and blocks; what skipping saves
    Splat(pareto_splat::Arguments),
}

/// Runs the command.
pub fn run(arguments: Arguments, terminal: &Terminal) -> Result<()> {
    match arguments.kind {
        Kind::Render(arguments) => pareto_render::run(arguments, terminal),
        Kind::Phase(arguments) => pareto_phase::run(arguments, terminal),
        Kind::Splat(arguments) => pareto_splat::run(arguments, terminal),
    }
}
