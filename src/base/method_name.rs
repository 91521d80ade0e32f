//! What a third party may call its own row.

use super::own_row::OWN;
use super::{Error, Result};

/// Most characters of a third party's name: more would break tables.
const LONGEST: usize = 60;

/// What tables add to the title of an own row that is run with other settings ([`title_of_changed`]).
const CHANGED: &str = ", changed";

/// The title of a row of this program that is run with other settings than those that come with it.
pub fn title_of_changed(title: &str) -> String {
    format!("{title}{CHANGED}")
}

/// Whether a reader would take two names for one: they differ in case, or in letters and digits that look alike, at most.
pub fn look_alike(a: &str, b: &str) -> bool {
    shapes(a) == shapes(b)
}

/// Refuses a name that a third party's row cannot have: other letters than ASCII, among which many look alike and some
/// turn the text around them; and an own row's id or title, whatever its case and separators (two rows of a table must
/// not look like one).
pub fn check_foreign(name: &str) -> Result<()> {
    let is_printable = |c: char| c == ' ' || c.is_ascii_graphic();
    if name.is_empty() || name.trim() != name || name.len() > LONGEST || !name.chars().all(is_printable) {
        return Err(Error::input(format!(
            "the name of a method has 1 to {LONGEST} characters, which are letters a to z, digits, spaces within and \
             punctuation of ASCII"
        )));
    }
    let seen_name = seen(name);
    let is_own = |own: &str| [seen(own), seen(own) + &seen(CHANGED)].contains(&seen_name);
    match OWN.iter().find(|row| is_own(row.id) || is_own(row.title)) {
        Some(row) => Err(Error::input(format!(
            "`{name}` is reserved for this program's own row `{}`; give yours another name",
            row.id
        ))),
        None => Ok(()),
    }
}

/// What a reader may take a name for: letters and digits, where 5 and $ stand for an s, 8 for a b and @ for an a.
fn seen(name: &str) -> String {
    let letter = |c: char| match c {
        '5' | '$' => 's',
        '8' => 'b',
        '@' => 'a',
        other => other,
    };
    shapes(name).chars().map(letter).filter(char::is_ascii_alphanumeric).collect()
}

/// What can be told apart of a name in any typeface: lower case, 0 as an o, 1, l, a bar and ! as an i, rn as an m, vv as a w.
fn shapes(name: &str) -> String {
    let letter = |c: char| match c.to_ascii_lowercase() {
        '0' => 'o',
        '1' | 'l' | '|' | '!' => 'i',
        other => other,
    };
    name.chars().map(letter).collect::<String>().replace("rn", "m").replace("vv", "w")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_look_like_an_own_row_are_reserved() {
        let reserved = [
            "ours",
            "Ours",
            "ours_nomesh",
            "Ours (no mesh)",
            "oracle phase",
            "Static CT",
            "0urs",
            "Our5",
            "VirtuaI bronchoscopy",
            "BridgeSp|at",
            "Our$",
            "8ridgeSplat",
            "Ours (no rnesh)",
            "Ours, changed",
            "ours changed",
        ];
        for reserved in reserved {
            let said = check_foreign(reserved).unwrap_err().to_string();
            assert!(said.contains("reserved"), "{said}");
        }
        // Cyrillic, full width, turned around, with a dash, an accent or a blank that nobody sees.
        let alike =
            ["\u{43e}urs", "\u{ff2f}urs", "\u{202e}sruo", "Ours (Gauss\u{2013}Newton)", "ours\u{308}", "o\u{200b}urs"];
        for unfit in alike.into_iter().chain(["", "  ", "mine ", " OURS ", "two\nlines", "ours2\u{8}", &"x".repeat(61)])
        {
            let said = check_foreign(unfit).unwrap_err().to_string();
            assert!(said.contains("1 to 60 characters") && said.contains("ASCII"), "{unfit}: {said}");
        }
        for free in ["mine", "ours-but-better", "EndoGSLAM", "Groesse 2", "oracle-phase (paper)"] {
            check_foreign(free).unwrap();
        }
    }

    #[test]
    fn names_that_look_alike_are_told() {
        for (a, b) in [("EndoGSLAM", "EndoGSIAM"), ("EndoGSLAM", "endogslam"), ("net 10", "net lO"), ("mine", "rnine")]
        {
            assert!(look_alike(a, b), "{a} and {b}");
        }
        for (a, b) in [("net v1.0", "net v10"), ("net 5", "net S"), ("net 8", "net B"), ("mine", "mine 2")] {
            assert!(!look_alike(a, b), "{a} and {b}");
        }
    }
}
