#!/usr/bin/env bash
# Ends small runs of the main job by four signals in turn (TERM, INT, HUP, KILL) at random times, resumes each, and
# compares: results.csv and frames.csv must be the bytes of a run that nobody disturbed, and nothing may be left over.
#
#   scripts/kill-and-resume.sh [ROUNDS]        default 40
#
# RESPIRE_SEED chooses the times, RESPIRE_BENCH the program (target/release/respire-bench).
set -euo pipefail
# Seconds with a point.
export LC_ALL=C
cd "$(dirname "$0")/.."
rounds=${1:-40} program=${RESPIRE_BENCH:-target/release/respire-bench}
RANDOM=${RESPIRE_SEED:-1}
[ -x "$program" ] || cargo build --release --locked --quiet
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

scripts/tube-case.sh "$work"

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
  left=$(find "$work/$round" -name '.*' ! -name .finished.json ! -name . -o -name '*.tmp')
  [ -z "$left" ] || fail "left over: $left"
  [ "$sound" = yes ] || failed=$((failed + 1))
  rm -rf "${work:?}/$round"
done
for signal in "${signals[@]}"; do printf '%-5s %s\n' "$signal" "${ended[$signal]:-0}"; done
printf 'finished before the signal %s, ended before main %s\n' "$finished" "$before_main"
printf '%s of %s rounds: same bytes, nothing left over\n' $((rounds - failed)) "$rounds"
[ "$failed" = 0 ]
