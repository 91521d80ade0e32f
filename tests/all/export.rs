//! `export`: each layout is opened by the other's own loader (pycolmap, trimesh) or by its rules, retold from its
//! source with version and name; and what comes out is where the film has it.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use glam::{DAffine3, DVec2, DVec3};
use respire_bench::airway::case::{Case, ScopeSettings};
use respire_bench::base::{Camera, NoProgress, TriangleMesh, mesh};
use respire_bench::formats::transforms::Transforms;
use respire_bench::formats::{glb, npy};
use respire_bench::simulate::export::{ExportFormat, ExportSettings, ExportedTruth, PoseAxes, export};
use respire_bench::simulate::participant::Given;
use respire_bench::simulate::sequence::Sequence;
use respire_bench::simulate::{MeshOutput, RadianceOutput, SimulationSettings, participant, simulate};

use crate::binary::{outcome, run};
use crate::sequence_folder::python;
use crate::shared;
use crate::simulate::{case, contents, off_surface, small};
use crate::skip::skip;
use crate::third_parties::{accepted, copy, refused};

/// The frame whose points are looked at.
const FRAME: usize = 4;

/// A film, which other tests look at too, and a place for its exports.
struct Filmed {
    folder: tempfile::TempDir,
    film: Sequence,
}

impl Filmed {
    fn of(name: &str, case: &Case) -> Filmed {
        let settings = SimulationSettings {
            width_px: 48,
            height_px: 32,
            frames: 9,
            meshes: MeshOutput::EndStates,
            radiance: RadianceOutput::None,
            ..small()
        };
        let made = shared::folder(&format!("filmed-{name}"), |folder| {
            simulate(case, &settings, &folder.join("film"), &NoProgress).unwrap();
        });
        Filmed { folder: tempfile::tempdir().unwrap(), film: Sequence::open(&made.join("film")).unwrap() }
    }

    fn pinhole() -> Filmed {
        let mut case = case();
        case.scope = ScopeSettings { mask_radius: 0.95, ..case.scope };
        Filmed::of("pinhole", &case)
    }

