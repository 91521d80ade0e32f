//! A user's airway surface: read, made one closed surface in LPS and mm, and held against what an airway can be.

use std::collections::HashMap;
use std::path::Path;

use glam::DVec3;

use super::case_build::closed_into_lumen;
use super::centerline::{Centerline, CenterlineSettings};
use super::centerline_extract::extract_watched;
use super::import_axes::PatientAxes;
use super::import_check::{ExpectedAnatomy, FURTHEST_MM, FrameSource, STILL_MM, check_extent, check_stem};
use crate::base::estimate::{Estimate, demand_memory};
use crate::base::{Error, Progress, Result, TriangleMesh};
use crate::formats;

/// Largest factor on the volume of an airway from inspiration to expiration: it gets smaller, and what is registered badly may
/// seem to grow a little.
const MOST_LUMEN_GROWTH: f64 = 1.1;
/// And what is left of it at least: lungs keep a quarter, and airways are stiffer.
const LEAST_LUMEN_LEFT: f64 = 0.25;

/// What a centreline takes for each voxel of the lumen, measured on a box of 14 million: 200 bytes, 8 microseconds.
const VOXEL_BYTES: f64 = 200.0;
const VOXEL_SECONDS: f64 = 8e-6;

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
        let mesh = formats::mesh::read(path)?;
        // Vertices of no face are of no surface: exports keep points that were measured or deleted.
        let every: Vec<usize> = (0..mesh.faces.len()).collect();
        let mut mesh = part(&mesh, &every);
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
            check_extent(mesh.vertices.iter().copied(), FrameSource::Options)?;
        }
        Ok(mesh)
    }

    /// The centreline of a surface that [`FileMeaning::read_surface`] read. Errors: an airway that does not lie in the
    /// body as the axes say, or whose trachea is none; one that this machine has no memory for; large work that the
    /// user has not agreed to, or has stopped.
    pub fn centerline(&self, mesh: &TriangleMesh, progress: &dyn Progress) -> Result<Centerline> {
        self.line(mesh, FrameSource::Options, progress)
    }

    /// [`FileMeaning::centerline`] for a surface that was made of a volume, whose header says where it lies.
    pub fn centerline_in_volume(&self, mesh: &TriangleMesh, progress: &dyn Progress) -> Result<Centerline> {
        self.line(mesh, FrameSource::Header, progress)
    }

    fn line(&self, mesh: &TriangleMesh, source: FrameSource, progress: &dyn Progress) -> Result<Centerline> {
        let settings = CenterlineSettings::default();
        let voxel_mm = settings.voxel_mm.unwrap_or(0.6 * settings.minimal_radius_mm);
        let voxels = mesh.signed_volume().abs() / voxel_mm.powi(3);
        demand_memory(format_args!("a lumen of {voxels:.1e} voxels of {voxel_mm} mm"), voxels * VOXEL_BYTES)?;
        progress.accepts(&Estimate {
            memory_bytes: voxels * VOXEL_BYTES,
            seconds: voxels * VOXEL_SECONDS,
            resumable: false,
        })?;
        let line = extract_watched(mesh, &settings, progress)?;
        self.check_line(&line, source)?;
        Ok(line)
    }

    /// Refuses a centreline in LPS and mm that is not one of a human airway.
    pub fn check_centerline(&self, line: &Centerline) -> Result<()> {
        self.check_line(line, FrameSource::Options)
    }

    fn check_line(&self, line: &Centerline, source: FrameSource) -> Result<()> {
        if self.anatomy == ExpectedAnatomy::Any {
            return Ok(());
        }
        check_extent(line.points.iter().map(|p| p.position_mm), source)?;
        check_stem(line, self.axes, source)
    }

    /// Refuses a surface that is no other state of `rest`: other faces, or further away than breathing moves.
    pub fn check_pair(&self, rest: &TriangleMesh, other: &TriangleMesh) -> Result<()> {
        if rest.faces != other.faces || rest.vertices.len() != other.vertices.len() {
            return Err(Error::input("has other faces than the inspiration mesh: the two are not registered"));
        }
        self.check_moves(rest, &other.vertices)
    }

    /// Refuses a second state of `rest` that is further away than breathing moves, or the first one.
    pub fn check_moves(&self, rest: &TriangleMesh, moved: &[DVec3]) -> Result<()> {
        let most = rest.vertices.iter().zip(moved).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
        if self.anatomy == ExpectedAnatomy::Human && most > FURTHEST_MM {
            return Err(Error::input(format!(
                "a vertex moves by {most:.0} mm between the breath holds, and breathing moves {FURTHEST_MM} mm at most: \
                 both files must have one unit and one frame; --unusual takes them as they are"
            )));
        }
        let other = TriangleMesh { vertices: moved.to_vec(), faces: rest.faces.clone() };
        let growth = (other.signed_volume() / rest.signed_volume()).abs();
        if self.anatomy == ExpectedAnatomy::Human && growth > MOST_LUMEN_GROWTH {
            return Err(Error::input(format!(
                "the airway is {growth:.2} times as large at expiration as at inspiration: are the two swapped? \
                 --unusual takes them as they are"
            )));
        }
        if self.anatomy == ExpectedAnatomy::Human && growth < LEAST_LUMEN_LEFT {
            return Err(Error::input(format!(
                "the airway at expiration has {growth:.2} of its volume at inspiration, and an airway keeps more than a \
                 quarter: both files must have one unit; --unusual takes them as they are"
            )));
        }
        if most >= STILL_MM {
            return Ok(());
        }
        Err(Error::input(format!(
            "does not move: no vertex lies {STILL_MM} mm or more from where it is at inspiration (the most is {most:.3} mm)"
        )))
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

    fn human() -> FileMeaning {
        FileMeaning { axes: PatientAxes::LPS, scale: 1.0, parts: PartChoice::Single, anatomy: ExpectedAnatomy::Human }
    }

    #[test]
    fn vertices_of_no_face_are_dropped() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cube.ply");
        let corners =
            |side: f64| [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]].map(|c| DVec3::from(c) * side);
        let vertices = [vec![DVec3::splat(900.0)], corners(100.0).to_vec(), vec![DVec3::splat(-900.0)]].concat();
        let faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]].map(|face: [u32; 3]| face.map(|v| v + 1)).to_vec();
        formats::mesh::write_ply(&path, &TriangleMesh { vertices, faces }, &[]).unwrap();
        assert_eq!(human().read_surface(&path).unwrap().vertices.len(), 4);
    }

    #[test]
    fn a_pair_without_motion_is_refused() {
        let vertices = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.]].map(DVec3::from).to_vec();
        let rest = TriangleMesh { vertices, faces: vec![[0, 1, 2]] };
        let moved = |by: f64| {
            let mut other = rest.clone();
            other.vertices[2].z += by;
            human().check_pair(&rest, &other)
        };
        assert!(moved(0.05).unwrap_err().to_string().contains("does not move"));
        moved(0.5).unwrap();
    }

    /// A box of ten kilometres: it was begun, and ran out of memory or of patience.
    #[test]
    fn a_lumen_beyond_the_machine_is_refused_before_the_work() {
        let vertices = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]].map(|c| DVec3::from(c) * 1e7).to_vec();
        let mesh = TriangleMesh { vertices, faces: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]] };
        let any = FileMeaning { anatomy: ExpectedAnatomy::Any, ..human() };
        let said = any.centerline(&mesh, &crate::base::NoProgress).unwrap_err().to_string();
        assert!(said.contains("voxels of 0.6 mm would take"), "{said}");
    }
}
