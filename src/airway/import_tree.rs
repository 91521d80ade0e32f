//! Measures a bronchial tree: from a table of centreline points, or from a surface by way of its centreline.

use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec3;

use super::centerline::{Centerline, CenterlinePoint};
use super::import_mesh::FileMeaning;
use super::tree::Tree;
use crate::base::range::{COORDINATE_MM, GENERATION, NumberRange, RADIUS_MM};
use crate::base::{Error, Progress, Result, files};
use crate::formats::number_table;

/// Columns of a centreline table.
const COLUMNS: [&str; 8] = ["id", "x_mm", "y_mm", "z_mm", "radius_mm", "branch", "generation", "parent_id"];
/// Any number: what each column may hold is said by its row's id.
const ANY: NumberRange = NumberRange::new(f64::MIN, f64::MAX);

/// Distance between the points of a measured table in mm.
const STEP_MM: f64 = 1.5;

/// Reads a table with the columns `id,x_mm,y_mm,z_mm,radius_mm,branch,generation,parent_id` (rows in any order, the
/// inlet's parent is -1) and makes a tree of it. Errors name file and line.
pub fn from_table(path: &Path, meaning: &FileMeaning, source: &str) -> Result<Tree> {
    let read = || {
        let centerline = parse_table(&files::read_text(path)?, meaning)?;
        meaning.check_centerline(&centerline)?;
        from_centerline(&centerline, source)
    };
    read().map_err(|e| e.at(path))
}

/// Extracts the centreline of the closed airway surface in `path` and makes a tree of it.
pub fn from_mesh(path: &Path, meaning: &FileMeaning, source: &str, progress: &dyn Progress) -> Result<Tree> {
    let mesh = meaning.read_surface(path)?;
    meaning.centerline(&mesh, progress).and_then(|line| from_centerline(&line, source)).map_err(|e| e.at(path))
}

/// The table of `centerline`, resampled to 1.5 mm.
pub fn from_centerline(centerline: &Centerline, source: &str) -> Result<Tree> {
    let whole = Tree::from_centerline(centerline, source);
    // Before the tables are made, whose length is that of the branches.
    whole.validate()?;
    let tree = whole.resampled(STEP_MM);
    tree.validate()?;
    Ok(tree)
}

fn parse_table(text: &str, meaning: &FileMeaning) -> Result<Centerline> {
    let mut rows: Vec<[f64; 8]> =
        number_table::rows(text.as_bytes(), COLUMNS.map(|name| (name, ANY)))?.iter().map(|row| row.numbers).collect();
    rows.sort_by(|a, b| a[0].total_cmp(&b[0]));
    if let Some(twice) = rows.windows(2).find(|two| two[0][0] == two[1][0]) {
        return Err(Error::input("is there twice").element(format!("id {}", twice[0][0])));
    }
    // The last point of each branch so far.
    let mut ends: BTreeMap<u32, usize> = BTreeMap::new();
    let mut points = Vec::with_capacity(rows.len());
    for (index, &[id, x, y, z, radius_mm, branch, generation, parent]) in rows.iter().enumerate() {
        let wrong = |what: &str| Err(Error::input(what).element(format!("id {id}")));
        let parent = match rows[..index].binary_search_by(|row| row[0].total_cmp(&parent)) {
            Ok(found) => Some(found as u32),
            Err(_) if index == 0 => None,
            Err(_) => return wrong("its parent is not an earlier point"),
        };
        let named = |key: &'static str| move |e: Error| e.element(format!("id {id}, {key}"));
        if branch < 0.0 || branch.fract() != 0.0 || branch > f64::from(u32::MAX) {
            return wrong("branch must be a whole number of at most 32 bits");
        }
        GENERATION.check(generation).map_err(named("generation"))?;
        let (radius_mm, position_mm) = (radius_mm * meaning.scale, meaning.to_lps_mm(DVec3::new(x, y, z)));
        RADIUS_MM.check(radius_mm).map_err(named("radius_mm"))?;
        position_mm.to_array().into_iter().try_for_each(|v| COORDINATE_MM.check(v)).map_err(named("coordinates"))?;
        let (branch, generation) = (branch as u32, generation as u32);
        let point = CenterlinePoint { position_mm, radius_mm, branch, generation, parent };
        let before: Option<&CenterlinePoint> = parent.map(|parent| &points[parent as usize]);
        match (ends.insert(branch, index), before) {
            (Some(end), _) if parent != Some(end as u32) => {
                return wrong("its parent is not the point of its branch before it");
            }
            (Some(_), Some(before)) if before.generation != generation => {
                return wrong("its generation is not that of its branch");
            }
            // The same where branches part close together: in films' own tables they are siblings.
            (None, Some(before)) if before.generation > generation => {
                return wrong(
                    "its branch begins here, and its generation is below that of the branch from which it comes",
                );
            }
            _ => {}
        }
        points.push(point);
    }
    Ok(Centerline { points })
}

#[cfg(test)]
mod tests {
    use super::super::import_axes::PatientAxes;
    use super::super::import_check::ExpectedAnatomy;
    use super::super::import_mesh::PartChoice;
    use super::*;

