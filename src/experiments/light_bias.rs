//! Bias of the light at vertices, which films use, against path tracing: frame by frame over cases, looks of the wall,
//! places on the route and breathing phases, lit as in the films.
//!
//! Both sides are means over independent parts, so both have a standard error: `REFERENCE_PARTS` path-traced images,
//! and `FILM_FRAMES` frames as a film would render them (what is known at the vertices is the same in all of them).
//! relMSE is that of one such frame, free of the reference's noise but for the denominator: pixels that came out too dark
//! weigh too much, so that it is an upper bound (case1 at 64 px: .0069 with 64 samples, .0024 with 512).
//!
//! References are kept, part by part. An image of one path per pixel is kept with them and rendered anew each time: if a
//! single byte of it differs, paths, material or airway have changed and the reference is made anew.

use std::path::{Path, PathBuf};

use crate::airway::{self, case::Case};
use crate::base::{Error, Estimate, Image, Result};
use crate::experiments::ExperimentWatcher;
use crate::experiments::case_scene::{CaseScene, Viewpoint};
use crate::experiments::difference::relative_mse;
use crate::experiments::timing;
use crate::formats::exr;
use crate::render::{RenderSettings, Shading, Transport};
use crate::report::table::counted;
use crate::simulate::trajectory::Route;

/// Independent images of a reference.
const REFERENCE_PARTS: u32 = 8;
/// Frames with light at vertices.
const FILM_FRAMES: u64 = 4;
/// Samples per pixel of a film's frame.
const FILM_SAMPLES: u32 = 4;
/// Seed of the references, apart from those of the cases.
const REFERENCE_SEED: u64 = 7000;
/// CPU seconds of a path of a reference, and of the frames that it is compared with (case2, 64 pixels wide).
const REFERENCE_SAMPLE_S: f64 = 1e-5;
const FILM_FRAMES_S: f64 = 1.0;
/// Bytes of a pixel in each part of a reference, and of the scene.
const PART_PIXEL_BYTES: f64 = 24.0;
const SCENE_BYTES: f64 = 3e8;
/// relMSE's floor, as a share of the reference's squared mean: keeps dark pixels from deciding.
const FLOOR_SHARE: f64 = 1e-4;
/// Names of the channels.
const CHANNEL_NAMES: [&str; 3] = ["red", "green", "blue"];
/// Columns of the table.
pub const COLUMNS: [&str; 14] = [
    "case_id",
    "look",
    "place",
    "phase",
    "bias_r",
    "bias_g",
    "bias_b",
    "se_r",
    "se_g",
    "se_b",
    "relmse",
    "cpu_s",
    "width_px",
    "reference_spp",
];

/// Which parts of the look the wall has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// As the case says.
    Full,
    /// No vessels, no fine relief, an even film, no folds, pale ridges or soot.
    Bare,
    /// No vessels.
    NoVessels,
    /// No fine relief.
    NoRelief,
    /// An even film.
    NoFilm,
    /// Without its coat and pattern: scattering in the wall alone.
    Uncoated,
    /// Without scattering in the wall.
    Unscattered,
}

impl Look {
    /// All of them, with their names.
    pub const ALL: [(Look, &'static str); 7] = [
        (Look::Full, "full"),
        (Look::Bare, "bare"),
        (Look::NoVessels, "no-vessels"),
        (Look::NoRelief, "no-relief"),
        (Look::NoFilm, "no-film"),
        (Look::Uncoated, "uncoated"),
        (Look::Unscattered, "unscattered"),
    ];

    /// The name in the table.
    pub fn name(self) -> &'static str {
        Self::ALL.iter().find(|(look, _)| *look == self).map_or("", |(_, name)| name)
    }

    /// Parts of the material that this look switches off.
    fn switched_off(self) -> &'static [&'static str] {
        match self {
            Look::Full | Look::Uncoated | Look::Unscattered => &[],
            Look::Bare => &["vessels", "relief", "film", "folds", "spurs", "anthracosis"],
            Look::NoVessels => &["vessels"],
            Look::NoRelief => &["relief"],
            Look::NoFilm => &["film"],
        }
    }

    /// The case with this look.
    fn of(self, case: &Case) -> Case {
        let mut case = case.clone();
        for part in self.switched_off() {
            case.material.insert((*part).to_owned(), toml::Value::Float(0.0));
        }
        let change = match self {
            Look::Uncoated => Some(("kind", "subsurface")),
            Look::Unscattered => Some(("subsurface", "off")),
            _ => None,
        };
        if let Some((key, value)) = change {
            case.material.insert(key.to_owned(), toml::Value::String(value.to_owned()));
        }
        case
    }
}

