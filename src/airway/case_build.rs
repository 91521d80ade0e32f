//! From a case to the airway in both breath holds: surface, centreline, motion, checked to be free of folds.

use std::path::Path;

use glam::DVec3;
use rayon::prelude::*;

use super::Anatomy;
use super::case::{AnatomySource, Breathing, Case};
use super::case_centerline;
use super::centerline::{Centerline, CenterlineSettings};
use super::centerline_extract::extract;
use super::field_calibre::{Axis, AxisPoint};
use super::field_check;
use super::fold_mending::{Mending, mended, settled, yielding};
use super::grow::grow;
use super::nearest_points::NearestPoints;
use super::surface::{SurfaceSettings, surface_from_tree};
use super::tree::Tree;
use crate::base::{Error, Result, TriangleMesh, files};

/// A point of a mesh pair's centreline moves with the wall within this many of its radii.
const CARRY_RADII: f64 = 1.6;
/// Vertices that carry it where none is as near.
const FEWEST_CARRIERS: usize = 8;

/// Both states of a case's airway, checked: closed surface, no face turned over at any phase, orientation kept.
///
/// Errors name the case's file at fault and the face, vertex or key.
pub fn build(case: &Case) -> Result<Anatomy> {
    match &case.anatomy {
        AnatomySource::MeshPair { inspiration, expiration, centerline } => {
            let rest = read_mesh(&case.resolve(inspiration))?;
            let other = read_mesh(&case.resolve(expiration))?;
            if rest.faces != other.faces || rest.vertices.len() != other.vertices.len() {
                let sentence = "has other faces than the inspiration mesh: the two are not registered";
                return Err(Error::input(sentence).at(case.resolve(expiration)));
            }
            let line = read_or_extract(case, centerline.as_deref(), &rest)?;
            from_pair(rest, other.vertices, line)
        }
        AnatomySource::Mesh { path, centerline } => {
            let rest = read_mesh(&case.resolve(path))?;
            let line = read_or_extract(case, centerline.as_deref(), &rest)?;
            from_field(rest, line, None, field_of(case)?)
        }
        AnatomySource::Tree { path, least_radius_mm, deepest, surface } => {
            let tree = read_tree(&case.resolve(path))?.reachable(*least_radius_mm, *deepest);
            from_tree(&tree, surface, field_of(case)?)
        }
        AnatomySource::Grown { seed, growth, surface } => from_tree(&grow(*seed, growth)?, surface, field_of(case)?),
    }
}

/// The centreline at rest of a case's airway, without its surface where the case has a tree.
pub fn rest_centerline(case: &Case) -> Result<Centerline> {
    match &case.anatomy {
        AnatomySource::Tree { path, least_radius_mm, deepest, .. } => {
            Ok(read_tree(&case.resolve(path))?.reachable(*least_radius_mm, *deepest).to_centerline())
        }
        AnatomySource::Grown { seed, growth, .. } => Ok(grow(*seed, growth)?.to_centerline()),
        AnatomySource::Mesh { .. } | AnatomySource::MeshPair { .. } => Ok(build(case)?.centerline),
    }
}

fn field_of(case: &Case) -> Result<&Breathing> {
    case.breathing.as_ref().ok_or_else(|| Error::input("is missing").element("breathing"))
}

fn from_tree(tree: &Tree, surface: &SurfaceSettings, breathing: &Breathing) -> Result<Anatomy> {
    let (rest, generation) = surface_from_tree(tree, surface)?;
    from_field(rest, tree.to_centerline(), Some(generation), breathing)
}

/// Reads and checks a tree table.
pub fn read_tree(path: &Path) -> Result<Tree> {
    let tree: Tree = files::read_toml(path)?;
    tree.validate().map_err(|e| e.at(path))?;
    Ok(tree)
}

