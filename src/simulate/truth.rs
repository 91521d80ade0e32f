//! Ground truth per frame that is written on request: the wall at each pixel's central ray.

use glam::{DAffine3, DVec2, DVec3};
use rayon::prelude::*;
use serde::{Serialize, Serializer};

use crate::base::statistics::upper_median;
use crate::base::{Camera, Image, Result, TriangleMesh};
use crate::render::Scene;
use crate::render::probe::{SurfacePoint, image_of, probe};

/// Tissue beyond the picture's rim by more than this part of the picture has left it, as far as its way is concerned; and
/// in how many steps the part of its way is found that has not.
const BESIDE_PICTURE: f64 = 0.5;
const BISECTIONS: u32 = 12;

/// A kind of ground-truth image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum TruthMap {
    /// Unit normal of the mesh's face in camera axes (OpenCV), pointing into the lumen.
    Normals,
    /// Albedo of the tissue's base (linear), vessels and all; under the film of mucus.
    Albedo,
    /// Motion of the tissue at the pixel to the next and from the previous frame, in the scanner's frame, mm.
    Motion,
    /// |dI/dphase| of the encoded, noise-free image at a camera that stays in place.
    PhaseSensitivity,
}

impl TruthMap {
    /// All of them.
    pub const ALL: [TruthMap; 4] = [TruthMap::Normals, TruthMap::Albedo, TruthMap::Motion, TruthMap::PhaseSensitivity];

    /// Its name in commands.
    pub fn name(self) -> &'static str {
        match self {
            TruthMap::Normals => "normals",
            TruthMap::Albedo => "albedo",
            TruthMap::Motion => "motion",
            TruthMap::PhaseSensitivity => "phase-sensitivity",
        }
    }
}

impl std::str::FromStr for TruthMap {
    type Err = String;

    fn from_str(name: &str) -> std::result::Result<Self, String> {
        TruthMap::ALL.into_iter().find(|t| t.name() == name).ok_or_else(|| {
            let known: Vec<&str> = TruthMap::ALL.iter().map(|t| t.name()).collect();
            format!("there is no truth `{name}`; there are {}", known.join(", "))
        })
    }
}

/// Which ground-truth images are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TruthSet(u8);

impl TruthSet {
    /// Whether `map` is among them.
    pub fn has(self, map: TruthMap) -> bool {
        self.0 & (1 << map as u8) != 0
    }
}

impl FromIterator<TruthMap> for TruthSet {
    fn from_iter<I: IntoIterator<Item = TruthMap>>(maps: I) -> Self {
        TruthSet(maps.into_iter().fold(0, |set, map| set | 1 << map as u8))
    }
}

impl Serialize for TruthSet {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.collect_seq(TruthMap::ALL.into_iter().filter(|&map| self.has(map)))
    }
}

/// The wall visible in one frame.
pub struct VisibleWall<'a> {
    points: Vec<Option<SurfacePoint>>,
    width: usize,
    rest: &'a TriangleMesh,
    other: &'a [DVec3],
}

impl<'a> VisibleWall<'a> {
    /// Casts the central ray of every pixel into `scene`, which is deformed to the frame's phase; `rest` is the airway
    /// at inspiration and `other` its vertices at expiration.
    pub fn new(
        scene: &Scene,
        camera: &Camera,
        world_from_camera: &DAffine3,
        rest: &'a TriangleMesh,
        other: &'a [DVec3],
    ) -> Result<Self> {
        Ok(VisibleWall { points: probe(scene, camera, world_from_camera)?, width: camera.width as usize, rest, other })
    }

    /// Normals at `phase`, camera axes.
    pub fn normals(&self, phase: f64, world_from_camera: &DAffine3) -> Image<f32> {
        let camera_from_world = world_from_camera.matrix3.transpose();
        image_of(&self.points, self.width, 3, |point, out| {
            let corners = self.rest.faces[point.face as usize]
                .map(|v| self.rest.vertices[v as usize].lerp(self.other[v as usize], phase));
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
            out.copy_from_slice(&(camera_from_world * normal).to_array().map(|v| v as f32));
        })
    }

