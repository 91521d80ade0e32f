//! The frame of every page: one file that asks the network for nothing, with the looks and the scripts that all share.

use maud::{DOCTYPE, Markup, PreEscaped, html};

const STYLE: &str = include_str!("page/page.css");
/// In this order: the later ones use the earlier ones.
const SHARED: [&str; 3] = [include_str!("page/base.js"), include_str!("page/solids.js"), include_str!("page/scene.js")];

/// A page with `body`, its own rules of style after those of all, and its own scripts after theirs.
pub(super) fn document(title: &str, style: &str, scripts: &[&str], body: Markup) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                link rel="icon" href="data:,";
                title { (title) }
                style { (PreEscaped(STYLE)) (PreEscaped(style)) }
            }
            body {
                (body)
                @for script in SHARED.iter().chain(scripts) { script { (PreEscaped(*script)) } }
            }
        }
    }
    .into_string()
}
