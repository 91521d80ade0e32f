//! NumPy arrays (.npy, .npz) of 32- and 64-bit floats, C or Fortran order; written as little-endian f32 in C order.

use std::io::{Cursor, Write};
use std::path::Path;

use npyz::{NpyFile, Order, WriterBuilder};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::damage::guarded;
use crate::base::{Error, Image, Result, files};

/// Longest header that NumPy reads (`numpy.lib.format`).
const MAX_HEADER_BYTES: u32 = 10_000;
/// Most axes that an array of NumPy has.
const MAX_AXES: usize = 64;

/// An array, row-major whatever the file's order was.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Lengths of the axes, slowest first.
    pub shape: Vec<usize>,
    /// Values in C order.
    pub data: Vec<f32>,
}

/// Reads one array of floats. Errors name the file: unreadable, damaged, of another type.
pub fn read(path: &Path) -> Result<Array> {
    decode(&files::read_bytes(path)?).map_err(|e| e.at(path))
}

/// Reads a plane: shape (height, width), or the same with axes of length 1 around it.
pub fn read_plane(path: &Path) -> Result<Image<f32>> {
    read(path).and_then(plane).map_err(|e| e.at(path))
}

/// `array` as a plane, as [`read_plane`] does it.
pub fn plane(array: Array) -> Result<Image<f32>> {
    let axes: Vec<usize> = array.shape.iter().copied().filter(|&n| n != 1).collect();
    let (height, width) = match (array.shape.as_slice(), axes.as_slice()) {
        (&[height, width], _) | (_, &[height, width]) => (height, width),
        _ => return Err(Error::input(format!("has shape {:?}; (height, width) is wanted", array.shape))),
    };
    Ok(Image { width, height, channels: 1, data: array.data })
}

/// Writes one array in one atomic step; `data` in C order.
pub fn write(path: &Path, shape: &[usize], data: &[f32]) -> Result<()> {
    files::write_bytes(path, &encode(shape, data).map_err(|e| e.at(path))?)
}

/// Writes named arrays as an uncompressed `.npz` in one atomic step.
pub fn write_npz(path: &Path, arrays: &[(&str, &[usize], &[f32])]) -> Result<()> {
    let failed = |e: &dyn std::fmt::Display| Error::input(format!("encoding as .npz failed: {e}")).at(path);
    // The same bytes whenever it is written.
    let stored = SimpleFileOptions::DEFAULT.compression_method(CompressionMethod::Stored);
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, shape, data) in arrays {
        let array = encode(shape, data).map_err(|e| e.element(name).at(path))?;
        archive.start_file(format!("{name}.npy"), stored).map_err(|e| failed(&e))?;
        archive.write_all(&array).map_err(|e| failed(&e))?;
    }
    files::write_bytes(path, archive.finish().map_err(|e| failed(&e))?.get_ref())
}

fn shape_u64(shape: &[usize]) -> Vec<u64> {
    shape.iter().map(|&n| n as u64).collect()
}

fn expect_length(shape: &[usize], data: &[f32]) -> Result<()> {
    if shape.iter().product::<usize>() == data.len() {
        return Ok(());
    }
    Err(Error::input(format!("{} values cannot have the shape {shape:?}", data.len())))
}

fn encode(shape: &[usize], data: &[f32]) -> Result<Vec<u8>> {
    expect_length(shape, data)?;
    let failed = |e: std::io::Error| Error::input(format!("encoding as .npy failed: {e}"));
    let mut bytes = Vec::new();
    let options = npyz::WriteOptions::new().default_dtype().shape(&shape_u64(shape)).writer(&mut bytes);
    let mut writer = options.begin_nd().map_err(failed)?;
    writer.extend(data.iter().copied()).map_err(failed)?;
    writer.finish().map_err(failed)?;
    Ok(bytes)
}

/// [`read`] for bytes in memory.
pub fn decode(bytes: &[u8]) -> Result<Array> {
    check_header(bytes)?;
    guarded(".npy", || decode_unguarded(bytes))
}

/// Refuses, before the decoder sees them, headers that would cost it memory or time out of proportion: longer than
/// NumPy's, with more brackets than an array of plain numbers has, or with more axes.
fn check_header(bytes: &[u8]) -> Result<()> {
    let refused = |why: &str| Err(Error::input(why));
    let Some(rest) = bytes.strip_prefix(b"\x93NUMPY") else { return refused("is not a .npy file") };
    let (length, start) = match *rest {
        [1, _, a, b, ..] => (u32::from(u16::from_le_bytes([a, b])), 4),
        [2 | 3, _, a, b, c, d, ..] => (u32::from_le_bytes([a, b, c, d]), 6),
        _ => return refused("is a .npy file of an unknown version, or ends in its header"),
    };
    if length > MAX_HEADER_BYTES {
        return Err(Error::input(format!("has a header of {length} bytes; {MAX_HEADER_BYTES} is the most")));
    }
    let Some(header) = rest.get(start..start + length as usize) else { return refused("ends in its header") };
    let count = |bracket: u8| header.iter().filter(|&&b| b == bracket).count();
    if count(b'{') > 1 || count(b'(') > 1 || count(b'[') > 0 {
        return refused("is no array of plain numbers: its header is nested");
    }
    // Between the axes, and a few between the keys.
    if count(b',') > MAX_AXES + 8 {
        return Err(Error::input(format!("has more than {MAX_AXES} axes")));
    }
    Ok(())
}

