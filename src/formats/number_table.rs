//! Tables of numbers as CSV: columns are found by the names in the first line, and every row has all of them.

use crate::base::range::NumberRange;
use crate::base::{Error, Result};

/// Numbers that count or name things: frames, targets, points.
pub const COUNT: NumberRange = NumberRange::new(0.0, 1e9);

/// A column: its name, and the numbers that it may hold.
pub type Column<'a> = (&'a str, NumberRange);

/// The line of `bytes` in which a record begins. Its position, as the reader tells it, is before the empty lines that it
/// passed over.
pub fn line_of(bytes: &[u8], at: Option<&csv::Position>) -> u64 {
    let Some(at) = at else { return 1 };
    let rest = bytes.get(at.byte() as usize..).unwrap_or_default();
    let empty = rest.iter().take_while(|byte| matches!(byte, b'\r' | b'\n'));
    at.line() + empty.filter(|&&byte| byte == b'\n').count() as u64
}

/// A row of a table, and where it stands: an empty line is no row, and a field may hold a line break.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NumberRow<const N: usize> {
    /// Line of the file, from 1.
    pub line: u64,
    /// In the order of the columns that were asked for.
    pub numbers: [f64; N],
}

impl<const N: usize> NumberRow<N> {
    /// `error` with the row's line.
    pub fn refuse(&self, error: Error) -> Error {
        error.element(format!("line {}", self.line))
    }
}

