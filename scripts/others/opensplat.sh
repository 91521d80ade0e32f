#!/usr/bin/env bash
# OpenSplat as its authors ship it, as a row of the table:
# scripts/others/opensplat.sh --out DIR [--case CASE] [--profile P] [--report REPORT]      (docs/others.md)
#
# OPENSPLAT is its program (default: opensplat on the path), built as its README says. It is AGPL and is called as a
# program, never linked. OPENSPLAT_STEPS: how many steps it trains (default 2000, as in its README).
set -euo pipefail
program=opensplat method=opensplat
. "$(dirname "$0")/common.sh"
opensplat=$(command -v "${OPENSPLAT:-opensplat}") ||
  stop "there is no program ${OPENSPLAT:-opensplat}; build it as https://github.com/pierotofy/OpenSplat says, and put its path into OPENSPLAT."
steps=${OPENSPLAT_STEPS:-2000}

make_film
export_film colmap
[ "$(awk '/^[0-9]/ { print $2; exit }' "$out/colmap/sparse/0/cameras.txt")" = PINHOLE ] ||
  stop "the film's camera is a fisheye, which OpenSplat does not know; choose a case with a pinhole."

# --- the method: trains on all frames, then its Gaussians are drawn by our rasteriser, since it writes no views ---------
work=$(mktemp -d "$out/.unfinished-XXXXXX")
trap 'rm -rf "$work"' EXIT
train_and_draw() {
  # Its defaults begin at a quarter of the resolution for 6,000 steps, which leaves 32x32 pixels of a small film.
  "$opensplat" "$out/colmap" --keep-crs --num-downscales 0 -n "$steps" -o "$work/splat.ply" >"$work/log.txt" 2>&1 ||
    { tail -n 3 "$work/log.txt" >&2; stop "OpenSplat failed on $out/colmap."; }
  "$bench" splat "$work/splat.ply" --cameras "$participant/transforms.json" --near 0.5 --out "$work/frames" >>"$work/log.txt"
  "$bench" splat "$work/splat.ply" --cameras "$participant/transforms_novel.json" --near 0.5 --out "$work/novel" >>"$work/log.txt"
}
TIMEFORMAT='%R %U %S'
# Its standard error is the caller's; that of `time` alone is read.
{ time train_and_draw 2>&3; } 3>&2 2>"$work/seconds.txt"

# --- the prediction ---------------------------------------------------------------------------------------------------
answer=$work/prediction
mkdir -p "$answer"/{color,depth,novel,novel_depth}
# place FROM TRANSFORMS PICTURES DEPTHS: `splat` numbers views as they come, a prediction as the film's files are named.
place() {
  local number=0 name from
  while read -r name; do
    from=$(printf '%s/%s/%06d' "$work" "$1" "$number")
    mv "$from.png" "$answer/$3/$name.png"
    mv "${from}_depth.exr" "$answer/$4/$name.exr"
    number=$((number + 1))
  done < <(grep -o '"file_path": *"[^"]*"' "$participant/$2" | sed 's:.*/::; s:\.png"::')
}
place frames transforms.json color depth
place novel transforms_novel.json novel novel_depth
awk '{ printf "{\"time_total_s\": %s, \"time_cpu_s\": %s}\n", $1, $2 + $3 }' "$work/seconds.txt" >"$answer/timing.json"
printf '{"method": "%s"}\n' "$method" >"$answer/prediction.json"
mv "$work/splat.ply" "$out/"
mv "$answer" "$out/prediction"
bring_in
