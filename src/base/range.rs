//! The rule for numbers from outside: each has a range, and is checked against it where it is read.
//!
//! A file's settings have a table of [`KeyRanges`], a word of the command line has [`NumberRange::parser`]. Both say
//! the same sentence: `1e-300 must lie in 0.1 to 10`. Ranges are wide: they keep out what no film, scene or method
//! could mean (or what would never end), not what is unusual. A number in range may still ask for much work; that is
//! what [`super::estimate`] is for.

use std::fmt;
use std::str::FromStr;

#[cfg(feature = "methods")]
use serde::Serialize;
#[cfg(feature = "methods")]
use toml::Value;

use super::error::{Error, Result};

/// The numbers that a key or an option may have: from one to another, both included. Never NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NumberRange {
    low: f64,
    high: f64,
    or_zero: bool,
}

/// Numbers of frames in a film.
pub const FRAMES: NumberRange = NumberRange::new(2.0, 100_000.0);
/// Frames per second.
pub const FRAME_RATE: NumberRange = NumberRange::new(0.1, 1000.0);
/// Width and height in pixels of a film or a chart's image.
pub const IMAGE_SIDE_PX: NumberRange = NumberRange::new(1.0, 4096.0);
/// Samples per pixel.
pub const SAMPLES_PER_PIXEL: NumberRange = NumberRange::new(1.0, 65_536.0);
/// Seeds: what a TOML file can hold, rounded down.
pub const SEED: NumberRange = NumberRange::new(0.0, 9e18);
/// More threads than this only wait for each other.
const MOST_THREADS: f64 = 512.0;
/// Threads; 0 means every core.
pub const THREADS: NumberRange = NumberRange::new(0.0, MOST_THREADS);
/// Processors of a task on a cluster, each with a thread.
pub const PROCESSORS: NumberRange = NumberRange::new(1.0, MOST_THREADS);
/// Repetitions of a measurement.
pub const REPETITIONS: NumberRange = NumberRange::new(1.0, 10_000.0);
/// A part of a whole, and the breathing phase.
pub const SHARE: NumberRange = NumberRange::new(0.0, 1.0);
/// Coordinates in mm: ten metres around the origin of a scanner.
pub const COORDINATE_MM: NumberRange = NumberRange::new(-10_000.0, 10_000.0);
/// Coordinates in a unit that a file of another program does not tell: still exact to a millionth of a unit.
pub const COORDINATE: NumberRange = NumberRange::new(-1e9, 1e9);
/// Largest depths of a prediction in mm; what is above 0 and within is a depth, what is not finite or not above 0 is none.
pub const PREDICTED_DEPTH_MM: NumberRange = NumberRange::new(0.0, 1e6);
/// Times of frames in seconds since the first.
pub const TIME_S: NumberRange = NumberRange::new(0.0, 1e7);
/// Phases of a prediction; one in percent is read, and `check` warns of it.
pub const PREDICTED_PHASE: NumberRange = NumberRange::new(-1000.0, 1000.0);
/// Standard deviations of a prediction's phases.
pub const PREDICTED_PHASE_SD: NumberRange = NumberRange::new(1e-12, 1000.0);
/// Entries of a covariance of places, mm squared.
pub const COVARIANCE_MM2: NumberRange = NumberRange::new(-1e8, 1e8);
/// Seconds that a method took: no less than a clock can tell.
pub const WORK_TIME_S: NumberRange = NumberRange::new(1e-6, 1e9);
/// Mean duration of a breath in seconds.
pub const BREATHING_PERIOD_S: NumberRange = NumberRange::new(1e-3, 1e6);
/// Inscribed radii in mm.
pub const RADIUS_MM: NumberRange = NumberRange::new(1e-3, 1000.0);
/// Airway generations; real ones end at 23.
pub const GENERATION: NumberRange = NumberRange::new(0.0, 64.0);
/// Radii in mm below which branches are left out.
pub const LEAST_RADIUS_MM: NumberRange = NumberRange::new(0.1, 10.0);
/// Horizontal fields of view in degrees of a scope.
pub const FIELD_OF_VIEW_DEG: NumberRange = NumberRange::new(20.0, 170.0);
/// Radii in mm of a scope.
pub const SCOPE_RADIUS_MM: NumberRange = NumberRange::new(0.1, 50.0);
/// Radiances and other unbounded amounts of light.
pub const LIGHT: NumberRange = NumberRange::new(0.0, 1e12);

impl NumberRange {
    /// From `low` to `high`, both included.
    pub const fn new(low: f64, high: f64) -> Self {
        NumberRange { low, high, or_zero: false }
    }

    /// The same, and 0: the value that switches something off.
    pub const fn or_zero(self) -> Self {
        NumberRange { or_zero: true, ..self }
    }

    /// Whether `value` is one of them.
    pub fn contains(self, value: f64) -> bool {
        (self.low..=self.high).contains(&value) || (self.or_zero && value == 0.0)
    }

    /// Refuses every other value; the caller adds key and file.
    pub fn check(self, value: f64) -> Result<()> {
        if self.contains(value) { Ok(()) } else { Err(Error::input(self.sentence(&shown(value)))) }
    }

    fn sentence(self, value: &str) -> String {
        format!("{value} must lie in {self}")
    }

    /// Reads a number of this range from a word of the command line.
    pub fn parser<T: FromStr>(self) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static {
        move |word| {
            let number: f64 = word.trim().parse().map_err(|_| format!("`{word}` is no number"))?;
            if !self.contains(number) {
                return Err(self.sentence(word.trim()));
            }
            word.trim().parse().map_err(|_| format!("{} must be a whole number", word.trim()))
        }
    }
}

