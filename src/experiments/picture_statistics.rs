//! Statistics of pictures that tell a simulated bronchoscopy from a real one, for any folder of pictures.
//!
//! Every picture is cut to its central square (to the square inside a circular or octagonal mask on request) and
//! resized to 256 x 256, but for `noise_full`, which is of the pixels as they are. Luma (Rec. 601)
//! is of the encoded values; ratios of colours are of linear ones between the dark and the saturated. What real pictures
//! have stands in `real_pictures.csv`.

use std::path::{Path, PathBuf};

use image::imageops::{self, FilterType};
use image::{ImageBuffer, RgbImage};
use rayon::prelude::*;

use crate::base::color::linear_from_srgb;
use crate::base::statistics::quantile;
use crate::base::{Error, Image, Result};
use crate::formats::png;

/// Side of the compared pictures in pixels.
const SIDE: usize = 256;
/// Part of a masked picture's shorter side that the square inside the mask has.
const INSIDE_MASK: f64 = 0.7;
/// Luma (0 to 1) below which a pixel says nothing about colour, and the largest channel above which it is saturated.
const COLOUR_RANGE: (f64, f64) = (0.12, 0.96);
/// Spatial frequencies in cycles per picture to which the spectrum's slope is fitted.
const SLOPE_RANGE: std::ops::Range<usize> = 4..65;

/// Medians over real pictures, one row per set; see the file's first line for sources.
const REAL: &str = include_str!("real_pictures.csv");

/// Name, unit and meaning of every statistic, in the order of [`PictureStatistics::values`].
pub const STATISTICS: [(&str, &str); 17] = [
    ("luma_p5", "5 % quantile of luma, codes"),
    ("luma_p50", "median luma, codes"),
    ("luma_p95", "95 % quantile of luma, codes"),
    ("luma_ratio", "luma 95 % over luma 50 %"),
    ("saturated_pct", "pixels with a channel above .98, %"),
    ("dark_pct", "pixels of luma below .1, %"),
    ("glare_pct", "pixels whose every channel is above .82, %"),
    ("glare_spots", "connected regions of glare of at least 3 pixels"),
    ("r_over_g", "median linear red over green"),
    ("b_over_g", "median linear blue over green"),
    ("chroma_spread", "standard deviation of the logarithms of both ratios, together"),
    ("gradient_p50", "median gradient of luma at 128 x 128, codes a pixel"),
    ("gradient_p99", "99 % quantile of that gradient"),
    ("spectral_slope", "slope of the logarithm of the power spectrum"),
    ("noise_sigma", "noise at 256 x 256, codes (Immerkaer 1996)"),
    ("noise_full", "the same at full resolution"),
    ("centre_over_rim", "mean luma of the centre over that of the rim"),
];

/// Statistics of one picture, or medians over many.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureStatistics {
    /// In the order of [`STATISTICS`]; NaN where a picture has none.
    pub values: [f64; STATISTICS.len()],
}

/// A set of pictures: median, 10 % and 90 % quantile of every statistic.
#[derive(Clone, Debug)]
pub struct PictureSet {
    /// The folder's or file's name.
    pub name: String,
    /// Number of pictures.
    pub pictures: usize,
    /// Medians.
    pub median: PictureStatistics,
    /// 10 % and 90 % quantiles.
    pub spread: [PictureStatistics; 2],
}

impl PictureSet {
    /// Reads a picture, or every PNG of a folder in order of name. `masked`: cut to the square inside a round mask.
    ///
    /// Errors: nothing there, a folder without PNG, a damaged file.
    pub fn read(path: &Path, masked: bool) -> Result<PictureSet> {
        let files = pictures_of(path)?;
        let all: Vec<PictureStatistics> = files
            .par_iter()
            .map(|file| Ok(PictureStatistics::of(&png::read_rgb(file)?, masked)))
            .collect::<Result<_>>()?;
        let at = |share: f64| PictureStatistics {
            values: std::array::from_fn(|s| quantile_of_finite(all.iter().map(|p| p.values[s]), share)),
        };
        let name = path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned());
        Ok(PictureSet { name, pictures: files.len(), median: at(0.5), spread: [at(0.1), at(0.9)] })
    }
}

