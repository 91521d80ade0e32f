//! `respire-bench simulate`: films cases into sequence folders.

use std::path::PathBuf;

use clap::Args;

use super::Terminal;
use super::selection::{CatalogueFolder, ProfileChoice, TrackChoice};
use super::stopped::resumable;
use crate::airway::case::{Case, Condition, Effect};
use crate::base::range::{FRAMES, IMAGE_SIDE_PX, SAMPLES_PER_PIXEL};
use crate::base::{Error, Estimate, Progress, Result};
use crate::bench::profile::Profile;
use crate::simulate::track::Track;
use crate::simulate::truth::TruthMap;
use crate::simulate::{MeshOutput, RadianceOutput, SimulationSettings, material, participant, simulate};

/// Arguments of `simulate`.
#[derive(Args)]
#[command(
    after_help = "Writes one folder per case: DIR/<case> with images, depth, poses, phases and meshes (FORMAT.md there).\n\
    With --blind, what methods may see stands apart from the truth: `run --sequence DIR/participant --out P` answers, \
    `evaluate --truth DIR/truth --predictions P` scores. Whoever has the case file can film it again: a blind \
    comparison needs a case that is not published.\n\
    Example: respire-bench simulate case1 mine/own.toml --out /tmp/films --profile quick"
)]
pub struct SimulateArguments {
    /// Cases by id, or paths of case files
    #[arg(value_name = "CASE", required = true)]
    cases: Vec<String>,
    /// Folder for the sequences
    #[arg(long, value_name = "DIR", required_unless_present = "blind")]
    out: Option<PathBuf>,
    /// Films one case into DIR/truth, and writes what methods may see of it, and nothing else, to DIR/participant
    #[arg(long, value_name = "DIR", conflicts_with = "out")]
    blind: Option<PathBuf>,
    #[command(flatten)]
    profile: ProfileChoice,
    /// Frames, instead of the profile's
    #[arg(long, value_name = "N", value_parser = FRAMES.parser::<usize>())]
    frames: Option<usize>,
    /// Image width and height in pixels, instead of the profile's
    #[arg(long, value_name = "PX", value_parser = IMAGE_SIDE_PX.parser::<u32>())]
    width: Option<u32>,
    /// Paths per pixel, instead of the profile's
    #[arg(long, value_name = "N", value_parser = SAMPLES_PER_PIXEL.parser::<u32>())]
    spp: Option<u32>,
    /// Also writes the deformed mesh of every frame
    #[arg(long)]
    meshes: bool,
    /// Also writes the linear radiance of every frame as OpenEXR
    #[arg(long)]
    radiance: bool,
    /// Also writes these ground-truth images: normals, albedo, motion, phase-sensitivity
    #[arg(long, value_name = "MAP,..", value_delimiter = ',')]
    truth: Vec<TruthMap>,
    /// Switches effects of the scope off: emission, auto-exposure, lag, overshoot, gain-drift, white-balance,
    /// shot-noise, read-noise, vignette, distortion, motion-blur, mask, steering
    #[arg(long, value_name = "EFFECT,..", value_delimiter = ',')]
    without: Vec<Effect>,
    #[command(flatten)]
    track: TrackChoice,
    /// Switches rows of the clinical track off, by their names in docs/clinical.md
    #[arg(long, value_name = "ROW,..", value_delimiter = ',', conflicts_with = "only")]
    off: Vec<Condition>,
    /// Switches all other rows of the clinical track off
    #[arg(long, value_name = "ROW,..", value_delimiter = ',')]
    only: Vec<Condition>,
    #[command(flatten)]
    catalogue: CatalogueFolder,
}

/// Runs the command.
pub fn run(arguments: SimulateArguments, terminal: &Terminal) -> Result<()> {
    if arguments.blind.is_some() && arguments.cases.len() != 1 {
        return Err(Error::usage("--blind takes one case: the names of several would tell which they are"));
    }
    let track = arguments.track.track();
    if track == Track::Ideal && !(arguments.off.is_empty() && arguments.only.is_empty()) {
        return Err(Error::usage("--off and --only are for --track clinical"));
    }
    // Before the work.
    arguments.blind.iter().try_for_each(|blind| participant::check_replaceable(&blind.join("participant")))?;
    let catalogue = arguments.catalogue.open()?;
    let profile = Profile::load(&catalogue.profiles(), arguments.profile.name())?;
    let files: Vec<PathBuf> = arguments.cases.iter().map(|c| catalogue.case_file(c)).collect::<Result<_>>()?;
    let load = |file: &PathBuf| {
        let mut case = track.filming(Case::load(file)?).without(&profile.without).without(&arguments.without);
        if let Some(clinical) = &mut case.clinical {
            clinical.off.extend(&arguments.off);
            if !arguments.only.is_empty() {
                clinical.only = Some(arguments.only.clone());
            }
        }
        material(&case).map_err(|e| e.at(file))?;
        Ok(case)
    };
    let cases: Vec<Case> = files.iter().map(load).collect::<Result<_>>()?;
    for (place, case) in cases.iter().enumerate() {
        if let Some(first) = cases[..place].iter().position(|other| other.id == case.id) {
            let (id, first) = (&case.id, files[first].display());
            let sentence = format!("has the id {id}, as {first} has: a film would take the other one's place");
            return Err(Error::usage(sentence).at(&files[place]));
        }
    }
    let settings = |case: &Case| {
        let side = arguments.width.unwrap_or(profile.image_width_px);
        SimulationSettings {
            width_px: side,
            height_px: side,
            frames_per_second: profile.frames_per_second,
            frames: arguments.frames.unwrap_or_else(|| profile.frames(case.waveform.period_s())),
            samples_per_pixel: arguments.spp.unwrap_or(profile.samples_per_pixel),
            meshes: if arguments.meshes { MeshOutput::EveryFrame } else { MeshOutput::EndStates },
            radiance: if arguments.radiance { RadianceOutput::Exr } else { RadianceOutput::None },
            truth: arguments.truth.iter().copied().collect(),
            light: profile.light,
        }
    };
    // All of them are judged before the first is made.
    let mut all = Estimate { resumable: true, ..Estimate::default() };
    for case in &cases {
        settings(case).check()?;
        all = all.then(settings(case).estimate(case));
    }
    terminal.accepts(&all)?;
    for case in &cases {
        terminal.stage(format!("{}: filming", case.id));
        let folder = match (&arguments.blind, &arguments.out) {
            (Some(blind), _) => blind.join("truth"),
            (None, out) => out.clone().unwrap_or_default().join(&case.id),
        };
        let sequence = resumable(simulate(case, &settings(case), &folder, terminal))?;
        terminal.line(format!("{}: {} frames", sequence.root.display(), sequence.frames.len()));
        if let Some(blind) = &arguments.blind {
            let folder = blind.join("participant");
            participant::write(&sequence, &folder)?;
            terminal.line(format!("{}: what participants get", folder.display()));
        }
    }
    Ok(())
}
