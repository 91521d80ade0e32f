//! What a page shows besides tables and plots: the airway in both breath holds, the path of the scope, targets, and a
//! reduced film with the renderings of every row.
//!
//! `scenes.json` of a report folder. It is made while film and predictions are at hand, and kept: a report that is
//! merged or written anew shows the same. Nothing in it is a number of a table.

mod airway;
mod packed;
mod simplify;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde::{Deserialize, Serialize};

pub use airway::{AirwayScene, ReducedAirway, SurfaceScene};
pub use packed::{Packed, PackedNumber};

use crate::base::range::COORDINATE_MM;
use crate::base::{Error, Result, files};
use crate::score::CellScore;
use crate::score::contour::ContourOverlay;

/// Name of the file.
pub const SCENES: &str = "scenes.json";
/// Vertices of an airway. The same in every run, so that what is known at vertices fits together when runs are merged.
pub const AIRWAY_VERTICES: usize = 12_000;

/// Everything that was kept of a run.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Scenes {
    /// One per case.
    pub films: Vec<FilmScene>,
    /// One per row that was shown of a case.
    pub rows: Vec<RowScene>,
}

/// Which film something is of.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FilmKey {
    /// Case id.
    pub case_id: String,
    /// What the film was made from.
    pub case_hash: String,
    /// What it held.
    pub content: String,
}

impl FilmKey {
    /// Of the film that a score is of.
    pub fn of(score: &CellScore) -> Self {
        FilmKey {
            case_id: score.case_id.clone(),
            case_hash: score.case_hash.clone(),
            content: score.film_content.clone(),
        }
    }
}

/// Some frames as pictures.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Pictures {
    /// Indices of the frames, ascending.
    pub frames: Vec<u32>,
    /// Pixels of each.
    pub width: u32,
    /// Pixels of each.
    pub height: u32,
    /// One JPEG per frame.
    pub jpeg: Vec<Packed<u8>>,
}

/// The truth of a case, as far as it is shown.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct FilmScene {
    /// The film.
    pub film: FilmKey,
    /// One line; empty when unknown.
    pub title: String,
    /// Seconds since the first frame, of every frame.
    pub times_s: Packed<f32>,
    /// True phase of every frame.
    pub phases: Packed<f32>,
    /// World from camera of every frame: x, y and z axis, then the centre in mm; axes of OpenCV.
    pub poses: Packed<f32>,
    /// Tangent of half the vertical angle of view.
    pub tan_half_height: f64,
    /// Places x, y, z in mm of all targets at inspiration, then of all at expiration.
    pub targets_mm: Packed<f32>,
    /// Places x, y, z in mm of all targets at every frame, where no phase says them: on the clinical track.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub targets_by_frame_mm: Option<Packed<f32>>,
    /// The surface; `None` where there is none to show.
    pub airway: Option<AirwayScene>,
    /// What the scope saw.
    pub pictures: Pictures,
}

/// One row on one film.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct RowScene {
    /// The film.
    pub film: FilmKey,
    /// Method id.
    pub method: String,
    /// Seed of the method.
    pub seed: u64,
    /// Its renderings.
    pub pictures: Pictures,
    /// Places x, y, z in mm of all targets, for each frame of the pictures; empty where it states none.
    pub targets_mm: Packed<f32>,
    /// How far its surface is from the true one.
    pub surface: SurfaceScene,
    /// Contours of the last frame.
    pub contours: Option<ContourOverlay>,
}

/// At most `wanted` of `count` indices, evenly spread, first and last among them.
pub(super) fn spread(count: usize, wanted: usize) -> Vec<usize> {
    if count <= wanted {
        return (0..count).collect();
    }
    match wanted {
        0 => Vec::new(),
        1 => vec![count - 1],
        _ => (0..wanted).map(|i| (i * (count - 1) + (wanted - 1) / 2) / (wanted - 1)).collect(),
    }
}

