//! The imperfections of the scope: light, lens, sensor, automatic exposure. Each has its own switch in the case file,
//! and a profile or a command can switch any of them off by name.

use serde::{Deserialize, Serialize};

use crate::base::Result;
use crate::base::range::{KeyRanges, NumberRange, SHARE};

/// Ranges of `[exposure]`.
const EXPOSURE_RANGES: KeyRanges = KeyRanges(&[
    ("target", NumberRange::new(0.05, 0.9)),
    ("lag_s", NumberRange::new(1e-3, 60.0).or_zero()),
    ("overshoot", NumberRange::new(1e-6, 0.9).or_zero()),
    ("drift", SHARE),
    ("white_balance_drift", SHARE),
]);
/// Ranges of `[scope]`; the half angle's 0 is even light.
const SCOPE_RANGES: KeyRanges = KeyRanges(&[
    ("emission_half_angle_deg", NumberRange::new(5.0, 85.0).or_zero()),
    ("vignette", SHARE),
    ("shot_noise", NumberRange::new(1e-6, 0.5).or_zero()),
    ("read_noise", NumberRange::new(0.0, 0.5)),
    ("shutter_s", SHARE),
    ("mask_radius", NumberRange::new(0.0, 2.0)),
]);

/// What sets the gain.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ExposureControl {
    /// The scope's automatic exposure.
    #[default]
    Automatic,
    /// One gain for the whole film: the median of those that the automatic exposure would have aimed for.
    Fixed,
}

/// Automatic exposure and its imperfections.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ExposureSettings {
    /// What sets the gain.
    pub control: ExposureControl,
    /// Mean encoded brightness that the automatic exposure aims for.
    pub target: f64,
    /// Time constant in seconds with which it follows the scene; 0 follows at once.
    pub lag_s: f64,
    /// After a jump of the scene's brightness the log gain overshoots by this part of the jump; 0 never does.
    pub overshoot: f64,
    /// Standard deviation of the slow drift of log gain.
    pub drift: f64,
    /// Standard deviation of the slow drift of log red and log blue.
    pub white_balance_drift: f64,
}

impl Default for ExposureSettings {
    fn default() -> Self {
        ExposureSettings {
            control: ExposureControl::Automatic,
            target: 0.42,
            lag_s: 0.25,
            overshoot: 0.1,
            drift: 0.06,
            white_balance_drift: 0.025,
        }
    }
}

/// `[scope]`: light guide, lens and sensor. 0 switches an effect off.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScopeSettings {
    /// The fibre bundle is half as bright at this angle from its axis as on it: intensity falls with the power ln(1/2)
    /// / ln(cos angle) of the cosine. 60 is a fibre face that radiates by Lambert's law; 0 is even in all directions.
    pub emission_half_angle_deg: f64,
    /// Vignette: irradiance on the sensor falls by this part of what the cos^4 law says; 1 is the law itself.
    pub vignette: f64,
    /// Shot noise: standard deviation of a white pixel (linear value 1) at the film's middle gain, 1 / sqrt(electrons).
    pub shot_noise: f64,
    /// Read noise: standard deviation of a black pixel (linear) at the film's middle gain.
    pub read_noise: f64,
    /// Motion blur: the shutter is open for this long around the time of a frame, in seconds.
    pub shutter_s: f64,
    /// Circular image mask: its radius as a part of half the image's shorter side; black outside.
    pub mask_radius: f64,
}

impl Default for ScopeSettings {
    fn default() -> Self {
        ScopeSettings {
            emission_half_angle_deg: 60.0,
            vignette: 0.2,
            shot_noise: 0.007,
            read_noise: 0.0003,
            shutter_s: 0.0,
            mask_radius: 0.0,
        }
    }
}

/// An effect that can be switched off by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Effect {
    /// The fibre bundle's emission profile: the light becomes even.
    Emission,
    /// Automatic exposure: one gain for the whole film.
    AutoExposure,
    /// The automatic exposure's lag, and with it its overshoot.
    Lag,
    /// The automatic exposure's overshoot.
    Overshoot,
    /// The slow drift of the gain.
    GainDrift,
    /// The slow drift of the white balance.
    WhiteBalance,
    /// The sensor's shot noise.
    ShotNoise,
    /// The sensor's read noise.
    ReadNoise,
    /// The lens's darker rim.
    Vignette,
    /// The lens's fisheye distortion: the camera becomes a pinhole of the same view.
    Distortion,
    /// Motion during the exposure.
    MotionBlur,
    /// The circular image mask.
    Mask,
    /// The steering hand: the scope goes along the middle of the airway at one speed.
    Steering,
}

impl Effect {
    /// All of them.
    pub const ALL: [Effect; 13] = [
        Effect::Emission,
        Effect::AutoExposure,
        Effect::Lag,
        Effect::Overshoot,
        Effect::GainDrift,
        Effect::WhiteBalance,
        Effect::ShotNoise,
        Effect::ReadNoise,
        Effect::Vignette,
        Effect::Distortion,
        Effect::MotionBlur,
        Effect::Mask,
        Effect::Steering,
    ];

    /// Its name in profiles and commands.
    pub fn name(self) -> &'static str {
        match self {
            Effect::Emission => "emission",
            Effect::AutoExposure => "auto-exposure",
            Effect::Lag => "lag",
            Effect::Overshoot => "overshoot",
            Effect::GainDrift => "gain-drift",
            Effect::WhiteBalance => "white-balance",
            Effect::ShotNoise => "shot-noise",
            Effect::ReadNoise => "read-noise",
            Effect::Vignette => "vignette",
            Effect::Distortion => "distortion",
            Effect::MotionBlur => "motion-blur",
            Effect::Mask => "mask",
            Effect::Steering => "steering",
        }
    }
}

impl std::str::FromStr for Effect {
    type Err = String;

    fn from_str(name: &str) -> std::result::Result<Self, String> {
        Effect::ALL.into_iter().find(|e| e.name() == name).ok_or_else(|| {
            let known: Vec<&str> = Effect::ALL.iter().map(|e| e.name()).collect();
            format!("there is no effect `{name}`; there are {}", known.join(", "))
        })
    }
}

/// Rejects values that no scope can have; the error names the key.
pub(super) fn validate(exposure: &ExposureSettings, scope: &ScopeSettings) -> Result<()> {
    EXPOSURE_RANGES.check("exposure", exposure)?;
    SCOPE_RANGES.check("scope", scope)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_files() {
        for effect in Effect::ALL {
            assert_eq!(serde_json::to_value(effect).unwrap(), effect.name());
            assert_eq!(effect.name().parse::<Effect>().unwrap(), effect);
        }
        assert!("glare".parse::<Effect>().unwrap_err().contains("auto-exposure, lag"));
    }

    #[test]
    fn wrong_values_are_named() {
        let scope = ScopeSettings { emission_half_angle_deg: 1.0, ..ScopeSettings::default() };
        let said = validate(&ExposureSettings::default(), &scope).unwrap_err().to_string();
        assert!(said.starts_with("scope.emission_half_angle_deg: "), "{said}");
        let scope = ScopeSettings { read_noise: f64::NAN, ..ScopeSettings::default() };
        assert!(validate(&ExposureSettings::default(), &scope).is_err());
        assert!(validate(&ExposureSettings::default(), &ScopeSettings::default()).is_ok());
    }
}