/// Reads a closed surface and turns its faces so that the normals point into the lumen.
///
/// Errors name the file and the vertex, edge or face: not finite, not closed, not manifold, no enclosed space.
pub fn read_mesh(path: &Path) -> Result<TriangleMesh> {
    closed_into_lumen(crate::formats::mesh::read(path)?).map_err(|e| e.at(path))
}

/// The surface with its normals into the lumen. Errors as [`read_mesh`].
pub fn closed_into_lumen(mut mesh: TriangleMesh) -> Result<TriangleMesh> {
    mesh.validate_closed()?;
    let volume = mesh.signed_volume();
    if !volume.is_finite() || volume == 0.0 {
        return Err(Error::input("the surface encloses no space"));
    }
    if volume > 0.0 {
        mesh.flip();
    }
    Ok(mesh)
}

fn read_or_extract(case: &Case, file: Option<&Path>, mesh: &TriangleMesh) -> Result<Centerline> {
    match file {
        Some(path) => case_centerline::read(&case.resolve(path)),
        None => extract(mesh, &CenterlineSettings::default()),
    }
}

/// What is done with faces that would turn over between the breath holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FoldPolicy {
    /// The few that are slivers are mended; more are an error.
    Strict,
    /// The narrowing of the lumen yields around them ([`super::fold_mending`]).
    Yield,
}

/// The two states of `rest` under `breathing`. `vertex_generation` is taken from the centreline when not known. Faces
/// that would turn over are mended.
pub fn from_field(
    rest: TriangleMesh,
    centerline: Centerline,
    vertex_generation: Option<Vec<f32>>,
    breathing: &Breathing,
) -> Result<Anatomy> {
    AirwayAtRest::new(&rest, &centerline)?.moved(breathing, vertex_generation, FoldPolicy::Yield)
}

/// An airway at full inspiration, ready to be moved, by one breath after another.
pub struct AirwayAtRest<'a> {
    /// Its surface.
    pub mesh: &'a TriangleMesh,
    /// Its centreline.
    pub centerline: &'a Centerline,
    /// Foot of each vertex on the centreline.
    feet: Vec<AxisPoint>,
    line_points: Vec<DVec3>,
    line_feet: Vec<AxisPoint>,
}

impl<'a> AirwayAtRest<'a> {
    /// Finds where on the centreline each vertex belongs. Errors: a centreline without length.
    pub fn new(mesh: &'a TriangleMesh, centerline: &'a Centerline) -> Result<Self> {
        let axis = Axis::new(centerline);
        let feet = axis.feet(&mesh.vertices);
        let line_points: Vec<DVec3> = centerline.points.iter().map(|p| p.position_mm).collect();
        let line_feet = axis.feet(&line_points);
        if feet.len() != mesh.vertices.len() {
            return Err(Error::input("the centreline has no length"));
        }
        Ok(AirwayAtRest { mesh, centerline, feet, line_points, line_feet })
    }

    /// Both states under `breathing`. `vertex_generation` is taken from the centreline when not known.
    ///
    /// Errors: a field that folds space; faces that turn over in spite of `policy`.
    pub fn moved(
        &self,
        breathing: &Breathing,
        vertex_generation: Option<Vec<f32>>,
        policy: FoldPolicy,
    ) -> Result<Anatomy> {
        let (rest, feet) = (self.mesh, &self.feet);
        let whole = vec![1.0; feet.len()];
        let mut expiration = settled(rest, moved(&rest.vertices, feet, breathing, &whole));
        let (least, vertex) = field_check::least_determinant(&breathing.field, &rest.vertices);
        if least <= 0.0 {
            return Err(Error::input(format!("folds space (determinant {least:.3} at vertex {vertex})"))
                .element("breathing.field"));
        }
        if policy == FoldPolicy::Yield && check_faces(rest, &expiration).is_err() {
            let walls = wall_shares(&rest.vertices, feet);
            expiration = yielding(rest, walls, |share| moved(&rest.vertices, feet, breathing, share));
        }
        check_faces(rest, &expiration)?;
        let line_expiration = moved(&self.line_points, &self.line_feet, breathing, &vec![1.0; self.line_feet.len()]);
        let generation = vertex_generation.unwrap_or_else(|| feet.iter().map(|foot| foot.generation as f32).collect());
        finish(rest.clone(), expiration, generation, self.centerline.clone(), line_expiration)
    }

