//! The cache folder: finished products by key, checked before they are used again. Any number of processes share it,
//! on one machine or on several, without locks of the file system.
//!
//! ```text
//! <cache>/sequences/<case>-<12 digits>/          film/, timing.json
//! <cache>/cells/<case>-<method>-s<seed>-<12>/    prediction/, score/score.json, timing.json
//! ```
//!
//! Each of these folders is one piece of work: a process claims it (`claim.rs`) before it makes or discards a product in
//! it. A product is made under a hidden name, gets its finish marker `.finished.json` (key and hash), and is renamed into
//! place: readers see a whole product or none.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::claim::{self, Asked, Claim, Claims, DISCARDED, MAKING};
use super::plan::{Cell, Plan, Planned};
use crate::base::{Error, ErrorKind, Result, files, hash};

/// Name of a product's finish marker.
pub const MARKER: &str = ".finished.json";

/// The finish marker of a product.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FinishMarker {
    /// Hash of everything that the product depends on.
    pub key: String,
    /// Hash of its files.
    pub outputs: String,
    /// Hash of its files' names, sizes and times of change. As long as it holds, the files are not read again.
    pub listing: String,
}

/// The state of a product in the cache.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProductState {
    /// There, made from the same key, and its files are as they were when it was finished.
    Whole,
    /// Never finished.
    Absent,
    /// Finished, but from another key.
    Outdated,
    /// Finished, but its files are not what they were.
    Damaged,
}

/// What came of a product that somebody could not use.
#[derive(Debug)]
pub enum Unusable {
    /// It is whole, or nothing can be read there at the moment: something else is wrong.
    Whole,
    /// The product is no longer there: removed now, since its files are not those that were finished, or by another
    /// process before.
    Removed(PathBuf),
    /// Another process works on it.
    Held(claim::Holder),
}

/// How closely a product's files are looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scrutiny {
    /// By names, sizes and times of change, and read only where these differ: enough for who finds out by reading them.
    Listing,
    /// All are read: a failing disk changes neither size nor time.
    Content,
}

/// A piece of work that this process has claimed.
#[derive(Debug)]
pub struct Work {
    folder: PathBuf,
    claim: Claim,
}

impl Work {
    /// A folder for the product of that name; what an ended process had begun is in it.
    pub fn resume(&self, product: &str) -> Result<PathBuf> {
        let own = self.making(product);
        let begun = claim::unfinished(&self.folder)?;
        if let Some(begun) = begun.iter().find(|name| name.starts_with(&format!("{MAKING}{product}-"))) {
            let from = self.folder.join(begun);
            fs::rename(&from, &own).map_err(|e| Error::io("writing", &from, e))?;
            // What was being written when the process ended.
            files::remove_unfinished(&own)?;
        }
        Ok(own)
    }

    /// An empty folder for the product of that name.
    pub fn begin(&self, product: &str) -> Result<PathBuf> {
        let own = self.making(product);
        claim::remove_folder(&own)?;
        fs::create_dir_all(&own).map_err(|e| Error::io("making the folder", &own, e))?;
        Ok(own)
    }

    /// Whether the work is still this process': false once another one has taken it for dead. What it makes then is
    /// worth nothing.
    pub fn is_held(&self) -> Result<bool> {
        self.claim.is_held()
    }

    /// The process that has the work now; this one where nobody has.
    pub fn holder_now(&self) -> Result<claim::Holder> {
        self.claim.holder_now()
    }

    fn making(&self, product: &str) -> PathBuf {
        self.folder.join(format!("{MAKING}{product}-{}", self.claim.token()))
    }

    /// Marks a product as finished and moves it into place, once its files are on disk.
    ///
    /// Errors: a folder that cannot be written; work that is another process' by now ([`Work::is_held`]).
    pub fn publish(&self, product: &str, key: &str) -> Result<()> {
        let (own, place) = (self.making(product), self.folder.join(product));
        let marker = FinishMarker { key: key.into(), outputs: hash_of_files(&own)?, listing: hash_of_listing(&own)? };
        files::write_json(&own.join(MARKER), &marker)?;
        // Its folder may have been cleared away and made anew by the next file that was written.
        if !self.is_held()? {
            claim::remove_folder(&own)?;
            return Err(Error::new(ErrorKind::CellFailed, "another process has taken the work over").at(&place));
        }
        let moved = match fs::rename(&own, &place) {
            // Another process took this one for dead and has finished.
            Err(e) if claim::is_occupied(&e) && state_of(&place, key, Scrutiny::Content)? == ProductState::Whole => {
                return claim::remove_folder(&own);
            }
            Err(e) if claim::is_occupied(&e) => {
                self.discard(product)?;
                fs::rename(&own, &place)
            }
            moved => moved,
        };
        moved.and_then(|()| File::open(&self.folder)?.sync_all()).map_err(|e| Error::io("writing", &place, e))
    }

