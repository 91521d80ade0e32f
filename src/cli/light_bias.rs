//! `respire-bench light-bias`: how far the light of films is from path tracing.

use std::path::PathBuf;

use clap::builder::PossibleValuesParser;
use clap::{Args, builder::TypedValueParser};

use super::Terminal;
use super::selection::CatalogueFolder;
use super::stopped::resumable;
use crate::airway::case::Case;
use crate::base::range::{NumberRange, SHARE};
use crate::base::{Error, Estimate, Progress, Result, files};
use crate::experiments::light_bias::{self, BiasSweep, Look};
use crate::report::tables::write_csv;

/// Width in pixels of the compared images.
const WIDTH_PX: NumberRange = NumberRange::new(8.0, 1024.0);
/// Paths per pixel of a reference, which is made in parts.
const REFERENCE_SAMPLES: NumberRange = NumberRange::new(8.0, 65_536.0);

/// Arguments of `light-bias`.
#[derive(Args)]
#[command(
    after_help = "Films take light from the mesh's vertices; this compares their frames with path tracing: bias of the\n\
    mean radiance per channel with its standard error, relMSE, CPU seconds of a frame. Writes light-bias.csv and\n\
    light-bias.md into DIR after every case. References are kept and made anew when paths or cases have changed.\n\
    Example: respire-bench light-bias --cases case1 --phases 0,1 --out /tmp/light-bias"
)]
pub struct LightBiasArguments {
    /// Folder for the tables
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Cases by id, or paths of case files; all nine when not given
    #[arg(long, value_delimiter = ',', value_name = "CASE,..")]
    cases: Vec<String>,
    /// Looks of the wall; bare has neither vessels nor fine relief and an even film
    #[arg(long, value_delimiter = ',', value_name = "LOOK,..", default_value = "full,bare", value_parser = look_parser())]
    looks: Vec<Look>,
    /// Places of the camera, fractions of the route
    #[arg(long, value_delimiter = ',', value_name = "R,..", default_value = "0.1,0.3,0.5,0.7,0.9", value_parser = SHARE.parser::<f64>())]
    places: Vec<f64>,
    /// Breathing phases, 0 inspiration to 1 expiration
    #[arg(long, value_delimiter = ',', value_name = "R,..", default_value = "0,0.25,0.5,0.75,1", value_parser = SHARE.parser::<f64>())]
    phases: Vec<f64>,
    /// Image width and height in pixels
    #[arg(long, default_value_t = 128, value_name = "PX", value_parser = WIDTH_PX.parser::<u32>())]
    width: u32,
    /// Paths per pixel of a reference
    #[arg(long, default_value_t = 64, value_name = "N", value_parser = REFERENCE_SAMPLES.parser::<u32>())]
    reference_spp: u32,
    /// Folder of the references
    #[arg(long, default_value = ".cache/light-bias", value_name = "DIR")]
    cache: PathBuf,
    #[command(flatten)]
    catalogue: CatalogueFolder,
}

fn look_parser() -> impl TypedValueParser<Value = Look> {
    PossibleValuesParser::new(Look::ALL.map(|(_, name)| name))
        .map(|given| Look::ALL.into_iter().find(|(_, name)| *name == given).map_or(Look::Full, |(look, _)| look))
}

/// Compares, writes the tables and prints the summary.
pub fn run(arguments: LightBiasArguments, terminal: &Terminal) -> Result<()> {
    for (option, values) in [("--places", &arguments.places), ("--phases", &arguments.phases)] {
        if let Some(twice) = (1..values.len()).find(|&k| values[..k].contains(&values[k])) {
            let sentence = format!("{option}: {} stands there twice, and would count as two", values[twice]);
            return Err(Error::usage(sentence));
        }
    }
    let catalogue = arguments.catalogue.open()?;
    let cases = if arguments.cases.is_empty() { catalogue.case_ids()? } else { arguments.cases };
    let sweep = BiasSweep {
        looks: arguments.looks,
        places: arguments.places,
        phases: arguments.phases,
        width_px: arguments.width,
        reference_samples: arguments.reference_spp,
        cache: arguments.cache,
    };
    let one = sweep.estimate();
    terminal.accepts(&Estimate { seconds: cases.len() as f64 * one.seconds, ..one })?;
    let mut rows = Vec::new();
    for name in &cases {
        let case = Case::load(&catalogue.case_file(name)?)?;
        rows.extend(resumable(light_bias::rows(&case, &sweep, terminal))?);
        let table = light_bias::records(&rows, &sweep);
        write_csv(&arguments.out.join("light-bias.csv"), &light_bias::COLUMNS.map(String::from), &table)?;
        files::write_bytes(&arguments.out.join("light-bias.md"), light_bias::markdown(&rows, &sweep).as_bytes())?;
    }
    terminal.finish();
    terminal.line(light_bias::summary(&rows, &sweep));
    Ok(())
}
