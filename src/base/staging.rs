//! Several files that belong together: put together in a folder of their own, moved to where they belong once all are
//! there and right.

use std::fs;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use super::error::{Error, Result};

/// A folder on its way to another one. Dropped before [`Staging::publish`], it leaves nothing behind.
#[derive(Debug)]
pub struct Staging {
    folder: TempDir,
    target: PathBuf,
}

impl Staging {
    /// A new folder on the disk of `target`, which need not exist and is not touched.
    pub fn new(target: &Path) -> Result<Staging> {
        let fail = |e| Error::io("writing", target, e);
        let absolute = std::path::absolute(target).map_err(fail)?;
        let near = absolute.ancestors().find(|folder| folder.is_dir()).unwrap_or(Path::new("/"));
        let folder = tempfile::Builder::new().prefix(".unfinished-").tempdir_in(near).map_err(fail)?;
        Ok(Staging { folder, target: target.to_path_buf() })
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
        fs::File::open(&self.target).and_then(|folder| folder.sync_all()).map_err(fail)
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
}
