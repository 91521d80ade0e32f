//! Files that are either whole or absent: temporary file in the same folder, write, sync, rename, sync the folder.
//! Reading takes paths on disk and those of carried files ([`super::shipped`]).

use std::fs::{self, File};
use std::io::{BufWriter, Read, Write};
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::error::{Error, Result};
use super::estimate::demand_memory;
use super::shipped;

/// How the name of an unfinished file begins and ends.
const UNFINISHED: (&str, &str) = (".", ".tmp");
/// Permissions that a file is opened with; the system takes away those of the process's mask (`umask`).
const FOR_EVERYBODY: u32 = 0o666;
/// Most bytes that are read from a pipe, whose length nobody knows, and beyond the length of a file that grows.
const MOST_UNKNOWN_BYTES: u64 = 1 << 28;

/// Writes `path` in one atomic step through `write`; the folder is made when missing. On failure the old file, if
/// any, stays as it was and nothing else is left behind.
pub fn write_atomically(path: &Path, write: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<()> {
    let folder = match path.parent() {
        Some(p) if !p.as_os_str().is_empty() => p,
        _ => Path::new("."),
    };
    let fail = |e| Error::io("writing", path, e);
    if shipped::below_root(path).is_some() {
        return Err(Error::input("what the program carries cannot be written").at(path));
    }
    fs::create_dir_all(folder).map_err(fail)?;
    let mut unfinished = tempfile::Builder::new();
    // Temporary files are made for the owner alone; results are for whom the user's mask lets in.
    unfinished.prefix(UNFINISHED.0).suffix(UNFINISHED.1).permissions(fs::Permissions::from_mode(FOR_EVERYBODY));
    let file = unfinished.tempfile_in(folder).map_err(fail)?;
    let mut buffered = BufWriter::new(file);
    write(&mut buffered).map_err(fail)?;
    let file = buffered.into_inner().map_err(|e| fail(e.into_error()))?;
    file.as_file().sync_all().map_err(fail)?;
    file.persist(path).map_err(|e| fail(e.error))?;
    File::open(folder).and_then(|f| f.sync_all()).map_err(fail)
}

/// Removes what a kill in the middle of [`write_atomically`] left behind in `folder` and below it. Call it only as the
/// folder's one writer. A missing folder counts as empty.
pub fn remove_unfinished(folder: &Path) -> Result<()> {
    let fail = |e| Error::io("reading", folder, e);
    let entries = match fs::read_dir(folder) {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        entries => entries.map_err(fail)?,
    };
    for entry in entries {
        let entry = entry.map_err(fail)?;
        let (kind, path) = (entry.file_type().map_err(fail)?, entry.path());
        if kind.is_dir() {
            remove_unfinished(&path)?;
        } else if kind.is_file() && is_unfinished(&entry.file_name().to_string_lossy()) {
            fs::remove_file(&path).map_err(|e| Error::io("removing", &path, e))?;
        }
    }
    Ok(())
}

/// All files in `folder` and below it, sorted; links are files.
pub fn all_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let fail = |e| Error::io("reading", folder, e);
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(fail)? {
        let entry = entry.map_err(fail)?;
        match entry.file_type().map_err(fail)?.is_dir() {
            true => found.extend(all_in(&entry.path())?),
            false => found.push(entry.path()),
        }
    }
    found.sort();
    Ok(found)
}

/// What stands in `folder` itself, sorted.
fn entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let fail = |e| Error::io("reading", folder, e);
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(fail)? {
        found.push(entry.map_err(fail)?.path());
    }
    found.sort();
    Ok(found)
}

/// All files that stand in `folder` itself, sorted.
pub fn all_directly_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = entries(folder)?;
    found.retain(|path| path.is_file());
    Ok(found)
}

/// All folders that stand in `folder` itself, sorted.
pub fn folders_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = entries(folder)?;
    found.retain(|path| path.is_dir());
    Ok(found)
}

/// Names of all files and folders that stand in `folder` itself, sorted.
pub fn names_in(folder: &Path) -> Result<Vec<PathBuf>> {
    Ok(entries(folder)?.iter().filter_map(|path| path.file_name()).map(PathBuf::from).collect())
}

/// Sets the time of change of `folder` and of everything in it.
pub fn set_modified_below(folder: &Path, time: SystemTime) -> Result<()> {
    let fail = |e| Error::io("writing", folder, e);
    for entry in fs::read_dir(folder).map_err(fail)? {
        let entry = entry.map_err(fail)?;
        let path = entry.path();
        if entry.file_type().map_err(fail)?.is_dir() {
            set_modified_below(&path, time)?;
        } else {
            File::open(&path).and_then(|file| file.set_modified(time)).map_err(|e| Error::io("writing", &path, e))?;
        }
    }
    File::open(folder).and_then(|opened| opened.set_modified(time)).map_err(fail)
}

