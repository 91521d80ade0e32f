//! A centreline as CSV: `id,x_mm,y_mm,z_mm,radius_mm,branch,generation,parent_id`, parents before children, the inlet's
//! parent is -1 (the columns of Chaste's tables).

use std::path::Path;

use glam::DVec3;

use super::centerline::{Centerline, CenterlinePoint, MOST_LENGTH_MM};
use crate::base::range::{COORDINATE_MM, GENERATION, NumberRange, RADIUS_MM};
use crate::base::{Error, Result, files};

/// First line of the file.
const HEADER: &str = "id,x_mm,y_mm,z_mm,radius_mm,branch,generation,parent_id";

/// The text form; numbers round-trip exactly.
pub fn to_csv(centerline: &Centerline) -> String {
    let mut text = format!("{HEADER}\n");
    for (id, p) in centerline.points.iter().enumerate() {
        let parent = p.parent.map_or(-1, i64::from);
        let x = p.position_mm;
        text += &format!("{id},{},{},{},{},{},{},{parent}\n", x.x, x.y, x.z, p.radius_mm, p.branch, p.generation);
    }
    text
}

/// Reads what [`to_csv`] wrote; errors name file and line.
pub fn read(path: &Path) -> Result<Centerline> {
    parse(&files::read_text(path)?).map_err(|e| e.at(path))
}

/// [`read`] for text in memory.
pub fn parse(text: &str) -> Result<Centerline> {
    let mut lines = text.lines();
    if lines.next().map(str::trim) != Some(HEADER) {
        return Err(Error::input(format!("must be \"{HEADER}\"")).element("line 1"));
    }
    let mut points: Vec<CenterlinePoint> = Vec::new();
    for (row, line) in lines.enumerate() {
        let parsed = point(line, points.len());
        points.push(parsed.map_err(|sentence| Error::input(sentence).element(format!("line {}", row + 2)))?);
    }
    if points.len() < 2 {
        return Err(Error::input("a centreline needs at least two points"));
    }
    let parent = |p: &CenterlinePoint| p.parent.map(|parent: u32| points[parent as usize].position_mm);
    let length_mm: f64 = points.iter().filter_map(|p| Some(p.position_mm.distance(parent(p)?))).sum();
    if length_mm > MOST_LENGTH_MM {
        let sentence = format!("the centreline is {length_mm:.0} mm long in all, and {MOST_LENGTH_MM:.0} is the most");
        return Err(Error::input(sentence));
    }
    Ok(Centerline { points })
}

fn point(line: &str, id: usize) -> Result<CenterlinePoint, String> {
    let values: Vec<f64> = line
        .split(',')
        .map(|v| v.trim().parse::<f64>().ok().filter(|v| v.is_finite()).ok_or(format!("\"{v}\" is no finite number")))
        .collect::<Result<_, String>>()?;
    let [_, x, y, z, radius_mm, branch, generation, parent] = values[..] else {
        return Err(format!("has {} values instead of 8", values.len()));
    };
    let named = |what: &'static str| move |e: Error| format!("{what} {e}");
    [x, y, z].into_iter().try_for_each(|v| COORDINATE_MM.check(v)).map_err(named("coordinate"))?;
    RADIUS_MM.check(radius_mm).map_err(named("radius"))?;
    GENERATION.check(generation).map_err(named("generation"))?;
    NumberRange::new(0.0, f64::from(u32::MAX)).check(branch).map_err(named("branch"))?;
    let parent = match (id, parent) {
        (0, p) if p < 0.0 => None,
        (_, p) if p >= 0.0 && (p as usize) < id => Some(p as u32),
        _ => return Err(format!("parent {parent} is not an earlier point")),
    };
    Ok(CenterlinePoint {
        position_mm: DVec3::new(x, y, z),
        radius_mm,
        branch: branch as u32,
        generation: generation as u32,
        parent,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_round_trips_and_damage_is_named() {
        let at = |x: f64, parent| CenterlinePoint {
            position_mm: DVec3::new(x, 0.1, -1e-7),
            radius_mm: 3.3,
            branch: 0,
            generation: 0,
            parent,
        };
        let line = Centerline { points: vec![at(0.0, None), at(1.0 / 3.0, Some(0)), at(2.0, Some(0))] };
        let text = to_csv(&line);
        assert_eq!(parse(&text).unwrap(), line);
        assert!(parse(&text.replace("3.3", "-1")).unwrap_err().to_string().starts_with("line 2: radius"));
        assert!(parse(&text.replace(",0\n", ",7\n")).unwrap_err().to_string().contains("not an earlier point"));
        assert!(parse("x\n").unwrap_err().to_string().starts_with("line 1"));
    }
}
