//! What scoring needs from a sequence.

use std::path::PathBuf;

use glam::{DAffine3, DVec3};

use crate::airway::target::Target;
use crate::base::mesh::interpolate;
use crate::base::{Camera, Error, Image, Mask, Result, TriangleMesh};
use crate::simulate::participant::Given;
use crate::simulate::sequence::{FrameRecord, NovelView, Sequence};

/// A sequence with its ground truth.
pub trait Truth: Send + Sync {
    /// Which case was filmed.
    fn case_id(&self) -> &str;

    /// Content hash of everything that determines the sequence.
    fn hash(&self) -> &str;

    /// Hash of what the film itself holds: two films of one case may differ.
    fn content(&self) -> &str;

    /// The files that hold the truth; none for a truth that lies in memory.
    fn file_paths(&self) -> Vec<PathBuf>;

    /// Intrinsics of all frames.
    fn camera(&self) -> &Camera;

    /// Time, phase and pose of every frame.
    fn frames(&self) -> &[FrameRecord];

    /// 8-bit sRGB image of a frame.
    fn image(&self, frame: usize) -> Result<Image<u8>>;

    /// True z-depth of a frame in mm, 0 where nothing was hit.
    fn depth_mm(&self, frame: usize) -> Result<Image<f32>>;

    /// Views that no method fits, in order of their frames.
    fn novel_views(&self) -> &[NovelView];

    /// 8-bit sRGB image of the second camera of a frame.
    fn novel_image(&self, frame: usize) -> Result<Image<u8>>;

    /// True z-depth in mm of the second camera of a frame.
    fn novel_depth_mm(&self, frame: usize) -> Result<Image<f32>>;

    /// What navigation is after.
    fn targets(&self) -> &[Target];

    /// Where target `index` is at `frame`, mm.
    fn target_mm(&self, index: usize, frame: usize) -> DVec3 {
        self.targets()[index].at(self.frames()[frame].phase)
    }

    /// The pose of every frame as methods are told it.
    fn told_poses(&self) -> Vec<DAffine3> {
        self.frames().iter().map(|frame| frame.world_from_camera).collect()
    }

    /// Which frames a cough or a touch of the wall disturbs.
    fn disturbed(&self) -> Result<Vec<bool>> {
        Ok(vec![false; self.frames().len()])
    }

    /// The surface that methods are told, and the `correspondence.csv` of a row that keeps its faces; `None` where those
    /// are the true ones.
    fn told_correspondence(&self) -> Result<Option<(TriangleMesh, Vec<u8>)>> {
        Ok(None)
    }

    /// The surface at the last frame, where no phase says it.
    fn last_surface(&self) -> Result<Option<TriangleMesh>> {
        Ok(None)
    }

    /// Which pixels of all frames count; `None`: all.
    fn mask(&self) -> Result<Option<Mask>>;

    /// Surface at full inspiration.
    fn inspiration(&self) -> Result<TriangleMesh>;

    /// Surface at full expiration, same faces.
    fn expiration(&self) -> Result<TriangleMesh>;
}

impl Truth for Sequence {
    fn case_id(&self) -> &str {
        &self.case_id
    }

    fn hash(&self) -> &str {
        &self.hash
    }

    fn content(&self) -> &str {
        &self.content
    }

    fn file_paths(&self) -> Vec<PathBuf> {
        Sequence::file_paths(self).collect()
    }

    fn camera(&self) -> &Camera {
        &self.camera
    }

    fn frames(&self) -> &[FrameRecord] {
        &self.frames
    }

    fn image(&self, frame: usize) -> Result<Image<u8>> {
        Sequence::image(self, frame)
    }

    fn depth_mm(&self, frame: usize) -> Result<Image<f32>> {
        Sequence::depth_mm(self, frame)
    }

    fn novel_views(&self) -> &[NovelView] {
        &self.novel_views
    }

    fn novel_image(&self, frame: usize) -> Result<Image<u8>> {
        Sequence::novel_image(self, frame)
    }

    fn novel_depth_mm(&self, frame: usize) -> Result<Image<f32>> {
        Sequence::novel_depth_mm(self, frame)
    }

    fn targets(&self) -> &[Target] {
        &self.targets
    }

    fn target_mm(&self, index: usize, frame: usize) -> DVec3 {
        Sequence::target_mm(self, index, frame)
    }

    fn told_poses(&self) -> Vec<DAffine3> {
        self.given_frames().into_iter().map(|frame| frame.world_from_camera).collect()
    }

    fn disturbed(&self) -> Result<Vec<bool>> {
        Sequence::disturbed(self)
    }

    fn told_correspondence(&self) -> Result<Option<(TriangleMesh, Vec<u8>)>> {
        Sequence::told_correspondence(self)
    }

    fn last_surface(&self) -> Result<Option<TriangleMesh>> {
        Sequence::last_surface(self)
    }

    fn mask(&self) -> Result<Option<Mask>> {
        Sequence::mask(self)
    }

    fn inspiration(&self) -> Result<TriangleMesh> {
        Sequence::inspiration(self)
    }

    fn expiration(&self) -> Result<TriangleMesh> {
        Sequence::expiration(self)
    }
}

/// The true surface at the last frame: the end states blended by the true phase, where the film has no other motion.
pub fn final_mesh(truth: &dyn Truth) -> Result<TriangleMesh> {
    if let Some(surface) = truth.last_surface()? {
        return Ok(surface);
    }
    let last = truth.frames().last().ok_or_else(|| Error::input("the sequence has no frames"))?;
    let (inspiration, expiration) = (truth.inspiration()?, truth.expiration()?);
    if inspiration.vertices.len() != expiration.vertices.len() {
        return Err(Error::input(format!(
            "the end states of case {} have {} and {} vertices",
            truth.case_id(),
            inspiration.vertices.len(),
            expiration.vertices.len()
        )));
    }
    let vertices = interpolate(&inspiration.vertices, &expiration.vertices, last.phase);
    Ok(TriangleMesh { vertices, faces: inspiration.faces })
}
