//! Which cells: the arguments that `all-cases`, `run` and `list` share.

use std::path::PathBuf;

use clap::Args;

use crate::base::Result;
use crate::bench::{Catalogue, Pipeline, Wishes};

/// Profile, cases, methods, seeds.
#[derive(Args)]
pub struct Selection {
    /// How much of everything: smoke, quick or paper
    #[arg(long, default_value = "quick", value_name = "P")]
    profile: String,
    /// Cases by id, or paths of case files; the profile's when not given
    #[arg(long, value_delimiter = ',', value_name = "CASE,..")]
    cases: Vec<String>,
    /// Methods by id; the profile's when not given
    #[arg(long, value_delimiter = ',', value_name = "METHOD,..")]
    methods: Vec<String>,
    /// Seeds of the methods' randomness; the profile's when not given
    #[arg(long, value_delimiter = ',', value_name = "N,..")]
    seeds: Vec<u64>,
    #[command(flatten)]
    places: Places,
}

/// Where cases, methods and profiles are described.
#[derive(Args)]
pub struct Places {
    /// Folder of cases, methods and profiles; the nearest `bench-cases` when not given
    #[arg(long, value_name = "DIR")]
    bench_cases: Option<PathBuf>,
}

impl Places {
    /// Opens the folder.
    pub fn catalogue(&self) -> Result<Catalogue> {
        Catalogue::find(self.bench_cases.as_deref())
    }
}

fn wish<T>(given: Vec<T>) -> Option<Vec<T>> {
    (!given.is_empty()).then_some(given)
}

impl Selection {
    /// Reads everything that was chosen; every mistake in it is found here, before any work.
    pub fn pipeline(self) -> Result<Pipeline> {
        let wishes = Wishes { cases: wish(self.cases), methods: wish(self.methods), seeds: wish(self.seeds) };
        Pipeline::new(&self.places.catalogue()?, &self.profile, wishes)
    }
}
