//! How tissue moves on the clinical track: hysteresis, regional lag, heartbeat and cough beside one breathing phase.
//!
//! With p(t) the phase of the spirometer, f(t) its rate over the largest rate of a regular breath (softly limited), d
//! the displacement of a point from inspiration r to expiration, and T its delay behind the spirometer:
//!
//!   x(t) = r + p(t - T) d + h/2 f(t - T) (d x c) + w(r) b(t) e + s(t)
//!
//! The second term is motion with the air flow (Low et al., Int J Radiat Oncol Biol Phys 63:921, 2005), across d: c is
//! a unit vector, the same everywhere, square to the mean of d, so that the loop's width is the part h of the motion.
//! T(r) is a mean over the centreline around r of delays that are drawn per lobe, so it is smooth in space
//! (`DelayField`). w is a Gaussian about the left hilum, b the heartbeat of amplitude in mm, e its direction. s is the
//! shake of the whole chest in a cough, whose effort also drives p towards expiration: the spirometer sees it.
//!
//! All of it is smooth in r, and a common factor on what lies beyond p(t) d is lowered until no face turns over at any
//! frame (`film.rs`), so the wall stays as sound as that of the ideal track.

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use rayon::prelude::*;

use crate::airway::Anatomy;
use crate::airway::case::ClinicalSettings;
use crate::airway::centerline::Centerline;
use crate::airway::waveform::Waveform;
use crate::base::random::{CounterRng, Stage};

/// Delays at which phase and rate are tabulated for one moment.
const DELAYS: usize = 33;
/// Half the step in seconds of the difference quotient of the phase.
const RATE_STEP_S: f64 = 0.01;
/// The air flow's effect saturates at this multiple of a quiet breath's peak.
const MOST_FLOW: f64 = 2.0;
/// Width in mm of the average over the centreline that makes delays smooth in space, and spacing of its samples.
const LOBE_SIGMA_MM: f64 = 20.0;
const SAMPLE_MM: f64 = 3.0;
/// Centre of the heart's motion relative to the carina (LPS, mm): by the left hilum. Its width.
const HEART_MM: DVec3 = DVec3::new(30.0, -15.0, -30.0);
const HEART_SIGMA_MM: f64 = 35.0;
/// Harmonics of a heartbeat and their sum's peak.
const BEAT: [f64; 3] = [1.0, 0.35, 0.1];
const BEAT_PEAK: f64 = 1.1743;
/// Rise and fall in seconds of a cough's effort; frequency, decay and amplitude of the chest's shake.
const COUGH_S: [f64; 2] = [0.12, 0.5];
const SHAKE_HZ: f64 = 6.0;
const SHAKE_DECAY_S: f64 = 0.15;
const SHAKE_MM: f64 = 1.5;
/// A cough falls into this part of the film, of which so many moments are looked at.
const COUGH_PART: [f64; 2] = [0.55, 0.8];
const COUGH_MOMENTS: usize = 40;

/// A point of tissue, with what of its motion does not depend on time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TissuePoint {
    rest: DVec3,
    travel: DVec3,
    delay_s: f64,
    heart: f64,
}

/// What all points share at one moment.
#[derive(Clone, Debug)]
pub struct BodyState {
    /// Phase of the spirometer.
    pub phase: f64,
    /// Rate of the phase over that of a regular breath, softly limited: positive while breathing out.
    pub flow: f64,
    /// The heartbeat, -1 to 1.
    pub beat: f64,
    /// Effort of the cough, 0 to 1.
    pub cough: f64,
    /// The chest's shake by the cough, mm.
    pub shake_mm: DVec3,
    /// Phase and rate at delays from 0 to the longest, evenly spaced.
    delayed: [(f64, f64); DELAYS],
}

/// The motion of one film.
#[derive(Clone, Debug)]
pub struct TissueMotion {
    waveform: Waveform,
    seed: u64,
    hysteresis: f64,
    heartbeat_mm: f64,
    heart_rate_hz: f64,
    heart_direction: DVec3,
    heart_centre: DVec3,
    /// c of the module's formula.
    across: DVec3,
    delays: DelayField,
    cough_depth: f64,
    cough_direction: DVec3,
    /// When the effort of a cough begins.
    pub cough_s: Option<f64>,
    /// Factor on all that lies beyond one phase; 1 unless a face would turn over.
    pub share: f64,
}