impl fmt::Display for NumberRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} to {}", shown(self.low), shown(self.high))?;
        if self.or_zero { f.write_str(", or be 0") } else { Ok(()) }
    }
}

/// As a person writes it: no 300 zeros.
fn shown(value: f64) -> String {
    let size = value.abs();
    if size == 0.0 || (1e-4..1e7).contains(&size) || !value.is_finite() {
        value.to_string()
    } else {
        format!("{value:e}")
    }
}

/// Ranges of all numbers of one kind of settings. A key of a group has the group's name before it
/// (`window.keyframes`); an array's numbers share its key, and so do the tables of an array.
#[cfg(feature = "methods")]
pub struct KeyRanges(pub &'static [(&'static str, NumberRange)]);

#[cfg(feature = "methods")]
impl KeyRanges {
    /// Checks every number that `settings` holds. The error names the key, with `prefix` before it where that is not
    /// empty. A number whose key has no range is refused too, so that no key can be added without one.
    pub fn check(&self, prefix: &str, settings: &impl Serialize) -> Result<()> {
        let values = Value::try_from(settings)
            .map_err(|e| Error::input(e.to_string().trim_end().replace('\n', " ")).element(prefix))?;
        self.check_value(prefix, &values)
    }

    /// [`KeyRanges::check`] for a value that has been read already. A table with a `value` (and its source) counts as
    /// that value.
    pub fn check_value(&self, prefix: &str, values: &Value) -> Result<()> {
        self.walk(values, "", prefix)
    }

    /// `key` finds the range, `place` is what the user sees.
    fn walk(&self, value: &Value, key: &str, place: &str) -> Result<()> {
        let number = match value {
            Value::Integer(number) => *number as f64,
            Value::Float(number) => *number,
            Value::Array(items) => {
                return items
                    .iter()
                    .enumerate()
                    .try_for_each(|(i, item)| self.walk(item, key, &format!("{place}[{i}]")));
            }
            Value::Table(table) => {
                return match table.get("value") {
                    Some(sourced) => self.walk(sourced, key, place),
                    None => {
                        table.iter().try_for_each(|(name, v)| self.walk(v, &joined(key, name), &joined(place, name)))
                    }
                };
            }
            Value::String(_) | Value::Boolean(_) | Value::Datetime(_) => return Ok(()),
        };
        let range = self.0.iter().find(|(name, _)| *name == key).map(|(_, range)| range);
        let range = range.ok_or_else(|| Error::input("has no range").element(place))?;
        range.check(number).map_err(|e| e.element(place))
    }
}

#[cfg(feature = "methods")]
fn joined(path: &str, name: &str) -> String {
    if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sentence_says_number_and_range() {
        let said = |range: NumberRange, value: f64| range.check(value).unwrap_err().to_string();
        let period = NumberRange::new(0.1, 100.0);
        assert_eq!(said(period, 1e-300), "1e-300 must lie in 0.1 to 100");
        assert_eq!(said(period, f64::NAN), "NaN must lie in 0.1 to 100");
        assert_eq!(said(period, 0.0), "0 must lie in 0.1 to 100");
        assert_eq!(said(NumberRange::new(5.0, 85.0).or_zero(), -1.0), "-1 must lie in 5 to 85, or be 0");
        assert_eq!(said(LIGHT, f64::INFINITY), "inf must lie in 0 to 1e12");
        for value in [0.1, 1.0, 100.0] {
            assert!(period.check(value).is_ok());
        }
        assert!(period.or_zero().check(0.0).is_ok() && period.or_zero().check(f64::NAN).is_err());
    }

    #[test]
    fn words_are_read_in_range_or_refused() {
        let frames = FRAMES.parser::<usize>();
        assert_eq!(frames("40"), Ok(40));
        assert_eq!(frames("2000000000").unwrap_err(), "2000000000 must lie in 2 to 100000");
        assert_eq!(frames("18446744073709551615").unwrap_err(), "18446744073709551615 must lie in 2 to 100000");
        assert_eq!(frames("2.5").unwrap_err(), "2.5 must be a whole number");
        for word in ["", "many", "nan", "inf", "-1", "1e300"] {
            assert!(frames(word).is_err(), "{word}");
        }
        assert_eq!(SHARE.parser::<f64>()("1e-300"), Ok(1e-300));
    }

    #[test]
    fn every_number_of_settings_is_checked_and_named() {
        let ranges = KeyRanges(&[("a", SHARE), ("group.b", FRAMES), ("rows.c", SHARE), ("d", SHARE)]);
        let good = "a = 0.5\nd = { value = [0, 1], source = 'x' }\nname = 'n'\n[group]\nb = 7\n[[rows]]\nc = 1";
        let check = |from: &str, to: &str| {
            let table: toml::Table = toml::from_str(&good.replace(from, to)).unwrap();
            ranges.check("file", &table).map_err(|e| e.to_string())
        };
        assert_eq!(check("", ""), Ok(()));
        for (from, to, says) in [
            ("a = 0.5", "a = nan", "file.a: NaN must lie in 0 to 1"),
            ("b = 7", "b = 1", "file.group.b: 1 must lie in 2 to 100000"),
            ("c = 1", "c = -1", "file.rows[0].c: -1 must lie in 0 to 1"),
            ("[0, 1]", "[0, inf]", "file.d[1]: inf must lie in 0 to 1"),
            ("name = 'n'", "name = 3", "file.name: has no range"),
        ] {
            assert_eq!(check(from, to), Err(says.to_owned()));
        }
    }
}
