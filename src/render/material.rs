//! The wall's material, as case and scene files describe it.

use serde::{Deserialize, Serialize};

use crate::base::random::{CounterRng, Stage};
use crate::base::range::{KeyRanges, NumberRange, SHARE};
use crate::base::{Error, Result};
use crate::ffi::trace::tracer::{MaterialSettings, SubsurfaceKind};

/// Strengths of the look's parts.
const STRENGTH: NumberRange = NumberRange::new(0.0, 3.0);
/// Ranges of `[material]`.
const RANGES: KeyRanges = KeyRanges(&[
    ("albedo", SHARE),
    ("coat_alpha", NumberRange::new(1e-3, 1.0)),
    ("coat_ior", NumberRange::new(1.0 + 1e-6, 4.0)),
    ("mean_free_path_mm", NumberRange::new(1e-4, 1e6)),
    ("single_scattering_albedo", SHARE),
    ("vessels", STRENGTH),
    ("blotches", STRENGTH),
    ("relief", NumberRange::new(0.0, 10.0)),
    ("film", STRENGTH),
    ("rings", STRENGTH),
    ("ring_spacing_mm", NumberRange::new(0.1, 1e3)),
    ("folds", STRENGTH),
    ("spurs", STRENGTH),
    ("anthracosis", STRENGTH),
]);

/// Family of a material.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MaterialKind {
    /// Lambert: `albedo / pi`.
    Lambert,
    /// GGX dielectric coat over Lambert.
    Coated,
    /// Random walk below the surface, uncoated.
    Subsurface,
    /// `Coated` with procedural vessels, blotches, mucus film and relief on the rest shape.
    #[default]
    Mucosa,
}

/// Whether light scatters through the wall of a `coated` or `mucosa` material.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Subsurface {
    /// It leaves where it enters (Lambert base).
    Off,
    /// It scatters in the wall (`mean_free_path_mm`, at the first vertex of a path; diffuse boundary below the coat).
    Walk,
}

/// How light passes the surface of a `subsurface` wall.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Boundary {
    /// Enters by the cosine law and leaves as from a Lambert surface of albedo 1.
    #[default]
    Diffuse,
    /// Half enters by the cosine law, half is refracted by `coat_ior` through microfacets of GGX alpha 1; leaves as
    /// from a Lambert surface of albedo 1 (the random walk of Blender 4).
    Mixed,
    /// Same refractive index on both sides: neither bent nor reflected.
    Matched,
}

/// At which vertices of a path light scatters through a `subsurface` wall.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WalkedVertices {
    /// The one that the camera sees; later ones are Lambert surfaces of the equivalent diffuse albedo.
    #[default]
    First,
    /// All of them.
    Every,
}

/// A material. Keys that a kind does not use are allowed and ignored, so that one file can try several kinds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Material {
    /// Family.
    pub kind: MaterialKind,
    /// Albedo of the base per channel, each in [0, 1]; for `mucosa` the mean around which it varies.
    pub albedo: [f64; 3],
    /// Roughness of the coat: GGX alpha, not its square root; for `mucosa` the roughness of a middling film.
    pub coat_alpha: f64,
    /// Refractive index of the coat.
    pub coat_ior: f64,
    /// Light in the wall of `coated` and `mucosa`; where left out, it scatters in `mucosa` and not in `coated`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub subsurface: Option<Subsurface>,
    /// Mean free path below the surface in mm per channel (`subsurface`).
    pub mean_free_path_mm: [f64; 3],
    /// Single-scattering albedo per channel (`subsurface`); where left out, that whose half-space has `albedo`. A
    /// file gives one of the two ([`Material::as_given`]).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub single_scattering_albedo: Option<[f64; 3]>,
    /// Surface of a `subsurface` wall.
    pub boundary: Boundary,
    /// Where light scatters through a `subsurface` wall.
    pub walk: WalkedVertices,
    /// Strength of the vessels (`mucosa`; 0 none, 1 usual).
    pub vessels: f64,
    /// Strength of colour unevenness (`mucosa`).
    pub blotches: f64,
    /// Strength of fine relief (`mucosa`).
    pub relief: f64,
    /// Strength of the film's roughness variation (`mucosa`).
    pub film: f64,
    /// Strength of cartilage rings: colour and relief (`mucosa`).
    pub rings: f64,
    /// Distance between two rings in mm (`mucosa`).
    pub ring_spacing_mm: f64,
    /// Strength of lengthwise folds: on the membranous back wall of the trachea, and in small airways (`mucosa`).
    pub folds: f64,
    /// How pale the edges of carinas are (`mucosa`).
    pub spurs: f64,
    /// Strength of dark patches of soot (`mucosa`).
    pub anthracosis: f64,
}

