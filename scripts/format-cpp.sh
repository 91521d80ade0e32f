#!/usr/bin/env bash
# Formats the C++ in cpp/ and the C in tests/ by .clang-format; with --check it only lists what is not formatted, and fails. Every version
# of clang-format breaks lines differently: the pinned one is fetched once, into .deps/clang-format.
set -euo pipefail
cd "$(dirname "$0")/.."
program=format-cpp
. scripts/packages.sh
wheel='clang-format==19.1.7 --hash=sha256:f4906fb463dd2033032978f56962caab268c9428a384126b9400543eb667f11c'
format=$PWD/.deps/clang-format/19.1.7/clang-format

case "${1-}" in
  '') mode=-i ;;
  --check) mode='--dry-run --Werror' ;;
  *) printf 'usage: scripts/format-cpp.sh [--check]\n' >&2; exit 2 ;;
esac

if [ ! -x "$format" ]; then
  has_pip python3 || has_pip /usr/bin/python3 || install_packages python3 python3-pip
  say "fetching clang-format 19.1.7"
  work=$(mktemp -d)
  trap 'rm -rf "$work"' EXIT
  fetch_wheel "$work" "$wheel" --platform manylinux_2_17_x86_64
  mkdir -p "$(dirname "$format")"
  install -m 755 "$work/wheel/clang_format/data/bin/clang-format" "$format.part"
  mv "$format.part" "$format"
fi
find cpp tests -name '*.h' -o -name '*.c' -o -name '*.cpp' | LC_ALL=C sort | xargs "$format" $mode