    /// By how much the narrowing yielded to faces that would turn over, where `expiration` is what came of `breathing`.
    pub fn mending(&self, expiration: &[DVec3], breathing: &Breathing) -> Mending {
        let (rest, feet) = (self.mesh, &self.feet);
        let whole = moved(&rest.vertices, feet, breathing, &vec![1.0; feet.len()]);
        let faces = field_check::flipped_faces(rest, &whole).len();
        if faces == 0 {
            return Mending::default();
        }
        let wanted = moved(&rest.vertices, feet, breathing, &wall_shares(&rest.vertices, feet));
        Mending { faces, ..Mending::between(rest, &wanted, expiration) }
    }
}

/// How far each vertex is the wall of its foot's airway: 1 up to twice its radius, 0 from three times on. A branch too
/// narrow for the centreline has its feet on another one, towards which it must not be drawn.
fn wall_shares(vertices: &[DVec3], feet: &[AxisPoint]) -> Vec<f64> {
    let share = |(x, foot): (&DVec3, &AxisPoint)| (3.0 - x.distance(foot.position_mm) / foot.radius_mm).clamp(0.0, 1.0);
    vertices.iter().zip(feet).map(share).collect()
}

/// The other state of a registered pair, with the motion averaged around faces that it would turn over. Errors: faces
/// that turn over all the same, with how many did at first.
pub fn mended_pair(rest: &TriangleMesh, expiration: Vec<DVec3>) -> Result<(Vec<DVec3>, Mending)> {
    let found = mended(rest, expiration.clone());
    let mending = Mending::between(rest, &expiration, &found);
    check_faces(rest, &found)?;
    Ok((found, mending))
}

/// A registered pair: the centreline moves with the wall around it, or where faces are so large that no vertex is near, with
/// the nearest vertices.
pub fn from_pair(rest: TriangleMesh, expiration: Vec<DVec3>, centerline: Centerline) -> Result<Anatomy> {
    check_faces(&rest, &expiration)?;
    let generation: Vec<f32> =
        Axis::new(&centerline).feet(&rest.vertices).iter().map(|foot| foot.generation as f32).collect();
    if generation.len() != rest.vertices.len() {
        return Err(Error::input("the centreline has no length"));
    }
    let wall = NearestPoints::new(&rest.vertices)?;
    let nearest_motion = |place: DVec3| {
        let near = wall.several(place, FEWEST_CARRIERS);
        near.iter().map(|&(v, _)| expiration[v] - rest.vertices[v]).sum::<DVec3>() / near.len() as f64
    };
    let carried: Vec<DVec3> = centerline
        .points
        .par_iter()
        .map(|point| {
            let reach2 = (CARRY_RADII * point.radius_mm).powi(2);
            let (mut sum, mut total) = (DVec3::ZERO, 0.0);
            for (v, e) in rest.vertices.iter().zip(&expiration) {
                let d2 = v.distance_squared(point.position_mm);
                if d2 < reach2 {
                    let weight = (1.0 - d2 / reach2).powi(2);
                    sum += (e - v) * weight;
                    total += weight;
                }
            }
            point.position_mm + if total > 0.0 { sum / total } else { nearest_motion(point.position_mm) }
        })
        .collect();
    finish(rest, expiration, generation, centerline, carried)
}

/// Where points are at expiration, with `share` of the narrowing each.
fn moved(points: &[DVec3], feet: &[AxisPoint], breathing: &Breathing, share: &[f64]) -> Vec<DVec3> {
    let move_one = |((&x, foot), &share): ((&DVec3, &AxisPoint), &f64)| {
        let narrowed = x + breathing.calibre.displacement(x, foot) * share;
        narrowed + breathing.field.displacement(narrowed)
    };
    points.par_iter().zip(feet).zip(share).map(move_one).collect()
}

