//! A method that follows frames as they come: where they come from, which are left out, how long an answer takes.
//!
//! A thread of its own reads frames; the method takes the newest. Where it is slower than they come, those between are
//! left out, so that an answer is never about a picture of long ago.

use std::cell::Cell;
use std::collections::VecDeque;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use glam::{DAffine3, DMat4};
use serde::Serialize;

use super::catalogue::Catalogue;
use super::live_poses::LivePoses;
use super::pipeline::{SeededMethod, method_of};
use super::stages::caught;
use crate::base::{Camera, Error, Image, Progress, Result, files};
use crate::formats::png;
use crate::reconstruct::{self, ArrivedFrame, LiveAnswer, TrackState, WallMask};
use crate::simulate::participant::Given;

/// How often a folder is looked at for new pictures, and a wait asks whether it was called off.
const LOOK_AGAIN: Duration = Duration::from_millis(5);
/// Frames that wait at most where none is left out.
const WAITING: usize = 4;

/// Where pictures come from. What is known beforehand (camera, surfaces, first depth, poses) is the film's in each case.
pub enum FrameFeed {
    /// The film, as fast as it can be read.
    Film,
    /// The film at its own pace, as if it happened now.
    Paced,
    /// A folder in which PNG files appear, in the order of their names; ends when none has come for so long.
    Folder(PathBuf, Duration),
    /// Raw pictures one after the other, three bytes a pixel (ffmpeg's `rawvideo`, `rgb24`).
    Raw(Box<dyn Read + Send>),
}

impl FrameFeed {
    /// Whether frames are left out when the method is slower than they come.
    fn leaves_out(&self) -> bool {
        !matches!(self, FrameFeed::Film)
    }
}

/// How a film is followed.
pub struct LiveOptions {
    /// Where pictures come from.
    pub feed: FrameFeed,
    /// Times and poses in place of the film's: the lines of [`LivePoses`].
    pub poses: Option<PathBuf>,
    /// No frame is left out, however long it takes.
    pub every_frame: bool,
    /// Folder for a picture of each answer: what of the frame counted as wall.
    pub masks: Option<PathBuf>,
}

impl LiveOptions {
    /// Refuses masks in the folder of the pictures, over which they would be written.
    fn check(&self) -> Result<()> {
        let (FrameFeed::Folder(images, _), Some(masks)) = (&self.feed, &self.masks) else { return Ok(()) };
        let is_same = images.canonicalize().is_ok_and(|images| masks.canonicalize().is_ok_and(|masks| masks == images));
        match is_same {
            true => Err(Error::usage("--masks: names the folder of --images, whose pictures would be replaced")),
            false => Ok(()),
        }
    }
}

/// One line of `track`: the answer for one frame.
#[derive(Clone, Debug, Serialize)]
pub struct LiveLine {
    /// Number of the frame among all that came.
    pub frame: usize,
    /// Seconds since the first frame.
    pub time_s: f64,
    /// `tracking`, `unsure` or `lost`.
    pub state: &'static str,
    /// Breathing phase, 0 inspiration to 1 expiration.
    pub phase: f64,
    /// Its standard deviation.
    pub phase_deviation: Option<f64>,
    /// Rows of the matrix from the camera's axes to the world's, mm.
    pub world_from_camera: [[f64; 4]; 4],
    /// Where the targets are, mm.
    pub targets_mm: Vec<[f64; 3]>,
    /// Rows of the covariance of each target's place in the camera's axes, mm squared.
    pub target_covariance_mm2: Vec<[[f64; 3]; 3]>,
    /// Share of the picture that does not show the wall, where the method tells them apart.
    pub masked_share: Option<f64>,
    /// From the picture's arrival to the answer, milliseconds.
    pub latency_ms: f64,
    /// Frames left out just before.
    pub left_out: usize,
}

/// The picture that a line is about.
pub struct LivePicture {
    /// 8-bit sRGB, of the camera's size.
    pub image: Arc<Image<u8>>,
    mask: Option<WallMask>,
}

impl LivePicture {
    /// How much each pixel counted as wall, 0 to 255, drawn now; `None` where the method does not tell.
    pub fn wall(&self) -> Option<Image<u8>> {
        self.mask.as_ref().map(WallMask::picture)
    }
}