fn pictures_of(path: &Path) -> Result<Vec<PathBuf>> {
    if path.is_file() {
        return Ok(vec![path.to_owned()]);
    }
    let entries = path.read_dir().map_err(|e| Error::io("reading", path, e))?;
    let mut files = Vec::new();
    for entry in entries {
        let file = entry.map_err(|e| Error::io("reading", path, e))?.path();
        if file.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
            files.push(file);
        }
    }
    files.sort();
    if files.is_empty() {
        return Err(Error::input("holds no PNG picture").at(path));
    }
    Ok(files)
}

/// Smallest and largest median over the real sets, in the order of [`STATISTICS`]; `None` where no set says it.
pub fn real_ranges() -> Vec<Option<(f64, f64)>> {
    let mut lines = REAL.lines().filter(|line| !line.starts_with('#'));
    let header: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    STATISTICS
        .iter()
        .map(|(name, _)| {
            let column = header.iter().position(|h| h == name)?;
            let values = rows.iter().filter_map(|row| row.get(column)?.parse::<f64>().ok());
            values.fold(None, |range: Option<(f64, f64)>, v| {
                Some(range.map_or((v, v), |(low, high)| (low.min(v), high.max(v))))
            })
        })
        .collect()
}

impl PictureStatistics {
    /// Of one RGB picture of any size. `masked`: cut to the square inside a round mask first.
    pub fn of(picture: &Image<u8>, masked: bool) -> PictureStatistics {
        let full = square(picture, masked);
        let side = SIDE as u32;
        let scaled = imageops::resize(&full, side, side, FilterType::Lanczos3);
        let rgb: Vec<[f64; 3]> = scaled.pixels().map(|p| p.0.map(|v| f64::from(v) / 255.0)).collect();
        let luma: Vec<f64> = rgb.iter().map(luma_of).collect();
        let glare: Vec<bool> = rgb.iter().map(|v| v.iter().all(|&c| c > 0.82)).collect();
        let (red, blue): (Vec<f64>, Vec<f64>) = rgb
            .iter()
            .zip(&luma)
            .filter(|(v, l)| **l > COLOUR_RANGE.0 && v.iter().all(|&c| c < COLOUR_RANGE.1))
            .map(|(v, _)| {
                let [r, g, b] = v.map(|c| f64::from(linear_from_srgb(c as f32)));
                (r / g.max(1e-4), b / g.max(1e-4))
            })
            .unzip();
        let gradient = gradients(&luma);
        let share = |count: usize| 100.0 * count as f64 / rgb.len() as f64;
        let at = |share: f64| 255.0 * quantile_of_finite(luma.iter().copied(), share);
        let full_luma: Vec<f64> = full.pixels().map(|p| luma_of(&p.0.map(|v| f64::from(v) / 255.0))).collect();
        PictureStatistics {
            values: [
                at(0.05),
                at(0.5),
                at(0.95),
                at(0.95) / at(0.5).max(1e-9),
                share(rgb.iter().filter(|v| v.iter().any(|&c| c > 0.98)).count()),
                share(luma.iter().filter(|&&l| l < 0.1).count()),
                share(glare.iter().filter(|&&g| g).count()),
                spots(&glare) as f64,
                quantile_of_finite(red.iter().copied(), 0.5),
                quantile_of_finite(blue.iter().copied(), 0.5),
                deviation_of_logarithms(&red).hypot(deviation_of_logarithms(&blue)),
                quantile_of_finite(gradient.iter().copied(), 0.5),
                quantile_of_finite(gradient.iter().copied(), 0.99),
                spectral_slope(&luma),
                noise(&luma, SIDE),
                noise(&full_luma, full.width() as usize),
                centre_over_rim(&luma),
            ],
        }
    }
}

fn luma_of(v: &[f64; 3]) -> f64 {
    0.299 * v[0] + 0.587 * v[1] + 0.114 * v[2]
}

fn square(picture: &Image<u8>, masked: bool) -> RgbImage {
    let (width, height) = (picture.width as u32, picture.height as u32);
    let side = (f64::from(width.min(height)) * if masked { INSIDE_MASK } else { 1.0 }) as u32;
    let whole: RgbImage = ImageBuffer::from_fn(width, height, |x, y| {
        let pixel = picture.pixel(x as usize, y as usize);
        image::Rgb([pixel[0], pixel[1], pixel[2]])
    });
    imageops::crop_imm(&whole, (width - side) / 2, (height - side) / 2, side.max(1), side.max(1)).to_image()
}

