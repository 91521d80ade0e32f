//! What a case may be called: folders, pictures and pages are named by it.

use super::{Error, Result};

/// Most characters of an id: folder names have more after it.
const LONGEST: usize = 100;

fn is_plain(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '-' || c == '_'
}

/// Refuses an id that could not name a file, or that names one elsewhere; the caller adds key and file.
pub fn check(id: &str) -> Result<()> {
    if id.is_empty() || !id.chars().all(is_plain) {
        return Err(Error::input("must be letters, digits, `-` and `_`"));
    }
    if id.starts_with('-') {
        return Err(Error::input("must not begin with `-`: commands would take it for an option"));
    }
    if id.len() > LONGEST {
        return Err(Error::input(format!("must have no more than {LONGEST} characters: folders are named by it")));
    }
    Ok(())
}

/// An id made of a folder's name, for a film that does not tell its own: what an id cannot hold is `_`.
pub fn of_folder(name: &str) -> String {
    let id: String = name.chars().map(|c| if is_plain(c) { c } else { '_' }).take(LONGEST).collect();
    match id.strip_prefix('-') {
        Some(rest) => format!("_{rest}"),
        None if id.is_empty() => "_".to_owned(),
        None => id,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_id_names_a_file_here_and_nowhere_else() {
        check("case1").unwrap();
        check(&"x".repeat(LONGEST)).unwrap();
        for id in ["", "..", "/../x", "a b", "ä", "a\u{0}", "a.b", "--help", &"x".repeat(LONGEST + 1)] {
            assert!(check(id).is_err(), "{id:?}");
            check(&of_folder(id)).unwrap();
        }
        assert_eq!(of_folder("my film.1"), "my_film_1");
    }
}
