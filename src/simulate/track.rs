//! Tracks: what stands between the truth and what a method is told. Numbers of two tracks are never put into one table.

use crate::base::{Error, Result};

/// A track. Every film is of one, and so is every run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Track {
    /// The paper's assumptions: true poses and intrinsics, true meshes at both ends, breathing linear in one phase.
    #[default]
    Ideal,
}

impl Track {
    /// The word in tables and on the command line.
    pub fn word(self) -> &'static str {
        match self {
            Track::Ideal => "ideal",
        }
    }

    /// The track of a word. Tables from before there were tracks say nothing: they are of the ideal one.
    pub fn of_word(word: &str) -> Result<Self> {
        match word {
            "" | "ideal" => Ok(Track::Ideal),
            other => Err(Error::input(format!("this version knows no track `{other}`"))),
        }
    }

    /// The tracks that `--track` asks for: `ideal`, `clinical` or `both`.
    pub fn wanted(word: &str) -> Result<Vec<Self>> {
        match word {
            "ideal" => Ok(vec![Track::Ideal]),
            "clinical" | "both" => Err(Error::usage(format!(
                "--track {word}: there are no films of the clinical track yet; --track ideal is what can be run"
            ))),
            other => Err(Error::usage(format!("--track {other}: a track is `ideal` or `clinical`, or `both`"))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_filmed_is_taken() {
        assert_eq!(Track::wanted("ideal").unwrap(), [Track::Ideal]);
        for (word, says) in [("clinical", "no films of the clinical track"), ("both", "--track both"), ("x", "`ideal`")]
        {
            let refused = Track::wanted(word).unwrap_err();
            assert!(refused.kind().exit_code() == 2 && refused.to_string().contains(says), "{refused}");
        }
        assert_eq!((Track::of_word("").unwrap(), Track::of_word("ideal").unwrap()), (Track::Ideal, Track::Ideal));
        assert!(Track::of_word("clinical").unwrap_err().to_string().contains("`clinical`"));
    }
}
