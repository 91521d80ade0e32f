#!/usr/bin/env bash
# Makes the gate's baselines anew, for when films, methods or metrics were meant to change: reports/baselines/TRACK with
# the results of the smoke run and limits.toml, which are four standard deviations of the seeds or, of a method that draws nothing, of
# the nine cases between two samplings of their films (docs/statistics.md).
# usage: scripts/baseline.sh [WORK]; about ten minutes on two cores. WORK keeps the runs: the same command goes on.
set -euo pipefail
cd "$(dirname "$0")/.."
work=${1:-target/baseline}

cargo build --release --locked --quiet
bench() { target/release/respire-bench --yes "$@"; }

mkdir -p "$work"
cases=$(cd bench-cases && echo case*.toml | sed 's/\.toml//g; s/ /,/g')
# Seeds say nothing of methods that draw nothing: all but BridgeSplat, which would take two thirds of the time.
still=$(cd bench-cases/methods && ls *.toml | grep -v '^bridgesplat' | sed 's/\.toml//' | paste -sd,)
# The rows that the clinical track's gate watches.
clinical=$(sed -n 's/^methods = \[\(.*\)\]$/\1/p' bench-cases/gate-clinical.toml | tr -d '" ')
# The same films but for the places of the samples in each pixel.
sed 's/^samples_per_pixel = .*/samples_per_pixel = 5/' bench-cases/profiles/smoke.toml > "$work/resampled.toml"

baseline() {
    local track=$1 to=reports/baselines/$1 runs
    shift
    run() {
        local name=$1
        shift
        bench all-cases --track "$track" --out "$work/$track-$name" --cache "$work/cache" "$@"
    }
    run smoke --profile smoke "${listed[@]}"
    run nine --profile smoke --cases "$cases" --methods "$still"
    run resampled --profile "$work/resampled.toml" --cases "$cases" --methods "$still"
    runs="$work/$track-nine/latest,$work/$track-resampled/latest"
    if [ "$track" = ideal ]; then
        run seeds --profile smoke --seeds 1,2,3
        runs="$work/$track-seeds/latest,$runs"
    fi
    rm -rf "$to"
    mkdir -p "$to"
    cp "$work/$track-smoke"/latest/{results.csv,run.json} "$to/"
    bench gate --limits-from "$runs" --out "$to"
    bench gate --results "$work/$track-smoke/latest" --baseline "$to" --out "$work"
}

listed=()
baseline ideal
still=$clinical
listed=(--methods "$clinical")
baseline clinical