/// The `share` quantile of the finite values, linear between ranks; NaN without any.
fn quantile_of_finite(values: impl Iterator<Item = f64>, share: f64) -> f64 {
    let finite: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    quantile(&finite, share).unwrap_or(f64::NAN)
}

fn deviation_of_logarithms(values: &[f64]) -> f64 {
    let logarithms: Vec<f64> = values.iter().map(|v| (v + 1e-6).ln()).collect();
    let mean = logarithms.iter().sum::<f64>() / logarithms.len() as f64;
    (logarithms.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / logarithms.len() as f64).sqrt()
}

/// Length of the gradient (central differences, one-sided at the rim) at half the size, in codes.
fn gradients(luma: &[f64]) -> Vec<f64> {
    let side = SIDE / 2;
    let half: Vec<f64> = (0..side * side)
        .map(|p| {
            let (x, y) = (2 * (p % side), 2 * (p / side));
            let at = |dx: usize, dy: usize| luma[(y + dy) * SIDE + x + dx];
            255.0 * 0.25 * (at(0, 0) + at(1, 0) + at(0, 1) + at(1, 1))
        })
        .collect();
    let slope = |k: usize, at: &dyn Fn(usize) -> f64| {
        let (low, high) = (k.saturating_sub(1), (k + 1).min(side - 1));
        (at(high) - at(low)) / (high - low) as f64
    };
    (0..side * side)
        .map(|p| {
            let (x, y) = (p % side, p / side);
            slope(x, &|k| half[y * side + k]).hypot(slope(y, &|k| half[k * side + x]))
        })
        .collect()
}

/// 8-connected regions of at least three pixels.
fn spots(mask: &[bool]) -> usize {
    let mut seen = vec![false; mask.len()];
    let mut count = 0;
    for start in 0..mask.len() {
        if !mask[start] || seen[start] {
            continue;
        }
        let (mut stack, mut size) = (vec![start], 0);
        seen[start] = true;
        while let Some(p) = stack.pop() {
            size += 1;
            let (x, y) = (p % SIDE, p / SIDE);
            for ny in y.saturating_sub(1)..(y + 2).min(SIDE) {
                for nx in x.saturating_sub(1)..(x + 2).min(SIDE) {
                    let n = ny * SIDE + nx;
                    if mask[n] && !seen[n] {
                        seen[n] = true;
                        stack.push(n);
                    }
                }
            }
        }
        count += usize::from(size >= 3);
    }
    count
}

/// Immerkaer's estimate (Computer Vision and Image Understanding 64, 1996): mean absolute response to the difference of
/// two Laplacians, which sees neither edges nor ramps; in codes.
fn noise(luma: &[f64], width: usize) -> f64 {
    let height = luma.len() / width.max(1);
    if width < 3 || height < 3 {
        return f64::NAN;
    }
    let weights = [1.0, -2.0, 1.0];
    let mut sum = 0.0;
    for y in 0..height - 2 {
        for x in 0..width - 2 {
            let mut response = 0.0;
            for (dy, wy) in weights.iter().enumerate() {
                for (dx, wx) in weights.iter().enumerate() {
                    response += wy * wx * luma[(y + dy) * width + x + dx];
                }
            }
            sum += response.abs();
        }
    }
    std::f64::consts::FRAC_PI_2.sqrt() / 6.0 * sum / ((width - 2) * (height - 2)) as f64 * 255.0
}

