//! Reads settings from the keys of a table, and knows which keys nothing has read.
//!
//! `serde` can refuse unknown keys, and it can build a struct from several that share a table, but not both at once.
//! Here each part of a method's settings takes its keys from the table in turn. What a part has read is known from the
//! keys that it writes when it is turned into a table again, so that no second list of names is needed.

use serde::Serialize;
use serde::de::DeserializeOwned;
use toml::{Table, Value};

use crate::base::{Error, Result};

/// Where a key stands: the names of its groups, then its own.
pub type KeyPath = Vec<String>;

/// Settings of one kind of method.
pub trait MethodSettings: Sized {
    /// Takes the kind's keys.
    ///
    /// Errors: a key is missing, or its value has another type.
    fn read(keys: &mut Keys) -> Result<Self>;
}

/// The keys of a table, and those that have not been read yet.
pub struct Keys {
    all: Table,
    unread: Table,
}

impl Keys {
    /// All keys of `table`, none of them read.
    pub fn new(table: Table) -> Self {
        Keys { unread: table.clone(), all: table }
    }

    /// Reads a part whose keys stand in this table among those of others.
    pub fn part<P: Serialize + DeserializeOwned>(&mut self) -> Result<P> {
        let part: P = Value::Table(self.all.clone()).try_into().map_err(refusal)?;
        if let Value::Table(read) = back(&part)? {
            subtract(&mut self.unread, &read);
        }
        Ok(part)
    }

    /// Reads the value of one key.
    pub fn key<T: Serialize + DeserializeOwned>(&mut self, name: &str) -> Result<T> {
        let missing = || Error::input(format!("missing field `{name}`"));
        let value: T =
            self.all.get(name).ok_or_else(missing)?.clone().try_into().map_err(|e| refusal(e).element(name))?;
        let read = Table::from_iter([(name.to_owned(), back(&value)?)]);
        subtract(&mut self.unread, &read);
        Ok(value)
    }

    /// Reads the table `name` in parts.
    pub fn table<T>(&mut self, name: &str, read: impl FnOnce(&mut Keys) -> Result<T>) -> Result<T> {
        let missing = || Error::input(format!("missing table `{name}`"));
        let mut inner = Keys::new(self.all.get(name).and_then(Value::as_table).ok_or_else(missing)?.clone());
        let value = read(&mut inner).map_err(|e| e.element(name))?;
        self.unread.remove(name);
        if !inner.unread.is_empty() {
            self.unread.insert(name.to_owned(), Value::Table(inner.unread));
        }
        Ok(value)
    }

    /// Paths of the keys that nothing has read.
    pub fn unread(&self) -> Vec<KeyPath> {
        leaves(&self.unread)
    }
}

/// Whether a table is the value of one key (`{ value = .., source = .. }`) and not a group of keys.
fn is_sourced(table: &Table) -> bool {
    table.contains_key("value")
}

/// A group of keys; `None` for the value of one key.
fn group(value: &Value) -> Option<&Table> {
    value.as_table().filter(|table| !is_sourced(table))
}

fn refusal(error: toml::de::Error) -> Error {
    Error::input(error.to_string().trim_end().replace('\n', " "))
}

fn back(value: &impl Serialize) -> Result<Value> {
    Value::try_from(value).map_err(|e| Error::input(e.to_string()))
}

fn subtract(from: &mut Table, read: &Table) {
    for (name, value) in read {
        match (from.get_mut(name), group(value)) {
            (Some(Value::Table(rest)), Some(read)) if !is_sourced(rest) => {
                subtract(rest, read);
                if rest.is_empty() {
                    from.remove(name);
                }
            }
            _ => drop(from.remove(name)),
        }
    }
}

fn leaves(table: &Table) -> Vec<KeyPath> {
    let mut found = Vec::new();
    for (name, value) in table {
        let below = group(value).filter(|inner| !inner.is_empty()).map_or_else(|| vec![Vec::new()], leaves);
        found.extend(below.into_iter().map(|path| [vec![name.clone()], path].concat()));
    }
    found
}

/// Removes the key at `path`, and the groups that it leaves empty.
pub fn remove(table: &mut Table, path: &[String]) {
    let Some((first, rest)) = path.split_first() else { return };
    if rest.is_empty() {
        table.remove(first);
    } else if let Some(Value::Table(inner)) = table.get_mut(first) {
        remove(inner, rest);
        if inner.is_empty() {
            table.remove(first);
        }
    }
}

