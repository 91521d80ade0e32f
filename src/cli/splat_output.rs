//! What `splat` writes: images, what was asked for beyond them, timing.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::base::image::codes_from_unit;
use crate::base::{Error, Estimate, Image, Result, files};
use crate::experiments::timing::{BACKWARD_STAGES, FORWARD_STAGES, Samples};
use crate::formats::gaussians_ply::GaussianCloud;
use crate::formats::{exr, npy, png};
use crate::splat::{Gaussians, PassStage, Rasterizer, Rendered, StageTimes, View};

/// Bytes of a value of an image while it is encoded, and the seconds that this takes.
const VALUE_BYTES: f64 = 12.0;
const VALUE_S: f64 = 5e-8;

/// Sums of gradients over all frames.
pub(super) const GRADIENTS: &str = "gradients.npz";
/// Endings of all files of a frame. The first is written first and removed last, so that whatever a kill leaves is known.
const ENDINGS: [&str; 7] = [ALPHA, ".exr", ".png", "_depth.exr", "_contributors.exr", "_normals.exr", "_channels.exr"];
/// The ending of opacities, which every frame of `splat` has, and no picture of a film.
const ALPHA: &str = "_alpha.exr";

/// Medians of one stage in milliseconds.
#[derive(Serialize)]
pub(super) struct SplatStageTiming {
    wall_ms: f64,
    cpu_ms: f64,
}

/// Medians of one frame.
#[derive(Serialize)]
pub(super) struct FrameTiming {
    forward_ms: f64,
    backward_ms: Option<f64>,
    forward_cpu_ms: f64,
    backward_cpu_ms: Option<f64>,
    pub visible: usize,
    intersections: usize,
    stages: BTreeMap<&'static str, SplatStageTiming>,
}

/// `timing.json`.
#[derive(Serialize)]
pub(super) struct SplatTiming {
    pub frames: Vec<FrameTiming>,
    pub threads: usize,
    pub isa: String,
    pub gaussians: usize,
    pub dropped: usize,
    pub sh_degree: u8,
    pub repeat: usize,
}

impl FrameTiming {
    /// Medians over the repetitions; stages that did not run are left out.
    pub fn new(times: &[StageTimes], with_backward: bool, image: &Rendered<f32>) -> FrameTiming {
        let median = |stages: std::ops::Range<usize>| {
            let samples = Samples::of_stages(times, stages);
            SplatStageTiming { wall_ms: 1e3 * samples.wall().median_s, cpu_ms: 1e3 * samples.cpu().median_s }
        };
        let count = if with_backward { BACKWARD_STAGES.end } else { FORWARD_STAGES.end };
        let (forward, backward) = (median(FORWARD_STAGES), with_backward.then(|| median(BACKWARD_STAGES)));
        FrameTiming {
            forward_ms: forward.wall_ms,
            backward_ms: backward.as_ref().map(|t| t.wall_ms),
            forward_cpu_ms: forward.cpu_ms,
            backward_cpu_ms: backward.map(|t| t.cpu_ms),
            visible: image.visible_count,
            intersections: image.intersections,
            stages: (0..count).map(|k| (PassStage::ALL[k].name(), median(k..k + 1))).collect(),
        }
    }
}

/// Features of the Gaussians that are kept.
pub(super) struct Features {
    data: Vec<f32>,
    count: usize,
}

impl Features {
    /// Reads the features; the error names the file, and the shape that is wanted or the value that is not finite.
    pub fn read(path: &Path, cloud: &GaussianCloud) -> Result<Features> {
        let array = npy::read(path)?;
        let &[n, count] = array.shape.as_slice() else {
            return Err(Error::input(format!("has shape {:?}; (Gaussians, channels) is wanted", array.shape)).at(path));
        };
        if n != cloud.count_in_file || count == 0 {
            let message = format!("has shape [{n}, {count}]; the file has {} Gaussians", cloud.count_in_file);
            return Err(Error::input(message).at(path));
        }
        let of = |&i: &u32| &array.data[i as usize * count..(i as usize + 1) * count];
        for i in &cloud.index {
            if let Some(channel) = of(i).iter().position(|v| !v.is_finite()) {
                let element = format!("Gaussian {i}, channel {channel}");
                return Err(Error::input("a feature is not finite").element(element).at(path));
            }
        }
        Ok(Features { data: cloud.index.iter().flat_map(of).copied().collect(), count })
    }
}

/// The folder of the output, and what goes into it beyond colour, depth and alpha.
pub(super) struct SplatOutput {
    pub folder: PathBuf,
    pub normals: bool,
    pub contributors: bool,
    pub features: Option<Features>,
}

impl SplatOutput {
    fn path(&self, number: usize, ending: &str) -> PathBuf {
        self.folder.join(format!("{number:06}{ending}"))
    }

