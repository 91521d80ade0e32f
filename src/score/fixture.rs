//! For tests: a small true sequence in memory, and predictions of it on disk with errors of a chosen size.

use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

use glam::{DAffine3, DVec3};

use super::truth::{Truth, final_mesh};
use crate::airway::target::Target;
use crate::base::random::{CounterRng, Stage};
use crate::base::{Camera, Image, Mask, Result, TriangleMesh, files};
use crate::formats::{exr, mesh, png};
use crate::simulate::sequence::{FrameRecord, NovelView};

/// A camera that goes down a breathing, textured tube.
pub struct TubeTruth {
    case_id: String,
    camera: Camera,
    frames: Vec<FrameRecord>,
    novel_views: Vec<NovelView>,
    targets: Vec<Target>,
    inspiration: TriangleMesh,
    expiration: TriangleMesh,
}

fn tube(radius: impl Fn(f64) -> f64, shift: DVec3) -> TriangleMesh {
    let (around, along) = (48u32, 24u32);
    let mut mesh = TriangleMesh::default();
    for ring in 0..=along {
        let z = 40.0 * f64::from(ring) / f64::from(along);
        for step in 0..around {
            let angle = TAU * f64::from(step) / f64::from(around);
            let lobes = 1.0 + 0.12 * (3.0 * angle).cos();
            let side = DVec3::new(angle.cos(), angle.sin(), 0.0) * radius(z) * lobes;
            mesh.vertices.push(side + DVec3::new(0.0, 0.0, z) + shift * (z / 40.0));
        }
    }
    for ring in 0..along {
        for step in 0..around {
            let (a, b) = (ring * around + step, ring * around + (step + 1) % around);
            mesh.faces.push([a, a + around, b]);
            mesh.faces.push([b, a + around, b + around]);
        }
    }
    mesh
}

impl TubeTruth {
    pub fn new(case_id: &str, side: u32, frames: usize) -> Self {
        let record = |frame: usize| {
            let time_s = frame as f64 * 0.1;
            let phase = 0.5 - 0.5 * (TAU * time_s / 4.0).cos();
            let centre = DVec3::new(1.5 * phase, 0.0, 10.0 + 8.0 * frame as f64 / frames as f64);
            FrameRecord {
                time_s,
                phase,
                gain: 1.0,
                white_balance: [1.0; 3],
                world_from_camera: DAffine3::from_translation(centre),
            }
        };
        let novel = |frame: usize| NovelView { frame, world_from_camera: record(frame).world_from_camera };
        let target = |k: usize| {
            let inspiration_mm = DVec3::new(3.0 * k as f64, 4.0, 20.0);
            Target { inspiration_mm, expiration_mm: inspiration_mm + DVec3::new(1.0, -2.0, 6.0) }
        };
        TubeTruth {
            novel_views: (7..frames).step_by(8).map(novel).collect(),
            targets: (0..3).map(target).collect(),
            case_id: case_id.into(),
            camera: Camera::pinhole(side, side, 1.6),
            frames: (0..frames).map(record).collect(),
            inspiration: tube(|z| 6.0 - 0.05 * z, DVec3::ZERO),
            expiration: tube(|z| 4.8 - 0.05 * z, DVec3::new(3.0, -2.0, 9.0)),
        }
    }
}

impl Truth for TubeTruth {
    fn case_id(&self) -> &str {
        &self.case_id
    }

    fn hash(&self) -> &str {
        "0123456789abcdef"
    }

    fn content(&self) -> &str {
        "fedcba9876543210"
    }

    fn file_paths(&self) -> Vec<PathBuf> {
        Vec::new()
    }

    fn camera(&self) -> &Camera {
        &self.camera
    }

    fn frames(&self) -> &[FrameRecord] {
        &self.frames
    }

    fn image(&self, frame: usize) -> Result<Image<u8>> {
        let depth = self.depth_mm(frame)?;
        let mut image = Image::filled(depth.width, depth.height, 3, 0u8);
        for y in 0..depth.height {
            for x in 0..depth.width {
                let d = f64::from(depth.pixel(x, y)[0]);
                let wave = 0.75 + 0.25 * ((x as f64 * 0.6).sin() * (y as f64 * 0.5 + frame as f64 * 0.2).cos());
                let light = (200.0 / (d * d + 12.0)).min(1.0) * wave;
                for (channel, albedo) in [0.95, 0.55, 0.45].into_iter().enumerate() {
                    image.pixel_mut(x, y)[channel] = (255.0 * (light * albedo).sqrt()) as u8;
                }
            }
        }
        Ok(image)
    }

    fn depth_mm(&self, frame: usize) -> Result<Image<f32>> {
        let side = self.camera.width as usize;
        let phase = self.frames[frame].phase;
        let mut depth = Image::filled(side, side, 1, 0f32);
        for y in 0..side {
            for x in 0..side {
                let offset = (x as f64 + 0.5 - self.camera.cx - 6.0 * phase).hypot(y as f64 + 0.5 - self.camera.cy);
                depth.pixel_mut(x, y)[0] = ((5.5 - phase) * self.camera.fl_x / offset.max(1.5)).min(60.0) as f32;
            }
        }
        // A few pixels show the open far end.
        depth.pixel_mut(0, 0)[0] = 0.0;
        Ok(depth)
    }

