//! The scene file of `respire-bench render`: mesh, camera, light, material, integrator in one TOML.

use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};
use serde::{Deserialize, Serialize};

use super::probe::WallInView;
use super::settings::{EMISSION_EXPONENT, RAYS_PER_FACE, STILL_SIDE_PX, check_size};
use super::{Denoise, Light, Material, RenderSettings, Scene, Shading, Transport};
use crate::base::camera::{DISTORTION, FOCAL_PX, PRINCIPAL_PX};
use crate::base::range::{COORDINATE_MM, KeyRanges, LIGHT, NumberRange, SAMPLES_PER_PIXEL, SEED, SHARE};
use crate::base::{Camera, Error, Result, TriangleMesh, files, mesh, pose};
use crate::formats::mesh::read as read_mesh;

/// Positions of camera and lamp in mm.
const PLACE_MM: NumberRange = NumberRange::new(-1e6, 1e6);
/// Diagonals in mm of the box around a mesh. The tracer moves rays off the wall by a fixed 2e-4 mm and computes in
/// single precision: within this range spheres have the radiance of the closed form to .5 %, and one of 5200 mm is 7 %
/// dark.
const EXTENT_MM: NumberRange = NumberRange::new(0.5, 1500.0);
/// Ranges of `[mesh]`, `[camera]`, `[light]` and `[integrator]`; `[material]` knows its own.
const MESH_RANGES: KeyRanges = KeyRanges(&[("phase", SHARE)]);
const CAMERA_RANGES: KeyRanges = KeyRanges(&[
    ("world_from_camera", PLACE_MM),
    ("width", STILL_SIDE_PX),
    ("height", STILL_SIDE_PX),
    ("fov_x_deg", NumberRange::new(0.1, 179.0)),
    ("fl_x", FOCAL_PX),
    ("fl_y", FOCAL_PX),
    ("cx", PRINCIPAL_PX),
    ("cy", PRINCIPAL_PX),
    ("k1", DISTORTION),
    ("k2", DISTORTION),
    ("k3", DISTORTION),
    ("k4", DISTORTION),
]);
const LIGHT_RANGES: KeyRanges =
    KeyRanges(&[("intensity", LIGHT), ("position", PLACE_MM), ("emission_exponent", EMISSION_EXPONENT)]);
const INTEGRATOR_RANGES: KeyRanges = KeyRanges(&[
    ("max_scatterings", NumberRange::new(0.0, 1e6)),
    ("spp", SAMPLES_PER_PIXEL),
    ("target_relmse", NumberRange::new(1e-8, 1e3)),
    ("rays_per_face", RAYS_PER_FACE),
    ("seed", SEED),
    ("background", LIGHT),
]);

/// A scene file. Lengths in mm; paths are relative to the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    /// The mesh.
    pub mesh: MeshSection,
    /// The camera.
    pub camera: CameraSection,
    /// The lamp.
    pub light: Light,
    /// The wall's material.
    #[serde(default)]
    pub material: Material,
    /// Settings of the light transport.
    #[serde(default)]
    pub integrator: IntegratorSection,
}

/// `[mesh]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MeshSection {
    /// The mesh (at inspiration).
    pub path: PathBuf,
    /// The same mesh at expiration: same number of vertices.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expiration: Option<PathBuf>,
    /// Breathing phase, 0 inspiration to 1 expiration.
    #[serde(default)]
    pub phase: f64,
    /// Turns all faces around, for meshes whose normals point out of the lumen. The transports "vertices" and "gather"
    /// need normals that point into it; "paths" shades both sides alike.
    #[serde(default)]
    pub flip: bool,
}