/// Least-squares slope of ln(power) over ln(frequency), the power averaged over directions, under a Hann window.
fn spectral_slope(luma: &[f64]) -> f64 {
    let mean = luma.iter().sum::<f64>() / luma.len() as f64;
    let window: Vec<f64> =
        (0..SIDE).map(|i| 0.5 - 0.5 * (std::f64::consts::TAU * i as f64 / (SIDE - 1) as f64).cos()).collect();
    let windowed: Vec<f64> = (0..SIDE * SIDE).map(|p| (luma[p] - mean) * window[p / SIDE] * window[p % SIDE]).collect();
    // Frequencies above the fitted ones are not needed: a plain transform of rows, then of columns.
    let top = SLOPE_RANGE.end as i64;
    let turns: Vec<(f64, f64)> =
        (0..SIDE).map(|k| (std::f64::consts::TAU * k as f64 / SIDE as f64).sin_cos()).map(|(s, c)| (c, -s)).collect();
    let frequencies: Vec<i64> = (-top..=top).collect();
    let rows: Vec<Vec<(f64, f64)>> = frequencies
        .iter()
        .map(|&f| {
            let at = |x: usize| turns[(f * x as i64).rem_euclid(SIDE as i64) as usize];
            (0..SIDE)
                .map(|y| {
                    (0..SIDE).fold((0.0, 0.0), |(re, im), x| {
                        let ((c, s), v) = (at(x), windowed[y * SIDE + x]);
                        (re + v * c, im + v * s)
                    })
                })
                .collect()
        })
        .collect();
    let mut sums = vec![(0.0, 0usize); SLOPE_RANGE.end + 1];
    for (column, &fx) in rows.iter().zip(&frequencies) {
        for &fy in &frequencies {
            let radius = ((fx * fx + fy * fy) as f64).sqrt() as usize;
            if !SLOPE_RANGE.contains(&radius) {
                continue;
            }
            let (re, im) = column.iter().enumerate().fold((0.0, 0.0), |(re, im), (y, v)| {
                let (c, s) = turns[(fy * y as i64).rem_euclid(SIDE as i64) as usize];
                (re + v.0 * c - v.1 * s, im + v.0 * s + v.1 * c)
            });
            sums[radius].0 += re * re + im * im;
            sums[radius].1 += 1;
        }
    }
    let points: Vec<(f64, f64)> =
        SLOPE_RANGE.map(|k| ((k as f64).ln(), (sums[k].0 / sums[k].1.max(1) as f64 + 1e-12).ln())).collect();
    let count = points.len() as f64;
    let (mx, my) = (points.iter().map(|p| p.0).sum::<f64>() / count, points.iter().map(|p| p.1).sum::<f64>() / count);
    let covariance: f64 = points.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum();
    covariance / points.iter().map(|p| (p.0 - mx).powi(2)).sum::<f64>()
}

fn centre_over_rim(luma: &[f64]) -> f64 {
    let mean = |low: i64, high: i64| {
        let (mut sum, mut count) = (0.0, 0usize);
        for (p, l) in luma.iter().enumerate() {
            let (x, y) = ((p % SIDE) as f64 - SIDE as f64 / 2.0, (p / SIDE) as f64 - SIDE as f64 / 2.0);
            let radius = x.hypot(y) as i64;
            if radius > low && radius < high {
                sum += l;
                count += 1;
            }
        }
        sum / count.max(1) as f64
    };
    mean(-1, 40) / mean(110, 126).max(1e-3)
}

/// One line per set of pictures, as CSV records under [`columns`].
pub fn records(sets: &[PictureSet]) -> Vec<Vec<String>> {
    sets.iter()
        .map(|set| {
            let mut record = vec![set.name.clone(), set.pictures.to_string()];
            for s in 0..STATISTICS.len() {
                let value = |of: &PictureStatistics| digits(of.values[s]);
                record.extend([value(&set.median), value(&set.spread[0]), value(&set.spread[1])]);
            }
            record
        })
        .collect()
}

/// Columns of [`records`].
pub fn columns() -> Vec<String> {
    let mut columns = vec!["what".to_owned(), "pictures".to_owned()];
    for (name, _) in STATISTICS {
        columns.extend([name.to_owned(), format!("{name}_p10"), format!("{name}_p90")]);
    }
    columns
}

/// One line per statistic: range over the real sets, range and median of the sets, whether the median lies inside.
pub fn markdown(sets: &[PictureSet]) -> String {
    let mut text = String::from("| statistic | meaning | real sets | these | median | inside |\n");
    text += "|---|---|--:|--:|--:|---|\n";
    for (s, ((name, meaning), real)) in STATISTICS.iter().zip(real_ranges()).enumerate() {
        let values = || sets.iter().map(|set| set.median.values[s]);
        let median = quantile_of_finite(values(), 0.5);
        let range = |low: f64, high: f64| format!("{} to {}", digits(low), digits(high));
        let inside = match real {
            Some((low, high)) if (low..=high).contains(&median) => "yes",
            Some(_) => "no",
            None => "-",
        };
        let real = real.map_or_else(|| "-".to_owned(), |(low, high)| range(low, high));
        let these = range(quantile_of_finite(values(), 0.0), quantile_of_finite(values(), 1.0));
        text += &format!("| `{name}` | {meaning} | {real} | {these} | {} | {inside} |\n", digits(median));
    }
    text
}

