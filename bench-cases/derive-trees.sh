#!/usr/bin/env bash
# Regenerates the measured tree tables from the data they were measured from (not part of this repository).
# The tables of the repository stay as they are, since the nine cases rest on them: they were measured when the centreline
# still lay up to 5 % of the radius beside the middle and lacked branches with a thin end. This script gives others.
# Usage: bench-cases/derive-trees.sh DATA_FOLDER    (with atm22/meshes/*.ply and chaste/*.csv in it)
set -euo pipefail
data=${1:?usage: bench-cases/derive-trees.sh DATA_FOLDER}
cd "$(dirname "$0")/.."
bench=${RESPIRE_BENCH:-target/release/respire-bench}
atm="Measured from the airway surface of ATM'22 case %s: majority vote of five teams' masks, repository EndoluminalSurgicalVision-IMR/ATM-22-Related-Work (MIT). Cite Zhang et al., Medical Image Analysis 90:102957 (2023). LPS, mm."
for id in 224 305 384; do
  "$bench" import tree "$data/atm22/meshes/ATM_$id.ply" --axes ras --source "$(printf "$atm" "$id")" --out "bench-cases/trees/atm_$id.toml"
done
"$bench" import tree "$data/chaste/airway_centreline_points.csv" --axes lps --least-radius-mm 1.0 \
  --source "Measured from the centreline of one real subject's CT in the Chaste lung test data (github.com/Chaste/Chaste, BSD-3-Clause, Copyright (c) 2005-2025, University of Oxford, all rights reserved). Resampled. LPS, mm." \
  --out bench-cases/trees/chaste_subject002.toml
