#!/usr/bin/env bash
# Builds the wheel of the Python package (docs/python.md) and runs its tests: on the numpy of the Python package index,
# and once more on the first Python that has torch, with Debian's python3-torch for example. The compiled library is
# shared with scripts/check-library.sh. Fetches maturin and numpy into .deps.
#
#   scripts/test-python.sh [--torch]     --torch, or RESPIRE_REQUIRE=torch: without any torch, installs Debian's (142 MB)
set -euo pipefail
cd "$(dirname "$0")/.."
program=test-python
. scripts/packages.sh
target=${CARGO_TARGET_DIR:-$PWD/target}

eval "$(scripts/python-packages.sh)"
numpy=$PYTHONPATH
python=$RESPIRE_PYTHON
unset PYTHONPATH

# --- the wheel ----------------------------------------------------------------------------------------------------
tools=$PWD/.deps/maturin
if [ ! -e "$tools/.ok" ]; then
  say "fetching maturin"
  log=$(mktemp)
  "$python" -m pip install -q --disable-pip-version-check --only-binary=:all: --upgrade --target "$tools" 'maturin>=1.9,<2' \
    >"$log" 2>&1 || stop "pip could not install maturin: $(grep -m1 ERROR "$log" || tail -n1 "$log")"
  rm -f "$log"
  touch "$tools/.ok"
fi
rm -rf "$target/python"
"$tools/bin/maturin" build --quiet --release --locked --manifest-path python/Cargo.toml --target-dir "$target" \
  --interpreter "$python" --out "$target/python"
"$python" -m pip install -q --disable-pip-version-check --no-deps --target "$target/python/site" "$target"/python/*.whl
# What only the program may need.
for name in embree opencv; do
  case $(ldd "$target"/python/site/respire_bench/_native*.so) in *"$name"*) stop "the wheel is linked against $name" ;; esac
done

# --- the tests ----------------------------------------------------------------------------------------------------
RESPIRE_BENCH=${RESPIRE_BENCH:-$target/release/respire-bench}
export RESPIRE_BENCH
has_torch() { PYTHONPATH=$2 "$1" -c 'import numpy, torch; torch.zeros(1).numpy()' 2>/dev/null; }
# run_tests PYTHON FOLDERS: with the packages in FOLDERS beside the wheel's, from a folder that is not the source.
run_tests() {
  say "tests on $("$1" --version)$(has_torch "$1" "$2" && echo ' with torch' || echo ' without torch')"
  PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=$target/python/site${2:+:$2} \
    "$1" -m unittest discover --start-directory python/tests --top-level-directory python/tests
}
run_tests "$python" "$numpy"
if ! has_torch "$python" "$numpy"; then
  { [ "${1:-}" != --torch ] && ! required torch; } || has_torch /usr/bin/python3 "" || install_packages python3-torch
  for other in python3 /usr/bin/python3; do
    if has_torch "$other" ""; then
      run_tests "$other" ""
      exit
    fi
  done
  ! required torch || stop "no Python here has torch, so that rasterize was tested on numpy alone"
  say "SKIPPED: no Python here has torch, so that rasterize was tested on numpy alone; scripts/test-python.sh --torch installs it"
fi
