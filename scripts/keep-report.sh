#!/usr/bin/env bash
# Keeps a report under reports/reference: scripts/keep-report.sh REPORT DIR, where REPORT is a folder with results.csv (one
# track) and DIR is replaced. Left out is what can be made again and is large: page, films, values and pictures of frames.
set -euo pipefail
[ $# = 2 ] || { printf 'usage: scripts/keep-report.sh REPORT DIR\n' >&2; exit 2; }
report=$1 kept=$2
[ -f "$report/results.csv" ] || { printf 'keep-report: %s has no results.csv\n' "$report" >&2; exit 4; }
rm -rf "$kept"
mkdir -p "$kept/plots"
for name in comparison.csv differences.csv environment.json environments.json manifest.json results.csv run.json summary.csv \
  table.tex timings.csv; do
  [ ! -f "$report/$name" ] || cp "$report/$name" "$kept/"
done
# A report merged from kept ones has no frames, and no plots of them.
for name in contours error-against-time methods phase; do
  [ ! -f "$report/plots/$name.png" ] || cp "$report/plots/$name.png" "$kept/plots/"
done
# Every case's folded part holds those pictures alone.
awk '/^<details>/ { part = "" ; inside = 1 }
  inside { part = part $0 "\n"; if (/^<\/details>/) { inside = 0; if (part !~ /!\[Errors per frame/) printf "%s", part; else skip = 1 }; next }
  skip && /^$/ { skip = 0; next }
  { skip = 0; print }' "$report/report.md" >"$kept/report.md"
