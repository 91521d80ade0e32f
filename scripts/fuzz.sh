#!/usr/bin/env bash
# Fuzzes the readers with libFuzzer (fuzz/, needs clang's C++ compiler or g++, stable Rust):
#
#   scripts/fuzz.sh [TARGET|all] [SECONDS]     60 seconds of one reader, or of each
#   scripts/fuzz.sh minimise [TARGET|all]      the committed corpus, reduced to what covers the most
#
# New inputs that cover more go to target/fuzz-corpus/TARGET, findings to target/fuzz-findings/TARGET-*. A finding is
# mended, and its input goes to fuzz/corpus/TARGET, which tests/all/readers.rs replays.
set -euo pipefail
cd "$(dirname "$0")/.."

action=fuzz
[ "${1:-}" != minimise ] || { action=minimise; shift; }
what=${1:-all} value=${2:-60}
names() { sed -n 's/^ *Target { name: "\([a-z_]*\)".*/\1/p' fuzz/src/targets.rs; }
chosen=$(names)
if [ "$what" != all ]; then
  grep -qxF -e "$what" <<<"$chosen" ||
    { printf 'fuzz: there is no target `%s`; the targets are: all %s\n' "$what" "$(tr '\n' ' ' <<<"$chosen")" >&2; exit 2; }
  chosen=$what
fi
host=$(rustc -vV | sed -n 's/^host: //p')
target_folder=$PWD/target/fuzz

# libFuzzer's feedback in the Rust code of the readers and of the libraries that they use. The flags are the compiler's
# own; no nightly is needed. A target triple keeps them away from build scripts.
flags=(--cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4
  -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table
  -Cllvm-args=-sanitizer-coverage-trace-compares)
RUSTFLAGS="${flags[*]}" CARGO_INCREMENTAL=0 \
  cargo build --release --locked --manifest-path fuzz/Cargo.toml --target "$host" --target-dir "$target_folder"
program=$target_folder/$host/release/fuzz
# The library of scripts/setup.sh on Debian 12; elsewhere it lies in the system.
export LD_LIBRARY_PATH=$PWD/.deps/embree4/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}

# One input may take 10 s (on a busy machine), ask for 1 GiB at once and hold 2 GiB in all.
limits=(-timeout=10 -rss_limit_mb=2048 -malloc_limit_mb=1024 -max_len=20000 -len_control=50)

fuzz() { # TARGET
  local found=target/fuzz-corpus/$1
  mkdir -p "$found" "fuzz/corpus/$1" target/fuzz-findings
  RESPIRE_FUZZ_TARGET=$1 "$program" "${limits[@]}" -max_total_time="$value" -print_final_stats=1 \
    -artifact_prefix="target/fuzz-findings/$1-" "$found" "fuzz/corpus/$1" 2>"$found.log" || {
    grep -aE 'panicked|ERROR|SUMMARY|Test unit' "$found.log" | head -8
    return 1
  }
  printf '%-14s %s\n' "$1" "$(sed -n 's/^stat::number_of_executed_units: *\(.*\)/\1 executions/p' "$found.log")"
}

# Whoever calls these functions asks whether they failed, which switches errexit off inside them.
minimise() { # TARGET
  local corpus=fuzz/corpus/$1 found=target/fuzz-corpus/$1 merged
  mkdir -p "$found" || return 1
  merged=$(mktemp -d target/fuzz-merged.XXXXXX) || return 1
  RESPIRE_FUZZ_TARGET=$1 "$program" -merge=1 -max_len=4000 "$merged" "$corpus" "$found" 2>"$found.log" || {
    printf '%s: not merged, and the corpus stays as it is; the end of %s:\n' "$1" "$found.log"
    tail -n 4 "$found.log"
    rm -rf "$merged"
    return 1
  }
  # Refused by rmdir unless it is empty.
  ! rmdir "$merged" 2>/dev/null || { printf '%s: nothing was left of the corpus, which stays as it is\n' "$1"; return 1; }
  # Findings are kept whatever they cover.
  for finding in "$corpus"/found-*; do
    [ ! -e "$finding" ] || cp "$finding" "$merged"/ || return 1
  done
  # The old one goes when the new one is in its place.
  chmod 755 "$merged" && mv "$corpus" "$merged.old" && mv "$merged" "$corpus" && rm -rf "$merged.old" || return 1
  printf '%-14s %s inputs\n' "$1" "$(find "$corpus" -type f | wc -l)"
}

status=0
# Folders of programs that have ended; others may be fuzzing beside this.
sweep() {
  for folder in /dev/shm/respire-bench-fuzz-*; do
    kill -0 "${folder##*-}" 2>/dev/null || rm -rf "$folder"
  done
}
trap sweep EXIT
for name in $chosen; do
  "$action" "$name" || status=1
done
exit $status
