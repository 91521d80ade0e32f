#!/usr/bin/env bash
# Instructions of one forward and backward pass, by callgrind: the same number on a busy machine and on a quiet one.
#   scripts/count-instructions.sh [DISCS] [SIDE]
# Valgrind does not support AVX-512, so this counts the AVX2 kernels.
set -euo pipefail
cd "$(dirname "$0")/.."
command -v valgrind >/dev/null || { echo "valgrind is not installed" >&2; exit 2; }
cargo build --release --quiet --example splat_timing
discs=${1:-20000} side=${2:-256} folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
count() {
  # One thread: a second one that searches for work in vain would be counted too.
  RAYON_NUM_THREADS=1 valgrind --tool=callgrind --callgrind-out-file="$folder/$1" target/release/examples/splat_timing pass "$discs" "$side" "$1" 2>/dev/null
  awk '/^summary:|^totals:/ { print $2; exit }' "$folder/$1"
}
one=$(count 1) three=$(count 3)
echo "$discs discs, ${side}x$side: $(((three - one) / 2)) instructions per forward and backward pass"
callgrind_annotate "$folder/3" 2>/dev/null | grep -E '^ *[0-9,]+ \(' | head -14