/// Whether there is a key at `path`.
pub fn contains(table: &Table, path: &[String]) -> bool {
    match path {
        [] => true,
        [first, rest @ ..] => table.get(first).is_some_and(|value| match group(value) {
            Some(inner) => contains(inner, rest),
            None => rest.is_empty(),
        }),
    }
}

/// Overrides the keys of `base` by those of `own`, group by group; a value is replaced together with its source.
pub fn overlay(base: &mut Table, own: Table) {
    for (name, value) in own {
        match (base.get_mut(&name), value) {
            (Some(Value::Table(below)), Value::Table(above)) if !is_sourced(below) && !is_sourced(&above) => {
                overlay(below, above);
            }
            (_, value) => drop(base.insert(name, value)),
        }
    }
}

/// Replaces the value at `path`, whose source stays; an error when there is no such key.
pub fn replace(table: &mut Table, path: &[&str], value: Value) -> Result<()> {
    let missing = || Error::input(format!("has no key `{}`", path.join(".")));
    let (last, groups) = path.split_last().ok_or_else(missing)?;
    let mut at = table;
    for group in groups {
        at = at.get_mut(*group).and_then(Value::as_table_mut).ok_or_else(missing)?;
    }
    match at.get_mut(*last).ok_or_else(missing)? {
        Value::Table(sourced) if is_sourced(sourced) => sourced.insert("value".into(), value),
        plain => Some(std::mem::replace(plain, value)),
    };
    Ok(())
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    fn table(text: &str) -> Table {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn what_no_part_reads_is_left_with_its_path() {
        #[derive(Serialize, Deserialize)]
        struct Window {
            keyframes: u32,
        }
        #[derive(Serialize, Deserialize)]
        struct Rates {
            rate: f64,
            #[serde(default)]
            absent: Option<f64>,
        }
        let mut keys = Keys::new(table(
            "rate = 1
            stray = { value = 1, source = 'ours' }
            window = { keyframes = 3, size = 2 }
            discs = { rate = 2.0, number = 4, color = 'red' }",
        ));
        assert_eq!(keys.part::<Rates>().unwrap().rate, 1.0);
        assert_eq!(keys.key::<Window>("window").unwrap().keyframes, 3);
        let read = keys.table("discs", |discs| Ok((discs.part::<Rates>()?.rate, discs.key::<u32>("number")?)));
        assert_eq!(read.unwrap(), (2.0, 4));
        let unread: Vec<String> = keys.unread().iter().map(|path| path.join(".")).collect();
        assert_eq!(unread, ["discs.color", "stray", "window.size"]);
        for (says, error) in [
            ("speed", keys.key::<f64>("speed").unwrap_err()),
            ("absent", keys.key::<Rates>("absent").err().unwrap()),
            ("color", keys.table("discs", |discs| discs.key::<f64>("color")).unwrap_err()),
        ] {
            assert!(error.to_string().contains(says), "{error}");
        }
    }

    #[test]
    fn an_heir_replaces_values_with_their_source_and_keeps_the_rest_of_a_group() {
        let mut keys = table("a = { value = 1, source = 'paper', why = 'Eq. 3' }\n[group]\nb = 1\nc = 2");
        overlay(&mut keys, table("a = { value = 2, source = 'ours' }\n[group]\nc = 3\n[other]\nd = 4"));
        assert_eq!(keys, table("a = { value = 2, source = 'ours' }\n[group]\nb = 1\nc = 3\n[other]\nd = 4"));
        let path = |path: &str| path.split('.').map(str::to_owned).collect::<Vec<_>>();
        assert!(contains(&keys, &path("group.b")) && !contains(&keys, &path("group.d")));
        remove(&mut keys, &path("other.d"));
        assert!(!keys.contains_key("other"));
    }

    #[test]
    fn a_changed_value_keeps_its_source_and_an_unknown_key_is_named() {
        let mut keys = table("variant = 'full'\n[appearance]\nrate = { value = 1, source = 'ours' }");
        replace(&mut keys, &["appearance", "rate"], Value::from(3)).unwrap();
        replace(&mut keys, &["variant"], Value::from("release")).unwrap();
        assert_eq!(keys, table("variant = 'release'\n[appearance]\nrate = { value = 3, source = 'ours' }"));
        let error = replace(&mut keys, &["appearance", "speed"], Value::from(3)).unwrap_err();
        assert!(error.to_string().contains("appearance.speed"), "{error}");
    }
}
