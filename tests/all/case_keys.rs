//! What docs/case-files.md says of the numbers of a case file is what the program says: each has a row with its range and
//! its default, no other key has one, and the page's example is a case. A range is read from the refusal of a number
//! beyond it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use respire_bench::airway::case::Case;
use respire_bench::base::range::{COORDINATE_MM, GENERATION, RADIUS_MM};
use toml::{Table, Value};

/// Sources that hold tables of ranges of a case file, with what stands before the keys of each table.
const SOURCES: [(&str, &[&str]); 8] = [
    ("case.rs", &["camera", "trajectory"]),
    ("case_clinical.rs", &["clinical"]),
    ("case_scope.rs", &["exposure", "scope"]),
    ("field.rs", &["breathing.field"]),
    ("field_calibre.rs", &["breathing.calibre"]),
    ("grow.rs", &["anatomy.growth"]),
    ("surface.rs", &["anatomy.surface"]),
    ("waveform.rs", &["waveform"]),
];
/// How a table of ranges begins in a source.
const TABLE: &str = "KeyRanges(&[";

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn page() -> String {
    std::fs::read_to_string(root().join("docs/case-files.md")).unwrap()
}

/// The page's example, as a table of TOML.
fn example() -> Table {
    let page = page();
    toml::from_str(page.split("```toml").nth(1).unwrap().split("```").next().unwrap()).unwrap()
}

fn joined(before: &str, key: &str) -> String {
    if before.is_empty() { key.to_owned() } else { format!("{before}.{key}") }
}

/// What a row of the page says beside its key.
#[derive(Default)]
struct KeyRow {
    range: String,
    /// `None` where the table has no such column.
    default: Option<String>,
}

/// The rows of the page by the whole names of their keys. The heading "## `[camera]`" says what stands before a key.
fn documented() -> BTreeMap<String, KeyRow> {
    let (mut rows, mut before, mut columns) = (BTreeMap::new(), String::new(), Vec::new());
    for line in page().lines() {
        let cells: Vec<String> = line.split('|').map(|cell| cell.trim().to_owned()).collect();
        if line.starts_with("## ") {
            before = line.split("`[").nth(1).and_then(|rest| rest.split("]`").next()).unwrap_or("").to_owned();
        } else if cells[0] == "key" {
            columns = cells;
        } else if line.starts_with('`') && cells.len() > 1 {
            assert_eq!(cells.len(), columns.len(), "{line}");
            let cell = |name: &str| columns.iter().position(|column| column == name).map(|at| cells[at].clone());
            let row = KeyRow { range: cell("range").unwrap(), default: cell("default") };
            let key = joined(&before, cells[0].trim_matches('`'));
            assert!(rows.insert(key, row).is_none(), "{line}: the second row of its key");
        }
    }
    rows
}

/// Keys of the tables of ranges in the sources.
fn ranged_keys() -> BTreeSet<String> {
    let folder = root().join("src/airway");
    let mut keys = BTreeSet::new();
    for entry in std::fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        let text = std::fs::read_to_string(&path).unwrap();
        let name = path.file_name().unwrap().to_str().unwrap();
        let tables = SOURCES.iter().find(|(file, _)| *file == name).map_or(&[][..], |(_, tables)| tables);
        let found: Vec<&str> = text.split(TABLE).skip(1).collect();
        assert_eq!(found.len(), tables.len(), "{name}: its tables of ranges are not those of SOURCES");
        for (table, before) in found.iter().zip(tables) {
            let entries = table.split("]);").next().unwrap().split("(\"").skip(1);
            keys.extend(entries.map(|entry| joined(before, entry.split('"').next().unwrap())));
        }
    }
    keys
}

/// Paths to the numbers of `value`; of an array to its first element.
fn numbers(value: &Value, at: &[String], found: &mut Vec<Vec<String>>) {
    let below = |name: &str| [at, &[name.to_owned()]].concat();
    match value {
        Value::Integer(_) | Value::Float(_) => found.push(at.to_vec()),
        Value::Table(table) => table.iter().for_each(|(name, v)| numbers(v, &below(name), found)),
        Value::Array(items) => items.first().into_iter().for_each(|v| numbers(v, &below("0"), found)),
        _ => {}
    }
}

/// The whole name of the key in which a number stands.
fn key_of(path: &[String]) -> String {
    path.iter().filter(|word| *word != "0").cloned().collect::<Vec<_>>().join(".")
}

fn value_at<'a>(value: &'a Value, key: &str) -> Option<&'a Value> {
    key.split('.').try_fold(value, |at, name| at.get(name))
}

fn with_number(mut case: Value, path: &[String], number: Value) -> Value {
    let place = path.iter().fold(&mut case, |at, name| match at {
        Value::Array(items) => &mut items[name.parse::<usize>().unwrap()],
        other => other.get_mut(name.as_str()).unwrap(),
    });
    *place = number;
    case
}

/// The case that a file of this text is, or the sentence that refuses it.
fn load(file: &Path, case: &Value) -> Result<Case, String> {
    std::fs::write(file, toml::to_string(case).unwrap()).unwrap();
    Case::load(file).map_err(|error| error.to_string())
}

