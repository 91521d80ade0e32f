//! A mesh with its material, ready to be traced and to be deformed.

use glam::DVec3;

use super::material::Material;
use super::rest_shape::rest_vertices;
use super::tissue::{RestShape, Tissue};
use super::topology::Topology;
use crate::base::{Error, Result, TriangleMesh};
use crate::ffi::trace::tracer::{MeshTracer, SubsurfaceKind};

/// The scene: one surface, its look on the rest shape, its hierarchy. Built once, refitted per frame.
pub struct Scene {
    pub(super) tracer: MeshTracer,
    /// Subtracted from every world position before it becomes f32: keeps coordinates small.
    pub(super) shift: DVec3,
    pub(super) topology: Topology,
    /// Light transport at the two ends of the motion.
    pub(super) tissue: Tissue,
    /// How far the shape is on the way to the other end of its motion, 0 to 1.
    pub(super) progress: f64,
    /// An index-matched boundary.
    matched: bool,
    /// See [`Material::is_dark`].
    pub(super) is_dark: bool,
}

impl Scene {
    /// `rest`: the shape on which the look is defined (inspiration), faces wound so that normals point into the lumen
    /// (a face seen from behind is shaded as if it were turned). `vertex_generation`: airway generation per vertex
    /// (0 trachea; may be fractional), or empty for all 0. `seed`: of the procedural look.
    ///
    /// Errors: an invalid mesh, a generation list of another length, a material that cannot be.
    pub fn new(rest: &TriangleMesh, vertex_generation: &[f32], material: Material, seed: u64) -> Result<Self> {
        rest.validate()?;
        let settings = material.settings(seed)?;
        let generation = match vertex_generation.len() {
            0 => vec![0.0; rest.vertices.len()],
            n if n == rest.vertices.len() => vertex_generation.to_vec(),
            n => return Err(Error::input(format!("{n} generations for {} vertices", rest.vertices.len()))),
        };
        let look = rest_vertices(rest, &generation, settings.mucosa);
        let (low, high) = rest.bounds();
        let shift = (low + high) * 0.5;
        let vertices = floats(&rest.vertices, shift);
        let tracer = MeshTracer::new(&vertices, rest.faces.as_flattened(), &look, &settings)?;
        let topology = Topology::new(rest);
        let tissue = Tissue::new(RestShape { look, material: settings }, vertices, &topology);
        Ok(Scene {
            tracer,
            shift,
            topology,
            tissue,
            progress: 0.0,
            matched: settings.subsurface == SubsurfaceKind::Matched,
            is_dark: material.is_dark(),
        })
    }

    /// Refuses a material that light at vertices cannot represent, and a mesh for which it would need too much memory.
    pub(super) fn check_vertex_light(&self) -> Result<()> {
        if self.matched {
            return Err(Error::input(
                "light at vertices needs a wall that light leaves as from a Lambert surface; a matched boundary needs paths",
            ));
        }
        Ok(())
    }

    /// Moves the vertices (world, mm) and refits the hierarchy. The look stays on the tissue.
    pub fn deform(&mut self, vertices: &[DVec3]) -> Result<()> {
        self.check_vertices(vertices)?;
        let vertices = floats(vertices, self.shift);
        self.progress = self.tissue.progress(&vertices);
        self.tracer.update(&vertices)
    }

    /// Sets the other end of the motion that starts at rest (positions in the world, mm). Light at vertices then
    /// interpolates the visibility between walls from the two ends; without it, visibility is that at rest.
    ///
    /// Errors: another number of vertices.
    pub fn set_other_end(&mut self, vertices: &[DVec3]) -> Result<()> {
        self.check_vertices(vertices)?;
        self.tissue.set_other_end(floats(vertices, self.shift), &self.topology);
        Ok(())
    }

    fn check_vertices(&self, vertices: &[DVec3]) -> Result<()> {
        if vertices.len() != self.topology.vertex_count() {
            return Err(Error::input(format!(
                "{} positions for {} vertices",
                vertices.len(),
                self.topology.vertex_count()
            )));
        }
        if let Some(v) = vertices.iter().position(|v| !v.is_finite()) {
            return Err(Error::input("coordinate is not finite").element(format!("vertex {v}")));
        }
        Ok(())
    }

    /// Number of triangles.
    pub fn triangles(&self) -> usize {
        self.topology.faces.len()
    }

    /// Seconds that one refit of the hierarchies takes; changes nothing.
    pub fn refit_seconds(&mut self) -> Result<f64> {
        let start = std::time::Instant::now();
        self.tracer.refit()?;
        Ok(start.elapsed().as_secs_f64())
    }

    /// Distances in mm from `origins` along unit `directions` (world) to the wall; infinity where there is none.
    pub fn distances(&self, origins: &[DVec3], directions: &[DVec3]) -> Result<Vec<f32>> {
        let mut distances = vec![0.0; origins.len()];
        let (o, d) = (floats(origins, self.shift), floats(directions, DVec3::ZERO));
        self.tracer.cast(&o, &d, &mut distances)?;
        Ok(distances)
    }
}

fn floats(points: &[DVec3], shift: DVec3) -> Vec<f32> {
    points.iter().flat_map(|&p| (p - shift).to_array()).map(|v| v as f32).collect()
}
