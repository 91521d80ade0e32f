#!/usr/bin/env bash
# Two processes on one cache against one: how much sooner the same table is there, with one thread each.
#
#   scripts/two-processes.sh [ARGUMENT OF all-cases...]      default: --profile smoke
#
# Prints the seconds and their ratio, and compares results.csv of all three byte by byte. Two cores, and nothing else on
# them: with a load above 0.5 before it begins, it compares the bytes and says that its seconds mean nothing.
# RESPIRE_BENCH chooses the program (target/release/respire-bench).
set -euo pipefail
# Seconds with a point.
export LC_ALL=C
bench=$(readlink -f "${RESPIRE_BENCH:-$(dirname "$0")/../target/release/respire-bench}")
[ -x "$bench" ] || { echo "two-processes: there is no program $bench; build it first: cargo build --release" >&2; exit 5; }
[ $# -gt 0 ] || set -- --profile smoke
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
read -r load _ </proc/loadavg

# run NAME CACHE ARGUMENT...: a report in WORK/NAME.
run() { "$bench" --yes --threads 1 all-cases --out "$work/$1" --cache "$work/$2" "${@:3}" >"$work/$1.log" 2>&1; }
# seconds COMMAND...
seconds() {
  local start=$EPOCHREALTIME
  "$@"
  awk -v a="$start" -v b="$EPOCHREALTIME" 'BEGIN { printf "%.1f", b - a }'
}
both() {
  run second shared "$@" &
  local other=$!
  run third shared "$@"
  wait "$other"
}
alone=$(seconds run first alone "$@")
together=$(seconds both "$@")
for name in second third; do
  cmp "$work/first/latest/results.csv" "$work/$name/latest/results.csv"
done
awk -v a="$alone" -v b="$together" 'BEGIN { printf "one process %.1f s, two %.1f s: %.2f times; the same bytes\n", a, b, a / b }'
if awk -v load="$load" 'BEGIN { exit load <= 0.5 }'; then
  echo "two-processes: the load was $load before it began, so these seconds mean nothing" >&2
fi