    fn read_as(axes: PatientAxes) -> FileMeaning {
        FileMeaning { axes, scale: 1.0, parts: PartChoice::Single, anatomy: ExpectedAnatomy::Human }
    }

    const TABLE: &str = "id,x_mm,y_mm,z_mm,radius_mm,branch,generation,parent_id\n\
                         0,0,0,0,5,0,0,-1\n2,0,1,-20,4,1,1,1\n1,0,0,-10,5,0,0,0\n3,0,2,-30,4,1,1,2\n";

    #[test]
    fn rows_in_any_order_make_a_tree_in_lps() {
        let centerline = parse_table(TABLE, &read_as(PatientAxes::RAS)).unwrap();
        assert_eq!(centerline.points[2].parent, Some(1));
        assert_eq!(centerline.points[3].position_mm, DVec3::new(0.0, -2.0, -30.0));
        let tree = from_centerline(&centerline, "test").unwrap();
        assert_eq!(tree.branches.len(), 2);
        assert!((tree.branches[0].length_mm() - 10.0).abs() < 0.02);
    }

    #[test]
    fn damage_is_named() {
        let orphan = TABLE.replace("2,0,1,-20,4,1,1,1", "2,0,1,-20,4,1,1,7");
        assert!(parse_table(&orphan, &read_as(PatientAxes::LPS)).unwrap_err().to_string().contains("id 2"));
        let short = TABLE.replace("2,0,1,-20,4,1,1,1", "2,0,1,x");
        assert!(parse_table(&short, &read_as(PatientAxes::LPS)).unwrap_err().to_string().contains("line 3"));
        assert!(parse_table("", &read_as(PatientAxes::LPS)).is_err());
        for (from, to, says) in [
            ("3,0,2,-30,4,1,1,2", "2,0,2,-30,4,1,1,1", "id 2: is there twice"),
            ("3,0,2,-30,4,1,1,2", "3,0,2,-30,4,1,1,1", "id 3: its parent is not the point of its branch before it"),
            ("3,0,2,-30,4,1,1,2", "3,0,2,-30,4,0,1,2", "id 3: its parent is not the point of its branch"),
            ("3,0,2,-30,4,1,1,2", "3,0,2,-30,4,1,2,2", "id 3: its generation is not that of its branch"),
        ] {
            let said = parse_table(&TABLE.replace(from, to), &read_as(PatientAxes::LPS)).unwrap_err().to_string();
            assert!(said.contains(says), "{to}: {said}");
        }
        let trunk = |generation: &str| TABLE.replace(",5,0,0,", &format!(",5,0,{generation},"));
        let said = parse_table(&trunk("2"), &read_as(PatientAxes::LPS)).unwrap_err().to_string();
        assert!(said.contains("id 2: its branch begins here"), "{said}");
        assert_eq!(parse_table(&trunk("1"), &read_as(PatientAxes::LPS)).unwrap().points.len(), 4, "siblings");
        // As a spreadsheet writes it, with columns of its own.
        let other = "\u{feff}note,parent_id,generation,branch,radius_mm,z_mm,y_mm,x_mm,id\r\n7,-1,0,0,5,0,0,0,0\r\n";
        assert_eq!(parse_table(other, &read_as(PatientAxes::LPS)).unwrap().points.len(), 1);
    }

    /// Sizes that a table's numbers would lead to, not its length.
    #[test]
    fn numbers_are_names_or_are_bounded() {
        let import = |from: &str, to: &str| {
            let text = TABLE.replace(from, to);
            parse_table(&text, &read_as(PatientAxes::LPS))
                .and_then(|line| from_centerline(&line, "test"))
                .map_err(|e| e.to_string())
        };
        let named = import(",4,1,1,", ",4,4294967294,1,").unwrap();
        assert_eq!(named.branches.len(), 2, "a branch's number is its name");
        for (from, to, says) in [
            ("0,1,-20,4", "0,1000000000,-20,4", "id 2, coordinates: 1e9 must lie in -10000 to 10000"),
            ("0,1,-20,4", "0,1,-20,1e-300", "id 2, radius_mm: 1e-300"),
            (",1,1,1\n", ",1,4294967295,1\n", "id 2, generation: 4.294967295e9 must lie in 0 to 64"),
            (",4,1,1,", ",4,1.5,1,", "id 2: branch must be a whole number"),
            (",4,1,1,", ",4,1e300,1,", "id 2: branch must be a whole number"),
        ] {
            assert!(import(from, to).unwrap_err().contains(says), "{:?}", import(from, to));
        }
        // Every number in range, and a thread of 4000 km to and fro.
        let far: String = (0..200_000)
            .map(|k| format!("{k},{},0,0,5,0,0,{}\n", if k % 2 == 0 { 1e4 } else { -1e4 }, k - 1))
            .collect();
        let line = parse_table(&format!("{}\n{far}", COLUMNS.join(",")), &read_as(PatientAxes::LPS)).unwrap();
        assert!(from_centerline(&line, "test").unwrap_err().to_string().contains("1000000 is the most"));
    }
}
