//! The command `render`: scene file in, EXR and timing out.

use respire_bench::formats::{exr, mesh};
use respire_bench::render::scene_file::{MeshSection, SceneFile};
use respire_bench::render::{Scene, render};

use crate::binary::PROGRAM;
use crate::render::{scaled, small_tube, sphere};

/// A scene file around a small tube, in a new folder.
fn scene_folder(material: &str, expiration: bool) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut tube = small_tube();
    mesh::write_ply(&folder.path().join("tube.ply"), &tube, &[]).unwrap();
    tube.vertices.iter_mut().for_each(|v| v.z += 4.0);
    mesh::write_ply(&folder.path().join("out.ply"), &tube, &[]).unwrap();
    let pair = if expiration { "expiration = \"out.ply\"\nphase = 0.5" } else { "" };
    let text = format!(
        "[mesh]\npath = \"tube.ply\"\n{pair}\n[camera]\nworld_from_camera = [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]\n\
         width = 24\nheight = 20\nfov_x_deg = 90.0\n[light]\nintensity = [400.0, 400.0, 400.0]\n[material]\n{material}\n\
         coat_alpha = 0.15\nmean_free_path_mm = [1.0, 0.4, 0.25]\n\
         [integrator]\nmax_scatterings = 2\nspp = 4\nseed = 1\nshading = \"flat\"\ndenoise = false\n"
    );
    std::fs::write(folder.path().join("scene.toml"), text).unwrap();
    folder
}

fn command(folder: &tempfile::TempDir) -> assert_cmd::assert::Assert {
    assert_cmd::Command::new(PROGRAM)
        .arg("render")
        .arg(folder.path().join("scene.toml"))
        .arg("--out")
        .arg(folder.path().join("view"))
        .assert()
}

#[test]
fn command_writes_image_depth_and_timing() {
    let depth_at = |expiration| {
        let folder = scene_folder("kind = \"lambert\"", expiration);
        command(&folder).success();
        let view = folder.path().join("view");
        let image = exr::read(&view.join("image.exr")).unwrap();
        assert_eq!((image.width, image.height, image.channels), (24, 20, 3));
        let timing: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(view.join("timing.json")).unwrap()).unwrap();
        for key in [
            "render_wall_s",
            "render_cpu_s",
            "bvh_build_s",
            "bvh_refit_s",
            "triangles",
            "paths",
            "rays",
            "spp",
            "threads",
        ] {
            assert!(timing[key].is_number(), "{key}: {timing}");
        }
        assert_eq!(timing["isa"], "avx2");
        assert_eq!(timing["paths"], 24 * 20 * 4);
        // The camera looks out of the far end of the bent tube at its wall near the left.
        exr::read(&view.join("depth.exr")).unwrap()
    };
    let (inspiration, half) = (depth_at(false), depth_at(true));
    assert_eq!(inspiration.channels, 1);
    assert_ne!(inspiration, half);
}

/// Light at vertices interpolates between what walls see of each other at both ends of the breath: a scene file with
/// both meshes renders what a scene with its other end set does.
#[test]
fn light_at_vertices_knows_the_expiration_mesh() {
    let folder = scene_folder("kind = \"lambert\"", true);
    let tube = small_tube();
    let mut bent = tube.clone();
    bent.vertices.iter_mut().for_each(|v| v.y += 0.03 * v.z * v.z);
    mesh::write_ply(&folder.path().join("out.ply"), &bent, &[]).unwrap();
    let path = folder.path().join("scene.toml");
    let text = std::fs::read_to_string(&path).unwrap().replace("phase = 0.5", "phase = 1.0");
    std::fs::write(&path, text.replace("spp = 4", "spp = 4\ntransport = \"vertices\"")).unwrap();
    let file = SceneFile::load(&path).unwrap();
    let (camera, pose) = (file.camera.intrinsics().unwrap(), file.camera.pose().unwrap());
    let image = |scene: &Scene| render(scene, &camera, &pose, &file.light, &file.settings()).unwrap().radiance;
    let by_hand = |other_end: bool| {
        let mut scene = SceneFile { mesh: MeshSection { expiration: None, ..file.mesh.clone() }, ..file.clone() };
        scene.mesh.phase = 0.0;
        let mut scene = scene.build().unwrap();
        if other_end {
            scene.set_other_end(&bent.vertices).unwrap();
        }
        scene.deform(&bent.vertices).unwrap();
        image(&scene)
    };
    let found = image(&file.build().unwrap());
    assert_eq!(found, by_hand(true));
    assert_ne!(found, by_hand(false));
}

