#!/usr/bin/env bash
# Opens a report in headless Chromium (software WebGL) and checks it: scripts/test-page.sh [REPORT.html [PICTURES]]
# Default: the smoke run's, that run merged with a prediction of one's own, one of both tracks, and the page of `track`
# while it follows a film. PICTURES: a folder for screenshots and a print. Takes about a minute; installs Debian's chromium
# where it is missing and can be had, and otherwise says loudly that nothing was checked.
set -euo pipefail
cd "$(dirname "$0")/.."
program=test-page
. scripts/packages.sh
report=${1:-target/smoke/latest/report.html}

skipped() { ! required page || stop "the page was not looked at: $*"; printf '\n*** SKIPPED: the page was NOT looked at: %s\n\n' "$*" >&2; exit 0; }
[ -f "$report" ] || stop "$report is missing; make it with: respire-bench all-cases --profile smoke --out target/smoke"
command -v python3 >/dev/null || skipped "there is no python3"
if ! command -v chromium >/dev/null; then
  # Only the download may be cut short: a package that is half installed breaks the machine.
  as_root timeout "$(required page && echo 600 || echo 45)" apt-get install -y -qq --no-install-recommends --download-only chromium >/dev/null 2>&1 &&
    (install_packages chromium) || true
fi
command -v chromium >/dev/null || skipped "there is no chromium, and it cannot be had here in time (apt-get install chromium)"
chromium=$(command -v chromium)
python3 -B tests/page/test_page.py "$chromium" "$report" ${2:+"$2"}

# --- one's own method beside the others: a prediction of the smoke run under another name, merged with the run -----------
[ $# = 0 ] || exit 0
bench=${CARGO_TARGET_DIR:-target}/release/respire-bench
smoke=$(dirname "$(dirname "$report")")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
# What a command prints is shown where it fails, and is not wanted otherwise.
quietly() {
  "$@" >"$work/said" 2>"$work/log" || { cat "$work/said" "$work/log" >&2; say "this failed: $*" >&2; return 1; }
}
# A cell that the run has made; where it is missing it is made.
quietly "$bench" run --case case1 --method pose-only --profile smoke --cache "$smoke/cache"
said=$(cat "$work/said")
film=$(sed -n 's/^sequence: *//p' <<<"$said") prediction=$(sed -n 's/^prediction: *//p' <<<"$said")
quietly "$bench" evaluate --sequence "$film" --predictions "$prediction" --method mine --out "$work/mine"
quietly "$bench" merge "$smoke/latest" "$work/mine" --out "$work/table"
python3 -B tests/page/test_merged.py "$chromium" "$work/table/report.html" mine

# --- both tracks on one page ------------------------------------------------------------------------------------------------
quietly "$bench" all-cases --profile smoke --track both --cases case1 --methods pose-only,static-ct --out "$work/both" \
  --cache "$smoke/cache"
python3 -B tests/page/test_tracks.py "$chromium" "$work/both/latest/report.html"

# --- the live page, while a small clinical film is followed ---------------------------------------------------------------------
quietly "$bench" simulate case1 --profile smoke --track clinical --out "$work/films"
python3 -B tests/page/test_live.py "$chromium" "$bench" "$work/films/case1"