/// Whether a name is one that [`write_atomically`] gives to unfinished files.
pub fn is_unfinished(name: &str) -> bool {
    name.starts_with(UNFINISHED.0) && name.ends_with(UNFINISHED.1)
}

/// [`write_atomically`] for bytes in memory.
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    write_atomically(path, |w| w.write_all(bytes))
}

/// Pretty JSON with a final newline.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    let mut text = serde_json::to_string_pretty(value).map_err(|e| Error::input(e.to_string()).at(path))?;
    text.push('\n');
    write_bytes(path, text.as_bytes())
}

/// Refuses what has no end: a device, a socket. The length of a file in bytes; `None` for a pipe.
fn bounded_length(path: &Path) -> Result<Option<u64>> {
    let about = fs::metadata(path).map_err(|e| Error::io("reading", path, e))?;
    match about.file_type() {
        kind if kind.is_fifo() => Ok(None),
        kind if kind.is_file() || kind.is_dir() => Ok(Some(about.len())),
        _ => Err(Error::input("is neither a file nor a pipe").at(path)),
    }
}

/// Reads the whole of a file, or of a pipe up to [`MOST_UNKNOWN_BYTES`].
fn read_bounded(path: &Path) -> Result<Vec<u8>> {
    let length = bounded_length(path)?;
    demand_memory("its content", length.unwrap_or(0) as f64).map_err(|e| e.at(path))?;
    let most = length.unwrap_or(0).saturating_add(MOST_UNKNOWN_BYTES);
    let mut bytes = Vec::with_capacity(usize::try_from(length.unwrap_or(0)).unwrap_or(0));
    let read = File::open(path).and_then(|file| file.take(most + 1).read_to_end(&mut bytes));
    match read.map_err(|e| Error::io("reading", path, e))? as u64 {
        count if count > most => Err(Error::input(format!("does not end after {most} bytes")).at(path)),
        _ => Ok(bytes),
    }
}

/// Reads a whole file or pipe.
///
/// Errors: neither of both (a device, which may have no end); more than this machine has memory for.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    match shipped::below_root(path) {
        Some(inside) => {
            shipped::bytes(inside).map(<[u8]>::to_vec).ok_or_else(|| Error::io("reading", path, not_carried("file")))
        }
        None => read_bounded(path),
    }
}

/// Reads a whole UTF-8 file or pipe. Errors as [`read_bytes`].
pub fn read_text(path: &Path) -> Result<String> {
    let not_text = |_| std::io::Error::new(std::io::ErrorKind::InvalidData, "it is not UTF-8");
    String::from_utf8(read_bytes(path)?).map_err(|e| Error::io("reading", path, not_text(e)))
}

/// Whether there is a file at `path`.
pub fn is_file(path: &Path) -> bool {
    match shipped::below_root(path) {
        Some(inside) => shipped::bytes(inside).is_some(),
        None => path.is_file(),
    }
}

/// Names of the TOML files in `folder` without `.toml`, sorted by bytes. Errors: a name that is not UTF-8.
pub fn toml_stems(folder: &Path) -> Result<Vec<String>> {
    let fail = |e| Error::io("reading", folder, e);
    let mut stems = Vec::new();
    if let Some(inside) = shipped::below_root(folder) {
        let names = shipped::names(inside).ok_or_else(|| fail(not_carried("folder")))?;
        stems.extend(names.iter().filter_map(|name| name.strip_suffix(".toml")).map(str::to_owned));
    } else {
        for entry in fs::read_dir(folder).map_err(fail)? {
            let path = entry.map_err(fail)?.path();
            if path.extension().is_some_and(|extension| extension == "toml") {
                let stem = path.file_stem().and_then(|stem| stem.to_str());
                stems.push(stem.ok_or_else(|| Error::input("the file name is not UTF-8").at(&path))?.to_owned());
            }
        }
    }
    stems.sort();
    Ok(stems)
}

fn not_carried(what: &str) -> std::io::Error {
    std::io::Error::new(std::io::ErrorKind::NotFound, format!("the program carries no such {what}"))
}

/// Reads JSON; the error names line and column.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    serde_json::from_str(&read_text(path)?).map_err(|e| Error::input(e.to_string()).at(path))
}

/// Reads TOML; the error names line and column, and shows the line.
#[cfg(feature = "methods")]
pub fn read_toml<T: DeserializeOwned>(path: &Path) -> Result<T> {
    parse_toml(&read_text(path)?, path)
}

/// [`read_toml`] of the text of the file `path`.
#[cfg(feature = "methods")]
pub fn parse_toml<T: DeserializeOwned>(text: &str, path: &Path) -> Result<T> {
    toml::from_str(text).map_err(|e| {
        let error = Error::input(e.message().trim_end().replace('\n', ", ")).at(path);
        match e.span() {
            Some(span) => error.element(place(text, span.start)),
            None => error,
        }
    })
}

