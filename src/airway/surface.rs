//! From a bronchial tree to its surface: one smooth closed 2-manifold without seams.
//!
//! Recipe: smooth union of round cones on a grid ([`LumenField`]), marching tetrahedra, isotropic remeshing with edges
//! in proportion to the local radius, mucosal unevenness as a small displacement along the normal. Cartilage rings are
//! finer than the triangles: they are relief of the material (`render`), not of the mesh.

use glam::DVec3;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::remesh::remesh;
use super::surface_field::LumenField;
use super::surface_polygon::polygonise;
use super::tree::Tree;
use crate::base::random::{CounterRng, Stage};
use crate::base::range::{KeyRanges, NumberRange, SEED};
use crate::base::{Error, Result, TriangleMesh};

/// Ranges of `[anatomy.surface]`.
const RANGES: KeyRanges = KeyRanges(&[
    ("spacing_mm", NumberRange::new(0.1, 5.0)),
    ("edge_per_radius", NumberRange::new(0.01, 5.0)),
    ("shortest_edge_mm", NumberRange::new(0.05, 20.0)),
    ("longest_edge_mm", NumberRange::new(0.05, 20.0)),
    ("blend", NumberRange::new(0.0, 2.0)),
    ("unevenness", NumberRange::new(0.0, 0.2)),
    ("rounds", NumberRange::new(0.0, 50.0)),
    ("seed", SEED),
]);
/// Most faces of a surface, as its area and the wanted edges suggest, and most before remeshing, as its area and the
/// grid suggest: some twenty times those of the shipped cases.
const MOST_FACES: f64 = 2e6;
/// Most faces times rounds of remeshing; one takes about 20 microseconds.
const MOST_FACE_ROUNDS: f64 = 1.2e7;
/// Faces of marching tetrahedra per square of the grid.
const FACES_PER_SQUARE: f64 = 4.0;

/// How fine and how even the surface is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SurfaceSettings {
    /// Spacing of the grid in mm.
    pub spacing_mm: f64,
    /// Wanted edge length over the local radius.
    pub edge_per_radius: f64,
    /// Shortest wanted edge in mm.
    pub shortest_edge_mm: f64,
    /// Longest wanted edge in mm.
    pub longest_edge_mm: f64,
    /// Width of the smooth union at bifurcations over the radius of the joining branch.
    pub blend: f64,
    /// Amplitude of the mucosal unevenness over the local radius (standard deviation).
    pub unevenness: f64,
    /// Remeshing rounds.
    pub rounds: usize,
    /// Seed of the unevenness.
    pub seed: u64,
}

impl Default for SurfaceSettings {
    fn default() -> Self {
        SurfaceSettings {
            spacing_mm: 0.8,
            edge_per_radius: 0.32,
            shortest_edge_mm: 0.8,
            longest_edge_mm: 1.6,
            blend: 0.5,
            unevenness: 0.02,
            rounds: 5,
            seed: 1,
        }
    }
}

impl SurfaceSettings {
    /// Rejects what no surface could have; the element names the key, `prefix` before it.
    pub fn validate(&self, prefix: &str) -> Result<()> {
        RANGES.check(prefix, self)?;
        if self.longest_edge_mm < self.shortest_edge_mm {
            let sentence = format!("{} is less than shortest_edge_mm", self.longest_edge_mm);
            return Err(Error::input(sentence).element(format!("{prefix}.longest_edge_mm")));
        }
        Ok(())
    }

    /// Wanted length in mm of an edge where the airway has a radius of `radius_mm`.
    fn edge_mm(&self, radius_mm: f64) -> f64 {
        (self.edge_per_radius * radius_mm).clamp(self.shortest_edge_mm, self.longest_edge_mm)
    }

    /// Refuses a surface of `tree` that would take too long. Its area is the mantle of its cones, its faces are
    /// equilateral triangles of the wanted edges.
    fn check_faces(&self, tree: &Tree) -> Result<()> {
        let (mut faces, mut rough) = (0.0, 0.0);
        for (branch, k) in tree.branches.iter().flat_map(|b| (1..b.points_mm.len()).map(move |k| (b, k))) {
            let radius_mm = 0.5 * (branch.radius(k - 1) + branch.radius(k));
            let area_mm2 = std::f64::consts::TAU * radius_mm * branch.position(k - 1).distance(branch.position(k));
            faces += area_mm2 / (0.25 * 3f64.sqrt() * self.edge_mm(radius_mm).powi(2));
            rough += area_mm2 * FACES_PER_SQUARE / self.spacing_mm.powi(2);
        }
        for (key, what, count, most) in [
            ("shortest_edge_mm", "faces", faces, MOST_FACES),
            ("spacing_mm", "faces on the grid", rough, MOST_FACES),
            ("rounds", "faces times rounds", faces * self.rounds as f64, MOST_FACE_ROUNDS),
        ] {
            if count > most {
                let sentence = format!("the surface would have about {count:.0} {what}, and {most:.0} is the most");
                return Err(Error::input(sentence).element(format!("anatomy.surface.{key}")));
            }
        }
        Ok(())
    }
}

