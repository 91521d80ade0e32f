//! Light and the knobs of one rendering.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::base::range::NumberRange;
use crate::base::{Error, Result};

/// Most pixels of an image: more would need over 4 GiB for the film.
const MOST_PIXELS: u64 = 1 << 24;
/// Width and height of an image in pixels; [`check_size`] bounds their product.
pub(super) const STILL_SIDE_PX: NumberRange = NumberRange::new(1.0, MOST_PIXELS as f64);
/// Rays per face of light at vertices.
pub(super) const RAYS_PER_FACE: NumberRange = NumberRange::new(1.0, 4096.0);
/// Emission exponents of a light.
pub(super) const EMISSION_EXPONENT: NumberRange = NumberRange::new(0.0, 1e3);

/// Refuses images of more than 2^24 pixels.
pub(super) fn check_size(width_px: u32, height_px: u32) -> Result<()> {
    if u64::from(width_px) * u64::from(height_px) > MOST_PIXELS {
        let sentence =
            format!("an image of {width_px}x{height_px} pixels is too large: {MOST_PIXELS} in all is the most");
        return Err(Error::input(sentence));
    }
    Ok(())
}

/// A point light with inverse-square falloff.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Light {
    /// Radiant intensity per channel in W/sr; irradiance is `intensity * cos / distance_mm^2`.
    pub intensity: [f64; 3],
    /// Position in the world in mm; `None` is at the camera.
    #[serde(default, rename = "position", skip_serializing_if = "Option::is_none")]
    pub position_mm: Option<DVec3>,
    /// Emission profile: in directions that make the angle t with the camera's axis the intensity is `intensity *
    /// max(cos t, 0)^emission_exponent`. 0 is even in all directions (backwards too); 1 is a polished fibre face that
    /// radiates by Lambert's law; a fibre bundle of smaller aperture has more ([`Light::exponent_of_half_angle`]).
    #[serde(default)]
    pub emission_exponent: f64,
}

impl Light {
    /// A light of `intensity` at the camera.
    pub fn at_camera(intensity: [f64; 3]) -> Self {
        Light { intensity, position_mm: None, emission_exponent: 0.0 }
    }

    /// The emission exponent of a bundle that is half as bright at `half_angle_deg` from its axis as on it.
    pub fn exponent_of_half_angle(half_angle_deg: f64) -> f64 {
        0.5f64.ln() / half_angle_deg.to_radians().cos().ln()
    }
}

/// Which normals are shaded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Shading {
    /// The triangles' own.
    #[default]
    Flat,
    /// Interpolated from area-weighted vertex normals.
    Smooth,
}

/// With so few rays a face, light at vertices is a draft.
pub const DRAFT_RAYS_PER_FACE: u32 = 4;

/// How light that does not come straight from the lamp is found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Transport {
    /// Paths from every camera sample: no bias, noise.
    #[default]
    Paths,
    /// At the vertices that the camera sees, interpolated (`vertex_light.rs`): a little bias, hardly any noise. Faces
    /// must be wound so that their normals point into the lumen.
    Vertices {
        /// Rays that every face around a seen vertex sends out, 1 to 4096. With [`DRAFT_RAYS_PER_FACE`] or fewer, light
        /// that scatters in the wall is a draft, too: 32 walks for a vertex, and not 256 to 4096.
        rays_per_face: u32,
    },
    /// A ray (or a walk) from every camera sample, and light at the vertices of what it meets: less bias and more noise
    /// than [`Transport::Vertices`], a fraction of the noise of [`Transport::Paths`]. For stills; faces wound as there.
    Gather {
        /// As in [`Transport::Vertices`].
        rays_per_face: u32,
    },
}

impl Transport {
    /// Light at vertices with as many rays as the measurements of `docs/decisions/0005-light-at-vertices.md` suggest.
    pub const VERTICES: Transport = Transport::Vertices { rays_per_face: 32 };
    /// Light at vertices in a third of the time: right in kind, and off by tens of per cent here and there.
    pub const DRAFT: Transport = Transport::Vertices { rays_per_face: DRAFT_RAYS_PER_FACE };
    /// A ray or walk, then light at vertices, with as many rays.
    pub const GATHER: Transport = Transport::Gather { rays_per_face: 32 };
}

/// Whether the indirect light is filtered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Denoise {
    /// Unbiased.
    #[default]
    Off,
    /// Edge-aware filter of the demodulated indirect light (`denoise.rs` states its bias).
    On,
}

/// The knobs of one rendering.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Surface scatterings of the longest path, direct light = 1; 0 = unlimited (Russian roulette ends the paths).
    pub max_scatterings: u32,
    /// Camera samples per pixel.
    pub samples_per_pixel: u32,
    /// With `Some(target)`: tiles double their samples, from `samples_per_pixel`, while their estimated mean of (error
    /// / radiance)^2 is above `target`, until that of the image is below it.
    pub target_relmse: Option<f64>,
    /// How indirect light is found.
    pub transport: Transport,
    /// Normals.
    pub shading: Shading,
    /// Filter.
    pub denoise: Denoise,
    /// Radiance of rays that leave the scene.
    pub background: [f64; 3],
    /// Seed of the samples.
    pub seed: u64,
    /// Frame number: two frames of one seed have different noise.
    pub frame: u64,
}

impl Default for RenderSettings {
    fn default() -> Self {
        RenderSettings {
            max_scatterings: 0,
            samples_per_pixel: 16,
            target_relmse: None,
            transport: Transport::Paths,
            shading: Shading::Flat,
            denoise: Denoise::Off,
            background: [0.0; 3],
            seed: 1,
            frame: 0,
        }
    }
}