fn decode_unguarded(bytes: &[u8]) -> Result<Array> {
    let damaged = |e: std::io::Error| Error::input(format!("is not a readable .npy file: {e}"));
    let file = NpyFile::new(bytes).map_err(damaged)?;
    let declared = file.shape().iter().try_fold(1u64, |product, &n| product.checked_mul(n));
    let Some(count) = declared.filter(|&n| n <= bytes.len() as u64) else {
        return Err(Error::input(format!(
            "declares the shape {:?}, more than its {} bytes can hold",
            file.shape(),
            bytes.len()
        )));
    };
    let shape: Vec<usize> = file.shape().iter().map(|&n| n as usize).collect();
    let order = file.order();
    let kind = file.dtype().descr();
    let data: Vec<f32> = match kind.trim_matches(['\'', '"']) {
        "<f4" | ">f4" => file.into_vec::<f32>().map_err(damaged)?,
        "<f8" | ">f8" => file.into_vec::<f64>().map_err(damaged)?.into_iter().map(|v| v as f32).collect(),
        other => return Err(Error::input(format!("holds values of type {other}; 32- or 64-bit floats are wanted"))),
    };
    if data.len() as u64 != count {
        return Err(Error::input(format!("holds {} values of {count}", data.len())));
    }
    let data = if order == Order::Fortran { from_fortran(&shape, &data) } else { data };
    Ok(Array { shape, data })
}

/// Column-major to row-major.
fn from_fortran(shape: &[usize], data: &[f32]) -> Vec<f32> {
    (0..data.len())
        .map(|index| {
            let (mut rest, mut weights) = (index, 0usize);
            let mut stride = data.len();
            for &n in shape.iter().rev() {
                stride /= n;
                weights += (rest % n) * stride;
                rest /= n;
            }
            data[weights]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let data: Vec<f32> = (0..6).map(|v| v as f32 * 0.5).collect();
        write(&path, &[2, 3], &data).unwrap();
        assert_eq!(read(&path).unwrap(), Array { shape: vec![2, 3], data: data.clone() });
        let plane = read_plane(&path).unwrap();
        assert_eq!((plane.width, plane.height), (3, 2));
        write(&path, &[1, 2, 3], &data).unwrap();
        assert_eq!(read_plane(&path).unwrap(), plane);
        write(&path, &[6], &data).unwrap();
        assert!(read_plane(&path).unwrap_err().to_string().contains("a.npy"));
        assert!(write(&path, &[7], &data).is_err());
    }

    /// Bytes as `numpy.save` writes them for `numpy.asfortranarray([[1., 2., 3.], [4., 5., 6.]])`.
    #[test]
    fn fortran_order_and_doubles_are_understood() {
        let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
        let header = "{'descr': '<f8', 'fortran_order': True, 'shape': (2, 3), }";
        bytes.extend(format!("{header:<117}\n").into_bytes());
        for value in [1.0f64, 4.0, 2.0, 5.0, 3.0, 6.0] {
            bytes.extend(value.to_le_bytes());
        }
        let array = decode(&bytes).unwrap();
        assert_eq!(array, Array { shape: vec![2, 3], data: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0] });
    }

    #[test]
    fn an_archive_opens_as_zip_of_arrays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npz");
        write_npz(&path, &[("means", &[1, 3], &[1.0, 2.0, 3.0]), ("opacities", &[2], &[0.5, 0.25])]).unwrap();
        let mut archive = zip::ZipArchive::new(std::fs::File::open(&path).unwrap()).unwrap();
        let mut means = Vec::new();
        archive.by_name("means.npy").unwrap().read_to_end(&mut means).unwrap();
        assert_eq!(decode(&means).unwrap(), Array { shape: vec![1, 3], data: vec![1.0, 2.0, 3.0] });
        assert!(write_npz(&path, &[("means", &[2], &[1.0])]).unwrap_err().to_string().contains("means"));
    }

    /// Found by fuzzing: a header of 4 GiB that is announced, one whose brackets are nested a thousand deep, one of
    /// thousands of axes.
    #[test]
    fn headers_out_of_proportion_are_refused_at_once() {
        let file = |header: &str| {
            let mut bytes = b"\x93NUMPY\x02\x00".to_vec();
            bytes.extend((header.len() as u32).to_le_bytes());
            bytes.extend(header.as_bytes());
            bytes
        };
        let refused = |bytes: &[u8]| decode(bytes).unwrap_err().to_string();
        assert!(refused(b"\x93NUMPY\x02\x00\xf0\xff\xff\xff{'descr'").contains("4294967280 bytes"));
        let nested = format!("{}{}", "(".repeat(1000), ")".repeat(1000));
        assert!(
            refused(&file(&format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {nested}}}")))
                .contains("nested")
        );
        let long = format!("{{'descr': '<f4', 'fortran_order': True, 'shape': ({})}}", "1,".repeat(3000));
        assert!(refused(&file(&long)).contains("more than 64 axes"));
        assert!(refused(&file(&" ".repeat(20_000))).contains("20000 bytes"));
        let fine = file("{'descr': '<f4', 'fortran_order': False, 'shape': (1,)}");
        assert_eq!(decode(&[fine, vec![0; 4]].concat()).unwrap().data, [0.0]);
    }

    #[test]
    fn damage_is_an_error() {
        let whole = encode(&[4, 5], &[1.5; 20]).unwrap();
        for length in 0..whole.len() {
            assert!(decode(&whole[..length]).is_err(), "{length}");
        }
        for bit in 0..whole.len() * 8 {
            let mut bytes = whole.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            let _ = decode(&bytes);
        }
    }
}
