//! Tracks: what stands between the truth and what a method is told. Numbers of two tracks are never put into one table.

use serde::{Deserialize, Serialize};

use crate::airway::case::Case;
use crate::base::{Error, Result};

/// A track. Every film is of one, and so is every run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Track {
    /// The paper's assumptions: true poses and intrinsics, true meshes at both ends, breathing linear in one phase.
    #[default]
    Ideal,
    /// What a hospital has (`docs/clinical.md`): nothing of that is true.
    Clinical,
}

impl Track {
    /// The word in tables and on the command line.
    pub fn word(self) -> &'static str {
        match self {
            Track::Ideal => "ideal",
            Track::Clinical => "clinical",
        }
    }

    /// The track of a word. Tables from before there were tracks say nothing: they are of the ideal one.
    pub fn of_word(word: &str) -> Result<Self> {
        match word {
            "" | "ideal" => Ok(Track::Ideal),
            "clinical" => Ok(Track::Clinical),
            other => Err(Error::input(format!("this version knows no track `{other}`"))),
        }
    }

    /// The track of the films of `case`.
    pub fn of_case(case: &Case) -> Self {
        if case.clinical.is_some() { Track::Clinical } else { Track::Ideal }
    }

    /// `case` as this track films it.
    pub fn filming(self, case: Case) -> Case {
        match self {
            Track::Ideal => Case { clinical: None, ..case },
            Track::Clinical => case.on_clinical_track(),
        }
    }

    /// The name of a run of `profile`: that of the profile on the ideal track.
    pub fn run_name(self, profile: &str) -> String {
        match self {
            Track::Ideal => profile.to_owned(),
            Track::Clinical => format!("{profile}-{}", self.word()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_those_of_the_tracks() {
        for track in [Track::Ideal, Track::Clinical] {
            assert_eq!(Track::of_word(track.word()).unwrap(), track);
            assert_eq!(serde_json::to_value(track).unwrap(), track.word());
        }
        assert_eq!(Track::of_word("").unwrap(), Track::Ideal);
        assert!(Track::of_word("lunar").unwrap_err().to_string().contains("`lunar`"));
        assert_eq!(
            (Track::Ideal.run_name("quick"), Track::Clinical.run_name("quick")),
            ("quick".into(), "quick-clinical".into())
        );
    }
}