/// Which frames are compared, and how exactly.
#[derive(Clone, Debug)]
pub struct BiasSweep {
    /// Looks of the wall.
    pub looks: Vec<Look>,
    /// Fractions of the route, 0 to 1.
    pub places: Vec<f64>,
    /// Breathing phases, 0 inspiration to 1 expiration.
    pub phases: Vec<f64>,
    /// Image width and height in pixels.
    pub width_px: u32,
    /// Paths per pixel of a reference.
    pub reference_samples: u32,
    /// Folder of the references.
    pub cache: PathBuf,
}

impl BiasSweep {
    /// What one case would cost, were no reference kept.
    pub fn estimate(&self) -> Estimate {
        let frames = (self.looks.len() * self.places.len() * self.phases.len()) as f64;
        let pixels = f64::from(self.width_px).powi(2);
        let frame_s = pixels * f64::from(self.reference_samples) * REFERENCE_SAMPLE_S + FILM_FRAMES_S;
        Estimate {
            memory_bytes: pixels * f64::from(REFERENCE_PARTS + 1) * PART_PIXEL_BYTES + SCENE_BYTES,
            seconds: frames * frame_s / rayon::current_num_threads() as f64,
            resumable: true,
        }
    }
}

/// One frame: light at vertices against paths.
#[derive(Clone, Debug, PartialEq)]
pub struct BiasRow {
    /// The case.
    pub case_id: String,
    /// Its look.
    pub look: Look,
    /// Fraction of the route.
    pub place: f64,
    /// Breathing phase.
    pub phase: f64,
    /// Ratio of the mean radiances less 1, per channel.
    pub bias: [f64; 3],
    /// Its standard error.
    pub standard_error: [f64; 3],
    /// relMSE of one frame.
    pub relmse: f64,
    /// Least CPU seconds of a frame (light at the vertices and samples; what films keep was there).
    pub cpu_s: f64,
}

impl BiasRow {
    /// The channel with the largest bias.
    fn worst(&self) -> usize {
        (0..3).max_by(|&a, &b| self.bias[a].abs().total_cmp(&self.bias[b].abs())).unwrap_or(0)
    }
}

/// Compares every frame of `sweep` for one case.
///
/// Errors: a case that cannot be built, a reference that cannot be read or written, stopped by the user.
pub fn rows(case: &Case, sweep: &BiasSweep, watcher: &dyn ExperimentWatcher) -> Result<Vec<BiasRow>> {
    let anatomy = airway::build(case).map_err(|e| case.blamed(e))?;
    let route = Route::plan(&anatomy, &case.trajectory).map_err(|e| case.blamed(e))?;
    let mut rows = Vec::new();
    for &look in &sweep.looks {
        watcher.stage_starts(&format!("{}, {}", case.id, look.name()));
        let case = look.of(case);
        let mut scene = CaseScene::new(&case, &anatomy)?;
        for &place in &sweep.places {
            for &phase in &sweep.phases {
                watcher.advance(
                    rows.len() % (sweep.places.len() * sweep.phases.len()),
                    sweep.places.len() * sweep.phases.len(),
                );
                scene.set_phase(phase)?;
                let viewpoint = Viewpoint::in_film(&case, &route, place * route.length_mm(), phase, sweep.width_px);
                let subject = ComparedFrame { scene: &scene, viewpoint: &viewpoint, seed: case.seed };
                let name = format!("{}-{}-{place}-{phase}-{}px", case.id, look.name(), sweep.width_px);
                let reference = subject.reference(&sweep.cache.join(name), sweep.reference_samples, watcher)?;
                let (frames, cpu_s) = subject.frames()?;
                let (paths, found) = (Mean::of(&reference), Mean::of(&frames));
                rows.push(BiasRow {
                    case_id: case.id.clone(),
                    look,
                    place,
                    phase,
                    bias: std::array::from_fn(|c| found.value[c] / paths.value[c] - 1.0),
                    standard_error: std::array::from_fn(|c| {
                        (found.error[c] / paths.value[c])
                            .hypot(found.value[c] * paths.error[c] / paths.value[c].powi(2))
                    }),
                    relmse: relative_error(&frames[0], &reference),
                    cpu_s,
                });
            }
        }
    }
    Ok(rows)
}