    /// Refuses a folder with numbered pictures that no earlier run wrote, a film's for example: those have opacities.
    pub fn check_replaceable(&self) -> Result<()> {
        if !self.folder.is_dir() || self.path(0, ALPHA).exists() {
            return Ok(());
        }
        let is_frame = |name: &str| {
            let number = name.strip_suffix(".exr").or(name.strip_suffix(".png"));
            number.is_some_and(|number| number.len() == 6 && number.bytes().all(|b| b.is_ascii_digit()))
        };
        let names = files::names_in(&self.folder)?;
        match names.iter().find(|name| name.to_str().is_some_and(is_frame)) {
            Some(name) => {
                let sentence = "is no picture of splat's, and nothing is overwritten: name another folder with --out";
                Err(Error::input(sentence).at(self.folder.join(name)))
            }
            None => Ok(()),
        }
    }

    /// Removes what an earlier run wrote into the folder: frames that this one does not have would be taken for its.
    pub fn remove_earlier(&self) -> Result<()> {
        let remove = |path: PathBuf| match std::fs::remove_file(&path) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io("removing", &path, e)),
            _ => Ok(()),
        };
        remove(self.folder.join(GRADIENTS))?;
        let count = (0..).take_while(|&number| self.path(number, ALPHA).exists()).count();
        (0..count)
            .rev()
            .try_for_each(|number| ENDINGS.iter().rev().try_for_each(|ending| remove(self.path(number, ending))))
    }

    /// What `frames` frames of `size` (height, width) would cost, their files included, when `pass` is the cost of one
    /// rendering.
    pub fn with_files(&self, pass: Estimate, [height, width]: [usize; 2], frames: usize, repeat: usize) -> Estimate {
        let (normals, features) = (if self.normals { 3 } else { 0 }, self.features.as_ref().map_or(0, |f| f.count));
        let values = 5 + usize::from(self.contributors) + normals + features;
        let values = values as f64 * (height * width) as f64;
        let channels_bytes = Rasterizer::<f32>::channels_bytes([width, height], features.max(normals));
        Estimate {
            memory_bytes: pass.memory_bytes + channels_bytes + values * VALUE_BYTES,
            seconds: frames as f64 * (repeat as f64 * pass.seconds + values * VALUE_S),
            resumable: false,
        }
    }

    /// Everything of the frame that `rasterizer` rendered last.
    pub fn write(
        &self,
        number: usize,
        scene: &Gaussians<f32>,
        view: &View,
        rasterizer: &mut Rasterizer<f32>,
    ) -> Result<()> {
        let (width, height) = (view.camera.width as usize, view.camera.height as usize);
        let image = |channels: usize, data: Vec<f32>| Image { width, height, channels, data };
        let path = |ending: &str| self.path(number, ending);
        let rendered = rasterizer.rendered();
        let color = image(3, rendered.color.clone());
        exr::write_channel(&path(ALPHA), "A", &image(1, rendered.alpha.clone()))?;
        exr::write_rgb(&path(".exr"), &color)?;
        png::write_rgb(&path(".png"), &codes_from_unit(&color))?;
        exr::write_depth(&path("_depth.exr"), &image(1, rendered.depth.clone()))?;
        if self.contributors {
            let counts = rasterizer.contributors()?.into_iter().map(|count| count as f32).collect();
            exr::write_channel(&path("_contributors.exr"), "N", &image(1, counts))?;
        }
        if self.normals {
            let normals = rasterizer.render_channels(&scene.normals(view), 3)?.to_vec();
            exr::write_rgb(&path("_normals.exr"), &image(3, normals))?;
        }
        if let Some(features) = &self.features {
            let channels = rasterizer.render_channels(&features.data, features.count)?.to_vec();
            let names: Vec<String> = (0..features.count).map(|k| format!("C{k:03}")).collect();
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            exr::write(&path("_channels.exr"), &image(features.count, channels), &names)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_of_an_earlier_run_do_not_stay() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        let own = ["000000.exr", "000000.png", "000001.exr", "000001_alpha.exr", "000001_normals.exr", GRADIENTS];
        let others = ["notes.txt", "000009.png"];
        own.iter().chain(&others).for_each(|name| std::fs::write(place(name), "").unwrap());
        let output =
            SplatOutput { folder: folder.path().to_owned(), normals: false, contributors: false, features: None };
        let said = output.check_replaceable().unwrap_err().to_string();
        assert!(said.contains("000000.exr: is no picture of splat's"), "{said}");
        std::fs::write(place("000000_alpha.exr"), "").unwrap();
        output.check_replaceable().unwrap();
        output.remove_earlier().unwrap();
        assert!(own.iter().all(|name| !place(name).exists()) && others.iter().all(|name| place(name).exists()));
    }

    /// Each group of three channels keeps the state of all its tiles: more than the image of the channels.
    #[test]
    fn the_estimate_counts_the_states_of_the_channels() {
        let output = |count: usize| {
            let features = (count > 0).then(|| Features { data: Vec::new(), count });
            SplatOutput { folder: PathBuf::new(), normals: false, contributors: false, features }
        };
        let bytes = |count| output(count).with_files(Estimate::default(), [4096, 4096], 1, 1).memory_bytes;
        let (pixels, more) = (4096.0 * 4096.0, bytes(300) - bytes(0));
        // 12 bytes of a value in files, 4 of a channel, and 5 numbers of 4 bytes for each three channels.
        assert!((more / pixels - 300.0 * (12.0 + 4.0 + 20.0 / 3.0)).abs() < 1e-6, "{more}");
    }
}
