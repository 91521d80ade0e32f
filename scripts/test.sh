#!/usr/bin/env bash
# Everything that must hold before a change lands: format, lints, documentation, tests, the smoke run and its gate.
set -euo pipefail
cd "$(dirname "$0")/.."
# Half of what the compiler does for a release is optimising across the units of a crate. A check does without: the same
# bytes, methods a tenth to a quarter slower (docs/log/2026-11-compile-time.md).
export CARGO_PROFILE_RELEASE_LTO=off
step() { printf '\n== %s (%s s)\n' "$*" "$SECONDS"; }

step setup
scripts/setup.sh
step format
cargo fmt --check
scripts/format-cpp.sh --check
step lints
cargo clippy --release --locked --all-targets --quiet -- -D warnings
step documentation
RUSTDOCFLAGS='-D warnings' cargo doc --release --locked --no-deps --document-private-items --quiet
step python packages
eval "$(scripts/python-packages.sh)"
export RESPIRE_PYTHON PYTHONPATH
step build
# Program and tests in one call, so that the library and its unit tests compile side by side. Examples are checked by the
# lints, and no comment holds a program to be tested.
tests=(--release --locked --quiet --lib --test all)
cargo test "${tests[@]}" --no-run
step tests
RESPIRE_FUZZ_SECONDS=2 cargo test "${tests[@]}"
step library
scripts/check-library.sh
step python
scripts/test-python.sh
step package
rm -rf target/package
scripts/package.sh target/package
step smoke run
bench() { cargo run --release --locked --quiet -- "$@"; }
bench all-cases --profile smoke --out target/smoke --cache target/smoke/cache
navigators=$(sed -n 's/^methods = \[\(.*\)\]$/\1/p' bench-cases/gate-clinical.toml | tr -d '" ')
bench all-cases --profile smoke --track clinical --methods "$navigators" \
  --out target/smoke-clinical --cache target/smoke/cache
step page
scripts/test-page.sh
step gate: absolute limits, and losses against the baseline
bench gate --results target/smoke/latest --baseline reports/baselines/ideal
bench gate --results target/smoke-clinical/latest --baseline reports/baselines/clinical
step done