    fn fisheye() -> Filmed {
        let mut case = case();
        case.camera.fisheye = Some([-0.03, 0.002, 0.0, 0.0]);
        Filmed::of("fisheye", &case)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The layout in the folder `name`.
    fn export(&self, name: &str, settings: ExportSettings) -> PathBuf {
        let out = self.path(name);
        export(&self.film.root, &settings, &out, &NoProgress).unwrap();
        out
    }

    /// The wall as it was at [`FRAME`].
    fn wall(&self) -> TriangleMesh {
        let (rest, moved) = (self.film.inspiration().unwrap(), self.film.expiration().unwrap());
        let vertices = mesh::interpolate(&rest.vertices, &moved.vertices, self.film.frames[FRAME].phase);
        TriangleMesh { vertices, faces: rest.faces }
    }

    /// Distances in mm from the wall of points that a loader prints, x y z each, in units of which `scale` are one mm.
    fn off_wall(&self, printed: &str, scale: f64) -> Vec<f64> {
        let values: Vec<f64> = printed.split_whitespace().map(|v| v.parse().unwrap()).collect();
        assert!(values.len() > 60, "{printed}");
        let wall = self.wall();
        values.chunks(3).map(|p| off_surface(&wall, DVec3::new(p[0], p[1], p[2]) / scale)).collect()
    }
}

const HIDDEN: ExportSettings =
    ExportSettings { format: ExportFormat::Colmap, truth: ExportedTruth::Hidden, scale: None, axes: PoseAxes::OpenGl };

fn of(format: ExportFormat) -> ExportSettings {
    ExportSettings { format, ..HIDDEN }
}

fn shown(format: ExportFormat) -> ExportSettings {
    ExportSettings { truth: ExportedTruth::Shown, ..of(format) }
}

fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

fn run_python(python: &str, code: &str, folder: &Path) -> String {
    let code = format!("import sys, json, glob, os, numpy as np\nfrom PIL import Image\nfolder = sys.argv[1]\n{code}");
    let (status, out, err) = outcome(Command::new(python).args(["-c", &code]).arg(folder).output().unwrap());
    assert_eq!(status, 0, "{err}");
    out
}

/// A Python that has `module` too. Says so where there is none.
fn python_with(module: &str) -> Option<String> {
    let python = python()?;
    let found = Command::new(&python).args(["-c", &format!("import {module}")]).stderr(Stdio::null()).status();
    if found.is_ok_and(|status| status.success()) {
        return Some(python);
    }
    skip("python", &format!("{python} has no {module} (scripts/python-packages.sh, RESPIRE_PYTHON)"));
    None
}

/// nerfstudio 1.1.5, `data/dataparsers/nerfstudio_dataparser.py` and `data/utils/data_utils.py`, retold: frames sorted
/// by name; masks and depths of all frames or none; the three lists of names, each known; poses centred and scaled to
/// one; points of `ply_file_path` transformed like the poses and multiplied by the same scale times `applied_scale`;
/// depth times 0.001 and that scale; one-channel masks. Prints points of frame 4, in the file's unit again.
const NERFSTUDIO: &str = r##"
meta = json.load(open(f"{folder}/transforms.json"))
frames = sorted(meta["frames"], key=lambda f: f["file_path"])
names = [f["file_path"] for f in frames]
masks = [f["mask_path"] for f in frames if "mask_path" in f]
depths = [f["depth_file_path"] for f in frames if "depth_file_path" in f]
assert len(masks) in (0, len(names)) and len(depths) == len(names)
for split, count in (("train", len(names) - 1), ("val", 1), ("test", 1)):
    chosen = set(meta[f"{split}_filenames"])
    assert chosen <= set(names) and len(chosen) == count, split
assert meta["test_filenames"] == ["images/000007.png"]
mask = np.array(Image.open(f"{folder}/{masks[4]}"))
assert mask.ndim == 2 and Image.open(f"{folder}/{names[4]}").size == (meta["w"], meta["h"])

poses = np.array([f["transform_matrix"] for f in frames])
centre = poses[:, :3, 3].mean(0)
poses[:, :3, 3] -= centre
scale = 1 / np.abs(poses[:, :3, 3]).max()
poses[:, :3, 3] *= scale
scale *= meta.get("applied_scale", 1.0)
head, body = open(f"{folder}/{meta['ply_file_path']}", "rb").read().split(b"end_header\n", 1)
kinds = {b"float": "<f4", b"uchar": "u1"}
fields = [l.split()[1:] for l in head.split(b"\n") if l.startswith(b"property")]
ply = np.frombuffer(body, np.dtype([(name.decode(), kinds[kind]) for kind, name in fields]))
cloud = (np.stack([ply["x"], ply["y"], ply["z"]], -1) - centre) * scale

depth = np.load(f"{folder}/{depths[4]}").astype(np.float32) * (1e-3 * scale)
v, u = np.mgrid[:meta["h"], :meta["w"]] + 0.5
rays = np.stack([(u - meta["cx"]) / meta["fl_x"], -(v - meta["cy"]) / meta["fl_y"], -np.ones_like(u)], -1)
wall = (rays * depth[..., None])[mask.astype(bool) & (depth > 0)] @ poses[4, :3, :3].T + poses[4, :3, 3]
# The cloud lies where the wall lies: the nearest vertex is as near as an edge is long (mm in the file).
unit = float(os.environ.get("UNIT", "1"))
near = [np.sqrt(((cloud - p) ** 2).sum(1).min()) / scale / unit for p in wall[::9]]
print(max(near), len(cloud))
for p in wall[::9]:
    print(*(p / scale + centre))
"##;

#[test]
fn nerfstudio_reads_splits_masks_depth_and_points() {
    let Some(python) = python() else { return };
    let place = Filmed::pinhole();
    for (name, scale) in [("mm", None), ("metres", Some(1e-3))] {
        let out = place.export(name, ExportSettings { scale, ..shown(ExportFormat::Nerfstudio) });
        let unit = scale.unwrap_or(1.0);
        let code = format!("os.environ['UNIT'] = '{unit}'\n{NERFSTUDIO}");
        let printed = run_python(&python, &code, &out);
        let (first, points) = printed.split_once('\n').unwrap();
        let [near_mm, vertices] = first.split(' ').map(|v| v.parse::<f64>().unwrap()).collect::<Vec<_>>()[..] else {
            panic!("{first}")
        };
        assert_eq!(vertices as usize, place.film.inspiration().unwrap().vertices.len());
        // The cloud is the wall at inspiration, and vertices are some mm apart.
        let (rest, moved) = (place.film.inspiration().unwrap(), place.film.expiration().unwrap());
        let shifts = rest.vertices.iter().zip(&moved.vertices).map(|(a, b)| a.distance(*b));
        let most_mm = shifts.fold(0.0, f64::max) * place.film.frames[FRAME].phase + 3.0;
        assert!(near_mm < most_mm, "the cloud is {near_mm} mm from the wall, which moved by {most_mm}");
        let off = place.off_wall(points, unit);
        assert!(largest(&off) < 0.02, "{name}: {} mm off the wall", largest(&off));
        // The test can tell: OpenCV's axes in place of OpenGL's.
        let printed = run_python(&python, &code.replace("-np.ones_like(u)", "np.ones_like(u)"), &out);
        assert!(largest(&place.off_wall(printed.split_once('\n').unwrap().1, unit)) > 1.0);
    }
    // Without truth there is no depth at all: that of the first frame alone would be refused.
    let out = place.export("blind", of(ExportFormat::Nerfstudio));
    let text = fs::read_to_string(out.join("transforms.json")).unwrap();
    assert!(!text.contains("depth_file_path") && !text.contains("breathing_phase") && !out.join("depth").exists());
}

/// nerfstudio 1.1.5, `data/dataparsers/dnerf_dataparser.py`, retold; 4DGaussians and Deformable-3D-Gaussians read the
/// same keys. Prints the focal length, the number of frames, and the times of train and test.
const DNERF: &str = r##"
for split in ("train", "val", "test"):
    meta = json.load(open(f"{folder}/transforms_{split}.json"))
    images = [Image.open(f"{folder}/" + f["file_path"].replace("./", "") + ".png") for f in meta["frames"]]
    width = images[0].size[0]
    print(0.5 * width / np.tan(0.5 * float(meta["camera_angle_x"])), *[f["time"] for f in meta["frames"]])
    assert all(np.array(f["transform_matrix"]).shape == (4, 4) for f in meta["frames"])
"##;

#[test]
fn dnerf_reads_the_splits_where_the_camera_allows_it() {
    let Some(python) = python() else { return };
    let place = Filmed::pinhole();
    let out = place.export("dnerf", of(ExportFormat::Nerfstudio));
    let printed = run_python(&python, DNERF, &out);
    let lines: Vec<Vec<f64>> =
        printed.lines().map(|line| line.split(' ').map(|v| v.parse().unwrap()).collect()).collect();
    assert!(lines.iter().all(|line| (line[0] - place.film.camera.fl_x).abs() < 1e-9), "{printed}");
    assert_eq!((lines[0].len(), lines[1].clone(), lines[2].len()), (9, lines[2].clone(), 2));
    assert_eq!((lines[0][1], lines[0][8], lines[1][1]), (0.0, 1.0, 7.0 / 8.0));
    let place = Filmed::fisheye();
    let fisheye = place.export("fisheye", of(ExportFormat::Nerfstudio));
    assert!(fisheye.join("transforms.json").exists() && !fisheye.join("transforms_train.json").exists());
}

/// EndoGaussian (`scene/endo_loader.py`, 0ac413c: FLIP = 1) and Deform3DGS (the same file, 02be2db: FLIP = -1) retold:
/// 640 x 512; equal counts of images, depths, masks and poses; depth clipped to percentiles (left out here); points of
/// the masked pixels by pixel centres at integers + SHIFT (theirs is 0). Prints points of frame 4.
const ENDONERF: &str = r##"
W, H = 640, 512
poses_arr = np.load(os.path.join(folder, "poses_bounds.npy"))
poses = poses_arr[:, :-2].reshape([-1, 3, 5])
height, width, focal = poses[0, :, -1]
assert (height, width) == (H, W)
poses = np.concatenate([poses[..., :1], FLIP * poses[..., 1:2], FLIP * poses[..., 2:3], poses[..., 3:4]], -1)
paths = {kind: sorted(glob.glob(os.path.join(folder, kind, "*.png"))) for kind in ("images", "depth", "masks")}
assert all(len(p) == len(poses) for p in paths.values())
color = np.array(Image.open(paths["images"][4])) / 255.0
depth = np.array(Image.open(paths["depth"][4]))
assert depth.dtype == np.uint16 or depth.dtype == np.int32, depth.dtype
mask = 1 - np.array(Image.open(paths["masks"][4])) / 255.0
assert color.shape == (H, W, 3) and depth.shape == (H, W) and mask.shape == (H, W)
near, far = poses_arr[4, -2:]
kept = depth[mask > 0]
assert kept.min() == near and kept.max() == far and near > 0
i, j = np.meshgrid(np.linspace(0, W - 1, W), np.linspace(0, H - 1, H))
X, Y = (i + SHIFT - W / 2) / focal * depth, (j + SHIFT - H / 2) / focal * depth
pts = np.stack((X, Y, depth), axis=-1).reshape(-1, 3)[mask.reshape(-1).astype(bool)]
c2w = np.concatenate((poses[4], np.array([[0, 0, 0, 1]])), axis=0)
c2w = np.linalg.inv(np.linalg.inv(c2w))
pts = (np.concatenate((pts, np.ones((len(pts), 1))), -1) @ c2w.T)[:, :3]
for p in pts[::9]:
    print(*p)
"##;

#[test]
fn endonerf_loaders_lift_its_depth_onto_the_wall() {
    let Some(python) = python() else { return };
    let place = Filmed::pinhole();
    let code = |flip: i32, shift: f64| ENDONERF.replace("FLIP", &flip.to_string()).replace("SHIFT", &shift.to_string());
    for (name, axes, flip) in [("opengl", PoseAxes::OpenGl, -1), ("opencv", PoseAxes::OpenCv, 1)] {
        let out = place.export(name, ExportSettings { axes, ..shown(ExportFormat::Endonerf) });
        // Codes are tenths of a millimetre; single floats hold the poses.
        let off = place.off_wall(&run_python(&python, &code(flip, 0.5), &out), 10.0);
        assert!(largest(&off) < 0.1, "{name}: {} mm", largest(&off));
        // As their loaders do it, half a pixel beside.
        let off = place.off_wall(&run_python(&python, &code(flip, 0.0), &out), 10.0);
        assert!(largest(&off) < 3.0, "{name}: {} mm", largest(&off));
        // The other's axes: the test can tell.
        let off = place.off_wall(&run_python(&python, &code(-flip, 0.5), &out), 10.0);
        assert!(largest(&off) > 1.0, "{name}: {} mm", largest(&off));
    }
    let fisheye = Filmed::fisheye();
    let settings = shown(ExportFormat::Endonerf);
    let refused = export(&fisheye.film.root, &settings, &fisheye.path("no"), &NoProgress).unwrap_err().to_string();
    assert!(refused.contains("pinholes alone") && !fisheye.path("no").exists(), "{refused}");
}

/// DurrLab/C3VD, `python/exampleDataLoader.py` (c7f97d1), retold: Scaramuzza's rays at integer pixels; codes of 65535
/// to 100 mm, 0 and 65535 no depth; z-depth; a pose is a line between commas, applied to rows from the right. And
/// EndoGSLAM's reading of a pose (`datasets/gradslam_datasets/c3vd.py`, fe73968): the transpose. Prints points of frame
/// 4.
const C3VD: &str = r##"
names, values = [line.split() for line in open(f"{folder}/camera_intrinsics.txt")]
k = {name: float(value) for name, value in zip(names, values)}
ix, iy = np.meshgrid(np.arange(k["width"]), np.arange(k["height"]))
stretch = np.linalg.inv(np.array([[k["c"], k["d"]], [k["e"], 1.0]]))
uv = np.einsum("ij,...j->...i", stretch, np.stack([ix - k["cx"], iy - k["cy"]], -1))
rho = np.hypot(uv[..., 0], uv[..., 1])
z = k["a0"] + k["a2"] * rho**2 + k["a3"] * rho**3 + k["a4"] * rho**4
image = Image.open(f"{folder}/0004_depth.tiff")
depth = np.array(image)
assert image.size == Image.open(f"{folder}/0004_color.png").size and depth.max() > 255, depth.dtype
depth = np.where((depth == 0) | (depth == 2**16 - 1), np.nan, depth).astype(np.float64) / (2**16 - 1) * 100
points = np.stack([depth * uv[..., 0] / z, depth * uv[..., 1] / z, depth], -1).reshape(-1, 3)
poses = [np.array([float(v) for v in line.strip().split(",")]).reshape(4, 4) for line in open(f"{folder}/pose.txt")]
assert len(poses) == 9 and np.allclose(poses[4].T[3], [0, 0, 0, 1])
world = (np.hstack([points, np.ones((len(points), 1))]) @ poses[4])[:, :3]
for p in world[~np.isnan(world).any(1)][::9]:
    print(*p)
"##;

#[test]
fn c3vd_loaders_lift_its_depth_onto_the_wall() {
    let Some(python) = python() else { return };
    for (place, most_mm) in [(Filmed::pinhole(), 0.02), (Filmed::fisheye(), 0.1)] {
        let out = place.export("c3vd", shown(ExportFormat::C3vd));
        let off = place.off_wall(&run_python(&python, C3VD, &out), 1.0);
        assert!(largest(&off) < most_mm, "{} mm", largest(&off));
        let off = place.off_wall(&run_python(&python, &C3VD.replace("@ poses[4]", "@ poses[4].T"), &out), 1.0);
        assert!(largest(&off) > 1.0, "the test can tell: {} mm", largest(&off));
    }
}

/// What methods are told of a clinical film is off by millimetres; with its truth goes out what fits the depth.
#[test]
fn a_clinical_films_depth_lies_on_its_wall_with_the_truth_and_is_told_without() {
    let place = Filmed::of("clinical", &case().on_clinical_track());
    let out = place.export("shown", shown(ExportFormat::Nerfstudio));
    let cameras = Transforms::read(&out.join("transforms.json")).unwrap();
    let last = cameras.frames.len() - 1;
    let wall = place.film.last_surface().unwrap().unwrap();
    let depth = npy::read_plane(&out.join(format!("depth/{last:06}.npy"))).unwrap();
    let largest_off = |camera: &Camera, pose: DAffine3| {
        let lifted = |(pixel, &depth): (usize, &f32)| {
            let (x, y) = (pixel % 48, pixel / 48);
            let ray = camera.direction(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
            let seen = ray * (f64::from(depth) * 1e-3 / ray.z);
            (depth > 0.0).then(|| off_surface(&wall, pose.transform_point3(seen)))
        };
        let off: Vec<f64> = depth.data.iter().enumerate().step_by(7).filter_map(lifted).collect();
        assert!(off.len() > 30);
        largest(&off)
    };
    let exported = largest_off(&cameras.camera().unwrap(), cameras.frames[last].world_from_camera());
    assert!(exported < 0.02, "{exported} mm");
    let told = place.film.given_frames()[last].world_from_camera;
    assert!(largest_off(&place.film.given_camera(), told) > 0.2, "the test can tell");
    let about = |folder: &Path| fs::read_to_string(folder.join("EXPORT.md")).unwrap();
    assert!(about(&out).contains("clinical track") && about(&out).contains("true ones"));

    let out = place.export("told", of(ExportFormat::Nerfstudio));
    let cameras = Transforms::read(&out.join("transforms.json")).unwrap();
    assert_eq!(cameras.camera().unwrap(), place.film.given_camera());
    assert!(cameras.frames[last].world_from_camera().abs_diff_eq(told, 1e-12));
    assert!(about(&out).contains("that a method is told"));

    for (name, settings, wanted) in [
        ("tum-told", of(ExportFormat::Tum), told),
        ("tum-shown", shown(ExportFormat::Tum), place.film.frames[last].world_from_camera),
    ] {
        let trajectory = fs::read_to_string(place.export(name, settings).join("trajectory.txt")).unwrap();
        let numbers: Vec<f64> =
            trajectory.lines().next_back().unwrap().split(' ').map(|number| number.parse().unwrap()).collect();
        assert!(DVec3::new(numbers[1], numbers[2], numbers[3]).distance(wanted.translation) < 1e-5, "{name}");
    }
    place.export("colmap-shown", shown(ExportFormat::Colmap));

    let surfaces = place.export("glb", shown(ExportFormat::Glb));
    let (rest, moved) = (place.film.inspiration().unwrap(), place.film.expiration().unwrap());
    let wanted = glb::breathing(&rest, &moved, place.film.given_period_s()).unwrap();
    assert!(fs::read(surfaces.join("airway.glb")).unwrap() == wanted);
    let ideal = Filmed::pinhole();
    assert!(!about(&ideal.export("ideal", shown(ExportFormat::Nerfstudio))).contains("clinical"));
}

/// COLMAP's text by the rules of nerfstudio 1.1.5 (`data/utils/colmap_parsing_utils.py`), which are COLMAP's own: two
/// lines per image, quaternion w x y z, world to camera. Prints where the first points are seen in image 5.
const COLMAP_TEXT: &str = r##"
lines = [l for l in open(f"{folder}/sparse/0/images.txt") if not l.startswith("#")]
assert len(lines) == 18 and all(l.strip() == "" for l in lines[1::2])
words = lines[8].split()
(w, x, y, z), t = map(float, words[1:5]), np.array(list(map(float, words[5:8])))
R = np.array([[1 - 2*y*y - 2*z*z, 2*x*y - 2*w*z, 2*z*x + 2*w*y],
              [2*x*y + 2*w*z, 1 - 2*x*x - 2*z*z, 2*y*z - 2*w*x],
              [2*z*x - 2*w*y, 2*y*z + 2*w*x, 1 - 2*x*x - 2*y*y]])
assert words[8:] == ["1", "000004.png"] and os.path.exists(f"{folder}/images/{words[9]}")
camera = [l.split() for l in open(f"{folder}/sparse/0/cameras.txt") if not l.startswith("#")]
assert len(camera) == 1 and camera[0][1] == "PINHOLE"
fx, fy, cx, cy = map(float, camera[0][4:])
rows = [l.split() for l in open(f"{folder}/sparse/0/points3D.txt") if not l.startswith("#")]
assert all(len(row) == 8 for row in rows)
lists = [open(f"{folder}/{split}_list.txt").read().split() for split in ("train", "val", "test")]
assert lists[1] == lists[2] == ["000007.png"] and len(lists[0]) == 8
seen = np.array([list(map(float, row[1:4])) for row in rows]) @ R.T + t
print(*[v for p in seen for v in (fx * p[0] / p[2] + cx, fy * p[1] / p[2] + cy)])
"##;

/// The same by pycolmap, from the binary files (which it prefers) or, without them, from the text.
const PYCOLMAP: &str = r##"
import pycolmap
if TEXT:
    for name in ("cameras", "images", "points3D"):
        os.remove(f"{folder}/sparse/0/{name}.bin")
model = pycolmap.Reconstruction(f"{folder}/sparse/0")
assert len(model.images) == 9 and len(model.cameras) == 1
image = model.images[5]
assert image.name == "000004.png"
camera = model.cameras[image.camera_id]
pose = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world
points = np.array([model.points3D[k].xyz for k in sorted(model.points3D)])
seen = points @ pose.rotation.matrix().T + pose.translation
for p in seen:
    pixel = camera.img_from_cam(p)
    print(*(pixel if pixel is not None else (np.nan, np.nan)))
"##;

/// Pixels in which [`FRAME`] of the film sees the vertices at inspiration; `None` behind the camera.
fn projected(film: &Sequence) -> Vec<Option<DVec2>> {
    let camera_from_world = film.frames[FRAME].world_from_camera.inverse();
    let seen = |v: &DVec3| {
        let p = camera_from_world.transform_point3(*v);
        if p.z > 0.0 { film.camera.project(p) } else { None }
    };
    film.inspiration().unwrap().vertices.iter().map(seen).collect()
}

/// The largest distance in pixels of what a loader prints from where the film's camera sees the vertices.
fn furthest_px(film: &Sequence, printed: &str) -> f64 {
    let values: Vec<f64> = printed.split_whitespace().map(|v| v.parse().unwrap()).collect();
    let ours = projected(film);
    assert_eq!(values.len(), 2 * ours.len());
    let pairs = ours.iter().zip(values.chunks(2)).filter_map(|(ours, theirs)| Some(((*ours)?, theirs)));
    // Within the image, near enough to its border.
    let pairs: Vec<f64> = pairs
        .filter(|(ours, _)| (ours.x - 24.0).abs() < 30.0 && (ours.y - 16.0).abs() < 20.0)
        .map(|(ours, theirs)| ours.distance(DVec2::new(theirs[0], theirs[1])))
        .collect();
    assert!(pairs.len() > 100, "{} vertices in the picture", pairs.len());
    if pairs.iter().any(|d| d.is_nan()) { f64::NAN } else { largest(&pairs) }
}

#[test]
fn colmap_models_see_the_mesh_where_the_film_does() {
    let Some(python) = python() else { return };
    let place = Filmed::pinhole();
    let out = place.export("colmap", of(ExportFormat::Colmap));
    let off = furthest_px(&place.film, &run_python(&python, COLMAP_TEXT, &out));
    assert!(off < 1e-6, "{off} px");
    let off = furthest_px(&place.film, &run_python(&python, &COLMAP_TEXT.replace("R.T + t", "R + t"), &out));
    assert!(off > 1.0, "the test can tell: {off} px");
    // Brush takes any .ply for the points; masks are where it and nerfstudio look for them.
    let names: BTreeSet<String> = contents(&out).into_keys().collect();
    assert!(!names.iter().any(|name| name.ends_with(".ply")) && names.contains("masks/000004.png"));
    // Metres: poses and points are scaled alike.
    let settings = ExportSettings { scale: Some(1e-3), ..of(ExportFormat::Colmap) };
    let off = furthest_px(&place.film, &run_python(&python, COLMAP_TEXT, &place.export("metres", settings)));
    assert!(off < 1e-6, "{off} px");
}

#[test]
fn pycolmap_opens_text_and_binary() {
    let Some(python) = python_with("pycolmap") else { return };
    for (place, most_px) in [(Filmed::pinhole(), 1e-6), (Filmed::fisheye(), 1e-4)] {
        let out = place.export("colmap", of(ExportFormat::Colmap));
        for text in ["False", "True"] {
            let off = furthest_px(&place.film, &run_python(&python, &PYCOLMAP.replace("TEXT", text), &out));
            assert!(off < most_px, "text {text}: {off} px");
        }
    }
}

/// evo 1.38.1, `tools/file_interface.py`, retold: lines without `#`, split at single blanks, eight numbers each; the
/// quaternion's w is last. Prints time, place and the camera's z axis of frame 4.
const EVO: &str = r##"
import csv
rows = list(csv.reader((l for l in open(f"{folder}/trajectory.txt") if not l.startswith("#")), delimiter=" "))
assert len(rows) == 9 and all(len(row) == 8 for row in rows)
t, *xyz, x, y, z, w = map(float, rows[4])
assert abs(x*x + y*y + z*z + w*w - 1) < 1e-9
print(t, *xyz, 2*z*x + 2*w*y, 2*y*z - 2*w*x, 1 - 2*x*x - 2*y*y)
"##;

#[test]
fn evo_reads_the_trajectory() {
    let Some(python) = python() else { return };
    let place = Filmed::pinhole();
    let out = place.export("tum", ExportSettings { scale: Some(1e-3), ..of(ExportFormat::Tum) });
    let read: Vec<f64> = run_python(&python, EVO, &out).split_whitespace().map(|v| v.parse().unwrap()).collect();
    let (frame, pose) = (place.film.frames[FRAME], place.film.frames[FRAME].world_from_camera);
    let mut wanted = vec![frame.time_s];
    wanted.extend((pose.translation * 1e-3).to_array());
    wanted.extend(pose.matrix3.z_axis.to_array());
    assert_eq!(read.len(), wanted.len());
    assert!(read.iter().zip(&wanted).all(|(a, b)| (a - b).abs() < 1e-9), "{read:?} {wanted:?}");
}

/// glTF 2.0 by its specification, and trimesh beside it. Prints vertices, faces, furthest shift in mm, height in metres
/// and, from trimesh, vertices and height in metres of the scene.
const GLTF: &str = r##"
import struct, trimesh
data = open(f"{folder}/airway.glb", "rb").read()
magic, version, length = struct.unpack("<4sII", data[:12])
assert magic == b"glTF" and version == 2 and length == len(data)
size = struct.unpack("<I", data[12:16])[0]
doc, binary = json.loads(data[20:20 + size]), data[28 + size:]
def accessor(index):
    a = doc["accessors"][index]
    view = doc["bufferViews"][a["bufferView"]]
    kind, width = {5126: "<f4", 5125: "<u4"}[a["componentType"]], {"VEC3": 3, "SCALAR": 1}[a["type"]]
    values = np.frombuffer(binary, kind, a["count"] * width, view["byteOffset"]).reshape(-1, width)
    if "min" in a:
        assert (values.min(0) == a["min"]).all() and (values.max(0) == a["max"]).all()
    return values
(mesh,) = doc["meshes"]
(primitive,) = mesh["primitives"]
position, (target,) = accessor(primitive["attributes"]["POSITION"]), primitive["targets"]
shift, faces = accessor(target["POSITION"]), accessor(primitive["indices"]).reshape(-1, 3)
assert shift.shape == position.shape and faces.max() < len(position) and mesh["weights"] == [0.0]
assert mesh["extras"]["targetNames"] == ["expiration"] and len(doc["animations"]) == 1
scene = trimesh.load(f"{folder}/airway.glb", process=False, force="scene")
(geometry,) = scene.geometry.values()
print(len(position), len(faces), np.linalg.norm(shift, axis=1).max(), np.ptp(position[:, 2]) * 1e-3,
      len(geometry.vertices), np.ptp(scene.bounds[:, 1]))
"##;

#[test]
fn the_surface_has_one_morph_target_and_stands_upright_in_metres() {
    let Some(python) = python_with("trimesh") else { return };
    let place = Filmed::pinhole();
    let out = place.export("glb", of(ExportFormat::Glb));
    let read: Vec<f64> = run_python(&python, GLTF, &out).split_whitespace().map(|v| v.parse().unwrap()).collect();
    let (rest, moved) = (place.film.inspiration().unwrap(), place.film.registered_expiration().unwrap());
    let furthest = rest.vertices.iter().zip(&moved.vertices).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
    let (low, high) = rest.bounds();
    let height_m = (high.z - low.z) * 1e-3;
    let wanted =
        [rest.vertices.len() as f64, rest.faces.len() as f64, furthest, height_m, rest.vertices.len() as f64, height_m];
    assert!(read.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-5 * b), "{read:?} {wanted:?}");
    assert!(furthest > 1.0, "the wall moves by {furthest} mm");
}

#[test]
fn nothing_of_the_truth_goes_out_unasked_and_a_participants_folder_will_do() {
    let place = Filmed::pinhole();
    let blind = place.path("participant");
    participant::write(&place.film, &blind).unwrap();
    for format in [ExportFormat::Colmap, ExportFormat::Nerfstudio, ExportFormat::Tum, ExportFormat::Glb] {
        let name = format!("{format:?}");
        let from_film = place.export(&name, of(format));
        let from_blind = place.path(&format!("{name}-blind"));
        export(&blind, &of(format), &from_blind, &NoProgress).unwrap();
        let (a, b) = (contents(&from_film), contents(&from_blind));
        assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
        // What the film gives out is what participants have: no number of it comes from anywhere else.
        assert!(a == b, "{name}: the exports of the film and of the participant's folder differ");
        assert!(a.contains_key("EXPORT.md"));
    }
    let text = |path: &Path| path.to_str().unwrap().to_owned();
    let command = |film: &Path, words: &[&str]| {
        let (film, out) = (text(film), text(&place.path("out")));
        run(&[&["export", &film, "--out", &out][..], words].concat())
    };
    for format in ["endonerf", "c3vd"] {
        refused(command(&place.film.root, &["--format", format]), 2, &["depth of every frame", "--truth"]);
    }
    refused(command(&blind, &["--format", "c3vd", "--truth"]), 4, &["participant", "holds no truth"]);
    refused(command(&place.film.root, &["--format", "tum", "--truth"]), 2, &["nothing else that is true"]);
    refused(command(&place.film.root, &["--format", "glb", "--scale", "2"]), 2, &["--scale", "metres"]);
    refused(command(&place.film.root, &["--format", "tum", "--axes", "opencv"]), 2, &["--axes"]);
    refused(command(&place.path("nowhere"), &["--format", "tum"]), 4, &["nowhere", "no such folder"]);
    // All or nothing, and nothing is overwritten.
    let damaged = place.path("damaged");
    copy(&place.film.root, &damaged);
    fs::write(damaged.join("images/000005.png"), "no image").unwrap();
    refused(command(&damaged, &["--format", "colmap"]), 4, &["images/000005.png", "manifest.json"]);
    let left: Vec<String> = (fs::read_dir(place.folder.path()).unwrap())
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name.starts_with('.') || name == "out")
        .collect();
    assert!(left.is_empty(), "{left:?}");
    let said = accepted(command(&blind, &["--format", "tum"]));
    assert!(said.contains("9 frames"), "{said}");
    refused(command(&blind, &["--format", "tum"]), 4, &["out", "is not empty"]);
}
