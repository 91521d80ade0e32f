//! This program's own rows, and what a third party may call its own.

use super::{Error, Result};

/// Id, title, whether it is a bound (shown, never ranked), CT scans that it is given, whether it keeps a mesh.
pub type OwnRow = (&'static str, &'static str, bool, u8, bool);

/// This program's own rows, in the order of tables: the paper's four, ours beyond the paper, what needs no map, the
/// bounds. A test holds that these are the files of `bench-cases/methods/`. The names are reserved.
pub const OWN: [OwnRow; 16] = [
    ("bridgesplat", "BridgeSplat", false, 1, true),
    ("bridgesplat-release", "BridgeSplat (released objective)", false, 1, true),
    ("bridgesplat-tuned", "BridgeSplat (tuned)", false, 1, true),
    ("bridgesplat-nomesh", "BridgeSplat (no mesh)", false, 1, false),
    ("ours-nomesh", "Ours (no mesh)", false, 2, false),
    ("ours", "Ours", false, 2, true),
    ("ours-window", "Ours + keyframes", false, 2, true),
    ("ours-gn", "Ours (Gauss-Newton)", false, 2, true),
    ("ours-gn-pose", "Ours (Gauss-Newton), rough poses", false, 2, true),
    ("ours-nav", "Ours, navigation", false, 2, true),
    ("virtual-bronchoscopy", "Virtual bronchoscopy", false, 2, true),
    ("pose-only", "No picture: pose", false, 2, true),
    ("mean-breath", "No picture: clock", false, 2, true),
    ("static-ct", "Static CT", true, 1, true),
    ("static-expiration", "Static CT, expiration", true, 1, true),
    ("oracle-phase", "Oracle phase", true, 2, true),
];

/// Most characters of a third party's name: more would break tables.
const LONGEST: usize = 60;

/// One of this program's own rows.
pub fn own(id: &str) -> Option<&'static OwnRow> {
    OWN.iter().find(|row| row.0 == id)
}

/// Refuses a name that a third party's row cannot have: other letters than ASCII, among which many look alike and some
/// turn the text around them; and an own row's id or title, whatever its case and separators (two rows of a table must
/// not look like one).
pub fn check_foreign(name: &str) -> Result<()> {
    let is_printable = |c: char| c == ' ' || c.is_ascii_graphic();
    if name.trim().is_empty() || name.len() > LONGEST || !name.chars().all(is_printable) {
        return Err(Error::input(format!(
            "the name of a method has 1 to {LONGEST} characters, which are letters a to z, digits, spaces and \
             punctuation of ASCII"
        )));
    }
    match OWN.iter().find(|row| [row.0, row.1].iter().any(|own| seen(own) == seen(name))) {
        Some((id, ..)) => Err(Error::input(format!(
            "`{name}` is reserved for this program's own row `{id}`; give yours another name"
        ))),
        None => Ok(()),
    }
}

/// What a reader tells names apart by: letters and digits, where 0 may be an o, and 1 and l an i.
fn seen(name: &str) -> String {
    let letter = |c: char| match c.to_ascii_lowercase() {
        '0' => 'o',
        '1' | 'l' => 'i',
        other => other,
    };
    name.chars().filter(char::is_ascii_alphanumeric).map(letter).collect()
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
        let mut own: Vec<&str> = OWN.iter().map(|row| row.0).collect();
        shipped.sort();
        own.sort_unstable();
        assert_eq!(own, shipped);
    }

    #[test]
    fn names_that_look_like_an_own_row_are_reserved() {
        let reserved = [
            "ours",
            "Ours",
            " OURS ",
            "ours_nomesh",
            "Ours (no mesh)",
            "oracle phase",
            "Static CT",
            "0urs",
            "VirtuaI bronchoscopy",
        ];
        for reserved in reserved {
            let said = check_foreign(reserved).unwrap_err().to_string();
            assert!(said.contains("reserved"), "{said}");
        }
        // Cyrillic, full width, turned around, with a dash, an accent or a blank that nobody sees.
        let alike =
            ["\u{43e}urs", "\u{ff2f}urs", "\u{202e}sruo", "Ours (Gauss\u{2013}Newton)", "ours\u{308}", "o\u{200b}urs"];
        for unfit in alike.into_iter().chain(["", "  ", "two\nlines", "ours2\u{8}", &"x".repeat(61)]) {
            let said = check_foreign(unfit).unwrap_err().to_string();
            assert!(said.contains("1 to 60 characters") && said.contains("ASCII"), "{unfit}: {said}");
        }
        for free in ["mine", "ours-but-better", "EndoGSLAM", "Groesse 2", "oracle-phase (paper)"] {
            check_foreign(free).unwrap();
        }
    }
}
