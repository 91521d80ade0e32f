#!/usr/bin/env bash
# COLMAP's features, matches and triangulation with known poses, as PyPI's pycolmap ships them, as a row of the table:
# scripts/others/pycolmap.sh --out DIR [--case CASE] [--profile P] [--report REPORT]      (docs/others.md)
set -euo pipefail
program=pycolmap method=colmap-points
. "$(dirname "$0")/common.sh"

make_film
export_film colmap
make_python 'numpy>=2,<3' 'pillow>=11,<13' 'pycolmap>=4,<5' 'scipy>=1.13,<2'
"$own_python" "$root/scripts/others/pycolmap_row.py" "$participant" "$out/colmap" "$out/prediction"
bring_in
