//! Makes the scenes of a run from films and predictions, as long as these are at hand.

use glam::DVec3;
use rayon::prelude::*;

use super::html::film_page;
use super::page_data;
use super::run::{CaseInfo, Run};
use super::scene::{
    AIRWAY_VERTICES, AirwayScene, FilmKey, FilmScene, Packed, Pictures, ReducedAirway, RowScene, Scenes, SurfaceScene,
    spread,
};
use super::seal;
use crate::base::{Image, Progress, Result, TriangleMesh, files};
use crate::formats::jpeg;
use crate::score::contour::ContourOverlay;
use crate::score::{Prediction, Question, Truth, by_told_faces};
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
    let keeping = Keeping { frames: FRAMES, side_px: SIDE_PX, quality: QUALITY, vertices: AIRWAY_VERTICES };
    let mut scenes = run.scenes.clone();
    for (done, case) in run.cases.iter().enumerate() {
        progress.proceed()?;
        progress.advance(done, run.cases.len());
        if let Some(truth) = &case.truth {
            scenes.add(of_case(run, case, truth.as_ref(), keeping)?);
        }
    }
    Ok(scenes.thinned(PICTURE_CHARACTERS))
}

/// All frames of a case at full size, without its surface, which the report itself has: of its film, where it is at hand,
/// and else of the reports that the run was read from. `None` where neither has it.
///
/// Errors: as [`gather`]; a page of those reports that was changed since it was written.
pub fn whole_film(run: &Run, case: &CaseInfo) -> Result<Option<Scenes>> {
    let keeping = Keeping { frames: usize::MAX, side_px: usize::MAX, quality: WHOLE_QUALITY, vertices: 0 };
    if let Some(truth) = &case.truth {
        return of_case(run, case, truth.as_ref(), keeping).map(Some);
    }
    let shown = run.shown(&case.id);
    let is_shown = |method: &str, seed: u64, run_id: &str| {
        shown.iter().any(|(_, cell, _)| (&*cell.method, cell.seed, &*cell.run_id) == (method, seed, run_id))
    };
    let name = film_page(&case.id);
    let mut whole = Scenes::default();
    for folder in &run.read_from {
        if !seal::is_sealed(folder, &name)? {
            continue;
        }
        let path = folder.join(&name);
        if let Some(kept) = page_data::kept_scenes(&files::read_text(&path)?, is_shown).map_err(|e| e.at(&path))? {
            whole.add(kept);
        }
    }
    Ok((!whole.films.is_empty()).then_some(whole))
}

