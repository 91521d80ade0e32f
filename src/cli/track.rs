//! `track`: answers while the film goes on.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use super::Terminal;
use super::selection::CatalogueFolder;
use super::terminal::complain;
use crate::base::range::{NumberRange, SEED};
use crate::base::{Error, ErrorKind, Progress, Result};
use crate::bench::SeededMethod;
use crate::bench::live::{self, FrameFeed, LiveOptions, LiveSummary};
use crate::bench::pipeline::open_given;
use crate::report::live::{LiveAddress, LiveEnd, LivePage, ShownFrame};
use crate::simulate::participant::Given;
use crate::simulate::sequence::holds_files_of;

/// Seconds without a new picture after which a folder has ended.
const PATIENCE_S: NumberRange = NumberRange::new(0.0, 86_400.0);
/// How often the page that is left open asks for Ctrl-C.
const LOOK_AGAIN: Duration = Duration::from_millis(50);

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
    on standard error.\n\
    --page shows all of it in a browser, and stays open after the last frame until Ctrl-C.\nExample: respire-bench track --sequence my/film --paced"
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
    /// Show the airway, the scope and the answers as a page at this address and port, 127.0.0.1:8080 unless named
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = "127.0.0.1:8080",
        value_parser = address_and_port)]
    page: Option<SocketAddr>,
    #[command(flatten)]
    catalogue: CatalogueFolder,
}

fn address_and_port(text: &str) -> Result<SocketAddr, String> {
    text.parse()
        .map_err(|_| "needs an address and a port, for instance 127.0.0.1:8080; port 0 is any free one".to_owned())
}

/// Serves the page and says where. Anyone who reaches another address than a loopback one sees the pictures.
fn serve(address: LiveAddress, arguments: &TrackArguments, film: &dyn Given) -> Result<LivePage> {
    let folder = arguments.sequence.canonicalize().unwrap_or_else(|_| arguments.sequence.clone());
    let name = folder.file_name().map_or_else(|| "film".into(), |name| name.to_string_lossy());
    let page = LivePage::serve(address, film, &name, &arguments.method)?;
    complain(format_args!("page: http://{}/", page.address()));
    Ok(page)
}

/// What the page says after the last frame.
fn end_of(outcome: &Result<LiveSummary>) -> LiveEnd {
    let none = LiveSummary::default();
    let (summary, error) = match outcome {
        Ok(summary) => (summary, None),
        Err(error) if error.kind() == ErrorKind::Interrupted => (&none, Some("by Ctrl-C".into())),
        Err(error) => (&none, Some(error.to_string())),
    };
    LiveEnd {
        frames: summary.frames,
        left_out: summary.left_out,
        latency_ms: [0.5, 0.99].map(|share| summary.latency_ms(share)),
        error,
    }
}

/// What follows nothing has gone wrong before: a camera that does not run, another folder.
fn no_picture(images: Option<&Path>) -> Error {
    match images {
        Some(folder) => Error::input("no picture appeared in it").at(folder),
        None => Error::input("no picture came").element("standard input"),
    }
}

/// Follows, and prints a line for each answer.
pub fn run(arguments: TrackArguments, terminal: &Terminal) -> Result<()> {
    if let Some(masks) = &arguments.masks
        && holds_files_of(&arguments.sequence, masks)
    {
        return Err(Error::usage("--masks: names a folder of the film, whose pictures would be replaced"));
    }
    // Before anything that takes long: the port may be in use.
    let address = arguments.page.map(LiveAddress::take).transpose()?;
    let catalogue = arguments.catalogue.open()?;
    let film: Arc<dyn Given> = open_given(&arguments.sequence)?.into();
    let page = address.map(|address| serve(address, &arguments, film.as_ref())).transpose()?;
    let feed = match (&arguments.images, arguments.raw, arguments.paced) {
        (Some(folder), ..) => FrameFeed::Folder(folder.clone(), Duration::from_secs_f64(arguments.patience_s)),
        (None, true, _) => FrameFeed::Raw(Box::new(std::io::stdin())),
        (None, false, true) => FrameFeed::Paced,
        (None, false, false) => FrameFeed::Film,
    };
    let options =
        LiveOptions { feed, poses: arguments.poses, every_frame: arguments.every_frame, masks: arguments.masks };
    let mut report = |line: &live::LiveLine, picture: live::LivePicture| {
        terminal.proceed()?;
        let line = serde_json::to_string(line).map_err(|e| Error::input(format!("cannot be written: {e}")))?;
        terminal.line(&line);
        if let Some(page) = &page {
            let image = Arc::clone(&picture.image);
            page.push(&line, ShownFrame { image, wall: Box::new(move || picture.wall()) });
        }
        Ok(())
    };
    let method = SeededMethod { id: &arguments.method, seed: arguments.seed };
    let outcome = live::follow(&catalogue, &arguments.profile, method, film, options, &mut report, terminal);
    let outcome = outcome.and_then(|summary| match summary.frames {
        0 => Err(no_picture(arguments.images.as_deref())),
        _ => Ok(summary),
    });
    if let Some(page) = &page {
        page.end(&end_of(&outcome));
    }
    let summary = outcome?;
    complain(format_args!(
        "{} frames answered, {} left out; latency {:.1} ms (median), {:.1} ms (99 %)",
        summary.frames,
        summary.left_out,
        summary.latency_ms(0.5),
        summary.latency_ms(0.99)
    ));
    if page.is_some() {
        complain("the film has ended; the page stays until Ctrl-C");
        while !terminal.cancelled() {
            std::thread::sleep(LOOK_AGAIN);
        }
    }
    Ok(())
}