#[test]
fn command_says_what_is_wrong() {
    for (material, code, words) in [
        ("kind = \"subsurface\"\nsingle_scattering_albedo = [0.9, 1.1, 0.9]", 4, "material.single_scattering_albedo"),
        ("kind = \"velvet\"", 4, "velvet"),
        ("kind = \"coated\"\nalbedo = [0.5, 1.5, 0.5]", 4, "material.albedo"),
    ] {
        let folder = scene_folder(material, false);
        let output = command(&folder).code(code).get_output().stderr.clone();
        let text = String::from_utf8(output).unwrap();
        assert!(text.contains(words) && text.contains("scene.toml"), "{text}");
    }
    let folder = scene_folder("kind = \"lambert\"", false);
    std::fs::remove_file(folder.path().join("tube.ply")).unwrap();
    let text = String::from_utf8(command(&folder).code(4).get_output().stderr.clone()).unwrap();
    assert!(text.contains("tube.ply"), "{text}");
}

/// Replaces `from` in the folder's scene file.
fn change(folder: &tempfile::TempDir, from: &str, to: &str) {
    let path = folder.path().join("scene.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(text.contains(from), "{from}");
    std::fs::write(&path, text.replace(from, to)).unwrap();
}

fn complaint(outcome: assert_cmd::assert::Assert) -> String {
    String::from_utf8(outcome.get_output().stderr.clone()).unwrap()
}

#[test]
fn light_at_vertices_refuses_walls_wound_the_other_way() {
    let folder = scene_folder("kind = \"lambert\"", false);
    change(&folder, "spp = 4", "spp = 4\ntransport = \"vertices\"");
    command(&folder).success();
    change(&folder, "path = \"tube.ply\"", "path = \"tube.ply\"\nflip = true");
    let text = complaint(command(&folder).code(4));
    assert!(text.contains("scene.toml: mesh.flip: ") && text.contains("flip = false"), "{text}");
    change(&folder, "\"vertices\"", "\"paths\"");
    command(&folder).success();
}

#[test]
fn light_at_vertices_refuses_walls_wound_both_ways() {
    let folder = scene_folder("kind = \"lambert\"", false);
    let path = folder.path().join("tube.ply");
    let mut tube = mesh::read(&path).unwrap();
    tube.faces[7].swap(0, 1);
    mesh::write_ply(&path, &tube, &[]).unwrap();
    command(&folder).success();
    change(&folder, "spp = 4", "spp = 4\ntransport = \"gather\"");
    let text = complaint(command(&folder).code(4));
    assert!(text.contains("tube.ply: edge ") && text.contains("orient all faces alike"), "{text}");
}

#[test]
fn a_target_of_the_error_says_how_it_went() {
    let folder = scene_folder("kind = \"lambert\"", false);
    let estimate = || {
        let text = std::fs::read_to_string(folder.path().join("view/timing.json")).unwrap();
        let timing: serde_json::Value = serde_json::from_str(&text).unwrap();
        timing["estimated_relmse"].as_f64()
    };
    command(&folder).success();
    assert_eq!(estimate(), None);
    change(&folder, "spp = 4", "spp = 4\ntarget_relmse = 0.05");
    let text = complaint(command(&folder).success());
    assert!(!text.contains("target_relmse") && estimate().unwrap() <= 0.05, "{text}");
}

#[test]
fn light_at_vertices_settles_between_bright_walls_or_says_so() {
    let mean_of = |albedo: &str, transport: &str, subdivisions: u32| {
        let folder = scene_folder(&format!("kind = \"lambert\"\nalbedo = [{albedo}, {albedo}, {albedo}]"), false);
        mesh::write_ply(&folder.path().join("tube.ply"), &scaled(sphere(subdivisions), 10.0), &[]).unwrap();
        change(&folder, "max_scatterings = 2", &format!("transport = \"{transport}\""));
        let outcome = command(&folder);
        let image = exr::read(&folder.path().join("view/image.exr"));
        image
            .map(|image| image.data.iter().map(|&v| f64::from(v)).sum::<f64>() / image.data.len() as f64)
            .map_err(|_| complaint(outcome.code(4)))
    };
    // Lambert's sphere lit from its middle: I albedo / (1 - albedo) / (pi r^2).
    for transport in ["vertices", "gather"] {
        let expected = 400.0 / (100.0 * std::f64::consts::PI) * 0.99 / 0.01;
        let found = mean_of("0.99", transport, 4).unwrap();
        assert!((found / expected - 1.0).abs() < 0.02, "{transport}: {found} for {expected}");
    }
    let text = mean_of("1.0", "vertices", 1).unwrap_err();
    assert!(text.contains("max_scatterings"), "{text}");
}

#[test]
fn a_picture_of_nothing_is_noted_and_a_file_for_a_folder_refused() {
    let folder = scene_folder("kind = \"lambert\"", false);
    assert!(!complaint(command(&folder).success()).contains("note:"));
    change(&folder, "0,0,1,0, 0,0,0,1]", "0,0,1,500, 0,0,0,1]");
    let text = complaint(command(&folder).success());
    assert!(text.contains("note: no pixel shows the mesh"), "{text}");
    std::fs::remove_dir_all(folder.path().join("view")).unwrap();
    std::fs::write(folder.path().join("view"), "a file").unwrap();
    let text = complaint(command(&folder).code(4));
    assert!(text.contains("view: --out: is no folder"), "{text}");
}
