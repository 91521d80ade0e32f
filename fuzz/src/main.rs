//! libFuzzer over one reader: `RESPIRE_FUZZ_TARGET` names it. `scripts/fuzz.sh` builds and runs this.
#![no_main]

mod targets;

use std::path::Path;
use std::sync::LazyLock;

use libfuzzer_sys::{fuzz_mutator, fuzz_target, fuzzer_mutate};
use respire_bench::base::random::{CounterRng, Stage};

use targets::{Scratch, TARGETS, Target, mutate};

static TARGET: LazyLock<&Target> = LazyLock::new(|| {
    let name = std::env::var("RESPIRE_FUZZ_TARGET").unwrap_or_default();
    let names: Vec<&str> = TARGETS.iter().map(|t| t.name).collect();
    let target = TARGETS.iter().find(|t| t.name == name);
    target.unwrap_or_else(|| panic!("RESPIRE_FUZZ_TARGET must be one of {}", names.join(", ")))
});

static SCRATCH: LazyLock<Scratch> = LazyLock::new(|| {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    Scratch::new(root, &format!("fuzz-{}", TARGET.name)).expect("a scratch folder can be made")
});

fuzz_target!(|bytes: &[u8]| {
    (TARGET.run)(bytes, &SCRATCH);
});

// Half of the changes are libFuzzer's own, which the coverage guides; the others know what numbers look like.
fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    if seed % 2 == 0 {
        return fuzzer_mutate(data, size, max_size);
    }
    let mut rng = CounterRng::new(u64::from(seed), Stage::Test, &[]);
    let input = data[..size].to_vec();
    let changed = mutate(&input, &input, max_size, &mut rng);
    data[..changed.len()].copy_from_slice(&changed);
    changed.len()
});
