//! The command `splat`: a `.ply` and cameras in; images, timing and gradients out, equal to the library's.

use std::path::Path;

use respire_bench::formats::gaussians_ply::{self, GaussianCloud};
use respire_bench::formats::transforms::{Transforms, TransformsFrame};
use respire_bench::formats::{exr, npy};
use respire_bench::splat::{Gaussians, ImageGradient, Rasterizer, Settings, Shape, View, Wanted};

use super::scenes::{Kind, Lens, random, relative, view, world_from_camera};

/// A `.ply` of ellipsoids with one that is not finite in the middle, and two cameras.
fn folder() -> (tempfile::TempDir, GaussianCloud) {
    let folder = tempfile::tempdir().unwrap();
    let scene = random(40, Kind::Ellipsoids, 1, 91).cast::<f32>();
    let Shape::Ellipsoids { rotations, scales } = &scene.shape else { unreachable!("asked for ellipsoids") };
    let unit = |q: &[f32; 4]| {
        let length = q.iter().map(|v| v * v).sum::<f32>().sqrt();
        q.map(|v| v / length)
    };
    let mut cloud = GaussianCloud {
        positions: scene.positions.clone(),
        rotations: rotations.iter().map(unit).collect(),
        scales: scales.clone(),
        opacities: scene.opacities.iter().map(|o| o.min(0.98)).collect(),
        sh: scene.sh.clone(),
        sh_degree: 1,
        ..GaussianCloud::default()
    };
    cloud.positions[17][1] = f32::NAN;
    gaussians_ply::write(&folder.path().join("scene.ply"), &cloud).unwrap();
    let frame = |shift: f64| {
        let mut world = world_from_camera();
        world.translation.x += shift;
        TransformsFrame {
            file_path: "images/000000.png".into(),
            depth_file_path: None,
            mask_path: None,
            transform_matrix: TransformsFrame::matrix(&world),
            time: 0.0,
            breathing_phase: None,
            exposure: 1.0,
            white_balance: [1.0; 3],
        }
    };
    Transforms::new(&view(Lens::Pinhole).camera, vec![frame(0.0), frame(0.5)])
        .write(&folder.path().join("transforms.json"))
        .unwrap();
    let cloud = gaussians_ply::read(&folder.path().join("scene.ply")).unwrap();
    (folder, cloud)
}

fn command(folder: &Path, more: &[&str]) -> assert_cmd::assert::Assert {
    assert_cmd::Command::cargo_bin("respire-bench")
        .unwrap()
        .current_dir(folder)
        .args(["splat", "scene.ply", "--cameras", "transforms.json", "--out", "out"])
        .args(more)
        .assert()
}

