# Sourced by the scripts that fetch something. Debian's packages are signed. Wheels of the Python package index: Embree,
# which becomes part of the program, and clang-format are wanted by their hashes (fetch_wheel); maturin and the packages that
# tests read with are ranges of versions (test-python.sh, python-packages.sh). The caller sets $program, its name in messages.

# Numbers are written and read with a point, whatever the user's language.
[ -z "${LC_ALL:-}" ] || export LANG=$LC_ALL
unset LC_ALL
export LC_NUMERIC=C

say() { printf '%s: %s\n' "$program" "$*"; }
# One sentence, and the documented exit code for an environment that lacks something.
stop() { printf '%s: %s\n' "$program" "$*" >&2; exit 5; }

as_root() {
  if [ "$(id -u)" = 0 ]; then "$@"
  elif command -v sudo >/dev/null; then sudo "$@"
  else stop "packages are missing and this is neither root nor sudo; run scripts/$program.sh as root once."
  fi
}

installed() { dpkg-query -W -f '${db:Status-Status}' "$1" 2>/dev/null | grep -qx installed; }

# install_packages NAME...: those that are missing.
install_packages() {
  local package missing=() log
  for package in "$@"; do installed "$package" || missing+=("$package"); done
  [ ${#missing[@]} -gt 0 ] || return 0
  say "installing ${missing[*]}"
  log=$(mktemp)
  as_root apt-get update -qq >"$log" 2>&1 || true
  as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >>"$log" 2>&1 ||
    stop "apt could not install ${missing[*]}: $(grep -m1 '^E:' "$log" || tail -n1 "$log") (whole output: $log)"
  rm -f "$log"
}

# The Python that has pip: the user's, or Debian's (package python3-pip).
has_pip() { "$1" -m pip --version >/dev/null 2>&1; }
python_with_pip() { if has_pip python3; then echo python3; else echo /usr/bin/python3; fi; }

# fetch_wheel WORK 'NAME==VERSION --hash=sha256:...' PIP_ARGUMENT...: unpacks it into WORK/wheel.
fetch_wheel() {
  local work=$1 requirement=$2 python
  shift 2
  python=$(python_with_pip)
  "$python" -m pip download -q --disable-pip-version-check --no-deps --only-binary=:all: "$@" \
    --require-hashes -r <(echo "$requirement") -d "$work" >"$work/pip.log" 2>&1 ||
    stop "${requirement%% *} cannot be had from the Python package index: $(grep -m1 ERROR "$work/pip.log" || tail -n1 "$work/pip.log")"
  "$python" -m zipfile -e "$work"/*.whl "$work/wheel"
}

# Whether a check must be made, so that a missing tool is a failure and not a line that says SKIPPED. RESPIRE_REQUIRE has
# the names of such checks with commas between, or "all": page and torch of the scripts, and those of the tests
# (CONTRIBUTING.md, tests/all/skip.rs).
required() { case ",${RESPIRE_REQUIRE:-}," in *,all,* | *,"$1",*) return 0 ;; *) return 1 ;; esac; }