fn of_case(run: &Run, case: &CaseInfo, truth: &dyn Truth, keeping: Keeping) -> Result<Scenes> {
    let frames = spread(truth.frames().len(), keeping.frames);
    let walls = Walls { rest: [truth.inspiration()?, truth.expiration()?], last: truth.last_surface()? };
    let airway = match keeping.vertices {
        0 => None,
        most => AirwayScene::of(&walls.rest[0], &walls.rest[1], walls.last.as_ref(), most),
    };
    let question = Question::of(truth);
    let mut scenes = Scenes::default();
    for (_, cell, score) in run.shown(&case.id) {
        let prediction = Prediction::open(&cell.prediction, &question)?;
        let surface = match &airway {
            Some(airway) => surface(airway, &walls, truth, &prediction)?,
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
    let at_frame = |frame: usize| (0..targets.len()).map(move |index| truth.target_mm(index, frame));
    // Without a surface at the last frame the phase says where everything is.
    let by_frame = walls
        .last
        .is_some()
        .then(|| Packed::of_doubles((0..records.len()).flat_map(at_frame).flat_map(|place| place.to_array())));
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
        targets_by_frame_mm: by_frame,
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

/// The true wall, as far as it is known.
struct Walls {
    /// At full inspiration and at full expiration.
    rest: [TriangleMesh; 2],
    /// At the last frame, where no phase says it.
    last: Option<TriangleMesh>,
}

/// Where the row's surface is known point by point: the truth's faces or the told ones, or a table of correspondences.
fn surface(airway: &ReducedAirway, walls: &Walls, truth: &dyn Truth, prediction: &Prediction) -> Result<SurfaceScene> {
    let Some(predicted) = prediction.final_mesh()? else { return Ok(SurfaceScene::Unknown) };
    let Some(last) = truth.frames().last() else { return Ok(SurfaceScene::Unknown) };
    let places = match prediction.correspondence()? {
        Some(places) => places,
        None if predicted.faces == walls.rest[0].faces => predicted.vertices,
        None => by_told_faces(truth, &predicted)?.unwrap_or_default(),
    };
    if places.len() != walls.rest[0].vertices.len() {
        return Ok(SurfaceScene::OtherFaces);
    }
    if let Some(wall) = &walls.last {
        return Ok(airway.surface_from(wall, &places));
    }
    let stated = prediction.phase().and_then(|phases| phases.last().copied());
    let [inspiration, expiration] = &walls.rest;
    Ok(airway.surface([inspiration, expiration], &places, last.phase, stated))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::report_tests::sample_run;
    use crate::score::fixture::{BeyondPhase, TubeTruth};

    /// The page of a clinical film had balls, wall and colours where the phase would have them.
    #[test]
    fn what_no_phase_says_is_taken_from_the_film() {
        let folder = tempfile::tempdir().unwrap();
        let run = sample_run(folder.path(), 16, 9);
        let truth = BeyondPhase(TubeTruth::new("case1", 16, 9));
        let keeping = Keeping { frames: FRAMES, side_px: SIDE_PX, quality: QUALITY, vertices: AIRWAY_VERTICES };
        let ideal = of_case(&run, &run.cases[0], &truth.0, keeping).unwrap();
        let scenes = of_case(&run, &run.cases[0], &truth, keeping).unwrap();
        let (film, places) = (&scenes.films[0], scenes.films[0].targets_by_frame_mm.as_ref().unwrap());
        for (frame, of_frame) in places.0.chunks(9).enumerate() {
            for (index, place) in of_frame.chunks(3).enumerate() {
                let wanted = truth.target_mm(index, frame).as_vec3();
                assert_eq!(place, wanted.to_array(), "target {index} at frame {frame}");
                assert!(wanted.distance(truth.0.target_mm(index, frame).as_vec3()) > 0.1);
            }
        }
        let (airway, wall) = (film.airway.as_ref().unwrap(), truth.last_surface().unwrap().unwrap());
        let drawn = airway.last.as_ref().unwrap().0.as_chunks::<3>().0.iter();
        let drawn =
            drawn.map(|v| DVec3::from_array(airway.low_mm) + airway.step_mm * DVec3::from_array(v.map(f64::from)));
        let off = drawn.map(|v| wall.vertices.iter().map(|w| w.distance(v)).fold(f64::INFINITY, f64::min));
        assert!(off.fold(0.0, f64::max) < 2.0 * airway.step_mm);
        // The row whose surface is the blend by its phase: right on the ideal track, off by what tissue moved besides.
        let surface =
            |scenes: &Scenes| scenes.rows.iter().find(|row| row.method == "oracle-phase").unwrap().surface.clone();
        assert_eq!(surface(&ideal), SurfaceScene::ByPhase);
        let SurfaceScene::AtEnd(codes) = surface(&scenes) else { panic!("an error that follows from the phase") };
        let error_mm = |code: u8| 0.01 * 10f64.powf(4.0 * f64::from(code) / 254.0);
        assert!(codes.0.iter().all(|&code| (error_mm(code) - BeyondPhase::MOVED_MM).abs() < 0.05));
        assert!(ideal.films[0].targets_by_frame_mm.is_none() && ideal.films[0].airway.as_ref().unwrap().last.is_none());
        assert!(!serde_json::to_string(&ideal.films[0]).unwrap().contains("by_frame"));
    }
}
