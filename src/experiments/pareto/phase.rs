//! Time against phase error of the two solvers, over steps, resolutions, iterations and discs per face.
//!
//! Each setting is the shipped method with one number changed. The error is the mean absolute error of the phase; the
//! mean error of the targets on the last frame's contour stands beside it. The cost is CPU time per frame of the method
//! alone, which other work on the machine disturbs least; wall time stands beside it.

use std::path::Path;

use crate::base::{NoProgress, Result};
use crate::bench::{Catalogue, Freshness, Pipeline, Profile, Store, Variant, Wishes, execute};
use crate::experiments::{ExperimentWatcher, timing};
use crate::reconstruct::observe;
use crate::report::pareto_chart::{ParetoChart, ParetoPoint, SettingRole};
use crate::score::contour::target_errors;
use crate::score::{final_mesh, statistics};
use crate::simulate::sequence::Sequence;

/// On what the solvers are measured.
pub struct PhaseSweep<'a> {
    /// Where cases, methods and profiles are described.
    pub catalogue: &'a Catalogue,
    /// Cases by id, or paths of case files.
    pub cases: Vec<String>,
    /// Name of the profile, or the path of its file.
    pub profile: &'a str,
    /// Folder of the sequences.
    pub cache: &'a Path,
}

/// Films the cases (or finds their films in the cache) and runs every setting on each.
pub fn chart(sweep: &PhaseSweep<'_>, watcher: &dyn ExperimentWatcher) -> Result<ParetoChart> {
    let iteration_scale = Profile::load(&sweep.catalogue.profiles(), sweep.profile)?.iteration_scale;
    let mut points = Vec::new();
    for sequence in sequences(sweep, watcher)? {
        watcher.stage_starts(&sequence.case_id);
        for setting in settings() {
            watcher.proceed()?;
            points.push(point(&sequence, &setting, &sweep.catalogue.methods(), iteration_scale)?);
        }
    }
    Ok(ParetoChart { cost: "CPU seconds per frame", error: "mean absolute error of the phase", points })
}

fn sequences(sweep: &PhaseSweep<'_>, watcher: &dyn ExperimentWatcher) -> Result<Vec<Sequence>> {
    let wishes = Wishes {
        cases: Some(sweep.cases.clone()),
        methods: Some(vec!["ours-gn".into()]),
        seeds: Some(vec![1]),
        ..Wishes::default()
    };
    let pipeline = Pipeline::new(sweep.catalogue, sweep.profile, wishes)?;
    let store = Store::open(sweep.cache)?;
    let finished = execute(&pipeline.plan()?, &pipeline, &store, Freshness::Resume, watcher)?;
    let open = |cell: crate::bench::FinishedCell| match cell.failure {
        Some(error) => Err(error),
        None => Sequence::open(&cell.sequence),
    };
    finished.into_iter().map(open).collect()
}

/// A shipped method with a few of its numbers changed.
struct SolverSetting {
    mode: &'static str,
    name: String,
    variant: Variant,
    iteration_share: f64,
    role: SettingRole,
}

/// Keys of the method files.
const STEPS: &str = "steps";
const SMALLEST_WIDTH: &str = "smallest_width";
const DISCS: &str = "discs.gaussians_per_face";
const ADAM_DISCS: &str = "appearance.gaussians_per_face";
const KEYFRAMES: &str = "window.keyframes";