    /// Gives up a product that is being made.
    pub fn abandon(&self, product: &str) -> Result<()> {
        claim::remove_folder(&self.making(product))
    }

    /// Removes a finished product.
    pub fn discard(&self, product: &str) -> Result<()> {
        let aside = self.folder.join(format!("{DISCARDED}{product}-{}", self.claim.token()));
        claim::remove_renamed(&self.folder.join(product), &aside)
    }

    /// Gives the work back.
    pub fn release(self) -> Result<()> {
        self.claim.release()
    }
}

/// A finish of a product, unlike any other of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Finish {
    file: u64,
    written: SystemTime,
}

/// A cache folder.
#[derive(Debug)]
pub struct Store {
    root: PathBuf,
    claims: Claims,
}

impl Store {
    /// The cache at `root`, for work: the folder is made when missing.
    pub fn open(root: &Path) -> Result<Store> {
        fs::create_dir_all(root).map_err(|e| Error::io("making the folder", root, e))?;
        Ok(Store::look(root))
    }

    /// The cache at `root`, which need not exist, for reading.
    pub fn look(root: &Path) -> Store {
        Store { root: root.to_path_buf(), claims: Claims::default() }
    }

    /// The cache folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Where a product or piece of work lies.
    pub fn path(&self, product: &str) -> PathBuf {
        self.root.join(product)
    }

    /// Checks a product against its key and, when the key fits, its files.
    ///
    /// Errors: files that are there and cannot be read.
    pub fn state(&self, product: &str, key: &str, scrutiny: Scrutiny) -> Result<ProductState> {
        state_of(&self.path(product), key, scrutiny)
    }

    /// The folder of the product in which `path` lies, if its files are not those that were finished.
    pub fn damaged(&self, path: &Path) -> Option<PathBuf> {
        let place = self.product_of(path).map(|product| self.path(&product))?;
        is_damaged(&place).then_some(place)
    }

    /// Removes the product in which `path` lies, for whoever could not use that file, if its files are not those that were
    /// finished.
    ///
    /// Errors: a folder that cannot be removed.
    pub fn discard_damaged(&self, path: &Path) -> Result<Unusable> {
        let Some(product) = self.product_of(path) else { return Ok(Unusable::Whole) };
        let place = self.path(&product);
        // Known before the files are read: what is made again meanwhile is another one.
        let Some(finish) = self.finish(&product) else { return Ok(Unusable::Removed(place)) };
        if !is_damaged(&place) {
            return Ok(Unusable::Whole);
        }
        let (work, name) = product.rsplit_once('/').unwrap_or_default();
        let claimed = match self.claim(work, &[])? {
            Ok(claimed) => claimed,
            Err(holder) => return Ok(Unusable::Held(holder)),
        };
        if self.finish(&product) == Some(finish) {
            claimed.discard(name)?;
        }
        claimed.release()?;
        Ok(Unusable::Removed(place))
    }

    /// The product in which `path` lies. What is being made is none.
    fn product_of(&self, path: &Path) -> Option<String> {
        let names: Vec<&str> = path.strip_prefix(&self.root).into_iter().flatten().filter_map(OsStr::to_str).collect();
        match names[..] {
            [kind, work, product, ..] if !product.starts_with('.') => Some(format!("{kind}/{work}/{product}")),
            _ => None,
        }
    }

    /// Which finish of a product this is: another one after it was made again, whatever any clock says. `None` where it
    /// was never finished.
    pub fn finish(&self, product: &str) -> Option<Finish> {
        let data = fs::metadata(self.path(product).join(MARKER)).ok()?;
        Some(Finish { file: data.ino(), written: data.modified().ok()? })
    }

