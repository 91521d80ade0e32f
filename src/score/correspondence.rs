//! `correspondence.csv`: where each vertex of the sequence's meshes is on a predicted surface that has other faces.
//!
//! ```text
//! vertex,face,b0,b1,b2          on a face of final.ply, with weights of its three corners that add up to 1
//! vertex,predicted_vertex       at a vertex of final.ply
//! ```
//!
//! One row per vertex, in order. A weight is not below 0: a point beside its face is not on the surface.

use std::path::Path;

use glam::DVec3;

use super::truth::Truth;
use crate::base::{Error, Result, TriangleMesh};
use crate::formats::number_table::line_of;
use crate::formats::prediction::{AT_VERTEX_COLUMNS, CORRESPONDENCE, FINAL_MESH, ON_FACE_COLUMNS};

/// How far the sum of the weights may be from 1, and a weight below 0: files round.
const ROUNDING: f64 = 1e-3;

/// Place in mm of each vertex that the table names, on `surface`. Errors name the line.
pub fn parse(bytes: &[u8], surface: &TriangleMesh) -> Result<Vec<DVec3>> {
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(bytes);
    let header = reader.headers().map_err(|e| Error::input(e.to_string()).element("line 1"))?;
    let names: Vec<&str> = header.iter().map(|name| name.trim_start_matches('\u{feff}')).collect();
    let on_faces = names == ON_FACE_COLUMNS;
    if !on_faces && names != AT_VERTEX_COLUMNS {
        let sentence = format!("must be \"{}\" or \"{}\"", ON_FACE_COLUMNS.join(","), AT_VERTEX_COLUMNS.join(","));
        return Err(Error::input(sentence).element("line 1"));
    }
    let mut places = Vec::new();
    for (row, record) in reader.records().enumerate() {
        let line = |at: Option<&csv::Position>| format!("line {}", line_of(bytes, at));
        let record = record.map_err(|e| {
            let element = line(e.position());
            Error::input(e.to_string()).element(element)
        })?;
        let index = |column: usize| record.get(column).and_then(|text| text.parse::<usize>().ok());
        let place = match (index(0) == Some(row), index(1)) {
            (true, Some(face)) if on_faces && face < surface.faces.len() => {
                let weight = |k: usize| record.get(2 + k).and_then(|text| text.parse::<f64>().ok());
                on_face(surface.corners(face), [0, 1, 2].map(|k| weight(k).unwrap_or(f64::NAN)))
            }
            (true, Some(vertex)) if !on_faces => surface.vertices.get(vertex).copied(),
            _ => None,
        };
        let wanted = || {
            let what = if on_faces { "a face and three weights" } else { "a predicted vertex" };
            Error::input(format!("wanted vertex {row} and {what} of {FINAL_MESH}")).element(line(record.position()))
        };
        places.push(place.ok_or_else(wanted)?);
    }
    Ok(places)
}

/// Where each vertex of the film is on a `surface` that keeps the faces that methods are told on the clinical track: by the
/// film's own table. `None` where it has other faces, or nothing is told.
pub fn by_told_faces(truth: &dyn Truth, surface: &TriangleMesh) -> Result<Option<Vec<DVec3>>> {
    match truth.told_correspondence()? {
        Some((told, table)) if told.faces == surface.faces && told.vertices.len() == surface.vertices.len() => {
            parse(&table, surface).map(Some).map_err(|e| e.at(Path::new("the film's told").join(CORRESPONDENCE)))
        }
        _ => Ok(None),
    }
}

/// Refuses a table of `places` for a surface of another number of `vertices`.
pub fn check_length(places: &[DVec3], vertices: usize) -> Result<()> {
    if places.len() == vertices {
        return Ok(());
    }
    Err(Error::input(format!("has {} vertices, the sequence's meshes have {vertices}", places.len())))
}

/// The weighted mean of the corners; `None` where the weights leave the face.
fn on_face(corners: [DVec3; 3], weights: [f64; 3]) -> Option<DVec3> {
    let sum: f64 = weights.iter().sum();
    let is_inside = weights.iter().all(|&w| w >= -ROUNDING) && (sum - 1.0).abs() <= ROUNDING;
    is_inside.then(|| corners.iter().zip(weights).map(|(&corner, weight)| corner * (weight / sum)).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_are_read_and_damage_is_named() {
        let vertices = vec![DVec3::ZERO, DVec3::X * 2.0, DVec3::Y * 4.0];
        let surface = TriangleMesh { vertices, faces: vec![[0, 1, 2]] };
        let read = |text: &str| parse(text.as_bytes(), &surface);
        let faces = "vertex,face,b0,b1,b2\n0,0,0.5,0.5,0\n1,0,0,0.25,0.75\n";
        assert_eq!(read(faces).unwrap(), [DVec3::X, DVec3::new(0.5, 3.0, 0.0)]);
        assert_eq!(read("vertex,predicted_vertex\n0,2\n1,0\n").unwrap(), [DVec3::Y * 4.0, DVec3::ZERO]);
        for (text, line) in [
            ("vertex,face\n0,0\n", "line 1"),
            ("vertex,predicted_vertex\n0,3\n", "line 2"),
            ("vertex,predicted_vertex\n0,0\n0,0\n", "line 3"),
            ("vertex,face,b0,b1,b2\n0,1,1,0,0\n", "line 2"),
            ("vertex,face,b0,b1,b2\n0,0,2,-1,0\n", "line 2"),
            ("vertex,face,b0,b1,b2\n0,0,0.5,0.4,0\n", "line 2"),
            ("vertex,face,b0,b1,b2\n0,0,nan,0.5,0.5\n", "line 2"),
            ("vertex,face,b0,b1,b2\n0,0,1\n", "line 2"),
        ] {
            assert!(read(text).unwrap_err().to_string().contains(line), "{text}");
        }
    }
}
