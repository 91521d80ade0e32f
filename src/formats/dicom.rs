//! A folder of DICOM slices: one CT series, uncompressed.
//!
//! Read with the `dicom-object` crate. Slices are put in order by their place along the normal of their planes, never
//! by name or number. Left out: compressed pixels, several series in a folder, slices of unequal distance; each is
//! refused with the way out, which is `dcm2niix` (docs/decisions/0015-from-scans-to-case.md).

use std::path::{Path, PathBuf};

use dicom_object::{DefaultDicomObject, Tag, open_file};
use glam::{DMat3, DVec3};

use crate::base::{Error, Result, Volume, VoxelGrid};

const TRANSFER_SYNTAXES: [&str; 2] = ["1.2.840.10008.1.2", "1.2.840.10008.1.2.1"];
const MODALITY: Tag = Tag(0x0008, 0x0060);
const SERIES: Tag = Tag(0x0020, 0x000e);
const POSITION: Tag = Tag(0x0020, 0x0032);
const ORIENTATION: Tag = Tag(0x0020, 0x0037);
const SAMPLES_PER_PIXEL: Tag = Tag(0x0028, 0x0002);
const ROWS: Tag = Tag(0x0028, 0x0010);
const COLUMNS: Tag = Tag(0x0028, 0x0011);
const PIXEL_SPACING: Tag = Tag(0x0028, 0x0030);
const BITS_ALLOCATED: Tag = Tag(0x0028, 0x0100);
const PIXEL_REPRESENTATION: Tag = Tag(0x0028, 0x0103);
const INTERCEPT: Tag = Tag(0x0028, 0x1052);
const SLOPE: Tag = Tag(0x0028, 0x1053);
const PIXELS: Tag = Tag(0x7fe0, 0x0010);

/// The way out that every refusal of a kind of DICOM names.
const CURE: &str = "`dcm2niix -z y -o OUT DIR` makes a .nii.gz of the folder";
/// Most that distances between slices differ, as a part of the distance.
const UNEVEN: f64 = 0.05;
/// Most slices.
const MOST_SLICES: usize = 4096;

/// What must agree between slices, and where a slice lies.
struct SliceHeader {
    path: PathBuf,
    series: String,
    size: [usize; 2],
    /// Directions of the rows and of the columns.
    directions: [DVec3; 2],
    /// Distance in mm between columns and between rows.
    spacing_mm: [f64; 2],
    position_mm: DVec3,
    pixels: Vec<i16>,
}

/// Reads the series in `folder`: HU. Files that are no DICOM are passed over.
///
/// Errors name the file and what it lacks; or say what the folder is instead of one CT series, and the cure.
pub fn read_folder(folder: &Path) -> Result<Volume<i16>> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io("reading", folder, e))?;
    let mut paths: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.retain(|path| path.is_file());
    paths.sort();
    let mut slices: Vec<SliceHeader> = Vec::new();
    for path in paths {
        // DICOM files need have no ending, and folders of exports hold indices and pictures besides.
        let Ok(object) = open_file(&path) else { continue };
        if object.element(PIXELS).is_err() {
            continue;
        }
        if slices.len() == MOST_SLICES {
            return Err(Error::input(format!("holds more than {MOST_SLICES} slices")).at(folder));
        }
        slices.push(slice(&object, &path).map_err(|e| e.at(&path))?);
    }
    stacked(slices).map_err(|e| e.at(folder))
}

