//! NIfTI-1 (`.nii`, `.nii.gz`): volumes of scanners' exports, of TotalSegmentator, nnU-Net and 3D Slicer.
//!
//! The header is read by the `nifti` crate. The place of the voxels follows the standard: the sform where its code is
//! above 0, else the qform, else the spacing alone; RAS in the file, LPS here. Vectors (`dim[5]` is 3) are in LPS, as ITK
//! and elastix write them, but for the intent "displacement vector" (1006), which ITK writes in RAS.

use std::fs::File;
use std::io::{BufReader, Read, Write};
use std::path::Path;

use flate2::Compression;
use flate2::read::MultiGzDecoder;
use flate2::write::GzEncoder;
use glam::{DMat3, DVec3};
use nifti::{Endianness, NiftiHeader};

use super::volume_samples::{ChannelOrder, SampleKind, VolumeSource};
use crate::base::{Error, Result, Volume, VoxelGrid, files};

/// Bytes of the header, and where the voxels begin in what is written here.
const HEADER_BYTES: usize = 348;
const VOXELS_AT: usize = 352;
/// Farthest that voxels may begin: room for extensions of the header.
const LATEST_VOXELS: f64 = 1e8;
/// What a NIfTI-2 file begins with: the size of its header.
const NIFTI_2_BYTES: [[u8; 4]; 2] = [540i32.to_le_bytes(), 540i32.to_be_bytes()];
/// Intents of vectors.
const DISPLACEMENT: i16 = 1006;
const VECTOR: i16 = 1007;

/// Opens a file and reads its header. Errors name what is wrong with it.
pub fn open(path: &Path) -> Result<VolumeSource> {
    open_stream(unpacked(path)?).map_err(|e| e.at(path))
}

/// The bytes of a file, packed or not: its first two say which, whatever it is called.
fn unpacked(path: &Path) -> Result<Box<dyn Read>> {
    let file = File::open(path).map_err(|e| Error::io("reading", path, e))?;
    let mut file = BufReader::new(file);
    let mut start = Vec::new();
    file.by_ref().take(2).read_to_end(&mut start).map_err(|e| Error::io("reading", path, e))?;
    let is_compressed = start == [0x1f, 0x8b];
    let whole = std::io::Cursor::new(start).chain(file);
    Ok(if is_compressed { Box::new(MultiGzDecoder::new(whole)) } else { Box::new(whole) })
}

fn read_header(reader: &mut dyn Read) -> Result<NiftiHeader> {
    let mut bytes = Vec::with_capacity(HEADER_BYTES);
    let read = reader.take(HEADER_BYTES as u64).read_to_end(&mut bytes);
    read.map_err(|e| Error::input(format!("is no NIfTI file: {e}")))?;
    if bytes.is_empty() {
        return Err(Error::input("is empty"));
    }
    if NIFTI_2_BYTES.iter().any(|start| bytes.starts_with(start)) {
        return Err(Error::input("is NIfTI-2: rewrite it as NIfTI-1, as SimpleITK and nibabel's Nifti1Image do"));
    }
    if bytes.len() < HEADER_BYTES {
        return Err(Error::input(format!("is no NIfTI file: it ends within the header, after {} bytes", bytes.len())));
    }
    NiftiHeader::from_reader(&bytes[..]).map_err(|e| Error::input(format!("is no NIfTI file: {e}")))
}

