//! Makes the images of `docs/gallery.md`: each case at three depths of its route, side by side.
//!
//! ```text
//! cargo run --release --example gallery [FOLDER]
//! ```
//! Films go to FOLDER (`target/gallery`), nine frames over the last 160 mm of each route; finished ones are reused.

use std::path::{Path, PathBuf};

use respire_bench::airway::case::Case;
use respire_bench::base::{NoProgress, Result};
use respire_bench::formats::png;
use respire_bench::simulate::preview::sheet;
use respire_bench::simulate::truth::TruthSet;
use respire_bench::simulate::{FilmLight, MeshOutput, RadianceOutput, SimulationSettings, simulate};

/// Frames shown of the nine, case by case: one in the trachea, one before a bifurcation, one at the end of the route.
const SHOWN: [[usize; 3]; 9] =
    [[1, 4, 8], [1, 3, 8], [1, 3, 8], [1, 4, 8], [1, 4, 8], [1, 3, 8], [1, 3, 8], [1, 3, 8], [1, 4, 8]];

fn main() -> Result<()> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let films = std::env::args().nth(1).map_or_else(|| root.join("target/gallery"), PathBuf::from);
    let settings = SimulationSettings {
        width_px: 180,
        height_px: 180,
        frames_per_second: 0.5,
        frames: 9,
        samples_per_pixel: 24,
        meshes: MeshOutput::EndStates,
        radiance: RadianceOutput::None,
        truth: TruthSet::default(),
        light: FilmLight::Full,
    };
    for (number, shown) in (1..).zip(SHOWN) {
        let case = Case::load(&root.join(format!("bench-cases/case{number}.toml")))?;
        let film = simulate(&case, &settings, &films.join(&case.id), &NoProgress)?;
        let shown: Vec<_> = shown.iter().map(|&frame| film.image(frame)).collect::<Result<_>>()?;
        let path = root.join(format!("docs/images/{}.png", case.id));
        png::write_rgb(&path, &sheet(&shown, shown.len()))?;
        println!("{}", path.display());
    }
    Ok(())
}
