#!/usr/bin/env bash
# Writes the smallest case that runs, a tube that bends (tube.toml), and the smallest profile (tiny.toml) into DIR:
#
#   scripts/tube-case.sh DIR
set -euo pipefail
mkdir -p "$1"
work=$1

# A closed tube of 60 mm that bends, RADIUS and BEND in mm: a real airway takes seconds to build, this one none.
tube() { # RADIUS BEND
  awk -v radius="$1" -v bend="$2" -v around=16 -v rings=24 '
    function face(a, b, c) { faces = faces sprintf("3 %d %d %d\n", a, b, c); count++ }
    BEGIN {
      turn = 8 * atan2(1, 1)
      for (r = 0; r < rings; r++) for (k = 0; k < around; k++) {
        part = r / (rings - 1)
        points = points sprintf("%.9f %.9f %.9f\n", radius * cos(turn * k / around) + bend * part * part,
          radius * sin(turn * k / around), -60 * part)
        next_k = (k + 1) % around
        if (r + 1 < rings) {
          face(r * around + k, r * around + next_k, (r + 1) * around + next_k)
          face(r * around + k, (r + 1) * around + next_k, (r + 1) * around + k)
        }
      }
      top = around * rings; last = around * (rings - 1)
      for (k = 0; k < around; k++) {
        face(top, (k + 1) % around, k); face(top + 1, last + k, last + (k + 1) % around)
      }
      printf "ply\nformat ascii 1.0\nelement vertex %d\nproperty double x\nproperty double y\nproperty double z\n", top + 2
      printf "element face %d\nproperty list uchar int vertex_indices\nend_header\n", count
      printf "%s0 0 0\n%.9f 0 -60\n%s", points, bend, faces
    }'
}
tube 6 0 >"$work/in.ply"
tube 5.4 5 >"$work/out.ply"
awk 'BEGIN {
  print "id,x_mm,y_mm,z_mm,radius_mm,branch,generation,parent_id"
  for (k = 0; k < 58; k++) printf "%d,0,0,%d,6,0,0,%d\n", k, -1 - k, k - 1
}' >"$work/line.csv"
cat >"$work/tube.toml" <<'CASE'
id = "tube"
title = "a tube"
seed = 1
camera = { fov_x_deg = 90.0 }
trajectory = { speed_mm_per_s = 10.0, scope_radius_mm = 1.9, seed = 1 }
anatomy = { kind = "mesh-pair", inspiration = "in.ply", expiration = "out.ply", centerline = "line.csv" }
CASE
cat >"$work/tiny.toml" <<'PROFILE'
description = "as cheap as it gets"
methods = ["static-ct", "ours"]
seeds = [1]
image_width_px = 16
frames_per_second = 2.0
minimum_frames = 4
minimum_breaths = 0.0
samples_per_pixel = 1
light = "draft"
iteration_scale = 0.05
PROFILE
