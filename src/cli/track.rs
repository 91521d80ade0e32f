//! `track`: answers while the film goes on.

use std::path::PathBuf;
use std::time::Duration;

use super::Terminal;
use super::selection::CatalogueFolder;
use super::terminal::complain;
use crate::base::range::{NumberRange, SEED};
use crate::base::{Error, Progress, Result};
use crate::bench::live::{self, FrameFeed, LiveOptions};

/// Seconds without a new picture after which a folder has ended.
const PATIENCE_S: NumberRange = NumberRange::new(0.0, 86_400.0);

/// Arguments of `track`.
#[derive(clap::Args)]
#[command(
    after_help = "What is known beforehand (camera, surfaces, depth of the first frame, targets, times and poses) is \
    read from --sequence, a film or a participant's folder. Its pictures follow as fast as they can be answered \
    (the default, no frame is left out), at their own pace (--paced), or come from elsewhere: as PNG files that appear \
    in a folder (--images), or from a pipe, for instance\n  \
    ffmpeg -i /dev/video0 -f rawvideo -pix_fmt rgb24 - | respire-bench track --sequence DIR --raw --poses FIFO\n\
    Each line has frame, time_s, state (tracking, unsure, lost), phase and its standard deviation, pose, targets and \
    the covariance of their places, the latency and how many frames were left out. At the end latencies are printed \
    on standard error.\nExample: respire-bench track --sequence my/film --paced"
)]
pub struct TrackArguments {
    /// A film or a participant's folder
    #[arg(long, value_name = "DIR")]
    sequence: PathBuf,
    /// Method by id, one that follows frames
    #[arg(long, default_value = "ours-gn", value_name = "METHOD")]
    method: String,
    /// Seed of the method's randomness
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = SEED.parser::<u64>())]
    seed: u64,
    /// Size of the run: smoke, quick, paper, or the path of a profile file
    #[arg(long, default_value = "paper", value_name = "P")]
    profile: String,
    /// The film's own pictures at their own pace, as if it happened now
    #[arg(long, conflicts_with_all = ["images", "raw"])]
    paced: bool,
    /// Folder in which pictures appear as PNG files, in the order of their names
    #[arg(long, value_name = "DIR", conflicts_with = "raw")]
    images: Option<PathBuf>,
    /// Seconds without a new picture after which --images has ended
    #[arg(long, default_value_t = 10.0, value_name = "R", value_parser = PATIENCE_S.parser::<f64>())]
    patience_s: f64,
    /// Raw pictures of the camera's size on standard input, three bytes a pixel
    #[arg(long)]
    raw: bool,
    /// Times and poses in place of the film's: a file or FIFO with a line of JSON a frame, as docs/track.md has it
    #[arg(long, value_name = "FILE")]
    poses: Option<PathBuf>,
    /// Leave no frame out, however long it takes
    #[arg(long)]
    every_frame: bool,
    /// Folder for masks: a PNG for each answer, bright where the picture counted as wall (ours-nav)
    #[arg(long, value_name = "DIR")]
    masks: Option<PathBuf>,
    #[command(flatten)]
    catalogue: CatalogueFolder,
}

/// Follows, and prints a line for each answer.
pub fn run(arguments: TrackArguments, terminal: &Terminal) -> Result<()> {
    let feed = match (&arguments.images, arguments.raw, arguments.paced) {
        (Some(folder), ..) => FrameFeed::Folder(folder.clone(), Duration::from_secs_f64(arguments.patience_s)),
        (None, true, _) => FrameFeed::Raw(Box::new(std::io::stdin())),
        (None, false, true) => FrameFeed::Paced,
        (None, false, false) => FrameFeed::Film,
    };
    let options =
        LiveOptions { feed, poses: arguments.poses, every_frame: arguments.every_frame, masks: arguments.masks };
    let mut report = |line: &live::LiveLine| {
        if terminal.cancelled() {
            return Err(Error::interrupted());
        }
        terminal.line(serde_json::to_string(line).map_err(|e| Error::input(format!("cannot be written: {e}")))?);
        Ok(())
    };
    let method = (arguments.method.as_str(), arguments.seed);
    let catalogue = arguments.catalogue.open()?;
    let film = &arguments.sequence;
    let summary = live::follow(&catalogue, &arguments.profile, method, film, options, &mut report, terminal)?;
    complain(format_args!(
        "{} frames answered, {} left out; latency {:.1} ms (median), {:.1} ms (99 %)",
        summary.frames,
        summary.left_out,
        summary.latency_ms(0.5),
        summary.latency_ms(0.99)
    ));
    Ok(())
}
