//! A folder of DICOM slices: one CT series, uncompressed.
//!
//! Slices are put in order by their place along the normal of their planes, never
//! by name or number. Left out: compressed pixels, several slices in a file, several series in a folder, slices of
//! unequal distance; each is refused with the way out, which is `dcm2niix`
//! (docs/decisions/0015-from-scans-to-case.md).

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};

use super::dicom_elements::{Elements, MAGIC_END, PIXELS, Tag, begin};
use super::volume_samples::hounsfield;
use crate::base::estimate::demand_memory;
use crate::base::range::NumberRange;
use crate::base::volume::MOST_VOXELS_A_SIDE;
use crate::base::{Error, Result, Volume, VoxelGrid, files};

const CLASS: Tag = Tag(0x0002, 0x0002);
const MODALITY: Tag = Tag(0x0008, 0x0060);
const SERIES: Tag = Tag(0x0020, 0x000e);
const POSITION: Tag = Tag(0x0020, 0x0032);
const ORIENTATION: Tag = Tag(0x0020, 0x0037);
const SAMPLES_PER_PIXEL: Tag = Tag(0x0028, 0x0002);
const ROWS: Tag = Tag(0x0028, 0x0010);
const COLUMNS: Tag = Tag(0x0028, 0x0011);
const PIXEL_SPACING: Tag = Tag(0x0028, 0x0030);
const BITS_ALLOCATED: Tag = Tag(0x0028, 0x0100);
const BITS_STORED: Tag = Tag(0x0028, 0x0101);
const HIGH_BIT: Tag = Tag(0x0028, 0x0102);
const PIXEL_REPRESENTATION: Tag = Tag(0x0028, 0x0103);
const INTERCEPT: Tag = Tag(0x0028, 0x1052);
const SLOPE: Tag = Tag(0x0028, 0x1053);

/// The way out that every refusal of a kind of DICOM names.
const CURE: &str = "`dcm2niix -z y -o OUT DIR` makes a .nii.gz of the folder (scripts/setup.sh --ct installs it)";
/// Transfer syntaxes that need words of their own: whole files packed by zlib, which dcm2niix does not read either, and
/// the other byte order.
const DEFLATED: &str = "1.2.840.10008.1.2.1.99";
const BIG_ENDIAN: &str = "1.2.840.10008.1.2.2";
/// Bits of a stored number, and the place of its highest.
const STORED_BITS: NumberRange = NumberRange::new(1.0, 16.0);
const BIT: NumberRange = NumberRange::new(0.0, 15.0);
/// Class of a slice of a CT, and how the classes of files begin that hold many.
const CT_SLICE: &str = "1.2.840.10008.5.1.4.1.1.2";
const CT_SLICES: &str = "1.2.840.10008.5.1.4.1.1.2.";
/// Most that distances between slices differ, as a part of the distance.
const UNEVEN: f64 = 0.05;
/// Most slices.
const MOST_SLICES: usize = 4096;
/// Rows and columns of a slice.
const SIDE: NumberRange = NumberRange::new(1.0, MOST_VOXELS_A_SIDE as f64);
/// What turns stored numbers into Hounsfield units.
const SCALE: NumberRange = NumberRange::new(-1e6, 1e6);
/// Coordinates in mm.
const PLACE: NumberRange = NumberRange::new(-1e5, 1e5);
/// Distances of pixels in mm.
const SPACING_MM: NumberRange = NumberRange::new(1e-3, 100.0);
/// Components of directions.
const COSINE: NumberRange = NumberRange::new(-1.01, 1.01);
/// Most that the length of a direction differs from 1, and the cosine of the angle between both from 0: files round.
const SKEW: f64 = 0.01;

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