/// [`open`] for the (uncompressed) bytes of a file.
pub fn open_stream(mut reader: Box<dyn Read>) -> Result<VolumeSource> {
    let header = read_header(&mut reader)?;
    if &header.magic[..3] != b"n+1" {
        return Err(Error::input("keeps its voxels in another file (.hdr and .img): rewrite it as one .nii.gz"));
    }
    let (grid, channels) = (grid_of(&header)?, channels_of(&header)?);
    let offset = f64::from(header.vox_offset);
    if !(HEADER_BYTES as f64..=LATEST_VOXELS).contains(&offset) {
        return Err(Error::input(format!("its voxels begin at byte {offset}, which is none")));
    }
    let skipped = offset as u64 - HEADER_BYTES as u64;
    let copied = std::io::copy(&mut reader.by_ref().take(skipped), &mut std::io::sink());
    if copied.map_err(|e| Error::input(format!("its voxels cannot be read: {e}")))? != skipped {
        return Err(Error::input("ends before its voxels begin"));
    }
    let (slope, intercept) = (f64::from(header.scl_slope), f64::from(header.scl_inter));
    // A slope of 0 says "not scaled".
    let is_scaled = slope != 0.0 && slope.is_finite() && intercept.is_finite();
    Ok(VolumeSource {
        grid,
        channels,
        order: ChannelOrder::ByChannel,
        kind: kind_of(header.datatype)?,
        is_big_endian: header.endianness == Endianness::Big,
        slope: if is_scaled { slope } else { 1.0 },
        intercept: if is_scaled { intercept } else { 0.0 },
        reader,
    })
}

/// Whether the vectors of the file at `path` are in RAS. Only for files that [`open`] has accepted.
pub fn vectors_are_ras(path: &Path) -> Result<bool> {
    let header = read_header(&mut unpacked(path)?).map_err(|e| e.at(path))?;
    Ok(header.intent_code == DISPLACEMENT)
}

/// A sentence where sform and qform of the file at `path` lie more than a voxel apart: which of them is taken. Only for
/// files that [`open`] has accepted.
pub fn frame_note(path: &Path) -> Option<String> {
    let header = read_header(&mut unpacked(path).ok()?).ok()?;
    if header.sform_code <= 0 || header.qform_code <= 0 {
        return None;
    }
    let sform = grid_of(&header).ok()?;
    let qform = grid_of(&NiftiHeader { sform_code: 0, ..header }).ok()?;
    let corner = |k: usize| DVec3::from_array([0, 1, 2].map(|a| ((k >> a & 1) * (sform.size[a] - 1)) as f64));
    let apart = (0..8).map(|k| sform.position(corner(k)).distance(qform.position(corner(k)))).fold(0.0, f64::max);
    let sentence =
        || format!("{}: its sform and its qform lie up to {apart:.1} mm apart: the sform is taken", path.display());
    (apart > sform.spacing_mm().max_element()).then(sentence)
}

fn kind_of(datatype: i16) -> Result<SampleKind> {
    Ok(match datatype {
        2 => SampleKind::U8,
        4 => SampleKind::I16,
        8 => SampleKind::I32,
        16 => SampleKind::F32,
        64 => SampleKind::F64,
        256 => SampleKind::I8,
        512 => SampleKind::U16,
        768 => SampleKind::U32,
        1024 => SampleKind::I64,
        1280 => SampleKind::U64,
        other => return Err(Error::input(format!("its voxels are of type {other}, which no scan or mask has"))),
    })
}

fn channels_of(header: &NiftiHeader) -> Result<usize> {
    let rank = header.dim[0] as usize;
    if !(3..=7).contains(&rank) {
        return Err(Error::input(format!("has {rank} dimensions, and a volume has three")));
    }
    let beyond = |axis: usize| if axis <= rank { usize::from(header.dim[axis]).max(1) } else { 1 };
    match (beyond(4), beyond(5), beyond(6) * beyond(7)) {
        (1, channels, 1) => Ok(channels),
        (phases, _, _) => Err(Error::input(format!(
            "holds {phases} or more volumes: write the one of the wanted breathing phase to a file of its own; components \
             of a displacement field stand in the fifth dimension (x, y, z, 1, 3)"
        ))),
    }
}

