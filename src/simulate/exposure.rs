//! Automatic exposure that is known before a frame is rendered, so that frames stay independent.
//!
//! A coarse grid of rays gives distance d and slant cos of the wall; radiance there is about albedo I cos / (pi d^2),
//! times a factor for light that comes from other walls, the fibre bundle's profile and the vignette. Beside the spot of a
//! narrow lamp there is no direct light to multiply: the spot's light comes back from all walls. The gain is the
//! one that brings the mean *encoded* brightness of that proxy to the target (bisection on a monotone function),
//! followed with a lag and within limits, like the automatic exposure of a scope: the log gain is a damped oscillator
//! of natural frequency 1 / lag whose damping gives the stated overshoot after a jump (without overshoot: first order).
//! A seeded slow drift of gain and white balance comes on top. The noise that the gain brings is the sensor's
//! (`sensor.rs`).

use glam::{DAffine3, DVec2, DVec3};

use super::sensor::{mask_radius_px, vignette_at};
use crate::airway::case::{ExposureControl, ExposureSettings, ScopeSettings};
use crate::base::color::srgb_from_linear;
use crate::base::random::{CounterRng, Stage};
use crate::base::statistics::upper_median;
use crate::base::{Camera, Error, Result};
use crate::render::{Light, Scene};

/// Rays of the proxy per image side.
const GRID: usize = 48;
/// Indirect light: gain over direct light per unit albedo, fitted by eye to rendered frames.
const INTERREFLECTION: f64 = 1.6;
/// Half angles in degrees of lamps that light a spot: from the first downwards the picture's mean radiance comes back from
/// all walls in part, from the second in full.
const SPOT_DEG: [f64; 2] = [30.0, 20.0];
/// How much of it comes back, per unit albedo: fitted to the medians of films of three grown trees under lamps of 12 and 18
/// degrees.
const COMES_BACK: f64 = 1.25;
/// No picture needs more: the scope's light gives radiances of about one.
const MOST_GAIN: f64 = 1e9;
/// The gain stays within this factor of the film's median.
const RANGE: f64 = 8.0;

/// Direct plus indirect light of the proxy, one value per grid ray that the mask does not hide, and channel (3).
pub fn proxy_radiance(
    scene: &Scene,
    camera: &Camera,
    world_from_camera: &DAffine3,
    light: &Light,
    scope: &ScopeSettings,
    albedo: [f64; 3],
) -> Result<Vec<[f64; 3]>> {
    let pixel_of = |row: usize, column: usize| {
        DVec2::new(
            (column as f64 + 0.5) / GRID as f64 * camera.width as f64,
            (row as f64 + 0.5) / GRID as f64 * camera.height as f64,
        )
    };
    let mut directions = Vec::with_capacity(GRID * GRID);
    let mut passed = Vec::with_capacity(GRID * GRID);
    for row in 0..GRID {
        for column in 0..GRID {
            let pixel = pixel_of(row, column);
            let direction = camera.direction(pixel).normalize();
            let through_lens = vignette_at(camera, pixel, scope.vignette);
            passed.push(direction.z.max(0.0).powf(light.emission_exponent) * through_lens);
            directions.push(world_from_camera.transform_vector3(direction));
        }
    }
    let origins = vec![world_from_camera.translation; directions.len()];
    let distances = scene.distances(&origins, &directions)?;
    let points: Vec<DVec3> = directions.iter().zip(&distances).map(|(d, &t)| *d * t as f64).collect();
    let at = |row: usize, column: usize| points[row.min(GRID - 1) * GRID + column.min(GRID - 1)];
    let mut radiance = Vec::with_capacity(points.len());
    for row in 0..GRID {
        for column in 0..GRID {
            let here = at(row, column);
            let across = at(row, column + 1) - at(row, column.saturating_sub(1));
            let down = at(row + 1, column) - at(row.saturating_sub(1), column);
            let normal = across.cross(down).normalize_or_zero();
            let cosine = normal.dot(here.normalize_or_zero()).abs();
            let d2 = here.length_squared();
            // A ray that leaves the airway returns no light.
            let lit = if d2.is_finite() && d2 > 0.0 && cosine.is_finite() { cosine / d2 } else { 0.0 };
            let lit = lit * passed[row * GRID + column];
            radiance.push([0, 1, 2].map(|c| {
                let direct = albedo[c] * light.intensity[c] * lit / std::f64::consts::PI;
                direct * (1.0 + INTERREFLECTION * albedo[c])
            }));
        }
    }
    let share = COMES_BACK * spot_share(light.emission_exponent);
    if share > 0.0 {
        let mean = |c: usize| radiance.iter().map(|value| value[c]).sum::<f64>() / radiance.len() as f64;
        let back: [f64; 3] = [0, 1, 2].map(|c| share * albedo[c] * mean(c));
        radiance.iter_mut().for_each(|value| (0..3).for_each(|c| value[c] += back[c]));
    }
    if let Some(radius_px) = mask_radius_px(camera, scope) {
        let middle = DVec2::new(camera.width as f64, camera.height as f64) / 2.0;
        let is_seen = |at: usize| pixel_of(at / GRID, at % GRID).distance(middle) < radius_px;
        let seen: Vec<[f64; 3]> = (0..radiance.len()).filter(|&at| is_seen(at)).map(|at| radiance[at]).collect();
        // An opening finer than the grid is metered by the whole picture.
        return Ok(if seen.is_empty() { radiance } else { seen });
    }
    Ok(radiance)
}

