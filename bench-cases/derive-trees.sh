#!/usr/bin/env bash
# Measures the trees of the cases anew, from the data they were measured from (not part of this repository), into a folder
# of their own: bench-cases/derive-trees.sh DATA_FOLDER OUT_FOLDER    (DATA_FOLDER has atm22/meshes/*.ply and chaste/*.csv)
#
# These are not the tables of bench-cases/trees, which stay as they are since the nine cases rest on them: those were
# measured when the centreline still lay up to 5 % of the radius beside the middle and lacked branches with a thin end.
set -euo pipefail
[ $# = 2 ] || { echo "usage: bench-cases/derive-trees.sh DATA_FOLDER OUT_FOLDER" >&2; exit 2; }
data=$(realpath -e -- "$1")
out=$(realpath -m -- "$2")
cd "$(dirname "$0")/.."
[ ! "$out" -ef bench-cases/trees ] || { echo "derive-trees: the cases rest on the tables in $out; choose another folder" >&2; exit 2; }
mkdir -p "$out"
bench=${RESPIRE_BENCH:-target/release/respire-bench}
atm="Measured from the airway surface of ATM'22 case %s: majority vote of five teams' masks, repository EndoluminalSurgicalVision-IMR/ATM-22-Related-Work (MIT). Cite Zhang et al., Medical Image Analysis 90:102957 (2023). LPS, mm."
for id in 224 305 384; do
  "$bench" import tree "$data/atm22/meshes/ATM_$id.ply" --axes ras --source "$(printf "$atm" "$id")" --out "$out/atm_$id.toml"
done
"$bench" import tree "$data/chaste/airway_centreline_points.csv" --axes lps --least-radius-mm 1.0 \
  --source "Measured from the centreline of one real subject's CT in the Chaste lung test data (github.com/Chaste/Chaste, BSD-3-Clause, Copyright (c) 2005-2025, University of Oxford, all rights reserved). Resampled. LPS, mm." \
  --out "$out"/chaste_subject002.toml