fn grid_of(header: &NiftiHeader) -> Result<VoxelGrid> {
    let unit_mm = match header.xyzt_units & 7 {
        1 => 1000.0,
        3 => 1e-3,
        _ => 1.0,
    };
    let spacing = DVec3::new(header.pixdim[1].into(), header.pixdim[2].into(), header.pixdim[3].into());
    let (axes, origin) = if header.sform_code > 0 {
        let rows = [header.srow_x, header.srow_y, header.srow_z].map(|row| row.map(f64::from));
        let column = |k: usize| DVec3::new(rows[0][k], rows[1][k], rows[2][k]);
        (DMat3::from_cols(column(0), column(1), column(2)), column(3))
    } else if header.qform_code > 0 {
        let q = [header.quatern_b, header.quatern_c, header.quatern_d].map(f64::from);
        let a = (1.0 - q.iter().map(|v| v * v).sum::<f64>()).max(0.0).sqrt();
        let turn = DMat3::from_quat(glam::DQuat::from_xyzw(q[0], q[1], q[2], a).normalize());
        let handed = if header.pixdim[0] < 0.0 { -1.0 } else { 1.0 };
        let origin = DVec3::new(header.quatern_x.into(), header.quatern_y.into(), header.quatern_z.into());
        (turn * DMat3::from_diagonal(spacing * DVec3::new(1.0, 1.0, handed)), origin)
    } else {
        (DMat3::from_diagonal(spacing), DVec3::ZERO)
    };
    // RAS to LPS.
    let turn = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0) * unit_mm);
    let size = [header.dim[1], header.dim[2], header.dim[3]].map(usize::from);
    let grid = VoxelGrid { size, origin_mm: turn * origin, axes_mm: turn * axes };
    grid.validate(0.0)?;
    Ok(grid)
}

/// A value that can be written.
pub trait NiftiValue: Copy {
    /// The standard's code of its type.
    const DATATYPE: i16;
    /// Numbers a voxel.
    const CHANNELS: usize;
    /// Bits of a number.
    const BITS: i16;
    /// Appends number `channel`, little endian.
    fn push(self, channel: usize, bytes: &mut Vec<u8>);
}

impl NiftiValue for u8 {
    const DATATYPE: i16 = 2;
    const CHANNELS: usize = 1;
    const BITS: i16 = 8;
    fn push(self, _channel: usize, bytes: &mut Vec<u8>) {
        bytes.push(self);
    }
}

impl NiftiValue for i16 {
    const DATATYPE: i16 = 4;
    const CHANNELS: usize = 1;
    const BITS: i16 = 16;
    fn push(self, _channel: usize, bytes: &mut Vec<u8>) {
        bytes.extend(self.to_le_bytes());
    }
}

impl NiftiValue for [f32; 3] {
    const DATATYPE: i16 = 16;
    const CHANNELS: usize = 3;
    const BITS: i16 = 32;
    fn push(self, channel: usize, bytes: &mut Vec<u8>) {
        bytes.extend(self[channel].to_le_bytes());
    }
}

/// Writes a volume (HU as `i16`, a mask as `u8`, a displacement in LPS and mm as `[f32; 3]`) in one atomic step;
/// compressed when the name ends in `.gz`.
pub fn write<T: NiftiValue>(path: &Path, volume: &Volume<T>) -> Result<()> {
    files::write_atomically(path, |out| {
        if path.extension().is_some_and(|e| e == "gz") {
            let mut packed = GzEncoder::new(out, Compression::fast());
            write_stream(&mut packed, volume)?;
            packed.finish().map(|_| ())
        } else {
            write_stream(out, volume)
        }
    })
}

fn write_stream<T: NiftiValue>(out: &mut dyn Write, volume: &Volume<T>) -> std::io::Result<()> {
    out.write_all(&header_bytes::<T>(&volume.grid))?;
    let mut bytes = Vec::with_capacity(1 << 20);
    for channel in 0..T::CHANNELS {
        for part in volume.data.chunks(1 << 16) {
            bytes.clear();
            part.iter().for_each(|v| v.push(channel, &mut bytes));
            out.write_all(&bytes)?;
        }
    }
    Ok(())
}

