//! The HTML of the live page: what is known before the first frame. Everything else comes with the lines.

use maud::{PreEscaped, html};
use serde::Serialize;

use crate::base::{Error, Result};
use crate::report::document::document;
use crate::report::scene::{AIRWAY_VERTICES, AirwayScene};
use crate::simulate::participant::Given;

const STYLE: &str = include_str!("../page/live.css");
const SCRIPTS: [&str; 2] = [include_str!("../page/live_film.js"), include_str!("../page/live.js")];

/// What the scripts are given.
#[derive(Serialize)]
struct LiveData<'a> {
    /// Name of the run.
    run: &'a str,
    /// Tangent of half the vertical angle of view.
    tan_half_height: f64,
    /// Pixels of a frame.
    picture_px: [u32; 2],
    /// The wall as told; `None` where the two surfaces do not have the same faces.
    airway: Option<AirwayScene>,
}

/// The page. Errors: surfaces that cannot be read.
pub(super) fn live_page(film: &dyn Given, name: &str, method: &str, run: &str) -> Result<String> {
    let camera = film.given_camera();
    let (inspiration, expiration) = (film.given_inspiration()?, film.given_expiration()?);
    let airway = AirwayScene::of(&inspiration, &expiration, None, AIRWAY_VERTICES).map(|airway| airway.scene);
    let data = LiveData {
        run,
        tan_half_height: 0.5 * f64::from(camera.height) / camera.fl_y,
        picture_px: [camera.width, camera.height],
        airway,
    };
    // Inside a script element nothing but `</script` and `<!--` has a meaning: without `<` there is neither.
    let data = serde_json::to_string(&data).map_err(|e| Error::input(format!("cannot be written: {e}")))?;
    let data = data.replace('<', "\\u003c");
    let body = html! {
        header.head {
            h1 { (name) " " small { (method) ", live" } }
            div #tools {}
        }
        noscript { p.failed { "This page needs JavaScript." } }
        main #live {}
        script #data type="application/json" { (PreEscaped(data)) }
    };
    Ok(document(&format!("{name}: {method}, live"), STYLE, &SCRIPTS, body))
}
