#!/bin/sh
# Derives the [breathing] part of every case from the landmark files in DIR (default ../shared/data/dirlab_copd).
# The landmarks themselves are not part of this repository; see docs/cases.md.
set -eu
cd "$(dirname "$0")/.."
DIR=${1:-../shared/data/dirlab_copd}
derive() {
    cargo run --release --quiet -- import breathing "bench-cases/$1.toml" --landmarks "$DIR/$2.csv" \
        --lung-boxes "$DIR/lung_boxes.csv" --end-motion-mm "$3"
}
derive case1 copd01 12.0
derive case2 copd02 9.0
derive case3 copd03 6.0
derive case4 copd04 18.0
derive case5 copd05 20.0
derive case6 copd06 15.0
derive case7 copd07 10.0
derive case8 copd08 8.0
derive case9 copd09 5.0
