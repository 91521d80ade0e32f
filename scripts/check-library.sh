#!/usr/bin/env bash
# Proves that the splat core alone is a library: builds examples/splat_library.rs in a crate of its own, outside this
# folder, that depends on this one without default features, where neither Embree nor OpenCV nor clang is to be found,
# and compares what it prints. The compiled library is shared with the Python package (scripts/test-python.sh): the same
# versions, profile and features.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
fail() { printf 'check-library: %s\n' "$*" >&2; exit 1; }

mkdir -p "$work/crate/src" "$work/bin"
cp "$root/examples/splat_library.rs" "$work/crate/src/main.rs"
# Cargo adds the crate itself.
cargo fetch --quiet --locked --manifest-path "$root/python/Cargo.toml"
cp "$root/python/Cargo.lock" "$work/crate/"
cat >"$work/crate/Cargo.toml" <<TOML
[package]
name = "consumer"
version = "0.0.0"
edition = "2024"

[dependencies]
respire-bench = { path = "$root", default-features = false }
glam = { version = "0.34", default-features = false }
# The library does not need these features; the Python package's other dependencies ask for them.
num-traits = "0.2"
once_cell = "1"
[build-dependencies]
syn = { version = "3", features = ["extra-traits", "visit-mut"] }

$(sed -n '/^\[profile.release\]/,/^$/p' "$root/python/Cargo.toml")
TOML
# The build dependency counts only with a build script.
echo 'fn main() {}' >"$work/crate/build.rs"

# All that is on the path: Rust, g++ and what g++ calls.
for tool in cargo rustc c++ g++ gcc cc as ar ld; do
  ln -s "$(command -v "$tool")" "$work/bin/$tool"
done
alone() {
  env -u OPENCV_LINK_LIBS -u OPENCV_LINK_PATHS -u OPENCV_INCLUDE_PATHS PATH="$work/bin" EMBREE_DIR=/nonexistent \
    LIBCLANG_PATH=/nonexistent LLVM_CONFIG_PATH=/nonexistent "$@"
}
export CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-$root/target}

# From a folder in which cargo finds no .cargo/config.toml of ours.
cd "$work/crate"
tree() { cargo tree --offline --quiet --package respire-bench --edges normal,build --prefix none --format '{p} {f}' "$@"; }
tree=$(tree | sed 's/ (\*)$//' | sort --unique)
for name in bindgen clang-sys opencv clap plotters; do
  case $tree in *"$name v"*) fail "the library depends on $name" ;; esac
done
shared=$(tree --manifest-path "$root/python/Cargo.toml" | sed 's/ (\*)$//' | sort --unique)
[ "$tree" = "$shared" ] || fail "the library would be compiled once more for the Python package, whose features differ; \
name them in this script: $(diff <(echo "$tree") <(echo "$shared") | grep '^[<>]' || true)"
said=$(alone cargo run --offline --release --quiet)
[[ $said == "3 of 3 discs visible"* && $said == *"d(mean)/d(position)"* && $said == *"d(mean)/d(opacity)"* ]] ||
  fail "the example says: $said"
libraries=$(ldd "$CARGO_TARGET_DIR/release/consumer")
for name in embree opencv clang; do
  case $libraries in *"$name"*) fail "the example is linked against $name" ;; esac
done