/// One frame, to be rendered in both ways.
struct ComparedFrame<'a> {
    scene: &'a CaseScene,
    viewpoint: &'a Viewpoint,
    seed: u64,
}

impl ComparedFrame<'_> {
    fn picture(&self, settings: RenderSettings) -> Result<Image<f32>> {
        let settings = RenderSettings { shading: Shading::Smooth, ..settings };
        self.viewpoint.radiance(&self.scene.scene, &settings)
    }

    fn paths(&self, samples_per_pixel: u32, part: u32) -> Result<Image<f32>> {
        let frame = u64::from(part);
        self.picture(RenderSettings { samples_per_pixel, seed: REFERENCE_SEED, frame, ..RenderSettings::default() })
    }

    /// The parts of the reference, as far as possible from `folder`.
    fn reference(&self, folder: &Path, samples: u32, watcher: &dyn ExperimentWatcher) -> Result<Vec<Image<f32>>> {
        let probe = self.paths(1, REFERENCE_PARTS)?;
        let probe_file = folder.join("probe.exr");
        if !exr::read(&probe_file).is_ok_and(|kept| kept == probe) {
            if folder.exists() {
                std::fs::remove_dir_all(folder).map_err(|e| Error::io("removing", folder, e))?;
            }
            exr::write_rgb(&probe_file, &probe)?;
        }
        let each = samples.div_ceil(REFERENCE_PARTS);
        let part = |part: u32| {
            let file = folder.join(format!("{each}spp-{part}.exr"));
            watcher.proceed()?;
            // What is there may be damaged, or somebody else's.
            let fits = |kept: &Image<f32>| kept.same_shape(&probe) && kept.data.iter().all(|v| v.is_finite());
            if let Some(kept) = exr::read(&file).ok().filter(fits) {
                return Ok(kept);
            }
            let made = self.paths(each, part)?;
            exr::write_rgb(&file, &made)?;
            Ok(made)
        };
        (0..REFERENCE_PARTS).map(part).collect()
    }

    /// Frames as in a film, and the least CPU seconds of one.
    fn frames(&self) -> Result<(Vec<Image<f32>>, f64)> {
        let picture = |frame: u64| {
            self.picture(RenderSettings {
                samples_per_pixel: FILM_SAMPLES,
                transport: Transport::VERTICES,
                seed: self.seed,
                frame,
                ..RenderSettings::default()
            })
        };
        // What a film makes once for all frames is made before the clock starts.
        picture(FILM_FRAMES)?;
        let (mut images, mut least) = (Vec::new(), f64::INFINITY);
        for frame in 0..FILM_FRAMES {
            let (image, cost) = timing::measure(|| picture(frame));
            images.push(image?);
            least = least.min(cost.cpu_s);
        }
        Ok((images, least))
    }
}

/// Mean over images and its standard error, per channel.
struct Mean {
    value: [f64; 3],
    error: [f64; 3],
}

impl Mean {
    fn of(images: &[Image<f32>]) -> Mean {
        let count = images.len() as f64;
        let means: Vec<[f64; 3]> = images.iter().map(channel_means).collect();
        let value: [f64; 3] = std::array::from_fn(|c| means.iter().map(|m| m[c]).sum::<f64>() / count);
        let squares = |c: usize| means.iter().map(|m| (m[c] - value[c]).powi(2)).sum::<f64>();
        Mean { value, error: std::array::from_fn(|c| (squares(c) / (count * (count - 1.0))).sqrt()) }
    }
}

fn channel_means(image: &Image<f32>) -> [f64; 3] {
    let sum = |c: usize| image.data.iter().skip(c).step_by(3).map(|&v| f64::from(v)).sum::<f64>();
    std::array::from_fn(|c| sum(c) / (image.data.len() / 3) as f64)
}

