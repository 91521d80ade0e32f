//! DICOM that our own reader does not read (compressed pixels, all slices in one file) by way of `dcm2niix`, a program
//! of its own (Li et al., J Neurosci Methods 264:47, 2016; BSD). Which of several series was meant is never guessed.

use std::path::Path;
use std::process::{Command, Stdio};

use super::program::run;
use crate::base::{Error, Progress, Result, Volume, files};
use crate::formats::dicom::{self, PackedSlices};
use crate::formats::volume;

const PROGRAM: &str = "dcm2niix";

/// The version of dcm2niix, such as `v1.0.20220720`; `None` where it is not installed.
pub fn converter_version() -> Option<String> {
    // It ends with an exit code of its own where it only tells its version.
    let output = Command::new(PROGRAM).arg("--version").stdin(Stdio::null()).output().ok()?;
    let text = String::from_utf8_lossy(&output.stdout).to_string();
    let digit = |word: &str| word.strip_prefix('v').is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_digit()));
    text.split_whitespace().find(|word| digit(word)).map(str::to_owned)
}

/// Reads a scan as [`volume::read_scan`] does, and a folder of packed DICOM by way of dcm2niix where that is installed.
///
/// Errors name the file; what dcm2niix says; a folder of which it makes no volume, or several; the user stopped the work.
pub fn read_scan(path: &Path, progress: &dyn Progress) -> Result<Volume<i16>> {
    if !path.is_dir() {
        return volume::read_scan(path);
    }
    match dicom::packed_slices(path)? {
        Some(slices) if converter_version().is_some() => converted(path, slices, progress).map_err(|e| e.at(path)),
        _ => volume::read_scan(path),
    }
}

fn converted(folder: &Path, slices: PackedSlices, progress: &dyn Progress) -> Result<Volume<i16>> {
    let fail = |e| Error::io("reading", folder, e);
    // No name that begins with a minus is taken for a word of the program.
    let folder = folder.canonicalize().map_err(fail)?;
    let made = tempfile::tempdir().map_err(|e| Error::io("making", &std::env::temp_dir(), e))?;
    // Only this folder, no side files, uncompressed, the series number as name.
    let words = ["-d", "0", "-b", "n", "-z", "n", "-f", "series%s", "-o"];
    let mut command = Command::new(PROGRAM);
    command.args(words).arg(made.path()).arg(&folder);
    run(command, &made.path().join("dcm2niix.out"), progress)?;
    let (mut volumes, mut taken) = (Vec::new(), 0);
    for path in files::all_directly_in(made.path())?.iter().filter(|path| path.extension().is_some_and(|e| e == "nii"))
    {
        let scan = volume::read_scan(path)?;
        taken += scan.grid.size[2];
        // Scouts are single slices.
        if scan.grid.size[2] > 1 {
            let name = path.file_stem().unwrap_or_default().to_string_lossy().to_string();
            volumes.push((name, scan));
        }
    }
    // It drops what it takes for doubles and goes on.
    if slices.many == 0 && taken != slices.single {
        let sentence =
            format!("{PROGRAM} makes {taken} slices of its {}: convert it by hand and look at it", slices.single);
        return Err(Error::input(sentence));
    }
    let names: Vec<String> = volumes.iter().map(|(name, scan)| format!("{name} of {:?}", scan.grid.size)).collect();
    match (volumes.pop(), names.len()) {
        (Some((_, scan)), 1) => Ok(scan),
        (None, _) => Err(Error::input(format!("{PROGRAM} makes no volume of it"))),
        (_, count) => Err(Error::input(format!(
            "{PROGRAM} makes {count} volumes of it ({}), and one is wanted: convert it by hand, look at them, and give \
             the wanted .nii.gz",
            names.join(", ")
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::NoProgress;
    use crate::formats::dicom::tests::{PLAIN, RLE, write};
    use crate::skip::skip;

    const WITHOUT: &str = "dcm2niix is not installed (scripts/setup.sh --ct)";

    /// Slices with run-length encoded pixels are read as those without, value by value.
    #[test]
    fn compressed_slices_are_read_by_way_of_dcm2niix() {
        let Some(version) = converter_version() else {
            return skip("dcm2niix", WITHOUT);
        };
        println!("dcm2niix {version}");
        let folders = [PLAIN, RLE].map(|syntax| {
            let folder = tempfile::tempdir().unwrap();
            for (name, k) in [("c", 0), ("a", 2), ("b", 1)] {
                write(folder.path(), name, 100.0 + 1.5 * f64::from(k), "1.2", 300 + 7 * k, syntax);
            }
            folder
        });
        let [plain, packed] = folders.each_ref().map(|folder| read_scan(folder.path(), &NoProgress).unwrap());
        assert_eq!(dicom::packed_slices(folders[0].path()).unwrap(), None);
        let three = PackedSlices { single: 3, many: 0 };
        assert_eq!(dicom::packed_slices(folders[1].path()).unwrap(), Some(three));
        assert!(dicom::read_folder(folders[1].path()).unwrap_err().to_string().contains("compressed"));
        let (plain, packed) = (crate::ct::scan::turned(plain), crate::ct::scan::turned(packed));
        assert!(plain.grid.same_as(&packed.grid), "{:?} {:?}", plain.grid, packed.grid);
        assert_eq!(plain.data, packed.data);
    }

    /// dcm2niix takes slices of one number for doubles.
    #[test]
    fn slices_that_are_dropped_are_missed() {
        if converter_version().is_none() {
            return skip("dcm2niix", WITHOUT);
        }
        let folder = tempfile::tempdir().unwrap();
        for (name, z) in [("a", 0.0), ("b", 1.0), ("c", 1.01)] {
            write(folder.path(), name, z, "1.2", 10, RLE);
        }
        let said = read_scan(folder.path(), &NoProgress).unwrap_err().to_string();
        assert!(said.contains("slices of its 3"), "{said}");
    }

    #[test]
    fn which_of_two_series_was_meant_is_not_guessed() {
        if converter_version().is_none() {
            return skip("dcm2niix", WITHOUT);
        }
        let folder = tempfile::tempdir().unwrap();
        for (name, z, series) in [("a", 0.0, "1.2"), ("b", 1.0, "1.2"), ("c", 0.0, "1.3"), ("d", 1.0, "1.3")] {
            write(folder.path(), name, z, series, 10, RLE);
        }
        let said = read_scan(folder.path(), &NoProgress).unwrap_err().to_string();
        assert!(said.contains("makes 2 volumes of it") && said.contains("one is wanted"), "{said}");
    }
}