    fn novel_views(&self) -> &[NovelView] {
        &self.novel_views
    }

    fn novel_image(&self, frame: usize) -> Result<Image<u8>> {
        self.image(frame)
    }

    fn novel_depth_mm(&self, frame: usize) -> Result<Image<f32>> {
        self.depth_mm(frame)
    }

    fn targets(&self) -> &[Target] {
        &self.targets
    }

    /// A touch of the wall in the third and fourth frame.
    fn disturbed(&self) -> Result<Vec<bool>> {
        Ok((0..self.frames.len()).map(|frame| frame == 2 || frame == 3).collect())
    }

    fn mask(&self) -> Result<Option<Mask>> {
        Ok(None)
    }

    fn inspiration(&self) -> Result<TriangleMesh> {
        Ok(self.inspiration.clone())
    }

    fn expiration(&self) -> Result<TriangleMesh> {
        Ok(self.expiration.clone())
    }
}

/// The same tube on the clinical track: targets and the wall of the last frame have moved beside what the phase says.
pub struct BeyondPhase(pub TubeTruth);

impl BeyondPhase {
    /// How far the wall of the last frame has moved, mm.
    pub const MOVED_MM: f64 = 0.9;
    /// How far beside the camera methods are told that it is, mm.
    pub const TOLD_OFF_MM: f64 = 0.7;
}

impl Truth for BeyondPhase {
    fn case_id(&self) -> &str {
        self.0.case_id()
    }

    fn hash(&self) -> &str {
        self.0.hash()
    }

    fn content(&self) -> &str {
        self.0.content()
    }

    fn file_paths(&self) -> Vec<PathBuf> {
        self.0.file_paths()
    }

    fn camera(&self) -> &Camera {
        self.0.camera()
    }

    fn frames(&self) -> &[FrameRecord] {
        self.0.frames()
    }

    fn image(&self, frame: usize) -> Result<Image<u8>> {
        self.0.image(frame)
    }

    fn depth_mm(&self, frame: usize) -> Result<Image<f32>> {
        self.0.depth_mm(frame)
    }

    fn novel_views(&self) -> &[NovelView] {
        self.0.novel_views()
    }

    fn novel_image(&self, frame: usize) -> Result<Image<u8>> {
        self.0.novel_image(frame)
    }

    fn novel_depth_mm(&self, frame: usize) -> Result<Image<f32>> {
        self.0.novel_depth_mm(frame)
    }

    fn targets(&self) -> &[Target] {
        self.0.targets()
    }

    fn target_mm(&self, index: usize, frame: usize) -> DVec3 {
        self.0.target_mm(index, frame) + DVec3::new(0.5, 0.0, 0.1 * frame as f64)
    }

    fn told_poses(&self) -> Vec<DAffine3> {
        let off = DAffine3::from_translation(DVec3::Y * Self::TOLD_OFF_MM);
        self.0.told_poses().into_iter().map(|pose| off * pose).collect()
    }

    fn last_surface(&self) -> Result<Option<TriangleMesh>> {
        let mut surface = final_mesh(&self.0)?;
        surface.vertices.iter_mut().for_each(|v| v.y += Self::MOVED_MM);
        Ok(Some(surface))
    }

    fn mask(&self) -> Result<Option<Mask>> {
        self.0.mask()
    }

    fn inspiration(&self) -> Result<TriangleMesh> {
        self.0.inspiration()
    }

    fn expiration(&self) -> Result<TriangleMesh> {
        self.0.expiration()
    }
}

/// How a prediction departs from the truth; the default does not.
#[derive(Clone, Copy, Debug, Default)]
pub struct Distortion {
    /// Standard deviation of noise on colour codes.
    pub noise: f64,
    /// Columns by which images are shifted.
    pub shift_px: usize,
    /// Box blur of this radius.
    pub blur_px: usize,
    /// Depths are multiplied by 1 + this.
    pub depth_scale: f64,
    /// Share of depth pixels left out.
    pub dropout: f64,
    /// Time lag of the phase in frames.
    pub lag: usize,
    /// Phase added.
    pub phase_offset: f64,
    /// The final surface is moved sideways by this.
    pub surface_shift_mm: f64,
    /// The camera is moved sideways by this many mm and turned by this many degrees.
    pub pose_shift: f64,
    /// Seconds claimed.
    pub seconds: f64,
}

/// Standard deviation that predictions state of a target's place along each axis of the camera, mm.
pub const TARGET_SD_MM: f64 = 1.2;
/// Standard deviation that predictions state of their phase.
pub const PHASE_SD: f64 = 0.05;