/// relMSE against the parts of a reference, free of their noise but for the denominator.
fn relative_error(found: &Image<f32>, parts: &[Image<f32>]) -> f64 {
    let half = |first: usize| -> Vec<f64> {
        let chosen: Vec<&Image<f32>> = parts.iter().skip(first).step_by(2).collect();
        let value = |k: usize| chosen.iter().map(|p| f64::from(p.data[k])).sum::<f64>() / chosen.len() as f64;
        (0..found.data.len()).map(value).collect()
    };
    let (a, b) = (half(0), half(1));
    let mean = a.iter().chain(&b).sum::<f64>() / (2.0 * a.len() as f64);
    relative_mse(&found.data, [&a, &b], FLOOR_SHARE * mean * mean)
}

/// The rows as text, one column per name in [`COLUMNS`].
pub fn records(rows: &[BiasRow], sweep: &BiasSweep) -> Vec<Vec<String>> {
    let fraction = |v: f64| format!("{v:.5}");
    rows.iter()
        .map(|row| {
            let mut record =
                vec![row.case_id.clone(), row.look.name().to_owned(), row.place.to_string(), row.phase.to_string()];
            record.extend(row.bias.iter().chain(&row.standard_error).map(|&v| fraction(v)));
            record.extend([fraction(row.relmse), format!("{:.3}", row.cpu_s)]);
            record.extend([sweep.width_px, sweep.reference_samples].map(|v| v.to_string()));
            record
        })
        .collect()
}

/// A case with one look in one phase: its bias over the places of the camera.
struct BiasGroup<'a> {
    frames: Vec<&'a BiasRow>,
}