/// Reads the series in `folder`: HU. Files that are no DICOM are passed over, and so is DICOM without pixels that is no
/// slice of a CT; a slice that is damaged is not.
///
/// Errors name the file and what it lacks; or say what the folder is instead of one CT series, and the cure.
pub fn read_folder(folder: &Path) -> Result<Volume<i16>> {
    let paths = files::all_directly_in(folder)?;
    // A slice whose content was not fetched is one that is missing.
    for name in files::names_in(folder)? {
        let path = folder.join(name);
        if path.is_symlink() && !path.exists() {
            return Err(Error::input("is a link to nowhere: fetch its content, or remove it").at(path));
        }
    }
    let mut slices: Vec<SliceHeader> = Vec::new();
    for path in &paths {
        let Some(slice) = read_slice(path).map_err(|e| e.at(path))? else { continue };
        if slices.len() == MOST_SLICES {
            return Err(Error::input(format!("holds more than {MOST_SLICES} slices")).at(folder));
        }
        match slices.first() {
            // The slices, and the volume that is made of them.
            None => demand_memory("its slices", 4.0 * (slice.pixels.len() * paths.len()) as f64)
                .map_err(|e| e.at(folder))?,
            Some(first) if first.series != slice.series => return Err(other_series(&first.path).at(path)),
            Some(first) if first.size != slice.size => return Err(other_slice().at(path)),
            Some(_) => {}
        }
        slices.push(slice);
    }
    stacked(slices).map_err(|e| e.at(folder))
}

/// CT in a folder that [`read_folder`] does not read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PackedSlices {
    /// Files with one slice each.
    pub single: usize,
    /// Files with many slices each.
    pub many: usize,
}

/// What is to be unpacked in `folder`; `None` where every CT is stored as [`read_folder`] reads it: uncompressed, one
/// slice in a file.
///
/// Errors: a file that cannot be read. What is damaged is left to [`read_folder`].
pub fn packed_slices(folder: &Path) -> Result<Option<PackedSlices>> {
    let mut found = PackedSlices { single: 0, many: 0 };
    let mut is_packed = false;
    for path in files::all_directly_in(folder)? {
        let Some(elements_at) = beginning(&path)? else { continue };
        let bytes = files::read_bytes(&path)?;
        let Ok(elements) = Elements::read(&bytes, elements_at) else { continue };
        // Nothing here unpacks it, and the reader says so.
        if elements.transfer_syntax == DEFLATED {
            return Ok(None);
        }
        let class = elements.text(CLASS).unwrap_or_default();
        let (is_single, is_many) = (class == CT_SLICE, class.starts_with(CT_SLICES));
        found.single += usize::from(is_single);
        found.many += usize::from(is_many);
        is_packed |= is_many || is_single && !elements.is_plain();
    }
    Ok(is_packed.then_some(found))
}

fn other_series(first: &Path) -> Error {
    Error::input(format!(
        "is of another series than {}, a localizer or another reconstruction: put the slices of the wanted series into a \
         folder of their own, or {CURE} for each",
        first.file_name().unwrap_or_default().to_string_lossy()
    ))
}

/// Why the elements of a file cannot be read, by its transfer syntax.
fn unreadable(transfer_syntax: &str) -> Error {
    Error::input(match transfer_syntax {
        DEFLATED => format!(
            "is deflated (transfer syntax {DEFLATED}), which dcm2niix does not read either: `dcmconv +te IN OUT` (DCMTK) \
             writes each slice plainly"
        ),
        BIG_ENDIAN => format!("is stored big-endian (transfer syntax {BIG_ENDIAN}): {CURE}"),
        other => format!("is compressed (transfer syntax {other}): {CURE}"),
    })
}

fn other_slice() -> Error {
    Error::input(format!("has another size, spacing or orientation than the other slices: {CURE}"))
}

/// Where the elements of a DICOM file begin; `None` where it is none. DICOM files need have no ending, and folders of
/// exports hold indices and pictures besides.
fn beginning(path: &Path) -> Result<Option<usize>> {
    let mut start = Vec::with_capacity(MAGIC_END);
    let opened = File::open(path).and_then(|file| file.take(MAGIC_END as u64).read_to_end(&mut start));
    opened.map_err(|e| Error::io("reading", path, e))?;
    Ok(begin(&start))
}