/// Three significant digits.
fn digits(value: f64) -> String {
    if !value.is_finite() {
        return "-".to_owned();
    }
    let decimals = (2 - value.abs().max(1e-3).log10().floor() as i32).clamp(0, 4) as usize;
    let text = format!("{value:.decimals$}");
    // What rounds to nothing has no sign.
    if text.trim_start_matches('-').contains(|c| ('1'..='9').contains(&c)) { text } else { text.replace('-', "") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_three_digits_and_nothing_has_no_sign() {
        let shown = [-0.00001, 0.0, -0.0523, 12.345, -123.4, f64::NAN].map(digits);
        assert_eq!(shown, ["0.0000", "0.0000", "-0.0523", "12.3", "-123", "-"]);
    }

    use crate::base::random::{CounterRng, Stage};

    fn picture(side: usize, value: impl Fn(usize, usize) -> [u8; 3]) -> Image<u8> {
        let data = (0..side * side).flat_map(|p| value(p % side, p / side)).collect();
        Image { width: side, height: side, channels: 3, data }
    }

    fn value(of: &PictureStatistics, name: &str) -> f64 {
        of.values[STATISTICS.iter().position(|s| s.0 == name).unwrap()]
    }

    #[test]
    fn a_ramp_has_the_quantiles_and_the_gradient_of_its_formula() {
        let of = PictureStatistics::of(&picture(256, |x, _| [x as u8; 3]), false);
        for (name, expected) in [("luma_p5", 12.75), ("luma_p50", 127.5), ("luma_p95", 242.25), ("gradient_p50", 2.0)] {
            assert!((value(&of, name) - expected).abs() < 0.8, "{name}: {}", value(&of, name));
        }
        assert!((value(&of, "luma_ratio") - 1.9).abs() < 0.01);
        assert!((value(&of, "r_over_g") - 1.0).abs() < 1e-6 && value(&of, "chroma_spread") < 1e-6);
        assert!(value(&of, "noise_sigma") < 0.05);
        // Codes of at least 250 of 255 are above .98.
        assert!((value(&of, "saturated_pct") - 100.0 * 6.0 / 256.0).abs() < 0.5);
    }

    #[test]
    fn noise_is_that_which_was_added() {
        let mut random = CounterRng::new(5, Stage::Test, &[3]);
        let noise: Vec<f64> = (0..256 * 256).map(|_| 3.0 * random.normal()).collect();
        let of = PictureStatistics::of(&picture(256, |x, y| [(128.0 + noise[y * 256 + x]).round() as u8; 3]), false);
        for name in ["noise_sigma", "noise_full"] {
            assert!((value(&of, name) - 3.0).abs() < 0.1, "{name}: {}", value(&of, name));
        }
        // White noise has a flat spectrum.
        assert!(value(&of, "spectral_slope").abs() < 0.1, "{}", value(&of, "spectral_slope"));
    }

    #[test]
    fn glare_is_counted_by_region() {
        let of = PictureStatistics::of(
            &picture(256, |x, y| if (x / 8) % 8 == 0 && (y / 8) % 8 == 0 { [255; 3] } else { [90, 40, 30] }),
            false,
        );
        assert_eq!(value(&of, "glare_spots"), 16.0);
        assert!((value(&of, "glare_pct") - 100.0 / 64.0).abs() < 0.3);
    }

    #[test]
    fn every_statistic_has_a_range_over_real_pictures() {
        for ((name, _), range) in STATISTICS.iter().zip(real_ranges()) {
            let (low, high) = range.unwrap_or_else(|| panic!("{name}"));
            assert!(low <= high, "{name}");
        }
        let set = PictureSet {
            name: "set".into(),
            pictures: 1,
            median: PictureStatistics { values: [1.7; STATISTICS.len()] },
            spread: [PictureStatistics { values: [1.0; STATISTICS.len()] }, PictureStatistics { values: [2.0; 17] }],
        };
        let text = markdown(std::slice::from_ref(&set));
        assert!(text.contains("1.58 to 1.92 | 1.70 to 1.70 | 1.70 | yes |"), "{text}");
        assert!(records(&[set]).iter().all(|record| record.len() == columns().len()));
    }
}
