#!/usr/bin/env bash
# Opens a report in headless Chromium (software WebGL) and checks it: scripts/test-page.sh [REPORT.html [PICTURES]]
# Default: the smoke run's. PICTURES: a folder for screenshots and a print. Takes about 20 s; installs Debian's chromium
# where it is missing and can be had, and otherwise says loudly that nothing was checked.
set -euo pipefail
cd "$(dirname "$0")/.."
program=test-page
. scripts/packages.sh
report=${1:-target/smoke/latest/report.html}

skipped() { printf '\n*** SKIPPED: the page was NOT looked at: %s\n\n' "$*" >&2; exit 0; }
[ -f "$report" ] || stop "$report is missing; make it with: respire-bench all-cases --profile smoke --out target/smoke"
command -v python3 >/dev/null || skipped "there is no python3"
if ! command -v chromium >/dev/null; then
  # Only the download may be cut short: a package that is half installed breaks the machine.
  as_root timeout 45 apt-get install -y -qq --no-install-recommends --download-only chromium >/dev/null 2>&1 &&
    (install_packages chromium) || true
fi
command -v chromium >/dev/null || skipped "there is no chromium, and it cannot be had here in 45 s (apt-get install chromium)"
exec python3 -B tests/page/test_page.py "$(command -v chromium)" "$report" ${2:+"$2"}
