#!/usr/bin/env bash
# Films and fits are the same bytes on every processor (docs/decisions/0017): runs a small case here and once more on a
# processor that QEMU emulates, without AVX-512 and with reciprocals of its own, and compares the folders byte by byte.
# About ten minutes on two cores. Debian's package qemu-user is installed when it is missing.
#
#   scripts/test-processors.sh [METHOD..]       (default: ours ours-gn bridgesplat bridgesplat-nomesh)
#
# RESPIRE_BENCH chooses the program (target/release/respire-bench).
set -euo pipefail
cd "$(dirname "$0")/.."
program=test-processors
. scripts/packages.sh
install_packages qemu-user

bench=$(readlink -f "${RESPIRE_BENCH:-target/release/respire-bench}")
[ -x "$bench" ] || stop "there is no program $bench; build it first: cargo build --release"
methods=("$@")
[ ${#methods[@]} -gt 0 ] || methods=(ours ours-gn bridgesplat bridgesplat-nomesh)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

cat >"$work/small.toml" <<'TOML'
description = "one case, as small as it goes"
cases = ["case1"]
seeds = [1]
image_width_px = 32
frames_per_second = 8.0
minimum_frames = 12
minimum_breaths = 0.0
samples_per_pixel = 2
iteration_scale = 0.02
TOML

all_cases() {
  local name=$1
  shift
  "$@" "$bench" --yes all-cases --profile "$work/small.toml" --methods "$(IFS=,; echo "${methods[*]}")" \
    --out "$work/$name" --cache "$work/$name.cache" >"$work/$name.log" 2>&1 ||
    { tail -n5 "$work/$name.log" >&2; stop "the run on the $name processor failed."; }
}
say "on this processor"
all_cases own
say "on the emulated one"
all_cases emulated qemu-x86_64 -cpu max

# Films with their truth, and predictions; what holds times is left out, and scores are compared as tables.
listing() {
  (cd "$1" && find . -type f ! -path '*/score/*' ! -name .finished.json ! -name '*timing*' ! -name '*.log' -print0 |
    sort -z | xargs -0 sha256sum)
}
differing=$(diff <(listing "$work/own.cache") <(listing "$work/emulated.cache") | grep '^[<>]' || true)
for table in results.csv frames.csv; do
  cmp -s "$work/own/latest/$table" "$work/emulated/latest/$table" || differing+=$'\n'"$table"
done
[ -z "$differing" ] || { echo "$differing" >&2; stop "these files are not the same bytes on both processors."; }
say "$(listing "$work/own.cache" | wc -l) files and the tables are the same bytes on both processors"
