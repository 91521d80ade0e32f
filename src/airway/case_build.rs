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
use super::grow::grow;
use super::surface::{SurfaceSettings, surface_from_tree};
use super::tree::Tree;
use crate::base::{Error, Result, TriangleMesh, files};

/// Most rounds of averaging around slivers; and no averaging when more than one face in this many is turned over: then
/// the field itself folds.
const SETTLING_ROUNDS: usize = 60;
const SETTLED_PART: usize = 1000;
/// A point of a mesh pair's centreline moves with the wall within this many of its radii.
const CARRY_RADII: f64 = 1.6;

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

/// The two states of `rest` under `breathing`. `vertex_generation` is taken from the centreline when not known.
pub fn from_field(
    rest: TriangleMesh,
    centerline: Centerline,
    vertex_generation: Option<Vec<f32>>,
    breathing: &Breathing,
) -> Result<Anatomy> {
    let axis = Axis::new(&centerline);
    let feet = axis.feet(&rest.vertices);
    let line_points: Vec<DVec3> = centerline.points.iter().map(|p| p.position_mm).collect();
    let line_feet = axis.feet(&line_points);
    if feet.len() != rest.vertices.len() {
        return Err(Error::input("the centreline has no length"));
    }
    let expiration = settled(&rest, moved(&rest.vertices, &feet, breathing));
    let (least, vertex) = field_check::least_determinant(&breathing.field, &rest.vertices);
    if least <= 0.0 {
        return Err(
            Error::input(format!("folds space (determinant {least:.3} at vertex {vertex})")).element("breathing.field")
        );
    }
    check_faces(&rest, &expiration)?;
    let line_expiration = moved(&line_points, &line_feet, breathing);
    let generation = vertex_generation.unwrap_or_else(|| feet.iter().map(|foot| foot.generation as f32).collect());
    Ok(finish(rest, expiration, generation, centerline, line_expiration))
}

/// A registered pair: the centreline moves with the wall around it.
pub fn from_pair(rest: TriangleMesh, expiration: Vec<DVec3>, centerline: Centerline) -> Result<Anatomy> {
    check_faces(&rest, &expiration)?;
    let generation: Vec<f32> =
        Axis::new(&centerline).feet(&rest.vertices).iter().map(|foot| foot.generation as f32).collect();
    if generation.len() != rest.vertices.len() {
        return Err(Error::input("the centreline has no length"));
    }
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
            point.position_mm + if total > 0.0 { sum / total } else { DVec3::ZERO }
        })
        .collect();
    Ok(finish(rest, expiration, generation, centerline, carried))
}

fn moved(points: &[DVec3], feet: &[AxisPoint], breathing: &Breathing) -> Vec<DVec3> {
    let move_one = |(&x, foot): (&DVec3, &AxisPoint)| {
        let narrowed = x + breathing.calibre.displacement(x, foot);
        narrowed + breathing.field.displacement(narrowed)
    };
    points.par_iter().zip(feet).map(move_one).collect()
}

/// Real surfaces hold slivers much thinner than the scale of the motion, and those may turn over in the finest
/// gradients of the calibre's change. Around such a face the motion is averaged over neighbours until it no longer
/// does; when that does not help, the faces are left for [`check_faces`] to name.
fn settled(rest: &TriangleMesh, mut expiration: Vec<DVec3>) -> Vec<DVec3> {
    let mut flipped = field_check::flipped_faces(rest, &expiration);
    if flipped.is_empty() || flipped.len() * SETTLED_PART > rest.faces.len() {
        return expiration;
    }
    let neighbours = rest.neighbours();
    let around = |v: usize| neighbours.of(v).iter().map(|&n| n as usize);
    let mut touched: Vec<usize> = Vec::new();
    for _ in 0..SETTLING_ROUNDS {
        let corners = flipped.iter().flat_map(|&f| rest.faces[f as usize]).map(|v| v as usize);
        touched.extend(corners.flat_map(|v| around(v).chain([v])));
        touched.sort_unstable();
        touched.dedup();
        let averaged: Vec<DVec3> = touched
            .iter()
            .map(|&v| {
                let count = neighbours.of(v).len().max(1) as f64;
                around(v).map(|n| expiration[n] - rest.vertices[n]).sum::<DVec3>() / count
            })
            .collect();
        for (&v, motion) in touched.iter().zip(averaged) {
            expiration[v] = rest.vertices[v] + motion;
        }
        flipped = field_check::flipped_faces(rest, &expiration);
        if flipped.is_empty() {
            break;
        }
    }
    expiration
}

fn check_faces(rest: &TriangleMesh, expiration: &[DVec3]) -> Result<()> {
    if let Some(v) = expiration.iter().position(|v| !v.is_finite()) {
        return Err(Error::input("is not finite at expiration").element(format!("vertex {v}")));
    }
    match field_check::flipped_faces(rest, expiration).as_slice() {
        [] => Ok(()),
        flipped => Err(Error::input(format!("and {} others turn over between the breath holds", flipped.len() - 1))
            .element(format!("face {}", flipped[0]))),
    }
}

fn finish(
    inspiration: TriangleMesh,
    expiration: Vec<DVec3>,
    vertex_generation: Vec<f32>,
    centerline: Centerline,
    centerline_expiration: Vec<DVec3>,
) -> Anatomy {
    // The wall's vertices are dense enough to measure an inscribed radius.
    let radius_expiration_mm = centerline_expiration
        .par_iter()
        .map(|p| expiration.iter().map(|v| v.distance_squared(*p)).fold(f64::INFINITY, f64::min).sqrt())
        .collect();
    let expiration = TriangleMesh { vertices: expiration, faces: inspiration.faces.clone() };
    Anatomy { inspiration, expiration, vertex_generation, centerline, centerline_expiration, radius_expiration_mm }
}
