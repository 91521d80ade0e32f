#!/usr/bin/env bash
# Makes a Debian machine (12 or later, x86-64) able to build respire-bench: Embree 4, OpenCV's two libraries, clang.
# Needs Rust and git; root or sudo when a package is missing. Touches apt and ./.deps, nothing else; running it again
# takes a moment and changes nothing. With --ct also elastix, with which `import ct` registers two scans. What was
# tried and measured: docs/BUILD.md.
set -euo pipefail
cd "$(dirname "$0")/.."
prefix=$PWD/.deps/embree4

program=setup
. scripts/packages.sh

candidate() { LC_ALL=C apt-cache policy "$1" 2>/dev/null | awk '/Candidate:/ && $2 != "(none)" {print $2}'; }

case "${1:-}" in
  '') with_ct= ;;
  --ct) with_ct=yes ;;
  *) stop "knows --ct and no \`$1\`." ;;
esac

# --- the machine -----------------------------------------------------------------------------------------------
[ "$(uname -s)-$(uname -m)" = Linux-x86_64 ] || stop "this is $(uname -s) on $(uname -m); respire-bench is built on x86-64 Linux."
command -v apt-get >/dev/null && command -v dpkg >/dev/null || stop \
  "this is not Debian; install Embree 4.3 or later, OpenCV 4 (core, imgproc), clang and g++ yourself, set EMBREE_DIR, and see docs/BUILD.md."
command -v cargo >/dev/null || stop "Rust is missing; install Rust 1.95 or later first (https://rustup.rs)."

# --- Debian's packages -----------------------------------------------------------------------------------------
# clang: bindgen wants libclang, the opencv crate the clang program. OpenCV's two libraries are 47 MB, the meta-package 690 MB.
packages=(g++ clang libopencv-core-dev libopencv-imgproc-dev)

embree_of_debian() {
  local version
  version=$(candidate libembree-dev)
  [ -n "$version" ] || { as_root apt-get update -qq || true; version=$(candidate libembree-dev); }
  [ -n "$version" ] || stop "apt knows no package libembree-dev; is there a network, and is this Debian 12 or later with its main archive?"
  dpkg --compare-versions "$version" ge 4.3
}

if installed libembree-dev && [ -e /usr/include/embree4/rtcore.h ] || { [ ! -e "$prefix/.ok" ] && embree_of_debian; }; then
  embree=debian
  packages+=(libembree-dev)
  # What an older Debian needed must not shadow the system's library after an upgrade.
  rm -rf "$prefix"
else
  # Debian 12 has Embree 3; the library of the wheel is given Debian's own names by patchelf.
  embree=wheel
  packages+=(libtbb12)
  if [ ! -e "$prefix/.ok" ]; then
    packages+=(patchelf)
    has_pip python3 || packages+=(python3-pip)
  fi
fi

[ -z "$with_ct" ] || packages+=(elastix dcm2niix)
install_packages "${packages[@]}"

# --- Embree 4 where Debian has only Embree 3 --------------------------------------------------------------------
# Library: the PyPI wheel embreex (glibc 2.28 or later), by its hash. Headers: Debian 13's libembree-dev, unpacked and
# not installed, through an apt configuration of its own that leaves the system's alone and takes its mirror.
wheel='embreex==4.4.0.post1 --hash=sha256:2cd0f7d5c6342e6247e31f700761689cae7829454d8c6de0c41e62124a023e1f'

fetch_library() {
  fetch_wheel "$work" "$wheel" --python-version 3.11 --implementation cp --abi cp311 \
    --platform manylinux_2_28_x86_64 --platform manylinux_2_27_x86_64
}

fetch_headers() {
  local mirror keyring=/usr/share/keyrings/debian-archive-keyring.gpg
  # awk reads to the end: with pipefail, apt's broken pipe would count as a failure.
  mirror=$(LC_ALL=C apt-get indextargets --format '$(SITE)' 'Created-By: Packages' | awk '/\/debian\/?$/ && !seen {print; seen = 1}')
  [ -n "$mirror" ] || stop "no Debian mirror stands in apt's sources, so the headers of Embree 4 cannot be had."
  mkdir -p "$work"/apt/lists/partial "$work"/apt/cache/archives/partial
  echo "deb [signed-by=$keyring] $mirror trixie main" >"$work/apt/sources.list"
  local own=(-o Dir::Etc::sourcelist="$work/apt/sources.list" -o Dir::Etc::sourceparts=- -o Dir::State::lists="$work/apt/lists"
    -o Dir::Cache="$work/apt/cache" -o Acquire::IndexTargets::deb::DEP-11::DefaultEnabled=false
    -o Acquire::Languages=none -o APT::Sandbox::User=root)
  (cd "$work" && apt-get "${own[@]}" -qq update && apt-get "${own[@]}" -qq download libembree-dev) >"$work/apt.log" 2>&1 ||
    stop "the headers of Embree 4 cannot be had from Debian 13's archive: $(grep -m1 '^E:' "$work/apt.log" || tail -n1 "$work/apt.log")"
  dpkg-deb -x "$work"/libembree-dev_*.deb "$work/headers"
}

assemble() {
  local library=$work/prefix/lib/libembree4.so.4 tbb
  mkdir -p "$work/prefix/lib" "$work/prefix/include"
  cp -r "$work/headers/usr/include/embree4" "$work/prefix/include/"
  cp "$work"/wheel/embreex.libs/libembree4-*.so.4 "$library"
  # Debian's own names: the program is the same as one built on Debian 13, and the process has one TBB (OpenCV's). One
  # call per edit, since patchelf 0.14 mixes several up.
  tbb=$(basename "$work"/wheel/embreex.libs/libtbb-*.so.12)
  patchelf --set-soname libembree4.so.4 "$library"
  patchelf --replace-needed "$tbb" libtbb.so.12 "$library"
  patchelf --remove-rpath "$library"
  ln -s libembree4.so.4 "$work/prefix/lib/libembree4.so"
  prove "$work/prefix"
  touch "$work/prefix/.ok"
  rm -rf "$prefix"
  mkdir -p "$(dirname "$prefix")"
  mv "$work/prefix" "$prefix"
}

# Builds and runs a program of three lines against what was just put together.
prove() {
  cat >"$work/prove.cpp" <<'CPP'
#include <embree4/rtcore.h>
int main() {
  RTCDevice device = rtcNewDevice(nullptr);
  return device && rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_VERSION) >= RTC_VERSION ? 0 : 1;
}
CPP
  { g++ "$work/prove.cpp" -I"$1/include" -L"$1/lib" -Wl,-rpath,"$1/lib" -lembree4 -o "$work/prove" && "$work/prove"; } \
    >"$work/prove.log" 2>&1 || stop "the fetched Embree 4 does not run here: $(tail -n1 "$work/prove.log")"
}

if [ "$embree" = wheel ] && [ ! -e "$prefix/.ok" ]; then
  say "fetching Embree 4"
  work=$(mktemp -d)
  trap 'rm -rf "$work"' EXIT
  fetch_library
  fetch_headers
  assemble
fi
say "ready (Embree 4: $([ "$embree" = wheel ] && echo .deps/embree4 || echo "Debian's"))"
