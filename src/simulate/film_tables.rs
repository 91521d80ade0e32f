//! The numbers in a film's files, each checked against its range where it is read: times and poses, points, places and
//! conditions at every frame.

use std::path::Path;

use glam::{DAffine3, DVec3};

use crate::base::range::{COORDINATE_MM, SHARE, TIME_S};
use crate::base::{Error, Result, files, pose};
use crate::formats::number_table::{self, COUNT, NumberRow};
use crate::formats::transforms::{Transforms, TransformsFrame};

/// First line of the places of the targets at every frame.
pub const TARGETS_BY_FRAME_HEADER: &str = "frame,target,x_mm,y_mm,z_mm";
/// First line of the tables of targets.
pub const POINTS_HEADER: &str = "target,x_mm,y_mm,z_mm";

/// The pose of an entry of a film, whose unit is mm.
pub fn film_pose(entry: &TransformsFrame) -> Result<DAffine3> {
    let world_from_camera = entry.world_from_camera();
    pose::check(&world_from_camera, COORDINATE_MM).map_err(|e| Error::input(format!("transform_matrix {e}")))?;
    Ok(world_from_camera)
}

/// Times and poses of the frames in `transforms`. Errors name the frame: a number out of range, a time that does not
/// come after that of the frame before.
pub fn given_frames(transforms: &Transforms) -> Result<Vec<(f64, DAffine3)>> {
    let mut frames: Vec<(f64, DAffine3)> = Vec::with_capacity(transforms.frames.len());
    for (index, entry) in transforms.frames.iter().enumerate() {
        let named = |e: Error| e.element(format!("frame {index}"));
        TIME_S.check(entry.time).map_err(|e| named(Error::input(format!("time: {e}"))))?;
        if let Some((before, _)) = frames.last().filter(|(before, _)| *before >= entry.time) {
            return Err(named(Error::input(format!("time: {} does not come after {before}", entry.time))));
        }
        frames.push((entry.time, film_pose(entry).map_err(named)?));
    }
    Ok(frames)
}

/// The range of a coordinate's column.
fn place_columns() -> [number_table::Column<'static>; 3] {
    ["x_mm", "y_mm", "z_mm"].map(|name| (name, COORDINATE_MM))
}

/// Place in mm of each of `targets` targets at each of `frames` frames: rows frame by frame, within a frame target by
/// target.
pub fn targets_by_frame(bytes: &[u8], frames: usize, targets: usize) -> Result<Vec<Vec<DVec3>>> {
    let [x, y, z] = place_columns();
    let rows = number_table::rows(bytes, [("frame", COUNT), ("target", COUNT), x, y, z])?;
    if rows.len() != frames * targets {
        return Err(Error::input(format!("has {} rows: {frames} frames of {targets} targets are wanted", rows.len())));
    }
    let mut places: Vec<Vec<DVec3>> = (0..frames).map(|_| Vec::with_capacity(targets)).collect();
    for (at, row) in rows.iter().enumerate() {
        let (frame, target, [f, t, x, y, z]) = (at / targets, at % targets, row.numbers);
        if [f, t] != [frame as f64, target as f64] {
            return Err(row.refuse(Error::input(format!("wanted {frame}, {target} and a place"))));
        }
        places[frame].push(DVec3::new(x, y, z));
    }
    Ok(places)
}

/// Effort of a cough and weight of a touch of the wall from which a frame counts as disturbed by it.
const DISTURBED: f64 = 0.1;

/// Which of `frames` frames a cough or a touch of the wall disturbs, by the table of the clinical track's conditions.
pub fn disturbed(bytes: &[u8], frames: usize) -> Result<Vec<bool>> {
    let rows = number_table::rows(bytes, [("frame", COUNT), ("cough", SHARE), ("contact", SHARE)])?;
    if rows.len() != frames {
        return Err(Error::input(format!("has {} rows: {frames} frames are wanted", rows.len())));
    }
    let is_disturbed = |row: &NumberRow<3>| {
        let [_, cough, contact] = row.numbers;
        cough.max(contact) >= DISTURBED
    };
    Ok(rows.iter().map(is_disturbed).collect())
}

/// Points as a table below `header`, such as [`POINTS_HEADER`].
pub fn points_csv(header: &str, points: impl Iterator<Item = DVec3>) -> String {
    let row = |(target, p): (usize, DVec3)| format!("{target},{},{},{}\n", p.x, p.y, p.z);
    points.enumerate().map(row).fold(format!("{header}\n"), |text, row| text + &row)
}

