//! The plan: which cells there are, and the key of each: a hash of everything that it depends on.

use std::path::Path;

use serde::Serialize;

use super::revision::Revisions;
use crate::base::{Error, Result, files, hash};

/// A case or a method of a plan: its id and the hash of everything the user can change about it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Planned {
    /// Id in tables and folders.
    pub id: String,
    /// Content hash: the TOML, and the profile's settings as far as they matter to it.
    pub content: String,
    /// Whether what is made of it depends on the seed. No film does, and few methods do ([`Reconstruct::draws`]).
    ///
    /// [`Reconstruct::draws`]: crate::reconstruct::Reconstruct::draws
    #[serde(skip)]
    pub draws: bool,
}

/// One case x one method x one seed: the unit that is run, cached and resumed.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Cell {
    /// Id of the case.
    pub case_id: String,
    /// Id of the method.
    pub method: String,
    /// Seed of the method's randomness.
    pub seed: u64,
}

impl Cell {
    /// `<case>-<method>-s<seed>`.
    pub fn id(&self) -> String {
        format!("{}-{}-s{}", self.case_id, self.method, self.seed)
    }
}

/// Everything a run will do, case by case.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Name of the profile, and of the track where it is not the ideal one.
    pub profile: String,
    /// Cases in order.
    pub cases: Vec<Planned>,
    /// Methods in order.
    pub methods: Vec<Planned>,
    /// Seeds in order.
    pub seeds: Vec<u64>,
    /// Revisions of the code that will do it.
    pub revisions: Revisions,
}

impl Plan {
    /// `<profile>-<8 digits>`: the same for the same work, whatever the code's revision.
    pub fn run_id(&self) -> Result<String> {
        let content = hash::of_value(&(&self.profile, &self.cases, &self.methods, &self.seeds))?;
        Ok(format!("{}-{}", self.profile, &content[..8]))
    }

    /// All cells, in the order in which they are run: case, then method, then seed.
    pub fn cells(&self) -> Vec<Cell> {
        self.cases.iter().flat_map(|case| self.cells_of(&case.id)).collect()
    }

    /// The cells of one case: of a method that draws nothing, the first seed is all there is.
    pub fn cells_of(&self, case_id: &str) -> Vec<Cell> {
        let of_method = |m: &Planned| if m.draws { self.seeds.len() } else { 1 };
        let pairs = self.methods.iter().flat_map(|m| self.seeds.iter().take(of_method(m)).map(move |&seed| (m, seed)));
        pairs.map(|(m, seed)| Cell { case_id: case_id.to_owned(), method: m.id.clone(), seed }).collect()
    }

    /// Key of the sequence of `case`.
    pub fn sequence_key(&self, case: &Planned) -> Result<String> {
        hash::of_value(&("sequence", &case.id, &case.content, &self.revisions.sequence))
    }

    /// Key of the prediction of `cell`.
    pub fn prediction_key(&self, cell: &Cell) -> Result<String> {
        let case = find(&self.cases, &cell.case_id, "case")?;
        let method = find(&self.methods, &cell.method, "method")?;
        let sequence = self.sequence_key(case)?;
        hash::of_value(&("prediction", sequence, &method.id, &method.content, cell.seed, &self.revisions.prediction))
    }

    /// What the film of `case` costs depends on this: all that its key does but the code's revision.
    pub fn sequence_cost_key(&self, case: &Planned) -> Result<String> {
        hash::of_value(&("cost", &case.id, &case.content))
    }

    /// What `cell` costs depends on this: all that its key does but the code's revision and the seed.
    pub fn cell_cost_key(&self, cell: &Cell) -> Result<String> {
        let sequence = self.sequence_cost_key(find(&self.cases, &cell.case_id, "case")?)?;
        let method = find(&self.methods, &cell.method, "method")?;
        hash::of_value(&("cost", sequence, &method.id, &method.content))
    }

    /// Key of the score of `cell`.
    pub fn score_key(&self, cell: &Cell) -> Result<String> {
        hash::of_value(&("score", self.prediction_key(cell)?, &self.revisions.score))
    }
}

fn find<'a>(among: &'a [Planned], id: &str, what: &str) -> Result<&'a Planned> {
    among.iter().find(|p| p.id == id).ok_or_else(|| Error::usage(format!("the plan has no {what} `{id}`")))
}

