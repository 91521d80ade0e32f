//! Several files that belong together: put together in a folder of their own, moved to where they belong once all are
//! there and right.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use super::error::{Error, Result};

/// How the name of a folder begins that is not finished.
const UNFINISHED: &str = ".unfinished-";

/// A folder on its way to another one. Dropped before [`Staging::publish`], it leaves nothing behind; what a kill left
/// behind is removed by the next one to the same place.
#[derive(Debug)]
pub struct Staging {
    folder: TempDir,
    target: PathBuf,
    /// Locked as long as this process lives: how others know that the folder is in use. `None` where the file system
    /// knows no locks.
    _lock: Option<File>,
}

impl Staging {
    /// A new folder on the disk of `target`, which need not exist and is not touched.
    pub fn new(target: &Path) -> Result<Staging> {
        let fail = |e| Error::io("writing", target, e);
        let absolute = std::path::absolute(target).map_err(fail)?;
        let near = absolute.ancestors().find(|folder| folder.is_dir()).unwrap_or(Path::new("/"));
        // The target may have appeared since the kill.
        for place in [Some(near), absolute.parent()].into_iter().flatten() {
            remove_unfinished(place);
        }
        loop {
            let folder = tempfile::Builder::new().prefix(UNFINISHED).tempdir_in(near).map_err(fail)?;
            let lock = File::open(folder.path()).ok().filter(|opened| opened.try_lock().is_ok());
            // Another process may have taken it for a dead one's before it was locked.
            if folder.path().is_dir() {
                return Ok(Staging { folder, target: target.to_path_buf(), _lock: lock });
            }
        }
    }

    /// Where a file of that name is put together.
    pub fn path(&self, name: impl AsRef<Path>) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Moves the files `names` into the target, in this order; those of the same name there are replaced.
    pub fn publish(self, names: &[PathBuf]) -> Result<()> {
        let fail = |e| Error::io("writing", &self.target, e);
        fs::create_dir_all(&self.target).map_err(fail)?;
        for name in names {
            let to = self.target.join(name);
            fs::rename(self.folder.path().join(name), &to).map_err(|e| Error::io("writing", &to, e))?;
        }
        File::open(&self.target).and_then(|folder| folder.sync_all()).map_err(fail)
    }
}

/// Removes from `place` the unfinished folders whose process has ended. What cannot be removed is no reason to stop.
fn remove_unfinished(place: &Path) {
    let Ok(entries) = fs::read_dir(place) else { return };
    for entry in entries.flatten().filter(|e| e.file_name().to_string_lossy().starts_with(UNFINISHED)) {
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        let Some(opened) = File::open(entry.path()).ok().filter(|_| is_folder) else { continue };
        if opened.try_lock().is_ok() {
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::files;
    use super::*;

    #[test]
    fn files_appear_together_or_not_at_all() {
        let place = tempfile::tempdir().unwrap();
        let count = || fs::read_dir(place.path()).unwrap().count();
        let target = place.path().join("a/b");
        for is_right in [false, true] {
            let staging = Staging::new(&target).unwrap();
            files::write_bytes(&staging.path("x.txt"), b"x").unwrap();
            assert!(!place.path().join("a").exists());
            if is_right {
                staging.publish(&["x.txt".into()]).unwrap();
                assert_eq!(fs::read(target.join("x.txt")).unwrap(), b"x");
            } else {
                drop(staging);
            }
            assert_eq!(count(), usize::from(is_right));
        }
    }

    #[test]
    fn what_a_kill_left_behind_is_removed_and_what_is_in_use_is_not() {
        let place = tempfile::tempdir().unwrap();
        let left = place.path().join(".unfinished-Ab12Cd");
        fs::create_dir_all(left.join("work")).unwrap();
        fs::write(left.join("work/x.txt"), b"x").unwrap();
        let in_use = Staging::new(&place.path().join("a")).unwrap();
        assert!(!left.exists());
        let other = Staging::new(&place.path().join("b")).unwrap();
        assert!(in_use.path("").is_dir() && other.path("").is_dir());
    }
}