/// Reads what [`points_csv`] wrote below a header whose first name is `index`: points in mm, in order.
pub fn read_points(path: &Path, index: &str) -> Result<Vec<DVec3>> {
    let [x, y, z] = place_columns();
    let rows = number_table::rows(&files::read_bytes(path)?, [(index, COUNT), x, y, z]).map_err(|e| e.at(path))?;
    let point = |(at, row): (usize, &NumberRow<4>)| match row.numbers {
        [k, x, y, z] if k == at as f64 => Ok(DVec3::new(x, y, z)),
        _ => Err(row.refuse(Error::input(format!("wanted {index} {at}"))).at(path)),
    };
    rows.iter().enumerate().map(point).collect()
}

#[cfg(test)]
mod tests {
    use glam::DMat3;

    use super::*;
    use crate::base::Camera;
    use crate::formats::transforms::TransformsLens;

    fn entry(time: f64, place_mm: DVec3) -> TransformsFrame {
        TransformsFrame {
            file_path: "images/000000.png".into(),
            depth_file_path: None,
            mask_path: None,
            transform_matrix: TransformsFrame::matrix(&DAffine3::from_mat3_translation(DMat3::IDENTITY, place_mm)),
            time,
            breathing_phase: None,
            exposure: 1.0,
            white_balance: [1.0; 3],
            lens: TransformsLens::default(),
        }
    }

    #[test]
    fn times_rise_and_poses_lie_in_a_scanner() {
        let read = |entries: Vec<TransformsFrame>| {
            given_frames(&Transforms::new(&Camera::pinhole(4, 4, 1.0), entries)).map_err(|e| e.to_string())
        };
        let good = read(vec![entry(0.0, DVec3::ZERO), entry(0.1, DVec3::splat(7.0))]).unwrap();
        assert_eq!(good[1].0, 0.1);
        for (wrong, says) in [
            (entry(0.0, DVec3::ZERO), "frame 1: time: 0 does not come after 0"),
            (entry(-1.0, DVec3::ZERO), "frame 1: time: -1 must lie in 0 to 1e7"),
            (entry(f64::NAN, DVec3::ZERO), "frame 1: time: NaN must lie"),
            (entry(0.1, DVec3::splat(1e6)), "frame 1: transform_matrix lies too far away: 1000000 must lie"),
        ] {
            let said = read(vec![entry(0.0, DVec3::ZERO), wrong]).unwrap_err();
            assert!(said.starts_with(says), "{said}");
        }
    }

    #[test]
    fn places_are_read_by_the_names_of_their_columns_or_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("targets.csv");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            read_points(&path, "target").map_err(|e| e.to_string())
        };
        let there = [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.5)];
        assert_eq!(read(&points_csv(POINTS_HEADER, there.into_iter())).unwrap(), there);
        assert_eq!(read("z_mm,target,y_mm,x_mm\n3,0,2,1\n").unwrap(), there[..1]);
        for (text, says) in [
            ("target,x_mm,y_mm,z_mm\n0,1,n/a,2,3\n", "line 2"),
            ("target,x_mm,y_mm,z_mm\n1,1,2,3\n", "line 2: wanted target 0"),
            ("target,x_mm,y_mm,z_mm\n0,1,2,1e300\n", "line 2: z_mm: 1e300 must lie"),
            ("target,x,y,z\n0,1,2,3\n", "column x_mm: is missing"),
        ] {
            let said = read(text).unwrap_err();
            assert!(said.contains("targets.csv") && said.contains(says), "{said}");
        }
        let conditions = "frame,contact,phase,cough\n0,0,.5,.09\n1,0.2,.5,0\n2,0,.5,1\n";
        assert_eq!(disturbed(conditions.as_bytes(), 3).unwrap(), [false, true, true]);
        for (text, says) in [
            (conditions, "has 3 rows: 4 frames"),
            ("frame,cough\n0,1\n", "column contact: is missing"),
            ("frame,cough,contact\n0,0,7\n", "line 2: contact: 7 must lie"),
        ] {
            let said = disturbed(text.as_bytes(), 4).unwrap_err().to_string();
            assert!(said.contains(says), "{said}");
        }
        let by_frame = |text: &str| targets_by_frame(text.as_bytes(), 2, 1).map_err(|e| e.to_string());
        let header = TARGETS_BY_FRAME_HEADER;
        assert_eq!(by_frame(&format!("{header}\n0,0,1,2,3\n1,0,4,5,6.5\n")).unwrap(), there.map(|p| vec![p]));
        for (rows, says) in [
            ("0,0,1,2,3\n", "has 1 rows: 2 frames of 1 targets"),
            ("0,0,1,2,3\n0,0,1,2,3\n", "line 3: wanted 1, 0"),
            ("0,0,n/a,1,2,3\n1,0,1,2,3\n", "line 2"),
            ("0,0,1,2,3\n1,0,1,2,1e200\n", "line 3: z_mm: 1e200 must lie"),
        ] {
            let said = by_frame(&format!("{header}\n{rows}")).unwrap_err();
            assert!(said.contains(says), "{said}");
        }
    }
}
