//! The floors of the splat core (`src/splat/mod.rs`): a file imports from its own floor and from those before it.

use std::fs;
use std::path::Path;

/// From the ground up: folders of `src/splat`, or files.
const FLOORS: [&str; 7] = ["number", "types", "plain", "kernels", "pass", "anchors", "check"];

/// Lines of code, without tests, that import from a floor above number `own`, or from the roof (`crate::splat` itself).
fn violations(own: usize, text: &str) -> Vec<String> {
    let code = text.split("#[cfg(test)]").next().unwrap();
    let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
    let wrong = |line: &&str| {
        let imported = line.split("crate::splat::").skip(1).chain(line.split("super::").skip(1));
        let mut words = imported.map(|rest| rest.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap());
        let roof = line.contains("crate::splat::{");
        roof || words.any(|word| FLOORS.iter().position(|floor| *floor == word).is_some_and(|other| other > own))
    };
    lines.filter(wrong).map(str::to_owned).collect()
}

#[test]
fn each_floor_imports_from_those_below() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/splat");
    let mut wrong = Vec::new();
    for (own, floor) in FLOORS.iter().enumerate() {
        let mut files = vec![root.join(format!("{floor}.rs"))];
        if let Ok(folder) = fs::read_dir(root.join(floor)) {
            files = folder.map(|entry| entry.unwrap().path()).collect();
        }
        for file in files {
            let found = violations(own, &fs::read_to_string(&file).unwrap());
            wrong.extend(found.into_iter().map(|line| format!("{}: {line}", file.display())));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn an_import_from_above_is_noticed() {
    assert_eq!(violations(1, "use crate::splat::pass::Rasterizer;").len(), 1);
    assert_eq!(violations(3, "use super::check::tube;").len(), 1);
    assert_eq!(violations(2, "use crate::splat::{Gaussians, View};").len(), 1);
    assert!(violations(3, "use super::types::Wanted;\n#[cfg(test)]\nuse crate::splat::{View};").is_empty());
}
