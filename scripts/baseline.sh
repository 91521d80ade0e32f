#!/usr/bin/env bash
# Makes the gate's baseline of a track anew, for when films, methods or metrics were meant to change:
# reports/baselines/TRACK with the results of the smoke run and limits.toml, which are four standard deviations of the
# seeds or, where those are 0, of the nine cases between two samplings of their films (docs/statistics.md).
# usage: scripts/baseline.sh [WORK]; about half an hour on two cores. WORK keeps the runs: the same command goes on.
set -euo pipefail
cd "$(dirname "$0")/.."
work=${1:-target/baseline}
track=ideal
to=reports/baselines/$track

cargo build --release --locked --quiet
bench() { target/release/respire-bench --yes "$@"; }
run() {
    local name=$1
    shift
    bench all-cases --track "$track" --out "$work/$name" --cache "$work/cache" "$@"
}

mkdir -p "$work"
cases=$(cd bench-cases && echo case*.toml | sed 's/\.toml//g; s/ /,/g')
# Seeds say nothing of methods that draw nothing: all but BridgeSplat, which would take two thirds of the time.
still=$(cd bench-cases/methods && ls *.toml | grep -v '^bridgesplat' | sed 's/\.toml//' | paste -sd,)
# The same films but for the places of the samples in each pixel.
sed 's/^samples_per_pixel = .*/samples_per_pixel = 5/' bench-cases/profiles/smoke.toml > "$work/resampled.toml"

run smoke --profile smoke
run seeds --profile smoke --seeds 1,2,3
run nine --profile smoke --cases "$cases" --methods "$still"
run resampled --profile "$work/resampled.toml" --cases "$cases" --methods "$still"

rm -rf "$to"
mkdir -p "$to"
cp "$work"/smoke/latest/{results.csv,run.json} "$to/"
bench gate --limits-from "$work/seeds/latest,$work/nine/latest,$work/resampled/latest" --out "$to"
bench gate --results "$work/smoke/latest" --baseline "$to" --out "$work"