/// The range of the number at `path`, in the words of the program's refusal.
fn range_of(file: &Path, case: &Value, path: &[String]) -> String {
    let beyond = [Value::Float(1e300), Value::Integer(i64::MAX), Value::Integer(u32::MAX.into())];
    let refusals = beyond.into_iter().filter_map(|number| load(file, &with_number(case.clone(), path, number)).err());
    let ranges: Vec<String> =
        refusals.filter_map(|said| Some(said.split_once(" must lie in ")?.1.to_owned())).collect();
    ranges.first().unwrap_or_else(|| panic!("{path:?}: no number is beyond its range")).replace("or be 0", "or 0")
}

/// The example with a grown tree, as it stands, and with a tree file.
fn kinds() -> [Value; 2] {
    let grown = example();
    let path = root().join("bench-cases/trees/atm_224.toml").to_str().unwrap().to_owned();
    let tree = Table::from_iter([("kind".to_owned(), "tree".into()), ("path".to_owned(), Value::String(path))]);
    let mut other = grown.clone();
    other.insert("anatomy".to_owned(), Value::Table(tree));
    [Value::Table(grown), Value::Table(other)]
}

/// A case with its defaults written out, and the same with what is left out by default.
fn written_out(file: &Path, case: &Value) -> [Value; 2] {
    let mut case = load(file, case).unwrap();
    case.clinical = Some(case.clinical_table.clone());
    let plain = Value::try_from(&case).unwrap();
    case.camera.fisheye = Some([-0.02, 0.0, 0.0, 0.0]);
    case.waveform.hold_s = 0.5;
    case.waveform.end_phase = Some(0.5);
    case.registration_error_mm = 0.5;
    case.breathing.as_mut().unwrap().field.centers.push([0.0; 6]);
    [plain, Value::try_from(&case).unwrap()]
}

/// Whether a cell of the page says `value`: as numbers, so that 10 is 10.0.
fn says(cell: &str, value: &Value) -> bool {
    fn flat(value: &Value) -> Vec<f64> {
        match value {
            Value::Integer(number) => vec![*number as f64],
            Value::Float(number) => vec![*number],
            Value::Array(items) => items.iter().flat_map(flat).collect(),
            other => panic!("{other} is no number"),
        }
    }
    toml::from_str::<Table>(&format!("cell = {cell}")).is_ok_and(|table| flat(&table["cell"]) == flat(value))
}

/// Whether the case without `key` is refused; a case that never had it was not.
fn is_needed(file: &Path, case: &Value, key: &str) -> bool {
    let (before, last) = key.rsplit_once('.').unwrap_or(("", key));
    let mut without = case.clone();
    let table = before.split('.').filter(|name| !name.is_empty()).try_fold(&mut without, |at, name| at.get_mut(name));
    let had = table.and_then(Value::as_table_mut).and_then(|table| table.remove(last));
    had.is_some() && load(file, &without).is_err()
}

#[test]
fn every_number_of_a_case_file_is_documented_with_its_range_and_default() {
    let folder = tempfile::tempdir().unwrap();
    let file: PathBuf = folder.path().join("case.toml");
    let (rows, mut seen) = (documented(), BTreeSet::new());
    for given in kinds() {
        let [plain, full] = written_out(&file, &given);
        load(&file, &full).unwrap();
        let mut paths = Vec::new();
        numbers(&full, &[], &mut paths);
        for path in &paths {
            let key = key_of(path);
            let row = rows.get(&key).unwrap_or_else(|| panic!("docs/case-files.md has no row of {key}"));
            assert_eq!(row.range, range_of(&file, &full, path), "{key}: its range");
            let needed = row.default.as_deref() == Some("needed");
            assert_eq!(needed, is_needed(&file, &given, &key), "{key}: whether it is needed");
            match (row.default.as_deref(), value_at(&plain, &key)) {
                _ if needed => {}
                (Some(cell), Some(value)) => assert!(says(cell, value), "{key}: its default is {value}, not {cell}"),
                (Some(cell), None) => assert!(["0", "none", "drawn"].contains(&cell), "{key}: {cell}"),
                (None, _) => assert!(key.starts_with("clinical."), "{key}: no default"),
            }
            seen.insert(key);
        }
    }
    let ranged = ranged_keys();
    assert!(ranged.len() > 80, "{} keys in the sources", ranged.len());
    let untried: Vec<&String> = ranged.difference(&seen).collect();
    assert!(untried.is_empty(), "give them a value in `written_out`: {untried:?}");
    let unknown = rows.iter().filter(|(key, row)| !row.range.is_empty() && !seen.contains(*key));
    let unknown: Vec<&String> = unknown.map(|(key, _)| key).collect();
    assert!(unknown.is_empty(), "docs/case-files.md has rows of keys that no case has: {unknown:?}");
}

#[test]
fn numbers_of_a_tree_file_are_documented_with_their_ranges() {
    let page = page();
    let section = page.split("## Tree files").nth(1).unwrap();
    for (key, range) in [("`generation`", GENERATION), ("x, y, z", COORDINATE_MM), ("inscribed radius", RADIUS_MM)] {
        let said = format!("{key} ({range})");
        assert!(section.split_whitespace().collect::<Vec<_>>().join(" ").contains(&said), "{said}");
    }
}