/// Answers "how wide is the airway here, and of which generation" by the nearest centreline points.
struct Neighbourhood {
    kd: ImmutableKdTree<f64, 3>,
    points: Vec<(DVec3, f64, f64)>,
}

impl Neighbourhood {
    fn of(tree: &Tree) -> Self {
        let points: Vec<_> = tree
            .branches
            .iter()
            .flat_map(|b| (0..b.points_mm.len()).map(|k| (b.position(k), b.radius(k), b.generation as f64)))
            .collect();
        let keys: Vec<[f64; 3]> = points.iter().map(|p| p.0.to_array()).collect();
        let kd = ImmutableKdTree::new_from_slice(&keys).expect("a valid tree has finite points");
        Neighbourhood { kd, points }
    }

    /// (radius in mm, generation) averaged over the points whose spheres come nearest to `at`.
    fn look(&self, at: DVec3) -> (f64, f64) {
        let count = std::num::NonZeroUsize::new(24.min(self.points.len())).expect("a tree has points");
        let near = self.kd.query(&at.to_array()).nearest_n::<SquaredEuclidean<f64>>(count).execute();
        let gaps: Vec<(f64, usize)> = near
            .iter()
            .map(|n| n.item as usize)
            .map(|k| (at.distance(self.points[k].0) - self.points[k].1, k))
            .collect();
        let least = gaps.iter().map(|g| g.0).fold(f64::INFINITY, f64::min);
        let (mut weight, mut radius, mut generation) = (0.0, 0.0, 0.0);
        for (gap, k) in gaps {
            let (_, r, g) = self.points[k];
            let w = (-((gap - least) / (0.3 * r)).powi(2)).exp();
            weight += w;
            radius += w * r;
            generation += w * g;
        }
        (radius / weight, generation / weight)
    }
}

/// The surface of `tree` with normals into the lumen, and the (fractional) generation at each vertex.
///
/// Errors: a tree that is no tree, settings out of range, or a tree for which they would need more than 300 million
/// grid nodes or two million faces, and a result that is not one closed manifold (branches that loop back into each
/// other).
pub fn surface_from_tree(tree: &Tree, settings: &SurfaceSettings) -> Result<(TriangleMesh, Vec<f32>)> {
    tree.validate()?;
    settings.validate("anatomy.surface")?;
    settings.check_faces(tree)?;
    let neighbourhood = Neighbourhood::of(tree);
    let field = LumenField::of_tree(tree, settings.spacing_mm, settings.blend)?;
    let rough = polygonise(&field);
    let target = |p: DVec3| settings.edge_mm(neighbourhood.look(p).0);
    let mut mesh = remesh(&rough, settings.rounds, target, |p| field.project(p));
    smooth(&mut mesh, 6);
    let looks: Vec<(f64, f64)> = mesh.vertices.par_iter().with_min_len(256).map(|&v| neighbourhood.look(v)).collect();
    roughen(&mut mesh, &looks, settings);
    mesh.validate_closed()?;
    check_sphere(&mesh)?;
    Ok((mesh, looks.iter().map(|l| l.1 as f32).collect()))
}

/// Taubin's smoothing (SIGGRAPH 1995, lambda .5, mu -.53): takes the grid's facets, leaves the volume.
pub fn smooth(mesh: &mut TriangleMesh, rounds: usize) {
    let neighbours = mesh.neighbours();
    for factor in (0..rounds).flat_map(|_| [0.5, -0.53]) {
        let old = mesh.vertices.clone();
        for v in 0..old.len() {
            let around = neighbours.of(v);
            let mean = around.iter().map(|&u| old[u as usize]).sum::<DVec3>() / around.len() as f64;
            mesh.vertices[v] = old[v] + (mean - old[v]) * factor;
        }
    }
}

/// Displaces the vertices along their normals by a sum of seeded plane waves of 5 to 16 mm.
fn roughen(mesh: &mut TriangleMesh, looks: &[(f64, f64)], settings: &SurfaceSettings) {
    // Waves in the sum.
    const WAVES: usize = 24;
    let mut rng = CounterRng::new(settings.seed, Stage::Surface, &[]);
    let waves: Vec<(DVec3, f64)> = (0..WAVES)
        .map(|_| {
            let direction = DVec3::new(rng.normal(), rng.normal(), rng.normal()).normalize_or(DVec3::X);
            (direction * (std::f64::consts::TAU / rng.range(5.0, 16.0)), rng.range(0.0, std::f64::consts::TAU))
        })
        .collect();
    let normals = mesh.vertex_normals();
    for (v, (radius, _)) in looks.iter().enumerate() {
        let at = mesh.vertices[v];
        let height: f64 = waves.iter().map(|(k, phase)| (k.dot(at) + phase).sin()).sum();
        let amplitude = settings.unevenness * radius * (2.0 / WAVES as f64).sqrt();
        mesh.vertices[v] = at - normals[v] * (amplitude * height);
    }
}