#[test]
fn command_writes_what_the_library_computes() {
    let (folder, cloud) = folder();
    let path = folder.path();
    let weights: Vec<f32> = (0..43 * 29 * 3).map(|k| ((k * 7919) % 101) as f32 / 50.0 - 1.0).collect();
    npy::write(&path.join("w.npy"), &[29, 43, 3], &weights).unwrap();
    let said = command(path, &["--gradients", "w.npy", "--repeat", "2"]).success();
    let said = String::from_utf8_lossy(&said.get_output().stdout).into_owned()
        + &String::from_utf8_lossy(&said.get_output().stderr);
    assert!(said.contains("1 of 40 Gaussians are not finite"), "{said}");
    let scene = Gaussians {
        positions: cloud.positions.clone(),
        shape: Shape::Ellipsoids { rotations: cloud.rotations.clone(), scales: cloud.scales.clone() },
        opacities: cloud.opacities.clone(),
        sh: cloud.sh.clone(),
        sh_degree: 1,
    };
    // Double precision: what the command's single precision must come near to.
    let scene = scene.cast::<f64>();
    let wide: Vec<f64> = weights.iter().map(|&w| w as f64).collect();
    let mut rasterizer = Rasterizer::<f64>::new();
    let mut means = vec![0.0; 40 * 3];
    for (number, shift) in [0.0, 0.5].into_iter().enumerate() {
        let mut world = world_from_camera();
        world.translation.x += shift;
        let seen = View::new(view(Lens::Pinhole).camera, world);
        let image = rasterizer.render(&scene, &seen, &Settings::default(), None).unwrap().clone();
        let file = |ending: &str| exr::read(&path.join(format!("out/{number:06}{ending}"))).unwrap();
        for (found, truth) in
            [(file(".exr"), &image.color), (file("_depth.exr"), &image.depth), (file("_alpha.exr"), &image.alpha)]
        {
            let found: Vec<f64> = found.data.iter().map(|&v| v as f64).collect();
            assert!(relative(&found, truth) < 1e-5);
        }
        assert!(path.join(format!("out/{number:06}.png")).exists());
        let gradient = ImageGradient { color: &wide, ..ImageGradient::default() };
        let gradients = rasterizer.backward(&scene, &gradient, Wanted::ALL).unwrap();
        for (row, &i) in gradients.positions.iter().zip(&cloud.index) {
            (0..3).for_each(|k| means[i as usize * 3 + k] += row[k]);
        }
    }
    let mut archive = npyz::npz::NpzArchive::open(path.join("out/gradients.npz")).unwrap();
    let mut array = |name: &str| {
        let array = archive.by_name(name).unwrap().unwrap();
        (array.shape().to_vec(), array.into_vec::<f32>().unwrap())
    };
    let (shape, found) = array("means");
    assert_eq!(shape, [40, 3]);
    let found: Vec<f64> = found.iter().map(|&v| v as f64).collect();
    assert!(relative(&found, &means) < 1e-4, "{}", relative(&found, &means));
    assert!(found[17 * 3..18 * 3] == [0.0; 3], "the one that was left out has a gradient");
    for (name, expected) in
        [("scales", vec![40, 3]), ("quats", vec![40, 4]), ("opacities", vec![40]), ("sh", vec![40, 4, 3])]
    {
        assert_eq!(array(name).0, expected, "{name}");
    }
    let timing: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(path.join("out/timing.json")).unwrap()).unwrap();
    assert_eq!((timing["gaussians"].as_u64(), timing["dropped"].as_u64()), (Some(39), Some(1)));
    assert_eq!(timing["frames"].as_array().unwrap().len(), 2);
    for key in ["forward_ms", "backward_ms", "forward_cpu_ms", "backward_cpu_ms"] {
        assert!(timing["frames"][0][key].as_f64().unwrap() >= 0.0, "{key}");
    }
    assert!(timing["frames"][1]["stages"]["chain"]["wall_ms"].is_number() && timing["isa"].is_string());
}

#[test]
fn every_kernel_can_be_asked_for_and_depth_chosen() {
    let (folder, _) = folder();
    for isa in ["scalar", "sse2"] {
        command(folder.path(), &["--isa", isa, "--depth", "surface", "--background", "1", "0.5", "0"]).success();
    }
}

#[test]
fn command_says_what_is_wrong() {
    let (folder, _) = folder();
    let path = folder.path();
    let refused =
        |more: &[&str]| String::from_utf8_lossy(&command(path, more).failure().get_output().stderr).into_owned();
    npy::write(&path.join("w.npy"), &[4, 4, 3], &[0.0; 48]).unwrap();
    assert!(refused(&["--gradients", "w.npy"]).contains("[29, 43, 3] is wanted"));
    npy::write(&path.join("nan.npy"), &[29, 43, 3], &vec![f32::NAN; 29 * 43 * 3]).unwrap();
    assert!(refused(&["--gradients", "nan.npy"]).contains("not finite"));
    std::fs::write(path.join("scene.ply"), "ply\nformat ascii 1.0\nelement vertex 0\nend_header\n").unwrap();
    assert!(refused(&[]).contains("property x"));
}

#[test]
fn stress_passes_and_pareto_marks_the_default() {
    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| {
        let mut command = assert_cmd::Command::cargo_bin("respire-bench").unwrap();
        command.current_dir(folder.path()).args(arguments).assert().success();
    };
    run(&["stress", "--small", "--out", "stress"]);
    let table = std::fs::read_to_string(folder.path().join("stress/stress.csv")).unwrap();
    assert!(table.lines().count() > 40 && !table.contains("false"), "{table}");
    assert!(table.contains("NaN in positions") && table.contains("depth ties"));
    run(&["pareto", "splat", "--out", "pareto", "--scenes", "600x48", "--repeat", "1"]);
    let table = std::fs::read_to_string(folder.path().join("pareto/pareto-splat.csv")).unwrap();
    let defaults = table.lines().filter(|line| line.split(',').any(|f| f == "single precision")).count();
    assert!(defaults >= 2 && table.contains("double precision"), "{table}");
    assert!(std::fs::read_to_string(folder.path().join("pareto/skipping.csv")).unwrap().contains("(JVP)"));
}
