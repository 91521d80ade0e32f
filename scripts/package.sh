#!/usr/bin/env bash
# Makes a folder with the program that runs wherever it is moved to: scripts/package.sh DIR
#   DIR/respire-bench     the program; cases, methods and profiles are inside it
#   DIR/lib/              libraries that Debian does not have (on Debian 12: Embree 4)
#   DIR/packages.txt      Debian's packages with the other libraries, for apt-get install
#   DIR/bench-cases/      what the program carries, to read, or to change and give back with --bench-cases
#   DIR/share/            completions for bash, fish and zsh, and manual pages: copy it into /usr/local or ~/.local
#   DIR/licences/         of the program and of everything in it
# Another machine needs the same release of Debian, since OpenCV's libraries carry its version in their names.
set -euo pipefail
cd "$(dirname "$0")/.."
program=package
. scripts/packages.sh
[ $# = 1 ] || { printf 'usage: scripts/package.sh DIR\n' >&2; exit 2; }
case $1 in /*) out=$1 ;; *) out=$OLDPWD/$1 ;; esac
[ ! -e "$out" ] || { printf 'package: %s is there already; nothing is overwritten.\n' "$out" >&2; exit 4; }
command -v dpkg-query >/dev/null || stop "this is not Debian, so nobody knows which libraries another machine lacks."
installed patchelf || install_packages patchelf

cargo build --release --locked --quiet
built=${CARGO_TARGET_DIR:-target}/release/respire-bench
mkdir -p "$(dirname "$out")"
part=$(mktemp -d "$out.XXXXXX")
trap 'rm -rf "$part"' EXIT
chmod 755 "$part"
mkdir "$part/lib"
cp "$built" "$part/"
cp -r bench-cases "$part/"
rm "$part"/bench-cases/*.sh

# --- libraries -------------------------------------------------------------------------------------------------
needed() { readelf -d "$@" | sed -n 's/.*(NEEDED).*\[\(.*\)\]/\1/p' | sort -u; }
libraries=$(ldd "$built")
place_of() { awk -v name="$1" '$1 == name && $2 == "=>" { print $3; exit }' <<<"$libraries"; }
# Empty when no package owns the file. Debian knows some files of /usr/lib as /lib.
owner_of() {
  local file
  file=$(realpath "$1")
  { dpkg-query -S "$file" || dpkg-query -S "${file#/usr}"; } 2>/dev/null | sed 's/:.*//;q' || true
}

own=() packages=()
# What the program needs, then what the copied libraries need; apt knows the rest.
queue=("$built")
while [ ${#queue[@]} -gt 0 ]; do
  file=${queue[0]} queue=("${queue[@]:1}")
  for name in $(needed "$file"); do
    place=$(place_of "$name")
    # The dynamic linker has no such line.
    [ -n "$place" ] || continue
    owner=$(owner_of "$place")
    if [ -n "$owner" ]; then
      packages+=("$owner")
    elif [ ! -e "$part/lib/$name" ]; then
      cp -L "$place" "$part/lib/$name"
      patchelf --set-rpath '$ORIGIN' "$part/lib/$name"
      own+=("$name")
      queue+=("$place")
    fi
  done
done
printf '%s\n' "${packages[@]}" | sort -u >"$part/packages.txt"
# No way back into this folder.
patchelf --set-rpath '$ORIGIN:$ORIGIN/lib' "$part/respire-bench"

# --- completions and manual pages, where shells and man look below a prefix -----------------------------------------
place_completions() {
  mkdir -p "$part/share/$2"
  "$built" completions "$1" >"$part/share/$2/$3"
}
place_completions bash bash-completion/completions respire-bench
place_completions fish fish/vendor_completions.d respire-bench.fish
place_completions zsh zsh/site-functions _respire-bench
"$built" man --out "$part/share/man/man1" >/dev/null

# --- licences --------------------------------------------------------------------------------------------------
licences=$part/licences
mkdir "$licences"
cp LICENSE-APACHE LICENSE-MIT "$licences/"
mkdir "$licences/DejaVu-fonts"
cp src/report/font/LICENSE "$licences/DejaVu-fonts/"
{
  echo 'Rust standard library: MIT OR Apache-2.0'
  for name in ${own[@]+"${own[@]}"}; do
    case $name in
      libembree4.*) echo "$name: Embree, Copyright Intel Corporation, Apache-2.0 (LICENSE-APACHE)" ;;
      libtbb.*) echo "$name: oneTBB, Copyright Intel Corporation, Apache-2.0 (LICENSE-APACHE)" ;;
      *) stop "$name belongs to no package of Debian, and this script does not know its licence." ;;
    esac
  done
} >"$licences/README.txt"
# Asked for first: of a command in <(..) nobody sees that it failed, and the folder would have no licences.
crates=$(cargo tree --locked --edges normal --prefix none --no-dedupe --format '{p} {l}' | grep -v "^respire-bench " |
  sed 's/ (proc-macro)//' | LC_ALL=C sort -u) || stop "cargo tree does not name the crates whose licences are to be collected."
while read -r crate version licence; do
  printf '%s %s: %s\n' "$crate" "${version#v}" "$licence" >>"$licences/README.txt"
  for source in "${CARGO_HOME:-$HOME/.cargo}"/registry/src/*/"$crate-${version#v}"; do
    for text in "$source"/{LICENSE,LICENCE,COPYING,COPYRIGHT,NOTICE,UNLICENSE,license,copying}*; do
      [ -f "$text" ] || continue
      mkdir -p "$licences/$crate-${version#v}"
      cp "$text" "$licences/$crate-${version#v}/"
    done
  done
done <<<"$crates"

# --- proof -----------------------------------------------------------------------------------------------------
mv "$part" "$out"
trap - EXIT
works() { (cd / && env -u LD_LIBRARY_PATH "$out/respire-bench" "$@") >/dev/null || stop "$out/respire-bench $1 does not run."; }
strays=$(env -u LD_LIBRARY_PATH ldd "$out/respire-bench" | awk -v out="$out/" '$2 == "=>" && index($3, out) != 1 && $3 !~ /^\/(usr\/)?lib/')
[ -z "$strays" ] || stop "a library lies neither in $out nor with the system: $strays"
works doctor
works list
works all-cases --dry-run
bash -c 'source "$1" && complete -p respire-bench' - "$out/share/bash-completion/completions/respire-bench" >/dev/null ||
  stop "bash does not take the completions."
[ -s "$out/share/man/man1/respire-bench-simulate.1" ] || stop "a manual page is missing."
say "$out ($(du -sh "$out" | cut -f1); libraries beside the program: ${own[*]:-none})"
