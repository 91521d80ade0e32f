//! Which revision of the code makes a sequence, a prediction, a score.
//!
//! `build.rs` hashes the sources of every room (comments and tests left out), the own C++ and the locked versions of
//! the dependencies. A change in the report therefore keeps every cached cell, a change in a method redoes the
//! cells but not the sequences, and a stale cell is never shown as a fresh one.

use crate::base::hash;

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

/// Makes `room_revision(name)` from the hashes that `build.rs` hands over.
macro_rules! rooms {
    ($($room:literal => $variable:literal,)+) => {
        fn room_revision(room: &str) -> &'static str {
            match room {
                $($room => env!($variable),)+
                _ => unreachable!("build.rs hashes every room that is asked for"),
            }
        }
    };
}

rooms! {
    "base" => "RESPIRE_BENCH_REVISION_BASE",
    "ffi" => "RESPIRE_BENCH_REVISION_FFI",
    "formats" => "RESPIRE_BENCH_REVISION_FORMATS",
    "airway" => "RESPIRE_BENCH_REVISION_AIRWAY",
    "render" => "RESPIRE_BENCH_REVISION_RENDER",
    "simulate" => "RESPIRE_BENCH_REVISION_SIMULATE",
    "splat" => "RESPIRE_BENCH_REVISION_SPLAT",
    "reconstruct" => "RESPIRE_BENCH_REVISION_RECONSTRUCT",
    "score" => "RESPIRE_BENCH_REVISION_SCORE",
    "outside" => "RESPIRE_BENCH_REVISION_OUTSIDE",
}

fn combined(rooms: &[&str]) -> String {
    let parts: Vec<&str> = rooms.iter().map(|room| room_revision(room)).collect();
    hash::of_bytes(parts.join(" ").as_bytes())
}

impl Revisions {
    /// Those of this program. A room's list is the arrows of the house: what a room may use can change its results.
    pub fn of_this_program() -> Self {
        Revisions {
            sequence: combined(&["outside", "base", "ffi", "formats", "airway", "render", "simulate"]),
            prediction: combined(&["outside", "base", "ffi", "formats", "simulate", "splat", "reconstruct"]),
            score: combined(&["outside", "base", "ffi", "formats", "simulate", "score"]),
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
