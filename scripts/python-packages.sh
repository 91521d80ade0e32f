#!/usr/bin/env bash
# The Python packages with which tests read films (src/simulate/FORMAT.md) and exports (docs/export.md) independently of
# this program, and check the types of the Python package, in .deps/python. Prints what to put into the environment:
# eval "$(scripts/python-packages.sh)"
set -euo pipefail
cd "$(dirname "$0")/.."
program=python-packages
. scripts/packages.sh
packages=('numpy>=2,<3' 'pillow>=11,<13' 'OpenEXR>=3.3,<4' 'pycolmap>=4,<5' 'trimesh>=4,<6' 'mypy>=1.13,<2')

has_pip python3 || has_pip /usr/bin/python3 || install_packages python3 python3-pip >&2
python=$(python_with_pip)
# Compiled packages belong to one version of Python.
folder=$PWD/.deps/python/$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
# A folder that was made for another list is made anew.
if [ "$(cat "$folder/.ok" 2>/dev/null)" != "${packages[*]}" ]; then
  say "fetching ${packages[*]}" >&2
  log=$(mktemp)
  "$python" -m pip install -q --disable-pip-version-check --only-binary=:all: --upgrade --target "$folder" "${packages[@]}" \
    >"$log" 2>&1 || stop "pip could not install ${packages[*]}: $(grep -m1 ERROR "$log" || tail -n1 "$log")"
  rm -f "$log"
  echo "${packages[*]}" >"$folder/.ok"
fi
printf 'export RESPIRE_PYTHON=%q PYTHONPATH=%q\n' "$python" "$folder"
