//! Hashes the sources of every room, so that cached results record which code made them (`src/bench/revision.rs`).

use std::fs;
use std::path::{Path, PathBuf};

/// The rooms with a revision of their own; report, bench and cli make nothing that is kept and taken again.
const ROOMS: [&str; 10] =
    ["base", "formats", "airway", "ct", "render", "simulate", "splat", "reconstruct", "score", "experiments"];

/// The splat core's own C++ and its bridges: no film depends on them, and nothing else there includes them
/// (`tests/all/layering/`).
const KERNELS: [&str; 2] = ["cpp/splat", "src/ffi/splat"];

/// The path tracer's C++, what both share, and their bridges.
const TRACER: [&str; 8] = [
    "cpp/common",
    "cpp/trace",
    "src/ffi/isa.rs",
    "src/ffi/mod.rs",
    "src/ffi/system.rs",
    "src/ffi/trace",
    "src/ffi/versions.rs",
    "src/ffi/vision.rs",
];

/// The build itself: its script, features and profiles, the locked dependencies.
const BUILD: [&str; 4] = ["build.rs", "build", "Cargo.toml", "Cargo.lock"];

/// What changes the machine code of the same sources.
const FLAGS: [&str; 4] = ["CXX", "CXXFLAGS", "CFLAGS", "CARGO_ENCODED_RUSTFLAGS"];

/// Sets `RESPIRE_BENCH_REVISION_<ROOM>` for the compiler; OUTSIDE is the build, the compilers and their flags, and what the
/// headers of the libraries of the system say of their versions.
pub fn tell(root: &Path, compilers: &[String], headers: &[PathBuf]) {
    for room in ROOMS {
        set(room, &of(&[root.join("src").join(room)]));
    }
    let mut outside = BUILD.map(|path| root.join(path)).to_vec();
    outside.extend(headers.iter().filter(|header| header.exists()).cloned());
    let mut hash = Fnv::new();
    hash.add(of(&outside).as_bytes());
    compilers.iter().for_each(|words| hash.add(words.as_bytes()));
    for flag in FLAGS {
        hash.add(std::env::var_os(flag).unwrap_or_default().as_encoded_bytes());
        println!("cargo:rerun-if-env-changed={flag}");
    }
    set("outside", &hash.digits());
    set("kernels", &of(&KERNELS.map(|path| root.join(path))));
    set("tracer", &of(&TRACER.map(|path| root.join(path))));
    for path in ["src", "Cargo.toml", "Cargo.lock"] {
        println!("cargo:rerun-if-changed={path}");
    }
}

fn set(room: &str, digits: &str) {
    println!("cargo:rustc-env=RESPIRE_BENCH_REVISION_{}={digits}", room.to_uppercase());
}

/// 16 hex digits for the code in files and folders.
pub fn of(paths: &[PathBuf]) -> String {
    let mut files = Vec::new();
    paths.iter().for_each(|path| list(path, &mut files));
    files.sort();
    let mut hash = Fnv::new();
    for file in &files {
        hash.add(file.file_name().expect("a listed file has a name").as_encoded_bytes());
        let text = fs::read_to_string(file).expect("sources are readable UTF-8");
        code_lines(&text).for_each(|line| hash.add(line.as_bytes()));
    }
    hash.digits()
}

fn list(path: &Path, files: &mut Vec<PathBuf>) {
    if path.is_dir() {
        for entry in fs::read_dir(path).expect("the room is readable") {
            list(&entry.expect("the room is readable").path(), files);
        }
    } else if !path.to_string_lossy().ends_with("tests.rs") {
        files.push(path.to_path_buf());
    }
}

/// Lines that can change what the program does: no comments, no blank lines, no tests at the end of a file.
fn code_lines(text: &str) -> impl Iterator<Item = &str> {
    let end = text.find("\n#[cfg(test)]\nmod tests {").unwrap_or(text.len());
    text[..end].lines().filter(|line| !line.trim().is_empty() && !line.trim_start().starts_with("//"))
}

/// Fowler-Noll-Vo 1a, 64 bit: enough to tell versions apart, and no build dependency.
struct Fnv(u64);

impl Fnv {
    fn new() -> Self {
        Fnv(0xcbf2_9ce4_8422_2325)
    }

    fn digits(&self) -> String {
        format!("{:016x}", self.0)
    }

    fn add(&mut self, bytes: &[u8]) {
        // The separator keeps "ab" + "c" from being "a" + "bc".
        for &byte in bytes.iter().chain(&[0xff]) {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
}
