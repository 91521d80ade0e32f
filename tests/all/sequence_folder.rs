//! A sequence folder for strangers: the loader that ships in it, nerfstudio's conventions, resuming after a kill.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use respire_bench::base::NoProgress;
use respire_bench::formats::png;
use respire_bench::simulate::sequence::{self, Sequence};
use respire_bench::simulate::simulate;

use crate::binary::{outcome, program};
use crate::simulate::{assert_same, case, seal, small};
use crate::skip::skip;

/// A Python with the packages of the loader: `RESPIRE_PYTHON`, or `python3`. Says so when there is none.
pub fn python() -> Option<String> {
    let name = std::env::var("RESPIRE_PYTHON").unwrap_or_else(|_| "python3".into());
    let found = Command::new(&name).args(["-c", "import numpy, PIL, OpenEXR"]).stderr(Stdio::null()).status();
    if found.is_ok_and(|status| status.success()) {
        return Some(name);
    }
    let why = format!("{name} with numpy, pillow and OpenEXR is absent (scripts/python-packages.sh, RESPIRE_PYTHON)");
    skip("python", &why);
    None
}

/// The loader that the film's FORMAT.md holds.
fn loader(film: &Path) -> String {
    let format = fs::read_to_string(film.join(sequence::FORMAT)).unwrap();
    format.split("```python\n").nth(1).unwrap().split("```").next().unwrap().to_owned()
}

fn run_python(python: &str, code: &str, folder: &Path) -> String {
    let (status, out, err) = outcome(Command::new(python).arg("-c").arg(code).arg(folder).output().unwrap());
    assert_eq!(status, 0, "{err}");
    out
}

fn numbers(text: &str) -> Vec<f64> {
    text.split_whitespace().map(|v| v.parse().unwrap_or_else(|_| panic!("`{v}` is no number"))).collect()
}

#[test]
fn the_shipped_loader_reads_what_was_written() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("film");
    let sequence = simulate(&case(), &small(), &out, &NoProgress).unwrap();
    let code = format!(
        "{}
import sys
image, depth, world_from_camera, K, phase = load(sys.argv[1], 4)
normal = exr(sys.argv[1] + '/radiance/000004.exr')
print(image[3, 7, 1], depth[3, 7], depth.astype(float).sum(), phase, *world_from_camera[:3, 3], *world_from_camera[:3, 2])
print(*points(sys.argv[1], 4)[0], normal['G'][5, 6], normal['B'].shape[0])",
        loader(&out)
    );
    let read = numbers(&run_python(&python, &code, &out));
    let (image, depth) = (sequence.image(4).unwrap(), sequence.depth_mm(4).unwrap());
    let frame = sequence.frames[4];
    let pose = frame.world_from_camera;
    let sum: f64 = depth.data.iter().map(|&v| v as f64).sum();
    let ray = sequence.camera.direction(glam::DVec2::new(0.5, 0.5));
    let first = pose.transform_point3(ray * (depth.data[0] as f64 / ray.z));
    let radiance = respire_bench::formats::exr::read(&out.join("radiance/000004.exr")).unwrap();
    let mut expected = vec![image.pixel(7, 3)[1] as f64 / 255.0, depth.pixel(7, 3)[0] as f64, sum, frame.phase];
    expected.extend(pose.translation.to_array());
    expected.extend(pose.matrix3.z_axis.to_array());
    expected.extend(first.to_array());
    expected.extend([radiance.pixel(6, 5)[1] as f64, 32.0]);
    assert_eq!(read.len(), expected.len());
    for (i, (a, b)) in read.iter().zip(&expected).enumerate() {
        assert!((a - b).abs() < 1e-5 * b.abs().max(1.0), "value {i}: {a} for {b}");
    }
}

/// nerfstudio: the camera looks along its -z with y up; an image point is (cx + fl_x x / -z, cy - fl_y y / -z). The
/// mesh's vertices, projected so, must lie on or behind the depth image, and many of them on it.
const REPROJECTION: &str = r#"
import json, sys, numpy as np, struct
folder = sys.argv[1]
t = json.load(open(folder + "/transforms.json"))
def ply(path):
    b = open(path, "rb").read()
    head, body = b.split(b"end_header\n", 1)
    count = int(head.split(b"element vertex ")[1].split()[0])
    kind = "<f8" if b"property double x" in head else "<f4"
    names = [l.split()[-1] for l in head.split(b"element face")[0].split(b"\n") if l.startswith(b"property")]
    return np.frombuffer(body, kind, count * len(names)).reshape(count, -1)[:, :3].astype(float)
