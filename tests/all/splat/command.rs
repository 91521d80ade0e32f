//! The command `splat`: a `.ply` and cameras in; images, timing and gradients out, equal to the library's.

use std::path::Path;

use respire_bench::formats::gaussians_ply::{self, GaussianCloud};
use respire_bench::formats::transforms::{Transforms, TransformsFrame, TransformsLens};
use respire_bench::formats::{exr, npy};
use respire_bench::splat::{DepthOutput, Gaussians, ImageGradient, Isa, Rasterizer, Settings, Shape, View, Wanted};

use crate::binary::PROGRAM;

use super::scenes::{Kind, Lens, member, random, relative, view, world_from_camera};

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
            lens: TransformsLens::default(),
        }
    };
    Transforms::new(&view(Lens::Pinhole).camera, vec![frame(0.0), frame(0.5)])
        .write(&folder.path().join("transforms.json"))
        .unwrap();
    let cloud = gaussians_ply::read(&folder.path().join("scene.ply")).unwrap();
    (folder, cloud)
}

fn command(folder: &Path, more: &[&str]) -> assert_cmd::assert::Assert {
    assert_cmd::Command::new(PROGRAM)
        .current_dir(folder)
        .args(["splat", "scene.ply", "--cameras", "transforms.json", "--out", "out"])
        .args(more)
        .assert()
}