impl TissueMotion {
    /// For a film of `duration_s` that breathes by `waveform`; `settings` are the film's own
    /// ([`ClinicalSettings::drawn`]), `seed` the case's.
    pub fn new(
        anatomy: &Anatomy,
        waveform: &Waveform,
        settings: &ClinicalSettings,
        duration_s: f64,
        seed: u64,
    ) -> TissueMotion {
        let breathing = &settings.breathing;
        let mut random = CounterRng::new(seed, Stage::Clinical, &[1]);
        let (rest, other) = (&anatomy.inspiration.vertices, &anatomy.expiration.vertices);
        let mean = rest.iter().zip(other).map(|(r, e)| *e - *r).sum::<DVec3>();
        let drawn = unit(&mut random);
        let across = drawn.reject_from(mean.normalize_or(DVec3::Z)).normalize_or(mean.any_orthonormal_vector());
        let heart_direction = unit(&mut random);
        let cough_direction = unit(&mut random);
        let has_cough = random.uniform() < breathing.coughs && breathing.cough_depth > 0.0;
        // Coughs follow a breath in: of the moments within the part, the one of the fullest lungs.
        let moment = |k: usize| {
            let part = COUGH_PART[0] + (COUGH_PART[1] - COUGH_PART[0]) * k as f64 / (COUGH_MOMENTS - 1) as f64;
            duration_s * part
        };
        let phase = |k: usize| waveform.phase(moment(k), seed);
        let fullest = (0..COUGH_MOMENTS).fold(0, |best, k| if phase(k) < phase(best) { k } else { best });
        let cough_s = moment(fullest);
        TissueMotion {
            waveform: waveform.clone(),
            seed,
            hysteresis: breathing.hysteresis,
            heartbeat_mm: breathing.heartbeat_mm,
            heart_rate_hz: breathing.heart_rate_hz,
            heart_direction,
            heart_centre: anatomy.centerline.carina_mm().unwrap_or_default() + HEART_MM,
            across,
            delays: DelayField::new(&anatomy.centerline, breathing.lag_s, seed),
            cough_depth: breathing.cough_depth,
            cough_direction,
            cough_s: has_cough.then_some(cough_s),
            share: 1.0,
        }
    }

    /// The same motion with another factor on all that lies beyond one phase.
    pub fn with_share(&self, share: f64) -> TissueMotion {
        TissueMotion { share, ..self.clone() }
    }

    /// Whether tissue is anywhere else than one phase says.
    pub fn is_beyond_phase(&self) -> bool {
        let sizes = [self.hysteresis, self.heartbeat_mm, self.delays.longest_s];
        self.share > 0.0 && (sizes.iter().any(|&size| size > 0.0) || self.cough_s.is_some())
    }

    /// The point that is at `rest` at inspiration and at `other` at expiration.
    pub fn point(&self, rest: DVec3, other: DVec3) -> TissuePoint {
        let off = (rest - self.heart_centre).length_squared() / (HEART_SIGMA_MM * HEART_SIGMA_MM);
        TissuePoint { rest, travel: other - rest, delay_s: self.delays.at(rest), heart: (-0.5 * off).exp() }
    }

    /// [`TissueMotion::point`] for many.
    pub fn points(&self, rest: &[DVec3], other: &[DVec3]) -> Vec<TissuePoint> {
        rest.par_iter().zip(other).map(|(&r, &e)| self.point(r, e)).collect()
    }

    /// The state `time_s` after the start of the film. Before the start the chest is as at it.
    pub fn state(&self, time_s: f64) -> BodyState {
        let step = self.delays.longest_s / (DELAYS - 1) as f64;
        let delayed = std::array::from_fn(|i| {
            let then_s = time_s - i as f64 * step;
            (self.phase(then_s), self.flow(then_s))
        });
        let since_s = self.cough_s.map_or(-1.0, |start_s| time_s - start_s);
        let ringing =
            if since_s > 0.0 { (-since_s / SHAKE_DECAY_S).exp() * (TAU * SHAKE_HZ * since_s).sin() } else { 0.0 };
        BodyState {
            phase: delayed[0].0,
            flow: delayed[0].1,
            beat: self.beat(time_s),
            cough: effort(since_s),
            shake_mm: self.cough_direction * (SHAKE_MM * ringing),
            delayed,
        }
    }

