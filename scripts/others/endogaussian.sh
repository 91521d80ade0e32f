#!/usr/bin/env bash
# EndoGaussian as its authors ship it, as a row of the table, for whoever has a CUDA card:
# scripts/others/endogaussian.sh --out DIR [--case CASE] [--profile P] [--report REPORT]      (docs/others.md)
#
# ENDOGAUSSIAN is its folder, set up as its README says, and ENDOGAUSSIAN_PYTHON the Python of that environment (default:
# python). Without ENDOGAUSSIAN the script ends with the film in its layout, DIR/endonerf, and says what to run where the
# card is; called again with DIR/renders there, it makes the row.
set -euo pipefail
# It is given the true depth of every frame, and says so.
program=endogaussian method=endogaussian-true-depth
. "$(dirname "$0")/common.sh"
python=${ENDOGAUSSIAN_PYTHON:-python}
# Its own settings; the film's name among its results.
config=arguments/endonerf/pulling.py name=respire/$case_id

make_film
# The true depth is no participant's, so the export is of the truth.
[ -e "$out/endonerf" ] || "$bench" export "$out/film/truth" --format endonerf --axes opencv --truth --out "$out/endonerf"

# --- the method -------------------------------------------------------------------------------------------------------
train() {
  "$python" train.py -s "$out/endonerf" --port 6017 --expname "$name" --configs "$config"
  "$python" render.py --model_path "output/$name" --skip_train --skip_test --configs "$config"
}
if [ ! -e "$out/renders" ]; then
  if [ -z "${ENDOGAUSSIAN:-}" ]; then
    say "the film is ready; in EndoGaussian's folder, on a machine with a card, run"
    printf '  %s\n' "python train.py -s $out/endonerf --port 6017 --expname $name --configs $config" \
      "python render.py --model_path output/$name --skip_train --skip_test --configs $config" \
      "cp -r output/$name/video/ours_*/renders $out/renders"
    say "then call this script again."
    exit
  fi
  TIMEFORMAT='%R %U %S'
  (cd "$ENDOGAUSSIAN" && { time train 2>&3; } 3>&2 2>"$out/seconds.txt")
  # Its `video` set is all frames, in order.
  cp -r "$ENDOGAUSSIAN/output/$name"/video/ours_*/renders "$out/renders"
fi

# --- the prediction: the film's pixels of its 640x512 canvas -----------------------------------------------------------
# Depth is left out: render.py writes it in 8 bits, which end at 25.5 mm in these units.
make_python 'pillow>=11,<13'
"$own_python" "$root/scripts/others/endogaussian_row.py" "$out"
bring_in