/// What a followed film came to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LiveSummary {
    /// Frames answered.
    pub frames: usize,
    /// Frames left out.
    pub left_out: usize,
    /// Latency of each answer in milliseconds, ascending.
    pub latencies_ms: Vec<f64>,
}

impl LiveSummary {
    /// The latency that the given share of answers stays within; 0 without any.
    pub fn latency_ms(&self, share: f64) -> f64 {
        let place = (share * self.latencies_ms.len() as f64).ceil() as usize;
        self.latencies_ms.get(place.saturating_sub(1)).copied().unwrap_or(0.0)
    }
}

/// A frame that waits, and since when.
struct Waiting {
    number: usize,
    since: Instant,
    frame: ArrivedFrame,
}

/// What reader and method share.
#[derive(Default)]
struct Queue {
    state: Mutex<QueueState>,
    changed: Condvar,
}

#[derive(Default)]
struct QueueState {
    waiting: VecDeque<Waiting>,
    /// How reading ended.
    ended: Option<Result<()>>,
    /// Nobody takes frames any more.
    abandoned: bool,
}

impl Queue {
    fn lock(&self) -> MutexGuard<'_, QueueState> {
        // A panic elsewhere leaves nothing half done in here.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a frame; false when nobody takes any. With `leaves_out`, those that wait are dropped, but for the first of
    /// all, with which a method begins; otherwise it waits for room.
    fn push(&self, mut new: Waiting, leaves_out: bool) -> bool {
        let mut state = self.lock();
        if leaves_out {
            while let Some(stale) = state.waiting.pop_back_if(|stale| stale.number > 0) {
                new.frame.left_out += stale.frame.left_out + 1;
            }
        } else {
            while state.waiting.len() >= WAITING && !state.abandoned {
                state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
            }
        }
        state.waiting.push_back(new);
        self.changed.notify_all();
        !state.abandoned
    }

    fn end(&self, how: Result<()>) {
        self.lock().ended = Some(how);
        self.changed.notify_all();
    }