/// The slice in a file; `None` where the file is none of a CT.
fn read_slice(path: &Path) -> Result<Option<SliceHeader>> {
    let Some(elements_at) = beginning(path)? else {
        if path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("dcm")) {
            return Err(Error::input(format!("is called .dcm and is no DICOM file, or a damaged one: {CURE}")));
        }
        return Ok(None);
    };
    let bytes = files::read_bytes(path)?;
    let elements = Elements::read(&bytes, elements_at)?;
    let is_slice = elements.text(CLASS).as_deref() == Some(CT_SLICE)
        || elements.text(MODALITY).as_deref() == Some("CT")
        || elements.bytes(ROWS).is_some();
    if elements.is_plain() && elements.bytes(PIXELS).is_none() && !is_slice {
        return Ok(None);
    }
    slice(&elements, path).map(Some)
}

fn slice(elements: &Elements<'_>, path: &Path) -> Result<SliceHeader> {
    if elements.transfer_syntax.is_empty() {
        return Err(Error::input(format!("is damaged: it names no transfer syntax: {CURE}")));
    }
    if !elements.is_plain() {
        return Err(unreadable(&elements.transfer_syntax));
    }
    let missing = |tag: Tag| Error::input(format!("is missing: {CURE}")).element(format!("DICOM tag {tag}"));
    // Exactly `N` numbers in range.
    fn some<const N: usize>(elements: &Elements<'_>, tag: Tag, range: NumberRange) -> Result<Option<[f64; N]>> {
        let Some(numbers) = elements.numbers(tag).and_then(|n| <[f64; N]>::try_from(n).ok()) else { return Ok(None) };
        let check = |&n: &f64| range.check(n).map_err(|e| e.element(format!("DICOM tag {tag}")));
        numbers.iter().try_for_each(check).map(|()| Some(numbers))
    }
    let number = |tag: Tag, range| -> Result<f64> {
        let [value] = some(elements, tag, range)?.ok_or_else(|| missing(tag))?;
        Ok(value)
    };
    let modality = elements.text(MODALITY).unwrap_or_default();
    if modality != "CT" {
        return Err(Error::input(format!("is of modality `{modality}`, and CT is wanted")));
    }
    let size = [number(COLUMNS, SIDE)?, number(ROWS, SIDE)?].map(|n| n as usize);
    let is_signed = number(PIXEL_REPRESENTATION, SIDE.or_zero())? == 1.0;
    if number(BITS_ALLOCATED, SIDE)? != 16.0 || number(SAMPLES_PER_PIXEL, SIDE)? != 1.0 {
        return Err(Error::input(format!("has no pixels of one 16-bit number: {CURE}")));
    }
    let position_mm = some(elements, POSITION, PLACE)?.ok_or_else(|| missing(POSITION))?;
    let [a, b, c, d, e, f] = some(elements, ORIENTATION, COSINE)?.ok_or_else(|| missing(ORIENTATION))?;
    let directions = [DVec3::new(a, b, c), DVec3::new(d, e, f)];
    let is_unit = directions.iter().all(|direction| (direction.length() - 1.0).abs() <= SKEW);
    if !is_unit || directions[0].dot(directions[1]).abs() > SKEW {
        let sentence = "must be two directions of length 1, square to each other";
        return Err(Error::input(sentence).element(format!("DICOM tag {ORIENTATION}")));
    }
    let [between_rows, between_columns] =
        some(elements, PIXEL_SPACING, SPACING_MM)?.ok_or_else(|| missing(PIXEL_SPACING))?;
    let (slope, intercept) = (number(SLOPE, SCALE)?, number(INTERCEPT, SCALE)?);
    let bytes = elements.bytes(PIXELS).ok_or_else(|| missing(PIXELS))?;
    let count = size[0] * size[1];
    if bytes.len() < 2 * count {
        return Err(Error::input(format!("ends early: {} of {count} pixels are there", bytes.len() / 2)));
    }
    let [bits] = some(elements, BITS_STORED, STORED_BITS)?.unwrap_or([16.0]);
    let [high_bit] = some(elements, HIGH_BIT, BIT)?.unwrap_or([bits - 1.0]);
    if high_bit + 1.0 < bits {
        let sentence = format!("is {high_bit}, below the {bits} bits that are stored");
        return Err(Error::input(sentence).element(format!("DICOM tag {HIGH_BIT}")));
    }
    // The bits above and below belong to nothing (PS3.5, 8.1.1): out to the left, and back with the sign.
    let (above, unused) = (15 - high_bit as u32, 16 - bits as u32);
    let units = |word: &[u8; 2]| {
        let aligned = u16::from_le_bytes(*word) << above;
        let stored = if is_signed { f64::from(aligned as i16 >> unused) } else { f64::from(aligned >> unused) };
        hounsfield(stored * slope + intercept)
    };
    Ok(SliceHeader {
        path: path.to_path_buf(),
        series: elements.text(SERIES).unwrap_or_default(),
        size,
        directions,
        spacing_mm: [between_columns, between_rows],
        position_mm: DVec3::from_array(position_mm),
        pixels: bytes.as_chunks::<2>().0[..count].iter().map(units).collect::<Result<_>>()?,
    })
}