fn check_faces(rest: &TriangleMesh, expiration: &[DVec3]) -> Result<()> {
    if let Some(v) = expiration.iter().position(|v| !v.is_finite()) {
        return Err(Error::input("is not finite at expiration").element(format!("vertex {v}")));
    }
    let has_no_area = |&f: &usize| {
        let [a, b, c] = rest.corners(f);
        (b - a).cross(c - a) == DVec3::ZERO
    };
    if let Some(f) = (0..rest.faces.len()).find(has_no_area) {
        let sentence = "has no area: its corners lie on a line, or two in one place; merge double vertices first";
        return Err(Error::input(sentence).element(format!("face {f}")));
    }
    match field_check::flipped_faces(rest, expiration).as_slice() {
        [] => Ok(()),
        flipped => {
            let others = flipped.len() - 1;
            let sentence = format!(
                "and {others} others turn over between the breath holds: the motion folds the airway there, so it does not \
                 carry one surface onto the other"
            );
            Err(Error::input(sentence).element(format!("face {}", flipped[0])))
        }
    }
}

fn finish(
    inspiration: TriangleMesh,
    expiration: Vec<DVec3>,
    vertex_generation: Vec<f32>,
    centerline: Centerline,
    centerline_expiration: Vec<DVec3>,
) -> Result<Anatomy> {
    // The wall's vertices are dense enough to measure an inscribed radius.
    let wall = NearestPoints::new(&expiration)?;
    let radius_expiration_mm = centerline_expiration.par_iter().map(|p| wall.nearest(*p).1).collect();
    let expiration = TriangleMesh { vertices: expiration, faces: inspiration.faces.clone() };
    Ok(Anatomy { inspiration, expiration, vertex_generation, centerline, centerline_expiration, radius_expiration_mm })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::airway::centerline::CenterlinePoint;

    /// Of a coarse pair no vertex lies within 1.6 inscribed radii: points that stood still there took their targets along.
    #[test]
    fn a_centreline_far_from_all_vertices_moves_with_the_wall() {
        let corners = [[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]];
        let ring = |z: f64| corners.map(|[x, y]| DVec3::new(x, y, z));
        let vertices = [ring(0.0), ring(40.0)].concat();
        let sides = (0..4u32).flat_map(|k| [[k, (k + 1) % 4, 4 + k], [(k + 1) % 4, 4 + (k + 1) % 4, 4 + k]]);
        let ends = [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]];
        let rest = closed_into_lumen(TriangleMesh { vertices, faces: sides.chain(ends).collect() }).unwrap();
        let moved = rest.vertices.iter().map(|v| *v + DVec3::new(0.0, 0.0, 7.0)).collect();
        let points = [0u32, 1, 2].map(|k| CenterlinePoint {
            position_mm: DVec3::new(4.0, 4.0, 20.0 + 2.0 * f64::from(k)),
            radius_mm: 4.0,
            branch: 0,
            generation: 0,
            parent: k.checked_sub(1),
        });
        let line = Centerline { points: points.to_vec() };
        let anatomy = from_pair(rest, moved, line).unwrap();
        for (from, to) in anatomy.centerline.points.iter().zip(&anatomy.centerline_expiration) {
            assert!((*to - from.position_mm).distance(DVec3::Z * 7.0) < 1e-9, "{to}");
        }
    }

    /// "Turns over between the breath holds" sent people looking for a motion where two vertices lay in one place.
    #[test]
    fn a_face_without_area_is_named_as_such() {
        let vertices = [0.0, 1.0, 1.0].map(|x| DVec3::new(x, 0.0, 0.0)).to_vec();
        let mesh = TriangleMesh { vertices, faces: vec![[0, 1, 2]] };
        let said = check_faces(&mesh, &mesh.vertices).unwrap_err().to_string();
        assert!(said.contains("face 0") && said.contains("has no area"), "{said}");
    }
}
