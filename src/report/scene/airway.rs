//! The airway of a page: few vertices, each with its places in both breath holds, as whole numbers of a small step.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::packed::Packed;
use super::simplify::{Simplified, simplify};
use crate::base::mesh::interpolate;
use crate::base::{Error, Result, TriangleMesh};

/// Ends of the scale of surface errors, which is logarithmic; mm.
const ERROR_SCALE_MM: [f64; 2] = [0.01, 100.0];
/// Codes of that scale; above them: no error is known.
const ERROR_CODES: f64 = 254.0;
/// A surface this near to the two true ones, blended by the phase that a row states, is that blend.
const SAME_SURFACE_MM: f64 = 0.02;

/// The surface of a case.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct AirwayScene {
    /// Place of the whole number 0 on each axis, mm.
    pub low_mm: [f64; 3],
    /// Millimetres between whole numbers.
    pub step_mm: f64,
    /// x, y, z of each vertex at full inspiration.
    pub inspiration: Packed<u16>,
    /// The same at full expiration.
    pub expiration: Packed<u16>,
    /// The same at the last frame, where no phase says it: on the clinical track.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last: Option<Packed<u16>>,
    /// Three vertices a face, normals into the lumen.
    pub faces: Packed<u16>,
}

/// How far a row's surface is from the true one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SurfaceScene {
    /// It keeps no surface. Older reports say so of [`SurfaceScene::OtherFaces`], too.
    #[default]
    Unknown,
    /// Its surface has other faces than the film's, and no table says where the film's vertices are on it.
    OtherFaces,
    /// Its surface is the blend of the two true ones by its phase: the error follows from the phase, in every frame.
    ByPhase,
    /// Error of each vertex at the last frame: 0 to 254 from 0.01 to 100 mm, logarithmic; 255 where it is not known.
    AtEnd(Packed<u8>),
}

fn pick(vertices: &[DVec3], kept: &[u32]) -> Vec<DVec3> {
    kept.iter().map(|&v| vertices[v as usize]).collect()
}

/// A surface made smaller, and which vertices of the true one it has.
pub struct ReducedAirway {
    /// For the page.
    pub scene: AirwayScene,
    kept: Vec<u32>,
}