/// `[camera]`: pose and intrinsics; either `fov_x_deg` or focal lengths and principal point in pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraSection {
    /// 4x4, row-major, OpenCV axes.
    pub world_from_camera: Vec<f64>,
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Horizontal field of view of a pinhole with square pixels.
    pub fov_x_deg: Option<f64>,
    /// Horizontal focal length in pixels.
    pub fl_x: Option<f64>,
    /// Vertical focal length in pixels; `fl_x` where left out.
    pub fl_y: Option<f64>,
    /// Horizontal principal point in pixels; the image centre where left out.
    pub cx: Option<f64>,
    /// Vertical principal point in pixels; the image centre where left out.
    pub cy: Option<f64>,
    /// How directions become image points.
    #[serde(default)]
    pub model: LensModel,
    /// Fisheye coefficient.
    #[serde(default)]
    pub k1: f64,
    /// Fisheye coefficient.
    #[serde(default)]
    pub k2: f64,
    /// Fisheye coefficient.
    #[serde(default)]
    pub k3: f64,
    /// Fisheye coefficient.
    #[serde(default)]
    pub k4: f64,
}

/// Camera models by COLMAP's names.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum LensModel {
    /// Without distortion.
    #[default]
    #[serde(rename = "PINHOLE", alias = "pinhole")]
    Pinhole,
    /// OpenCV's fisheye, with `k1` to `k4`.
    #[serde(rename = "OPENCV_FISHEYE", alias = "opencv_fisheye", alias = "fisheye")]
    OpencvFisheye,
}

/// The kinds of [`Transport`] by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TransportName {
    /// [`Transport::Paths`].
    #[default]
    Paths,
    /// [`Transport::Vertices`].
    Vertices,
    /// [`Transport::Gather`].
    Gather,
}

/// `[integrator]`
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct IntegratorSection {
    /// Surface scatterings of the longest path, direct light = 1; 0 = unlimited.
    pub max_scatterings: u32,
    /// Samples per pixel; the least number where `target_relmse` is given.
    pub spp: u32,
    /// Sampling goes on until the estimated mean squared relative error is below this.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target_relmse: Option<f64>,
    /// How light by way of walls is found: "paths", "vertices" or "gather".
    pub transport: TransportName,
    /// Rays per face of "vertices" and "gather".
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rays_per_face: Option<u32>,
    /// Seed of samples and procedural look.
    pub seed: u64,
    /// Normals.
    pub shading: Shading,
    /// Filter of the indirect light.
    pub denoise: bool,
    /// Radiance of rays that leave the scene.
    pub background: [f64; 3],
}

impl Default for IntegratorSection {
    fn default() -> Self {
        IntegratorSection {
            max_scatterings: 0,
            spp: 16,
            target_relmse: None,
            transport: TransportName::Paths,
            rays_per_face: None,
            seed: 1,
            shading: Shading::Flat,
            denoise: false,
            background: [0.0; 3],
        }
    }
}

impl SceneFile {
    /// Reads a scene file; paths in it become relative to the working directory (or absolute).
    pub fn load(path: &Path) -> Result<Self> {
        let mut scene: SceneFile = files::read_toml(path)?;
        if let Some(toml::Value::Table(keys)) = files::read_toml::<toml::Table>(path)?.get("material") {
            scene.material = scene.material.as_given(keys).map_err(|e| e.at(path))?;
        }
        let folder = path.parent().unwrap_or(Path::new(""));
        scene.mesh.path = folder.join(&scene.mesh.path);
        scene.mesh.expiration = scene.mesh.expiration.map(|p| folder.join(p));
        scene.validate().map_err(|e| e.at(path))?;
        Ok(scene)
    }

    fn validate(&self) -> Result<()> {
        MESH_RANGES.check("mesh", &self.mesh)?;
        CAMERA_RANGES.check("camera", &self.camera)?;
        LIGHT_RANGES.check("light", &self.light)?;
        INTEGRATOR_RANGES.check("integrator", &self.integrator)?;
        check_size(self.camera.width, self.camera.height).map_err(|e| e.element("camera"))?;
        if self.integrator.transport == TransportName::Paths && self.integrator.rays_per_face.is_some() {
            let sentence = "is of the transports \"vertices\" and \"gather\", not of \"paths\"";
            return Err(Error::input(sentence).element("integrator.rays_per_face"));
        }
        if self.mesh.expiration.is_none() && self.mesh.phase != 0.0 {
            return Err(Error::input("needs the mesh at the other end, mesh.expiration").element("mesh.phase"));
        }
        self.camera.intrinsics()?;
        self.camera.pose()?;
        self.material.settings(self.integrator.seed).map(|_| ())
    }

