//! MetaImage (`.mha`, and `.mhd` with its data beside it): what ITK, elastix and plastimatch write.
//!
//! A text header of `key = value` lines whose last is `ElementDataFile`, then the voxels, raw or packed by zlib. They
//! begin at byte `HeaderSize` of their file, or end with it where that is -1. Places
//! are in LPS, as ITK reads the format; `TransformMatrix` lists the direction of i, then of j, then of k.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Read};
use std::path::Path;

use flate2::read::ZlibDecoder;
use glam::{DMat3, DVec3};

use super::volume_samples::{ChannelOrder, SampleKind, VolumeSource};
use crate::base::estimate::demand_memory;
use crate::base::{Error, Result, VoxelGrid};

/// Most bytes and lines of a header.
const MOST_HEADER_BYTES: u64 = 64 << 10;
/// Most bytes of another format's header before the voxels.
const MOST_SKIPPED_BYTES: f64 = 1e8;
/// Keys that say the same, the usual one first.
const SPACING: [&str; 2] = ["ElementSpacing", "ElementSize"];
const ORIGIN: [&str; 3] = ["Offset", "Origin", "Position"];
const AXES: [&str; 3] = ["TransformMatrix", "Rotation", "Orientation"];
const BIG_ENDIAN: [&str; 2] = ["BinaryDataByteOrderMSB", "ElementByteOrderMSB"];

struct MetaHeader {
    keys: HashMap<String, String>,
    /// Its length.
    bytes: u64,
}

impl MetaHeader {
    fn read(from: &mut impl BufRead) -> Result<Self> {
        let mut keys = HashMap::new();
        let mut bytes = 0;
        let mut limited = from.take(MOST_HEADER_BYTES);
        loop {
            let mut line = Vec::new();
            let count =
                limited.read_until(b'\n', &mut line).map_err(|e| Error::input(format!("cannot be read: {e}")))?;
            bytes += count as u64;
            let text = String::from_utf8_lossy(&line);
            let Some((key, value)) = text.split_once('=').filter(|_| count > 0) else {
                return Err(Error::input("is no MetaImage: its header has no `ElementDataFile`"));
            };
            let (key, value) = (key.trim().to_owned(), value.trim().to_owned());
            let is_last = key == "ElementDataFile";
            keys.insert(key, value);
            if is_last {
                return Ok(MetaHeader { keys, bytes });
            }
        }
    }

    fn text(&self, names: &[&str]) -> Option<&str> {
        names.iter().find_map(|name| self.keys.get(*name)).map(String::as_str)
    }

    fn is_true(&self, names: &[&str]) -> bool {
        self.text(names).is_some_and(|v| v.eq_ignore_ascii_case("true") || v == "1")
    }

    /// The numbers of a key; `None` where it is missing.
    fn numbers<const N: usize>(&self, names: &[&str]) -> Result<Option<[f64; N]>> {
        let Some(text) = self.text(names) else { return Ok(None) };
        let values: Option<Vec<f64>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
        match values.and_then(|v| <[f64; N]>::try_from(v).ok()) {
            Some(values) => Ok(Some(values)),
            None => Err(Error::input(format!("is `{text}` and not {N} number(s)")).element(names[0])),
        }
    }

    fn grid(&self) -> Result<VoxelGrid> {
        let rank = self.numbers::<1>(&["NDims"])?.map_or(0.0, |[n]| n);
        if rank != 3.0 {
            return Err(Error::input(format!("has {rank} dimensions, and a volume has three")));
        }
        let size = self.numbers::<3>(&["DimSize"])?.ok_or_else(|| Error::input("is missing").element("DimSize"))?;
        let spacing = self.numbers::<3>(&SPACING)?.ok_or_else(|| Error::input("is missing").element(SPACING[0]))?;
        let axes = self.numbers::<9>(&AXES)?.map_or(DMat3::IDENTITY, |m| DMat3::from_cols_array(&m));
        let origin = self.numbers::<3>(&ORIGIN)?.unwrap_or_default();
        let size = size.map(|n| if n >= 1.0 && n.fract() == 0.0 && n < 1e6 { n as usize } else { 0 });
        let axes_mm = axes * DMat3::from_diagonal(DVec3::from_array(spacing));
        let grid = VoxelGrid { size, origin_mm: DVec3::from_array(origin), axes_mm };
        grid.validate(0.0)?;
        Ok(grid)
    }