rest, other = ply(folder + "/mesh/inspiration.ply"), ply(folder + "/mesh/expiration.ply")
f = t["frames"][4]
p = rest + f["breathing_phase"] * (other - rest)
c = np.c_[p, np.ones(len(p))] @ np.linalg.inv(np.array(f["transform_matrix"])).T
z = -c[:, 2]
u, v = t["cx"] + t["fl_x"] * c[:, 0] / z, t["cy"] - t["fl_y"] * c[:, 1] / z
seen = (z > 0) & (u > 1) & (v > 1) & (u < t["w"] - 1) & (v < t["h"] - 1)
depth = np.fromfile(folder + "/depth.bin", "<f4").reshape(t["h"], t["w"])
d = depth[v[seen].astype(int), u[seen].astype(int)]
# Within a pixel the depth varies; half a pixel's slope is allowed for by the neighbours' range.
pad = np.pad(depth, 1, mode="edge")
around = np.stack([pad[y:y + t["h"], x:x + t["w"]] for y in range(3) for x in range(3)])
low, high = around.min(0)[v[seen].astype(int), u[seen].astype(int)], around.max(0)[v[seen].astype(int), u[seen].astype(int)]
print(seen.sum(), (z[seen] < low - 0.05).sum(), ((z[seen] >= low - 0.05) & (z[seen] <= high + 0.05)).sum())
"#;

#[test]
fn vertices_reproject_onto_the_depth_by_nerfstudios_convention() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("film");
    let sequence = simulate(&case(), &small(), &out, &NoProgress).unwrap();
    let depth: Vec<u8> = sequence.depth_mm(4).unwrap().data.iter().flat_map(|v| v.to_le_bytes()).collect();
    fs::write(out.join("depth.bin"), depth).unwrap();
    let counted = numbers(&run_python(&python, REPROJECTION, &out));
    let [seen, before, on] = counted[..] else { panic!("{counted:?}") };
    assert!(seen > 500.0 && on > 300.0, "{on} of {seen} vertices are on the surface");
    assert!(before <= 0.002 * seen, "{before} of {seen} vertices float before the surface");
    // The same with another sign of y fails: the test can tell.
    let wrong = REPROJECTION.replace("t[\"cy\"] - t[\"fl_y\"]", "t[\"cy\"] + t[\"fl_y\"]");
    let counted = numbers(&run_python(&python, &wrong, &out));
    assert!(counted[1] > 0.02 * counted[0], "{counted:?}");
}

/// What nerfstudio 1.1.5 does with a folder, retold (its parser of this layout, its depth data set, its OpenCV 4.10):
/// poses are centred and scaled until none is further than 1 along any axis; a depth is multiplied by a thousandth (its
/// option, not the file's key), by that scale and by `applied_scale`; OpenCV takes a depth from channel Y, a grey from
/// R, G and B, and nothing from a channel of another name. Prints how far, in mm, points of the wall that follow from
/// these depths are from those that follow from ours; then the same without `applied_scale`, and the depth of a channel
/// Z. (Turning the poses upright, which nerfstudio does too, changes no distance.)
const NERFSTUDIO: &str = r#"
def opencv(channels):
    if "Y" in channels:
        return channels["Y"]
    if all(name in channels for name in "RGB"):
        return 0.299 * channels["R"] + 0.587 * channels["G"] + 0.114 * channels["B"]
    return np.zeros_like(next(iter(channels.values())))

def seen(folder, i, applied_scale):
    t = json.load(open(f"{folder}/transforms.json"))
    poses = np.array([f["transform_matrix"] for f in t["frames"]])
    centre = poses[:, :3, 3].mean(0)
    poses[:, :3, 3] -= centre
    size = 1 / np.abs(poses[:, :3, 3]).max()
    poses[:, :3, 3] *= size
    depth = opencv(exr(f"{folder}/{t['frames'][i]['depth_file_path']}")) * (1e-3 * size * applied_scale)
    v, u = np.mgrid[:t["h"], :t["w"]] + 0.5
    rays = np.stack([(u - t["cx"]) / t["fl_x"], -(v - t["cy"]) / t["fl_y"], -np.ones_like(u)], -1)
    wall = (rays * depth[..., None])[depth > 0] @ poses[i, :3, :3].T + poses[i, :3, 3]
    return wall / size + centre

import sys
folder = sys.argv[1]
ours, scale = points(folder, 4), json.load(open(f"{folder}/transforms.json"))["applied_scale"]
print(np.abs(seen(folder, 4, scale) - ours).max(), np.abs(seen(folder, 4, 1) - ours).max())
print(opencv({"Z": np.ones((2, 2))}).max(), len(ours))
"#;

#[test]
fn nerfstudio_reads_depths_that_fit_its_poses() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("film");
    simulate(&case(), &small(), &out, &NoProgress).unwrap();
    let code = loader(&out) + NERFSTUDIO;
    let read = numbers(&run_python(&python, &code, &out));
    let [off_mm, unscaled_mm, z, pixels] = read[..] else { panic!("{read:?}") };
    assert!(off_mm < 1e-3 && pixels > 900.0, "nerfstudio sees the wall {off_mm} mm off, in {pixels} pixels");
    assert!(unscaled_mm > 5.0 && z == 0.0, "the test can tell: {unscaled_mm} mm without the scale, {z} from channel Z");
}