impl AirwayScene {
    /// The two breath holds, and the wall at the last frame where that is no blend of them, with at most `most`
    /// vertices; `None` where they have no surface or are of several topologies.
    pub fn of(
        inspiration: &TriangleMesh,
        expiration: &TriangleMesh,
        last: Option<&TriangleMesh>,
        most: usize,
    ) -> Option<ReducedAirway> {
        let is_alike = |other: &TriangleMesh| {
            other.faces == inspiration.faces && other.vertices.len() == inspiration.vertices.len()
        };
        if inspiration.faces.is_empty() || !is_alike(expiration) || !last.is_none_or(is_alike) {
            return None;
        }
        let Simplified { kept, faces } = simplify(inspiration, &expiration.vertices, most);
        if kept.len() > usize::from(u16::MAX) {
            return None;
        }
        let (start, end) = (pick(&inspiration.vertices, &kept), pick(&expiration.vertices, &kept));
        let last = last.map(|last| pick(&last.vertices, &kept));
        let all = start.iter().chain(&end).chain(last.iter().flatten());
        let (low, high) = all.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &v| (low.min(v), high.max(v)));
        let step_mm = ((high - low).max_element() / f64::from(u16::MAX)).max(1e-9);
        let whole = |places: &[DVec3]| {
            let numbers = places.iter().flat_map(|&v| ((v - low) / step_mm).to_array());
            Packed(numbers.map(|v| v.round().clamp(0.0, f64::from(u16::MAX)) as u16).collect())
        };
        let scene = AirwayScene {
            low_mm: low.to_array(),
            step_mm,
            inspiration: whole(&start),
            expiration: whole(&end),
            last: last.as_deref().map(whole),
            faces: Packed(faces.iter().flatten().map(|&v| v as u16).collect()),
        };
        Some(ReducedAirway { scene, kept })
    }

    /// Takes vertices away until `most` are left; returns which are.
    pub(super) fn reduce(&mut self, most: usize) -> Vec<u32> {
        let low = DVec3::from_array(self.low_mm);
        let places = |numbers: &Packed<u16>| -> Vec<DVec3> {
            let place = |v: &[u16]| low + self.step_mm * DVec3::new(v[0].into(), v[1].into(), v[2].into());
            numbers.0.chunks_exact(3).map(place).collect()
        };
        let faces = self.faces.0.chunks_exact(3).map(|face| [face[0].into(), face[1].into(), face[2].into()]);
        let mesh = TriangleMesh { vertices: places(&self.inspiration), faces: faces.collect() };
        let Simplified { kept, faces } = simplify(&mesh, &places(&self.expiration), most);
        let of_kept = |numbers: &Packed<u16>| {
            Packed(kept.iter().flat_map(|&v| numbers.0[3 * v as usize..][..3].to_vec()).collect())
        };
        (self.inspiration, self.expiration) = (of_kept(&self.inspiration), of_kept(&self.expiration));
        self.last = self.last.as_ref().map(of_kept);
        self.faces = Packed(faces.iter().flatten().map(|&v| v as u16).collect());
        kept
    }

    /// Vertices.
    pub fn vertices(&self) -> usize {
        self.inspiration.0.len() / 3
    }

    pub(super) fn check(&self) -> Result<()> {
        let vertices = self.vertices();
        let places = [Some(&self.inspiration), Some(&self.expiration), self.last.as_ref()];
        let is_whole = places.into_iter().flatten().all(|places| places.0.len() == 3 * vertices);
        let is_known = self.faces.0.iter().all(|&v| usize::from(v) < vertices);
        if !is_whole || !is_known || !self.faces.0.len().is_multiple_of(3) || self.step_mm <= 0.0 {
            return Err(Error::input(
                "the airway needs three numbers a vertex in each of its states, and known vertices",
            ));
        }
        Ok(())
    }
}

impl ReducedAirway {
    /// How far `predicted`, places of all true vertices, is from `last`, the true surface where no phase says it.
    pub fn surface_from(&self, last: &TriangleMesh, predicted: &[DVec3]) -> SurfaceScene {
        let [truth, predicted] = [&last.vertices, predicted].map(|vertices| pick(vertices, &self.kept));
        errors(&truth, &predicted)
    }

    /// How far `predicted`, places of all true vertices, is from the true surface at `phase`; `stated` is the phase
    /// that the row has there.
    pub fn surface(
        &self,
        [inspiration, expiration]: [&TriangleMesh; 2],
        predicted: &[DVec3],
        phase: f64,
        stated: Option<f64>,
    ) -> SurfaceScene {
        let [start, end, predicted] =
            [&inspiration.vertices, &expiration.vertices, predicted].map(|vertices| pick(vertices, &self.kept));
        let is_near = |blend: Vec<DVec3>| blend.iter().zip(&predicted).all(|(a, b)| a.distance(*b) < SAME_SURFACE_MM);
        if stated.is_some_and(|stated| is_near(interpolate(&start, &end, stated))) {
            return SurfaceScene::ByPhase;
        }
        errors(&interpolate(&start, &end, phase), &predicted)
    }
}

/// Distances of vertices as codes.
fn errors(truth: &[DVec3], predicted: &[DVec3]) -> SurfaceScene {
    let [low, high] = ERROR_SCALE_MM.map(f64::ln);
    let code = |(truth, place): (&DVec3, &DVec3)| {
        let error_mm = truth.distance(*place);
        let share = (error_mm.max(1e-9).ln() - low) / (high - low);
        if error_mm.is_finite() { (share.clamp(0.0, 1.0) * ERROR_CODES).round() as u8 } else { u8::MAX }
    };
    SurfaceScene::AtEnd(Packed(truth.iter().zip(predicted).map(code).collect()))
}
