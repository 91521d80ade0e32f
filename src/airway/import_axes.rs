//! Which way the axes of an imported file point.

use std::fmt;
use std::str::FromStr;

use glam::DVec3;

/// A direction of the body, by the letter that medical formats use for it: the axis of LPS that it lies on, and whether
/// it points along it.
const DIRECTIONS: [(char, usize, bool); 6] =
    [('l', 0, true), ('r', 0, false), ('p', 1, true), ('a', 1, false), ('s', 2, true), ('i', 2, false)];

/// Where x, y and z of a file point: three letters of l/r (left, right), p/a (posterior, anterior), s/i (superior,
/// inferior), one of each pair. Everything inside this program is LPS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PatientAxes([(usize, bool); 3]);

impl PatientAxes {
    /// x left, y posterior, z superior.
    pub const LPS: PatientAxes = PatientAxes([(0, true), (1, true), (2, true)]);
    /// x right, y anterior, z superior.
    pub const RAS: PatientAxes = PatientAxes([(0, false), (1, false), (2, true)]);

    /// The point in LPS.
    pub fn to_lps(self, point: DVec3) -> DVec3 {
        let mut lps = DVec3::ZERO;
        for (axis, (along, forward)) in self.0.into_iter().enumerate() {
            lps[along] = if forward { point[axis] } else { -point[axis] };
        }
        lps
    }

    /// Whether the map to LPS turns a right hand into a left one, and so a surface inside out.
    pub fn is_mirrored(self) -> bool {
        let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| self.to_lps(axis));
        x.cross(y).dot(z) < 0.0
    }

    /// The axes of a file that was read with `self`, when what came out as LPS turns out to have the axes `found`.
    pub fn corrected(self, found: PatientAxes) -> PatientAxes {
        PatientAxes(self.0.map(|(along, forward)| {
            let (true_axis, is_kept) = found.0[along];
            (true_axis, is_kept == forward)
        }))
    }

    /// Axes of a file in which the three given directions (axis, and whether along it) are left, posterior, superior.
    /// `None` where an axis is named twice.
    pub fn from_directions(lps: [(usize, bool); 3]) -> Option<PatientAxes> {
        let mut axes = [None; 3];
        for (direction, (axis, forward)) in lps.into_iter().enumerate() {
            axes[axis] = Some((direction, forward));
        }
        let [x, y, z] = axes;
        Some(PatientAxes([x?, y?, z?]))
    }
}

impl FromStr for PatientAxes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!(
                "`{text}` does not say where x, y and z point: three letters, one each of l/r (left, right), p/a (posterior, \
                 anterior), s/i (superior, inferior), such as lps or ras"
            )
        };
        let letters: Vec<char> = text.to_ascii_lowercase().chars().collect();
        let direction = |letter: &char| DIRECTIONS.iter().find(|d| d.0 == *letter).map(|d| (d.1, d.2));
        let axes: Vec<(usize, bool)> = letters.iter().map(direction).collect::<Option<_>>().ok_or_else(wrong)?;
        let axes: [(usize, bool); 3] = axes.try_into().map_err(|_| wrong())?;
        if (0..3).all(|wanted| axes.iter().any(|(along, _)| *along == wanted)) {
            Ok(PatientAxes(axes))
        } else {
            Err(wrong())
        }
    }
}

impl fmt::Display for PatientAxes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for wanted in self.0 {
            let letter = DIRECTIONS.iter().find(|d| (d.1, d.2) == wanted).map_or('?', |d| d.0);
            write!(f, "{letter}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_say_where_the_axes_point() {
        let axes = |text: &str| text.parse::<PatientAxes>();
        assert_eq!(axes("LPS").unwrap(), PatientAxes::LPS);
        assert_eq!(axes("ras").unwrap().to_lps(DVec3::new(1.0, 2.0, 3.0)), DVec3::new(-1.0, -2.0, 3.0));
        // y up: x to the left, z to the front.
        let up = axes("lsa").unwrap();
        assert_eq!(up.to_lps(DVec3::new(1.0, 2.0, 3.0)), DVec3::new(1.0, -3.0, 2.0));
        assert!(!up.is_mirrored() && !PatientAxes::RAS.is_mirrored() && axes("rps").unwrap().is_mirrored());
        assert_eq!(up.to_string(), "lsa");
        for wrong in ["", "lp", "lpsx", "lrs", "xyz", "lps "] {
            assert!(axes(wrong).unwrap_err().contains("lps or ras"), "{wrong}");
        }
    }

    /// For every pair of true and assumed axes, what is found in the wrongly read file leads back to the true ones.
    #[test]
    fn a_wrong_reading_is_corrected() {
        let all: Vec<PatientAxes> =
            ["lps", "ras", "las", "lsa", "spl", "ail", "irp"].map(|t| t.parse().unwrap()).to_vec();
        for truth in &all {
            for assumed in &all {
                // In the assumed LPS, left (posterior, superior) lies along this axis.
                let found = [DVec3::X, DVec3::Y, DVec3::Z].map(|direction| {
                    let in_file = (0..3).map(|k| {
                        let mut axis = DVec3::ZERO;
                        axis[k] = 1.0;
                        axis * truth.to_lps(axis).dot(direction)
                    });
                    let read = assumed.to_lps(in_file.sum());
                    let axis = (0..3).find(|&k| read[k].abs() > 0.5).unwrap();
                    (axis, read[axis] > 0.0)
                });
                let found = PatientAxes::from_directions(found).unwrap();
                assert_eq!(assumed.corrected(found), *truth, "{truth} read as {assumed}: {found}");
            }
        }
    }
}
