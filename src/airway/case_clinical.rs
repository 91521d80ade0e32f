//! `[clinical]`: what a hospital's film has beyond the ideal one (PROTOCOL 5). Every number is a size with a source in
//! `docs/clinical.md`; 0 switches its effect off, and [`ClinicalSettings::off`] and [`ClinicalSettings::only`] switch
//! rows of the table by name.
//!
//! Sizes are medians. A film's own are drawn from its case's seed: `size * exp(spread * n)`, n standard normal, within
//! two deviations ([`ClinicalSettings::drawn`]).

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::base::random::{CounterRng, Stage};
use crate::base::range::{KeyRanges, NumberRange, SHARE};
use crate::base::{Error, Result};

/// Ranges of `[clinical]`.
const RANGES: KeyRanges = KeyRanges(&[
    ("spread", SHARE),
    ("surfaces.registration_error_mm", NumberRange::new(0.0, 20.0)),
    ("breathing.hysteresis", SHARE),
    ("breathing.lag_s", NumberRange::new(0.0, 2.0)),
    ("breathing.irregularity", SHARE),
    ("breathing.heartbeat_mm", NumberRange::new(0.0, 10.0)),
    ("breathing.heart_rate_hz", NumberRange::new(0.2, 5.0)),
    ("breathing.coughs", SHARE),
    ("breathing.cough_depth", SHARE),
    ("sensor.noise_mm", NumberRange::new(0.0, 20.0)),
    ("sensor.noise_deg", NumberRange::new(0.0, 45.0)),
    ("sensor.drift_mm", NumberRange::new(0.0, 50.0)),
    ("sensor.drift_deg", NumberRange::new(0.0, 45.0)),
    ("sensor.distortion_mm", NumberRange::new(0.0, 20.0)),
    ("sensor.delay_s", NumberRange::new(0.0, 1.0)),
    ("optics.focal_error", NumberRange::new(0.0, 0.2)),
    ("optics.centre_error", NumberRange::new(0.0, 0.2)),
    ("optics.residual_distortion", NumberRange::new(0.0, 0.1)),
    ("optics.lamp_offset_mm", NumberRange::new(0.0, 10.0)),
    ("optics.lamp_angle_error_deg", NumberRange::new(0.0, 20.0)),
    ("optics.vignette_error", SHARE),
    ("picture.shutter_s", SHARE),
    ("picture.shot_noise", NumberRange::new(1e-6, 0.5).or_zero()),
    ("picture.read_noise", NumberRange::new(0.0, 0.5)),
    ("picture.jpeg_quality", NumberRange::new(1.0, 100.0).or_zero()),
    ("picture.exposure", NumberRange::new(0.1, 10.0).or_zero()),
    ("picture.aperture_mm", NumberRange::new(0.0, 2.0)),
    ("picture.sharp_from_mm", NumberRange::new(0.1, 100.0)),
    ("picture.secretions_per_cm", NumberRange::new(0.0, 50.0)),
    ("picture.bubbles_per_cm", NumberRange::new(0.0, 50.0)),
    ("picture.lens_film", SHARE),
    ("picture.wipe_every_s", NumberRange::new(0.5, 3600.0)),
    ("picture.contact_s", NumberRange::new(0.0, 10.0)),
]);
/// Draws stay within this many deviations of the median.
const MOST_DEVIATIONS: f64 = 2.0;

/// A row of the table of PROTOCOL 5: what can be switched off, or on alone, by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Condition {
    /// The two surfaces are those of a CT import, not the truth.
    Surfaces,
    /// Another way out than in.
    Hysteresis,
    /// Lobes that follow the spirometer late.
    Lag,
    /// Depth and rate that vary from breath to breath.
    BreathVariation,
    /// The beating heart.
    Heartbeat,
    /// A cough.
    Cough,
    /// White noise of the electromagnetic sensor.
    PoseNoise,
    /// Its drift over the film.
    PoseDrift,
    /// The smooth distortion of its field.
    FieldDistortion,
    /// Its delay.
    PoseDelay,
    /// Focal length, centre and distortion that are not those of the calibration.
    Intrinsics,
    /// The light guide beside the lens, with shadows.
    LampOffset,
    /// A lamp profile that is not told.
    LampProfile,
    /// A vignette that is not told.
    Vignette,
    /// Blur by motion while the shutter is open.
    Blur,
    /// The noise of a small sensor.
    Noise,
    /// Lossy compression.
    Compression,
    /// Exposure for the middle of the picture: near walls clip.
    Clipping,
    /// Near walls out of focus.
    Defocus,
    /// Secretions on the wall.
    Secretions,
    /// Bubbles on the wall.
    Bubbles,
    /// A film on the lens, wiped away now and then.
    LensFilm,
    /// A touch of the wall.
    Contact,
}

