//! Statistics of pictures against the script that measured the real ones (`shared/reference/realism`).

use std::path::Path;
use std::process::Command;

use respire_bench::experiments::picture_statistics::{PictureStatistics, STATISTICS};
use respire_bench::formats::png;

use crate::reference::Reference;
use crate::sequence_folder::python;

#[test]
fn statistics_are_those_of_the_script_that_measured_real_pictures() {
    let Some(script) = Reference::open("reference/realism") else { return };
    let Some(python) = python() else { return };
    let images = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/images");
    let pictures: Vec<_> = (1..=9).map(|case| images.join(format!("case{case}.png"))).collect();
    let output = Command::new(python).arg(script.path("statistics.py")).args(&pictures).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    let mut lines = text.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let names = lines.next().expect("the script prints a head");
    let mut compared = 0;
    for (picture, row) in pictures.iter().zip(lines) {
        let ours = PictureStatistics::of(&png::read_rgb(picture).unwrap(), false);
        for (name, told) in names.iter().zip(row).skip(2) {
            let told: f64 = told.split_whitespace().next().unwrap().parse().unwrap();
            let found = ours.values[STATISTICS.iter().position(|s| s.0 == *name).unwrap()];
            // Three digits are printed; the two Lanczos filters round differently, which noise and thresholds notice.
            let room = match *name {
                "glare_spots" => 1.0,
                name if name.ends_with("_pct") => 0.1,
                _ => 0.012 * told.abs(),
            };
            assert!((found - told).abs() <= room, "{} {name}: {found} for {told}", picture.display());
            compared += 1;
        }
    }
    assert_eq!(compared, 9 * 15);
}
