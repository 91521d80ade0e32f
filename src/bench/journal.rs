//! The journal: one JSON line per finished product, appended and synced, so that what a line says is on disk.
//!
//! A run can be killed at any moment: a torn last line is ignored (and cut off before the next one is written); any
//! other unreadable line means damage and is an error.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::base::{Error, Result, files};

/// A finished product.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JournalEntry {
    /// Folder or file below the cache folder.
    pub product: String,
    /// Hash of everything that it depends on.
    pub key: String,
    /// Hash of its files.
    pub outputs: String,
}

/// An open journal file.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
}

/// The newest entry of each product, and how many bytes of the file are whole lines. A missing file is an empty
/// journal.
pub fn read(path: &Path) -> Result<(BTreeMap<String, JournalEntry>, u64)> {
    if !path.exists() {
        return Ok((BTreeMap::new(), 0));
    }
    let bytes = files::read_bytes(path)?;
    let whole = bytes.iter().rposition(|&b| b == b'\n').map_or(0, |last| last + 1);
    let mut entries = BTreeMap::new();
    for (number, line) in bytes[..whole].split(|&b| b == b'\n').enumerate().filter(|(_, line)| !line.is_empty()) {
        let entry: JournalEntry = serde_json::from_slice(line).map_err(|e| {
            Error::input(format!("is damaged ({e}); remove the file to start afresh"))
                .element(format!("line {}", number + 1))
                .at(path)
        })?;
        entries.insert(entry.product.clone(), entry);
    }
    Ok((entries, whole as u64))
}

impl Journal {
    /// Opens for appending after the `whole` bytes that [`read`] understood; cuts off a torn last line.
    pub fn open(path: &Path, whole: u64) -> Result<Self> {
        let fail = |e| Error::io("writing", path, e);
        let mut file = OpenOptions::new().create(true).truncate(false).write(true).open(path).map_err(fail)?;
        file.set_len(whole).map_err(fail)?;
        file.seek(SeekFrom::End(0)).map_err(fail)?;
        Ok(Journal { path: path.to_path_buf(), file })
    }

    /// Appends a line and waits until it is on disk.
    pub fn append(&mut self, entry: &JournalEntry) -> Result<()> {
        let mut line = serde_json::to_vec(entry).map_err(|e| Error::input(e.to_string()).at(&self.path))?;
        line.push(b'\n');
        let written = self.file.write_all(&line).and_then(|()| self.file.sync_data());
        written.map_err(|e| Error::io("writing", &self.path, e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(product: &str, key: &str) -> JournalEntry {
        JournalEntry { product: product.into(), key: key.into(), outputs: "o".into() }
    }

    #[test]
    fn every_torn_tail_is_survived_and_the_last_entry_counts() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal.jsonl");
        let mut journal = Journal::open(&path, 0).unwrap();
        for e in [entry("a", "1"), entry("b", "1"), entry("a", "2")] {
            journal.append(&e).unwrap();
        }
        let bytes = std::fs::read(&path).unwrap();
        let line = bytes.len() / 3;
        for length in 0..=bytes.len() {
            std::fs::write(&path, &bytes[..length]).unwrap();
            let (entries, whole) = read(&path).unwrap();
            assert_eq!(whole as usize, length / line * line, "cut at {length}");
            Journal::open(&path, whole).unwrap().append(&entry("c", "9")).unwrap();
            let (after, _) = read(&path).unwrap();
            assert_eq!(after.len(), entries.len() + 1);
            assert_eq!(after["c"], entry("c", "9"));
        }
        std::fs::write(&path, &bytes).unwrap();
        assert_eq!(read(&path).unwrap().0["a"].key, "2");
    }

    #[test]
    fn damage_in_the_middle_is_an_error_that_names_the_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal.jsonl");
        std::fs::write(&path, "{\"product\":\"a\",\"key\":\"1\",\"outputs\":\"o\"}\nrubbish\n").unwrap();
        let error = read(&path).unwrap_err().to_string();
        assert!(error.contains("journal.jsonl: line 2: is damaged"), "{error}");
    }
}