fn slice(object: &DefaultDicomObject, path: &Path) -> Result<SliceHeader> {
    let missing = |tag: Tag| Error::input(format!("is missing: {CURE}")).element(format!("DICOM tag {tag}"));
    let numbers = |tag: Tag| -> Result<Vec<f64>> {
        let element = object.element(tag).map_err(|_| missing(tag))?;
        element.to_multi_float64().map_err(|_| missing(tag))
    };
    let number = |tag: Tag| numbers(tag)?.first().copied().ok_or_else(|| missing(tag));
    let text = |tag: Tag| object.element(tag).ok().and_then(|e| e.to_str().ok()).map(|t| t.trim().to_owned());
    let modality = text(MODALITY).unwrap_or_default();
    if modality != "CT" {
        return Err(Error::input(format!("is of modality `{modality}`, and CT is wanted")));
    }
    let syntax = object.meta().transfer_syntax().trim_end_matches(['\0', ' ']).to_owned();
    if !TRANSFER_SYNTAXES.contains(&syntax.as_str()) {
        return Err(Error::input(format!("is compressed (transfer syntax {syntax}): {CURE}")));
    }
    let size = [number(COLUMNS)?, number(ROWS)?].map(|n| n as usize);
    let is_signed = number(PIXEL_REPRESENTATION)? == 1.0;
    if number(BITS_ALLOCATED)? != 16.0 || number(SAMPLES_PER_PIXEL)? != 1.0 {
        return Err(Error::input(format!("has no pixels of one 16-bit number: {CURE}")));
    }
    let triple = |values: &[f64]| <[f64; 3]>::try_from(values).map(DVec3::from_array).ok();
    let position_mm = triple(&numbers(POSITION)?).ok_or_else(|| missing(POSITION))?;
    let orientation = numbers(ORIENTATION)?;
    let directions = match orientation.len() {
        6 => [0, 3].map(|at| triple(&orientation[at..at + 3]).unwrap_or_default()),
        _ => return Err(missing(ORIENTATION)),
    };
    let [between_rows, between_columns] =
        <[f64; 2]>::try_from(numbers(PIXEL_SPACING)?).map_err(|_| missing(PIXEL_SPACING))?;
    let (slope, intercept) = (number(SLOPE)?, number(INTERCEPT)?);
    let bytes = object.element(PIXELS).map_err(|_| missing(PIXELS))?.to_bytes().map_err(|_| missing(PIXELS))?;
    let count = size[0] * size[1];
    if bytes.len() < 2 * count {
        return Err(Error::input(format!("ends early: {} of {count} pixels are there", bytes.len() / 2)));
    }
    let hounsfield = |pair: &[u8]| {
        let word = [pair[0], pair[1]];
        let stored = if is_signed { i16::from_le_bytes(word).into() } else { u16::from_le_bytes(word).into() };
        let stored: f64 = stored;
        (stored * slope + intercept).round() as i16
    };
    Ok(SliceHeader {
        path: path.to_path_buf(),
        series: text(SERIES).unwrap_or_default(),
        size,
        directions,
        spacing_mm: [between_columns, between_rows],
        position_mm,
        pixels: bytes.chunks_exact(2).take(count).map(hounsfield).collect(),
    })
}

