//! Makes the scenes of a run from films and predictions, as long as these are at hand.

use glam::DVec3;
use rayon::prelude::*;

use super::run::{CaseInfo, Run};
use super::scene::{
    AirwayScene, FilmKey, FilmScene, Packed, Pictures, ReducedAirway, RowScene, Scenes, SurfaceScene, spread,
};
use crate::base::{Error, Image, Progress, Result, TriangleMesh};
use crate::formats::jpeg;
use crate::score::contour::ContourOverlay;
use crate::score::{Prediction, Question, Truth};
use crate::simulate::preview::shrunk;

/// Most frames that are kept of a film; four breaths at ten pictures a second are not needed to see what a row does.
const FRAMES: usize = 48;
/// Sides of a kept picture at most, in pixels: what `quick` films.
const SIDE_PX: usize = 128;
/// Quality of kept pictures, and of the whole film's.
const QUALITY: u8 = 82;
const WHOLE_QUALITY: u8 = 88;
/// Characters that all kept pictures of a run may take.
const PICTURE_CHARACTERS: usize = 9_000_000;
/// Vertices of an airway. The same in every run, so that what is known at vertices fits together when runs are merged.
const VERTICES: usize = 12_000;
/// Contours are kept to a tenth of a micrometre.
const CONTOUR_STEPS_PER_MM: f64 = 1e4;

/// Which frames are kept, and how.
#[derive(Clone, Copy)]
struct Keeping {
    frames: usize,
    side_px: usize,
    quality: u8,
    vertices: usize,
}

/// The scenes of a run: of its films and predictions where they are at hand, and otherwise those it was read with.
///
/// Errors: a film or prediction that cannot be read again.
pub fn gather(run: &Run, progress: &dyn Progress) -> Result<Scenes> {
    let keeping = Keeping { frames: FRAMES, side_px: SIDE_PX, quality: QUALITY, vertices: VERTICES };
    let mut scenes = run.scenes.clone();
    for (done, case) in run.cases.iter().enumerate() {
        if progress.cancelled() {
            return Err(Error::interrupted());
        }
        progress.advance(done, run.cases.len());
        if let Some(truth) = &case.truth {
            scenes.add(of_case(run, case, truth.as_ref(), keeping)?);
        }
    }
    Ok(scenes.thinned(PICTURE_CHARACTERS))
}

/// All frames of a case at full size, without its surface, which the report itself has. `None` without the film.
///
/// Errors: as [`gather`].
pub fn whole_film(run: &Run, case: &CaseInfo) -> Result<Option<Scenes>> {
    let keeping = Keeping { frames: usize::MAX, side_px: usize::MAX, quality: WHOLE_QUALITY, vertices: 0 };
    case.truth.as_ref().map(|truth| of_case(run, case, truth.as_ref(), keeping)).transpose()
}

fn of_case(run: &Run, case: &CaseInfo, truth: &dyn Truth, keeping: Keeping) -> Result<Scenes> {
    let frames = spread(truth.frames().len(), keeping.frames);
    let meshes = [truth.inspiration()?, truth.expiration()?];
    let airway = match keeping.vertices {
        0 => None,
        most => AirwayScene::of(&meshes[0], &meshes[1], most),
    };
    let question = Question::of(truth);
    let mut scenes = Scenes::default();
    for (_, cell, score) in run.shown(&case.id) {
        let prediction = Prediction::open(&cell.prediction, &question)?;
        let surface = match &airway {
            Some(airway) => surface(airway, &meshes, truth, &prediction)?,
            None => SurfaceScene::Unknown,
        };
        let places = |all: &[Vec<DVec3>]| {
            Packed::of_doubles(frames.iter().flat_map(|&f| &all[f]).flat_map(|place| place.to_array()))
        };
        scenes.rows.push(RowScene {
            film: FilmKey::of(score),
            method: cell.method.clone(),
            seed: cell.seed,
            pictures: pictures(&frames, keeping, |frame| prediction.color(frame))?,
            targets_mm: prediction.targets().map_or_else(Packed::default, places),
            surface,
            contours: score.overlay.as_ref().map(rounded),
        });
    }
    let records = truth.frames();
    let poses = records.iter().flat_map(|r| r.world_from_camera.to_cols_array());
    let targets = truth.targets();
    let ends = targets.iter().map(|t| t.inspiration_mm).chain(targets.iter().map(|t| t.expiration_mm));
    let camera = truth.camera();
    scenes.films.push(FilmScene {
        film: FilmKey {
            case_id: case.id.clone(),
            case_hash: truth.hash().to_owned(),
            content: truth.content().to_owned(),
        },
        title: case.title.clone(),
        times_s: Packed::of_doubles(records.iter().map(|r| r.time_s)),
        phases: Packed::of_doubles(records.iter().map(|r| r.phase)),
        poses: Packed::of_doubles(poses),
        tan_half_height: 0.5 * f64::from(camera.height) / camera.fl_y,
        targets_mm: Packed::of_doubles(ends.flat_map(|place| place.to_array())),
        airway: airway.map(|airway| airway.scene),
        pictures: pictures(&frames, keeping, |frame| truth.image(frame))?,
    });
    Ok(scenes)
}

fn pictures(frames: &[usize], keeping: Keeping, read: impl Fn(usize) -> Result<Image<u8>> + Sync) -> Result<Pictures> {
    let encoded = |&frame: &usize| {
        let image = shrunk(&read(frame)?, keeping.side_px);
        Ok(([image.width, image.height], Packed(jpeg::encode_rgb(&image, keeping.quality)?)))
    };
    let (sizes, jpeg): (Vec<_>, Vec<_>) =
        frames.par_iter().map(encoded).collect::<Result<Vec<_>>>()?.into_iter().unzip();
    let [width, height] = sizes.first().copied().unwrap_or([1, 1]);
    Ok(Pictures {
        frames: frames.iter().map(|&f| f as u32).collect(),
        width: width as u32,
        height: height as u32,
        jpeg,
    })
}

/// Where the row's surface is known point by point: the truth's faces, or a table of correspondences.
fn surface(
    airway: &ReducedAirway,
    meshes: &[TriangleMesh; 2],
    truth: &dyn Truth,
    prediction: &Prediction,
) -> Result<SurfaceScene> {
    let Some(predicted) = prediction.final_mesh()? else { return Ok(SurfaceScene::Unknown) };
    let Some(last) = truth.frames().last() else { return Ok(SurfaceScene::Unknown) };
    let places = match prediction.correspondence()? {
        Some(places) => places,
        None if predicted.faces == meshes[0].faces => predicted.vertices,
        None => return Ok(SurfaceScene::Unknown),
    };
    if places.len() != meshes[0].vertices.len() {
        return Ok(SurfaceScene::Unknown);
    }
    let stated = prediction.phase().and_then(|phases| phases.last().copied());
    Ok(airway.surface([&meshes[0], &meshes[1]], &places, last.phase, stated))
}

fn rounded(overlay: &ContourOverlay) -> ContourOverlay {
    let round = |point: [f64; 2]| point.map(|v| (v * CONTOUR_STEPS_PER_MM).round() / CONTOUR_STEPS_PER_MM);
    ContourOverlay {
        truth: overlay.truth.iter().map(|&p| round(p)).collect(),
        predicted: overlay.predicted.iter().map(|&p| round(p)).collect(),
        predicted_closed: overlay.predicted_closed,
        target_truth: round(overlay.target_truth),
        target_predicted: round(overlay.target_predicted),
    }
}