fn stacked(mut slices: Vec<SliceHeader>) -> Result<Volume<i16>> {
    let Some(first) = slices.first() else {
        return Err(Error::input("holds no DICOM slices of a CT"));
    };
    let normal = first.directions[0].cross(first.directions[1]).normalize_or_zero();
    let (size, spacing, directions) = (first.size, first.spacing_mm, first.directions);
    let agrees = |s: &SliceHeader| {
        s.size == size && s.spacing_mm == spacing && (0..2).all(|k| s.directions[k].distance(directions[k]) < 1e-3)
    };
    if let Some(other) = slices.iter().find(|s| !agrees(s)) {
        return Err(other_slice().at(&other.path));
    }
    let height = |s: &SliceHeader| s.position_mm.dot(normal);
    slices.sort_by(|a, b| height(a).total_cmp(&height(b)));
    if slices.len() < 2 {
        return Err(Error::input("holds one slice, and a volume has more"));
    }
    let step = (slices[slices.len() - 1].position_mm - slices[0].position_mm) / (slices.len() - 1) as f64;
    let mut steps: Vec<DVec3> = slices.windows(2).map(|pair| pair[1].position_mm - pair[0].position_mm).collect();
    steps.sort_by(|a, b| a.dot(normal).total_cmp(&b.dot(normal)));
    // What a gap does not change, as it does the mean.
    let usual = steps[steps.len() / 2];
    for pair in slices.windows(2) {
        let off = (pair[1].position_mm - pair[0].position_mm).distance(usual);
        if off.is_nan() || off > UNEVEN * usual.length() || height(&pair[1]) <= height(&pair[0]) {
            let sentence = format!(
                "lies {:.2} mm from the slice before it and not {:.2} mm: slices are missing, double, or from several \
                 breathing phases",
                height(&pair[1]) - height(&pair[0]),
                usual.dot(normal)
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
    let mut data = Vec::with_capacity(grid.count());
    slices.into_iter().for_each(|slice| data.extend(slice.pixels));
    Ok(Volume { grid, data })
}

#[cfg(test)]
pub(crate) mod tests {
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
    pub(crate) fn write(folder: &Path, name: &str, z: f64, series: &str, stored: i16, syntax: &str) {
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
            element(0x20, 0x13, "IS", format!("{}", (10.0 * z) as i32).as_bytes()),
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
            if syntax == RLE { run_lengths(stored) } else { element(0x7fe0, 0x10, "OW", &pixels) },
        ]
        .concat();
        let length = element(2, 0, "UL", &(meta.len() as u32).to_le_bytes());
        std::fs::write(folder.join(name), [vec![0; 128], b"DICM".to_vec(), length, meta, data].concat()).unwrap();
    }

    pub(crate) const PLAIN: &str = "1.2.840.10008.1.2.1";
    pub(crate) const RLE: &str = "1.2.840.10008.1.2.5";

    /// Pixels that all hold `stored`, as the run-length encoding of DICOM PS3.5, annex G: an empty table of offsets, one
    /// item with a table of its two segments (high bytes, low bytes), each of one run.
    fn run_lengths(stored: i16) -> Vec<u8> {
        let [high, low] = stored.to_be_bytes();
        let mut item: Vec<u8> = [2u32, 64, 66].iter().flat_map(|n| n.to_le_bytes()).collect();
        item.resize(64, 0);
        // Six times the same byte: 1 - 6.
        item.extend([(-5i8) as u8, high, (-5i8) as u8, low]);
        let part = |mark: [u8; 4], bytes: &[u8]| [&mark[..], &(bytes.len() as u32).to_le_bytes(), bytes].concat();
        let begin = [0xe0, 0x7f, 0x10, 0, b'O', b'B', 0, 0, 0xff, 0xff, 0xff, 0xff];
        let [item_mark, end_mark] = [[0xfe, 0xff, 0, 0xe0], [0xfe, 0xff, 0xdd, 0xe0]];
        [begin.to_vec(), part(item_mark, &[]), part(item_mark, &item), part(end_mark, &[])].concat()
    }

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
        assert!(said(&[("a", 0.0, "1", PLAIN), ("b", 1.0, "2", PLAIN)]).contains("is of another series than a"));
        let gap = said(&[("a", 0.0, "1", PLAIN), ("b", 1.0, "1", PLAIN), ("c", 4.0, "1", PLAIN)]);
        assert!(gap.contains("slices are missing"), "{gap}");
        let gap: Vec<(String, f64)> = [0.0, 2.5, 5.0, 10.0, 12.5].map(|z| (format!("s{z}"), z)).to_vec();
        let gap: Vec<_> = gap.iter().map(|(name, z)| (name.as_str(), *z, "1", PLAIN)).collect();
        assert!(said(&gap).contains("lies 5.00 mm from the slice before it and not 2.50 mm"), "{}", said(&gap));
        let deflated = said(&[("a", 0.0, "1", DEFLATED), ("b", 1.0, "1", DEFLATED)]);
        assert!(deflated.contains("dcmconv") && !deflated.contains("-z y"), "{deflated}");
        assert!(said(&[("a", 0.0, "1", PLAIN), ("b", 0.0, "1", PLAIN)]).contains("slices are missing"));
        let packed = said(&[("a", 0.0, "1", "1.2.840.10008.1.2.4.70"), ("b", 1.0, "1", PLAIN)]);
        assert!(packed.contains("dcm2niix -z y") && packed.contains("compressed"), "{packed}");
    }

    /// Three slices, the file `name` of which `change` has changed.
    fn read_changed(name: &str, change: impl Fn(&mut Vec<u8>)) -> Result<Volume<i16>, String> {
        let folder = tempfile::tempdir().unwrap();
        for (name, z) in [("a", 0.0), ("b", 1.0), ("c", 2.0)] {
            write(folder.path(), name, z, "1", 10, PLAIN);
        }
        let path = folder.path().join(name);
        let mut bytes = std::fs::read(&path).unwrap_or_default();
        change(&mut bytes);
        std::fs::write(&path, bytes).unwrap();
        read_folder(folder.path()).map_err(|e| e.to_string())
    }

    /// 12 bits and a sign, without the sign in the bits above: -1000 was 3096.
    #[test]
    fn numbers_of_fewer_bits_are_masked_and_get_their_sign() {
        let units = |word: u16, bits: u16, high_bit: u16| {
            let folder = tempfile::tempdir().unwrap();
            for (name, z) in [("a", 0.0), ("b", 1.0)] {
                write(folder.path(), name, z, "1", word as i16, PLAIN);
                let path = folder.path().join(name);
                let mut bytes = std::fs::read(&path).unwrap();
                let at = find(&bytes, &[0x28, 0, 3, 1]);
                let stored = [element(0x28, 0x101, "US", &bits.to_le_bytes()), {
                    element(0x28, 0x102, "US", &high_bit.to_le_bytes())
                }];
                bytes.splice(at..at, stored.concat());
                std::fs::write(&path, bytes).unwrap();
            }
            read_folder(folder.path()).map(|volume| (volume.data[0] + 1024) / 2).map_err(|e| e.to_string())
        };
        let minus = (-1000i16) as u16;
        assert_eq!(units(minus & 0x0fff, 12, 11).unwrap(), -1000);
        assert_eq!(units(minus, 12, 11).unwrap(), -1000);
        assert_eq!(units(0x8000 | 40, 12, 11).unwrap(), 40);
        assert_eq!(units((minus & 0x0fff) << 4, 12, 15).unwrap(), -1000);
        assert!(units(0, 12, 10).unwrap_err().contains("DICOM tag (0028,0102): is 10"));
    }

    fn find(bytes: &[u8], what: &[u8]) -> usize {
        bytes.windows(what.len()).position(|window| window == what).unwrap()
    }

    /// Passed over as no DICOM, it cropped the volume: at either end nobody missed it.
    #[test]
    fn a_damaged_slice_is_refused_wherever_it_ends() {
        let whole = read_changed("c", |_| {}).unwrap();
        assert_eq!(whole.grid.size, [3, 2, 3]);
        let length = std::cell::Cell::new(0);
        read_changed("c", |bytes| length.set(bytes.len())).unwrap();
        // From where the magic says that it is DICOM.
        for end in MAGIC_END..length.get() {
            let said = read_changed("c", |bytes| bytes.truncate(end)).unwrap_err();
            assert!(said.contains("/c: "), "{end}: {said}");
        }
        let said = read_changed("d.dcm", |bytes| bytes.extend([7; 40])).unwrap_err();
        assert!(said.contains("d.dcm: is called .dcm and is no DICOM file"), "{said}");
        assert!(read_changed("notes", |bytes| bytes.extend([7; 400])).is_ok());
    }

    /// 4 GB were zeroed for a file of a kilobyte, and products wrapped.
    #[test]
    fn lengths_sizes_and_scales_are_checked_before_they_are_used() {
        let at = |bytes: &[u8], tag: Tag| find(bytes, &[tag.0.to_le_bytes(), tag.1.to_le_bytes()].concat());
        let said = read_changed("b", |bytes| {
            let length = at(bytes, PIXELS) + 8;
            bytes[length..length + 4].copy_from_slice(&0xffff_fff0u32.to_le_bytes());
        });
        assert!(said.unwrap_err().contains("ends within DICOM tag (7FE0,0010), which has 4294967280 bytes"));
        for (tag, kind, value) in [
            (ROWS, b"UL", u32::MAX.to_le_bytes().to_vec()),
            (COLUMNS, b"FD", 1e300f64.to_le_bytes().to_vec()),
            (COLUMNS, b"US", vec![0, 0]),
            (SLOPE, b"DS", b"nan ".to_vec()),
            (INTERCEPT, b"DS", b"1e300 ".to_vec()),
            (PIXEL_SPACING, b"DS", b"inf\\1 ".to_vec()),
            (PIXEL_SPACING, b"DS", b"0.8\\-0.7".to_vec()),
            (ORIENTATION, b"DS", b"2\\0\\0\\0\\1\\0 ".to_vec()),
            (ORIENTATION, b"DS", b"1\\0\\0\\0.6\\0.8\\0 ".to_vec()),
            (ORIENTATION, b"DS", b"1\\0\\0\\0\\0.9\\0 ".to_vec()),
        ] {
            let said = read_changed("b", |bytes| {
                let start = at(bytes, tag);
                let old = u16::from_le_bytes([bytes[start + 6], bytes[start + 7]]) as usize;
                let new = element(tag.0, tag.1, std::str::from_utf8(kind).unwrap(), &value);
                bytes.splice(start..start + 8 + old, new);
            });
            let said = said.unwrap_err();
            assert!(said.contains(&format!("/b: DICOM tag {tag}: ")) && said.contains("must "), "{said}");
        }
        let said = read_changed("b", |bytes| {
            let value = at(bytes, INTERCEPT) + 8;
            bytes[value..value + 5].copy_from_slice(b"90000");
        });
        assert!(said.unwrap_err().contains("Hounsfield units: 90020 must lie in"));
    }
}
