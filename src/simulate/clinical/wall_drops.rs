//! Secretions and bubbles that ride on the wall.
//!
//! Each sits on a vertex of the mesh and moves with it. A pixel shows one where the tissue at it lies, in the rest shape,
//! within the drop's radius. Secretions are flat patches with a ragged rim: they hide the tissue by up to three quarters
//! (its radiance is scaled to their own pale colour) and have a wet highlight. Bubbles are caps of a thin skin: a dark
//! rim, and two small highlights of the lamp. Highlights are Blinn's lobes about the drop's own normal, for the lamp's
//! distance and place. Drops are thin: depth and surfaces are those of the wall below them. Left out: refraction, shadows
//! of drops, secretions that flow.

use glam::DVec3;
use rayon::prelude::*;

use crate::airway::Anatomy;
use crate::airway::case::ClinicalSettings;
use crate::base::random::{CounterRng, Stage};
use crate::base::{Image, TriangleMesh};
use crate::render::Light;
use crate::render::probe::SurfacePoint;

/// Radii in mm from which those of patches and bubbles are drawn.
const PATCH_MM: [f64; 2] = [0.8, 3.0];
const BUBBLE_MM: [f64; 2] = [0.25, 0.8];
/// A drop is at most this part of the distance from the wall to the route.
const MOST_OF_LUMEN: f64 = 0.55;
/// Vertices farther than this from the route bear none, mm.
const REACH_MM: f64 = 14.0;
/// Of the bubbles, this part sits on a patch.
const ON_PATCH: f64 = 0.6;
/// Albedo of a secretion: from clear to purulent.
const PALE: [[f32; 3]; 2] = [[0.62, 0.56, 0.50], [0.78, 0.72, 0.48]];
/// Most that a patch hides, and that its colour may brighten the tissue.
const OPAQUE: f64 = 0.75;
const MOST_GAIN: f32 = 4.0;
/// Exponents of the highlights and the part of light that a water surface reflects.
const WET_EXPONENT: i32 = 160;
const SKIN_EXPONENT: i32 = 500;
const REFLECTED: f64 = 0.02;

#[derive(Clone, Copy, Debug, PartialEq)]
enum DropKind {
    Patch,
    Bubble,
}

/// One of them.
#[derive(Clone, Copy, Debug)]
struct WallDrop {
    kind: DropKind,
    vertex: u32,
    /// Place in the rest shape.
    rest: DVec3,
    radius_mm: f64,
    color: [f32; 3],
    /// Number and start of the waves of a patch's rim.
    rim: [f64; 2],
}

/// Those of one film.
#[derive(Clone, Debug, Default)]
pub struct WallDrops(Vec<WallDrop>);

impl WallDrops {
    /// Along `route_mm`, points of the scope's route at inspiration; `settings` are the film's own.
    pub fn new(anatomy: &Anatomy, route_mm: &[DVec3], settings: &ClinicalSettings, seed: u64) -> WallDrops {
        let picture = &settings.picture;
        let length_cm = route_mm.windows(2).map(|w| w[0].distance(w[1])).sum::<f64>() / 10.0;
        let vertices = &anatomy.inspiration.vertices;
        let off = |v: &DVec3| route_mm.iter().map(|p| p.distance_squared(*v)).fold(f64::INFINITY, f64::min).sqrt();
        let near: Vec<(u32, f64)> = vertices
            .par_iter()
            .enumerate()
            .map(|(i, v)| (i as u32, off(v)))
            .filter(|(_, off_mm)| *off_mm < REACH_MM)
            .collect();
        let mut drops: Vec<WallDrop> = Vec::new();
        if near.is_empty() {
            return WallDrops(drops);
        }
        let count = |per_cm: f64| (per_cm * length_cm).round() as u64;
        for index in 0..count(picture.secretions_per_cm) {
            let mut random = CounterRng::new(seed, Stage::Clinical, &[9, index]);
            let (vertex, off_mm) = near[random.index(near.len())];
            let pus = random.uniform() as f32;
            drops.push(WallDrop {
                kind: DropKind::Patch,
                vertex,
                rest: vertices[vertex as usize],
                radius_mm: random.range(PATCH_MM[0], PATCH_MM[1]).min(MOST_OF_LUMEN * off_mm),
                color: [0, 1, 2].map(|c| PALE[0][c] + pus * (PALE[1][c] - PALE[0][c])),
                rim: [random.range(2.0, 5.0), random.range(0.0, std::f64::consts::TAU)],
            });
        }
        let patches = drops.clone();
        for index in 0..count(picture.bubbles_per_cm) {
            let mut random = CounterRng::new(seed, Stage::Clinical, &[10, index]);
            let host =
                (random.uniform() < ON_PATCH && !patches.is_empty()).then(|| patches[random.index(patches.len())]);
            let among: Vec<(u32, f64)> = host.map_or_else(Vec::new, |patch| {
                let on_it = |(v, _): &&(u32, f64)| vertices[*v as usize].distance(patch.rest) < patch.radius_mm;
                near.iter().filter(on_it).copied().collect()
            });
            let from = if among.is_empty() { &near } else { &among };
            let (vertex, off_mm) = from[random.index(from.len())];
            drops.push(WallDrop {
                kind: DropKind::Bubble,
                vertex,
                rest: vertices[vertex as usize],
                radius_mm: random.range(BUBBLE_MM[0], BUBBLE_MM[1]).min(0.3 * off_mm),
                color: [0.0; 3],
                rim: [0.0; 2],
            });
        }
        WallDrops(drops)
    }

