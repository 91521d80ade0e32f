#!/usr/bin/env bash
# Runs the unit tests with the own C++ under AddressSanitizer and UndefinedBehaviorSanitizer (gcc's; stable Rust). Memory
# that Rust hands over is watched, too: all allocations go through the sanitizer.
#   scripts/sanitize.sh [TEST_FILTER]
# Builds in a folder of its own (target/sanitize); the first time takes as long as a build from nothing.
# Leaks are not looked for: OpenCV and the thread pools keep what they have until the end.
set -euo pipefail
cd "$(dirname "$0")/.."
host=$(rustc -vV | sed -n 's/^host: //p')
export CXXFLAGS="-fsanitize=address,undefined -fno-sanitize-recover=all -fno-omit-frame-pointer -g1"
export RUSTFLAGS="-Clink-arg=-lasan -Clink-arg=-lubsan"
export ASAN_OPTIONS="detect_leaks=0:detect_stack_use_after_return=1" UBSAN_OPTIONS="print_stacktrace=1"
# The sanitizer must be the first library that is loaded, and only by the tests: with a target named, no flag reaches build
# scripts and procedural macros, and the preloading is the runner's.
variable=CARGO_TARGET_$(tr a-z- A-Z_ <<<"$host")_RUNNER
export "$variable=env LD_PRELOAD=$(gcc -print-file-name=libasan.so)"
cargo test --locked --release --lib --target "$host" --target-dir target/sanitize -- "$@"