    /// Claims the piece of work of that name; who else has it where that fails. What an ended process left is removed,
    /// but for begun products of the names `kept`.
    ///
    /// Errors: a folder that cannot be read or written.
    pub fn claim(&self, work: &str, kept: &[&str]) -> Result<std::result::Result<Work, claim::Holder>> {
        let folder = self.path(work);
        let kept: Vec<String> = kept.iter().map(|product| format!("{MAKING}{product}-")).collect();
        let kept: Vec<&str> = kept.iter().map(String::as_str).collect();
        Ok(match self.claims.ask(&folder, &kept)? {
            Asked::Granted(claim) => Ok(Work { folder, claim }),
            Asked::Held(holder) => Err(holder),
        })
    }

    /// Clears away what a process left that ended between its last product and giving the work back.
    pub fn tidy(&self, work: &str) -> Result<()> {
        let folder = self.path(work);
        let is_tidy = !claim::is_claimed(&folder) && claim::unfinished(&folder)?.is_empty();
        match is_tidy {
            true => Ok(()),
            // A live process' claim is its own affair.
            false => self.claim(work, &[])?.map_or(Ok(()), Work::release),
        }
    }
}

/// Whether a finished product's files can be read, and are not those that were finished.
fn is_damaged(place: &Path) -> bool {
    let marker = files::read_json::<FinishMarker>(&place.join(MARKER));
    marker.is_ok_and(|marker| hash_of_files(place).is_ok_and(|found| found != marker.outputs))
}

/// Errors: a marker or a file that is there and cannot be read: what a bad moment of the disk hides is not damaged.
fn state_of(place: &Path, key: &str, scrutiny: Scrutiny) -> Result<ProductState> {
    let path = place.join(MARKER);
    let text = match fs::read(&path) {
        Err(_) if !path.exists() => {
            // A link that leads nowhere is in the way of what would be made.
            let is_there = fs::symlink_metadata(place).is_ok();
            return Ok(if is_there { ProductState::Damaged } else { ProductState::Absent });
        }
        read => read.map_err(|e| Error::io("reading", &path, e))?,
    };
    let Ok(marker) = serde_json::from_slice::<FinishMarker>(&text) else { return Ok(ProductState::Damaged) };
    if marker.key != key {
        return Ok(ProductState::Outdated);
    }
    // Copied files have other times, and are read.
    let is_whole = hash_of_listing(place).and_then(|listing| {
        let is_taken = scrutiny == Scrutiny::Listing && listing == marker.listing;
        Ok(is_taken || hash_of_files(place)? == marker.outputs)
    });
    match is_whole {
        Ok(true) => Ok(ProductState::Whole),
        Ok(false) => Ok(ProductState::Damaged),
        // A link that leads nowhere; or another process clears it away meanwhile.
        Err(error) if error.path().is_none_or(|path| !path.exists()) => Ok(ProductState::Damaged),
        Err(error) => Err(error),
    }
}

/// One hash over the names and contents of all files of a folder, or of a single file; hidden files do not count.
pub fn hash_of_files(path: &Path) -> Result<String> {
    if path.is_file() {
        return hash::of_file(path);
    }
    let found = list_files(path)?;
    // A pipe would never end, and a link may lead nowhere. What cannot be looked at is an error and no other content.
    let hash_of = |file: &PathBuf| match file.metadata() {
        Ok(data) if data.is_file() => hash::of_file(file),
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io("reading", file, e)),
        _ => Ok("no file".to_owned()),
    };
    let hashes: Vec<String> = found.par_iter().map(hash_of).collect::<Result<_>>()?;
    hash::of_value(&names(path, &found).zip(hashes).collect::<Vec<_>>())
}

/// One hash over the names, sizes and times of change of all files of a folder; hidden files do not count.
fn hash_of_listing(path: &Path) -> Result<String> {
    let found = list_files(path)?;
    let seen = |file: &PathBuf| -> std::io::Result<(u64, String)> {
        let data = file.metadata()?;
        let changed = data.modified()?.duration_since(UNIX_EPOCH).unwrap_or_default();
        Ok((data.len(), changed.as_nanos().to_string()))
    };
    let looks: Vec<(u64, String)> =
        found.iter().map(|file| seen(file).map_err(|e| Error::io("reading", file, e))).collect::<Result<_>>()?;
    hash::of_value(&names(path, &found).zip(looks).collect::<Vec<_>>())
}