impl Pictures {
    /// Characters that they take on a page.
    pub fn characters(&self) -> usize {
        self.jpeg.iter().map(|jpeg| jpeg.characters() + 8).sum()
    }

    /// At most `most` of them.
    fn thinned(&self, most: usize) -> Pictures {
        let kept = spread(self.frames.len(), most);
        Pictures {
            frames: kept.iter().map(|&k| self.frames[k]).collect(),
            jpeg: kept.iter().map(|&k| self.jpeg[k].clone()).collect(),
            ..*self
        }
    }

    /// Indices that ascend, one picture each.
    fn check(&self) -> Result<()> {
        let is_ascending = self.frames.windows(2).all(|pair| pair[0] < pair[1]);
        if !is_ascending || self.frames.len() != self.jpeg.len() || self.width == 0 || self.height == 0 {
            return Err(Error::input("pictures need a size, and frames that ascend, one for each"));
        }
        Ok(())
    }
}

/// Case, method and seed: what tells the rows of a report apart.
pub type RowKey<'a> = (&'a str, &'a str, u64);

impl RowScene {
    fn key(&self) -> RowKey<'_> {
        (&self.film.case_id, &self.method, self.seed)
    }

    /// With at most `most` frames.
    fn thinned(&self, most: usize) -> RowScene {
        let frames = self.pictures.frames.len();
        let of_frame = self.targets_mm.0.len() / frames.max(1);
        let place = |k: usize| self.targets_mm.0[k * of_frame..(k + 1) * of_frame].iter().copied();
        RowScene {
            pictures: self.pictures.thinned(most),
            targets_mm: Packed(spread(frames, most).into_iter().flat_map(place).collect()),
            ..self.clone()
        }
    }
}

impl Scenes {
    /// Reads what the report in `folder` kept; nothing where it has no such file.
    ///
    /// Errors name the file and the film or row in it whose arrays do not fit each other.
    pub fn read(folder: &Path) -> Result<Scenes> {
        let path = folder.join(SCENES);
        if !path.exists() {
            return Ok(Scenes::default());
        }
        let scenes: Scenes = files::read_json(&path)?;
        scenes.check().map_err(|e| e.at(path))?;
        Ok(scenes)
    }

