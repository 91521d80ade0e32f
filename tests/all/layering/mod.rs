//! The arrows of the house (`src/lib.rs`): between rooms, between the folders of a room, between files. Inside one
//! crate the compiler cannot forbid them.

mod graph;
mod source;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use graph::{circles, entry};
use source::{Import, Sources};

/// From the bottom up: a room may use the rooms before it in this list, and itself.
const ROOMS: [&str; 14] = [
    "base",
    "ffi",
    "formats",
    "airway",
    "ct",
    "render",
    "simulate",
    "splat",
    "reconstruct",
    "score",
    "report",
    "bench",
    "experiments",
    "cli",
];

/// Imports down the list that the house forbids all the same: (room, must not use, why).
const FORBIDDEN: [(&str, &str, &str); 9] = [
    ("render", "airway", "the path tracer knows nothing of breathing"),
    ("splat", "airway", "the rasteriser knows nothing of anatomy"),
    ("splat", "render", "the rasteriser knows nothing of the path tracer"),
    ("splat", "simulate", "the rasteriser knows nothing of sequences"),
    ("score", "reconstruct", "scoring reads folders and does not know how predictions were made"),
    ("report", "reconstruct", "reports do not know how predictions were made"),
    ("formats", "ffi", "file formats need no C"),
    ("cli", "ffi", "the command line computes nothing"),
    ("cli", "reconstruct", "the command line computes nothing"),
];

/// Rooms whose entries have a fixed order, from the bottom up: an entry may use those before it.
const FLOORS: [(&str, &[&str]); 2] = [
    ("splat", &["number", "types", "plain", "kernels", "pass", "anchors", "check", "mod"]),
    (
        "reconstruct",
        &[
            "activation",
            "settings",
            "stopwatch",
            "contract",
            "rough_poses",
            "observe",
            "online",
            "prediction_folder",
            "prediction",
            "geometry",
            "fitting",
            "estimate",
            "methods",
            "library",
            "mod",
        ],
    ),
];

/// Most arguments of a function across the language border.
const MOST_ARGUMENTS: usize = 6;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn position(room: &str) -> Option<usize> {
    ROOMS.iter().position(|r| *r == room)
}