/// Whether a lamp of this half angle (degrees; 0: the same in all directions) lights a spot, as far as the exposure goes.
pub(super) fn is_spot(half_angle_deg: f64) -> bool {
    half_angle_deg > 0.0 && half_angle_deg < SPOT_DEG[0]
}

/// How far a lamp's light is a spot: 0 for wide ones to 1.
fn spot_share(emission_exponent: f64) -> f64 {
    let [widest, narrowest] = SPOT_DEG.map(Light::exponent_of_half_angle);
    ((emission_exponent - widest) / (narrowest - widest)).clamp(0.0, 1.0)
}

/// Mean encoded brightness of `radiance` under a gain.
fn brightness(radiance: &[[f64; 3]], gain: f64) -> f64 {
    let sum: f64 = radiance.iter().flatten().map(|&v| srgb_from_linear((v * gain) as f32) as f64).sum();
    sum / (radiance.len() * 3) as f64
}

/// The gain that brings the mean encoded brightness of `radiance` to `target`.
///
/// Errors: more than any gain reaches, since too little of the picture is lit.
pub fn wanted_gain(radiance: &[[f64; 3]], target: f64) -> Result<f64> {
    let most = brightness(radiance, MOST_GAIN);
    if most < target {
        let sentence = format!(
            "{target} cannot be reached: {most:.2} is the brightest that this lamp, lens and wall give the picture"
        );
        return Err(Error::input(sentence).element("exposure.target"));
    }
    let (mut low, mut high) = (-30.0f64, 30.0f64);
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if brightness(radiance, middle.exp()) < target { low = middle } else { high = middle }
    }
    Ok((0.5 * (low + high)).exp())
}

/// Share of the values of `radiance` that a gain clips.
pub fn clipped_share(radiance: &[[f64; 3]], gain: f64) -> f64 {
    radiance.iter().flatten().filter(|&&v| v * gain >= 1.0).count() as f64 / (radiance.len() * 3) as f64
}

/// Gain and white balance of one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// The gain that the automatic exposure aimed for.
    pub wanted_gain: f64,
    /// Factor on linear radiance.
    pub gain: f64,
    /// Factors on red, green and blue.
    pub white_balance: [f64; 3],
}

/// Follows the wanted gains with lag, overshoot and limits, then adds the seeded drift.
pub fn follow(wanted: &[f64], time_s: &[f64], settings: &ExposureSettings, seed: u64) -> Vec<Exposure> {
    let median = upper_median(wanted.iter().map(|g| g.ln())).unwrap_or(0.0);
    let drift = [0, 1, 2].map(|channel| SlowDrift::new(seed, channel));
    let mut follower: Option<Follower> = None;
    let mut before_s = 0.0;
    wanted
        .iter()
        .zip(time_s)
        .map(|(gain, &now_s)| {
            let goal = match settings.control {
                ExposureControl::Automatic => gain.ln().clamp(median - RANGE.ln(), median + RANGE.ln()),
                ExposureControl::Fixed => median,
            };
            let follower = follower.get_or_insert(Follower { level: goal, speed: 0.0 });
            follower.advance(goal, now_s - before_s, settings);
            before_s = now_s;
            Exposure {
                wanted_gain: *gain,
                gain: (follower.level + settings.drift * drift[0].at(now_s)).exp(),
                white_balance: [
                    (settings.white_balance_drift * drift[1].at(now_s)).exp(),
                    1.0,
                    (settings.white_balance_drift * drift[2].at(now_s)).exp(),
                ],
            }
        })
        .collect()
}