    /// Writes the file.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let path = folder.join(SCENES);
        let text = serde_json::to_string(self).map_err(|e| Error::input(e.to_string()).at(&path))?;
        files::write_bytes(&path, text.as_bytes())
    }

    /// The film of a case.
    pub fn film(&self, case_id: &str) -> Option<&FilmScene> {
        self.films.iter().find(|film| film.film.case_id == case_id)
    }

    /// The row of a cell, if it is of the film that is shown of its case.
    pub fn row(&self, score: &CellScore) -> Option<&RowScene> {
        let key = FilmKey::of(score);
        self.film(&score.case_id).filter(|film| film.film == key)?;
        self.rows.iter().find(|row| row.film == key && row.method == score.method && row.seed == score.seed)
    }

    /// Drops the rows that are not among `known`, and the films of other cases.
    pub fn keep_rows_of(&mut self, known: &BTreeSet<RowKey<'_>>) {
        let cases: BTreeSet<&str> = known.iter().map(|(case, ..)| *case).collect();
        self.rows.retain(|row| known.contains(&row.key()));
        self.films.retain(|film| cases.contains(film.film.case_id.as_str()));
    }

    /// Drops the rows that are among `renewed`.
    pub fn drop_rows_of(&mut self, renewed: &BTreeSet<RowKey<'_>>) {
        self.rows.retain(|row| !renewed.contains(&row.key()));
    }

    /// Drops the rows that show another film than the one on which they were scored.
    pub fn keep_scored(&mut self, films: &BTreeMap<RowKey<'_>, FilmKey>) {
        self.rows.retain(|row| films.get(&row.key()) == Some(&row.film));
    }

    /// Takes films and rows of `other` in, in place of another film of the case, and of rows of the same case, method
    /// and seed.
    pub fn add(&mut self, other: Scenes) {
        let renewed: BTreeSet<RowKey<'_>> = other.rows.iter().map(RowScene::key).collect();
        self.rows.retain(|before| !renewed.contains(&before.key()));
        self.rows.extend(other.rows);
        for film in other.films {
            match self.films.iter_mut().find(|before| before.film.case_id == film.film.case_id) {
                Some(before) if before.film == film.film => {}
                Some(before) => *before = film,
                None => self.films.push(film),
            }
        }
    }

    /// Characters on a page of all that frames have: pictures, and places of targets.
    fn characters(&self) -> usize {
        let films = self.films.iter().map(|film| film.pictures.characters());
        films.chain(self.rows.iter().map(|row| row.pictures.characters() + row.targets_mm.characters())).sum()
    }

    /// With as many frames of every film as fit into `most` characters: evenly spread, none where not one each fits.
    pub fn thinned(&self, most: usize) -> Scenes {
        let frames = |scenes: &Scenes| {
            let films = scenes.films.iter().map(|film| film.pictures.frames.len());
            films.chain(scenes.rows.iter().map(|row| row.pictures.frames.len())).max().unwrap_or(0)
        };
        let mut thin = self.clone();
        while frames(&thin) > 0 && thin.characters() > most {
            let (now, wanted) = (frames(&thin), most as f64 / thin.characters() as f64);
            let fewer = ((now as f64 * wanted) as usize).min(now - 1);
            for film in &mut thin.films {
                film.pictures = film.pictures.thinned(fewer);
            }
            for row in &mut thin.rows {
                *row = row.thinned(fewer);
            }
        }
        thin
    }

    /// Without airways, errors on them, and pictures.
    pub fn without_pictures(&self) -> Scenes {
        let mut bare = self.thinned(0);
        bare.films.iter_mut().for_each(|film| film.airway = None);
        bare.rows.iter_mut().for_each(|row| row.surface = SurfaceScene::default());
        bare
    }

    /// With airways of at most `most` vertices, and the errors of rows at those that are left.
    pub fn with_small_airways(&self, most: usize) -> Scenes {
        let mut small = self.clone();
        for film in &mut small.films {
            let Some(airway) = film.airway.as_mut().filter(|airway| airway.vertices() > most) else { continue };
            let kept = airway.reduce(most);
            for row in small.rows.iter_mut().filter(|row| row.film == film.film) {
                if let SurfaceScene::AtEnd(codes) = &mut row.surface {
                    codes.0 = kept.iter().filter_map(|&v| codes.0.get(v as usize).copied()).collect();
                }
            }
        }
        small
    }

    /// Refuses arrays that do not fit each other; errors name the film or row.
    pub fn check(&self) -> Result<()> {
        for film in &self.films {
            film.check().map_err(|e| e.element(format!("film of {}", film.film.case_id)))?;
        }
        for row in &self.rows {
            let named = |e: Error| e.element(format!("row {} of {}", row.method, row.film.case_id));
            row.pictures.check().map_err(named)?;
            if !row.targets_mm.0.len().is_multiple_of(3 * row.pictures.frames.len().max(1)) {
                return Err(named(Error::input("targets need three numbers for each frame of the pictures")));
            }
            row.contours.as_ref().map_or(Ok(()), check_contours).map_err(named)?;
        }
        Ok(())
    }
}

/// A true contour, and places that a plot can hold.
fn check_contours(contours: &ContourOverlay) -> Result<()> {
    let targets = [contours.target_truth, contours.target_predicted];
    let places = contours.truth.iter().chain(&contours.predicted).chain(&targets);
    if contours.truth.is_empty() || !places.flatten().all(|&mm| COORDINATE_MM.contains(mm)) {
        return Err(Error::input(format!("contours need a true one, and coordinates in mm of {COORDINATE_MM}")));
    }
    Ok(())
}

