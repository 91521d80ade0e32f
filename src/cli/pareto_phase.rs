//! `respire-bench pareto phase`: time against phase error of the two solvers, over steps, resolutions, iterations and
//! discs per face.
//!
//! Each setting is the shipped method with one number changed. The error is the mean absolute error of the phase; the
//! mean error of the targets on the last frame's contour stands beside it. The cost is CPU time per frame of the method
//! alone, which other work on the machine disturbs least; wall time stands beside it.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;

use super::Terminal;
use crate::base::{Error, NoProgress, Progress, Result};
use crate::bench::{Catalogue, Freshness, Pipeline, Profile, Store, Wishes, execute};
use crate::ffi::system::cpu_time_s;
use crate::reconstruct::{MethodFile, Observation, observe};
use crate::report::pareto::{Chart, Point, Standing, write};
use crate::score::contour::target_errors;
use crate::score::{final_mesh, statistics};
use crate::simulate::sequence::Sequence;

/// Arguments of `pareto phase`.
#[derive(Args)]
pub(super) struct Arguments {
    /// Folder for table and plots
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Cases by id, or paths of case files
    #[arg(long, value_delimiter = ',', value_name = "CASE,..", default_value = "case1,case5,case9")]
    cases: Vec<String>,
    /// How much of everything: smoke, quick, paper, or the path of a profile file
    #[arg(long, default_value = "quick", value_name = "P")]
    profile: String,
    /// Folder of sequences
    #[arg(long, default_value = ".cache", value_name = "DIR")]
    cache: PathBuf,
    /// Folder with cases, methods and profiles
    #[arg(long, value_name = "DIR")]
    bench_cases: Option<PathBuf>,
}