fn stacked(mut slices: Vec<SliceHeader>) -> Result<Volume<i16>> {
    let Some(first) = slices.first() else {
        return Err(Error::input("holds no DICOM slices of a CT"));
    };
    let mut series: Vec<&str> = slices.iter().map(|s| s.series.as_str()).collect();
    series.sort_unstable();
    series.dedup();
    if series.len() > 1 {
        return Err(Error::input(format!(
            "holds {} series, and one is wanted: put the slices of the wanted one into a folder of their own, or {CURE} \
             for each",
            series.len()
        )));
    }
    let normal = first.directions[0].cross(first.directions[1]).normalize_or_zero();
    let (size, spacing, directions) = (first.size, first.spacing_mm, first.directions);
    let agrees = |s: &SliceHeader| {
        s.size == size && s.spacing_mm == spacing && (0..2).all(|k| s.directions[k].distance(directions[k]) < 1e-3)
    };
    if let Some(other) = slices.iter().find(|s| !agrees(s)) {
        let sentence = format!("has another size, spacing or orientation than the other slices: {CURE}");
        return Err(Error::input(sentence).at(&other.path));
    }
    let height = |s: &SliceHeader| s.position_mm.dot(normal);
    slices.sort_by(|a, b| height(a).total_cmp(&height(b)));
    if slices.len() < 2 {
        return Err(Error::input("holds one slice, and a volume has more"));
    }
    let step = (slices[slices.len() - 1].position_mm - slices[0].position_mm) / (slices.len() - 1) as f64;
    for pair in slices.windows(2) {
        let off = (pair[1].position_mm - pair[0].position_mm).distance(step);
        if off.is_nan() || off > UNEVEN * step.length() || height(&pair[1]) <= height(&pair[0]) {
            let sentence = format!(
                "lies {:.2} mm from the slice before it and not {:.2} mm: slices are missing, double, or from several \
                 breathing phases",
                height(&pair[1]) - height(&pair[0]),
                step.dot(normal)
            );
            return Err(Error::input(sentence).at(&pair[1].path));
        }
    }
    let grid = VoxelGrid {
        size: [size[0], size[1], slices.len()],
        origin_mm: slices[0].position_mm,
        axes_mm: DMat3::from_cols(directions[0] * spacing[0], directions[1] * spacing[1], step),
    };
    grid.validate(2.0)?;
    Ok(Volume { grid, data: slices.iter().flat_map(|s| s.pixels.iter().copied()).collect() })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An element in explicit representation, little endian.
    fn element(group: u16, number: u16, kind: &str, value: &[u8]) -> Vec<u8> {
        let mut padded = value.to_vec();
        if padded.len() % 2 == 1 {
            padded.push(if kind == "UI" { 0 } else { b' ' });
        }
        let mut bytes = [group.to_le_bytes(), number.to_le_bytes()].concat();
        bytes.extend(kind.bytes());
        if kind == "OW" || kind == "OB" {
            bytes.extend([0, 0]);
            bytes.extend((padded.len() as u32).to_le_bytes());
        } else {
            bytes.extend((padded.len() as u16).to_le_bytes());
        }
        [bytes, padded].concat()
    }

    /// A file of 3 x 2 pixels at height `z` in series `series`, all of whose pixels hold `stored`.
    fn write(folder: &Path, name: &str, z: f64, series: &str, stored: i16, syntax: &str) {
        let meta = [
            element(2, 1, "OB", &[0, 1]),
            element(2, 2, "UI", b"1.2.840.10008.5.1.4.1.1.2"),
            element(2, 3, "UI", b"1.2.3"),
            element(2, 0x10, "UI", syntax.as_bytes()),
            element(2, 0x12, "UI", b"1.2.3.4"),
        ]
        .concat();
        let pixels: Vec<u8> = (0..6).flat_map(|_| stored.to_le_bytes()).collect();
        let data = [
            element(8, 0x16, "UI", b"1.2.840.10008.5.1.4.1.1.2"),
            element(8, 0x18, "UI", b"1.2.3"),
            element(8, 0x60, "CS", b"CT"),
            element(0x20, 0xe, "UI", series.as_bytes()),
            element(0x20, 0x32, "DS", format!("-10\\20\\{z}").as_bytes()),
            element(0x20, 0x37, "DS", b"1\\0\\0\\0\\1\\0"),
            element(0x28, 2, "US", &1u16.to_le_bytes()),
            element(0x28, 0x10, "US", &2u16.to_le_bytes()),
            element(0x28, 0x11, "US", &3u16.to_le_bytes()),
            element(0x28, 0x30, "DS", b"0.8\\0.7"),
            element(0x28, 0x100, "US", &16u16.to_le_bytes()),
            element(0x28, 0x103, "US", &1u16.to_le_bytes()),
            element(0x28, 0x1052, "DS", b"-1024"),
            element(0x28, 0x1053, "DS", b"2"),
            element(0x7fe0, 0x10, "OW", &pixels),
        ]
        .concat();
        let length = element(2, 0, "UL", &(meta.len() as u32).to_le_bytes());
        std::fs::write(folder.join(name), [vec![0; 128], b"DICM".to_vec(), length, meta, data].concat()).unwrap();
    }

    const PLAIN: &str = TRANSFER_SYNTAXES[1];

    #[test]
    fn slices_are_stacked_by_their_place_and_scaled_to_hounsfield_units() {
        let folder = tempfile::tempdir().unwrap();
        for (name, k) in [("c", 0), ("a", 2), ("b", 1)] {
            write(folder.path(), name, 100.0 + 1.5 * f64::from(k), "1.2", 10 + k, PLAIN);
        }
        std::fs::write(folder.path().join("notes.txt"), "no slice").unwrap();
        let volume = read_folder(folder.path()).unwrap();
        assert_eq!(volume.grid.size, [3, 2, 3]);
        assert!((volume.grid.spacing_mm() - DVec3::new(0.7, 0.8, 1.5)).length() < 1e-9);
        assert!((volume.grid.origin_mm - DVec3::new(-10.0, 20.0, 100.0)).length() < 1e-9);
        assert_eq!([0, 1, 2].map(|k| volume.value([1, 1, k])), [-1004, -1002, -1000]);
    }

    #[test]
    fn what_is_no_plain_series_is_refused_with_the_way_out() {
        let said = |files: &[(&str, f64, &str, &str)]| {
            let folder = tempfile::tempdir().unwrap();
            files.iter().for_each(|(name, z, series, syntax)| write(folder.path(), name, *z, series, 0, syntax));
            read_folder(folder.path()).unwrap_err().to_string()
        };
        assert!(said(&[]).contains("no DICOM slices"));
        assert!(said(&[("a", 0.0, "1", PLAIN), ("b", 1.0, "2", PLAIN)]).contains("holds 2 series"));
        let gap = said(&[("a", 0.0, "1", PLAIN), ("b", 1.0, "1", PLAIN), ("c", 4.0, "1", PLAIN)]);
        assert!(gap.contains("slices are missing"), "{gap}");
        assert!(said(&[("a", 0.0, "1", PLAIN), ("b", 0.0, "1", PLAIN)]).contains("slices are missing"));
        let packed = said(&[("a", 0.0, "1", "1.2.840.10008.1.2.4.70"), ("b", 1.0, "1", PLAIN)]);
        assert!(packed.contains("dcm2niix -z y") && packed.contains("compressed"), "{packed}");
    }
}