impl FilmScene {
    fn check(&self) -> Result<()> {
        self.pictures.check()?;
        let frames = self.times_s.0.len();
        let is_inside = self.pictures.frames.last().is_none_or(|&last| (last as usize) < frames);
        if frames == 0 || self.phases.0.len() != frames || self.poses.0.len() != 12 * frames || !is_inside {
            return Err(Error::input("every frame needs a time, a phase and a pose"));
        }
        let has_angle = self.tan_half_height > 0.0 && self.tan_half_height.is_finite();
        if !self.targets_mm.0.len().is_multiple_of(6) || !has_angle {
            return Err(Error::input("targets need two places each, and a camera an angle of view"));
        }
        let wanted = self.targets_mm.0.len() / 2 * frames;
        if self.targets_by_frame_mm.as_ref().is_some_and(|places| places.0.len() != wanted) {
            return Err(Error::input("targets need a place at every frame, or none"));
        }
        self.airway.as_ref().map_or(Ok(()), AirwayScene::check)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pictures(frames: usize, bytes: usize) -> Pictures {
        let jpeg = vec![Packed(vec![7; bytes]); frames];
        Pictures { frames: (0..frames as u32).collect(), width: 8, height: 8, jpeg }
    }

    fn row(method: &str, frames: usize) -> RowScene {
        let targets = (0..6 * frames).map(|v| (v / 6) as f32).collect();
        RowScene {
            film: FilmKey { case_id: "case1".into(), ..FilmKey::default() },
            method: method.into(),
            pictures: pictures(frames, 3000),
            targets_mm: Packed(targets),
            ..RowScene::default()
        }
    }

    #[test]
    fn frames_are_thinned_until_they_fit_and_keep_their_targets() {
        let scenes = Scenes { films: Vec::new(), rows: vec![row("a", 40), row("b", 13)] };
        let thin = scenes.thinned(100_000);
        assert!(thin.characters() <= 100_000 && thin.characters() > 60_000, "{}", thin.characters());
        let first = &thin.rows[0];
        assert_eq!((first.pictures.frames[0], first.pictures.frames.last()), (0, Some(&39)));
        let of_frame: Vec<u32> = first.targets_mm.0.chunks(6).map(|chunk| chunk[0] as u32).collect();
        assert_eq!(of_frame, first.pictures.frames);
        assert_eq!(scenes.thinned(9000).rows[0].pictures.frames, [39]);
        assert!(scenes.thinned(10).rows[0].pictures.frames.is_empty());
        assert_eq!(scenes.thinned(10_000_000).rows[0].pictures.frames.len(), 40);
    }

    #[test]
    fn later_rows_take_the_place_of_earlier_ones() {
        let mut scenes = Scenes { films: Vec::new(), rows: vec![row("a", 4), row("b", 4)] };
        scenes.add(Scenes { films: Vec::new(), rows: vec![row("a", 9)] });
        let found: Vec<_> = scenes.rows.iter().map(|r| (r.method.as_str(), r.pictures.frames.len())).collect();
        assert_eq!(found, [("b", 4), ("a", 9)]);
    }

    #[test]
    fn what_does_not_fit_together_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let mut scenes = Scenes { films: Vec::new(), rows: vec![row("a", 4)] };
        scenes.write(folder.path()).unwrap();
        assert_eq!(Scenes::read(folder.path()).unwrap().rows[0].targets_mm, scenes.rows[0].targets_mm);
        scenes.rows[0].pictures.frames[2] = 0;
        scenes.write(folder.path()).unwrap();
        let said = Scenes::read(folder.path()).unwrap_err().to_string();
        assert!(said.contains("scenes.json") && said.contains("row a of case1"), "{said}");
        assert!(Scenes::read(&folder.path().join("nowhere")).unwrap().rows.is_empty());
    }
}