    /// The next frame; `None` after the last.
    fn take(&self, progress: &dyn Progress) -> Result<Option<Waiting>> {
        let mut state = self.lock();
        loop {
            if let Some(next) = state.waiting.pop_front() {
                self.changed.notify_all();
                return Ok(Some(next));
            }
            if let Some(how) = state.ended.take() {
                return how.map(|()| None);
            }
            progress.proceed()?;
            state = self.changed.wait_timeout(state, 20 * LOOK_AGAIN).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}

/// A frame that the method has.
struct CurrentFrame {
    /// Among all that came.
    number: usize,
    /// Seconds since the first frame.
    time_s: f64,
    /// When it came.
    since: Instant,
    /// Frames left out just before.
    left_out: usize,
    image: Arc<Image<u8>>,
}

/// Lets a method follow `film` and hands each answer, with its picture, to `report`.
///
/// Errors: an unknown profile or method, one that does not follow frames; those of reading, of the method and of
/// `report`; masks from a method that has none, or among the pictures; `Interrupted` between frames.
pub fn follow(
    catalogue: &Catalogue,
    profile: &str,
    SeededMethod { id, seed }: SeededMethod<'_>,
    film: Arc<dyn Given>,
    options: LiveOptions,
    report: &mut dyn FnMut(&LiveLine, LivePicture) -> Result<()>,
    progress: &dyn Progress,
) -> Result<LiveSummary> {
    options.check()?;
    let method = method_of(catalogue, profile, id)?;
    let Some(live) = method.live() else {
        return Err(Error::usage(format!(
            "`{id}` takes whole films; `ours-gn`, `ours-gn-pose` and `ours-nav` follow frames"
        )));
    };
    let known = reconstruct::observe_first(film.as_ref(), method.access(), seed)?;
    let given = reconstruct::given_poses(film.as_ref(), method.access(), seed);
    let times = film.given_frames().into_iter().map(|frame| frame.time_s);
    let table: Vec<(f64, DAffine3)> = times.zip(given).collect();
    let masks = options.masks.clone();
    let queue = Arc::new(Queue::default());
    let reader = Reader { film, table, queue: Arc::clone(&queue), options };
    // Not joined: it may wait in a pipe for ever.
    std::thread::Builder::new()
        .name("frames".into())
        .spawn(move || {
            let queue = Arc::clone(&reader.queue);
            // A reader that panics has ended, too, and is not waited for.
            queue.end(caught(|| reader.run()));
        })
        .map_err(|e| Error::input(format!("cannot start a thread: {e}")))?;

    let mut summary = LiveSummary::default();
    let current: Cell<Option<CurrentFrame>> = Cell::new(None);
    let mut next = || -> Result<Option<ArrivedFrame>> {
        let Some(Waiting { number, since, frame }) = queue.take(progress)? else { return Ok(None) };
        let (time_s, left_out, image) = (frame.time_s, frame.left_out, Arc::clone(&frame.image));
        current.set(Some(CurrentFrame { number, time_s, since, left_out, image }));
        Ok(Some(frame))
    };
    let mut answer = |mut answer: LiveAnswer| -> Result<()> {
        let frame = current.take().expect("an answer follows a frame");
        let latency_ms = 1e3 * frame.since.elapsed().as_secs_f64();
        summary.frames += 1;
        summary.left_out += frame.left_out;
        summary.latencies_ms.push(latency_ms);
        let line = line(&answer, &frame, latency_ms);
        let picture = LivePicture { image: frame.image, mask: answer.mask.take() };
        if let Some(folder) = &masks {
            let untold = || Error::usage(format!("--masks: `{id}` does not tell the wall from what covers it"));
            png::write_grey(&folder.join(format!("{:06}.png", frame.number)), &picture.wall().ok_or_else(untold)?)?;
        }
        report(&line, picture)
    };
    let outcome = live.follow(&known, &mut next, &mut answer);
    queue.lock().abandoned = true;
    queue.changed.notify_all();
    outcome?;
    summary.latencies_ms.sort_by(f64::total_cmp);
    Ok(summary)
}

fn line(answer: &LiveAnswer, frame: &CurrentFrame, latency_ms: f64) -> LiveLine {
    let rows = DMat4::from(answer.world_from_camera).transpose().to_cols_array_2d();
    LiveLine {
        frame: frame.number,
        time_s: frame.time_s,
        state: match answer.state {
            TrackState::Tracking => "tracking",
            TrackState::Unsure => "unsure",
            TrackState::Lost => "lost",
        },
        phase: answer.phase,
        phase_deviation: answer.phase_deviation,
        world_from_camera: rows,
        targets_mm: answer.targets_mm.iter().map(|target| target.to_array()).collect(),
        target_covariance_mm2: answer.target_covariance_mm2.iter().map(|c| c.to_cols_array_2d()).collect(),
        masked_share: answer.masked_share,
        latency_ms,
        left_out: frame.left_out,
    }
}

/// The thread that reads.
struct Reader {
    film: Arc<dyn Given>,
    /// Time and pose of the film's frames.
    table: Vec<(f64, DAffine3)>,
    queue: Arc<Queue>,
    options: LiveOptions,
}

impl Reader {
    /// Reads until there are no more pictures, or nobody wants any.
    fn run(self) -> Result<()> {
        let Reader { film, table, queue, options: LiveOptions { mut feed, poses, every_frame, .. } } = self;
        let leaves_out = feed.leaves_out() && !every_frame;
        let mut poses = poses.as_deref().map(LivePoses::open).transpose()?;
        let start = Instant::now();
        // A film's poses are those of its pictures, and a picture that is missing would shift them.
        let mut folder = FolderNames { without_gaps: poses.is_none(), ..FolderNames::default() };
        for number in 0.. {
            let image = match &mut feed {
                FrameFeed::Film | FrameFeed::Paced if number >= table.len() => None,
                FrameFeed::Film => Some(film.given_image(number)?),
                FrameFeed::Paced => {
                    let image = film.given_image(number)?;
                    let due = Duration::try_from_secs_f64(table[number].0).unwrap_or_default();
                    std::thread::sleep(due.saturating_sub(start.elapsed()));
                    Some(image)
                }
                FrameFeed::Folder(path, patience) => folder.next(path, *patience, film.given_camera())?,
                FrameFeed::Raw(pipe) => {
                    raw_image(pipe, film.given_camera(), number).map_err(|e| e.at("standard input"))?
                }
            };
            let Some(image) = image else { return Ok(()) };
            let since = Instant::now();
            let missing = || Error::input("has come, and its pose has not").element(format!("frame {number}"));
            let (time_s, world_from_camera) = match &mut poses {
                None => *table.get(number).ok_or_else(missing)?,
                Some(poses) => poses.next_pose()?.ok_or_else(|| missing().at(poses.path()))?,
            };
            let frame = ArrivedFrame { image: Arc::new(image), time_s, world_from_camera, left_out: 0 };
            if !queue.push(Waiting { number, since, frame }, leaves_out) {
                return Ok(());
            }
        }
        Ok(())
    }
}

/// The next picture of a pipe; `None` where it ends between two pictures.
fn raw_image(pipe: &mut dyn Read, camera: Camera, number: usize) -> Result<Option<Image<u8>>> {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let mut data = vec![0; 3 * width * height];
    let mut filled = 0;
    while filled < data.len() {
        match pipe.read(&mut data[filled..]) {
            Ok(0) if filled == 0 => return Ok(None),
            Ok(0) => {
                let sentence = format!("ends after {filled} of {} bytes ({width}x{height}, rgb24)", data.len());
                return Err(Error::input(sentence).element(format!("frame {number}")));
            }
            Ok(count) => filled += count,
            Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
            Err(e) => return Err(Error::input(format!("cannot be read: {e}")).element(format!("frame {number}"))),
        }
    }
    Ok(Some(Image { width, height, channels: 3, data }))
}

/// The pictures of a folder that have been taken: all up to a name. Folders within it are not looked at: masks of the
/// answers may be among them.
#[derive(Default)]
struct FolderNames {
    last: Option<PathBuf>,
    /// How many have been taken.
    count: u64,
    /// Whether pictures that are numbered from 0 must all come.
    without_gaps: bool,
}

impl FolderNames {
    /// Waits for the picture that follows the last one by name; `None` when none has come for `patience`. A picture
    /// that cannot be read is taken to be half written until then, and one whose number leaves a gap to be early.
    fn next(&mut self, folder: &Path, patience: Duration, camera: Camera) -> Result<Option<Image<u8>>> {
        let start = Instant::now();
        let mut damaged = None;
        loop {
            let is_new = |name: &PathBuf| {
                name.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) && self.last.as_ref() < Some(name)
            };
            let next = files::names_in(folder)?.into_iter().filter(is_new).find(|name| folder.join(name).is_file());
            let gap = next.as_ref().filter(|name| self.leaves_gap(name)).map(|name| folder.join(name));
            if let Some(name) = next.filter(|_| gap.is_none()) {
                let path = folder.join(&name);
                match png::read_rgb(&path) {
                    Ok(image) => {
                        let size = (camera.width as usize, camera.height as usize);
                        if (image.width, image.height) != size {
                            let (width, height) = (image.width, image.height);
                            let sentence = format!("has {width}x{height} pixels, the camera {}x{}", size.0, size.1);
                            return Err(Error::input(sentence).at(path));
                        }
                        self.without_gaps &= number_of(&name) == Some(self.count);
                        self.last = Some(name);
                        self.count += 1;
                        return Ok(Some(image));
                    }
                    Err(error) => damaged = Some(error),
                }
            }
            if start.elapsed() >= patience {
                if let Some(path) = gap {
                    let wanted = self.count;
                    let is_there =
                        files::names_in(folder)?.iter().any(|name| number_of(Path::new(name)) == Some(wanted));
                    let sentence = match is_there {
                        true => format!("comes before picture {wanted} by its name: numbers need leading zeros"),
                        false => format!("has come, and picture {wanted} has not, so that its pose would be another's"),
                    };
                    return Err(Error::input(sentence).at(path));
                }
                return damaged.map_or(Ok(None), Err);
            }
            std::thread::sleep(LOOK_AGAIN);
        }
    }

    /// Whether a picture comes too early, of those that are numbered from 0.
    fn leaves_gap(&self, name: &Path) -> bool {
        self.without_gaps && self.count > 0 && number_of(name).is_some_and(|number| number > self.count)
    }
}

/// The number that a picture is called by, if it is called by nothing else.
fn number_of(name: &Path) -> Option<u64> {
    let stem = name.file_stem()?.to_str()?;
    stem.bytes().all(|b| b.is_ascii_digit()).then(|| stem.parse().ok())?
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::NoProgress;

    fn waiting(number: usize) -> Waiting {
        let image = Arc::new(Image { width: 1, height: 1, channels: 3, data: vec![0; 3] });
        let frame = ArrivedFrame { image, time_s: 0.0, world_from_camera: DAffine3::IDENTITY, left_out: 0 };
        Waiting { number, since: Instant::now(), frame }
    }

    #[test]
    fn the_newest_frame_is_taken_and_the_first_is_kept() {
        let queue = Queue::default();
        (0..5).for_each(|number| assert!(queue.push(waiting(number), true)));
        let taken = |queue: &Queue| queue.take(&NoProgress).unwrap().map(|w| (w.number, w.frame.left_out));
        assert_eq!(taken(&queue), Some((0, 0)));
        assert_eq!(taken(&queue), Some((4, 3)));
        queue.end(Ok(()));
        assert_eq!(taken(&queue), None);
    }

    #[test]
    fn a_pipe_that_ends_within_a_picture_is_told_apart_from_one_that_ends() {
        let camera = Camera::pinhole(2, 2, 1.0);
        let mut pipe: &[u8] = &[7; 12 + 5];
        assert_eq!(raw_image(&mut pipe, camera, 0).unwrap().unwrap().data, [7; 12]);
        let error = raw_image(&mut pipe, camera, 1).unwrap_err().to_string();
        assert!(error.contains("frame 1") && error.contains("5 of 12 bytes"), "{error}");
        assert!(raw_image(&mut pipe, camera, 2).unwrap().is_none());
    }

    #[test]
    fn a_folder_gives_its_own_pictures_by_name_and_none_of_the_folders_in_it() {
        let folder = tempfile::tempdir().unwrap();
        let mask = Image { width: 2, height: 2, channels: 1, data: vec![9; 4] };
        png::write_grey(&folder.path().join("masks/000000.png"), &mask).unwrap();
        for (name, value) in [("000001.PNG", 1), ("000000.png", 0), ("notes.txt", 7)] {
            png::write_rgb(&folder.path().join(name), &Image::filled(2, 2, 3, value)).unwrap();
        }
        let mut names = FolderNames::default();
        let mut next = || names.next(folder.path(), Duration::ZERO, Camera::pinhole(2, 2, 1.0)).unwrap();
        let taken: Vec<u8> = std::iter::from_fn(|| next().map(|image| image.data[0])).collect();
        assert_eq!(taken, [0, 1]);
    }

    #[test]
    fn a_picture_that_is_missing_shifts_no_poses() {
        let folder = tempfile::tempdir().unwrap();
        let taken = |names: &[&str], without_gaps: bool| -> Result<usize> {
            let _ = std::fs::remove_dir_all(folder.path());
            for name in names {
                png::write_rgb(&folder.path().join(name), &Image::filled(2, 2, 3, 0)).unwrap();
            }
            let mut names = FolderNames { without_gaps, ..FolderNames::default() };
            let mut count = 0;
            while names.next(folder.path(), Duration::ZERO, Camera::pinhole(2, 2, 1.0))?.is_some() {
                count += 1;
            }
            Ok(count)
        };
        let gap = ["000000.png", "000001.png", "000003.png"];
        let said = taken(&gap, true).unwrap_err().to_string();
        assert!(said.contains("000003.png: has come, and picture 2 has not"), "{said}");
        // Poses of their own come with the pictures, and other numbers are times.
        assert_eq!(taken(&gap, false).unwrap(), 3);
        assert_eq!(taken(&["1700000000.png", "1700000040.png"], true).unwrap(), 2);
        assert_eq!(taken(&["frame 000000.png", "frame 000003.png"], true).unwrap(), 2);
    }

    #[test]
    fn masks_replace_no_pictures() {
        let folder = tempfile::tempdir().unwrap();
        let check = |masks: &str| {
            let feed = FrameFeed::Folder(folder.path().to_owned(), Duration::ZERO);
            LiveOptions { feed, poses: None, every_frame: false, masks: Some(folder.path().join(masks)) }.check()
        };
        assert_eq!(check(".").unwrap_err().kind().exit_code(), 2);
        check("masks").unwrap();
    }

    #[test]
    fn latencies_are_ranked() {
        let summary = LiveSummary { frames: 4, left_out: 0, latencies_ms: vec![1.0, 2.0, 3.0, 9.0] };
        assert_eq!((summary.latency_ms(0.5), summary.latency_ms(0.99)), (2.0, 9.0));
        assert_eq!(LiveSummary::default().latency_ms(0.5), 0.0);
    }
}
