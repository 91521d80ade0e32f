//! Landmark pairs as CSV: `insp_x,insp_y,insp_z,exp_x,exp_y,exp_z` in mm, one pair a row (DIR-Lab by way of
//! Lung250M-4B).

use std::path::Path;

use glam::DVec3;

use super::number_table::{self, Column, NumberRow};
use crate::base::range::COORDINATE;
use crate::base::{Error, Result, files};

/// One anatomical point in both breath holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LandmarkPair {
    /// Where it is at full inspiration, mm.
    pub inspiration_mm: DVec3,
    /// Where it is at full expiration, mm.
    pub expiration_mm: DVec3,
}

impl LandmarkPair {
    /// Its motion from inspiration to expiration, mm.
    pub fn motion_mm(&self) -> DVec3 {
        self.expiration_mm - self.inspiration_mm
    }
}

/// The columns that are read. In what unit a file is, is found out later, by the size of the lungs.
const COLUMNS: [Column<'static>; 6] = [
    ("insp_x", COORDINATE),
    ("insp_y", COORDINATE),
    ("insp_z", COORDINATE),
    ("exp_x", COORDINATE),
    ("exp_y", COORDINATE),
    ("exp_z", COORDINATE),
];

/// Reads all pairs of `path`. Columns are found by name, so more columns and any order are fine.
/// Errors name the file and the column or line at fault; a file without a pair is an error.
pub fn read(path: &Path) -> Result<Vec<LandmarkPair>> {
    parse(&files::read_bytes(path)?).map_err(|e| e.at(path))
}

/// [`read`] for bytes in memory.
pub fn parse(bytes: &[u8]) -> Result<Vec<LandmarkPair>> {
    if bytes.trim_ascii().is_empty() {
        return Err(Error::input("the landmark file is empty"));
    }
    let pair = |row: NumberRow<6>| {
        let [a, b, c, d, e, f] = row.numbers;
        LandmarkPair { inspiration_mm: DVec3::new(a, b, c), expiration_mm: DVec3::new(d, e, f) }
    };
    let pairs: Vec<LandmarkPair> = number_table::rows(bytes, COLUMNS)?.into_iter().map(pair).collect();
    if pairs.is_empty() {
        return Err(Error::input("the landmark file holds no landmark pair"));
    }
    Ok(pairs)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_found_by_name() {
        let pairs = parse(b"id,exp_x,exp_y,exp_z,insp_x,insp_y,insp_z\n7,1,2,3,4,5,6.5\n").unwrap();
        assert_eq!(pairs[0].inspiration_mm, DVec3::new(4.0, 5.0, 6.5));
        assert_eq!(pairs[0].motion_mm(), DVec3::new(-3.0, -3.0, -3.5));
    }

    #[test]
    fn damage_is_named() {
        let head = "insp_x,insp_y,insp_z,exp_x,exp_y,exp_z\n";
        let say = |text: String| parse(text.as_bytes()).unwrap_err().to_string();
        assert_eq!(say(String::new()), "the landmark file is empty");
        assert_eq!(say(head.into()), "the landmark file holds no landmark pair");
        assert!(say(format!("{head}1,2,3,4,5,6\n1,2,nan,4,5,6\n")).contains("line 3: insp_z: NaN"));
        assert!(say(format!("{head}1,2,3\n")).contains("line 2"));
        assert!(say("a,b\n1,2\n".into()).contains("column insp_x: is missing"));
    }
}
