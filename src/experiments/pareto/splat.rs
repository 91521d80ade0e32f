//! Time against error of everything that the rasteriser lets one choose, on tubes of several sizes: kernels, threads,
//! precision, blocks, dilated or compensated, EWA or exact discs; and what it saves to leave out what cannot be seen
//! or is not asked for ([`super::skipping`]).
//!
//! Two charts: the errors of the gradients (worst group) and of the image, relative L2 to the plain twin in f64 of the
//! same footprint and filter. The cost is CPU time of forward and backward, the median over repetitions; the least
//! wall clock stands beside it, and how far the image is from that of exact discs in f64, which is what EWA
//! approximates.

use std::str::FromStr;

use super::skipping::{self, SkipSaving};
use crate::base::range::NumberRange;
use crate::base::{Error, Estimate, Result};
use crate::experiments::difference::{gradient_groups, relative_l2, widened};
use crate::experiments::timing::{self, TimedScene};
use crate::report::pareto_chart::{ParetoChart, ParetoPoint, SettingRole};
use crate::splat::{Filter, Footprint, Isa, Rasterizer, Settings, Skips, SplatKernels, Wanted};

/// From so many discs on, a pass takes tenths of a second: a tenth of the repetitions, and no comparison of skips.
const MANY_DISCS: usize = 500_000;

/// The model behind [`SceneSize::estimate`]: core seconds per disc and per pixel of a pass of the vectorised kernels
/// and of the plain twin in f64, how many settings have either, and bytes of a disc and of a pixel.
const FAST_S: f64 = 2e-7;
const PLAIN_S: f64 = 5e-6;
const SETTINGS: [f64; 2] = [32.0, 10.0];
const DISC_BYTES: f64 = 2000.0;
const PIXEL_BYTES: f64 = 400.0;
/// Discs of a scene.
const DISCS: NumberRange = NumberRange::new(1.0, 1e7);
/// Widths of its image in pixels.
const SIDE_PX: NumberRange = NumberRange::new(1.0, 4096.0);

/// Size of a scene, `20000x256`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SceneSize {
    /// Discs.
    pub discs: usize,
    /// Width and height of the image in pixels, 1 to 4096.
    pub side_px: usize,
}

impl FromStr for SceneSize {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let parsed = name.split_once('x').and_then(|(n, side)| Some((n.parse().ok()?, side.parse().ok()?)));
        let none = || Error::usage(format!("`{name}` is no scene; 20000x256 would be one"));
        let (discs, side_px): (usize, usize) = parsed.ok_or_else(none)?;
        let named = |what: &'static str| move |e: Error| Error::usage(e.to_string()).element(what);
        DISCS.check(discs as f64).map_err(named("discs"))?;
        SIDE_PX.check(side_px as f64).map_err(named("pixels"))?;
        Ok(SceneSize { discs, side_px })
    }
}

impl SceneSize {
    /// What [`measure`] would cost.
    pub fn estimate(&self, repetitions: usize) -> Estimate {
        let (discs, pixels) = (self.discs as f64, (self.side_px * self.side_px) as f64);
        let slow = repetitions.div_ceil(10) as f64 + 1.0;
        let fast = if self.discs < MANY_DISCS { repetitions as f64 + 1.0 } else { slow };
        Estimate {
            memory_bytes: discs * DISC_BYTES + pixels * PIXEL_BYTES,
            seconds: (discs + pixels) * (SETTINGS[0] * fast * FAST_S + SETTINGS[1] * slow * PLAIN_S),
            resumable: false,
        }
    }
}

impl std::fmt::Display for SceneSize {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} discs, {} px", self.discs, self.side_px)
    }
}

/// What was measured on one scene.
pub struct SceneMeasurement {
    /// Points of the chart of gradients.
    pub gradients: Vec<ParetoPoint>,
    /// The same settings in the chart of images.
    pub image: Vec<ParetoPoint>,
    /// What each skip saves; empty for the largest scenes.
    pub skips: Vec<SkipSaving>,
}

/// The charts of gradients and of images, in this order.
pub fn charts(gradients: Vec<ParetoPoint>, image: Vec<ParetoPoint>) -> [ParetoChart; 2] {
    let cost = "CPU seconds, forward and backward";
    [
        ParetoChart { cost, error: "gradients to f64, worst group, relative L2", points: gradients },
        ParetoChart { cost, error: "image to f64, relative L2", points: image },
    ]
}

/// Measures all settings and skips on a scene, `repetitions` passes each.
pub fn measure(size: SceneSize, repetitions: usize) -> Result<SceneMeasurement> {
    let scene = TimedScene::tube(size.discs, size.side_px);
    let [gradients, image] = points(&size.to_string(), &scene, repetitions)?;
    let skips = match size.discs < MANY_DISCS {
        true => timing::pool(1)?.install(|| skipping::savings(&scene, repetitions))?,
        false => Vec::new(),
    };
    Ok(SceneMeasurement { gradients, image, skips })
}

/// One way to rasterise.
#[derive(Clone, Copy)]
struct SplatSetting {
    mode: &'static str,
    isa: Isa,
    threads: usize,
    footprint: Footprint,
    filter: Filter,
    skips: Skips,
}

