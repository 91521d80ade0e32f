//! What an export may hand out of a film: what methods may see, and the truth where it was asked for.

use std::path::Path;

use crate::base::{Camera, Error, Image, Mask, Result, TriangleMesh};
use crate::simulate::participant::{Given, GivenFrame, Participant};
use crate::simulate::sequence::{FrameRecord, Sequence, held_out};

/// Whether the truth goes out too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportedTruth {
    /// Only what a participant may see: images, given poses, intrinsics, mask, times, the two given surfaces.
    Hidden,
    /// The depth of every frame and the true surfaces too, and camera and poses as they were, which are told otherwise
    /// on the clinical track.
    Shown,
}

/// An opened film, whole or a participant's.
pub struct ExportSource {
    given: Box<dyn Given>,
    /// The film, where its truth may go out.
    truth: Option<Sequence>,
    /// Whether the film is known to be of the clinical track.
    is_clinical: bool,
    /// Intrinsics of all frames: the true ones where the truth is shown, else the given ones.
    pub camera: Camera,
    /// Time of each frame, and its true or given pose.
    pub frames: Vec<GivenFrame>,
    /// Which pixels show something; `None`: all.
    pub mask: Option<Mask>,
}

impl ExportSource {
    /// Opens the film or the participant's folder in `root`. Errors: a participant's folder of which the truth is
    /// wanted; those of opening.
    pub fn open(root: &Path, truth: ExportedTruth) -> Result<ExportSource> {
        let (given, truth, is_clinical): (Box<dyn Given>, _, _) = if Participant::is_at(root) {
            if truth == ExportedTruth::Shown {
                return Err(Error::input("is a participant's folder, which holds no truth to export").at(root));
            }
            let participant = Participant::open(root)?;
            let is_clinical = participant.given_poses_are_measured();
            (Box::new(participant), None, is_clinical)
        } else {
            let film = Sequence::open(root)?;
            let shown = (truth == ExportedTruth::Shown).then(|| film.clone());
            let is_clinical = film.clinical.is_some();
            (Box::new(film), shown, is_clinical)
        };
        let as_it_was = |f: &FrameRecord| GivenFrame { time_s: f.time_s, world_from_camera: f.world_from_camera };
        let (camera, frames) = match &truth {
            Some(film) => (film.camera, film.frames.iter().map(as_it_was).collect()),
            None => (given.given_camera(), given.given_frames()),
        };
        let mask = given.given_mask()?;
        Ok(ExportSource { given, truth, is_clinical, camera, frames, mask })
    }

    /// The 8-bit sRGB image of a frame.
    pub fn image(&self, frame: usize) -> Result<Image<u8>> {
        self.given.given_image(frame)
    }

    /// Whether the film is known to be of the clinical track, where camera, poses and surfaces that are told are not true.
    pub fn is_clinical(&self) -> bool {
        self.is_clinical
    }

    /// Whether the truth goes out.
    pub fn shows_truth(&self) -> bool {
        self.truth.is_some()
    }

    /// What EXPORT.md says of a film of the clinical track; `None` for any other.
    pub fn track_words(&self) -> Option<&'static str> {
        match self.is_clinical {
            false => None,
            true if self.shows_truth() => Some(include_str!("about/clinical_truth.md")),
            true => Some(include_str!("about/clinical_told.md")),
        }
    }

    /// True z-depth of a frame in mm, 0 where nothing was hit. An error where the truth is hidden.
    pub fn depth_mm(&self, frame: usize) -> Result<Image<f32>> {
        let hidden = || Error::usage("the depth of every frame is truth; say --truth to export it");
        self.truth.as_ref().ok_or_else(hidden)?.depth_mm(frame)
    }

    /// The surface at full inspiration: the true one where the truth is shown, else the given one.
    pub fn inspiration(&self) -> Result<TriangleMesh> {
        self.truth.as_ref().map_or_else(|| self.given.given_inspiration(), Sequence::inspiration)
    }

    /// The surface at full expiration: the true one where the truth is shown, else the registered one.
    pub fn expiration(&self) -> Result<TriangleMesh> {
        self.truth.as_ref().map_or_else(|| self.given.given_expiration(), Sequence::expiration)
    }

    /// Mean duration of a breath in seconds.
    pub fn period_s(&self) -> f64 {
        self.given.given_period_s()
    }

    /// The frames that methods of this benchmark render before they see them (7, 15, ..); of a shorter film the last.
    pub fn test_frames(&self) -> Vec<usize> {
        let count = self.frames.len();
        let held: Vec<usize> = (0..count).filter(|&frame| held_out(frame)).collect();
        if held.is_empty() { vec![count - 1] } else { held }
    }

    /// All other frames.
    pub fn train_frames(&self) -> Vec<usize> {
        let test = self.test_frames();
        (0..self.frames.len()).filter(|frame| !test.contains(frame)).collect()
    }

    /// The mask as an image: 255 where pixels count.
    pub fn mask_image(&self) -> Option<Image<u8>> {
        let mask = self.mask.as_ref()?;
        let data = (0..mask.width * mask.height).map(|pixel| if mask.shows(pixel) { 255 } else { 0 }).collect();
        Some(Image { width: mask.width, height: mask.height, channels: 1, data })
    }

    /// Mean colour of the pixels of the first frame that count: what a wall of this film looks like.
    pub fn wall_color(&self) -> Result<[u8; 3]> {
        let image = self.image(0)?;
        let (mut sums, mut count) = ([0u64; 3], 0u64);
        for (pixel, color) in image.data.chunks_exact(3).enumerate() {
            if self.mask.as_ref().is_none_or(|mask| mask.shows(pixel)) {
                sums.iter_mut().zip(color).for_each(|(sum, &code)| *sum += u64::from(code));
                count += 1;
            }
        }
        Ok(sums.map(|sum| (sum / count.max(1)) as u8))
    }
}