impl Condition {
    /// All of them, in the order of the table.
    pub const ALL: [Condition; 23] = [
        Condition::Surfaces,
        Condition::Hysteresis,
        Condition::Lag,
        Condition::BreathVariation,
        Condition::Heartbeat,
        Condition::Cough,
        Condition::PoseNoise,
        Condition::PoseDrift,
        Condition::FieldDistortion,
        Condition::PoseDelay,
        Condition::Intrinsics,
        Condition::LampOffset,
        Condition::LampProfile,
        Condition::Vignette,
        Condition::Blur,
        Condition::Noise,
        Condition::Compression,
        Condition::Clipping,
        Condition::Defocus,
        Condition::Secretions,
        Condition::Bubbles,
        Condition::LensFilm,
        Condition::Contact,
    ];

    /// Its name in files and commands.
    pub fn name(self) -> &'static str {
        match self {
            Condition::Surfaces => "surfaces",
            Condition::Hysteresis => "hysteresis",
            Condition::Lag => "lag",
            Condition::BreathVariation => "breath-variation",
            Condition::Heartbeat => "heartbeat",
            Condition::Cough => "cough",
            Condition::PoseNoise => "pose-noise",
            Condition::PoseDrift => "pose-drift",
            Condition::FieldDistortion => "field-distortion",
            Condition::PoseDelay => "pose-delay",
            Condition::Intrinsics => "intrinsics",
            Condition::LampOffset => "lamp-offset",
            Condition::LampProfile => "lamp-profile",
            Condition::Vignette => "vignette",
            Condition::Blur => "blur",
            Condition::Noise => "noise",
            Condition::Compression => "compression",
            Condition::Clipping => "clipping",
            Condition::Defocus => "defocus",
            Condition::Secretions => "secretions",
            Condition::Bubbles => "bubbles",
            Condition::LensFilm => "lens-film",
            Condition::Contact => "contact",
        }
    }
}

impl std::str::FromStr for Condition {
    type Err = String;

    fn from_str(name: &str) -> std::result::Result<Self, String> {
        Condition::ALL.into_iter().find(|c| c.name() == name).ok_or_else(|| {
            let known: Vec<&str> = Condition::ALL.iter().map(|c| c.name()).collect();
            format!("there is no condition `{name}`; there are {}", known.join(", "))
        })
    }
}

/// The two surfaces that methods are given.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SurfaceConditions {
    /// Folder of `inspiration.ply` and `expiration.ply`, relative to the case file; absent is `clinical/<id>` beside
    /// the case file or beside its folder, where that is there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub folder: Option<PathBuf>,
    /// The surface at expiration has a smooth error of this root mean square in mm: without such a folder in place of a
    /// registration's, with it besides, since a case's smooth field is easier to register than a patient.
    pub registration_error_mm: f64,
}

impl Default for SurfaceConditions {
    fn default() -> Self {
        SurfaceConditions { folder: None, registration_error_mm: 1.5 }
    }
}

/// How tissue moves beyond one phase.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BreathingConditions {
    /// Width of the loop between the ways out and in, as a part of the motion that it lies across.
    pub hysteresis: f64,
    /// Longest delay in seconds of a lobe behind the spirometer.
    pub lag_s: f64,
    /// `waveform.irregularity` of the film, where the case's own is smaller.
    pub irregularity: f64,
    /// Displacement in mm by a heartbeat at its centre, by the left hilum.
    pub heartbeat_mm: f64,
    /// Beats per second.
    pub heart_rate_hz: f64,
    /// Probability that the film has a cough.
    pub coughs: f64,
    /// Part of the way to full expiration that the cough drives the lungs.
    pub cough_depth: f64,
}

