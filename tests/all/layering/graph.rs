//! Circles in the graph of imports between the entries of each folder.

use std::collections::{BTreeMap, BTreeSet};

use super::source::{Import, SourceFile};

/// Circles between the entries (files and folders) of every folder: the folder, and an import for each step.
pub fn circles(imports: &[Import<'_>]) -> Vec<String> {
    let mut by_folder: BTreeMap<&[String], BTreeMap<(&str, &str), &Import<'_>>> = BTreeMap::new();
    for import in imports.iter().filter(|import| !import.re_export) {
        let common = import.from.module.iter().zip(&import.to.module).take_while(|(a, b)| a == b).count();
        // Between rooms there is a rule of its own.
        if common > 0 {
            let step = (entry(import.from, common), entry(import.to, common));
            by_folder.entry(&import.from.module[..common]).or_default().entry(step).or_insert(import);
        }
    }
    let mut found = Vec::new();
    for (folder, steps) in by_folder {
        for circle in components(&steps.keys().copied().collect()) {
            let within = steps.iter().filter(|((a, b), _)| circle.contains(a) && circle.contains(b));
            let steps: Vec<String> = within.map(|(_, i)| format!("  {} imports {}", i.from.path(), i.path)).collect();
            let members: Vec<&str> = circle.into_iter().collect();
            found.push(format!("{}: {} are a circle:\n{}", folder.join("/"), members.join(", "), steps.join("\n")));
        }
    }
    found
}

/// The entry of a folder `depth` levels below `src` that `file` belongs to.
pub fn entry(file: &SourceFile, depth: usize) -> &str {
    file.module.get(depth).map_or("mod", String::as_str)
}

/// Sets of more than one node that all reach each other. Folders have few entries: reachability, node by node.
fn components<'a>(edges: &BTreeSet<(&'a str, &'a str)>) -> Vec<BTreeSet<&'a str>> {
    let reach = |start: &'a str| {
        let (mut reached, mut next) = (BTreeSet::new(), vec![start]);
        while let Some(node) = next.pop() {
            let further = edges.iter().filter(|(from, _)| *from == node).map(|(_, to)| *to);
            next.extend(further.filter(|to| reached.insert(*to)).collect::<Vec<_>>());
        }
        reached
    };
    let nodes: BTreeSet<&str> = edges.iter().flat_map(|(a, b)| [*a, *b]).collect();
    let reached: BTreeMap<&str, BTreeSet<&str>> = nodes.iter().map(|node| (*node, reach(node))).collect();
    let mut found: Vec<BTreeSet<&str>> = Vec::new();
    for node in nodes {
        let own: BTreeSet<&str> = reached[node].iter().copied().filter(|other| reached[other].contains(node)).collect();
        if own.len() > 1 && !found.contains(&own) {
            found.push(own);
        }
    }
    found
}
