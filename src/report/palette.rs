//! One colour and one dash per row, in every plot and on the page.
//!
//! No two of the colours are alike: they are at least .08 apart in OKLab (Ottosson 2020), and .05 as somebody with
//! deuteranopia sees them (Viénot, Brettel and Mollon 1999); own rows of the same dash .07. On white paper each has a
//! contrast of 3:1 (WCAG 2.2, 1.4.11), and it stands out from a dark page. Lines are drawn without transparency.
//! Found by taking again and again the colour farthest from those taken, after Okabe and Ito's. Those of own rows stand
//! in their table ([`crate::base::own_row`]); here are those of third parties.

use std::collections::BTreeMap;

use super::run::MethodInfo;
use crate::base::own_row::{self, Dash};

/// How the lines of a row look.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RowStyle {
    /// Red, green, blue, 8-bit sRGB.
    pub color: [u8; 3],
    /// Lengths of dash and gap in units of a plot; `None`: an unbroken line.
    pub dash: Option<[u8; 2]>,
}

impl RowStyle {
    /// As CSS and SVG write the colour.
    pub fn hex(self) -> String {
        let [red, green, blue] = self.color;
        format!("#{red:02x}{green:02x}{blue:02x}")
    }
}

/// Lengths of dash and gap.
fn lengths(dash: Dash) -> Option<[u8; 2]> {
    match dash {
        Dash::Unbroken => None,
        Dash::Long => Some([9, 4]),
        Dash::Short => Some([4, 3]),
        Dash::Dots => Some([2, 2]),
    }
}

/// Rows of third parties, in the order in which they come; beyond them the colours come again with the next dash.
const FOREIGN: [[u8; 3]; 12] = [
    [198, 0, 168],
    [0, 84, 90],
    [240, 84, 120],
    [180, 120, 246],
    [72, 96, 48],
    [0, 36, 222],
    [252, 66, 222],
    [144, 96, 120],
    [210, 18, 90],
    [84, 72, 192],
    [108, 60, 66],
    [132, 114, 204],
];
const FOREIGN_DASHES: [Dash; 4] = [Dash::Unbroken, Dash::Long, Dash::Short, Dash::Dots];

/// The styles of the rows of one report.
#[derive(Clone, Debug, Default)]
pub struct Palette(BTreeMap<String, RowStyle>);

impl Palette {
    /// For these rows; those of third parties get theirs in this order.
    pub fn of<'a>(methods: impl IntoIterator<Item = &'a MethodInfo>) -> Self {
        let mut styles = BTreeMap::new();
        let mut foreign = 0;
        for method in methods {
            let style = match own_row::own(&method.id) {
                Some(row) => RowStyle { color: row.color, dash: lengths(row.dash) },
                None => {
                    let dash = FOREIGN_DASHES[foreign / FOREIGN.len() % FOREIGN_DASHES.len()];
                    foreign += 1;
                    RowStyle { color: FOREIGN[(foreign - 1) % FOREIGN.len()], dash: lengths(dash) }
                }
            };
            styles.insert(method.id.clone(), style);
        }
        Palette(styles)
    }

    /// The style of a row; that of no row is grey.
    pub fn style(&self, method: &str) -> RowStyle {
        self.0.get(method).copied().unwrap_or(RowStyle { color: [130; 3], dash: None })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::own_row::OWN;

    fn linear(code: u8) -> f64 {
        let value = f64::from(code) / 255.0;
        if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
    }

    /// OKLab of linear RGB.
    fn oklab([r, g, b]: [f64; 3]) -> [f64; 3] {
        let l = (0.4122214708 * r + 0.5363325363 * g + 0.0514459929 * b).cbrt();
        let m = (0.2119034982 * r + 0.6806995451 * g + 0.1073969566 * b).cbrt();
        let s = (0.0883024619 * r + 0.2817188376 * g + 0.6299787005 * b).cbrt();
        [
            0.2104542553 * l + 0.793617785 * m - 0.0040720468 * s,
            1.9779984951 * l - 2.428592205 * m + 0.4505937099 * s,
            0.0259040371 * l + 0.7827717662 * m - 0.808675766 * s,
        ]
    }

    /// Linear RGB as somebody with deuteranopia sees it.
    fn deuteranopia([r, g, b]: [f64; 3]) -> [f64; 3] {
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]]
            .map(|[x, y, z]| (x * r + y * g + z * b).clamp(0.0, 1.0))
    }

    fn apart(a: [u8; 3], b: [u8; 3], seen: fn([f64; 3]) -> [f64; 3]) -> f64 {
        let [a, b] = [a, b].map(|c| oklab(seen(c.map(linear))));
        (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
    }

    fn luminance(color: [u8; 3]) -> f64 {
        let [r, g, b] = color.map(linear);
        0.2126 * r + 0.7152 * g + 0.0722 * b
    }

    #[test]
    fn no_two_colours_are_alike_and_all_stand_out_on_paper_and_in_the_dark() {
        let all: Vec<[u8; 3]> = OWN.iter().map(|row| row.color).chain(FOREIGN).collect();
        for (i, &a) in all.iter().enumerate() {
            for &b in &all[..i] {
                assert!(apart(a, b, |c| c) > 0.08, "{a:?} {b:?} {}", apart(a, b, |c| c));
                assert!(apart(a, b, deuteranopia) > 0.05, "{a:?} {b:?} {}", apart(a, b, deuteranopia));
            }
            let own = luminance(a) + 0.05;
            assert!(1.05 / own >= 3.0 && own / (luminance([18, 21, 27]) + 0.05) > 2.0, "{a:?}");
        }
    }

    #[test]
    fn own_rows_of_one_dash_are_told_apart_with_deuteranopia() {
        for (i, a) in OWN.iter().enumerate() {
            for b in OWN[..i].iter().filter(|b| b.dash == a.dash) {
                let off = apart(a.color, b.color, deuteranopia);
                assert!(off > 0.07, "{} {} {off}", a.id, b.id);
            }
        }
    }

    #[test]
    fn own_rows_and_many_foreign_ones_have_different_styles() {
        let names: Vec<String> = (0..40).map(|k| format!("method {k}")).collect();
        let own = OWN.iter().map(|row| MethodInfo::of(row.id));
        let methods: Vec<MethodInfo> = own.chain(names.iter().map(|name| MethodInfo::of(name))).collect();
        let palette = Palette::of(&methods);
        let styles: Vec<RowStyle> = methods.iter().map(|m| palette.style(&m.id)).collect();
        for (i, style) in styles.iter().enumerate() {
            assert!(!styles[..i].contains(style), "{} has the style of another", methods[i].id);
        }
        assert_eq!(palette.style("ours").hex(), "#0072b2");
    }
}
