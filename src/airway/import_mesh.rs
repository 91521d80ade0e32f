//! A user's airway surface: read, made one closed surface in LPS and mm, and held against what an airway can be.

use std::collections::HashMap;
use std::path::Path;

use glam::DVec3;

use super::case_build::closed_into_lumen;
use super::centerline::{Centerline, CenterlineSettings};
use super::centerline_extract::extract;
use super::import_axes::PatientAxes;
use super::import_check::{check_extent, check_stem};
use crate::base::{Error, Result, TriangleMesh};
use crate::formats;

/// Furthest in mm that a vertex moves between two breath holds: the lung's base, deeply breathed, moves 60 mm.
const FURTHEST_MM: f64 = 80.0;

/// How a file is to be understood.
#[derive(Clone, Copy, Debug)]
pub struct FileMeaning {
    /// Where its axes point.
    pub axes: PatientAxes,
    /// Its unit in mm.
    pub scale: f64,
    /// Which of several loose parts are taken.
    pub parts: PartChoice,
    /// Whether it must look like a human airway.
    pub anatomy: ExpectedAnatomy,
}

/// What to do with a surface of several loose parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PartChoice {
    /// Refuse it.
    Single,
    /// Take the part with the most faces.
    Largest,
}

/// What is expected of an airway.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExpectedAnatomy {
    /// Size and shape of a human one.
    Human,
    /// Anything: an animal, a phantom, a part of an airway.
    Any,
}

impl FileMeaning {
    /// A point of the file in LPS, mm.
    pub fn to_lps_mm(&self, point: DVec3) -> DVec3 {
        self.axes.to_lps(point * self.scale)
    }

    /// Reads the surface of `path`: closed, one part, normals into the lumen, LPS, mm.
    ///
    /// Errors name the file and the vertex, edge or face; or say in one sentence which option makes the file right: a
    /// second part, an impossible size.
    pub fn read_surface(&self, path: &Path) -> Result<TriangleMesh> {
        self.surface(path).map_err(|e| e.at(path))
    }

    fn surface(&self, path: &Path) -> Result<TriangleMesh> {
        let mut mesh = formats::mesh::read(path)?;
        let parts = parts(&mesh);
        if parts.len() > 1 {
            match self.parts {
                PartChoice::Largest => mesh = part(&mesh, &parts[0]),
                PartChoice::Single => return Err(Error::input(several_parts(&mesh, &parts))),
            }
        }
        mesh.vertices.iter_mut().for_each(|v| *v = self.to_lps_mm(*v));
        let mesh = closed_into_lumen(mesh)?;
        if self.anatomy == ExpectedAnatomy::Human {
            check_extent(mesh.vertices.iter().copied())?;
        }
        Ok(mesh)
    }

    /// The centreline of a surface that [`FileMeaning::read_surface`] read. Errors: an airway that does not lie in the
    /// body as the axes say, or whose trachea is none.
    pub fn centerline(&self, mesh: &TriangleMesh) -> Result<Centerline> {
        let line = extract(mesh, &CenterlineSettings::default())?;
        self.check_centerline(&line)?;
        Ok(line)
    }

    /// Refuses a centreline in LPS and mm that is not one of a human airway.
    pub fn check_centerline(&self, line: &Centerline) -> Result<()> {
        if self.anatomy == ExpectedAnatomy::Any {
            return Ok(());
        }
        check_extent(line.points.iter().map(|p| p.position_mm))?;
        check_stem(line, self.axes)
    }

    /// Refuses a surface that is no other state of `rest`: other faces, or further away than breathing moves.
    pub fn check_pair(&self, rest: &TriangleMesh, other: &TriangleMesh) -> Result<()> {
        if rest.faces != other.faces || rest.vertices.len() != other.vertices.len() {
            return Err(Error::input("has other faces than the inspiration mesh: the two are not registered"));
        }
        let moved = rest.vertices.iter().zip(&other.vertices).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        if self.anatomy == ExpectedAnatomy::Human && moved > FURTHEST_MM {
            return Err(Error::input(format!(
                "a vertex moves by {moved:.0} mm between the breath holds, and breathing moves {FURTHEST_MM} mm at most: \
                 both files must have one unit and one frame; --unusual takes them as they are"
            )));
        }
        Ok(())
    }
}

/// Faces of each loose part, the part with the most faces first.
fn parts(mesh: &TriangleMesh) -> Vec<Vec<usize>> {
    let mut leader: Vec<u32> = (0..mesh.vertices.len() as u32).collect();
    fn find(leader: &mut [u32], mut v: u32) -> u32 {
        while leader[v as usize] != v {
            leader[v as usize] = leader[leader[v as usize] as usize];
            v = leader[v as usize];
        }
        v
    }
    for &[a, b, c] in &mesh.faces {
        for other in [b, c] {
            let (low, high) = (find(&mut leader, a), find(&mut leader, other));
            leader[low.max(high) as usize] = low.min(high);
        }
    }
    let mut place: HashMap<u32, usize> = HashMap::new();
    let mut parts: Vec<Vec<usize>> = Vec::new();
    for (f, face) in mesh.faces.iter().enumerate() {
        let index = *place.entry(find(&mut leader, face[0])).or_insert_with(|| {
            parts.push(Vec::new());
            parts.len() - 1
        });
        parts[index].push(f);
    }
    // Stable: of equal parts, the one that comes first in the file.
    parts.sort_by_key(|part| std::cmp::Reverse(part.len()));
    parts
}

fn several_parts(mesh: &TriangleMesh, parts: &[Vec<usize>]) -> String {
    let share = 100.0 * parts[0].len() as f64 / mesh.faces.len() as f64;
    let cure = match share < 5.0 {
        true => "weld its vertices, which its faces do not share",
        false => "--keep-largest takes the largest alone",
    };
    format!("holds {} loose parts, the largest of which has {share:.1} % of the faces: {cure}", parts.len())
}

/// The mesh of some faces, vertices in the order of the whole one.
fn part(mesh: &TriangleMesh, faces: &[usize]) -> TriangleMesh {
    let mut new_index = vec![u32::MAX; mesh.vertices.len()];
    faces.iter().flat_map(|&f| mesh.faces[f]).for_each(|v| new_index[v as usize] = 0);
    let mut vertices = Vec::new();
    for (v, index) in new_index.iter_mut().enumerate().filter(|(_, index)| **index == 0) {
        *index = vertices.len() as u32;
        vertices.push(mesh.vertices[v]);
    }
    let faces = faces.iter().map(|&f| mesh.faces[f].map(|v| new_index[v as usize])).collect();
    TriangleMesh { vertices, faces }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loose_parts_are_told_apart_and_the_largest_is_taken() {
        let square = |x: f64| [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(u, v)| DVec3::new(x + u, v, 0.0));
        let vertices = [square(0.0).to_vec(), square(5.0).to_vec()].concat();
        let mesh = TriangleMesh { vertices, faces: vec![[0, 1, 2], [4, 5, 6], [4, 6, 7]] };
        let found = parts(&mesh);
        assert_eq!(found, [vec![1, 2], vec![0]]);
        let largest = part(&mesh, &found[0]);
        assert_eq!(largest.vertices, square(5.0));
        assert_eq!(largest.faces, [[0, 1, 2], [0, 2, 3]]);
        assert!(
            several_parts(&mesh, &found).contains("2 loose parts") && several_parts(&mesh, &found).contains("66.7 %")
        );
    }
}