/// Writes a complete prediction of `truth` into `folder`.
pub fn write_prediction(truth: &dyn Truth, folder: &Path, d: &Distortion) {
    for frame in 0..truth.frames().len() {
        let color = distorted(&truth.image(frame).unwrap(), d, frame);
        png::write_rgb(&folder.join(format!("color/{frame:06}.png")), &color).unwrap();
        if frame % 8 == 7 {
            png::write_rgb(&folder.join(format!("ahead/{frame:06}.png")), &color).unwrap();
            png::write_rgb(&folder.join(format!("novel/{frame:06}.png")), &color).unwrap();
        }
        let mut depth = truth.depth_mm(frame).unwrap();
        let mut random = CounterRng::new(1, Stage::Test, &[2, frame as u64]);
        for value in &mut depth.data {
            let dropped = random.uniform() < d.dropout;
            *value = if dropped { 0.0 } else { *value * (1.0 + d.depth_scale) as f32 };
        }
        exr::write_depth(&folder.join(format!("depth/{frame:06}.exr")), &depth).unwrap();
        if frame % 8 == 7 {
            exr::write_depth(&folder.join(format!("novel_depth/{frame:06}.exr")), &depth).unwrap();
        }
    }
    let mut rows = "frame,target,x_mm,y_mm,z_mm\n".to_owned();
    for (frame, record) in truth.frames().iter().enumerate() {
        for (k, target) in truth.targets().iter().enumerate() {
            let place = target.at(record.phase) + DVec3::X * d.surface_shift_mm;
            rows.push_str(&format!("{frame},{k},{},{},{}\n", place.x, place.y, place.z));
        }
    }
    files::write_bytes(&folder.join("targets.csv"), rows.as_bytes()).unwrap();
    let mut rows = "frame,target,xx,xy,xz,yy,yz,zz\n".to_owned();
    let square = TARGET_SD_MM * TARGET_SD_MM;
    for frame in 0..truth.frames().len() {
        for k in 0..truth.targets().len() {
            rows.push_str(&format!("{frame},{k},{square},0,0,{square},0,{square}\n"));
        }
    }
    files::write_bytes(&folder.join("target_covariance.csv"), rows.as_bytes()).unwrap();
    let mut rows = "frame,phase,phase_sd\n".to_owned();
    for frame in 0..truth.frames().len() {
        let phase = truth.frames()[frame.saturating_sub(d.lag)].phase + d.phase_offset;
        rows.push_str(&format!("{frame},{phase},{PHASE_SD}\n"));
    }
    files::write_bytes(&folder.join("phase.csv"), rows.as_bytes()).unwrap();
    let mut rows = "frame,m00,m01,m02,m03,m10,m11,m12,m13,m20,m21,m22,m23\n".to_owned();
    for (frame, record) in truth.frames().iter().enumerate() {
        let turn = DAffine3::from_rotation_z(d.pose_shift.to_radians());
        let pose = DAffine3::from_translation(DVec3::X * d.pose_shift) * record.world_from_camera * turn;
        let m = [0, 1, 2].map(|r| [0, 1, 2, 3].map(|c| pose.to_cols_array()[3 * c + r].to_string()).join(","));
        rows.push_str(&format!("{frame},{}\n", m.join(",")));
    }
    files::write_bytes(&folder.join("poses.csv"), rows.as_bytes()).unwrap();
    let mut surface = final_mesh(truth).unwrap();
    for vertex in &mut surface.vertices {
        vertex.x += d.surface_shift_mm;
    }
    mesh::write_ply(&folder.join("mesh/final.ply"), &surface, &[]).unwrap();
    let seconds = if d.seconds > 0.0 { d.seconds } else { 2.0 };
    let timing = format!("{{\"time_total_s\": {seconds}, \"time_cpu_s\": {}}}", 2.0 * seconds);
    files::write_bytes(&folder.join("timing.json"), timing.as_bytes()).unwrap();
}

fn distorted(image: &Image<u8>, d: &Distortion, frame: usize) -> Image<u8> {
    let mut out = image.clone();
    let radius = d.blur_px as i64;
    for y in 0..image.height {
        for x in 0..image.width {
            for c in 0..3 {
                let (mut sum, mut count) = (0.0, 0.0);
                for dy in -radius..=radius {
                    for dx in -radius..=radius {
                        let sx = (x as i64 + dx + d.shift_px as i64).clamp(0, image.width as i64 - 1) as usize;
                        let sy = (y as i64 + dy).clamp(0, image.height as i64 - 1) as usize;
                        sum += f64::from(image.pixel(sx, sy)[c]);
                        count += 1.0;
                    }
                }
                let key = [3, frame as u64, y as u64, x as u64, c as u64];
                let noise = if d.noise > 0.0 { d.noise * CounterRng::new(1, Stage::Test, &key).normal() } else { 0.0 };
                out.pixel_mut(x, y)[c] = (sum / count + noise).round().clamp(0.0, 255.0) as u8;
            }
        }
    }
    out
}