    fn kind(&self) -> Result<SampleKind> {
        Ok(match self.text(&["ElementType"]).unwrap_or("nothing").trim_end_matches("_ARRAY") {
            "MET_UCHAR" => SampleKind::U8,
            "MET_CHAR" => SampleKind::I8,
            "MET_USHORT" => SampleKind::U16,
            "MET_SHORT" => SampleKind::I16,
            "MET_UINT" | "MET_ULONG" => SampleKind::U32,
            "MET_INT" | "MET_LONG" => SampleKind::I32,
            "MET_ULONG_LONG" => SampleKind::U64,
            "MET_LONG_LONG" => SampleKind::I64,
            "MET_FLOAT" => SampleKind::F32,
            "MET_DOUBLE" => SampleKind::F64,
            other => return Err(Error::input(format!("{other} is no type of a scan, mask or field"))),
        })
    }
}

/// The voxels in `raw`, of which `gone` bytes have been read, after what `HeaderSize` says is before them. With -1 the
/// last `wanted` bytes are taken.
fn after_header(
    header: &MetaHeader,
    mut raw: Box<dyn Read>,
    gone: u64,
    wanted: f64,
    is_packed: bool,
) -> Result<Box<dyn Read>> {
    let refused = |size: f64| {
        Err(Error::input(format!("is {size}, and the voxels begin at a byte from {gone} on, or end the file (-1)"))
            .element("HeaderSize"))
    };
    match header.numbers::<1>(&["HeaderSize"])?.map_or(0.0, |[n]| n) {
        // What every writer means that states it at all without a header.
        0.0 => Ok(raw),
        -1.0 if !is_packed => {
            demand_memory("its voxels", wanted)?;
            let mut bytes = Vec::new();
            let most = wanted + MOST_SKIPPED_BYTES;
            raw.take(most as u64 + 1)
                .read_to_end(&mut bytes)
                .map_err(|e| Error::input(format!("its voxels cannot be read: {e}")))?;
            if bytes.len() as f64 > most {
                return Err(Error::input("its voxels end the file, and too much comes before them"));
            }
            let first = bytes.len().saturating_sub(wanted as usize);
            Ok(Box::new(Cursor::new(bytes.split_off(first))))
        }
        size if size.fract() == 0.0 && (gone as f64..=MOST_SKIPPED_BYTES).contains(&size) => {
            let skipped = size as u64 - gone;
            let copied = std::io::copy(&mut raw.by_ref().take(skipped), &mut std::io::sink());
            if copied.map_err(|e| Error::input(format!("its voxels cannot be read: {e}")))? != skipped {
                return Err(Error::input("ends before its voxels begin").element("HeaderSize"));
            }
            Ok(raw)
        }
        size => refused(size),
    }
}

/// Opens a file and reads its header. Errors name what is wrong with it.
pub fn open(path: &Path) -> Result<VolumeSource> {
    let file = File::open(path).map_err(|e| Error::io("reading", path, e))?;
    open_stream(Box::new(BufReader::new(file)), path.parent().unwrap_or(Path::new(""))).map_err(|e| e.at(path))
}

