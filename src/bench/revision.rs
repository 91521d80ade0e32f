//! Which revision of the code makes a sequence, a prediction, a score.
//!
//! [`crate::base::revision`] has those of the rooms. A change in the report therefore keeps every cached cell, a change
//! in a method or in the splat core redoes the cells but not the sequences, and a stale cell is never shown as a fresh
//! one.

use crate::base::revision::of_rooms;
use crate::simulate;

/// Hashes of the code behind each of the three products.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Revisions {
    /// What films a sequence.
    pub sequence: String,
    /// What makes a prediction from a sequence.
    pub prediction: String,
    /// What scores a prediction.
    pub score: String,
}

impl Revisions {
    /// The revisions of this program. Each lists every room whose code the product's room may use, since that code can
    /// change its results.
    pub fn of_this_program() -> Self {
        Revisions {
            sequence: simulate::revision(),
            prediction: of_rooms(&[
                "outside",
                "tracer",
                "kernels",
                "base",
                "formats",
                "simulate",
                "splat",
                "reconstruct",
            ]),
            score: of_rooms(&["outside", "tracer", "kernels", "base", "formats", "simulate", "score"]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rooms_have_revisions_of_their_own() {
        let of = Revisions::of_this_program();
        assert!(of.sequence != of.prediction && of.prediction != of.score && of.score != of.sequence);
    }
}
