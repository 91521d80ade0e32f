//! Lists the files that the program carries (`src/base/shipped.rs`): the TOML files of `bench-cases/`, and the surfaces
//! and centrelines that cases name.

use std::fs;
use std::path::{Path, PathBuf};

/// What is carried, by the ends of names.
const CARRIED: [&str; 3] = ["toml", "ply", "csv"];

/// Writes the table `shipped.rs` into OUT: the path of each file below `bench-cases/`, and its bytes. Without airways and
/// methods nothing asks for one: the table is empty then, and the Python package 6 MB smaller.
pub fn list(root: &Path, out: &Path) {
    if !cfg!(feature = "methods") {
        fs::write(out.join("shipped.rs"), "[]").expect("OUT_DIR is writable");
        return;
    }
    let folder = root.join("bench-cases");
    // Of a folder, cargo looks at every file in it.
    println!("cargo:rerun-if-changed=bench-cases");
    let mut files = Vec::new();
    collect(&folder, &mut files);
    files.sort();
    let entry = |path: &PathBuf| {
        let name = path.strip_prefix(&folder).expect("a listed file lies in the folder").to_str();
        let name = name.expect("the name is UTF-8");
        format!(
            "    ({name:?}, include_bytes!(concat!(env!(\"CARGO_MANIFEST_DIR\"), \"/bench-cases/{name}\")).as_slice()),\n"
        )
    };
    let table = format!("[\n{}]\n", files.iter().map(entry).collect::<String>());
    fs::write(out.join("shipped.rs"), table).expect("OUT_DIR is writable");
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("bench-cases is readable") {
        let path = entry.expect("bench-cases is readable").path();
        if path.is_dir() {
            collect(&path, files);
        } else if path.extension().is_some_and(|extension| CARRIED.iter().any(|carried| extension == *carried)) {
            files.push(path);
        }
    }
}