impl<'a> BiasGroup<'a> {
    /// Frames of one case, look and phase, in the order of `rows`.
    fn all(rows: &'a [BiasRow]) -> Vec<BiasGroup<'a>> {
        let mut groups: Vec<BiasGroup> = Vec::new();
        for row in rows {
            let key = |row: &'a BiasRow| (&row.case_id, row.look, row.phase);
            match groups.iter_mut().find(|group| key(group.frames[0]) == key(row)) {
                Some(group) => group.frames.push(row),
                None => groups.push(BiasGroup { frames: vec![row] }),
            }
        }
        groups
    }

    /// Mean over the frames of what `of` says of each.
    fn mean(&self, of: impl Fn(&BiasRow) -> f64) -> f64 {
        self.frames.iter().map(|row| of(row)).sum::<f64>() / self.frames.len() as f64
    }

    /// The channel whose mean over the frames is furthest off, with that mean.
    fn worst_mean(&self) -> (usize, f64) {
        let of_channel = |c: usize| (c, self.mean(|row| row.bias[c]));
        (0..3).map(of_channel).max_by(|a, b| a.1.abs().total_cmp(&b.1.abs())).unwrap_or((0, 0.0))
    }

    /// The frame whose worst channel is furthest off, with that channel.
    fn worst_frame(&self) -> (&BiasRow, usize) {
        let off = |row: &BiasRow| row.bias[row.worst()].abs();
        let worst = self.frames.iter().copied().reduce(|a, b| if off(b) > off(a) { b } else { a });
        let worst = worst.unwrap_or(self.frames[0]);
        (worst, worst.worst())
    }
}

/// One line for every case, look and phase, as Markdown: the mean bias over the places, which is what a film is off by,
/// and the worst single frame.
pub fn markdown(rows: &[BiasRow], sweep: &BiasSweep) -> String {
    let mut text = String::from(
        "| case | look | phase | mean bias over the places, worst channel, % | worst frame, % | relMSE |\n",
    );
    text += "|---|---|--:|--:|--:|--:|\n";
    for group in BiasGroup::all(rows) {
        let (channel, mean) = group.worst_mean();
        let error = group.mean(|row| row.standard_error[channel].powi(2)).sqrt() / (group.frames.len() as f64).sqrt();
        let (worst, of) = group.worst_frame();
        let relmse = group.frames.iter().map(|row| row.relmse).fold(0.0, f64::max);
        text += &format!(
            "| {} | {} | {} | {:+.2} ± {:.2} {} | {:+.2} ± {:.2} {} | {relmse:.4} |\n",
            worst.case_id,
            worst.look.name(),
            worst.phase,
            100.0 * mean,
            100.0 * error,
            CHANNEL_NAMES[channel],
            100.0 * worst.bias[of],
            100.0 * worst.standard_error[of],
            CHANNEL_NAMES[of],
        );
    }
    format!("{}\n\n{text}", summary(rows, sweep))
}

/// How many cases and frames are how good, in one sentence.
pub fn summary(rows: &[BiasRow], sweep: &BiasSweep) -> String {
    let groups = BiasGroup::all(rows);
    let of_groups: Vec<f64> = groups.iter().map(|group| group.worst_mean().1.abs()).collect();
    let of_frames: Vec<f64> = rows.iter().map(|row| row.bias[row.worst()].abs()).collect();
    let within = |values: &[f64], limit: f64| values.iter().filter(|&&value| value <= limit).count();
    let largest = |values: &[f64]| 100.0 * values.iter().copied().fold(0.0, f64::max);
    let error = rows.iter().flat_map(|row| row.standard_error).sum::<f64>() / (3 * rows.len().max(1)) as f64;
    format!(
        "Mean over {}: {} of {} cases, looks and phases within .5 % in every channel, largest {:.2} %. Single \
         frames of {} px: {} of {} within .5 %, {} within 1 %, largest {:.2} %, mean standard error {:.2} %.",
        counted(sweep.places.len(), "place"),
        within(&of_groups, 0.005),
        groups.len(),
        largest(&of_groups),
        sweep.width_px,
        within(&of_frames, 0.005),
        rows.len(),
        within(&of_frames, 0.01),
        largest(&of_frames),
        100.0 * error,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(place: f64, bias: [f64; 3]) -> BiasRow {
        BiasRow {
            case_id: "case1".into(),
            look: Look::Bare,
            place,
            phase: 0.25,
            bias,
            standard_error: [0.001, 0.002, 0.003],
            relmse: 0.01 * place,
            cpu_s: 0.1,
        }
    }

    fn sweep() -> BiasSweep {
        BiasSweep {
            looks: vec![Look::Bare],
            places: vec![0.5, 0.9],
            phases: vec![0.25],
            width_px: 128,
            reference_samples: 64,
            cache: PathBuf::new(),
        }
    }

    #[test]
    fn the_table_shows_the_worst_channel_of_the_worst_place() {
        let rows = [row(0.5, [0.001, -0.002, 0.003]), row(0.9, [0.004, -0.012, 0.005])];
        let text = markdown(&rows, &sweep());
        // Green: (-0.2 - 1.2) / 2, with the standard error of the mean of two, 0.2 / sqrt 2.
        assert!(text.contains("| case1 | bare | 0.25 | -0.70 ± 0.14 green | -1.20 ± 0.20 green | 0.0090 |"), "{text}");
        assert!(text.starts_with("Mean over 2 places: 0 of 1 cases, looks and phases within .5 %"), "{text}");
        let one = summary(&rows[..1], &BiasSweep { places: vec![0.5], ..sweep() });
        assert!(one.starts_with("Mean over 1 place: "), "{one}");
        assert!(text.contains("128 px: 1 of 2 within .5 %, 1 within 1 %, largest 1.20 %"), "{text}");
        assert!(records(&rows, &sweep()).iter().all(|record| record.len() == COLUMNS.len()));
    }

    #[test]
    fn a_mean_has_the_standard_error_of_its_parts() {
        let image = |value: f32| Image { width: 2, height: 1, channels: 3, data: vec![value; 6] };
        let mean = Mean::of(&[image(1.0), image(2.0), image(3.0)]);
        assert_eq!(mean.value, [2.0; 3]);
        mean.error.iter().for_each(|error| assert!((error - (1.0f64 / 3.0).sqrt()).abs() < 1e-12));
    }

    #[test]
    fn a_look_switches_parts_of_the_material_off() {
        let case = Case::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases/case1.toml")).unwrap();
        let material = |look: Look| crate::simulate::material(&look.of(&case)).unwrap();
        let (full, bare) = (material(Look::Full), material(Look::Bare));
        assert_eq!((bare.vessels, bare.relief, bare.film, bare.rings), (0.0, 0.0, 0.0, full.rings));
        assert_eq!((bare.folds, bare.spurs, bare.anthracosis), (0.0, 0.0, 0.0));
        assert!(full.vessels > 0.0 && full.relief > 0.0 && full.film > 0.0);
        for (look, name) in Look::ALL {
            assert_eq!(look.name(), name);
            material(look);
        }
    }
}