impl Default for Material {
    fn default() -> Self {
        Material {
            kind: MaterialKind::Mucosa,
            albedo: [0.75, 0.40, 0.35],
            coat_alpha: 0.15,
            coat_ior: 1.4,
            subsurface: None,
            mean_free_path_mm: [1.0, 0.4, 0.25],
            single_scattering_albedo: None,
            boundary: Boundary::Diffuse,
            walk: WalkedVertices::First,
            vessels: 1.0,
            blotches: 1.0,
            relief: 1.0,
            film: 1.0,
            rings: 1.0,
            ring_spacing_mm: 4.0,
            folds: 1.0,
            spurs: 1.0,
            anthracosis: 0.0,
        }
    }
}

/// Diffuse albedo of a half-space of single-scattering albedo `a`: van de Hulst's law, whose inversion is
/// `single_scattering_albedo` of `cpp/trace/scatter_walk.h`.
///   rho = (1 - s) (1 - 0.139 s) / (1 + 1.17 s),   s = sqrt(1 - a)
fn half_space_albedo(a: f64) -> f64 {
    let s = (1.0 - a).sqrt();
    (1.0 - s) * (1.0 - 0.139 * s) / (1.0 + 1.17 * s)
}

/// Albedo up to which light between walls hardly goes on beyond four bounces. As in `from_lamp_side` of
/// `cpp/trace/wall_material.h`.
const DARK_ALBEDO: f64 = 0.65;

impl Material {
    /// Whether no channel's albedo is above .65: light between such walls is found with less work.
    pub fn is_dark(&self) -> bool {
        self.albedo.iter().all(|&albedo| albedo <= DARK_ALBEDO)
    }

    /// A Lambert wall.
    pub fn lambert(albedo: [f64; 3]) -> Self {
        Material { kind: MaterialKind::Lambert, albedo, ..Material::default() }
    }

    /// A Lambert wall under an even GGX coat.
    pub fn coated(albedo: [f64; 3], coat_alpha: f64, coat_ior: f64) -> Self {
        Material { kind: MaterialKind::Coated, albedo, coat_alpha, coat_ior, ..Material::default() }
    }

    /// An uncoated wall with light scattering in it.
    pub fn subsurface(albedo: [f64; 3], mean_free_path_mm: [f64; 3], boundary: Boundary, walk: WalkedVertices) -> Self {
        Material { kind: MaterialKind::Subsurface, albedo, mean_free_path_mm, boundary, walk, ..Material::default() }
    }

    /// The material as a file means it that gives these `keys`: a `subsurface` wall of a given single-scattering albedo
    /// has the diffuse albedo of its half-space wherever it is taken as a Lambert surface.
    ///
    /// Errors: a `subsurface` wall with both albedos.
    pub fn as_given(self, keys: &toml::Table) -> Result<Self> {
        let given = self.single_scattering_albedo.filter(|_| self.kind == MaterialKind::Subsurface);
        let Some(scattering) = given else { return Ok(self) };
        if keys.contains_key("albedo") {
            let sentence = "stands beside material.albedo, which follows from it; give one of the two";
            return Err(Error::input(sentence).element("material.single_scattering_albedo"));
        }
        // Others are refused by `validate`, under their own name.
        let is_share = scattering.iter().all(|&a| SHARE.contains(a));
        Ok(Material { albedo: if is_share { scattering.map(half_space_albedo) } else { self.albedo }, ..self })
    }

    /// Rejects values that no wall can have; the error names the key.
    pub fn validate(&self) -> Result<()> {
        RANGES.check("material", self)
    }