    /// Phase of the spirometer `time_s` after the start of the film.
    pub fn phase(&self, time_s: f64) -> f64 {
        let time_s = time_s.max(0.0);
        let quiet = self.waveform.phase(time_s, self.seed);
        let cough = self.cough_s.map_or(0.0, |start_s| effort(time_s - start_s));
        quiet + (1.0 - quiet) * self.cough_depth * cough
    }

    /// Where `point` is in the state of a moment.
    pub fn place(&self, point: &TissuePoint, state: &BodyState) -> DVec3 {
        let (phase, flow) = state.at(point.delay_s * self.share / self.delays.longest_s.max(1e-9));
        let loop_width = 0.5 * self.hysteresis * flow;
        let beyond = point.travel.cross(self.across) * loop_width
            + self.heart_direction * (self.heartbeat_mm * point.heart * state.beat)
            + state.shake_mm;
        point.rest + point.travel * phase + beyond * self.share
    }

    /// Where `points` are.
    pub fn places(&self, points: &[TissuePoint], state: &BodyState) -> Vec<DVec3> {
        points.par_iter().map(|point| self.place(point, state)).collect()
    }

    /// The state of a moment, with its phase and those of all delays moved by `change`.
    pub fn with_phase_moved(state: &BodyState, change: f64) -> BodyState {
        BodyState {
            phase: state.phase + change,
            delayed: state.delayed.map(|(phase, flow)| (phase + change, flow)),
            ..state.clone()
        }
    }

    /// Delay in seconds of the tissue at `rest` behind the spirometer.
    pub fn delay_s(&self, rest: DVec3) -> f64 {
        self.delays.at(rest) * self.share
    }

    fn flow(&self, time_s: f64) -> f64 {
        let rate = (self.phase(time_s + RATE_STEP_S) - self.phase(time_s - RATE_STEP_S)) / (2.0 * RATE_STEP_S);
        // A sinusoidal breath of the whole range has the largest rate pi / period.
        let flow = rate * self.waveform.period_s() / PI;
        flow / (1.0 + (flow / MOST_FLOW).powi(2)).sqrt()
    }

    fn beat(&self, time_s: f64) -> f64 {
        // The rate itself wanders a little, as hearts do with the breath.
        let angle = TAU * self.heart_rate_hz * time_s + 0.3 * (TAU * time_s / self.waveform.period_s()).sin();
        BEAT.iter().enumerate().map(|(k, a)| a * ((k + 1) as f64 * angle).sin()).sum::<f64>() / BEAT_PEAK
    }
}

impl BodyState {
    /// Phase and rate at `part` of the longest delay.
    fn at(&self, part: f64) -> (f64, f64) {
        let place = part.clamp(0.0, 1.0) * (DELAYS - 1) as f64;
        let low = (place.floor() as usize).min(DELAYS - 2);
        let t = place - low as f64;
        let ((p, f), (q, g)) = (self.delayed[low], self.delayed[low + 1]);
        (p + (q - p) * t, f + (g - f) * t)
    }
}

/// Effort of a cough `since_s` after its start: smooth steps up and down.
fn effort(since_s: f64) -> f64 {
    let smooth = |t: f64| {
        let t = t.clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    };
    smooth(since_s / COUGH_S[0]) * (1.0 - smooth((since_s - COUGH_S[0]) / COUGH_S[1]))
}

fn unit(random: &mut CounterRng) -> DVec3 {
    DVec3::new(random.normal(), random.normal(), random.normal()).normalize_or(DVec3::X)
}

/// Delay of tissue behind the spirometer: 0 about trachea and main bronchi, a drawn one in every lobe, smooth between.
#[derive(Clone, Debug)]
struct DelayField {
    samples: Vec<(DVec3, f64)>,
    longest_s: f64,
}