/// The shipped method `id` with the numbers of `changes` replaced (paths of TOML keys).
struct PhaseSetting {
    mode: &'static str,
    setting: String,
    id: &'static str,
    changes: Vec<(&'static str, toml::Value)>,
    iteration_share: f64,
    standing: Standing,
}

const STEPS: &str = "steps";
const WIDTH: &str = "smallest_width";
const DISCS: &str = "discs.gaussians_per_face";
const ADAM_DISCS: &str = "appearance.gaussians_per_face";
const KEYFRAMES: &str = "window.keyframes";

fn variants() -> Vec<PhaseSetting> {
    let gauss_newton = |mode, setting: String, changes| {
        let standing = Standing::Alternative;
        PhaseSetting { mode, setting, id: "ours-gn", changes, iteration_share: 1.0, standing }
    };
    let mut all = vec![gauss_newton("Gauss-Newton", "as shipped".into(), Vec::new())];
    all[0].standing = Standing::Default;
    for steps in [[1, 1, 0], [3, 2, 1], [0, 0, 2], [0, 3, 0], [6, 0, 0]] {
        let mut changes = vec![(STEPS, toml::Value::from(steps.to_vec()))];
        if steps[1..] == [0, 0] {
            changes.push((WIDTH, toml::Value::from(8)));
        }
        let [quarter, half, full] = steps;
        all.push(gauss_newton("Gauss-Newton: steps at 1/4, 1/2, 1", format!("{quarter}-{half}-{full}"), changes));
    }
    for keyframes in [0, 4, 16] {
        let mut changes = vec![(KEYFRAMES, toml::Value::from(keyframes))];
        if keyframes == 0 {
            changes.push((STEPS, toml::Value::from(vec![3, 2, 1])));
        }
        all.push(gauss_newton("Gauss-Newton: keyframes", format!("{keyframes}"), changes));
    }
    for discs in [1, 2, 8] {
        let changes = vec![(DISCS, toml::Value::from(discs))];
        all.push(gauss_newton("Gauss-Newton: discs a face", format!("{discs}"), changes));
    }
    let adam = |mode, setting: String, iteration_share, changes| {
        let standing = Standing::Alternative;
        PhaseSetting { mode, setting, id: "ours", changes, iteration_share, standing }
    };
    all.push(PhaseSetting { standing: Standing::Default, ..adam("Adam", "as shipped".into(), 1.0, Vec::new()) });
    for share in [0.25, 0.5, 2.0] {
        all.push(adam("Adam: iterations", format!("{share} times"), share, Vec::new()));
    }
    for keyframes in [0, 4] {
        let changes = vec![(KEYFRAMES, toml::Value::from(keyframes))];
        all.push(adam("Adam: keyframes", format!("{keyframes}"), 1.0, changes));
    }
    all.push(adam("Adam: discs a face", "4".into(), 1.0, vec![(ADAM_DISCS, toml::Value::from(4))]));
    let plain = adam("Adam", "the paper's equations alone".into(), 1.0, Vec::new());
    all.push(PhaseSetting { id: "ours-plain", ..plain });
    all
}

impl PhaseSetting {
    /// The method's file with the changes; `methods` is the folder of the shipped files.
    fn method_file(&self, methods: &Path) -> Result<MethodFile> {
        let file = MethodFile::load(&methods.join(format!("{}.toml", self.id)))?;
        file.with(self.changes.iter().map(|(key, value)| (*key, value)))
    }
}

/// One film of a case.
struct Film {
    name: String,
    sequence: Sequence,
}

/// Films the cases, or finds their films in the cache.
fn films(arguments: &Arguments, catalogue: &Catalogue, terminal: &Terminal) -> Result<Vec<Film>> {
    let wishes =
        Wishes { cases: Some(arguments.cases.clone()), methods: Some(vec!["ours-gn".into()]), seeds: Some(vec![1]) };
    let pipeline = Pipeline::new(catalogue, &arguments.profile, wishes)?;
    let mut store = Store::open(&arguments.cache)?;
    let finished = execute(&pipeline.plan()?, &pipeline, &mut store, Freshness::Resume, terminal)?;
    let open = |(case, cell): (&crate::airway::case::Case, &crate::bench::FinishedCell)| {
        if let Some(error) = &cell.failure {
            return Err(error.clone());
        }
        Ok(Film { name: case.id.clone(), sequence: Sequence::open(&cell.sequence)? })
    };
    pipeline.cases().iter().zip(&finished).map(open).collect()
}

fn point(film: &Film, variant: &PhaseSetting, methods: &Path, iteration_scale: f64) -> Result<Point> {
    let method = variant.method_file(methods)?.method(iteration_scale * variant.iteration_share)?;
    let observation: Observation = observe(&film.sequence, method.access(), 1)?;
    let frames = film.sequence.frames.len() as f64;
    let mut errors = Vec::new();
    let (wall, cpu) = (Instant::now(), cpu_time_s());
    let done = method.run(
        &observation,
        &mut |answer| {
            errors.extend(answer.phase.map(|phase| (phase - film.sequence.frames[answer.frame].phase).abs()));
            Ok(())
        },
        &NoProgress,
    )?;
    let (wall, cpu) = (wall.elapsed().as_secs_f64(), cpu_time_s() - cpu);
    let pose = film.sequence.frames.last().map(|f| f.world_from_camera).unwrap_or_default();
    let predicted = done.final_mesh.unwrap_or_else(|| observation.inspiration.clone());
    let target = target_errors(&final_mesh(&film.sequence)?, &predicted, &pose, 1)?.and_then(|t| t.mean_mm);
    Ok(Point {
        subject: film.name.clone(),
        mode: variant.mode.into(),
        setting: variant.setting.clone(),
        cost: cpu / frames,
        error: statistics::mean(&errors).unwrap_or(f64::NAN),
        standing: variant.standing,
        extra: vec![("target_mean_mm", target.unwrap_or(f64::NAN)), ("wall_s_per_frame", wall / frames)],
    })
}

/// Runs the command.
pub(super) fn run(arguments: Arguments, terminal: &Terminal) -> Result<()> {
    let catalogue = Catalogue::find(arguments.bench_cases.as_deref())?;
    let iteration_scale = Profile::load(&catalogue.profiles(), &arguments.profile)?.iteration_scale;
    let mut points = Vec::new();
    for film in films(&arguments, &catalogue, terminal)? {
        terminal.stage(&film.name);
        for variant in variants() {
            if terminal.cancelled() {
                return Err(Error::interrupted());
            }
            points.push(point(&film, &variant, &catalogue.methods(), iteration_scale)?);
        }
    }
    let chart = Chart { cost: "CPU seconds per frame", error: "mean absolute error of the phase", points };
    let table = write(&chart, &arguments.out, "pareto-phase")?;
    terminal.line(table.display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A key that a method's file no longer has would make a variant that changes nothing.
    #[test]
    fn every_variant_is_a_method_that_can_be_read() {
        let methods_folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases/methods");
        for variant in variants() {
            let changed = variant.method_file(&methods_folder).unwrap();
            assert_eq!(changed.header().id, variant.id);
            let shipped = MethodFile::load(&methods_folder.join(format!("{}.toml", variant.id))).unwrap();
            let same = shipped.keys() == changed.keys();
            assert_eq!(same, variant.changes.is_empty(), "{} {}", variant.mode, variant.setting);
        }
    }
}
