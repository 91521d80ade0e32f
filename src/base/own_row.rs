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

/// Which pictures of a film a row looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum PicturesSeen {
    /// None.
    None,
    /// Those of the first seconds.
    FirstSeconds,
    /// All.
    All,
}

/// What a row is given, as far as rows differ in it. A row is beaten only by one that sees no more than it does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sees {
    /// How many CT scans.
    pub ct_scans: u8,
    /// Which pictures.
    pub pictures: PicturesSeen,
    /// Poses as exact as the film's track tells them, and not rougher ones.
    pub told_poses: bool,
}

impl Sees {
    /// All that a film gives: what a row is taken to see of which nothing is known.
    pub const EVERYTHING: Sees = Sees { ct_scans: 2, pictures: PicturesSeen::All, told_poses: true };

    /// Whether `other` sees all of it.
    pub fn is_within(self, other: Sees) -> bool {
        self.ct_scans <= other.ct_scans && self.pictures <= other.pictures && self.told_poses <= other.told_poses
    }
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
    /// What it is given.
    pub sees: Sees,
    /// Whether it keeps an explicit mesh.
    pub keeps_mesh: bool,
    /// Whether its answers depend on the seed; a test holds it to the shipped settings.
    pub draws: bool,
    /// What it adds to the paper's equations, as tables say it below them; empty for rows that add nothing or are no
    /// variant of the paper's.
    pub additions: &'static str,
    /// Colour of its lines: red, green, blue, 8-bit sRGB (`src/report/palette.rs` says which colours will do).
    pub color: [u8; 3],
    /// How its lines are broken: those of bounds, of rows that never look at a picture, and of rows that somebody with
    /// deuteranopia would hardly tell from another by the colour.
    pub dash: Dash,
}

/// A ranked row with a mesh of two scans and an unbroken line: what most are.
const fn ranked(id: &'static str, title: &'static str, color: [u8; 3]) -> OwnRow {
    let sees = Sees::EVERYTHING;
    let (role, dash) = (Role::Ranked, Dash::Unbroken);
    OwnRow { id, title, role, sees, keeps_mesh: true, draws: false, additions: "", color, dash }
}

/// A bound: as [`ranked`], with long dashes.
const fn bound(id: &'static str, title: &'static str, color: [u8; 3]) -> OwnRow {
    OwnRow { role: Role::Sanity, dash: Dash::Long, ..ranked(id, title, color) }
}

/// BridgeSplat's rows see one CT, and their Gaussians begin at random.
const fn bridgesplat(id: &'static str, title: &'static str, color: [u8; 3]) -> OwnRow {
    OwnRow { sees: ONE_CT, draws: true, ..ranked(id, title, color) }
}

/// One CT and all pictures.
const ONE_CT: Sees = Sees { ct_scans: 1, ..Sees::EVERYTHING };
/// Two CTs and no picture.
const NO_PICTURE: Sees = Sees { pictures: PicturesSeen::None, ..Sees::EVERYTHING };

/// The table of additions in `docs/ours.md`, in a few words.
const WINDOW_ADDITIONS: &str = "keyframes, light of the scope with its exposure, memory of colours, finer and larger discs, \
     bounds on colours, colours of unseen walls, hidden faces left out, depth of the mesh, candidates and continued motion, a \
     phase mostly by SSIM, an early end of stages";

/// This program's own rows, in the order of tables: those of the paper's Table 1 from top to bottom, ours beyond it,
/// what needs no map, the bounds, and last the row that stands in for `ours-gn` where poses are rough. A test holds that
/// these are the files of `bench-cases/methods/`.
pub const OWN: [OwnRow; 16] = [
    bridgesplat("bridgesplat", "BridgeSplat", [213, 94, 0]),
    bridgesplat("bridgesplat-release", "BridgeSplat (released objective)", [156, 48, 96]),
    bridgesplat("bridgesplat-tuned", "BridgeSplat (tuned)", [120, 24, 144]),
    OwnRow {
        keeps_mesh: false,
        dash: Dash::Long,
        ..bridgesplat("bridgesplat-nomesh", "BridgeSplat (no mesh)", [192, 138, 66])
    },
    OwnRow { keeps_mesh: false, draws: true, ..ranked("ours-nomesh", "Ours (no mesh)", [72, 156, 210]) },
    ranked("ours", "Ours", [0, 114, 178]),
    OwnRow { additions: WINDOW_ADDITIONS, ..ranked("ours-window", "Ours + keyframes", [96, 24, 252]) },
    ranked("ours-gn", "Ours (Gauss-Newton)", [204, 121, 167]),
    OwnRow { dash: Dash::Dots, ..ranked("ours-nav", "Ours, navigation", [144, 72, 228]) },
    ranked("virtual-bronchoscopy", "Virtual bronchoscopy", [48, 138, 0]),
    OwnRow { sees: NO_PICTURE, dash: Dash::Short, ..ranked("pose-only", "No picture: pose", [132, 84, 0]) },
    OwnRow {
        sees: Sees { pictures: PicturesSeen::FirstSeconds, ..Sees::EVERYTHING },
        dash: Dash::Short,
        ..ranked("mean-breath", "No picture: clock", [18, 150, 162])
    },
    OwnRow { sees: ONE_CT, ..bound("static-ct", "Static CT", [130, 130, 130]) },
    OwnRow { sees: ONE_CT, dash: Dash::Dots, ..bound("static-expiration", "Static CT, expiration", [96, 84, 132]) },
    OwnRow { dash: Dash::Dots, ..bound("oracle-phase", "Oracle phase", [30, 160, 90]) },
    OwnRow {
        sees: Sees { told_poses: false, ..Sees::EVERYTHING },
        draws: true,
        dash: Dash::Long,
        ..ranked("ours-gn-pose", "Ours (Gauss-Newton), rough poses", [216, 0, 252])
    },
];

/// One of this program's own rows.
pub fn own(id: &str) -> Option<&'static OwnRow> {
    OWN.iter().find(|row| row.id == id)
}

/// What the row `id` sees; everything, where it is no own row.
pub fn sees(id: &str) -> Sees {
    own(id).map_or(Sees::EVERYTHING, |row| row.sees)
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
    fn what_is_seen_is_within_what_has_as_much_of_everything() {
        let [pose, clock, rough] = ["pose-only", "mean-breath", "ours-gn-pose"].map(sees);
        assert!(pose.is_within(clock) && clock.is_within(sees("ours")) && rough.is_within(sees("ours-gn")));
        assert!(!clock.is_within(pose) && !sees("ours").is_within(sees("bridgesplat")));
        assert!(!rough.is_within(sees("bridgesplat")) && !sees("bridgesplat").is_within(rough));
        assert_eq!(sees("opensplat"), Sees::EVERYTHING);
    }

    #[test]
    fn every_own_row_has_a_place_before_all_others() {
        assert!(OWN.iter().enumerate().all(|(index, row)| place(row.id) == index));
        assert_eq!(place("opensplat"), OWN.len());
    }
}