fn header_bytes<T: NiftiValue>(grid: &VoxelGrid) -> [u8; VOXELS_AT] {
    let mut bytes = [0u8; VOXELS_AT];
    let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
    put(0, &(HEADER_BYTES as i32).to_le_bytes());
    let is_vector = T::CHANNELS > 1;
    let size = grid.size.map(|n| n as i16);
    let dim = [if is_vector { 5 } else { 3 }, size[0], size[1], size[2], 1, T::CHANNELS as i16, 1, 1];
    dim.iter().enumerate().for_each(|(k, n)| put(40 + 2 * k, &n.to_le_bytes()));
    put(68, &(if is_vector { VECTOR } else { 0 }).to_le_bytes());
    put(70, &T::DATATYPE.to_le_bytes());
    put(72, &T::BITS.to_le_bytes());
    // LPS to RAS; the qform is the same frame for readers that prefer it.
    let ras = DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0));
    let (axes, origin, spacing) = (ras * grid.axes_mm, ras * grid.origin_mm, grid.spacing_mm());
    let mut turn = DMat3::from_cols(axes.x_axis / spacing.x, axes.y_axis / spacing.y, axes.z_axis / spacing.z);
    let handed = if turn.determinant() < 0.0 { -1.0 } else { 1.0 };
    turn.z_axis *= handed;
    let mut q = glam::DQuat::from_mat3(&turn).normalize();
    if q.w < 0.0 {
        q = -q;
    }
    let floats = |at: usize, values: &[f64], put: &mut dyn FnMut(usize, &[u8])| {
        values.iter().enumerate().for_each(|(k, &v)| put(at + 4 * k, &(v as f32).to_le_bytes()));
    };
    floats(76, &[handed, spacing.x, spacing.y, spacing.z, 1.0, 1.0, 1.0, 1.0], &mut put);
    floats(108, &[VOXELS_AT as f64, 1.0, 0.0], &mut put);
    // Millimetres.
    put(123, &[2]);
    // Both forms are those of the scanner.
    put(252, &1i16.to_le_bytes());
    put(254, &1i16.to_le_bytes());
    floats(256, &[q.x, q.y, q.z, origin.x, origin.y, origin.z], &mut put);
    for row in 0..3 {
        let values = [axes.x_axis[row], axes.y_axis[row], axes.z_axis[row], origin[row]];
        floats(280 + 16 * row, &values, &mut put);
    }
    put(344, b"n+1\0");
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn oblique() -> VoxelGrid {
        let turn = DMat3::from_rotation_z(0.4) * DMat3::from_rotation_x(0.2);
        VoxelGrid {
            size: [3, 4, 5],
            origin_mm: DVec3::new(-100.25, 50.5, -1204.75),
            axes_mm: turn * DMat3::from_diagonal(DVec3::new(0.7, 0.75, 1.25)),
        }
    }

    fn near(a: &VoxelGrid, b: &VoxelGrid) -> bool {
        a.size == b.size && a.same_as(b)
    }

    #[test]
    fn what_is_written_is_read_back_with_either_form_and_compressed_or_not() {
        let folder = tempfile::tempdir().unwrap();
        for handed in [1.0, -1.0] {
            let mut grid = oblique();
            grid.axes_mm.z_axis *= handed;
            let scan = Volume { grid, data: (0..60).map(|v| v as i16 * 31 - 1000).collect() };
            for name in ["a.nii", "a.nii.gz"] {
                let path = folder.path().join(name);
                write(&path, &scan).unwrap();
                let read = open(&path).unwrap().read_scalars(|v| Ok(v as i16)).unwrap();
                assert!(near(&read.grid, &grid), "{:?}", read.grid);
                assert_eq!(read.data, scan.data);
            }
            // Without the sform the qform says the same.
            let mut bytes = std::fs::read(folder.path().join("a.nii")).unwrap();
            bytes[254..256].fill(0);
            let source = open_stream(Box::new(std::io::Cursor::new(bytes))).unwrap();
            assert!(near(&source.grid, &grid), "{handed}: {:?}", source.grid);
            // Both are the same, until one of them is moved.
            let path = folder.path().join("a.nii");
            assert_eq!(frame_note(&path), None);
            let mut bytes = std::fs::read(&path).unwrap();
            let x = f32::from_le_bytes([bytes[268], bytes[269], bytes[270], bytes[271]]) + 20.0;
            bytes[268..272].copy_from_slice(&x.to_le_bytes());
            std::fs::write(&path, bytes).unwrap();
            assert!(frame_note(&path).unwrap().ends_with("20.0 mm apart: the sform is taken"));
        }
    }

    #[test]
    fn vectors_keep_their_order() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("field.nii.gz");
        let grid = VoxelGrid::upright([2, 2, 2], DVec3::ZERO, DVec3::splat(2.0));
        let field = Volume { grid, data: (0..8).map(|v| [v as f32, -v as f32, 0.5]).collect::<Vec<_>>() };
        write(&path, &field).unwrap();
        assert_eq!(open(&path).unwrap().read_vectors().unwrap().data, field.data);
        assert!(!vectors_are_ras(&path).unwrap());
        // Packed or not, its bytes say, and not its name.
        for name in ["FIELD.NII.GZ", "packed.nii"] {
            let path_then = folder.path().join(name);
            std::fs::copy(&path, &path_then).unwrap();
            assert_eq!(open(&path_then).unwrap().read_vectors().unwrap().data, field.data);
            assert!(!vectors_are_ras(&path_then).unwrap());
        }
        let refused = open(&path).unwrap().read_scalars(Ok).unwrap_err().to_string();
        assert!(refused.contains("3 numbers a voxel"), "{refused}");
    }

    #[test]
    fn damage_is_named() {
        let grid = VoxelGrid::upright([2, 2, 2], DVec3::ZERO, DVec3::ONE);
        let mut good = Vec::new();
        write_stream(&mut good, &Volume { grid, data: vec![1u8; 8] }).unwrap();
        let said = |change: &dyn Fn(&mut Vec<u8>)| {
            let mut bytes = good.clone();
            change(&mut bytes);
            let read = open_stream(Box::new(std::io::Cursor::new(bytes))).and_then(|s| s.read_scalars(|v| Ok(v as u8)));
            read.map(|_| String::new()).unwrap_or_else(|e| e.to_string())
        };
        assert_eq!(said(&|_| ()), "");
        assert!(said(&|b| b.truncate(100)).contains("is no NIfTI file"));
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("empty.nii.gz"), "").unwrap();
        assert!(
            open(&folder.path().join("empty.nii.gz")).err().unwrap().to_string().ends_with("empty.nii.gz: is empty")
        );
        assert!(said(&|b| b[..4].copy_from_slice(&540i32.to_be_bytes())).contains("is NIfTI-2: rewrite it"));
        // Labels of 64 bits, as numpy has them.
        let wide = |b: &mut Vec<u8>| {
            b[70..72].copy_from_slice(&1024i16.to_le_bytes());
            b.truncate(VOXELS_AT);
            b.extend([7i64; 8].map(i64::to_le_bytes).concat());
        };
        assert_eq!(said(&wide), "");
        assert!(said(&|b| b.truncate(355)).contains("ends early: fewer than 8"));
        assert!(said(&|b| b[42..44].copy_from_slice(&0i16.to_le_bytes())).contains("none of a scan"));
        assert!(said(&|b| b[48..50].copy_from_slice(&9i16.to_le_bytes())).is_empty());
        assert!(
            said(&|b| {
                b[40] = 4;
                b[48..50].copy_from_slice(&9i16.to_le_bytes());
            })
            .contains("9 or more volumes")
        );
        assert!(said(&|b| b[70] = 32).contains("type 32"));
        assert!(said(&|b| b[108..112].copy_from_slice(&1e30f32.to_le_bytes())).contains("begin at byte"));
    }
}
