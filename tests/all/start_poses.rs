//! Start poses that are off as in BronchOpt's tiers (arXiv 2511.09443): how many converge. It films and takes minutes:
//!
//! ```text
//! cargo test --release --locked --test all -- --ignored --nocapture start_poses
//! ```

use std::path::Path;

use glam::{DAffine3, DMat3, DQuat, DVec3};
use rayon::prelude::*;
use respire_bench::base::NoProgress;
use respire_bench::base::random::{CounterRng, Stage};
use respire_bench::reconstruct::{MethodFile, Reconstruct, observe};
use respire_bench::simulate::sequence::Sequence;
use respire_bench::simulate::track::Track;
use respire_bench::simulate::{SimulationSettings, simulate};

/// Mean offset of the starts of a tier, mm and rad, and the share of starts that is asked for, percent.
const TIERS: [(&str, f64, f64, f64); 3] =
    [("easy", 1.94, 0.14, 99.0), ("medium", 4.29, 0.34, 95.0), ("hard", 6.96, 0.49, 80.0)];
/// A start has converged if its pose is nearer than this, mm and degrees.
const CONVERGED: (f64, f64) = (2.0, 6.0);
/// Starts of each tier and film.
const STARTS: u64 = 24;

fn offset(pose: &DAffine3, mm: f64, rad: f64, seed: u64) -> DAffine3 {
    let mut random = CounterRng::new(seed, Stage::Test, &[41]);
    let mut unit = || DVec3::new(random.normal(), random.normal(), random.normal()).normalize_or(DVec3::X);
    let (axis, way) = (unit(), unit());
    let turn = DMat3::from_quat(DQuat::from_scaled_axis(axis * rad));
    DAffine3 { matrix3: pose.matrix3 * turn, translation: pose.translation + way * mm }
}

#[test]
#[ignore = "films four cases"]
fn starts_of_all_tiers_on_the_tuning_cases() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases");
    let method = MethodFile::load(&root.join("methods/ours-nav.toml")).unwrap().navigation().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let settings = SimulationSettings { width_px: 128, height_px: 128, frames: 4, ..crate::simulate::small() };
    let films: Vec<Sequence> = (1..=4)
        .map(|k| {
            let file = root.join(format!("tuning/tune{k}.toml"));
            let case = Track::Clinical.filming(respire_bench::airway::case::Case::load(&file).unwrap());
            let film = folder.path().join(&case.id);
            simulate(&case, &settings, &film, &NoProgress).unwrap();
            Sequence::open(&film).unwrap()
        })
        .collect();
    for (tier, mm, rad, wanted) in TIERS {
        let mut converged = 0;
        for film in &films {
            let observation = observe(film, method.access(), 1).unwrap();
            let truth = film.frames[0].world_from_camera;
            let found = |seed: u64| {
                let start = offset(&truth, mm, rad, seed);
                let deviation = [rad / 3f64.sqrt(), mm / 3f64.sqrt()];
                let pose = method.find_pose(&observation, 0, start, deviation);
                let off = DQuat::from_mat3(&(truth.matrix3.transpose() * pose.matrix3)).to_scaled_axis();
                (pose.translation.distance(truth.translation), off.length().to_degrees())
            };
            let off: Vec<(f64, f64)> = (0..STARTS).into_par_iter().map(found).collect();
            let count = off.iter().filter(|(mm, degrees)| *mm < CONVERGED.0 && *degrees < CONVERGED.1).count();
            println!("{tier} {}: {count} of {STARTS}", film.case_id);
            converged += count;
        }
        let percent = 100.0 * converged as f64 / (films.len() as u64 * STARTS) as f64;
        println!("{tier}: {percent:.1} % of starts (wanted: {wanted} %)");
    }
}