/// One component of genus 0.
fn check_sphere(mesh: &TriangleMesh) -> Result<()> {
    let euler = mesh.vertices.len() as i64 - mesh.edges().len() as i64 + mesh.faces.len() as i64;
    if euler != 2 {
        return Err(Error::input(format!(
            "the surface has Euler characteristic {euler} instead of 2: branches touch each other or stand apart; a finer \
             `anatomy.surface.spacing_mm` or a larger `anatomy.minimal_radius_mm` may mend it"
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::tree::Branch;
    use super::*;

    fn line(from: DVec3, to: DVec3, start_mm: f64, end_mm: f64) -> Vec<[f64; 4]> {
        (0..=20)
            .map(|k| k as f64 / 20.0)
            .map(|t| (from.lerp(to, t), start_mm + (end_mm - start_mm) * t))
            .map(|(p, r)| [p.x, p.y, p.z, r])
            .collect()
    }

    fn fork() -> Tree {
        let carina = DVec3::NEG_Z * 40.0;
        let arm =
            |to: DVec3, r: f64| Branch { parent: Some(0), generation: 1, points_mm: line(carina, to, r, 0.7 * r) };
        let trachea = Branch { parent: None, generation: 0, points_mm: line(DVec3::ZERO, carina, 8.0, 7.5) };
        Tree {
            source: "test".into(),
            branches: vec![trachea, arm(DVec3::new(22.0, 3.0, -75.0), 6.0), arm(DVec3::new(-28.0, 0.0, -70.0), 5.0)],
        }
    }

    #[test]
    fn a_fork_becomes_one_well_shaped_sphere_like_surface() {
        let settings = SurfaceSettings { unevenness: 0.0, ..Default::default() };
        let (mesh, generation) = surface_from_tree(&fork(), &settings).unwrap();
        assert!(mesh.signed_volume() < 0.0, "normals must point into the lumen");
        assert_eq!(generation.len(), mesh.vertices.len());
        // The trachea's wall lies at its radius.
        let middle: Vec<f64> =
            mesh.vertices.iter().filter(|v| (v.z + 20.0).abs() < 5.0).map(|v| v.truncate().length()).collect();
        assert!(middle.len() > 50);
        assert!(middle.iter().all(|r| (r - 7.75).abs() < 0.35), "{middle:?}");
        let mut angles: Vec<f64> = (0..mesh.faces.len())
            .map(|f| {
                let [a, b, c] = mesh.corners(f);
                (b - a).angle_between(c - a).min((a - b).angle_between(c - b)).min((a - c).angle_between(b - c))
            })
            .map(f64::to_degrees)
            .collect();
        angles.sort_by(f64::total_cmp);
        println!("{} faces, least angle {:.1}, 1 % {:.1}", angles.len(), angles[0], angles[angles.len() / 100]);
        assert!(angles[0] > 5.0 && angles[angles.len() / 100] > 25.0);
    }

    #[test]
    fn surfaces_that_would_not_end_are_refused() {
        let refused = |settings: SurfaceSettings| surface_from_tree(&fork(), &settings).unwrap_err().to_string();
        let fine = SurfaceSettings::default();
        let tiny = SurfaceSettings { shortest_edge_mm: 0.05, edge_per_radius: 0.01, ..fine };
        assert!(refused(tiny).contains("shortest_edge_mm: the surface would have about"));
        assert!(
            refused(SurfaceSettings { shortest_edge_mm: 1e-9, ..fine }).contains("shortest_edge_mm: 1e-9 must lie")
        );
        assert!(refused(SurfaceSettings { rounds: 1 << 62, ..fine }).contains("rounds: 4.6"));
        let patient = SurfaceSettings { rounds: 50, shortest_edge_mm: 0.2, longest_edge_mm: 0.2, ..fine };
        assert!(refused(patient).contains("faces times rounds"));
        let mut wide = fork();
        wide.branches[0].points_mm.iter_mut().for_each(|point| point[3] = 20.0);
        let said = surface_from_tree(&wide, &SurfaceSettings { spacing_mm: 0.1, ..fine }).unwrap_err().to_string();
        assert!(said.contains("faces on the grid"), "{said}");
        assert!(refused(SurfaceSettings { spacing_mm: f64::NAN, ..fine }).contains("spacing_mm: NaN"));
        assert!(refused(SurfaceSettings { blend: -1.0, ..fine }).contains("blend: -1"));
        assert!(refused(SurfaceSettings { longest_edge_mm: 0.3, ..fine }).contains("longest_edge_mm: 0.3 is less"));
        let mut long = fork();
        long.branches[1].points_mm.push([9000.0, 9000.0, 9000.0, 6.0]);
        let said = surface_from_tree(&long, &fine).unwrap_err().to_string();
        assert!(said.contains("0.8 mm is too fine for this tree") || said.contains("is the most"), "{said}");
    }

    #[test]
    fn the_same_seed_gives_the_same_bytes() {
        let settings = SurfaceSettings { rounds: 2, ..Default::default() };
        assert_eq!(surface_from_tree(&fork(), &settings).unwrap(), surface_from_tree(&fork(), &settings).unwrap());
    }
}
