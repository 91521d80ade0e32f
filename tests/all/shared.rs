//! Folders that several tests look at and none changes: the first test that asks makes one, the others wait for it.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock};

/// Beside what Cargo builds, since nothing that a test shares can be dropped at its end.
fn place() -> &'static Path {
    static PLACE: OnceLock<PathBuf> = OnceLock::new();
    PLACE.get_or_init(|| {
        let all = Path::new(env!("CARGO_TARGET_TMPDIR")).join("shared");
        let own = std::process::id().to_string();
        fs::create_dir_all(&all).unwrap();
        for old in fs::read_dir(&all).unwrap().map(|entry| entry.unwrap()) {
            // of a process that has ended, under this one's number too; another may delete it at the same moment
            if old.file_name() == own.as_str() || !Path::new("/proc").join(old.file_name()).exists() {
                let _ = fs::remove_dir_all(old.path());
            }
        }
        all.join(own)
    })
}

/// The folder `name`, which `make` fills if no test has yet.
pub fn folder(name: &str, make: impl FnOnce(&Path)) -> PathBuf {
    static MADE: Mutex<BTreeMap<String, Arc<OnceLock<PathBuf>>>> = Mutex::new(BTreeMap::new());
    let one = MADE.lock().unwrap().entry(name.to_owned()).or_default().clone();
    one.get_or_init(|| {
        let folder = place().join(name);
        fs::create_dir_all(&folder).unwrap();
        make(&folder);
        folder
    })
    .clone()
}