/// Log gain on its way to a goal.
struct Follower {
    level: f64,
    speed: f64,
}

impl Follower {
    /// `time_s` later, the goal having been `goal` all the while: the exact solution.
    fn advance(&mut self, goal: f64, time_s: f64, settings: &ExposureSettings) {
        if settings.lag_s <= 0.0 {
            (self.level, self.speed) = (goal, 0.0);
        } else if settings.overshoot <= 0.0 {
            self.level = goal + (self.level - goal) * (-time_s / settings.lag_s).exp();
        } else {
            // Overshoot m of a damped oscillator: m = exp(-pi z / sqrt(1 - z^2)).
            let m = settings.overshoot.ln();
            let damping = -m / (std::f64::consts::PI.powi(2) + m * m).sqrt();
            let natural = 1.0 / settings.lag_s;
            // Free oscillation around the goal: level = goal + exp(-decay t) (A cos(swing t) + B sin(swing t)).
            let (decay, swing) = (damping * natural, natural * (1.0 - damping * damping).sqrt());
            let (off, speed) = (self.level - goal, self.speed);
            let (sine, cosine) = (swing * time_s).sin_cos();
            let fade = (-decay * time_s).exp();
            self.level = goal + fade * (off * cosine + (speed + decay * off) / swing * sine);
            self.speed = fade * (speed * cosine - (natural * natural * off + decay * speed) / swing * sine);
        }
    }
}

/// A smooth seeded signal of zero mean and unit variance: three sines of incommensurate periods between 1.5 and 8 s.
struct SlowDrift([(f64, f64); 3]);

impl SlowDrift {
    fn new(seed: u64, channel: u64) -> Self {
        let mut random = CounterRng::new(seed, Stage::Exposure, &[channel]);
        SlowDrift([(1.5, 2.5), (2.5, 4.5), (4.5, 8.0)].map(|(low, high)| {
            (std::f64::consts::TAU / random.range(low, high), random.range(0.0, std::f64::consts::TAU))
        }))
    }