impl SplatSetting {
    /// What the program uses.
    fn default() -> Self {
        SplatSetting {
            mode: "EWA, f32",
            isa: Isa::widest(),
            threads: 1,
            footprint: Footprint::Ewa,
            filter: Filter::Dilate,
            skips: Skips::ALL,
        }
    }

    fn label(&self) -> String {
        match self.threads {
            1 => self.isa.to_string(),
            threads => format!("{}, {threads} threads", self.isa),
        }
    }
}

/// What one setting computes and costs.
struct PassMeasurement {
    image: Vec<f64>,
    groups: Vec<(&'static str, Vec<f64>)>,
    forward_s: f64,
    both_s: f64,
    wall_s: f64,
}

fn measure_passes<T: SplatKernels>(
    scene: &TimedScene,
    setting: SplatSetting,
    repetitions: usize,
) -> Result<PassMeasurement> {
    let mut scene = scene.cast::<T>();
    scene.settings = Settings { footprint: setting.footprint, filter: setting.filter, ..scene.settings };
    timing::pool(setting.threads)?.install(|| {
        let mut rasterizer = Rasterizer::<T>::with_isa(setting.isa)?;
        rasterizer.skips(setting.skips);
        let forward = timing::repeat(repetitions, || scene.forward(&mut rasterizer))?;
        let both = timing::repeat(repetitions, || scene.forward_backward(&mut rasterizer, Wanted::ALL))?;
        Ok(PassMeasurement {
            image: widened(&rasterizer.rendered().color),
            groups: gradient_groups(rasterizer.gradients()),
            forward_s: forward.cpu().median_s,
            both_s: both.cpu().median_s,
            wall_s: both.wall().least_s,
        })
    })
}

/// The points of a scene, for the chart of gradients and for that of the image.
fn points(subject: &str, scene: &TimedScene, repetitions: usize) -> Result<[Vec<ParetoPoint>; 2]> {
    let slow = repetitions.div_ceil(10);
    let few = if scene.gaussians.len() >= MANY_DISCS { slow } else { repetitions };
    let default = SplatSetting::default();
    let compensated = SplatSetting { filter: Filter::Compensate, ..default };
    let discs = SplatSetting { footprint: Footprint::Disc, ..default };
    let twin = |setting: SplatSetting| measure_passes::<f64>(scene, SplatSetting { isa: Isa::Scalar, ..setting }, slow);
    let (truth, truth_compensated, truth_discs) = (twin(default)?, twin(compensated)?, twin(discs)?);

    let mut charts = [Vec::new(), Vec::new()];
    let mut add = |setting: SplatSetting, found: &PassMeasurement, truth: &PassMeasurement, role: SettingRole| {
        let pairs = found.groups.iter().zip(&truth.groups);
        let gradients = pairs.map(|(f, t)| relative_l2(&f.1, &t.1)).fold(0.0, f64::max);
        let image = relative_l2(&found.image, &truth.image);
        for (chart, error) in charts.iter_mut().zip([gradients, image]) {
            chart.push(ParetoPoint {
                subject: subject.into(),
                mode: setting.mode.into(),
                setting: setting.label(),
                cost: found.both_s,
                error,
                role,
                extra: vec![
                    ("threads", setting.threads as f64),
                    ("forward_s", found.forward_s),
                    ("least_wall_s", found.wall_s),
                    ("gradient_error", gradients),
                    ("image_error", image),
                    ("image_to_exact_discs", relative_l2(&found.image, &truth_discs.image)),
                ],
            });
        }
    };
    for isa in [Isa::Scalar, Isa::Baseline, Isa::Avx2, Isa::Avx512] {
        if isa.available().is_ok() {
            let setting = SplatSetting { isa, ..default };
            let found = measure_passes::<f32>(scene, setting, if isa == Isa::Scalar { slow } else { few })?;
            let role = if isa == Isa::widest() { SettingRole::Default } else { SettingRole::Alternative };
            add(setting, &found, &truth, role);
        }
    }
    let whole_tiles = Skips::ALL.without(Skips::BLOCKS);
    for (setting, truth, repetitions) in [
        (SplatSetting { threads: 2, ..default }, &truth, few),
        (SplatSetting { mode: "EWA, f32, whole tiles", skips: whole_tiles, ..default }, &truth, few),
        (SplatSetting { mode: "EWA compensated, f32", ..compensated }, &truth_compensated, few),
        (SplatSetting { mode: "exact discs, f32", ..discs }, &truth_discs, slow),
    ] {
        let found = measure_passes::<f32>(scene, setting, repetitions)?;
        add(setting, &found, truth, SettingRole::Alternative);
    }
    let plain = |mode, setting| SplatSetting { mode, isa: Isa::Scalar, ..setting };
    for (setting, truth) in [
        (plain("EWA, f64", default), &truth),
        (plain("EWA compensated, f64", compensated), &truth_compensated),
        (plain("exact discs, f64", discs), &truth_discs),
    ] {
        add(setting, truth, truth, SettingRole::Alternative);
    }
    Ok(charts)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_of_scenes_are_read_and_others_refused() {
        assert_eq!("20000x256".parse::<SceneSize>().unwrap(), SceneSize { discs: 20_000, side_px: 256 });
        for wrong in ["20000", "x256", "10x0", "0x10", "10x5000", "99999999999x10", "tenxten"] {
            assert!(wrong.parse::<SceneSize>().is_err(), "{wrong}");
        }
    }
}