    /// Reads the mesh or meshes and builds the scene at its phase.
    pub fn build(&self) -> Result<Scene> {
        let read = |path: &Path| -> Result<TriangleMesh> {
            let mut mesh = read_mesh(path)?;
            check_extent(&mesh).map_err(|e| e.at(path))?;
            mesh.park_unused_vertices();
            if self.mesh.flip {
                mesh.flip();
            }
            Ok(mesh)
        };
        let inspiration = read(&self.mesh.path)?;
        if self.integrator.transport != TransportName::Paths
            && let Some([a, b]) = inspiration.two_ways_wound()
        {
            let sentence = "is run along in the same direction by two faces, so that one shows its back, and light at \
                            vertices is that of one side: orient all faces alike, or set integrator.transport = \"paths\"";
            return Err(Error::input(sentence).element(format!("edge {a}-{b}")).at(&self.mesh.path));
        }
        let mut scene =
            Scene::new(&inspiration, &[], self.material, self.integrator.seed).map_err(|e| e.at(&self.mesh.path))?;
        if let Some(path) = &self.mesh.expiration {
            let expiration = read(path)?;
            if expiration.faces != inspiration.faces || expiration.vertices.len() != inspiration.vertices.len() {
                return Err(Error::input("must have the vertices and faces of mesh.path, in the same order").at(path));
            }
            scene.set_other_end(&expiration.vertices).map_err(|e| e.at(path))?;
            scene
                .deform(&mesh::interpolate(&inspiration.vertices, &expiration.vertices, self.mesh.phase))
                .map_err(|e| e.at(path))?;
        }
        Ok(scene)
    }

    /// Refuses a view for which its transport is wrong: light at vertices is that on the side to which faces are wound.
    ///
    /// Errors: most of the walls in view are seen from behind; an impossible camera or pose.
    pub fn check_view(&self, scene: &Scene) -> Result<()> {
        if self.integrator.transport == TransportName::Paths {
            return Ok(());
        }
        let view = WallInView::new(scene, &self.camera.intrinsics()?, &self.camera.pose()?)?;
        if 2 * view.from_behind <= view.hit {
            return Ok(());
        }
        let flip = !self.mesh.flip;
        let sentence = format!(
            "most of the walls in view are seen from behind, and light at vertices needs normals that point to the \
             camera: set flip = {flip}, or integrator.transport = \"paths\""
        );
        Err(Error::input(sentence).element("mesh.flip"))
    }

    /// The settings of its rendering.
    pub fn settings(&self) -> RenderSettings {
        let i = &self.integrator;
        RenderSettings {
            max_scatterings: i.max_scatterings,
            samples_per_pixel: i.spp,
            target_relmse: i.target_relmse,
            transport: match (i.transport, i.rays_per_face) {
                (TransportName::Paths, _) => Transport::Paths,
                (TransportName::Vertices, None) => Transport::VERTICES,
                (TransportName::Vertices, Some(rays_per_face)) => Transport::Vertices { rays_per_face },
                (TransportName::Gather, None) => Transport::GATHER,
                (TransportName::Gather, Some(rays_per_face)) => Transport::Gather { rays_per_face },
            },
            shading: i.shading,
            denoise: if i.denoise { Denoise::On } else { Denoise::Off },
            background: i.background,
            seed: i.seed,
            frame: 0,
        }
    }
}

/// Refuses a mesh too large, too small or too far away to be traced; vertices that no face uses do not count.
fn check_extent(mesh: &TriangleMesh) -> Result<()> {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for (v, (&place, _)) in mesh.vertices.iter().zip(mesh.used_vertices()).enumerate().filter(|(_, (_, used))| *used) {
        let far = |e: Error| Error::input(format!("coordinates are in mm, and {e}")).element(format!("vertex {v}"));
        place.to_array().into_iter().try_for_each(|c| COORDINATE_MM.check(c)).map_err(far)?;
        (low, high) = (low.min(place), high.max(place));
    }
    let wrong = |e: Error| Error::input(format!("coordinates are in mm, and {e}")).element("diagonal of the mesh");
    EXTENT_MM.check((high - low).length()).map_err(wrong)
}

