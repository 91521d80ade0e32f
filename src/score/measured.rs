//! What is measured on a prediction before any metric is computed: every picture, depth, phase, pose and target beside
//! the truth's.

use std::collections::HashMap;

use glam::{DAffine3, DQuat, DVec3};
use rayon::prelude::*;

use super::contour::{TargetErrors, target_errors};
use super::correspondence;
use super::depth::{DepthErrors, depth_errors};
use super::image_quality::{Psnr, Ssim, psnr_ceiling, psnr_within, ssim_within};
use super::navigation::{NavigationFrame, navigation_errors};
use super::prediction::Prediction;
use super::truth::{Truth, final_mesh};
use crate::base::{Error, Image, Mask, Result};
use crate::formats::prediction::CORRESPONDENCE;

/// All that metrics are computed from.
pub struct Measured<'a> {
    /// The film.
    pub truth: &'a dyn Truth,
    /// What is scored.
    pub prediction: &'a Prediction,
    /// Of each frame.
    pub pictures: Vec<FrameMeasurement>,
    /// Of each second camera, in the order of the film's.
    pub novel: Vec<NovelMeasurement>,
    /// Distance in mm of each predicted target to the true one, per frame; empty without a prediction.
    pub distances_mm: Vec<Vec<f64>>,
    /// Errors in the camera's axes, per frame; empty without predicted targets.
    pub navigation: Vec<NavigationFrame>,
    /// Surface and target at the last frame.
    pub target: TargetOutcome,
    /// PSNR in dB that a frame which equals the truth counts with beside others.
    pub ceiling_db: f64,
    /// Seed of the target vertex, and of the intervals.
    pub seed: u64,
}

/// What was measured of one frame.
#[derive(Clone, Copy)]
pub struct MeasuredFrame<'a> {
    /// Picture, depth, phase and pose.
    pub picture: &'a FrameMeasurement,
    /// The view of its second camera, where it has one.
    pub novel: Option<&'a NovelMeasurement>,
    /// Distance in mm of each predicted target to the true one; empty without a prediction.
    pub distances_mm: &'a [f64],
    /// Errors in the camera's axes, where targets are predicted.
    pub navigation: Option<&'a NavigationFrame>,
}

/// Everything measured on one frame.
pub struct FrameMeasurement {
    /// Of the picture.
    pub psnr: Psnr,
    /// Of the picture that was rendered before the frame's own was read, where there is one.
    pub psnr_ahead: Option<Psnr>,
    /// Of the picture.
    pub ssim: Ssim,
    /// `None`: no depth predicted. `Some(None)`: the frame has no true depth.
    pub depth: Option<Option<DepthErrors>>,
    /// Predicted minus true phase, without its sign.
    pub phase_error: Option<f64>,
    /// Standard deviation that the prediction states of its phase.
    pub phase_sd: Option<f64>,
    /// mm, degrees.
    pub pose_error: Option<[f64; 2]>,
}

/// What is measured on the view of a second camera.
pub struct NovelMeasurement {
    /// Of the picture; `None` where there is none.
    pub psnr: Option<Psnr>,
    /// Of the picture; `None` where there is none.
    pub ssim: Option<Ssim>,
    /// Of the picture against that of the frame's own camera, where the true ones differ by more than [`ALIKE_DB`]: in a
    /// dark moment all are alike.
    pub psnr_to_frame: Option<Psnr>,
    /// As in [`FrameMeasurement`].
    pub depth: Option<Option<DepthErrors>>,
}

/// PSNR in dB from which the pictures of a frame's two cameras are too alike to tell which one was handed in.
const ALIKE_DB: f64 = 45.0;

/// The outcome of the target metrics.
pub enum TargetOutcome {
    /// The prediction has no surface.
    NoSurface,
    /// The truth has no contour around the camera.
    NoTrueContour,
    /// Both have one.
    Measured(Box<TargetErrors>),
}

impl<'a> Measured<'a> {
    /// Measures every frame of the film, which has some.
    ///
    /// Errors: a file of either folder that is damaged or has another size.
    pub fn of(truth: &'a dyn Truth, prediction: &'a Prediction, seed: u64) -> Result<Self> {
        let mask = truth.mask()?;
        let pixels = truth.camera().width as usize * truth.camera().height as usize;
        let pixels = mask.as_ref().map_or(pixels, Mask::count);
        Ok(Measured {
            truth,
            prediction,
            pictures: (0..truth.frames().len())
                .into_par_iter()
                .map(|frame| measure(truth, prediction, mask.as_ref(), frame))
                .collect::<Result<_>>()?,
            novel: (truth.novel_views().par_iter())
                .map(|view| measure_novel(truth, prediction, mask.as_ref(), view.frame))
                .collect::<Result<_>>()?,
            distances_mm: target_distances(truth, prediction),
            navigation: navigation_errors(truth, prediction)?,
            target: target(truth, prediction, seed)?,
            ceiling_db: psnr_ceiling(pixels * 3),
            seed,
        })
    }

    /// Every frame, in order.
    pub fn frames(&self) -> impl Iterator<Item = MeasuredFrame<'_>> {
        let views = self.truth.novel_views().iter().enumerate().map(|(view, of)| (of.frame, view));
        let view_of: HashMap<usize, usize> = views.collect();
        (0..self.pictures.len()).map(move |frame| {
            let view = view_of.get(&frame).copied();
            MeasuredFrame {
                picture: &self.pictures[frame],
                novel: view.map(|view| &self.novel[view]),
                distances_mm: self.distances_mm.get(frame).map_or(&[], Vec::as_slice),
                navigation: self.navigation.get(frame),
            }
        })
    }
}