    /// Settings of the C++ side.
    pub(super) fn settings(&self, seed: u64) -> Result<MaterialSettings> {
        self.validate()?;
        let mucosa = self.kind == MaterialKind::Mucosa;
        let alpha = self.coat_alpha as f32;
        // The film on real mucosa varies in wetness: from 0.5 to 1.7 times the middling roughness.
        let (alpha_low, alpha_high) = if mucosa { (alpha * 0.5, (alpha * 1.7).min(1.0)) } else { (alpha, alpha) };
        Ok(MaterialSettings {
            mucosa,
            coated: matches!(self.kind, MaterialKind::Coated | MaterialKind::Mucosa),
            albedo: self.albedo.map(|v| v as f32),
            alpha_low,
            alpha_high,
            ior: self.coat_ior as f32,
            vessels: self.vessels as f32,
            blotches: self.blotches as f32,
            relief: self.relief as f32,
            film: self.film as f32,
            rings: self.rings as f32,
            ring_spacing_mm: self.ring_spacing_mm as f32,
            folds: self.folds as f32,
            spurs: self.spurs as f32,
            anthracosis: self.anthracosis as f32,
            seed: CounterRng::new(seed, Stage::Texture, &[]).next_u32(),
            subsurface: match (self.kind, self.boundary) {
                (MaterialKind::Subsurface, Boundary::Diffuse | Boundary::Mixed) => SubsurfaceKind::Diffuse,
                (MaterialKind::Subsurface, Boundary::Matched) => SubsurfaceKind::Matched,
                (MaterialKind::Coated, _) if self.subsurface == Some(Subsurface::Walk) => SubsurfaceKind::Diffuse,
                (MaterialKind::Mucosa, _) if self.subsurface != Some(Subsurface::Off) => SubsurfaceKind::Diffuse,
                _ => SubsurfaceKind::Off,
            },
            walk_at_every_vertex: self.kind == MaterialKind::Subsurface && self.walk == WalkedVertices::Every,
            refracted_entry: match (self.kind, self.boundary) {
                (MaterialKind::Subsurface, Boundary::Mixed) => 0.5,
                _ => 0.0,
            },
            extinction: self.mean_free_path_mm.map(|v| (1.0 / v) as f32),
            fixed_scattering: self.kind == MaterialKind::Subsurface && self.single_scattering_albedo.is_some(),
            scattering: self.single_scattering_albedo.unwrap_or([0.0; 3]).map(|v| v as f32),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ffi::trace::tracer::medium_albedo;

    #[test]
    fn a_wrong_value_is_named() {
        let wrong = Material { coat_alpha: f64::NAN, ..Material::default() };
        assert!(wrong.validate().unwrap_err().to_string().starts_with("material.coat_alpha: "));
        let wrong = Material { single_scattering_albedo: Some([0.5, 1.5, 0.5]), ..Material::default() };
        assert!(wrong.validate().unwrap_err().to_string().starts_with("material.single_scattering_albedo[1]: "));
    }

    #[test]
    fn files_may_leave_out_what_is_usual() {
        let m: Material = toml::from_str("kind = \"lambert\"\nalbedo = [0.5, 0.5, 0.5]").unwrap();
        assert_eq!(m, Material::lambert([0.5; 3]));
        assert!(toml::from_str::<Material>("kind = \"velvet\"").is_err());
        assert!(toml::from_str::<Material>("colour = 1").is_err());
    }

    #[test]
    fn the_albedo_of_a_given_medium_is_that_of_its_half_space() {
        for a in [0.0, 0.3, 0.8, 0.95, 0.999, 1.0] {
            let back = f64::from(medium_albedo(half_space_albedo(a) as f32));
            assert!((back - a).abs() < 2e-4, "{a}: {back}");
        }
        let read = |text: &str| -> Result<Material> {
            let keys: toml::Table = toml::from_str(text).unwrap();
            keys.clone().try_into::<Material>().unwrap().as_given(&keys)
        };
        let given = "kind = \"subsurface\"\nsingle_scattering_albedo = [0.95, 0.95, 0.95]";
        assert!(read(given).unwrap().albedo.iter().all(|v| (v - 0.59626).abs() < 1e-5));
        let both = format!("{given}\nalbedo = [0.0, 0.0, 0.0]");
        assert!(read(&both).unwrap_err().to_string().starts_with("material.single_scattering_albedo: "));
        // Other kinds ignore it.
        assert_eq!(read(&both.replace("subsurface", "coated")).unwrap().albedo, [0.0; 3]);
        let wrong = read(&given.replace("0.95]", "1.95]")).unwrap().validate().unwrap_err().to_string();
        assert!(wrong.starts_with("material.single_scattering_albedo[2]: "), "{wrong}");
    }
}