fn settings() -> Vec<SolverSetting> {
    let setting = |mode, method: &str, name: &str, changes: Vec<(&str, toml::Value)>| SolverSetting {
        mode,
        name: name.into(),
        variant: Variant {
            set: changes.into_iter().map(|(key, value)| (key.to_owned(), value)).collect(),
            ..Variant::shipped(method)
        },
        iteration_share: 1.0,
        role: SettingRole::Alternative,
    };
    let shipped =
        |mode, method| SolverSetting { role: SettingRole::Default, ..setting(mode, method, "as shipped", vec![]) };
    let mut all = vec![shipped("Gauss-Newton", "ours-gn")];
    for steps in [[1, 1, 0], [3, 2, 1], [0, 0, 2], [0, 3, 0], [6, 0, 0]] {
        let [quarter, half, full] = steps;
        let mut changes = vec![(STEPS, toml::Value::from(steps.to_vec()))];
        if [half, full] == [0, 0] {
            changes.push((SMALLEST_WIDTH, 8.into()));
        }
        let name = format!("{quarter}-{half}-{full}");
        all.push(setting("Gauss-Newton: steps at 1/4, 1/2, 1", "ours-gn", &name, changes));
    }
    for keyframes in [0, 4, 16] {
        let mut changes = vec![(KEYFRAMES, keyframes.into())];
        if keyframes == 0 {
            changes.push((STEPS, vec![3, 2, 1].into()));
        }
        all.push(setting("Gauss-Newton: keyframes", "ours-gn", &keyframes.to_string(), changes));
    }
    for discs in [1, 2, 8] {
        let changes = vec![(DISCS, discs.into())];
        all.push(setting("Gauss-Newton: discs a face", "ours-gn", &discs.to_string(), changes));
    }
    all.push(shipped("Adam", "ours-window"));
    for share in [0.25, 0.5, 2.0] {
        let name = format!("{share} times");
        all.push(SolverSetting { iteration_share: share, ..setting("Adam: iterations", "ours-window", &name, vec![]) });
    }
    for keyframes in [0, 4] {
        let changes = vec![(KEYFRAMES, keyframes.into())];
        all.push(setting("Adam: keyframes", "ours-window", &keyframes.to_string(), changes));
    }
    all.push(setting("Adam: discs a face", "ours-window", "4", vec![(ADAM_DISCS, 4.into())]));
    all.push(setting("Adam", "ours", "the paper's equations alone", vec![]));
    all
}

fn point(sequence: &Sequence, setting: &SolverSetting, methods: &Path, iteration_scale: f64) -> Result<ParetoPoint> {
    let method = setting.variant.method_file(methods)?.method(iteration_scale * setting.iteration_share)?;
    let observation = observe(sequence, method.access(), 1)?;
    let frames = sequence.frames.len() as f64;
    let mut errors = Vec::new();
    let mut answer = |found: crate::reconstruct::FramePrediction| {
        errors.extend(found.phase.map(|phase| (phase - sequence.frames[found.frame].phase).abs()));
        Ok(())
    };
    let (done, cost) = timing::measure(|| method.run(&observation, &mut answer, &NoProgress));
    let predicted = done?.final_mesh.unwrap_or_else(|| observation.inspiration.clone());
    let pose = sequence.frames.last().map(|f| f.world_from_camera).unwrap_or_default();
    let target = target_errors(&final_mesh(sequence)?, &predicted, None, &pose, 1)?.and_then(|t| t.mean_mm);
    Ok(ParetoPoint {
        subject: sequence.case_id.clone(),
        mode: setting.mode.into(),
        setting: setting.name.clone(),
        cost: cost.cpu_s / frames,
        error: statistics::mean(&errors).unwrap_or(f64::NAN),
        role: setting.role,
        extra: vec![("target_mean_mm", target.unwrap_or(f64::NAN)), ("wall_s_per_frame", cost.wall_s / frames)],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A setting that changes nothing would be a second point of the shipped method.
    #[test]
    fn every_setting_is_a_method_that_can_be_read() {
        let methods = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases/methods");
        for setting in settings() {
            let id = &setting.variant.method;
            let [changed, shipped] =
                [&setting.variant, &Variant::shipped(id)].map(|v| v.method_file(&methods).unwrap());
            assert_eq!(&changed.header().id, id);
            let same = changed.keys() == shipped.keys();
            assert_eq!(same, setting.variant.set.is_empty(), "{} {}", setting.mode, setting.name);
        }
    }
}