fn names<'a>(folder: &'a Path, found: &'a [PathBuf]) -> impl Iterator<Item = String> + 'a {
    found.iter().map(move |file| file.strip_prefix(folder).unwrap_or(file).to_string_lossy().into_owned())
}

/// All files in a folder and below it, sorted; hidden ones are left out.
fn list_files(folder: &Path) -> Result<Vec<PathBuf>> {
    fn collect(folder: &Path, found: &mut Vec<PathBuf>) -> Result<()> {
        let fail = |e| Error::io("reading", folder, e);
        for entry in fs::read_dir(folder).map_err(fail)? {
            let entry = entry.map_err(fail)?;
            let hidden = entry.file_name().to_string_lossy().starts_with('.');
            match entry.file_type().map_err(fail)? {
                _ if hidden => {}
                kind if kind.is_dir() => collect(&entry.path(), found)?,
                _ => found.push(entry.path()),
            }
        }
        Ok(())
    }
    let mut found = Vec::new();
    collect(folder, &mut found)?;
    found.sort();
    Ok(found)
}

/// The folder of a planned case's work; `film` in it is a product.
pub fn film_folder(plan: &Plan, case: &Planned) -> Result<String> {
    Ok(format!("sequences/{}-{}", case.id, &plan.sequence_key(case)?[..12]))
}