    fn at(&self, time_s: f64) -> f64 {
        let sum: f64 = self.0.iter().map(|(rate, phase)| (rate * time_s + phase).sin()).sum();
        sum * (2.0f64 / 3.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::TriangleMesh;
    use crate::render::Material;

    fn camera() -> Camera {
        Camera::pinhole(96, 96, 1.5)
    }

    /// The proxy of an even wall 20 mm before the camera.
    fn of_even_wall(light: &Light, mask_radius: f64, albedo: [f64; 3]) -> Vec<[f64; 3]> {
        let corners = [[-500.0, -500.0], [500.0, -500.0], [500.0, 500.0], [-500.0, 500.0]];
        let vertices = corners.map(|[x, y]| DVec3::new(x, y, 20.0)).to_vec();
        let mesh = TriangleMesh { vertices, faces: vec![[0, 2, 1], [0, 3, 2]] };
        let scene = Scene::new(&mesh, &[], Material::lambert(albedo), 1).unwrap();
        let scope = ScopeSettings { vignette: 0.0, mask_radius, ..ScopeSettings::default() };
        proxy_radiance(&scene, &camera(), &DAffine3::IDENTITY, light, &scope, albedo).unwrap()
    }

    /// Before an even wall the light falls with the third power of the cosine: two of the distance, one of the slant.
    #[test]
    fn the_proxy_of_an_even_wall_has_a_closed_form() {
        let (albedo, light) = ([0.7, 0.4, 0.3], Light::at_camera([300.0, 200.0, 100.0]));
        let (camera, found) = (camera(), of_even_wall(&light, 0.0, albedo));
        // What a mask hides counts nowhere.
        let masked = of_even_wall(&light, 0.5, albedo);
        let (seen, all) = (masked.len() as f64, found.len() as f64);
        assert!((seen / all / (std::f64::consts::PI / 16.0) - 1.0).abs() < 0.02, "{seen} of {all}");
        let darkest = |values: &[[f64; 3]]| values.iter().map(|v| v[0]).fold(f64::INFINITY, f64::min);
        assert!(darkest(&masked) > 1.5 * darkest(&found));
        for (place, found) in found.iter().enumerate() {
            // A ray at the middle of each two pixels.
            let pixel = DVec2::new((place % GRID * 2 + 1) as f64, (place / GRID * 2 + 1) as f64);
            let cosine = camera.direction(pixel).normalize().z;
            for c in 0..3 {
                let direct = albedo[c] * light.intensity[c] * cosine.powi(3) / (std::f64::consts::PI * 400.0);
                let expected = direct * (1.0 + INTERREFLECTION * albedo[c]);
                assert!((found[c] / expected - 1.0).abs() < 1e-3, "{pixel}: {} {expected}", found[c]);
            }
        }
    }

    /// Of a lamp that lights a spot of the wall, the rest of the picture is what the exposure goes by: without what comes back
    /// it would be black, and the film white.
    #[test]
    fn beside_a_spot_the_wall_is_lit_by_what_comes_back() {
        let albedo = [0.6, 0.4, 0.3];
        let of = |half_angle_deg: f64| {
            let emission_exponent = Light::exponent_of_half_angle(half_angle_deg);
            of_even_wall(&Light { emission_exponent, ..Light::at_camera([300.0; 3]) }, 0.0, albedo)
        };
        for (half_angle_deg, full) in
            [(5.0, true), (12.0, true), (19.9, true), (25.0, false), (30.0, false), (60.0, false)]
        {
            let found = of(half_angle_deg);
            assert_eq!(is_spot(half_angle_deg), half_angle_deg < 30.0);
            let mean = found.iter().map(|value| value[0]).sum::<f64>() / found.len() as f64;
            let (corner, back) = (found[0][0], COMES_BACK * albedo[0]);
            // Of the mean with what comes back, `back / (1 + back)` came back.
            let share = corner / mean * (1.0 + back) / back;
            if full {
                assert!((1.0..1.1).contains(&share), "{half_angle_deg}: {share}");
            }
            let gain = wanted_gain(&found, 0.42).unwrap();
            assert!(gain < 1e3, "{half_angle_deg}: {gain}");
        }
        assert!(!is_spot(0.0));
    }

    /// Over many films, red and blue drift by the stated deviation, each on its own.
    #[test]
    fn red_and_blue_drift_each_on_its_own() {
        let settings = ExposureSettings { white_balance_drift: 0.1, ..ExposureSettings::default() };
        let drifts: Vec<[f64; 2]> = (0..2000)
            .map(|seed| follow(&[1.0, 1.0], &[0.0, 3.0], &settings, seed)[1].white_balance)
            .map(|[red, _, blue]| [red.ln() / 0.1, blue.ln() / 0.1])
            .collect();
        let mean = |of: &dyn Fn(&[f64; 2]) -> f64| drifts.iter().map(of).sum::<f64>() / 2000.0;
        let (red, blue, both) = (mean(&|d| d[0] * d[0]), mean(&|d| d[1] * d[1]), mean(&|d| d[0] * d[1]));
        assert!((red - 1.0).abs() < 0.1 && (blue - 1.0).abs() < 0.1 && both.abs() < 0.1, "{red} {blue} {both}");
    }

    #[test]
    fn the_wanted_gain_meets_the_target() {
        let radiance: Vec<[f64; 3]> = (1..200).map(|i| [30.0 / i as f64, 12.0 / i as f64, 9.0 / i as f64]).collect();
        for target in [0.2, 0.42, 0.6] {
            let gain = wanted_gain(&radiance, target).unwrap();
            let sum: f64 = radiance.iter().flatten().map(|&v| srgb_from_linear((v * gain) as f32) as f64).sum();
            assert!((sum / (radiance.len() * 3) as f64 - target).abs() < 1e-4);
        }
        // A third of the picture can be lit, and no more.
        let dark = [radiance[0], [0.0; 3], [0.0; 3]];
        assert!((wanted_gain(&dark, 0.3).unwrap() * dark[0][2]) < 1.0);
        assert!(wanted_gain(&dark, 0.4).unwrap_err().to_string().contains("exposure.target: 0.4 cannot be reached"));
    }

    #[test]
    fn gain_follows_a_jump_with_lag_and_stays_in_range() {
        let settings = ExposureSettings {
            drift: 0.0,
            white_balance_drift: 0.0,
            lag_s: 0.5,
            overshoot: 0.0,
            ..ExposureSettings::default()
        };
        let time_s: Vec<f64> = (0..40).map(|i| i as f64 * 0.1).collect();
        let wanted: Vec<f64> = (0..40).map(|i| if i < 25 { 1.0 } else { 1e6 }).collect();
        let gains: Vec<f64> = follow(&wanted, &time_s, &settings, 1).iter().map(|e| e.gain).collect();
        assert_eq!(gains[24], 1.0);
        assert!(gains[25] > 1.2 && gains[25] < 2.0);
        assert!(gains[39] > 6.0 && gains[39] <= RANGE);
    }

    #[test]
    fn a_jump_is_overshot_by_the_stated_part_at_the_stated_time() {
        for (overshoot, lag_s) in [(0.05, 0.25), (0.3, 0.1)] {
            let settings = ExposureSettings {
                drift: 0.0,
                white_balance_drift: 0.0,
                lag_s,
                overshoot,
                ..ExposureSettings::default()
            };
            let time_s: Vec<f64> = (0..4000).map(|i| i as f64 * 1e-3).collect();
            let wanted: Vec<f64> = time_s.iter().map(|&t| if t <= 1.0 { 1.0 } else { 2.0 }).collect();
            let step: Vec<f64> =
                follow(&wanted, &time_s, &settings, 1).iter().map(|e| e.gain.ln() / 2f64.ln()).collect();
            let peak = (0..4000).max_by(|&a, &b| step[a].total_cmp(&step[b])).unwrap();
            assert!((step[peak] - 1.0 - overshoot).abs() < 1e-3, "{overshoot}: peak {}", step[peak]);
            // Second-order step response (any textbook on control): peak at pi / damped frequency, damping from
            // overshoot.
            let log = overshoot.ln();
            let damping = (log * log / (std::f64::consts::PI.powi(2) + log * log)).sqrt();
            let peak_s = std::f64::consts::PI * lag_s / (1.0 - damping * damping).sqrt();
            assert!((time_s[peak] - 1.0 - peak_s).abs() < 3e-3, "{overshoot}: {} s for {peak_s}", time_s[peak] - 1.0);
            // The whole curve, at another frame rate too: the solution is exact between frames.
            let coarse: Vec<f64> = time_s.iter().copied().step_by(50).collect();
            let goals: Vec<f64> = wanted.iter().copied().step_by(50).collect();
            for (i, e) in follow(&goals, &coarse, &settings, 1).iter().enumerate() {
                let t = coarse[i] - 1.0;
                if t <= 0.0 {
                    assert_eq!(e.gain, 1.0);
                    continue;
                }
                let (natural, swing) = (1.0 / lag_s, (1.0 - damping * damping).sqrt() / lag_s);
                let form = 1.0
                    - (-damping * natural * t).exp()
                        * ((swing * t).cos() + damping / (1.0 - damping * damping).sqrt() * (swing * t).sin());
                assert!((e.gain.ln() / 2f64.ln() - form).abs() < 1e-9, "{t}");
            }
        }
    }

    #[test]
    fn a_fixed_exposure_has_one_gain() {
        let settings = ExposureSettings { control: ExposureControl::Fixed, drift: 0.0, ..ExposureSettings::default() };
        let time_s: Vec<f64> = (0..9).map(f64::from).collect();
        let wanted: Vec<f64> = (1..10).map(f64::from).collect();
        assert!(follow(&wanted, &time_s, &settings, 1).iter().all(|e| (e.gain - 5.0).abs() < 1e-12));
    }

    #[test]
    fn drift_has_unit_variance_and_follows_the_seed() {
        let d = SlowDrift::new(3, 0);
        let values: Vec<f64> = (0..200_000).map(|i| d.at(i as f64 * 0.01)).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64;
        assert!(mean.abs() < 0.02 && (variance - 1.0).abs() < 0.05, "{mean} {variance}");
        assert_ne!(d.at(1.0), SlowDrift::new(4, 0).at(1.0));
    }
}