/// Every number of a film's files has a range, also where the hash in the manifest is right.
#[test]
fn numbers_out_of_range_are_refused_by_file_and_key() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("film");
    let case = case().on_clinical_track();
    simulate(&case, &small(), &out, &NoProgress).unwrap();
    let change = |name: &str, edit: &dyn Fn(&mut serde_json::Value)| {
        let path = out.join(name);
        let whole = fs::read(&path).unwrap();
        let mut value = serde_json::from_slice(&whole).unwrap();
        edit(&mut value);
        fs::write(&path, serde_json::to_vec(&value).unwrap()).unwrap();
        (path, whole)
    };
    let said = |name: &str, edit: &dyn Fn(&mut serde_json::Value)| {
        let manifest = fs::read(out.join(sequence::MANIFEST)).unwrap();
        let (path, whole) = change(name, edit);
        seal(&out);
        let said = Sequence::open(&out).unwrap_err().to_string();
        fs::write(path, whole).unwrap();
        fs::write(out.join(sequence::MANIFEST), manifest).unwrap();
        assert!(said.contains(name), "{said}");
        said
    };
    for period in [1e-300, 0.0, -4.0, 1e300] {
        let sentence = said(sequence::MANIFEST, &|manifest| manifest["breathing_period_s"] = period.into());
        assert!(sentence.contains("breathing_period_s: ") && sentence.contains("must lie in"), "{sentence}");
    }
    for name in [sequence::TRANSFORMS, sequence::TOLD_TRANSFORMS] {
        let sentence = said(name, &|film| film["frames"][2]["transform_matrix"][1][3] = 1e6.into());
        assert!(sentence.contains("frame 2: transform_matrix lies too far away: 1000000 must lie"), "{sentence}");
        let sentence = said(name, &|film| film["frames"][2]["time"] = 0.0.into());
        assert!(sentence.contains("frame 2: time: 0 does not come after"), "{sentence}");
        assert!(said(name, &|film| film["fl_x"] = 1e-300.into()).contains("fl_x: 1e-300 must lie"));
    }
    let sentence = said(sequence::TOLD_TRANSFORMS, &|film| film["w"] = 99.into());
    assert!(sentence.contains("is 99x"), "{sentence}");
    assert!(Sequence::open(&out).is_ok());
    let path = out.join(sequence::TARGETS_BY_FRAME);
    let places = fs::read_to_string(&path).unwrap();
    for (from, to) in
        [("x_mm,y_mm", "y_mm,x_mm"), ("\n0,0,", "\n0,0,n/a,"), ("\n0,0,", "\n0,0,1e200,"), ("\n0,1,", "\n0,2,")]
    {
        fs::write(&path, places.replacen(from, to, 1)).unwrap();
        seal(&out);
        let opened = Sequence::open(&out);
        if from == "x_mm,y_mm" {
            // Columns are what their names say.
            let (first, line) = (opened.unwrap().target_mm(0, 0), places.lines().nth(1).unwrap().to_owned());
            let told: Vec<f64> = line.split(',').map(|v| v.parse().unwrap()).collect();
            assert_eq!(first.to_array(), [told[3], told[2], told[4]]);
        } else {
            let sentence = opened.unwrap_err().to_string();
            assert!(sentence.contains("targets_by_frame.csv: line "), "{sentence}");
        }
    }
}

#[test]
fn a_killed_film_is_resumed_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let (whole, killed) = (folder.path().join("whole"), folder.path().join("killed"));
    let command = |out: &Path| {
        let mut command = program();
        command.args(["simulate", "case1", "--profile", "smoke", "--frames", "10", "--width", "48", "--spp", "4"]);
        command.args(["--truth", "motion,normals", "--out"]).arg(out);
        command
    };
    let (code, _, err) = outcome(command(&whole).output().unwrap());
    assert_eq!(code, 0, "{err}");
    let mut kills = 0;
    for wanted in [1, 4, 7] {
        let mut child = command(&killed).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let image = killed.join("case1").join(sequence::image_name(wanted));
        while !image.is_file() && child.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(1));
        }
        if child.try_wait().unwrap().is_none() {
            child.kill().unwrap();
            kills += 1;
        }
        child.wait().unwrap();
    }
    assert!(kills >= 2, "the film was finished before it could be killed");
    let (code, _, err) = outcome(command(&killed).output().unwrap());
    assert_eq!(code, 0, "{err}");
    assert_same(&whole.join("case1"), &killed.join("case1"));
}

#[test]
fn previews_show_the_film() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("film");
    let sequence: Sequence = simulate(&case(), &small(), &out, &NoProgress).unwrap();
    let sheet = png::read_rgb(&out.join(sequence::CONTACT_SHEET)).unwrap();
    assert_eq!((sheet.width, sheet.height), (6 * 34 - 2, 32));
    let third = sequence.image(3).unwrap();
    assert_eq!(sheet.pixel(3 * 34 + 9, 20), third.pixel(9, 20));
    let first = png::read_rgb(&out.join(sequence::PREVIEW)).unwrap();
    assert_eq!(first, sequence.image(0).unwrap());
}