/// The folder of a cell's work; `prediction` and `score` in it are products.
pub fn cell_folder(plan: &Plan, cell: &Cell) -> Result<String> {
    Ok(format!("cells/{}-{}", cell.id(), &plan.prediction_key(cell)?[..12]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claimed(store: &Store, work: &str) -> Work {
        store.claim(work, &["film"]).unwrap().unwrap()
    }

    fn make(work: &Work, product: &str, key: &str) {
        let making = work.begin(product).unwrap();
        files::write_bytes(&making.join("x.png"), b"1").unwrap();
        files::write_bytes(&making.join("deep/y.png"), b"2").unwrap();
        work.publish(product, key).unwrap();
    }

    #[test]
    fn products_are_whole_outdated_damaged_or_absent() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::look(folder.path());
        let work = claimed(&store, "cells/a");
        let state = |key: &str| Store::look(folder.path()).state("cells/a/score", key, Scrutiny::Listing).unwrap();
        let _ = work.begin("score").unwrap();
        assert_eq!(state("key"), ProductState::Absent, "what is being made is not there");
        make(&work, "score", "key");
        assert_eq!(state("key"), ProductState::Whole);
        assert_eq!(state("other"), ProductState::Outdated);
        work.release().unwrap();

        let file = |name: &str| store.path("cells/a/score").join(name);
        fs::write(file("deep/y.png"), "3").unwrap();
        assert_eq!(state("key"), ProductState::Damaged);
        // The times of change differ now, and the files are read.
        fs::write(file("deep/y.png"), "2").unwrap();
        assert_eq!(state("key"), ProductState::Whole);
        fs::write(file("z.png"), "").unwrap();
        assert_eq!(state("key"), ProductState::Damaged);
        fs::remove_file(file("z.png")).unwrap();
        // What a failing disk leaves is noticed by whoever reads it, and cleared away then.
        let work = claimed(&store, "cells/b");
        make(&work, "score", "key");
        work.release().unwrap();
        let (rotten, store) = (store.path("cells/b/score/x.png"), Store::look(folder.path()));
        let discarded = |path: &Path| store.discard_damaged(path).unwrap();
        assert!(matches!(discarded(&rotten), Unusable::Whole) && store.damaged(&rotten).is_none());
        let written = rotten.metadata().unwrap().modified().unwrap();
        fs::write(&rotten, "7").unwrap();
        File::open(&rotten).unwrap().set_modified(written).unwrap();
        let states = [Scrutiny::Listing, Scrutiny::Content].map(|by| store.state("cells/b/score", "key", by).unwrap());
        assert_eq!(states, [ProductState::Whole, ProductState::Damaged]);
        assert!(matches!(discarded(&store.path("cells/b")), Unusable::Whole), "no product");
        assert!(matches!(discarded(&store.path("cells/b/.making-score-1/x")), Unusable::Whole), "no product yet");
        let place = store.path("cells/b/score");
        assert_eq!(store.damaged(&rotten), Some(place.clone()));
        let other = claimed(&Store::look(folder.path()), "cells/b");
        assert!(matches!(discarded(&rotten), Unusable::Held(_)) && rotten.exists(), "another one works on it");
        other.release().unwrap();
        assert!(matches!(discarded(&rotten), Unusable::Removed(removed) if removed == place));
        assert!(matches!(discarded(&rotten), Unusable::Removed(removed) if removed == place), "gone before");
        assert_eq!(store.state("cells/b/score", "key", Scrutiny::Listing).unwrap(), ProductState::Absent);
        assert_eq!(state("key"), ProductState::Whole);
        fs::write(file(MARKER), "{").unwrap();
        assert_eq!(state("key"), ProductState::Damaged, "nothing without a marker is taken for whole");
        fs::remove_dir_all(store.path("cells/a/score")).unwrap();
        assert_eq!(state("key"), ProductState::Absent);
    }

    #[test]
    fn what_an_ended_process_was_making_is_resumed_or_cleared_away() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::look(folder.path());
        let half = |name: &str| files::write_bytes(&store.path("sequences/a").join(name), b"half").unwrap();
        half(".making-film-0123/000000.png");
        half(".making-film-0123/.Ab12cd.tmp");
        half(".making-other-0123/x");
        half(".Ab12cd.tmp");
        half(".discarded-film-0123/x");
        let work = claimed(&store, "sequences/a");
        let making = work.resume("film").unwrap();
        assert_eq!(fs::read_dir(&making).unwrap().count(), 1, "what was whole is taken on");
        work.publish("film", "key").unwrap();
        work.release().unwrap();
        let left = claim::unfinished(&store.path("sequences/a")).unwrap();
        assert!(left.is_empty(), "{left:?}");
        assert_eq!(store.state("sequences/a/film", "key", Scrutiny::Content).unwrap(), ProductState::Whole);
    }

    /// As when the disk of a process stood still for long, and another one has done its work.
    #[test]
    fn who_comes_second_keeps_the_firsts_product_if_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::look(folder.path());
        let work = claimed(&store, "cells/a");
        make(&work, "score", "key");
        let first = fs::metadata(store.path("cells/a/score")).unwrap().modified().unwrap();
        make(&work, "score", "key");
        assert_eq!(fs::metadata(store.path("cells/a/score")).unwrap().modified().unwrap(), first);
        fs::remove_file(store.path("cells/a/score/x.png")).unwrap();
        make(&work, "score", "key");
        assert_eq!(store.state("cells/a/score", "key", Scrutiny::Listing).unwrap(), ProductState::Whole);
    }

    /// As when a process stood still for so long that another one took it for dead, then woke up and went on writing.
    #[test]
    fn what_was_taken_over_is_never_published() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::look(folder.path());
        let absent =
            || assert_eq!(store.state("cells/a/score", "key", Scrutiny::Listing).unwrap(), ProductState::Absent);
        // The other one has cleared away what was begun, and is still at work.
        let slept = claimed(&store, "cells/a");
        let making = slept.begin("score").unwrap();
        files::write_bytes(&making.join("first"), b"1").unwrap();
        fs::remove_dir_all(store.path("cells/a/.claim")).unwrap();
        let awake = claimed(&store, "cells/a");
        assert!(!making.exists() && !slept.is_held().unwrap() && awake.is_held().unwrap());
        files::write_bytes(&making.join("second"), b"2").unwrap();
        assert!(slept.publish("score", "key").is_err());
        absent();
        // It has finished and gone, and nobody holds the work.
        awake.release().unwrap();
        files::write_bytes(&making.join("second"), b"2").unwrap();
        assert!(slept.publish("score", "key").is_err());
        absent();
        let work = claimed(&store, "cells/a");
        make(&work, "score", "key");
        assert_eq!(store.state("cells/a/score", "key", Scrutiny::Listing).unwrap(), ProductState::Whole);
    }

    #[test]
    fn looking_touches_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let absent = folder.path().join("nowhere");
        assert_eq!(
            Store::look(&absent).state("cells/a/score", "key", Scrutiny::Listing).unwrap(),
            ProductState::Absent
        );
        assert!(!absent.exists());
    }
}
