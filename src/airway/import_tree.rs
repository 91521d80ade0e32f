//! Measures a bronchial tree: from a table of centreline points, or from a surface by way of its centreline.

use std::path::Path;

use glam::DVec3;

use super::centerline::{Centerline, CenterlinePoint};
use super::import_mesh::FileMeaning;
use super::tree::Tree;
use crate::base::{Error, Result, files};

/// Columns of a centreline table.
const COLUMNS: [&str; 8] = ["id", "x_mm", "y_mm", "z_mm", "radius_mm", "branch", "generation", "parent_id"];

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
pub fn from_mesh(path: &Path, meaning: &FileMeaning, source: &str) -> Result<Tree> {
    let mesh = meaning.read_surface(path)?;
    meaning.centerline(&mesh).and_then(|line| from_centerline(&line, source)).map_err(|e| e.at(path))
}

/// The table of `centerline`, resampled to 1.5 mm.
pub fn from_centerline(centerline: &Centerline, source: &str) -> Result<Tree> {
    let tree = Tree::from_centerline(centerline, source).resampled(STEP_MM);
    tree.validate()?;
    Ok(tree)
}

fn parse_table(text: &str, meaning: &FileMeaning) -> Result<Centerline> {
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap_or("").split(',').map(str::trim).collect();
    if header != COLUMNS {
        return Err(Error::input(format!("must be \"{}\"", COLUMNS.join(","))).element("line 1"));
    }
    let mut rows: Vec<[f64; 8]> = Vec::new();
    for (number, line) in lines.enumerate().filter(|(_, l)| !l.trim().is_empty()) {
        let wrong = || Error::input("needs 8 finite numbers").element(format!("line {}", number + 2));
        let values: Vec<f64> = line.split(',').map_while(|v| v.trim().parse().ok()).collect();
        let row: [f64; 8] = values.try_into().map_err(|_| wrong())?;
        if row.iter().any(|v| !v.is_finite()) {
            return Err(wrong());
        }
        rows.push(row);
    }
    rows.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut points = Vec::with_capacity(rows.len());
    for (index, &[id, x, y, z, radius_mm, branch, generation, parent]) in rows.iter().enumerate() {
        let wrong = |what: &str| Err(Error::input(what).element(format!("id {id}")));
        let parent = match rows[..index].binary_search_by(|row| row[0].total_cmp(&parent)) {
            Ok(found) => Some(found as u32),
            Err(_) if index == 0 => None,
            Err(_) => return wrong("its parent is not an earlier point"),
        };
        if branch < 0.0 || generation < 0.0 {
            return wrong("branch and generation cannot be negative");
        }
        let position_mm = meaning.to_lps_mm(DVec3::new(x, y, z));
        points.push(CenterlinePoint {
            position_mm,
            radius_mm: radius_mm * meaning.scale,
            branch: branch as u32,
            generation: generation as u32,
            parent,
        });
    }
    Ok(Centerline { points })
}

#[cfg(test)]
mod tests {
    use super::super::import_axes::PatientAxes;
    use super::super::import_mesh::{ExpectedAnatomy, PartChoice};
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
    }
}
