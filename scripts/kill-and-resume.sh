#!/usr/bin/env bash
# Ends small runs of the main job by four signals in turn (TERM, INT, HUP, KILL) at random times, resumes each, and
# compares: results.csv and frames.csv must be the bytes of a run that nobody disturbed, and nothing may be left over.
#
#   scripts/kill-and-resume.sh [ROUNDS]        default 40
#
# RESPIRE_SEED chooses the times, RESPIRE_BENCH the program (target/release/respire-bench).
set -euo pipefail
cd "$(dirname "$0")/.."
rounds=${1:-40} program=${RESPIRE_BENCH:-target/release/respire-bench}
RANDOM=${RESPIRE_SEED:-1}
[ -x "$program" ] || cargo build --release --locked --quiet
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

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
iteration_scale = 0.05
PROFILE

start() { # FOLDER
  exec "$program" all-cases --cases "$work/tube.toml" --profile "$work/tiny.toml" --out "$1/reports" --cache "$1/cache" >"$1.log" 2>&1
}

now_ms() { echo $((${EPOCHREALTIME/./} / 1000)); }

# A warm run says how long one takes.
(start "$work/warm")
from=$(now_ms)
(start "$work/whole")
length_ms=$(($(now_ms) - from))
printf 'a run takes %s ms\n' "$length_ms"

fail() {
  printf 'round %s (%s after %s ms): %s\n' "$round" "$signal" "$wait_ms" "$1"
  sed 's/^/    /' "$work/$round.log"
  sound=no
}

same() { # FILE
  cmp -s "$work/whole/reports/latest/$1" "$work/$round/reports/latest/$1" || fail "$1 differs"
}

failed=0 finished=0 before_main=0
declare -A ended
signals=(TERM INT HUP KILL)
for round in $(seq "$rounds"); do
  signal=${signals[round % 4]}
  sound=yes
  wait_ms=$((RANDOM * length_ms / 32768))
  start "$work/$round" &
  child=$!
  sleep "$(printf '%d.%03d' $((wait_ms / 1000)) $((wait_ms % 1000)))"
  kill -s "$signal" "$child" 2>/dev/null || true
  code=0
  wait "$child" 2>/dev/null || code=$?
  case "$signal-$code" in
    *-0) finished=$((finished + 1)) ;;
    KILL-137 | TERM-130 | INT-130 | HUP-130) ended[$signal]=$((${ended[$signal]:-0} + 1)) ;;
    # While the libraries are loaded nothing of the program runs yet, and nothing is written.
    TERM-143 | HUP-129)
      before_main=$((before_main + 1))
      [ ! -e "$work/$round" ] || fail "ended by the signal itself, exit $code"
      ;;
    *) fail "exit $code" ;;
  esac
  code=0
  (start "$work/$round") || code=$?
  [ "$code" = 0 ] || fail "resuming ends with $code"
  same results.csv
  same frames.csv
  left=$(find "$work/$round" -name '.*.tmp' -o -name '.partial' -o -name '*.tmp')
  [ -z "$left" ] || fail "left over: $left"
  [ "$sound" = yes ] || failed=$((failed + 1))
  rm -rf "${work:?}/$round"
done
for signal in "${signals[@]}"; do printf '%-5s %s\n' "$signal" "${ended[$signal]:-0}"; done
printf 'finished before the signal %s, ended before main %s\n' "$finished" "$before_main"
printf '%s of %s rounds: same bytes, nothing left over\n' $((rounds - failed)) "$rounds"
[ "$failed" = 0 ]