/// What the command reads from the `.ply` of `cloud`.
fn gaussians_of(cloud: &GaussianCloud) -> Gaussians<f32> {
    Gaussians {
        positions: cloud.positions.clone(),
        shape: Shape::Ellipsoids { rotations: cloud.rotations.clone(), scales: cloud.scales.clone() },
        opacities: cloud.opacities.clone(),
        sh: cloud.sh.clone(),
        sh_degree: 1,
    }
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
    let scene = gaussians_of(&cloud);
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
    let array = |name: &str| {
        let array = npy::decode(&member(&path.join("out/gradients.npz"), name)).unwrap();
        (array.shape, array.data)
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

/// What `--gradients` says against differences of what the command itself renders after the `.ply` was changed.
#[test]
fn gradients_predict_what_the_command_renders() {
    let (folder, cloud) = folder();
    let path = folder.path();
    // Smooth, so that what single pixels do at the cut at 1/255 weighs little.
    let weight = |k: usize| {
        let (x, y) = ((k / 3 % 43) as f32, (k / 3 / 43) as f32);
        [1.0, 0.6, -0.4][k % 3] * (1.0 + 0.5 * (x / 7.0).sin() + 0.3 * (y / 5.0).cos())
    };
    let weights: Vec<f32> = (0..43 * 29 * 3).map(weight).collect();
    npy::write(&path.join("w.npy"), &[29, 43, 3], &weights).unwrap();
    for more in [vec![], vec!["--filter", "compensate"]] {
        gaussians_ply::write(&path.join("scene.ply"), &cloud).unwrap();
        command(path, &[&["--gradients", "w.npy", "--lens"][..], &more].concat()).success();
        // The folder holds what the last run wrote, and nothing of this one after the next.
        std::fs::copy(path.join("out/gradients.npz"), path.join("gradients.npz")).unwrap();
        let array = |name: &str| npy::decode(&member(&path.join("gradients.npz"), name)).unwrap();
        let shapes = [("pose", vec![2, 6]), ("lens", vec![2, 4])];
        for (name, shape) in shapes {
            assert_eq!(array(name).shape, shape, "{name}");
        }
        for name in ["means", "scales", "opacities", "sh"] {
            let gradient = array(name).data;
            // Along the gradient itself. The cut at 1/255 adds a hundredth or two, which no derivative sees.
            let largest = gradient.iter().fold(0.0, |most: f32, g| most.max(g.abs()));
            let direction: Vec<f32> = gradient.iter().map(|g| g / largest).collect();
            let predicted: f64 = gradient.iter().zip(&direction).map(|(g, d)| f64::from(g * d)).sum();
            let loss_at = |step: f32| {
                let mut moved = cloud.clone();
                let values: &mut [f32] = match name {
                    "means" => moved.positions.as_flattened_mut(),
                    "scales" => moved.scales.as_flattened_mut(),
                    "opacities" => &mut moved.opacities,
                    _ => &mut moved.sh,
                };
                values.iter_mut().zip(&direction).for_each(|(v, d)| *v += step * d);
                gaussians_ply::write(&path.join("scene.ply"), &moved).unwrap();
                command(path, &more).success();
                let frame = |k: usize| exr::read(&path.join(format!("out/{k:06}.exr"))).unwrap().data;
                let weigh = |k| frame(k).iter().zip(&weights).map(|(v, w)| f64::from(*v) * f64::from(*w)).sum::<f64>();
                weigh(0) + weigh(1)
            };
            let step = 1e-3;
            let numeric = (loss_at(step) - loss_at(-step)) / (2.0 * f64::from(step));
            let error = (numeric - predicted).abs() / predicted.abs();
            println!("{more:?} {name}: {predicted:.4} predicted, {numeric:.4} rendered");
            assert!(error < 0.1, "{more:?} {name}: {predicted} predicted, {numeric} rendered");
        }
    }
}

#[test]
fn what_is_asked_for_is_written() {
    let (folder, cloud) = folder();
    let path = folder.path();
    let features: Vec<f32> = (0..40 * 5).map(|k| (k as f32 * 0.7).sin()).collect();
    npy::write(&path.join("f.npy"), &[40, 5], &features).unwrap();
    let asked = ["--normals", "--contributors", "--channels", "f.npy", "--depth", "median"];
    command(path, &asked).success();
    let normals = exr::read(&path.join("out/000000_normals.exr")).unwrap();
    let alpha = exr::read(&path.join("out/000000_alpha.exr")).unwrap();
    let counts = exr::read(&path.join("out/000000_contributors.exr")).unwrap();
    let depth = exr::read(&path.join("out/000000_depth.exr")).unwrap();
    assert!(path.join("out/000000_channels.exr").exists() && normals.channels == 3);
    for (p, normal) in normals.data.chunks(3).enumerate() {
        let length = normal.iter().map(|v| v * v).sum::<f32>().sqrt();
        assert!(length <= alpha.data[p] + 1e-5, "a mean of unit vectors is no longer than its weight");
        assert_eq!(counts.data[p] > 0.0, alpha.data[p] > 0.0);
        assert_eq!(depth.data[p] > 0.0, alpha.data[p] >= 0.5, "median depth is where half of the light is gone");
    }
    assert!(counts.data.iter().any(|&count| count >= 3.0) && cloud.len() == 39);
    npy::write(&path.join("short.npy"), &[39, 5], &features[..39 * 5]).unwrap();
    let refused = command(path, &["--channels", "short.npy"]).failure();
    let sentence = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
    assert!(sentence.contains("short.npy") && sentence.contains("40 Gaussians"), "{sentence}");
    // Named by its row in the file, before anything is written; what belongs to the one that is left out is not read.
    std::fs::remove_dir_all(path.join("out")).unwrap();
    let mut bad = features.clone();
    bad[17 * 5] = f32::NAN;
    npy::write(&path.join("left-out.npy"), &[40, 5], &bad).unwrap();
    command(path, &["--channels", "left-out.npy"]).success();
    std::fs::remove_dir_all(path.join("out")).unwrap();
    bad[30 * 5 + 2] = f32::INFINITY;
    npy::write(&path.join("bad.npy"), &[40, 5], &bad).unwrap();
    let refused = command(path, &["--channels", "bad.npy"]).code(4);
    let sentence = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
    assert!(sentence.contains("bad.npy: Gaussian 30, channel 2: a feature is not finite"), "{sentence}");
    assert!(!path.join("out").exists());
}

/// Every kernel that this processor runs shows what the plain twin in double precision does, at every kind of depth.
#[test]
fn every_kernel_can_be_asked_for_and_depth_chosen() {
    let (folder, cloud) = folder();
    let path = folder.path();
    let scene = gaussians_of(&cloud);
    let scene = scene.cast::<f64>();
    let seen = View::new(view(Lens::Pinhole).camera, world_from_camera());
    let mut depths: Vec<Vec<f64>> = Vec::new();
    for (name, depth) in
        [("expected", DepthOutput::Expected), ("surface", DepthOutput::Surface), ("median", DepthOutput::Median)]
    {
        let settings = Settings { depth, background: [1.0, 0.5, 0.0], ..Settings::default() };
        let truth = Rasterizer::<f64>::new().render(&scene, &seen, &settings, None).unwrap().clone();
        for isa in [Isa::Scalar, Isa::Baseline, Isa::Avx2, Isa::Avx512] {
            let asked = isa.to_string();
            let said = command(path, &["--isa", &asked, "--depth", name, "--background", "1", "0.5", "0"]);
            if isa.available().is_err() {
                said.code(5);
                continue;
            }
            said.success();
            let timing = std::fs::read_to_string(path.join("out/timing.json")).unwrap();
            let timing: serde_json::Value = serde_json::from_str(&timing).unwrap();
            assert_eq!(timing["isa"].as_str(), Some(&asked[..]));
            // A ray that grazes an ellipsoid magnifies what rounding takes from its depth.
            for (ending, truth, most) in
                [("", &truth.color, 1e-4), ("_alpha", &truth.alpha, 1e-4), ("_depth", &truth.depth, 1e-3)]
            {
                let found = exr::read(&path.join(format!("out/000000{ending}.exr"))).unwrap();
                let found: Vec<f64> = found.data.iter().map(|&v| f64::from(v)).collect();
                let error = relative(&found, truth);
                assert!(error < most, "{isa}, depth {name}, 000000{ending}.exr: {error:e}");
            }
        }
        assert!(depths.iter().all(|other| relative(other, &truth.depth) > 2e-3), "{name} shows another depth");
        depths.push(truth.depth);
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
    assert!(refused(&["--gradients", "nan.npy"]).contains("nan.npy: pixel (0, 0): a weight is not finite"));
    let mut weights = vec![0.0; 2 * 29 * 43 * 3];
    weights[29 * 43 * 3 + 3 * (5 * 43 + 7) + 1] = f32::INFINITY;
    npy::write(&path.join("inf.npy"), &[2, 29, 43, 3], &weights).unwrap();
    assert!(refused(&["--gradients", "inf.npy"]).contains("inf.npy: frame 1, pixel (7, 5): a weight is not finite"));
    npy::write(&path.join("zeros.npy"), &[29, 43, 3], &[0.0; 29 * 43 * 3]).unwrap();
    let cameras = std::fs::read_to_string(path.join("transforms.json")).unwrap();
    let mut value: serde_json::Value = serde_json::from_str(&cameras).unwrap();
    value["frames"] = serde_json::json!([]);
    std::fs::write(path.join("transforms.json"), value.to_string()).unwrap();
    assert!(refused(&[]).contains("transforms.json: frames: there is none"), "{}", refused(&[]));
    let mut value: serde_json::Value = serde_json::from_str(&cameras).unwrap();
    value["camera_model"] = "OPENCV_FISHEYE".into();
    std::fs::write(path.join("transforms.json"), value.to_string()).unwrap();
    let said = refused(&["--gradients", "zeros.npy", "--lens", "--mode", "disc"]);
    assert!(
        said.contains("transforms.json: frame 0: is a fisheye, whose --lens has no gradient with --mode disc"),
        "{said}"
    );
    assert!(!path.join("out").exists(), "all of it is known before any work");
    let mut value: serde_json::Value = serde_json::from_str(&cameras).unwrap();
    value["w"] = 60000.into();
    std::fs::write(path.join("transforms.json"), value.to_string()).unwrap();
    assert!(refused(&[]).contains("transforms.json: frame 0: image of 60000"), "{}", refused(&[]));
    std::fs::write(path.join("transforms.json"), cameras).unwrap();
    std::fs::write(path.join("scene.ply"), "ply\nformat ascii 1.0\nelement vertex 0\nend_header\n").unwrap();
    assert!(refused(&[]).contains("property x"));
    // Read to its end, a device takes all memory.
    std::fs::remove_file(path.join("scene.ply")).unwrap();
    std::os::unix::fs::symlink("/dev/zero", path.join("scene.ply")).unwrap();
    assert!(refused(&[]).contains("scene.ply: is neither a file nor a pipe"), "{}", refused(&[]));
}

#[test]
fn stress_passes_and_pareto_marks_the_default() {
    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| {
        let mut command = assert_cmd::Command::new(PROGRAM);
        command.current_dir(folder.path()).args(arguments).assert().success();
    };
    run(&["stress", "--small", "--out", "stress"]);
    let table = std::fs::read_to_string(folder.path().join("stress/stress.csv")).unwrap();
    assert!(table.lines().count() > 40 && !table.contains("false"), "{table}");
    assert!(table.contains("NaN in positions") && table.contains("depth ties"));
    let faults = table.lines().filter(|line| line.starts_with("seeded fault")).count();
    assert!(faults >= 12 && table.contains("central differences") && table.contains("exact discs"), "{faults}");
    run(&["pareto", "splat", "--out", "pareto", "--scenes", "600x48", "--repeat", "1"]);
    let table = std::fs::read_to_string(folder.path().join("pareto/pareto-splat.csv")).unwrap();
    // Or the same in two threads, or with the compensated filter, which take the same CPU time: which of them is on the
    // front is chance.
    let same_kernels = |line: &str| line.contains("2 threads") || line.contains("EWA compensated, f32");
    let on_front = |line: &&str| line.contains(",true,true,") || (line.contains(",true,false,") && same_kernels(line));
    assert!(table.lines().any(|line| on_front(&line)), "the default is on the front: {table}");
    for mode in ["EWA, f32", "2 threads", "whole tiles", "compensated", "EWA, f64", "exact discs, f32"] {
        assert!(table.contains(mode), "{mode} is missing: {table}");
    }
    assert!(folder.path().join("pareto/pareto-splat-image.png").exists());
    let table = std::fs::read_to_string(folder.path().join("pareto/skipping.csv")).unwrap();
    for skipped in ["extents", "blocks", "beside", "stopped", "frozen", "(JVP)", "Unchanged", "moments"] {
        assert!(table.contains(skipped), "{skipped} is missing: {table}");
    }
}

#[test]
fn an_empty_scene_is_said_to_be_empty() {
    let (folder, mut cloud) = folder();
    let path = folder.path();
    cloud.rotations.iter_mut().for_each(|q| *q = [0.0; 4]);
    for (cloud, says) in [
        (cloud, "39 of 39 Gaussians are not finite, or have no rotation: they are left out"),
        (GaussianCloud::default(), "no Gaussian is visible in 2 of 2 frames: scene.ply holds none"),
    ] {
        gaussians_ply::write(&path.join("scene.ply"), &cloud).unwrap();
        let said = command(path, &[]).success();
        let said = String::from_utf8_lossy(&said.get_output().stdout).into_owned()
            + &String::from_utf8_lossy(&said.get_output().stderr);
        assert!(said.contains(says) && !said.contains("behind the camera"), "{said}");
    }
}

/// Three billion entries of lists: asked about, and with `--yes` refused in one sentence.
#[test]
fn command_asks_before_work_that_does_not_fit() {
    let folder = tempfile::tempdir().unwrap();
    let cloud = GaussianCloud {
        positions: vec![[0.0, 0.0, -5.0]; 3000],
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; 3000],
        scales: vec![[50.0; 3]; 3000],
        opacities: vec![0.9; 3000],
        sh: vec![0.0; 3 * 3000],
        sh_degree: 0,
        ..GaussianCloud::default()
    };
    gaussians_ply::write(&folder.path().join("scene.ply"), &cloud).unwrap();
    let identity = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
    let frame = TransformsFrame {
        file_path: "images/000000.png".into(),
        depth_file_path: None,
        mask_path: None,
        transform_matrix: identity,
        time: 0.0,
        breathing_phase: None,
        exposure: 1.0,
        white_balance: [1.0; 3],
        lens: TransformsLens::default(),
    };
    let camera = respire_bench::base::Camera::pinhole(16384, 16384, 1.5);
    Transforms::new(&camera, vec![frame]).write(&folder.path().join("transforms.json")).unwrap();
    for (more, code, says) in [(&[][..], 2, "say --yes, or make it smaller"), (&["--yes"], 4, "frame 0: ")] {
        let said = command(folder.path(), more).code(code).get_output().stderr.clone();
        let said = String::from_utf8(said).unwrap();
        assert!(said.contains(says), "{said}");
    }
}

/// As others write them: sizes as floats, intrinsics in the frames, scenes in metres.
#[test]
fn cameras_of_other_programs_and_scenes_of_another_scale_are_shown() {
    let (folder, mut cloud) = folder();
    let path = folder.path();
    command(path, &[]).success();
    let image = |name: &str| exr::read(&path.join("out").join(name)).unwrap();
    let before = [image("000000.exr"), image("000001.exr")];
    let cameras = path.join("transforms.json");
    let ours: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&cameras).unwrap()).unwrap();

    // Every intrinsic in the frames, and the sizes as floats; the second frame is half as wide.
    let mut theirs = ours.clone();
    for key in ["w", "h", "fl_x", "fl_y", "cx", "cy"] {
        let value = theirs.as_object_mut().unwrap().remove(key).unwrap();
        for frame in theirs["frames"].as_array_mut().unwrap() {
            frame[key] = value.as_f64().unwrap().into();
        }
    }
    std::fs::write(&cameras, theirs.to_string()).unwrap();
    command(path, &[]).success();
    assert_eq!([image("000000.exr"), image("000001.exr")], before);
    theirs["frames"][1]["w"] = 20.0.into();
    std::fs::write(&cameras, theirs.to_string()).unwrap();
    command(path, &[]).success();
    assert_eq!((image("000000.exr"), image("000001.exr").width), (before[0].clone(), 20));
    let scene = gaussians_of(&cloud);
    let mut world = world_from_camera();
    world.translation.x += 0.5;
    let narrow = View::new(respire_bench::base::Camera { width: 20, ..view(Lens::Pinhole).camera }, world);
    let mut rasterizer = Rasterizer::<f64>::new();
    let truth = rasterizer.render(&scene.cast::<f64>(), &narrow, &Settings::default(), None).unwrap();
    let found: Vec<f64> = image("000001.exr").data.iter().map(|&v| v as f64).collect();
    assert!(relative(&found, &truth.color) < 1e-5);
    npy::write(&path.join("w.npy"), &[29, 43, 3], &[0.0; 29 * 43 * 3]).unwrap();
    let said =
        String::from_utf8_lossy(&command(path, &["--gradients", "w.npy"]).code(4).get_output().stderr).into_owned();
    assert!(said.contains("transforms.json: frame 1: has another size"), "{said}");

    // A scene in kilometres: nothing beyond the near plane, which is said; with a near plane of its scale, the same
    // image.
    let small = 1e-6;
    let mut theirs = ours;
    for frame in theirs["frames"].as_array_mut().unwrap() {
        (0..3).for_each(|row| {
            let moved = frame["transform_matrix"][row][3].as_f64().unwrap() * small;
            frame["transform_matrix"][row][3] = moved.into();
        });
    }
    std::fs::write(&cameras, theirs.to_string()).unwrap();
    cloud.positions.as_flattened_mut().iter_mut().for_each(|v| *v *= small as f32);
    cloud.scales.as_flattened_mut().iter_mut().for_each(|v| *v *= small as f32);
    gaussians_ply::write(&path.join("scene.ply"), &cloud).unwrap();
    let said = |more: &[&str]| String::from_utf8_lossy(&command(path, more).success().get_output().stderr).into_owned();
    let words = said(&[]);
    assert!(words.contains("no Gaussian is visible in 2 of 2 frames") && words.contains("--near"), "{words}");
    assert!(image("000000_alpha.exr").data.iter().all(|&alpha| alpha == 0.0));
    assert_eq!(said(&["--near", "2e-7"]), "");
    let pairs = image("000000.exr").data.into_iter().zip(&before[0].data).map(|(a, b)| (a - b).abs());
    assert!(pairs.fold(0.0, f32::max) < 2e-3);
}
