#!/usr/bin/env bash
# Where the rasteriser spends its time: samples `examples/splat_timing` with Linux perf and draws a flame graph.
#   scripts/flame-graph.sh [OUT.svg] [arguments of splat_timing ...]
# Needs `perf`; draws with `inferno-flamegraph` where it is installed (cargo install inferno), else writes the folded stacks
# beside OUT.svg and prints the functions that take most.
set -euo pipefail
cd "$(dirname "$0")/.."
out=${1:-target/splat-flame.svg}
shift || true
[ $# -gt 0 ] || set -- 20000 256 1 widest 300
command -v perf >/dev/null || { echo "perf is not installed" >&2; exit 2; }
mkdir -p "$(dirname "$out")"
# Frame pointers for the stacks, symbols for the names; in a target folder of its own.
RUSTFLAGS="-C force-frame-pointers=yes" CXXFLAGS="-fno-omit-frame-pointer" CARGO_PROFILE_RELEASE_DEBUG=1 \
  cargo build --release --target-dir target/flame --example splat_timing
data=$(mktemp)
trap 'rm -f "$data"' EXIT
perf record --quiet -e cpu-clock -F 4999 -g --output "$data" target/flame/release/examples/splat_timing "$@"
if command -v inferno-flamegraph >/dev/null; then
  perf script --input "$data" | inferno-collapse-perf | inferno-flamegraph >"$out"
  echo "$out"
else
  perf script --input "$data" | awk '
    /^[^ \t#]/ { next }
    /^[ \t]/ { name = $2; for (i = 3; i < NF; ++i) name = name " " $i; sub(/\+0x[0-9a-f]+$/, "", name); stack = stack == "" ? name : name ";" stack; next }
    /^$/ { if (stack != "") ++count[stack]; stack = "" }
    END { for (s in count) print s, count[s] }' >"${out%.svg}.folded"
  echo "${out%.svg}.folded (inferno-flamegraph is not installed)"
fi
perf report --input "$data" --no-children --stdio -g none 2>/dev/null | grep -v '^#' | grep '%' | head -15