/// Sets `value` at `path` and makes the path where it is missing: a case file leaves out what has a default.
#[cfg(feature = "methods")]
pub fn insert_toml(table: &mut toml::Table, path: &[&str], value: toml::Value) -> Result<()> {
    let (last, groups) = path.split_last().ok_or_else(|| Error::input("an empty key"))?;
    let mut at = table;
    for group in groups {
        at = at
            .entry(*group)
            .or_insert_with(|| toml::Value::Table(toml::Table::new()))
            .as_table_mut()
            .ok_or_else(|| Error::input(format!("`{group}` in `{}` is no table", path.join("."))))?;
    }
    at.insert((*last).to_owned(), value);
    Ok(())
}

/// Line and column of the byte `offset` of `text`, counted from 1, with the beginning of its line.
#[cfg(feature = "methods")]
fn place(text: &str, offset: usize) -> String {
    let before = text.get(..offset).unwrap_or(text);
    let line_start = before.rfind('\n').map_or(0, |end| end + 1);
    let line: String = text[line_start..].lines().next().unwrap_or("").trim().chars().take(60).collect();
    let (row, column) = (before.matches('\n').count() + 1, before[line_start..].chars().count() + 1);
    format!("line {row}, column {column} (`{line}`)")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_toml_mistake_is_one_line_that_says_where() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("case.toml");
        let mistake = |text: &str| {
            write_bytes(&path, text.as_bytes()).unwrap();
            read_toml::<std::collections::BTreeMap<String, u32>>(&path).unwrap_err().to_string()
        };
        let wrong_type = mistake("a = 1\nb = \"x\"\n");
        assert!(wrong_type.contains("case.toml: line 2, column 5 (`b = \"x\"`): invalid type"), "{wrong_type}");
        let broken = mistake("a = [1\n");
        assert!(broken.contains("case.toml: line ") && !broken.contains('\n'), "{broken}");
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b.txt");
        write_bytes(&path, b"old").unwrap();
        let failed = write_atomically(&path, |w| {
            w.write_all(b"half")?;
            Err(std::io::Error::other("disk full"))
        });
        assert!(failed.unwrap_err().to_string().contains("b.txt"));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(folder.path().join("a")).unwrap().count(), 1);
    }

    #[test]
    fn what_a_kill_left_behind_is_removed_at_any_depth_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        for name in ["a/b/.Ab12cd.tmp", ".Ef34gh.tmp", "a/kept.tmp", "a/.lock", "a/b/kept.png"] {
            write_bytes(&place(name), b"x").unwrap();
        }
        std::os::unix::fs::symlink("kept.tmp", place("a/.link.tmp")).unwrap();
        remove_unfinished(folder.path()).unwrap();
        assert!(!place("a/b/.Ab12cd.tmp").exists() && !place(".Ef34gh.tmp").exists());
        for name in ["a/kept.tmp", "a/.lock", "a/b/kept.png", "a/.link.tmp"] {
            assert!(place(name).exists(), "{name}");
        }
        remove_unfinished(&place("nowhere")).unwrap();
    }

    #[test]
    fn what_has_no_end_is_refused_and_a_pipe_is_read() {
        for device in ["/dev/zero", "/dev/full"] {
            for said in [read_bytes(Path::new(device)).unwrap_err(), read_text(Path::new(device)).unwrap_err()] {
                assert_eq!(said.to_string(), format!("{device}: is neither a file nor a pipe"));
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let hollow = folder.path().join("hollow");
        File::create(&hollow).unwrap().set_len(1 << 43).unwrap();
        let said = read_bytes(&hollow).unwrap_err().to_string();
        assert!(said.contains("hollow: its content would take"), "{said}");
        assert!(read_bytes(folder.path()).unwrap_err().to_string().contains("reading failed"));
        let text = folder.path().join("text");
        fs::write(&text, [0xff]).unwrap();
        assert!(read_text(&text).unwrap_err().to_string().contains("UTF-8"));
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        std::thread::scope(|scope| {
            scope.spawn(|| fs::write(&pipe, "told").unwrap());
            assert_eq!(read_text(&pipe).unwrap(), "told");
        });
    }

    #[test]
    fn toml_takes_keys_that_were_left_out() {
        let mut table: toml::Table = toml::from_str("id = 'a'").unwrap();
        insert_toml(&mut table, &["waveform", "hold_s"], toml::Value::from(2.0)).unwrap();
        assert_eq!(table["waveform"]["hold_s"].as_float(), Some(2.0));
        assert!(insert_toml(&mut table, &["id", "x"], toml::Value::from(1)).is_err());
    }
}