impl Default for BreathingConditions {
    fn default() -> Self {
        BreathingConditions {
            hysteresis: 0.15,
            lag_s: 0.25,
            irregularity: 0.6,
            heartbeat_mm: 1.0,
            heart_rate_hz: 1.15,
            coughs: 0.5,
            cough_depth: 0.6,
        }
    }
}

/// The electromagnetic sensor in the scope's tip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorConditions {
    /// White noise of the position, mm along each axis.
    pub noise_mm: f64,
    /// White noise of the orientation, degrees about each axis.
    pub noise_deg: f64,
    /// Largest drift of the position over the film, mm.
    pub drift_mm: f64,
    /// Largest drift of the orientation over the film, degrees.
    pub drift_deg: f64,
    /// Root mean square of the field's distortion, mm.
    pub distortion_mm: f64,
    /// A pose is this old, seconds.
    pub delay_s: f64,
}

impl Default for SensorConditions {
    fn default() -> Self {
        SensorConditions {
            noise_mm: 0.3,
            noise_deg: 0.3,
            drift_mm: 2.0,
            drift_deg: 2.0,
            distortion_mm: 1.0,
            delay_s: 0.04,
        }
    }
}

/// Lens and light guide, as far as the calibration does not know them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OpticsConditions {
    /// Relative error of the focal length that methods are told.
    pub focal_error: f64,
    /// Error of the image centre that they are told, as a part of the image's width.
    pub centre_error: f64,
    /// Change of the lens's cubic distortion (k1 of OpenCV's fisheye model) that they are not told.
    pub residual_distortion: f64,
    /// Distance in mm of the light guide from the lens.
    pub lamp_offset_mm: f64,
    /// Change in degrees of the lamp's half angle, which they are not told.
    pub lamp_angle_error_deg: f64,
    /// Change of the vignette, which they are not told.
    pub vignette_error: f64,
}

impl Default for OpticsConditions {
    fn default() -> Self {
        OpticsConditions {
            focal_error: 0.01,
            centre_error: 0.0078,
            residual_distortion: 0.01,
            lamp_offset_mm: 1.6,
            lamp_angle_error_deg: 8.0,
            vignette_error: 0.2,
        }
    }
}

/// What stands between the wall and the pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PictureConditions {
    /// The shutter is open for this long, seconds.
    pub shutter_s: f64,
    /// `scope.shot_noise` of the film.
    pub shot_noise: f64,
    /// `scope.read_noise` of the film.
    pub read_noise: f64,
    /// Quality of the JPEG that every frame goes through; 0 is none.
    pub jpeg_quality: f64,
    /// Factor on the gain that the automatic exposure finds; 0 is 1.
    pub exposure: f64,
    /// Diameter in mm of the lens's opening.
    pub aperture_mm: f64,
    /// Depth in mm from which on the picture is sharp.
    pub sharp_from_mm: f64,
    /// Patches of secretion per centimetre of the route.
    pub secretions_per_cm: f64,
    /// Bubbles per centimetre of the route.
    pub bubbles_per_cm: f64,
    /// Part of the light that the film on the lens scatters when it is at its thickest.
    pub lens_film: f64,
    /// Mean time in seconds between wipes of the lens.
    pub wipe_every_s: f64,
    /// Duration in seconds of the touch of the wall.
    pub contact_s: f64,
}

impl Default for PictureConditions {
    fn default() -> Self {
        PictureConditions {
            shutter_s: 0.02,
            shot_noise: 0.02,
            read_noise: 0.002,
            jpeg_quality: 75.0,
            exposure: 1.5,
            aperture_mm: 0.1,
            sharp_from_mm: 3.0,
            secretions_per_cm: 6.0,
            bubbles_per_cm: 8.0,
            lens_film: 0.35,
            wipe_every_s: 6.0,
            contact_s: 0.6,
        }
    }
}

/// `[clinical]` of a case file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClinicalSettings {
    /// Rows of the table that are switched off.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub off: Vec<Condition>,
    /// When given, all other rows are switched off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub only: Option<Vec<Condition>>,
    /// Standard deviation of the logarithm of a film's sizes; at 0 every film has the sizes below.
    pub spread: f64,
    /// The two surfaces.
    pub surfaces: SurfaceConditions,
    /// Motion of the tissue.
    pub breathing: BreathingConditions,
    /// The pose.
    pub sensor: SensorConditions,
    /// Lens and lamp.
    pub optics: OpticsConditions,
    /// The picture.
    pub picture: PictureConditions,
}