/// Imports from a room that stands higher, or that the house forbids.
fn wrong_rooms(imports: &[Import<'_>]) -> Vec<String> {
    let mut wrong = Vec::new();
    for Import { from, path, .. } in imports {
        // A room may hand on what it has from below: what counts is the room that is named.
        let named = path.split("::").next().unwrap_or_default();
        let forbidden = FORBIDDEN.iter().find(|(room, other, _)| *room == from.room() && *other == named);
        if position(named) > position(from.room()) || forbidden.is_some() {
            let why = forbidden.map_or("it stands higher in the house", |f| f.2);
            wrong.push(format!("{} imports {path}: {why}", from.path()));
        }
    }
    wrong
}

/// Imports from an entry that stands higher in the order of its room.
fn wrong_floors(imports: &[Import<'_>], floors: &[(&str, &[&str])]) -> Vec<String> {
    let mut wrong = Vec::new();
    for &(room, order) in floors {
        let floor = |file| {
            let name = entry(file, 1);
            order.iter().position(|e| *e == name).unwrap_or_else(|| panic!("{room}/{name} has no place in FLOORS"))
        };
        let inside = |i: &&Import<'_>| i.from.room() == room && i.to.room() == room && !i.re_export;
        let upwards = imports.iter().filter(inside).filter(|i| floor(i.to) > floor(i.from));
        wrong.extend(upwards.map(|i| format!("{} imports {} from a higher floor", i.from.path(), i.path)));
    }
    wrong
}

/// Type names that several files define.
fn repeated_types(sources: &Sources) -> Vec<String> {
    let mut places: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for file in &sources.files {
        for name in &file.types {
            places.entry(name).or_default().push(file.path());
        }
    }
    places.retain(|_, files| files.len() > 1);
    places.into_iter().map(|(name, files)| format!("{name}: {}", files.join(", "))).collect()
}

#[test]
fn rooms_import_only_from_rooms_below() {
    let sources = Sources::read(&root().join("src"));
    for room in ROOMS {
        assert!(sources.files.iter().any(|file| file.room() == room), "room {room} is missing");
    }
    let unknown: Vec<String> =
        sources.files.iter().filter(|f| position(f.room()).is_none()).map(|f| f.path()).collect();
    assert!(unknown.is_empty(), "no room of the list: {unknown:?}");
    let wrong = wrong_rooms(&sources.imports());
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn files_and_folders_of_a_room_form_no_circle() {
    let sources = Sources::read(&root().join("src"));
    let found = circles(&sources.imports());
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// Estimators are combined by methods and do not know each other.
#[test]
fn estimators_do_not_know_each_other() {
    let sources = Sources::read(&root().join("src"));
    let imports = sources.imports();
    let estimator = |i: &Import<'_>, file: fn(&Import<'_>) -> Vec<String>| file(i).get(..3).map(<[String]>::to_vec);
    let in_folder = |path: &Option<Vec<String>>| path.as_ref().is_some_and(|p| p[..2] == ["reconstruct", "estimate"]);
    let mut wrong = Vec::new();
    for import in &imports {
        let (from, to) = (estimator(import, |i| i.from.module.clone()), estimator(import, |i| i.to.module.clone()));
        if in_folder(&from) && in_folder(&to) && from != to {
            wrong.push(format!("{} imports {}", import.from.path(), import.path));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn floors_of_a_room_import_only_from_floors_below() {
    let sources = Sources::read(&root().join("src"));
    let wrong = wrong_floors(&sources.imports(), &FLOORS);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_type_name_stands_once_in_the_crate() {
    let repeated = repeated_types(&Sources::read(&root().join("src")));
    assert!(repeated.is_empty(), "{}", repeated.join("\n"));
}

#[test]
fn functions_across_the_language_border_have_few_arguments() {
    let sources = Sources::read(&root().join("src"));
    let functions = || sources.files.iter().flat_map(|f| f.border_functions.iter().map(move |b| (f.path(), b)));
    assert!(functions().count() > 10, "no bridge was looked at");
    let long: Vec<_> = functions().filter(|(_, (_, arguments))| *arguments > MOST_ARGUMENTS).collect();
    assert!(long.is_empty(), "{long:?}");
}

#[test]
fn the_checks_can_fail() {
    let wrong = |texts: &[(&str, &str)]| wrong_rooms(&Sources::new(texts.iter().copied()).imports()).len();
    assert_eq!(wrong(&[("base/a", "use crate::splat::b::X;"), ("splat/b", "pub struct X;")]), 1);
    assert_eq!(wrong(&[("score/a", "fn f() { crate::reconstruct::b::g(); }"), ("reconstruct/b", "")]), 1);
    assert_eq!(wrong(&[("score/a", "fn f() { assert!(crate::reconstruct::b::g()); }"), ("reconstruct/b", "")]), 1);
    assert_eq!(wrong(&[("simulate/a", "use crate::{base::b, splat::c::d};"), ("base/b", ""), ("splat/c", "")]), 1);
    assert_eq!(wrong(&[("cli/a", "use crate::bench::b; // crate::nothing"), ("bench/b", "")]), 0);
    assert_eq!(wrong(&[("base/a", "#[cfg(test)]\nmod tests { use crate::splat::b; }"), ("splat/b", "")]), 0);

    let round = |texts: &[(&str, &str)]| circles(&Sources::new(texts.iter().copied()).imports());
    let two = [("splat/a", "use super::b::B; pub struct A;"), ("splat/b", "use super::a::A; pub struct B;")];
    assert_eq!(round(&two).len(), 1);
    // Through a facade, through a child, through another folder.
    let facade = [
        ("splat/mod", "mod a; mod b; pub use a::A; pub use b::B;"),
        ("splat/a", "use super::B; pub struct A;"),
        ("splat/b", "use crate::splat::A; pub struct B;"),
    ];
    assert_eq!(round(&facade).len(), 1);
    let child = [("splat/a/mod", "mod b; use b::B; pub struct A;"), ("splat/a/b", "use super::A; pub struct B;")];
    assert_eq!(round(&child).len(), 1);
    let folders = [
        ("splat/x/a", "use crate::splat::y::c::C; pub struct A;"),
        ("splat/x/b", "pub struct B;"),
        ("splat/y/c", "pub struct C;"),
        ("splat/y/d", "use crate::splat::x::b::B;"),
    ];
    assert_eq!(round(&folders).len(), 1);
    assert!(round(&folders[..3]).is_empty());
    // A facade that only hands on is no circle.
    assert!(round(&[facade[0], facade[1], ("splat/b", "pub struct B;")]).is_empty());

    let sources = Sources::new(folders);
    assert_eq!(wrong_floors(&sources.imports(), &[("splat", &["x", "y"])]).len(), 1);
    assert_eq!(repeated_types(&Sources::new([two[0], ("base/c", "enum A {}")])).len(), 1);
    let bridge = Sources::new([("ffi/a", "mod bridge { unsafe extern \"C++\" { fn f(a: u8, b: u8); } }")]);
    assert_eq!(bridge.files[0].border_functions, [("f".to_owned(), 2)]);
}

fn files_below(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<_> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            files_below(&path, found);
        } else if path.extension().is_some_and(|e| ["rs", "h", "cpp"].iter().any(|known| e == *known)) {
            found.push(path);
        }
    }
}

#[test]
fn unsafe_lives_in_one_room() {
    let src = root().join("src");
    let mut files = Vec::new();
    files_below(&src, &mut files);
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

/// Files that sources and documents name, from the root of the project.
#[test]
fn files_that_are_named_exist() {
    let mut files = Vec::new();
    for folder in ["src", "cpp", "tests", "benches", "examples", "build"] {
        files_below(&root().join(folder), &mut files);
    }
    for folder in ["", "docs", "docs/decisions", "scripts"] {
        let entries = fs::read_dir(root().join(folder)).unwrap().map(|e| e.unwrap().path());
        files.extend(entries.filter(|path| path.extension().is_some_and(|e| e == "md" || e == "sh")));
    }
    let ends = [".rs", ".cpp", ".h", ".sh", ".md"];
    let starts = ["src/", "cpp/", "tests/", "benches/", "examples/", "scripts/", "docs/", "build/"];
    let (mut missing, mut named) = (Vec::new(), 0);
    for file in files {
        let text = fs::read_to_string(&file).unwrap();
        for word in text.split(|c: char| !(c.is_alphanumeric() || "_-./".contains(c))) {
            let word = word.trim_end_matches('.');
            let is_path = starts.iter().any(|s| word.starts_with(s)) && ends.iter().any(|e| word.ends_with(e));
            // A header that cxx makes, and the pattern of a name.
            if !is_path || word.ends_with(".rs.h") || word.contains("YYYY") {
                continue;
            }
            named += 1;
            if !root().join(word).exists() {
                missing.push(format!("{}: {word}", file.display()));
            }
        }
    }
    assert!(missing.is_empty(), "{}", missing.join("\n"));
    assert!(named > 100, "{named} names were looked at");
}

/// Films are kept when the splat core changes (`build/revision.rs`): nothing that films may include its C++, or use its
/// bridges.
#[test]
fn what_films_knows_nothing_of_the_splat_core() {
    let mut files = Vec::new();
    for folder in ["cpp/common", "cpp/trace", "src/ffi"] {
        files_below(&root().join(folder), &mut files);
    }
    files.retain(|file| !file.starts_with(root().join("src/ffi/splat")));
    for room in ["render", "airway", "simulate", "formats", "base"] {
        files_below(&root().join("src").join(room), &mut files);
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