/// The rows with the numbers of `columns`. The table may have them in another order, and others beside them.
///
/// Errors name the line and the column: a name that is missing or there twice, a row with more or fewer fields than
/// names, a field that is no number or out of range.
pub fn rows<const N: usize>(bytes: &[u8], columns: [Column<'_>; N]) -> Result<Vec<NumberRow<N>>> {
    rows_where(bytes, columns, |_| true)
}

/// [`rows`], of those alone that are `wanted` by their place from 0: in the others anything may stand.
pub fn rows_where<const N: usize>(
    bytes: &[u8],
    columns: [Column<'_>; N],
    wanted: impl Fn(usize) -> bool,
) -> Result<Vec<NumberRow<N>>> {
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(bytes);
    let header = reader.headers().map_err(|e| Error::input(e.to_string()).element("line 1"))?.clone();
    let mut places = [0; N];
    let names = columns.map(|(name, _)| name);
    for (place, name) in places.iter_mut().zip(names) {
        *place = place_of(name, &header, &names)?;
    }
    let mut rows = Vec::new();
    for (place, record) in reader.records().enumerate() {
        let record = record.map_err(|e| {
            let line = line_of(bytes, e.position());
            Error::input(e.to_string()).element(format!("line {line}"))
        })?;
        if !wanted(place) {
            continue;
        }
        let line = line_of(bytes, record.position());
        let mut numbers = [0.0; N];
        for ((number, place), (name, range)) in numbers.iter_mut().zip(places).zip(columns) {
            let text = record.get(place).unwrap_or_default();
            let named = |e: Error| e.element(format!("line {line}: {name}"));
            *number = text.parse().map_err(|_| named(Error::input(format!("\"{text}\" is no number"))))?;
            range.check(*number).map_err(named)?;
        }
        rows.push(NumberRow { line, numbers });
    }
    Ok(rows)
}

/// What stands in `column`, which is one of `names`, in each of the rows.
///
/// Errors as [`rows`].
pub fn words(bytes: &[u8], column: &str, names: &[&str]) -> Result<Vec<String>> {
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(bytes);
    let header = reader.headers().map_err(|e| Error::input(e.to_string()).element("line 1"))?.clone();
    let place = place_of(column, &header, names)?;
    let word = |record: csv::Result<csv::StringRecord>| match record {
        Ok(record) => Ok(record.get(place).unwrap_or_default().to_owned()),
        Err(e) => Err(Error::input(e.to_string()).element(format!("line {}", line_of(bytes, e.position())))),
    };
    reader.records().map(word).collect()
}

/// Which column of a table is called `name`; all of `names` are wanted.
fn place_of(name: &str, header: &csv::StringRecord, names: &[&str]) -> Result<usize> {
    let mut found = header.iter().enumerate().filter(|(_, h)| is_named(h, name)).map(|(at, _)| at);
    match (found.next(), found.next()) {
        (Some(at), None) => Ok(at),
        (Some(_), Some(_)) => Err(Error::input("is there twice").element(format!("line 1: column {name}"))),
        (None, _) if header.len() == 1 && header[0].contains([';', '\t']) => {
            let sentence = "has no comma: columns are separated by commas, not by semicolons or tabs";
            Err(Error::input(sentence).element("line 1"))
        }
        (None, _) => {
            let missing = Error::input(format!("is missing; the columns are {}", names.join(",")));
            Err(missing.element(format!("line 1: column {name}")))
        }
    }
}

/// Whether the first line of a table names `column`.
///
/// Errors: a first line that is no text.
pub fn has_column(bytes: &[u8], column: &str) -> Result<bool> {
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(bytes);
    let header = reader.headers().map_err(|e| Error::input(e.to_string()).element("line 1"))?;
    Ok(header.iter().any(|h| is_named(h, column)))
}

fn is_named(header: &str, column: &str) -> bool {
    header.trim_start_matches('\u{feff}').eq_ignore_ascii_case(column)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::range::{COORDINATE_MM, FRAMES};

    const COLUMNS: [Column<'_>; 3] = [("frame", FRAMES), ("x_mm", COORDINATE_MM), ("y_mm", COORDINATE_MM)];

    #[test]
    fn columns_are_found_by_name() {
        let read = rows(b"\xef\xbb\xbfy_mm, note,X_mm,frame\n2.5,a,1,7\n-3,b,1e3,8\n", COLUMNS).unwrap();
        let [first, second] = [(2, [7.0, 1.0, 2.5]), (3, [8.0, 1000.0, -3.0])];
        assert_eq!(read, [first, second].map(|(line, numbers)| NumberRow { line, numbers }));
        assert!(rows(b"frame,x_mm,y_mm\n", COLUMNS).unwrap().is_empty());
    }

    #[test]
    fn what_is_no_table_of_these_numbers_is_named() {
        for (text, says) in [
            ("", "line 1: column frame: is missing; the columns are frame,x_mm,y_mm"),
            ("frame,x_mm\n7,1\n", "line 1: column y_mm: is missing; the columns are frame,x_mm,y_mm"),
            ("frame,x_mm,y_mm,x_mm\n", "line 1: column x_mm: is there twice"),
            ("frame,x_mm,y_mm\n7,1,2\n7,n/a,2\n", "line 3: x_mm: \"n/a\" is no number"),
            ("frame,x_mm,y_mm\n7,,2\n", "line 2: x_mm: \"\" is no number"),
            ("frame,x_mm,y_mm\n7,1,1e200\n", "line 2: y_mm: 1e200 must lie in -10000 to 10000"),
            ("\nframe,x_mm,y_mm\n\n7,1,2\n\n7,n/a,2\n", "line 6: x_mm: \"n/a\" is no number"),
            ("frame,x_mm,note,y_mm\n7,1,\"a\nb\",2\n7,n/a,,2\n", "line 4: x_mm: \"n/a\" is no number"),
            ("frame,x_mm,y_mm\n7,1,nan\n", "line 2: y_mm: NaN must lie in -10000 to 10000"),
        ] {
            assert_eq!(rows(text.as_bytes(), COLUMNS).unwrap_err().to_string(), says);
        }
        for uneven in ["frame,x_mm,y_mm\n7,1\n", "frame,x_mm,y_mm\n7,n/a,1,2\n"] {
            assert!(rows(uneven.as_bytes(), COLUMNS).unwrap_err().to_string().starts_with("line 2: "), "{uneven}");
        }
    }
}