impl CameraSection {
    /// Intrinsics; the error names the missing key.
    pub fn intrinsics(&self) -> Result<Camera> {
        let fisheye = match self.model {
            LensModel::Pinhole => {
                let bends = [("k1", self.k1), ("k2", self.k2), ("k3", self.k3), ("k4", self.k4)];
                if let Some((name, _)) = bends.iter().find(|(_, k)| *k != 0.0) {
                    let sentence = "is of OPENCV_FISHEYE; a pinhole has no distortion here";
                    return Err(Error::input(sentence).element(format!("camera.{name}")));
                }
                None
            }
            LensModel::OpencvFisheye => Some([self.k1, self.k2, self.k3, self.k4]),
        };
        if self.fov_x_deg.is_some() && self.fl_y.is_some() {
            let sentence = "does not go with fov_x_deg, whose pixels are square; give fl_x and fl_y";
            return Err(Error::input(sentence).element("camera.fl_y"));
        }
        let mut camera = match (self.fl_x, self.fov_x_deg) {
            (Some(fl_x), None) => {
                Camera { fl_x, fl_y: self.fl_y.unwrap_or(fl_x), ..Camera::pinhole(self.width, self.height, 1.0) }
            }
            (None, Some(fov)) if fov > 0.0 && fov < 180.0 && fisheye.is_none() => {
                Camera::pinhole(self.width, self.height, fov.to_radians())
            }
            _ => {
                return Err(Error::input("needs either fov_x_deg (a pinhole's, 0.1 to 179) or fl_x").element("camera"));
            }
        };
        camera.cx = self.cx.unwrap_or(camera.cx);
        camera.cy = self.cy.unwrap_or(camera.cy);
        camera.fisheye = fisheye;
        camera.validate().map_err(|e| e.element("camera"))?;
        Ok(camera)
    }

    /// The pose, with what a file's rounding took from its rotation put right; the error says how many numbers are
    /// there.
    pub fn pose(&self) -> Result<DAffine3> {
        let numbers: [f64; 16] = self.world_from_camera.as_slice().try_into().map_err(|_| {
            Error::input(format!("has {} numbers, not 16", self.world_from_camera.len()))
                .element("camera.world_from_camera")
        })?;
        let [a, b, c, d] = [0, 4, 8, 12].map(|at| [0, 1, 2, 3].map(|k| numbers[at + k]));
        let pose = pose::from_rows(&[a, b, c, d], PLACE_MM).map_err(|e| e.element("camera.world_from_camera"))?;
        Ok(pose::rigid(&pose))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXAMPLE: &str = r#"
        [mesh]
        path = "tube.ply"
        expiration = "tube_out.ply"
        phase = 0.25
        [camera]
        world_from_camera = [1,0,0,5, 0,1,0,6, 0,0,1,7, 0,0,0,1]
        width = 256
        height = 128
        fov_x_deg = 90.0
        [light]
        intensity = [400.0, 300.0, 200.0]
        position = [1.0, 2.0, 3.0]
        [material]
        kind = "coated"
        albedo = [0.75, 0.40, 0.35]
        coat_alpha = 0.15
        coat_ior = 1.4
        mean_free_path_mm = [1.0, 0.4, 0.25]
        [integrator]
        max_scatterings = 6
        spp = 64
        seed = 1
        shading = "smooth"
        denoise = true
    "#;

    fn load(text: &str) -> Result<SceneFile> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.toml");
        files::write_bytes(&path, text.as_bytes()).unwrap();
        SceneFile::load(&path)
    }

