//! A volume's file, of whichever format: a folder of DICOM slices, MetaImage, or NIfTI.

use std::path::Path;

use glam::DVec3;

use super::volume_samples::{VolumeSource, hounsfield};
use super::{dicom, metaimage, nifti};
use crate::base::{Error, Result, Volume};

/// Largest label of a segmentation.
const MOST_LABEL: f64 = 65_535.0;

fn ending(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().to_ascii_lowercase()).unwrap_or_default()
}

fn is_nifti(path: &Path) -> bool {
    let name = ending(path);
    name.ends_with(".nii") || name.ends_with(".nii.gz")
}

fn open(path: &Path) -> Result<VolumeSource> {
    let name = ending(path);
    if is_nifti(path) {
        nifti::open(path)
    } else if name.ends_with(".mha") || name.ends_with(".mhd") {
        metaimage::open(path)
    } else {
        Err(Error::input(unreadable(path, &name)).at(path))
    }
}

/// What a file is that is no volume, and its cure.
fn unreadable(path: &Path, name: &str) -> &'static str {
    let ends = |endings: &[&str]| endings.iter().any(|ending| name.ends_with(ending));
    if path.is_dir() {
        "is a folder, and masks and fields are single files: .nii, .nii.gz, .mha or .mhd"
    } else if ends(&[".nrrd", ".nhdr"]) {
        "is NRRD, which is not read: export it from 3D Slicer as .nii.gz"
    } else if ends(&[".h5", ".hdf5", ".tfm", ".mat"]) {
        "is a transform and no volume: write it as a displacement field, .nii.gz or .mha"
    } else if ends(&[".hdr", ".img"]) {
        "keeps header and voxels in two files: rewrite it as one .nii.gz"
    } else {
        "is no volume that can be read: .nii, .nii.gz, .mha, .mhd, or (scans) a folder of DICOM slices is wanted"
    }
}

/// A sentence where the file at `path`, which has been read, says in two ways where it lies, and they differ.
pub fn frame_note(path: &Path) -> Option<String> {
    is_nifti(path).then(|| nifti::frame_note(path)).flatten()
}

/// Reads a CT scan: Hounsfield units, rounded. Errors name the file, and a voxel that is no number or beyond what a
/// scan holds.
pub fn read_scan(path: &Path) -> Result<Volume<i16>> {
    if path.is_dir() {
        return dicom::read_folder(path);
    }
    open(path)?.read_scalars(hounsfield).map_err(|e| e.at(path))
}

/// Reads a label map. Errors name the file, or the first value that is no label.
pub fn read_labels(path: &Path) -> Result<Volume<u16>> {
    let label = |value: f64| match (0.0..=MOST_LABEL).contains(&value) && (value - value.round()).abs() <= 1e-3 {
        true => Ok(value.round() as u16),
        false => Err(Error::input(format!("holds {value}, and labels are whole numbers from 0"))),
    };
    open(path)?.read_scalars(label).map_err(|e| e.at(path))
}

/// Reads a displacement field: vectors in LPS and mm. Errors name the file.
pub fn read_field(path: &Path) -> Result<Volume<[f32; 3]>> {
    let mut field = open(path)?.read_vectors().map_err(|e| e.at(path))?;
    if is_nifti(path) && nifti::vectors_are_ras(path)? {
        let turn = DVec3::new(-1.0, -1.0, 1.0).as_vec3().to_array();
        field.data.iter_mut().for_each(|v| *v = [v[0] * turn[0], v[1] * turn[1], v[2]]);
    }
    Ok(field)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::VoxelGrid;

    /// 1e9 HU and no number were metal and water.
    #[test]
    fn voxels_that_are_no_hounsfield_units_are_refused_by_their_place() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan.mha");
        let said = |kind: &str, voxels: &[u8]| {
            let header = format!(
                "ObjectType = Image\nNDims = 3\nBinaryData = True\nElementSpacing = 1 1 1\nDimSize = 3 1 1\n\
                 ElementType = {kind}\nElementDataFile = LOCAL\n"
            );
            std::fs::write(&path, [header.as_bytes(), voxels].concat()).unwrap();
            read_scan(&path).map(|scan| scan.data).map_err(|e| e.to_string())
        };
        let floats = |values: [f32; 3]| values.map(f32::to_le_bytes).concat();
        assert_eq!(said("MET_FLOAT", &floats([-1024.4, 0.5, 32767.0])).unwrap(), [-1024, 1, 32767]);
        for (value, shown) in [(f32::NAN, "NaN"), (f32::INFINITY, "inf"), (40_000.0, "40000"), (-1e9, "-1e9")] {
            let sentence = said("MET_FLOAT", &floats([0.0, value, 0.0])).unwrap_err();
            let says = format!("scan.mha: voxel [1, 0, 0]: Hounsfield units: {shown} must lie in -32768 to 32767");
            assert!(sentence.ends_with(&says), "{sentence}");
        }
        let words = [0u16, 1, 65_535].map(u16::to_le_bytes).concat();
        assert!(said("MET_USHORT", &words).unwrap_err().contains("voxel [2, 0, 0]"));
    }

    #[test]
    fn files_are_read_by_their_ending_and_labels_must_be_labels() {
        let folder = tempfile::tempdir().unwrap();
        let grid = VoxelGrid::upright([2, 1, 1], DVec3::ZERO, DVec3::ONE);
        let path = folder.path().join("Mask.NII.gz");
        let written = folder.path().join("a.nii.gz");
        nifti::write(&written, &Volume { grid, data: vec![0i16, 7] }).unwrap();
        std::fs::rename(&written, &path).unwrap();
        assert_eq!(read_labels(&path).unwrap().data, [0, 7]);
        assert_eq!(read_scan(&path).unwrap().data, [0, 7]);
        // A bit of the checksum or of the length, which stand behind all voxels.
        for from_end in [8, 2] {
            let mut bytes = std::fs::read(&path).unwrap();
            let at = bytes.len() - from_end;
            bytes[at] ^= 1;
            let broken = folder.path().join("broken.nii.gz");
            std::fs::write(&broken, bytes).unwrap();
            let said = read_scan(&broken).unwrap_err().to_string();
            assert!(said.contains("broken.nii.gz: is damaged"), "{said}");
        }
        nifti::write(&written, &Volume { grid, data: vec![0i16, -7] }).unwrap();
        assert!(read_labels(&written).unwrap_err().to_string().contains("holds -7"));
        assert!(read_scan(Path::new("a.png")).unwrap_err().to_string().contains("a folder of DICOM"));
        for (name, says) in [("a.seg.nrrd", "as .nii.gz"), ("t.h5", "displacement field"), ("a.hdr", "two files")] {
            assert!(read_labels(Path::new(name)).unwrap_err().to_string().contains(says), "{name}");
        }
        assert!(read_labels(folder.path()).unwrap_err().to_string().contains("is a folder, and masks"));
        let field = folder.path().join("field.nii");
        nifti::write(&field, &Volume { grid, data: vec![[1f32, 2.0, 3.0]; 2] }).unwrap();
        assert_eq!(read_field(&field).unwrap().data[1], [1.0, 2.0, 3.0]);
        let mut bytes = std::fs::read(&field).unwrap();
        bytes[68..70].copy_from_slice(&1006i16.to_le_bytes());
        std::fs::write(&field, bytes).unwrap();
        assert_eq!(read_field(&field).unwrap().data[1], [-1.0, -2.0, 3.0]);
    }
}