/// [`open`] for the bytes of a file in `folder`.
pub fn open_stream(mut file: Box<dyn BufRead>, folder: &Path) -> Result<VolumeSource> {
    let header = MetaHeader::read(&mut file)?;
    let (grid, kind) = (header.grid()?, header.kind()?);
    let channels = header.numbers::<1>(&["ElementNumberOfChannels"])?.map_or(1.0, |[n]| n);
    if !(1.0..=16.0).contains(&channels) || channels.fract() != 0.0 {
        return Err(Error::input(format!("{channels} numbers a voxel are none of a volume")));
    }
    if header.text(&["BinaryData"]).is_some() && !header.is_true(&["BinaryData"]) {
        return Err(Error::input("holds its voxels as text: write it as binary"));
    }
    let place = header.text(&["ElementDataFile"]).unwrap_or_default();
    let (raw, gone): (Box<dyn Read>, u64) = match place {
        "LOCAL" | "Local" | "local" => (file, header.bytes),
        // A header may be anybody's: it names a file beside itself and no other.
        name if name.contains(['/', '\\', '%']) || name.starts_with("LIST") || name.is_empty() => {
            return Err(Error::input(format!("keeps its voxels in `{name}`, and one file beside it is wanted")));
        }
        name => {
            let beside = folder.join(name);
            (Box::new(BufReader::new(File::open(&beside).map_err(|e| Error::io("reading", &beside, e))?)), 0)
        }
    };
    let is_packed = header.is_true(&["CompressedData"]);
    let wanted = grid.count() as f64 * channels * kind.bytes() as f64;
    let raw = after_header(&header, raw, gone, wanted, is_packed)?;
    Ok(VolumeSource {
        grid,
        channels: channels as usize,
        order: ChannelOrder::ByVoxel,
        kind,
        is_big_endian: header.is_true(&BIG_ENDIAN),
        slope: 1.0,
        intercept: 0.0,
        reader: if is_packed { Box::new(ZlibDecoder::new(raw)) } else { raw },
    })
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    const HEADER: &str = "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\n\
        CompressedData = False\nTransformMatrix = 0 1 0 -1 0 0 0 0 1\nOffset = 1 2 3\nElementSpacing = 0.5 0.7 2\n\
        DimSize = 2 2 2\nElementType = MET_SHORT\nElementDataFile = LOCAL\n";

    fn bytes(header: &str, voxels: &[u8]) -> Vec<u8> {
        [header.as_bytes(), voxels].concat()
    }

    fn read(bytes: Vec<u8>) -> Result<crate::base::Volume<i16>> {
        open_stream(Box::new(Cursor::new(bytes)), Path::new(""))?.read_scalars(|v| Ok(v as i16))
    }

    #[test]
    fn raw_packed_and_both_byte_orders_are_the_same_volume() {
        let values: Vec<i16> = (0..8).map(|v| v * 300 - 1000).collect();
        let little: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let big: Vec<u8> = values.iter().flat_map(|v| v.to_be_bytes()).collect();
        let mut packer = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
        packer.write_all(&little).unwrap();
        let packed = packer.finish().unwrap();
        let volume = read(bytes(HEADER, &little)).unwrap();
        assert_eq!(volume.data, values);
        // i points along y, j against x.
        assert!((volume.grid.centre(1) - DVec3::new(1.0, 2.5, 3.0)).length() < 1e-12);
        assert!((volume.grid.centre(2) - DVec3::new(0.3, 2.0, 3.0)).length() < 1e-12);
        let as_big = HEADER.replace("MSB = False", "MSB = True");
        assert_eq!(read(bytes(&as_big, &big)).unwrap(), volume);
        let as_packed = HEADER.replace("CompressedData = False", "CompressedData = True");
        assert_eq!(read(bytes(&as_packed, &packed)).unwrap(), volume);
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a.mhd"), HEADER.replace("LOCAL", "a.raw")).unwrap();
        std::fs::write(folder.path().join("a.raw"), &little).unwrap();
        assert_eq!(open(&folder.path().join("a.mhd")).unwrap().read_scalars(|v| Ok(v as i16)).unwrap(), volume);
    }

    /// The bytes before the voxels were read as voxels: the airway lay elsewhere.
    #[test]
    fn what_comes_before_the_voxels_is_skipped() {
        let values: Vec<i16> = (0..8).map(|v| v * 300 - 1000).collect();
        let voxels: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let folder = tempfile::tempdir().unwrap();
        let before = [vec![7u8; 300], voxels.clone()].concat();
        std::fs::write(folder.path().join("a.raw"), &before).unwrap();
        let beside = |size: &str| {
            let header = HEADER.replace("NDims", &format!("HeaderSize = {size}\nNDims")).replace("LOCAL", "a.raw");
            std::fs::write(folder.path().join("a.mhd"), header).unwrap();
            open(&folder.path().join("a.mhd"))
                .and_then(|source| source.read_scalars(|v| Ok(v as i16)))
                .map(|volume| volume.data)
                .map_err(|e| e.to_string())
        };
        assert_eq!(beside("300").unwrap(), values);
        assert_eq!(beside("-1").unwrap(), values);
        for wrong in ["-2", "1.5", "1e30"] {
            assert!(beside(wrong).unwrap_err().contains("HeaderSize: is "), "{wrong}");
        }
        assert!(beside("400").unwrap_err().contains("ends before its voxels begin"));
        assert!(beside("310").unwrap_err().contains("ends early"));
        // In one file the count is from its beginning.
        let local = HEADER.replace("NDims", "HeaderSize = 1000\nNDims");
        let mut file = bytes(&local, &[]);
        file.resize(1000, b' ');
        assert_eq!(read([file, voxels].concat()).unwrap().data, values);
    }

    #[test]
    fn damage_is_named() {
        let said = |from: &str, to: &str| read(bytes(&HEADER.replace(from, to), &[0; 16])).unwrap_err().to_string();
        assert!(said("DimSize = 2 2 2", "DimSize = 2 2").contains("DimSize: is `2 2` and not 3"));
        assert!(said("2 2 2", "2 2 3").contains("ends early: fewer than 12"));
        assert!(said("2 2 2", "2 2 -3").contains("none of a scan"));
        assert!(said("MET_SHORT", "MET_STRING").contains("MET_STRING"));
        assert!(said("0.5 0.7 2", "0.5 0 2").contains("none of a scan"));
        assert!(said("LOCAL", "/etc/passwd").contains("one file beside it"));
        assert!(said("ElementDataFile", "DataFile").contains("is no MetaImage"));
        assert!(said("NDims = 3", "NDims = 2").contains("has 2 dimensions"));
        assert!(read(vec![0; 100]).unwrap_err().to_string().contains("is no MetaImage"));
    }
}