    #[test]
    fn every_key_has_its_meaning() {
        let scene = load(EXAMPLE).unwrap();
        assert!(scene.mesh.path.is_absolute() && scene.mesh.path.ends_with("tube.ply"));
        assert_eq!(scene.mesh.phase, 0.25);
        let camera = scene.camera.intrinsics().unwrap();
        assert!((camera.fl_x - 128.0).abs() < 1e-9 && camera.cx == 128.0 && camera.cy == 64.0);
        assert_eq!(scene.camera.pose().unwrap().translation, DVec3::new(5.0, 6.0, 7.0));
        assert_eq!(scene.light.position_mm, Some(DVec3::new(1.0, 2.0, 3.0)));
        let settings = scene.settings();
        assert_eq!((settings.max_scatterings, settings.samples_per_pixel), (6, 64));
        assert_eq!((settings.shading, settings.denoise), (Shading::Smooth, Denoise::On));
    }

    #[test]
    fn a_fisheye_needs_focal_lengths() {
        let text = EXAMPLE.replace("fov_x_deg = 90.0", "fl_x = 100.0\nmodel = \"OPENCV_FISHEYE\"\nk1 = 0.1");
        let camera = load(&text).unwrap().camera.intrinsics().unwrap();
        assert_eq!((camera.fisheye, camera.fl_y), (Some([0.1, 0.0, 0.0, 0.0]), 100.0));
        // As a film's camera may have it.
        let off_centre =
            load(&text.replace("OPENCV_FISHEYE", "fisheye").replace("fl_x = 100.0", "fl_x = 1e7\ncx = 2e6"));
        assert_eq!(off_centre.unwrap().camera.intrinsics().unwrap().cx, 2e6);
        assert!(load(&EXAMPLE.replace("fov_x_deg = 90.0", "fov_x_deg = 90.0\nmodel = \"fisheye\"")).is_err());
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (from, to, words) in [
            ("phase = 0.25", "phase = 1.25", "mesh.phase"),
            ("expiration = \"tube_out.ply\"", "", "mesh.phase"),
            ("fov_x_deg = 90.0", "", "camera"),
            ("fov_x_deg = 90.0", "fov_x_deg = 90.0\nfl_y = 80.0", "camera.fl_y"),
            ("fov_x_deg = 90.0", "fov_x_deg = 90.0\nmodel = \"orthographic\"", "orthographic"),
            ("0,0,0,1]", "0,0,1]", "15 numbers"),
            ("0,0,0,1]", "0,0,0,2]", "world_from_camera"),
            ("spp = 64", "spp = 64\ntarget_relmse = 0.0", "target_relmse"),
            ("spp = 64", "ssp = 64", "ssp"),
            ("spp = 64", "spp = 0", "integrator.spp"),
        ] {
            let message = load(&EXAMPLE.replace(from, to)).unwrap_err().to_string();
            assert!(message.contains(words) && message.contains("scene.toml"), "{message}");
        }
    }

    #[test]
    fn a_pose_as_files_round_it_is_a_rotation() {
        let rounded = EXAMPLE.replace("1,0,0,5, 0,1,0,6,", "0.707,-0.707,0,5, 0.707,0.707,0,6,");
        let pose = load(&rounded).unwrap().camera.pose().unwrap();
        assert!(pose::rotation_error(&pose) < 1e-12);
        assert!((pose.matrix3.x_axis.x - 0.5f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_mesh_of_another_scale_is_refused_and_a_stray_vertex_does_no_harm() {
        let place = |scale: f64, stray: f64| TriangleMesh {
            vertices: vec![DVec3::ZERO, DVec3::X * scale, DVec3::Y * scale, DVec3::splat(stray)],
            faces: vec![[0, 1, 2]],
        };
        let said = |mesh: TriangleMesh| check_extent(&mesh).map_err(|e| e.to_string());
        assert_eq!(said(place(20.0, 1e12)), Ok(()));
        // In metres, in micrometres, and out of reach.
        let metres = "diagonal of the mesh: coordinates are in mm, and 0.0282842712474619 must lie in 0.5 to 1500";
        assert_eq!(said(place(0.02, 0.0)).unwrap_err(), metres);
        assert!(said(place(9e3, 0.0)).unwrap_err().starts_with("diagonal of the mesh"));
        let far = "vertex 1: coordinates are in mm, and 20000 must lie in -10000 to 10000";
        assert_eq!(said(place(2e4, 0.0)).unwrap_err(), far);
    }
}