    /// Whether there are any.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Puts them into `radiance`: `points` are what its pixels show, `rest` the airway at inspiration and `vertices` as
    /// it is, `eye` the camera's place. Returns how much of the wall each pixel hides, 0 to 255.
    pub fn cover(
        &self,
        radiance: &mut Image<f32>,
        points: &[Option<SurfacePoint>],
        (rest, vertices): (&TriangleMesh, &[DVec3]),
        eye: DVec3,
        light: &Light,
    ) -> Image<u8> {
        let mut hidden = Image::filled(radiance.width, radiance.height, 1, 0u8);
        if self.is_empty() {
            return hidden;
        }
        let lamp = light.position_mm.unwrap_or(eye);
        let pixels = radiance.data.par_chunks_exact_mut(3).zip(hidden.data.par_iter_mut()).zip(points.par_iter());
        pixels.for_each(|((pixel, hidden), point)| {
            let Some(point) = point else { return };
            let home = point.on(&rest.vertices, &rest.faces);
            for drop in self.0.iter().filter(|d| d.rest.distance_squared(home) < d.radius_mm * d.radius_mm) {
                let corners = rest.faces[point.face as usize].map(|v| vertices[v as usize]);
                let here = point.on(vertices, &rest.faces);
                let wall = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or(DVec3::Z);
                let centre = vertices[drop.vertex as usize];
                let shade = DropShade { here, wall, centre, eye, lamp, intensity: light.intensity };
                let part = match drop.kind {
                    DropKind::Patch => drop.patch(home, &shade, point.albedo, pixel),
                    DropKind::Bubble => drop.bubble(home, &shade, pixel),
                };
                *hidden = (*hidden).max((255.0 * part).round() as u8);
            }
        });
        hidden
    }
}

/// Where light comes from and goes at one point of a drop.
struct DropShade {
    here: DVec3,
    wall: DVec3,
    centre: DVec3,
    eye: DVec3,
    lamp: DVec3,
    intensity: [f64; 3],
}

impl DropShade {
    /// Unit vector along the wall, away from the drop's middle.
    fn outwards(&self) -> DVec3 {
        (self.here - self.centre).reject_from(self.wall).normalize_or_zero()
    }

    /// Radiance by Blinn's lobe about `normal` (a normalised lobe of `exponent` on water).
    fn highlight(&self, normal: DVec3, exponent: i32) -> [f64; 3] {
        let to_lamp = self.lamp - self.here;
        let (to_lamp, d2) = (to_lamp.normalize_or_zero(), to_lamp.length_squared().max(0.04));
        let half = (to_lamp + (self.eye - self.here).normalize_or_zero()).normalize_or_zero();
        let lobe =
            normal.dot(half).max(0.0).powi(exponent) * (f64::from(exponent) + 8.0) / (8.0 * std::f64::consts::PI);
        self.intensity.map(|power| power / d2 * REFLECTED * lobe * normal.dot(to_lamp).max(0.0))
    }
}

impl WallDrop {
    fn patch(&self, home: DVec3, shade: &DropShade, tissue: [f32; 3], pixel: &mut [f32]) -> f64 {
        // A ragged rim: the radius waves with the place.
        let off = home - self.rest;
        let wave = (self.rim[0] * (off.x + 1.7 * off.y - 0.6 * off.z) + self.rim[1]).sin();
        let place = off.length() / self.radius_mm * (1.15 + 0.15 * wave);
        let height = 1.0 - place * place;
        if height <= 0.0 {
            return 0.0;
        }
        let part = OPAQUE * (1.0 - (-3.0 * height).exp());
        // Thick in the middle, so its surface leans outwards towards the rim.
        let normal = (shade.wall + shade.outwards() * (0.5 * place)).normalize_or(shade.wall);
        let glint = shade.highlight(normal, WET_EXPONENT);
        for c in 0..3 {
            let gain = (self.color[c] / tissue[c].max(0.05)).min(MOST_GAIN);
            pixel[c] += part as f32 * (pixel[c] * gain - pixel[c]) + glint[c] as f32;
        }
        part
    }

    fn bubble(&self, home: DVec3, shade: &DropShade, pixel: &mut [f32]) -> f64 {
        let place = (home.distance(self.rest) / self.radius_mm).min(1.0);
        // Seen along its skin, a bubble hides what is behind it; elsewhere one looks through.
        let rim = ((place - 0.7) / 0.3).clamp(0.0, 1.0);
        let normal = shade.outwards() * place + shade.wall * (1.0 - place * place).sqrt();
        let inner = shade.wall * (1.0 - place * place).sqrt() - shade.outwards() * place;
        let (front, back) = (shade.highlight(normal, SKIN_EXPONENT), shade.highlight(inner, SKIN_EXPONENT / 2));
        for c in 0..3 {
            pixel[c] = pixel[c] * (1.0 - 0.45 * (rim * (2.0 - rim)) as f32) + (front[c] + 0.4 * back[c]) as f32;
        }
        0.25 + 0.5 * rim
    }
}
