//! A simulated pair of scans, coarse: what stands where, that mass is conserved, that tissue is carried by the field.

use glam::DVec3;
use respire_bench::airway::case::Case;
use respire_bench::base::{NoProgress, VoxelGrid};
use respire_bench::ct::simulated::chest::{BreathState, SimulatedChest};
use respire_bench::ct::simulated::protocol::ScannerSettings;
use respire_bench::ct::simulated::scan_truth::landmarks;
use respire_bench::ct::simulated::scanner::{NoiseSeed, scan};

use crate::cases::case_path;

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + v, count + 1.0));
    sum / count
}

#[test]
fn a_simulated_chest_is_one_tissue_in_two_states() {
    let case = Case::load(&case_path(1)).unwrap();
    let chest = SimulatedChest::new(&case).unwrap();
    let settings = ScannerSettings {
        pixel_mm: 4.0,
        slice_mm: 4.0,
        thickness_mm: 4.0,
        point_spread_mm: 4.0,
        noise_hu: 20.0,
        fine_slices: 2,
    };
    let grid = chest.grid(&settings);
    let places: Vec<DVec3> = (0..grid.count()).map(|at| grid.centre(at)).collect();
    let states = [BreathState::Inspiration, BreathState::Expiration].map(|state| chest.at(state).unwrap());
    let meshes = [&chest.anatomy.inspiration, &chest.anatomy.expiration];

    // Lumen, wall and lung have the densities of air, tissue and parenchyma; a lung that empties is denser.
    let lungs = [0, 1].map(|k: usize| {
        let (held, mesh) = (&states[k], meshes[k]);
        let wall = mesh.vertices.iter().zip(mesh.vertex_normals()).step_by(17);
        // Where the wall is thick enough to be seen whole.
        let across = |mm: f64| {
            let places = wall.clone().map(|(v, n)| (*v - n * mm, held.airway(*v - n * mm)));
            mean(places.filter(|(_, (d, t))| *t > 1.2 && (d - mm).abs() < 0.2).map(|(p, _)| held.hu(p)))
        };
        let (inside, middle) = (across(-1.5), across(0.65));
        assert!((inside + 995.0).abs() < 5.0 && (middle - 35.0).abs() < 60.0, "{k}: {inside} {middle}");
        mean(places.iter().filter(|p| held.lung(**p) < -2.0).map(|p| held.hu(*p)))
    });
    println!("lungs {lungs:?} HU");
    assert!((-900.0..-820.0).contains(&lungs[0]) && lungs[1] > lungs[0] + 10.0, "{lungs:?}");

    // The parenchyma's mass is the same at both: its density goes with the inverse of the volume.
    let mass = |k: usize| places.iter().filter_map(|p| states[k].density(*p)).sum::<f64>();
    let volume = |k: usize| places.iter().filter(|p| states[k].density(**p).is_some()).count() as f64;
    let (mass, volume) = (mass(1) / mass(0), volume(1) / volume(0));
    println!("mass {mass:.4}, volume {volume:.4}");
    assert!((mass - 1.0).abs() < 0.015 && volume < 0.97, "{mass} {volume}");

    // Vessels and texture stand where the field has carried them.
    let forks = landmarks(&chest, &states[1]);
    assert!(forks.len() >= 200, "{}", forks.len());
    for fork in &forks {
        let (x, y) = (fork.inspiration_mm, fork.expiration_mm);
        assert!((states[1].map.at(y).0 - x).length() < 1e-4);
        let hu = [states[0].hu(x), states[1].hu(y)];
        assert!((hu[0] - hu[1]).abs() < 80.0 && hu[0] > -450.0, "{hu:?} at {x}");
        for step in [DVec3::X, DVec3::Y * 3.0] {
            let there = states[1].map.forward(x + step);
            let (Some(a), Some(b)) = (states[0].density(x + step), states[1].density(there)) else { continue };
            let denser = states[1].map.at(there).1;
            assert!((b - (a * denser)).abs() < 0.02 * b, "{a} {b} {denser}");
        }
    }
    // The wall moves as the case says: the field of the picture and the surfaces agree beside it.
    let vertices = meshes[0].vertices.iter().zip(&meshes[1].vertices).step_by(97);
    let off = vertices.map(|(v, e)| states[1].map.forward(*v).distance(*e));
    let mut off: Vec<f64> = off.collect();
    off.sort_by(f64::total_cmp);
    println!("field beside the wall: {:.3} {:.3} mm", off[off.len() / 2], off[off.len() * 95 / 100]);
    assert!(off[off.len() / 2] < 0.25 && off[off.len() * 95 / 100] < 0.8);

    // The same bytes on any number of threads.
    let few = VoxelGrid { size: [grid.size[0], grid.size[1], 30], ..grid };
    let noise = NoiseSeed { seed: 1, exposure: 1 };
    let shoot = || scan(few, &settings, noise, |y| states[1].hu(y), &NoProgress).unwrap();
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(shoot);
    assert_eq!(one.data, shoot().data);
}
