//! The `[breathing]` part of a case file, replaced in its text: all else stays as it was written, comments included.

use std::path::Path;

use toml::de::{DeTable, DeValue};

use super::case::Breathing;
use super::import_breathing::breathing_toml;
use crate::base::{Error, Result, files};

/// The key of a case file whose tables are replaced.
const KEY: &str = "breathing";

/// The place of a key in a text.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct KeyPlace {
    offset: usize,
    is_breathing: bool,
}

/// Adds where the keys within `value` are written.
fn add_places(value: &DeValue<'_>, is_breathing: bool, places: &mut Vec<KeyPlace>) {
    match value {
        DeValue::Table(table) => {
            for (key, value) in table.iter() {
                places.push(KeyPlace { offset: key.span().start, is_breathing });
                add_places(value.get_ref(), is_breathing, places);
            }
        }
        DeValue::Array(values) => values.iter().for_each(|value| add_places(value.get_ref(), is_breathing, places)),
        _ => {}
    }
}

/// The lines at the end of `text` that hold no key: what they say may be about what follows.
fn last_comments(text: &str) -> &str {
    let says_nothing = |line: &&str| line.trim().is_empty() || line.trim_start().starts_with('#');
    let length: usize = text.split_inclusive('\n').rev().take_while(says_nothing).map(str::len).sum();
    &text[text.len() - length..]
}

/// The lines of `text` without those of `breathing`.
fn without_breathing(text: &str, root: &DeTable<'_>) -> String {
    let mut places = vec![KeyPlace { offset: 0, is_breathing: false }];
    for (key, value) in root.iter() {
        let is_breathing = key.get_ref() == KEY;
        places.push(KeyPlace { offset: key.span().start, is_breathing });
        add_places(value.get_ref(), is_breathing, &mut places);
    }
    places.sort();
    // Of keys side by side, the first one stands for all.
    places.dedup_by_key(|place| place.is_breathing);
    let line_start = |offset: usize| text[..offset].rfind('\n').map_or(0, |end| end + 1);
    let starts = places.iter().map(|place| line_start(place.offset));
    let ends = starts.clone().skip(1).chain([text.len()]);
    let part = |((place, start), end): ((&KeyPlace, usize), usize)| match place.is_breathing {
        true => last_comments(&text[start..end]),
        false => &text[start..end],
    };
    places.iter().zip(starts.clone()).zip(ends).map(part).collect()
}

/// The text of the case file `path` with `breathing` at its end, in place of what it says of breathing.
///
/// Errors: a text that is no TOML; one that says something else in the midst of it, by a table that is opened twice.
pub fn with_breathing(text: &str, path: &Path, breathing: &Breathing) -> Result<String> {
    let mut before: toml::Table = files::parse_toml(text, path)?;
    let root = DeTable::parse(text).map_err(|e| Error::input(e.message()).at(path))?;
    let written = format!("{}\n\n{}", without_breathing(text, root.get_ref()).trim_end(), breathing_toml(breathing));
    let after = toml::from_str::<toml::Table>(&written).ok();
    before.remove(KEY);
    let rest = after.map(|mut after| {
        after.remove(KEY);
        after
    });
    match rest == Some(before) {
        true => Ok(written),
        false => {
            let sentence = "what follows it cannot be told from it: move it to the end of the file";
            Err(Error::input(sentence).element(format!("[{KEY}]")).at(path))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::field::BreathingField;
    use super::super::field_calibre::Calibre;
    use super::*;

    fn breathing() -> Breathing {
        let field = BreathingField {
            source: "new".into(),
            scale: 1.0,
            softening_mm: 2.0,
            origin_mm: [0.0; 3],
            affine: [[0.0; 4]; 3],
            centers: vec![[1.0; 6]; 2],
        };
        Breathing { calibre: Calibre::default(), field }
    }

    #[test]
    fn all_but_the_breathing_stays_as_it_was_written() {
        let new = breathing_toml(&breathing());
        let written = |text: &str| with_breathing(text, Path::new("a.toml"), &breathing());
        let old = "[breathing.calibre]\n# old\ndiameter_ratio = [\n[1.0],\n]\n\n[breathing.field]\nscale = 2.0\n";
        let (head, tail) = ("# mine\nid = 'a'\n\n[camera]\nfov = 1 # wide\n", "\n# large\n[scope]\nradius_mm = 2\n");
        // At the end, where imports write it; before other tables; between them; nowhere yet.
        assert_eq!(written(&format!("{head}\n{old}")).unwrap(), format!("{head}\n{new}"));
        assert_eq!(written(&format!("{head}\n{old}{tail}")).unwrap(), format!("{head}\n{tail}\n{new}"));
        assert_eq!(written(&format!("{old}{tail}")).unwrap(), format!("{tail}\n{new}"));
        assert_eq!(written(head).unwrap(), format!("{head}\n{new}"));
        // Once more changes nothing.
        let once = written(&format!("{head}{old}{tail}")).unwrap();
        assert_eq!(written(&once).unwrap(), once);
        let inline = "breathing = { scale = 1 }\nid = 'a'\n";
        assert_eq!(written(inline).unwrap(), format!("id = 'a'\n\n{new}"));
    }

    #[test]
    fn what_cannot_be_told_apart_or_read_is_refused_with_its_place() {
        let said = |text: &str| with_breathing(text, Path::new("a.toml"), &breathing()).unwrap_err().to_string();
        let twice = said("[[x]]\na = 1\n[breathing]\nb = 1\n[[x]]\na = 2\n");
        assert!(twice.starts_with("a.toml: [breathing]: "), "{twice}");
        let broken = said("id = 'a'\nx = [1\n");
        assert!(broken.starts_with("a.toml: line "), "{broken}");
    }
}