fn measure(truth: &dyn Truth, prediction: &Prediction, mask: Option<&Mask>, frame: usize) -> Result<FrameMeasurement> {
    let image = truth.image(frame)?;
    let color = prediction.color(frame)?;
    if !color.same_shape(&image) {
        return Err(Error::input(format!(
            "image of frame {frame} of case {} is not of the camera's size",
            truth.case_id()
        )));
    }
    let psnr_ahead = match prediction.ahead_frames().binary_search(&frame) {
        Ok(_) => Some(psnr_within(&prediction.ahead(frame)?, &image, mask)),
        Err(_) => None,
    };
    let depth = match prediction.depth_mm(frame)? {
        Some(depth) => Some(depth_within(&depth, truth.depth_mm(frame)?, mask)),
        None => None,
    };
    let phase_error = prediction.phase().map(|p| (p[frame] - truth.frames()[frame].phase).abs());
    let phase_sd = prediction.phase_sd().map(|sd| sd[frame]);
    let pose_error = prediction.poses().map(|p| pose_error(&p[frame], &truth.frames()[frame].world_from_camera));
    let (psnr, ssim) = (psnr_within(&color, &image, mask), ssim_within(&color, &image, mask)?);
    Ok(FrameMeasurement { psnr, psnr_ahead, ssim, depth, phase_error, phase_sd, pose_error })
}

fn measure_novel(
    truth: &dyn Truth,
    prediction: &Prediction,
    mask: Option<&Mask>,
    frame: usize,
) -> Result<NovelMeasurement> {
    let (mut psnr, mut ssim, mut psnr_to_frame) = (None, None, None);
    if prediction.has_novel_views() {
        let (image, color) = (truth.novel_image(frame)?, prediction.novel(frame)?);
        (psnr, ssim) = (Some(psnr_within(&color, &image, mask)), Some(ssim_within(&color, &image, mask)?));
        let of_frame = truth.image(frame)?;
        let differ = matches!(psnr_within(&of_frame, &image, mask), Psnr::Decibel(decibel) if decibel < ALIKE_DB);
        psnr_to_frame = differ.then(|| psnr_within(&color, &of_frame, mask));
    }
    let depth = prediction.novel_depth_mm(frame)?;
    let depth = depth.map(|depth| Ok(depth_within(&depth, truth.novel_depth_mm(frame)?, mask))).transpose()?;
    Ok(NovelMeasurement { psnr, ssim, psnr_to_frame, depth })
}

/// Depth errors where the mask shows something: pixels without true depth do not count.
fn depth_within(depth: &Image<f32>, mut true_depth: Image<f32>, mask: Option<&Mask>) -> Option<DepthErrors> {
    if let Some(mask) = mask {
        mask.hide(&mut true_depth, 0.0);
    }
    depth_errors(depth, &true_depth)
}

/// Distance in mm of each predicted target to the true one, per frame; empty without a prediction.
fn target_distances(truth: &dyn Truth, prediction: &Prediction) -> Vec<Vec<f64>> {
    let count = truth.targets().len();
    let of_frame = |(frame, places): (usize, &Vec<DVec3>)| {
        let off = |(index, place): (usize, &DVec3)| place.distance(truth.target_mm(index, frame));
        places.iter().take(count).enumerate().map(off).collect()
    };
    prediction
        .targets()
        .map_or_else(Vec::new, |all| all.iter().take(truth.frames().len()).enumerate().map(of_frame).collect())
}

/// Distance in mm between two poses, and the angle in degrees between them.
pub(super) fn pose_error(predicted: &DAffine3, truth: &DAffine3) -> [f64; 2] {
    let turn = DQuat::from_mat3(&(truth.matrix3.transpose() * predicted.matrix3));
    let angle = 2.0 * turn.xyz().length().atan2(turn.w.abs());
    [predicted.translation.distance(truth.translation), angle.to_degrees()]
}

fn target(truth: &dyn Truth, prediction: &Prediction, seed: u64) -> Result<TargetOutcome> {
    // Read first: a table without a surface is damage.
    let stated = prediction.correspondence()?;
    let Some(surface) = prediction.final_mesh()? else { return Ok(TargetOutcome::NoSurface) };
    let last = &truth.frames()[truth.frames().len() - 1];
    let places = match &stated {
        Some(_) => stated.clone(),
        None => correspondence::by_told_faces(truth, &surface)?,
    };
    let errors = target_errors(&final_mesh(truth)?, &surface, places.as_deref(), &last.world_from_camera, seed);
    let table = prediction.root().join(CORRESPONDENCE);
    let errors = errors.map_err(|e| if stated.is_some() { e.at(table) } else { e })?;
    Ok(errors.map_or(TargetOutcome::NoTrueContour, |e| TargetOutcome::Measured(Box::new(e))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_counts_where_the_mask_shows_something() {
        let depth = |mm: [f32; 4]| Image { width: 4, height: 1, channels: 1, data: mm.to_vec() };
        let shown = Image { width: 4, height: 1, channels: 1, data: vec![255, 255, 255, 0] };
        let mask = Mask::from_image(&shown).unwrap();
        // Exact, off by 1 mm, absent, hidden: the absent one counts with the farthest of what is shown.
        let found = depth_within(&depth([10.0, 21.0, 0.0, 5.0]), depth([10.0, 20.0, 40.0, 80.0]), Some(&mask)).unwrap();
        assert!((found.rmse_mm - ((1.0 + 1600.0) / 3.0f64).sqrt()).abs() < 1e-12, "{found:?}");
        assert_eq!((found.delta_1_25, found.coverage), (2.0 / 3.0, 2.0 / 3.0));
    }
}
