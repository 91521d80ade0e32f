//! This program's own rows, in one table: from it follow their order, their names in tables, how their lines look, and
//! which names nobody else may have.
//!
//! It stands here because reports, the benchmark and the writer of predictions that needs no feature of the crate all
//! read it. What computes a row is said by its file in `bench-cases/methods/`.

use serde::Serialize;

/// Whether a row is ranked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Ranked.
    Ranked,
    /// A bound from above or below: shown, never ranked.
    Sanity,
}

/// How a line is broken in a plot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dash {
    /// It is not.
    Unbroken,
    /// Into long dashes.
    Long,
    /// Into short dashes.
    Short,
    /// Into dots.
    Dots,
}

/// A row of this program.
#[derive(Clone, Copy, Debug)]
pub struct OwnRow {
    /// Id in tables, folders and on the command line: the name of its file in `bench-cases/methods/`.
    pub id: &'static str,
    /// Name in tables.
    pub title: &'static str,
    /// Whether it is ranked.
    pub role: Role,
    /// How many CT scans it is given.
    pub ct_scans: u8,
    /// Whether it keeps an explicit mesh.
    pub keeps_mesh: bool,
    /// What it adds to the paper's equations, as tables say it below them; empty for rows that add nothing or are no
    /// variant of the paper's.
    pub additions: &'static str,
    /// Colour of its lines: red, green, blue, 8-bit sRGB (`src/report/palette.rs` says which colours will do).
    pub color: [u8; 3],
    /// How its lines are broken: those of bounds, and of rows that never look at a picture.
    pub dash: Dash,
}

/// A ranked row with a mesh of two scans and an unbroken line: what most are.
const fn ranked(id: &'static str, title: &'static str, color: [u8; 3]) -> OwnRow {
    OwnRow { id, title, role: Role::Ranked, ct_scans: 2, keeps_mesh: true, additions: "", color, dash: Dash::Unbroken }
}

/// A bound: as [`ranked`], with long dashes.
const fn bound(id: &'static str, title: &'static str, color: [u8; 3]) -> OwnRow {
    OwnRow { role: Role::Sanity, dash: Dash::Long, ..ranked(id, title, color) }
}

/// The table of additions in `docs/ours.md`, in a few words.
const WINDOW_ADDITIONS: &str = "keyframes, light of the scope with its exposure, memory of colours, finer and larger discs, \
     bounds on colours, colours of unseen walls, hidden faces left out, depth of the mesh, candidates and continued motion, a \
     phase mostly by SSIM, an early end of stages, a larger epsilon of Adam";

/// This program's own rows, in the order of tables: those of the paper's Table 1 from top to bottom, ours beyond it,
/// what needs no map, the bounds, and last the row that stands in for `ours-gn` where poses are rough. A test holds that
/// these are the files of `bench-cases/methods/`.
pub const OWN: [OwnRow; 16] = [
    OwnRow { ct_scans: 1, ..ranked("bridgesplat", "BridgeSplat", [213, 94, 0]) },
    OwnRow { ct_scans: 1, ..ranked("bridgesplat-release", "BridgeSplat (released objective)", [156, 48, 96]) },
    OwnRow { ct_scans: 1, ..ranked("bridgesplat-tuned", "BridgeSplat (tuned)", [120, 24, 144]) },
    OwnRow { ct_scans: 1, keeps_mesh: false, ..ranked("bridgesplat-nomesh", "BridgeSplat (no mesh)", [230, 159, 0]) },
    OwnRow { keeps_mesh: false, ..ranked("ours-nomesh", "Ours (no mesh)", [86, 180, 233]) },
    ranked("ours", "Ours", [0, 114, 178]),
    OwnRow { additions: WINDOW_ADDITIONS, ..ranked("ours-window", "Ours + keyframes", [96, 24, 252]) },
    ranked("ours-gn", "Ours (Gauss-Newton)", [204, 121, 167]),
    ranked("ours-nav", "Ours, navigation", [144, 72, 228]),
    ranked("virtual-bronchoscopy", "Virtual bronchoscopy", [12, 192, 72]),
    OwnRow { dash: Dash::Short, ..ranked("pose-only", "No picture: pose", [132, 84, 0]) },
    OwnRow { dash: Dash::Short, ..ranked("mean-breath", "No picture: clock", [132, 192, 144]) },
    OwnRow { ct_scans: 1, ..bound("static-ct", "Static CT", [130, 130, 130]) },
    OwnRow { ct_scans: 1, dash: Dash::Dots, ..bound("static-expiration", "Static CT, expiration", [96, 84, 132]) },
    bound("oracle-phase", "Oracle phase", [30, 160, 90]),
    OwnRow { dash: Dash::Long, ..ranked("ours-gn-pose", "Ours (Gauss-Newton), rough poses", [216, 0, 252]) },
];

/// One of this program's own rows.
pub fn own(id: &str) -> Option<&'static OwnRow> {
    OWN.iter().find(|row| row.id == id)
}

/// The place of a method in tables, 0 the first; what is no own row comes after all of them.
pub fn place(id: &str) -> usize {
    OWN.iter().position(|row| row.id == id).unwrap_or(OWN.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_own_rows_are_the_shipped_methods() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-cases/methods");
        let mut shipped: Vec<String> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path().file_stem().unwrap().to_string_lossy().into_owned())
            .collect();
        let mut own: Vec<&str> = OWN.iter().map(|row| row.id).collect();
        shipped.sort();
        own.sort_unstable();
        assert_eq!(own, shipped);
    }

    #[test]
    fn every_own_row_has_a_place_before_all_others() {
        assert!(OWN.iter().enumerate().all(|(index, row)| place(row.id) == index));
        assert_eq!(place("opensplat"), OWN.len());
    }
}
