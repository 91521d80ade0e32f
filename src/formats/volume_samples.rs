//! The voxels of a volume's file: numbers of one kind in a row, decoded as they are read, so that a compressed scan is
//! never in memory twice.

use std::io::Read;

use crate::base::range::NumberRange;
use crate::base::{Error, Result, Volume, VoxelGrid};

/// Hounsfield units that a scan can hold.
const HOUNSFIELD: NumberRange = NumberRange::new(i16::MIN as f64, i16::MAX as f64);
/// Bytes decoded at a time; a multiple of every sample's size.
const CHUNK_BYTES: usize = 1 << 20;
/// Bytes behind the voxels that are looked through at most; a file may have no end.
const MOST_BEHIND_BYTES: u64 = 1 << 30;

/// A voxel's Hounsfield units, rounded. Errors: no number, or more than a scan can hold.
pub fn hounsfield(value: f64) -> Result<i16> {
    let rounded = value.round();
    HOUNSFIELD.check(rounded).map_err(|e| Error::input(format!("Hounsfield units: {e}")))?;
    Ok(rounded as i16)
}

/// How a number is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleKind {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

impl SampleKind {
    /// Bytes of a number.
    pub fn bytes(self) -> usize {
        match self {
            SampleKind::U8 | SampleKind::I8 => 1,
            SampleKind::U16 | SampleKind::I16 => 2,
            SampleKind::U32 | SampleKind::I32 | SampleKind::F32 => 4,
            SampleKind::U64 | SampleKind::I64 | SampleKind::F64 => 8,
        }
    }

    /// The number that starts with the first of `bytes`, which are little endian.
    fn decode(self, bytes: &[u8]) -> f64 {
        fn first<const N: usize>(bytes: &[u8]) -> [u8; N] {
            std::array::from_fn(|k| bytes[k])
        }
        match self {
            SampleKind::U8 => f64::from(bytes[0]),
            SampleKind::I8 => f64::from(bytes[0] as i8),
            SampleKind::U16 => f64::from(u16::from_le_bytes(first(bytes))),
            SampleKind::I16 => f64::from(i16::from_le_bytes(first(bytes))),
            SampleKind::U32 => f64::from(u32::from_le_bytes(first(bytes))),
            SampleKind::I32 => f64::from(i32::from_le_bytes(first(bytes))),
            SampleKind::U64 => u64::from_le_bytes(first(bytes)) as f64,
            SampleKind::I64 => i64::from_le_bytes(first(bytes)) as f64,
            SampleKind::F32 => f64::from(f32::from_le_bytes(first(bytes))),
            SampleKind::F64 => f64::from_le_bytes(first(bytes)),
        }
    }
}

/// In which order the numbers of a vector volume stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChannelOrder {
    /// x, y and z of a voxel, then the next voxel.
    ByVoxel,
    /// x of all voxels, then y of all, then z.
    ByChannel,
}

/// A volume's file, its header read and its voxels not yet.
pub struct VolumeSource {
    /// Where the voxels lie.
    pub grid: VoxelGrid,
    /// Numbers a voxel.
    pub channels: usize,
    /// Their order.
    pub order: ChannelOrder,
    /// How they are stored.
    pub kind: SampleKind,
    /// Whether the most significant byte comes first.
    pub is_big_endian: bool,
    /// value = number * slope + intercept.
    pub slope: f64,
    /// See `slope`.
    pub intercept: f64,
    /// The numbers.
    pub reader: Box<dyn Read>,
}

impl VolumeSource {
    /// The value of every voxel through `convert`.
    ///
    /// Errors: several numbers a voxel; a file that ends early, or goes on for a slice and more; a packed one whose checksum is
    /// another; a grid too large for this machine; the first of `convert`.
    pub fn read_scalars<T: Copy + Default>(self, convert: impl Fn(f64) -> Result<T>) -> Result<Volume<T>> {
        if self.channels != 1 {
            return Err(Error::input(format!("holds {} numbers a voxel, and one is wanted", self.channels)));
        }
        let grid = self.grid;
        grid.validate(size_of::<T>() as f64)?;
        let mut data = Vec::with_capacity(grid.count());
        self.decode(grid.count(), |value| {
            let place = |e: Error| e.element(format!("voxel {:?}", grid.cell(data.len())));
            let converted = convert(value).map_err(place)?;
            data.push(converted);
            Ok(())
        })?;
        Ok(Volume { grid, data })
    }