impl Default for ClinicalSettings {
    fn default() -> Self {
        ClinicalSettings {
            off: Vec::new(),
            only: None,
            spread: 0.25,
            surfaces: SurfaceConditions::default(),
            breathing: BreathingConditions::default(),
            sensor: SensorConditions::default(),
            optics: OpticsConditions::default(),
            picture: PictureConditions::default(),
        }
    }
}

impl ClinicalSettings {
    /// Rejects sizes that no film can have; the error names the key.
    pub fn validate(&self) -> Result<()> {
        RANGES.check("clinical", self)?;
        match &self.only {
            Some(only) if only.iter().any(|row| self.off.contains(row)) => {
                Err(Error::input("names a condition that `only` switches on").element("clinical.off"))
            }
            _ => Ok(()),
        }
    }

    /// Whether a row of the table is switched on.
    pub fn has(&self, condition: Condition) -> bool {
        !self.off.contains(&condition) && self.only.as_ref().is_none_or(|only| only.contains(&condition))
    }

    /// The sizes of the film of `seed`: drawn about the medians, 0 where a row is switched off. Nothing of them is left
    /// to chance after that but what the effects draw themselves.
    pub fn drawn(&self, seed: u64) -> ClinicalSettings {
        let factor = |key: u64| {
            let n = CounterRng::new(seed, Stage::Clinical, &[0, key]).normal();
            (self.spread * n.clamp(-MOST_DEVIATIONS, MOST_DEVIATIONS)).exp()
        };
        // A size's key is its place in the tables of the stream: it must never change, or films change.
        let size = |row: Condition, key: u64, median: f64| if self.has(row) { median * factor(key) } else { 0.0 };
        let share = |row: Condition, key: u64, median: f64| size(row, key, median).min(1.0);
        let plain = |row: Condition, value: f64| if self.has(row) { value } else { 0.0 };
        let (b, s, o, p) = (&self.breathing, &self.sensor, &self.optics, &self.picture);
        ClinicalSettings {
            off: Vec::new(),
            only: None,
            spread: 0.0,
            surfaces: SurfaceConditions {
                folder: self.surfaces.folder.clone(),
                registration_error_mm: size(Condition::Surfaces, 1, self.surfaces.registration_error_mm),
            },
            breathing: BreathingConditions {
                hysteresis: share(Condition::Hysteresis, 2, b.hysteresis),
                lag_s: size(Condition::Lag, 3, b.lag_s),
                irregularity: share(Condition::BreathVariation, 4, b.irregularity),
                heartbeat_mm: size(Condition::Heartbeat, 5, b.heartbeat_mm),
                heart_rate_hz: b.heart_rate_hz * factor(6).clamp(0.87, 1.13),
                coughs: plain(Condition::Cough, b.coughs),
                cough_depth: share(Condition::Cough, 7, b.cough_depth),
            },
            sensor: SensorConditions {
                noise_mm: size(Condition::PoseNoise, 8, s.noise_mm),
                noise_deg: size(Condition::PoseNoise, 9, s.noise_deg),
                drift_mm: size(Condition::PoseDrift, 10, s.drift_mm),
                drift_deg: size(Condition::PoseDrift, 11, s.drift_deg),
                distortion_mm: size(Condition::FieldDistortion, 12, s.distortion_mm),
                delay_s: size(Condition::PoseDelay, 13, s.delay_s),
            },
            optics: OpticsConditions {
                focal_error: size(Condition::Intrinsics, 14, o.focal_error),
                centre_error: size(Condition::Intrinsics, 15, o.centre_error),
                residual_distortion: size(Condition::Intrinsics, 16, o.residual_distortion),
                lamp_offset_mm: size(Condition::LampOffset, 17, o.lamp_offset_mm),
                lamp_angle_error_deg: size(Condition::LampProfile, 18, o.lamp_angle_error_deg),
                vignette_error: share(Condition::Vignette, 19, o.vignette_error),
            },
            picture: PictureConditions {
                shutter_s: size(Condition::Blur, 20, p.shutter_s),
                shot_noise: size(Condition::Noise, 21, p.shot_noise),
                read_noise: size(Condition::Noise, 22, p.read_noise),
                jpeg_quality: plain(Condition::Compression, p.jpeg_quality),
                exposure: size(Condition::Clipping, 23, p.exposure),
                aperture_mm: size(Condition::Defocus, 24, p.aperture_mm),
                sharp_from_mm: p.sharp_from_mm,
                secretions_per_cm: size(Condition::Secretions, 25, p.secretions_per_cm),
                bubbles_per_cm: size(Condition::Bubbles, 26, p.bubbles_per_cm),
                lens_film: share(Condition::LensFilm, 27, p.lens_film),
                wipe_every_s: p.wipe_every_s,
                contact_s: size(Condition::Contact, 28, p.contact_s),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_files() {
        for row in Condition::ALL {
            assert_eq!(serde_json::to_value(row).unwrap(), row.name());
            assert_eq!(row.name().parse::<Condition>().unwrap(), row);
        }
        assert!("fog".parse::<Condition>().unwrap_err().contains("surfaces, hysteresis"));
    }

    #[test]
    fn sizes_are_drawn_about_their_medians_and_differ_between_films() {
        let settings = ClinicalSettings::default();
        let mut drifts: Vec<f64> = (0..401).map(|seed| settings.drawn(seed).sensor.drift_mm).collect();
        assert_eq!(settings.drawn(3), settings.drawn(3));
        drifts.sort_by(f64::total_cmp);
        assert!((drifts[200] / 2.0 - 1.0).abs() < 0.06, "median {}", drifts[200]);
        assert!(drifts[0] >= 2.0 * (-0.5f64).exp() - 1e-12 && drifts[400] <= 2.0 * 0.5f64.exp() + 1e-12);
        assert!(drifts[40] < 1.6 && drifts[360] > 2.5);
        let same = ClinicalSettings { spread: 0.0, ..settings };
        assert!((0..20).all(|seed| same.drawn(seed).optics.lamp_offset_mm == 1.6));
    }

    /// Every row of the table, switched off, leaves its sizes at 0 and all others as they were.
    #[test]
    fn every_row_has_a_switch_of_its_own() {
        let numbers = |settings: &ClinicalSettings| -> Vec<f64> {
            let all = serde_json::to_value(settings).unwrap();
            let groups = all.as_object().unwrap().values().filter_map(|group| group.as_object());
            groups.flat_map(|group| group.values().filter_map(|v| v.as_f64()).collect::<Vec<_>>()).collect()
        };
        let all = numbers(&ClinicalSettings::default().drawn(5));
        let mut switched = vec![0; all.len()];
        for row in Condition::ALL {
            let without = numbers(&ClinicalSettings { off: vec![row], ..ClinicalSettings::default() }.drawn(5));
            let alone = numbers(&ClinicalSettings { only: Some(vec![row]), ..ClinicalSettings::default() }.drawn(5));
            let changed: Vec<usize> = (0..all.len()).filter(|&i| without[i] != all[i]).collect();
            assert!(!changed.is_empty() && changed.iter().all(|&i| without[i] == 0.0), "{row:?}");
            assert!(changed.iter().all(|&i| alone[i] == all[i]), "{row:?}");
            changed.iter().for_each(|&i| switched[i] += 1);
        }
        // Rate, focus and wiping belong to effects whose size is another key.
        assert_eq!(switched.iter().filter(|&&n| n == 0).count(), 3);
        assert!(switched.iter().all(|&n| n < 2));
    }

    #[test]
    fn wrong_values_are_named() {
        let mut settings = ClinicalSettings::default();
        settings.sensor.delay_s = -0.1;
        assert!(settings.validate().unwrap_err().to_string().starts_with("clinical.sensor.delay_s: -0.1"));
        let both = ClinicalSettings {
            off: vec![Condition::Lag],
            only: Some(vec![Condition::Lag]),
            ..ClinicalSettings::default()
        };
        assert!(both.validate().unwrap_err().to_string().starts_with("clinical.off"));
        assert!(ClinicalSettings::default().validate().is_ok());
    }
}
