//! The arrows between the rooms of the house (`src/lib.rs`): inside one crate the compiler cannot forbid them.

use std::fs;
use std::path::{Path, PathBuf};

/// From the bottom up: a room may use the rooms before it in this list, and itself.
const ROOMS: [&str; 12] = [
    "base",
    "ffi",
    "formats",
    "airway",
    "render",
    "simulate",
    "splat",
    "reconstruct",
    "score",
    "report",
    "bench",
    "cli",
];

/// Arrows upwards in the list that the house forbids all the same: (room, must not use, why).
const FORBIDDEN: [(&str, &str, &str); 7] = [
    ("render", "airway", "the path tracer knows nothing of breathing"),
    ("splat", "airway", "the rasteriser knows nothing of anatomy"),
    ("splat", "render", "the rasteriser knows nothing of the path tracer"),
    ("splat", "simulate", "the rasteriser knows nothing of sequences"),
    ("score", "reconstruct", "scoring reads folders and does not know how predictions were made"),
    ("report", "reconstruct", "reports do not know how predictions were made"),
    ("formats", "ffi", "file formats need no C"),
];

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<_> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|e| ["rs", "h", "cpp"].iter().any(|known| e == *known)) {
            found.push(path);
        }
    }
}

/// Rooms named as `crate::room` anywhere in a line of code.
fn rooms_used(line: &str) -> Vec<&'static str> {
    let code = line.split("//").next().unwrap_or("");
    let mut used = Vec::new();
    for part in code.split("crate::").skip(1) {
        let names: Vec<&str> = match part.strip_prefix('{') {
            Some(group) => group.split([',', '}']).map(str::trim).collect(),
            None => vec![part],
        };
        for name in names {
            let word: String = name.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
            used.extend(ROOMS.iter().filter(|r| **r == word));
        }
    }
    used
}

fn violations(room: &str, text: &str) -> Vec<String> {
    let own = ROOMS.iter().position(|r| *r == room).unwrap();
    let mut found = Vec::new();
    for (number, line) in text.lines().enumerate() {
        for used in rooms_used(line) {
            let other = ROOMS.iter().position(|r| *r == used).unwrap();
            let forbidden = FORBIDDEN.iter().find(|(from, to, _)| *from == room && *to == used);
            if other > own || forbidden.is_some() {
                let why = forbidden.map_or("it stands higher in the house", |f| f.2);
                found.push(format!("line {}: {room} uses {used}: {why}", number + 1));
            }
        }
    }
    found
}

#[test]
fn arrows_point_the_allowed_way() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut wrong = Vec::new();
    for room in ROOMS {
        let mut files = Vec::new();
        sources(&src.join(room), &mut files);
        assert!(!files.is_empty(), "room {room} is missing");
        for file in files {
            let text = fs::read_to_string(&file).unwrap();
            wrong.extend(violations(room, &text).into_iter().map(|v| format!("{}: {v}", file.display())));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_check_can_fail() {
    assert_eq!(violations("base", "use crate::splat::Gaussians;").len(), 1);
    assert_eq!(violations("score", "    let x = crate::reconstruct::method();").len(), 1);
    assert_eq!(violations("simulate", "use crate::{base::Image, splat};").len(), 1);
    assert!(violations("cli", "use crate::bench::Plan; // crate::nothing").is_empty());
}

#[test]
fn unsafe_lives_in_one_room() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&src, &mut files);
    for file in files {
        let inside = file.strip_prefix(&src).unwrap().starts_with("ffi");
        let text = fs::read_to_string(&file).unwrap();
        for (number, line) in text.lines().enumerate() {
            let code = line.split("//").next().unwrap_or("");
            let says = code.split(|c: char| !c.is_alphanumeric() && c != '_').any(|w| w == "unsafe");
            assert!(inside || !says, "{}:{}: unsafe outside src/ffi", file.display(), number + 1);
        }
    }
}

/// Films are kept when the splat core changes (`build/revision.rs`): nothing that films may include its C++, or use its
/// bridges.
#[test]
fn what_films_knows_nothing_of_the_splat_core() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    for folder in ["cpp/common", "cpp/trace", "src/ffi"] {
        sources(&root.join(folder), &mut files);
    }
    files.retain(|file| !file.starts_with(root.join("src/ffi/splat")));
    for room in ["render", "airway", "simulate", "formats", "base"] {
        sources(&root.join("src").join(room), &mut files);
    }
    let mut bad = Vec::new();
    for path in &files {
        let text = fs::read_to_string(path).unwrap();
        let code = text.lines().map(|line| line.split("//").next().unwrap());
        let uses = code.filter(|line| line.contains("cpp/splat/") || line.contains("splat::"));
        bad.extend(uses.map(|line| format!("{}: {line}", path.display())));
    }
    assert!(bad.is_empty(), "{}", bad.join("\n"));
    assert!(files.iter().any(|file| file.ends_with("tracer.cpp")), "the C++ was not looked at");
}