/// The wanted ones of `known`, in the order of `known`; no wish means all. An unknown or doubled wish is a usage error.
pub fn choose(known: &[String], wanted: Option<&[String]>, what: &str) -> Result<Vec<String>> {
    let Some(wanted) = wanted else { return Ok(known.to_vec()) };
    for (i, id) in wanted.iter().enumerate() {
        if !known.contains(id) {
            return Err(Error::usage(format!("there is no {what} `{id}`; there are {}", known.join(", "))));
        }
        if wanted[..i].contains(id) {
            return Err(Error::usage(format!("the {what} `{id}` is named twice")));
        }
    }
    Ok(known.iter().filter(|id| wanted.contains(id)).cloned().collect())
}

/// File names without `.toml` in `folder`, sorted as people count: `case2` before `case10`.
pub fn toml_ids(folder: &Path) -> Result<Vec<String>> {
    let mut ids = files::toml_stems(folder)?;
    ids.sort_by_key(|id| (id.trim_end_matches(|c: char| c.is_ascii_digit()).to_owned(), id.len(), id.clone()));
    Ok(ids)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn small_plan() -> Plan {
        let planned = |id: &str| Planned { id: id.into(), content: format!("content of {id}"), draws: true };
        Plan {
            profile: "smoke".into(),
            cases: vec![planned("case1"), planned("case2")],
            methods: vec![planned("ours"), planned("static-ct")],
            seeds: vec![1, 2],
            revisions: Revisions { sequence: "a".into(), prediction: "b".into(), score: "c".into() },
        }
    }

    #[test]
    fn cells_are_ordered_and_keys_depend_on_what_they_should() {
        let plan = small_plan();
        let cells = plan.cells();
        assert_eq!(cells.len(), 8);
        assert_eq!(cells[3].id(), "case1-static-ct-s2");

        let mut still = plan.clone();
        still.methods[1].draws = false;
        let of_case1: Vec<String> = still.cells_of("case1").iter().map(Cell::id).collect();
        assert_eq!(of_case1, ["case1-ours-s1", "case1-ours-s2", "case1-static-ct-s1"]);
        assert_eq!(still.run_id().unwrap(), plan.run_id().unwrap(), "it follows from the content");

        let cell = &cells[0];
        let keys =
            |p: &Plan| [p.sequence_key(&p.cases[0]), p.prediction_key(cell), p.score_key(cell)].map(Result::unwrap);
        let changed = |edit: fn(&mut Plan)| {
            let mut other = plan.clone();
            edit(&mut other);
            let (a, b) = (keys(&plan), keys(&other));
            [a[0] != b[0], a[1] != b[1], a[2] != b[2], plan.run_id().unwrap() != other.run_id().unwrap()]
        };
        assert_eq!(changed(|p| p.cases[0].content.push('x')), [true, true, true, true]);
        assert_eq!(changed(|p| p.cases[1].content.push('x')), [false, false, false, true]);
        assert_eq!(changed(|p| p.methods[0].content.push('x')), [false, true, true, true]);
        assert_eq!(changed(|p| p.revisions.sequence.push('x')), [true, true, true, false]);
        assert_eq!(changed(|p| p.revisions.prediction.push('x')), [false, true, true, false]);
        assert_eq!(changed(|p| p.revisions.score.push('x')), [false, false, true, false]);
    }

    #[test]
    fn wishes_are_checked() {
        let known: Vec<String> = ["a", "b", "c"].map(String::from).into();
        let wish = |w: &[&str]| choose(&known, Some(&w.iter().map(|s| s.to_string()).collect::<Vec<_>>()), "case");
        assert_eq!(wish(&["c", "a"]).unwrap(), ["a", "c"]);
        assert_eq!(wish(&["d"]).unwrap_err().to_string(), "there is no case `d`; there are a, b, c");
        assert!(wish(&["a", "a"]).unwrap_err().to_string().contains("twice"));
        assert_eq!(choose(&known, None, "case").unwrap(), known);
    }

    #[test]
    fn ids_are_sorted_as_people_count() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["case10.toml", "case2.toml", "atm.toml", "README.md"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        assert_eq!(toml_ids(folder.path()).unwrap(), ["atm", "case2", "case10"]);
    }
}
