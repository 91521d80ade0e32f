#!/usr/bin/env bash
# Runs tests with cpp/ and the bridges under AddressSanitizer and UndefinedBehaviorSanitizer:
#
#   scripts/sanitize.sh             all unit tests: tracer, films, splat core and scores are among them
#   scripts/sanitize.sh FILTER ..   the unit and integration tests whose names contain one of these
#
# Needs clang with its runtime (Debian: clang, libclang-rt-14-dev or of clang's version). The C++ is compiled by clang
# with the checks; the Rust code is as always, and its allocations are watched because the process has one allocator.
# Every report is an error: the test program stops at it. What was found: docs/memory-safety.md.
set -euo pipefail
cd "$(dirname "$0")/.."

command -v clang++ >/dev/null || { echo "sanitize: clang++ is missing; see scripts/setup.sh" >&2; exit 5; }
ls "$(clang++ -print-resource-dir)"/lib/*/libclang_rt.asan*x86_64*.a >/dev/null 2>&1 || {
  echo "sanitize: clang's runtime is missing; on Debian: apt-get install libclang-rt-$(clang++ -dumpversion | cut -d. -f1)-dev" >&2
  exit 5
}

checks=address,undefined
folder=$PWD/target/sanitize
mkdir -p "$folder/bin"
# The build scripts compile C++ with "c++", and rustc links with "cc": both find these first. Environment variables would
# do the same, but make cargo build every dependency again. C is what dependencies bring: compiled without checks. rustc
# asks for no default libraries; the checks need the C++ one.
flags="-fsanitize=$checks -fno-sanitize-recover=all -fno-omit-frame-pointer -g1 -Wno-unknown-warning-option"
printf '#!/bin/sh\nexec clang++ %s "$@"\n' "$flags" >"$folder/bin/c++"
cat >"$folder/bin/cc" <<EOF
#!/bin/sh
for argument; do
  [ "\$argument" != -c ] && [ "\$argument" != -E ] || exec clang "\$@"
done
exec clang++ -fsanitize=$checks "\$@" -lstdc++
EOF
chmod +x "$folder/bin/c++" "$folder/bin/cc"
export PATH=$folder/bin:$PATH

# Leaks: Rust's test harness and OpenCV keep what they have until the end.
export ASAN_OPTIONS=detect_leaks=0:abort_on_error=0:detect_stack_use_after_return=1:strict_string_checks=1
export UBSAN_OPTIONS=print_stacktrace=1
run=(cargo test --release --locked --target-dir "$folder")
[ $# -eq 0 ] || exec "${run[@]}" --lib --test all -- "$@"
exec "${run[@]}" --lib
