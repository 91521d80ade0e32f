#!/bin/sh
# Derives the [breathing] part of every case from the landmark files in DIR (default ../shared/data/dirlab_copd).
# The landmarks themselves are not part of this repository; see docs/cases.md.
set -eu
cd "$(dirname "$0")/.."
DIR=${1:-../shared/data/dirlab_copd}
SOURCE="DIR-Lab COPDgene (Castillo et al., Phys Med Biol 58:2861, 2013) by way of Lung250M-4B"
derive() {
    cargo run --release --quiet -- import breathing "bench-cases/$1.toml" --landmarks "$DIR/$2.csv" \
        --lung-boxes "$DIR/lung_boxes.csv" --end-motion-mm "$3" --source "$SOURCE"
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

# The tuning cases breathe like other patients reflected left to right: motions that none of the nine has.
mirrored=$(mktemp -d)
trap 'rm -rf "$mirrored"' EXIT
awk -F, -v OFS=, 'NR > 1 {low = -$6; $6 = -$3; $3 = low} {print}' "$DIR/lung_boxes.csv" > "$mirrored/lung_boxes.csv"
derive_mirrored() {
    awk -F, -v OFS=, 'NR > 1 {$1 = -$1; $4 = -$4} {print}' "$DIR/$2.csv" > "$mirrored/$2.csv"
    cargo run --release --quiet -- import breathing "bench-cases/tuning/$1.toml" --landmarks "$mirrored/$2.csv" \
        --lung-boxes "$mirrored/lung_boxes.csv" --end-motion-mm "$3" \
        --source "reflected left to right: $SOURCE"
}
derive_mirrored tune1 copd03 9.0
derive_mirrored tune2 copd05 17.0
derive_mirrored tune3 copd08 11.0
derive_mirrored tune4 copd02 7.0
