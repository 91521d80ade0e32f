//! The cache folder: finished products by key, checked before they are used again, one writer at a time.
//!
//! ```text
//! <cache>/.lock                                  held by the process that writes here
//! <cache>/journal.jsonl                          what is finished
//! <cache>/sequences/<case>-<12 digits>/          a sequence
//! <cache>/cells/<case>-<method>-s<seed>-<12>/    prediction/, score.json, timing.json
//! ```

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::Write;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::journal::{self, Journal, JournalEntry};
use super::plan::{Cell, Plan, Planned};
use crate::base::{Error, Result, files, hash};

/// Holds a folder for this process until it is dropped, or the process ends however it ends.
#[derive(Debug)]
pub struct Lock(#[expect(dead_code, reason = "the open file is the lock")] File);

impl Lock {
    /// Takes `<folder>/.lock`; the folder is made when missing. Refuses in one sentence when another process has it.
    pub fn take(folder: &Path) -> Result<Lock> {
        fs::create_dir_all(folder).map_err(|e| Error::io("making the folder", folder, e))?;
        let path = folder.join(".lock");
        let fail = |e| Error::io("writing", &path, e);
        let mut file = OpenOptions::new().create(true).truncate(false).write(true).open(&path).map_err(fail)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let holder = fs::read_to_string(&path).unwrap_or_default();
                let holder = holder.trim();
                return Err(Error::input(format!(
                    "another run works in this folder ({}); wait for it, or choose another folder",
                    if holder.is_empty() { "unknown process" } else { holder }
                ))
                .at(folder));
            }
            Err(TryLockError::Error(e)) => return Err(fail(e)),
        }
        file.set_len(0).and_then(|()| write!(file, "process {}", std::process::id())).map_err(fail)?;
        Ok(Lock(file))
    }
}

/// Where products lie; other files in the folder are left alone.
const FOLDERS: [&str; 2] = ["sequences", "cells"];

/// The state of a product in the cache.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProductState {
    /// There, made from the same key, and its files hash as they did when it was finished.
    Whole,
    /// Never finished.
    Absent,
    /// Finished, but from another key.
    Outdated,
    /// Finished, but its files are not what they were.
    Damaged,
}

/// A cache folder.
#[derive(Debug)]
pub struct Store {
    root: PathBuf,
    entries: BTreeMap<String, JournalEntry>,
    writer: Option<(Journal, Lock)>,
}

impl Store {
    /// Opens for work: takes the lock, clears away what a killed run was writing, reads the journal, cuts off a torn
    /// last line.
    pub fn open(root: &Path) -> Result<Store> {
        let lock = Lock::take(root)?;
        for folder in FOLDERS {
            files::remove_unfinished(&root.join(folder))?;
        }
        let path = root.join("journal.jsonl");
        let (entries, whole) = journal::read(&path)?;
        let journal = Journal::open(&path, whole)?;
        Ok(Store { root: root.to_path_buf(), entries, writer: Some((journal, lock)) })
    }

    /// Opens for reading only; the folder need not exist.
    pub fn look(root: &Path) -> Result<Store> {
        let (entries, _) = journal::read(&root.join("journal.jsonl"))?;
        Ok(Store { root: root.to_path_buf(), entries, writer: None })
    }

    /// The cache folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Where a product lies.
    pub fn path(&self, product: &str) -> PathBuf {
        self.root.join(product)
    }

    /// Checks a product against its key and, when the key fits, its files against their hash.
    pub fn state(&self, product: &str, key: &str) -> ProductState {
        match self.entries.get(product) {
            None => ProductState::Absent,
            Some(entry) if entry.key != key => ProductState::Outdated,
            Some(entry) => match hash_of_files(&self.path(product)) {
                Ok(outputs) if outputs == entry.outputs => ProductState::Whole,
                _ => ProductState::Damaged,
            },
        }
    }

    /// Says that a product is finished, once its files are on disk.
    pub fn commit(&mut self, product: &str, key: &str) -> Result<()> {
        let outputs = hash_of_files(&self.path(product))?;
        let entry = JournalEntry { product: product.into(), key: key.into(), outputs };
        let (journal, _) = self.writer.as_mut().expect("only an opened store is committed to");
        journal.append(&entry)?;
        self.entries.insert(product.into(), entry);
        Ok(())
    }

    /// Removes the files of a product, finished or not.
    pub fn discard(&mut self, product: &str) -> Result<()> {
        let path = self.path(product);
        self.entries.remove(product);
        let outcome = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
        match outcome {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io("removing", &path, e)),
            _ => Ok(()),
        }
    }
}

