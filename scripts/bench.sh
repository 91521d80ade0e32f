#!/usr/bin/env bash
# The main job from nothing: sets the machine up, builds, simulates, reconstructs, scores, reports.
# Arguments go to `respire-bench all-cases`, for instance: scripts/bench.sh --profile smoke
set -euo pipefail
cd "$(dirname "$0")/.."
scripts/setup.sh
exec cargo run --release --locked --quiet -- all-cases "$@"