    /// The vector of every voxel. Errors as [`VolumeSource::read_scalars`], and other than three numbers a voxel.
    pub fn read_vectors(self) -> Result<Volume<[f32; 3]>> {
        if self.channels != 3 {
            let sentence = format!("holds {} number(s) a voxel, and a displacement has three", self.channels);
            return Err(Error::input(sentence));
        }
        let (grid, order) = (self.grid, self.order);
        grid.validate(12.0)?;
        let count = grid.count();
        let mut data = vec![[0f32; 3]; count];
        let mut next = 0;
        self.decode(3 * count, |value| {
            match order {
                ChannelOrder::ByVoxel => data[next / 3][next % 3] = value as f32,
                ChannelOrder::ByChannel => data[next % count][next / count] = value as f32,
            }
            next += 1;
            Ok(())
        })?;
        if let Some(at) = data.iter().position(|v| v.iter().any(|c| !c.is_finite())) {
            return Err(Error::input("is not finite").element(format!("the displacement of voxel {:?}", grid.cell(at))));
        }
        Ok(Volume { grid, data })
    }

    fn decode(mut self, count: usize, mut take: impl FnMut(f64) -> Result<()>) -> Result<()> {
        let size = self.kind.bytes();
        let mut left = count * size;
        let mut chunk = vec![0u8; CHUNK_BYTES.min(left)];
        while left > 0 {
            let part = &mut chunk[..CHUNK_BYTES.min(left)];
            self.reader.read_exact(part).map_err(|e| match e.kind() {
                std::io::ErrorKind::UnexpectedEof => {
                    Error::input(format!("ends early: fewer than {count} numbers are there"))
                }
                _ => Error::input(format!("its voxels cannot be read: {e}")),
            })?;
            if self.is_big_endian {
                part.chunks_exact_mut(size).for_each(<[u8]>::reverse);
            }
            for sample in part.chunks_exact(size) {
                take(self.kind.decode(sample) * self.slope + self.intercept)?;
            }
            left -= part.len();
        }
        // The checksum of a packed file stands at its end.
        let damaged = |e| Error::input(format!("is damaged: {e}"));
        let behind = std::io::copy(&mut self.reader.take(MOST_BEHIND_BYTES), &mut std::io::sink()).map_err(damaged)?;
        // Some writers fill up; another size or another kind of number leaves at least a slice.
        let slice = (count / self.grid.size[2] * size) as u64;
        if behind >= slice {
            return Err(Error::input(format!(
                "goes on for {behind} bytes behind the voxels that its header tells of ({count} numbers of {size} bytes): \
                 sizes or kind of number there are wrong"
            )));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    fn source(reader: impl Read + 'static) -> VolumeSource {
        VolumeSource {
            grid: VoxelGrid::upright([2, 3, 2], DVec3::ZERO, DVec3::ONE),
            channels: 1,
            order: ChannelOrder::ByVoxel,
            kind: SampleKind::U8,
            is_big_endian: false,
            slope: 2.0,
            intercept: -1.0,
            reader: Box::new(reader),
        }
    }

    #[test]
    fn a_file_that_goes_on_for_a_slice_has_another_size() {
        let read = |bytes: u64| source(std::io::repeat(7).take(bytes)).read_scalars(hounsfield);
        assert_eq!(read(12).unwrap().data, [13; 12]);
        // What fills up is not a slice.
        assert_eq!(read(17).unwrap().data, [13; 12]);
        let said = read(18).unwrap_err().to_string();
        assert!(said.contains("goes on for 6 bytes behind the voxels that its header tells of"), "{said}");
        assert!(read(11).unwrap_err().to_string().contains("ends early"));
        // One without end is not read for ever.
        assert!(source(std::io::repeat(7)).read_scalars(hounsfield).is_err());
    }
}
