# Sourced by the scripts of this folder: what is the same for every method of others (docs/others.md).
#
#   scripts/others/METHOD.sh --out DIR [--case CASE] [--profile P] [--report REPORT]
#
#   DIR/film         truth, and what the method may see
#   DIR/prediction   what the method answers, in the folder of docs/predictions.md
#   DIR/scores       the report of its row
#   DIR/table        the row beside those of REPORT, which has scores of the same film (default: none is merged)
#
# The caller sets $program, its name in messages, and $method, the row's name. RESPIRE_BENCH chooses our program.
. "$(dirname "${BASH_SOURCE[0]}")/../packages.sh"
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
bench=$(readlink -f "${RESPIRE_BENCH:-$root/target/release/respire-bench}")
[ -x "$bench" ] || stop "there is no program $bench; build it first: cargo build --release"

case_id=case1 profile=quick out='' report=''
usage() { printf 'usage: scripts/others/%s.sh --out DIR [--case CASE] [--profile P] [--report REPORT]\n' "$program" >&2; exit 2; }
while [ $# -gt 0 ]; do
  [ $# -ge 2 ] || usage
  case $1 in
    --out) out=$2 ;;
    --case) case_id=$2 ;;
    --profile) profile=$2 ;;
    --report) report=$2 ;;
    *) usage ;;
  esac
  shift 2
done
[ -n "$out" ] || usage
# Said before hours of training, not after.
# The films that these methods get are of the ideal track; where both were run, its report is one of two.
[ ! -f "$report/ideal/results.csv" ] || report=$report/ideal
[ -z "$report" ] || [ -f "$report/results.csv" ] || stop "--report: $report holds no results.csv of the ideal track."
end=$out/scores
[ -z "$report" ] || end=$out/table
[ ! -e "$end" ] || { printf '%s: %s is there already; nothing is overwritten.\n' "$program" "$end" >&2; exit 4; }
mkdir -p "$out"
out=$(cd "$out" && pwd)
participant=$out/film/participant

# make_film: the film, unless a run before has made it. Several methods may share one.
make_film() {
  [ -e "$participant/participant.json" ] || "$bench" simulate "$case_id" --profile "$profile" --blind "$out/film"
}

# export_film FORMAT [OPTION...]: what the method may see in its own layout, in DIR/FORMAT.
export_film() {
  [ -e "$out/$1" ] || "$bench" export "$participant" --format "$1" --out "$out/$1" "${@:2}"
}

# make_python PACKAGE...: a Python of its own in DIR/python; $own_python runs it.
make_python() {
  own_python=$out/python/bin/python
  [ ! -e "$out/python/.ok" ] || return 0
  say "making a Python with $*"
  python3 -m venv "$out/python" || stop "python3 makes no venv here (Debian: package python3-venv)."
  "$own_python" -m pip install -q --disable-pip-version-check --only-binary=:all: "$@" ||
    stop "pip could not install $*."
  touch "$out/python/.ok"
}

# bring_in: scores the prediction, and puts its row beside those of the report.
bring_in() {
  if [ ! -e "$out/scores" ]; then
    "$bench" check "$out/prediction" --sequence "$participant"
    "$bench" evaluate --truth "$out/film/truth" --predictions "$out/prediction" --method "$method" --out "$out/scores"
  fi
  [ -z "$report" ] || "$bench" merge "$report" "$out/scores" --out "$out/table"
}

# A prediction that is there is whole: it is brought in, and not made again, after what failed behind it.
if [ -e "$out/prediction" ]; then
  say "$out/prediction is there; its row is brought in"
  bring_in
  exit
fi