/// One hash over the names and contents of all files of a folder, or of a single file; hidden files do not count.
pub fn hash_of_files(path: &Path) -> Result<String> {
    if path.is_file() {
        return hash::of_file(path);
    }
    let mut found = Vec::new();
    list_files(path, &mut found)?;
    found.sort();
    let hashes: Vec<String> = found.par_iter().map(|file| hash::of_file(file)).collect::<Result<_>>()?;
    let names = found.iter().map(|file| file.strip_prefix(path).unwrap_or(file).to_string_lossy().into_owned());
    hash::of_value(&names.zip(hashes).collect::<Vec<_>>())
}

fn list_files(folder: &Path, found: &mut Vec<PathBuf>) -> Result<()> {
    let fail = |e| Error::io("reading", folder, e);
    for entry in fs::read_dir(folder).map_err(fail)? {
        let entry = entry.map_err(fail)?;
        let hidden = entry.file_name().to_string_lossy().starts_with('.');
        match entry.file_type().map_err(fail)? {
            _ if hidden => {}
            kind if kind.is_dir() => list_files(&entry.path(), found)?,
            _ => found.push(entry.path()),
        }
    }
    Ok(())
}

/// The sequence of a planned case: its product name and key.
pub fn sequence_product(plan: &Plan, case: &Planned) -> Result<(String, String)> {
    let key = plan.sequence_key(case)?;
    Ok((format!("sequences/{}-{}", case.id, &key[..12]), key))
}

/// The folder of a cell; `prediction` and `score.json` in it are products.
pub fn cell_folder(plan: &Plan, cell: &Cell) -> Result<String> {
    Ok(format!("cells/{}-{}", cell.id(), &plan.prediction_key(cell)?[..12]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_writer_is_refused_and_the_lock_dies_with_its_holder() {
        let folder = tempfile::tempdir().unwrap();
        let first = Store::open(folder.path()).unwrap();
        let refused = Store::open(folder.path()).unwrap_err().to_string();
        assert!(refused.contains("another run") && refused.contains(&std::process::id().to_string()), "{refused}");
        drop(first);
        Store::open(folder.path()).unwrap();
    }

    #[test]
    fn products_are_whole_outdated_damaged_or_absent() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = Store::open(folder.path()).unwrap();
        fs::create_dir_all(store.path("cells/a/deep")).unwrap();
        fs::write(store.path("cells/a/x.png"), "1").unwrap();
        fs::write(store.path("cells/a/deep/y.png"), "2").unwrap();
        assert_eq!(store.state("cells/a", "key"), ProductState::Absent);
        store.commit("cells/a", "key").unwrap();
        assert_eq!(store.state("cells/a", "key"), ProductState::Whole);
        assert_eq!(store.state("cells/a", "other"), ProductState::Outdated);
        drop(store);

        let store = Store::look(folder.path()).unwrap();
        assert_eq!(store.state("cells/a", "key"), ProductState::Whole);
        fs::write(store.path("cells/a/deep/y.png"), "3").unwrap();
        assert_eq!(store.state("cells/a", "key"), ProductState::Damaged);
        fs::write(store.path("cells/a/deep/y.png"), "2").unwrap();
        fs::write(store.path("cells/a/z.png"), "").unwrap();
        assert_eq!(store.state("cells/a", "key"), ProductState::Damaged);
        fs::remove_file(store.path("cells/a/z.png")).unwrap();
        assert_eq!(store.state("cells/a", "key"), ProductState::Whole);
        fs::remove_dir_all(store.path("cells/a")).unwrap();
        assert_eq!(store.state("cells/a", "key"), ProductState::Damaged);
    }

    /// A kill while the costs of a cell are written leaves half a file beside its products.
    #[test]
    fn what_a_killed_run_was_writing_is_cleared_away_by_the_next() {
        let folder = tempfile::tempdir().unwrap();
        let half = |place: &str| {
            fs::create_dir_all(folder.path().join(place)).unwrap();
            let path = folder.path().join(place).join(".Ab12cd.tmp");
            fs::write(&path, "half").unwrap();
            path
        };
        let (cell, film, foreign) = (half("cells/a"), half("sequences"), half("somebody"));
        Store::look(folder.path()).unwrap();
        assert!(cell.exists() && film.exists());
        Store::open(folder.path()).unwrap();
        assert!(!cell.exists() && !film.exists() && foreign.exists());
    }

    #[test]
    fn looking_touches_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let absent = folder.path().join("nowhere");
        assert_eq!(Store::look(&absent).unwrap().state("cells/a", "key"), ProductState::Absent);
        assert!(!absent.exists());
    }
}