impl DelayField {
    /// A lobe begins where the second generation does, and falls on all that hangs on it.
    fn new(line: &Centerline, longest_s: f64, seed: u64) -> DelayField {
        let mut delay = vec![0.0; line.points.len()];
        let mut since_mm = vec![0.0; line.points.len()];
        let mut samples = Vec::new();
        for (i, point) in line.points.iter().enumerate() {
            let parent = point.parent.map(|p| p as usize);
            delay[i] = match parent {
                _ if point.generation < 2 => 0.0,
                Some(parent) if line.points[parent].generation >= 2 => delay[parent],
                _ => longest_s * CounterRng::new(seed, Stage::Clinical, &[2, i as u64]).uniform(),
            };
            let step_mm = parent.map_or(f64::INFINITY, |p| line.points[p].position_mm.distance(point.position_mm));
            since_mm[i] = parent.map_or(0.0, |p| since_mm[p]) + step_mm;
            if since_mm[i] >= SAMPLE_MM {
                since_mm[i] = 0.0;
                samples.push((point.position_mm, delay[i]));
            }
        }
        DelayField { samples, longest_s }
    }

    fn at(&self, place: DVec3) -> f64 {
        if self.longest_s <= 0.0 {
            return 0.0;
        }
        let square = |sample: &(DVec3, f64)| sample.0.distance_squared(place);
        let nearest = self.samples.iter().map(square).fold(f64::INFINITY, f64::min);
        let (mut sum, mut total) = (0.0, 0.0);
        for sample in &self.samples {
            let weight = (-0.5 * (square(sample) - nearest) / (LOBE_SIGMA_MM * LOBE_SIGMA_MM)).exp();
            sum += weight * sample.1;
            total += weight;
        }
        sum / total.max(1e-300)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::airway::case::Condition;
    use crate::airway::centerline::CenterlinePoint;
    use crate::base::TriangleMesh;

    /// A trachea with two lobes far apart; tissue moves 20 mm up.
    fn anatomy() -> Anatomy {
        let mut points = Vec::new();
        let mut add = |x: f64, z: f64, generation: u32, parent: Option<u32>| {
            let (position_mm, radius_mm) = (DVec3::new(x, 0.0, z), 5.0);
            points.push(CenterlinePoint { position_mm, radius_mm, branch: generation, generation, parent });
            points.len() as u32 - 1
        };
        let mut last = add(0.0, 0.0, 0, None);
        for i in 1..20 {
            last = add(0.0, -5.0 * i as f64, 0, Some(last));
        }
        for side in [-1.0, 1.0] {
            let mut tip = last;
            for i in 1..25 {
                tip = add(side * 5.0 * i as f64, -95.0 - i as f64, 1 + u32::from(i > 4), Some(tip));
            }
        }
        let rest: Vec<DVec3> = points.iter().map(|p| p.position_mm).collect();
        let moved: Vec<DVec3> = rest.iter().map(|p| *p + DVec3::Z * 20.0).collect();
        let mesh = |vertices: &Vec<DVec3>| TriangleMesh { vertices: vertices.clone(), faces: Vec::new() };
        Anatomy {
            inspiration: mesh(&rest),
            expiration: mesh(&moved),
            vertex_generation: Vec::new(),
            radius_expiration_mm: Vec::new(),
            centerline_expiration: moved,
            centerline: Centerline { points },
        }
    }

    fn motion(only: &[Condition]) -> TissueMotion {
        let settings = ClinicalSettings { only: Some(only.to_vec()), spread: 0.0, ..ClinicalSettings::default() };
        let mut settings = settings.drawn(4);
        settings.breathing.coughs = settings.breathing.coughs.ceil();
        TissueMotion::new(&anatomy(), &Waveform::default(), &settings, 16.0, 4)
    }

    fn ends() -> (DVec3, DVec3) {
        let rest = DVec3::new(90.0, 0.0, -115.0);
        (rest, rest + DVec3::Z * 20.0)
    }

    #[test]
    fn with_everything_off_tissue_is_where_one_phase_has_it() {
        let motion = motion(&[]);
        let (rest, other) = ends();
        let point = motion.point(rest, other);
        for i in 0..160 {
            let t = i as f64 * 0.1;
            let expected = rest.lerp(other, Waveform::default().phase(t, 4));
            assert!(motion.place(&point, &motion.state(t)).distance(expected) < 1e-12);
        }
    }

    #[test]
    fn the_way_out_is_another_than_the_way_in_by_the_stated_width() {
        let motion = motion(&[Condition::Hysteresis]);
        let (rest, other) = ends();
        let point = motion.point(rest, other);
        let across: Vec<(f64, f64)> = (0..400)
            .map(|i| {
                let state = motion.state(4.5 + i as f64 * 0.01);
                let off = motion.place(&point, &state) - rest.lerp(other, state.phase);
                assert!(off.dot(DVec3::Z).abs() < 1e-9, "square to the motion");
                (state.flow, off.dot(DVec3::Z.cross(motion.across)))
            })
            .collect();
        let width = across.iter().map(|a| a.1).fold(0.0, f64::max) - across.iter().map(|a| a.1).fold(0.0, f64::min);
        // 15 % of 20 mm, a little more where the breath is quicker than a sine.
        assert!((2.4..4.2).contains(&width), "{width} mm");
        assert!(across.iter().any(|a| a.0 > 0.7) && across.iter().any(|a| a.0 < -0.7));
    }

    #[test]
    fn lobes_lag_by_delays_of_their_own_and_the_trachea_does_not() {
        let motion = motion(&[Condition::Lag]);
        let delay = |x: f64, z: f64| motion.delay_s(DVec3::new(x, 0.0, z));
        let (right, left) = (delay(-110.0, -115.0), delay(110.0, -115.0));
        assert!(delay(0.0, -20.0) < 0.02 && (right - left).abs() > 0.02, "{right} {left}");
        assert!([right, left].iter().all(|d| (0.0..=0.25).contains(d)));
        for i in 0..220 {
            let step = delay(-110.0 + i as f64 + 1.0, -115.0) - delay(-110.0 + i as f64, -115.0);
            assert!(step.abs() < 0.25 / 20.0, "smooth in space: {step} s/mm");
        }
        let (rest, other) = ends();
        let (point, own) = (motion.point(rest, other), motion.delay_s(rest));
        let late = rest.lerp(other, Waveform::default().phase(6.0 - own, 4));
        assert!(motion.place(&point, &motion.state(6.0)).distance(late) < 1e-3);
    }

    #[test]
    fn the_heart_moves_what_is_near_it_and_a_cough_everything() {
        let beating = motion(&[Condition::Heartbeat]);
        let near = beating.heart_centre;
        let swing = |motion: &TissueMotion, rest: DVec3| {
            let point = motion.point(rest, rest);
            let off = |i: i32| motion.place(&point, &motion.state(i as f64 * 0.02)).distance(rest);
            (0..100).map(off).fold(0.0, f64::max)
        };
        assert!((swing(&beating, near) - 1.0).abs() < 0.05);
        assert!(swing(&beating, near + DVec3::X * 120.0) < 0.01);
        let coughing = motion(&[Condition::Cough]);
        let start = coughing.cough_s.unwrap();
        assert!((0.54 * 16.0..0.81 * 16.0).contains(&start) && coughing.phase(start) < 0.3);
        assert_eq!(coughing.phase(start), Waveform::default().phase(start, 4));
        let quiet = Waveform::default().phase(start + 0.12, 4);
        assert!((coughing.phase(start + 0.12) - (quiet + 0.6 * (1.0 - quiet))).abs() < 1e-12);
        assert_eq!(coughing.phase(start + 1.0), Waveform::default().phase(start + 1.0, 4));
        assert!(coughing.state(start + 0.04).shake_mm.length() > 0.8);
    }

    #[test]
    fn motion_is_smooth_in_time() {
        let motion = motion(&Condition::ALL);
        let (rest, other) = ends();
        let point = motion.point(rest, other);
        let places: Vec<DVec3> = (0..16_000).map(|i| motion.place(&point, &motion.state(i as f64 * 0.001))).collect();
        // 20 mm within .12 s at the most, in a cough.
        assert!(places.windows(2).all(|w| w[0].distance(w[1]) < 0.4));
        assert!(places.iter().all(|p| p.is_finite() && p.distance(rest) < 40.0));
    }
}