    /// Normals of the wall with its vertices at `vertices`, camera axes.
    pub fn normals_of(&self, vertices: &[DVec3], world_from_camera: &DAffine3) -> Image<f32> {
        let camera_from_world = world_from_camera.matrix3.transpose();
        image_of(&self.points, self.width, 3, |point, out| {
            let corners = self.rest.faces[point.face as usize].map(|v| vertices[v as usize]);
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
            out.copy_from_slice(&(camera_from_world * normal).to_array().map(|v| v as f32));
        })
    }

    /// Displacement of the visible tissue from vertices at `from` to vertices at `to`, mm, scanner's frame.
    pub fn motion_between(&self, from: &[DVec3], to: &[DVec3]) -> Image<f32> {
        image_of(&self.points, self.width, 3, |point, out| {
            let way = point.on(to, &self.rest.faces) - point.on(from, &self.rest.faces);
            out.copy_from_slice(&way.to_array().map(|v| v as f32));
        })
    }

    /// What the pixels show, row-major.
    pub fn points(&self) -> &[Option<SurfacePoint>] {
        &self.points
    }

    /// Way in pixels of the tissue at each pixel over the image of `camera`, from one pose and wall to another; 0 where
    /// nothing is visible. Of what leaves the picture by far, or passes the camera, the part about the middle of the way.
    pub fn image_ways_px(&self, camera: &Camera, from: (&DAffine3, &[DVec3]), to: (&DAffine3, &[DVec3])) -> Vec<DVec2> {
        let eyes = [from, to].map(|(pose, vertices)| (pose.inverse(), vertices));
        let (low, high) = (DVec2::ZERO, DVec2::new(f64::from(camera.width), f64::from(camera.height)));
        let room = (high - low) * BESIDE_PICTURE;
        let is_near = |at: &DVec2| at.cmpge(low - room).all() && at.cmple(high + room).all();
        let project = |place: DVec3| camera.project(place).filter(is_near);
        let way = |point: &SurfacePoint| {
            let [from, to] = [0, 1].map(|k| eyes[k].0.transform_point3(point.on(eyes[k].1, &self.rest.faces)));
            let way = |[a, b]: [DVec3; 2]| Some(project(b)? - project(a)?);
            if let Some(whole) = way([from, to]) {
                return Some(whole);
            }
            // The longest part about the middle.
            let middle = from.midpoint(to);
            let part = |share: f64| way([from, to].map(|end| middle.lerp(end, share)));
            let (mut inside, mut outside, mut found) = (0.0, 1.0, None);
            for _ in 0..BISECTIONS {
                let share = 0.5 * (inside + outside);
                match part(share) {
                    None => outside = share,
                    some => (inside, found) = (share, some),
                }
            }
            found
        };
        let all = self.points.par_iter().map(|point| point.as_ref().and_then(way).unwrap_or(DVec2::ZERO));
        all.collect()
    }

    /// Albedo of the base.
    pub fn albedo(&self) -> Image<f32> {
        image_of(&self.points, self.width, 3, |point, out| out.copy_from_slice(&point.albedo))
    }

    /// Displacement of the visible tissue from `phase` to `other_phase`, mm, scanner's frame.
    pub fn motion(&self, phase: f64, other_phase: f64) -> Image<f32> {
        image_of(&self.points, self.width, 3, |point, out| {
            let from_rest = point.on(self.other, &self.rest.faces) - point.on(&self.rest.vertices, &self.rest.faces);
            out.copy_from_slice(&(from_rest * (other_phase - phase)).to_array().map(|v| v as f32));
        })
    }

    /// Median distance in pixels that the visible tissue moves over the image from one state of camera and airway to
    /// another; 0 where nothing is visible in both.
    pub fn image_motion_px(&self, camera: &Camera, from: (&DAffine3, f64), to: (&DAffine3, f64)) -> f64 {
        let image_point = |point: &SurfacePoint, (pose, phase): (&DAffine3, f64)| {
            let [a, b] = [&self.rest.vertices[..], self.other].map(|v| point.on(v, &self.rest.faces));
            camera.project(pose.inverse().transform_point3(a.lerp(b, phase)))
        };
        let ways =
            self.points.iter().flatten().filter_map(|p| Some(image_point(p, from)?.distance(image_point(p, to)?)));
        upper_median(ways).unwrap_or(0.0)
    }
}
