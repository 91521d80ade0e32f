"""What runs the installed program: scores need OpenCV, which the wheel does not have."""

import json
import os
import shutil
import subprocess

CURE = (
    "the program respire-bench is not installed: build it (`cargo build --release`) and put target/release on PATH, "
    "or name it in the environment variable RESPIRE_BENCH"
)


class ProgramMissing(RuntimeError):
    """The program `respire-bench` is neither on PATH nor in RESPIRE_BENCH."""


class ProgramFailed(RuntimeError):
    """The program stopped with an error: its sentence, and its exit code in `exit_code`."""

    def __init__(self, sentence, exit_code):
        super().__init__(sentence)
        self.exit_code = exit_code


def _program():
    named = os.environ.get("RESPIRE_BENCH")
    found = shutil.which(named or "respire-bench")
    if found is None:
        raise ProgramMissing(f"RESPIRE_BENCH is {named}, which is no program" if named else CURE)
    return found


def _folder(of):
    return os.fspath(getattr(of, "folder", of))


def _run(*arguments):
    done = subprocess.run([_program(), *map(str, arguments)], capture_output=True, text=True)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"respire-bench {arguments[0]} failed without a word"]
        raise ProgramFailed(lines[-1], done.returncode)
    return done.stdout


def evaluate(truth, predictions, *, method=None, out=None):
    """Scores a folder of predictions against a film with its truth: `respire-bench evaluate`.

    truth        the film (a `Film` or its folder); of a blind comparison, its `truth`
    predictions  the folder of predictions
    method       name of the method in tables; by default the one in `prediction.json`
    out          folder for the whole report: CSV, Markdown, LaTeX, HTML, plots

    Returns `(scores, row)`. `scores` is a dict by metric: `value` (`None` where there is none), `status`, `interval`,
    `deviation`, `count`, `detail` (docs/metrics.md). `row` is flat: `case`, `method`, `frames`, then the value of each
    metric. Raises `ProgramMissing`, with the cure, or `ProgramFailed`, with the program's sentence.
    """
    arguments = ["evaluate", "--sequence", _folder(truth), "--predictions", os.fspath(predictions), "--json"]
    arguments += ["--method", method] if method is not None else []
    arguments += ["--out", os.fspath(out)] if out is not None else []
    found = json.loads(_run(*arguments))
    scores = {score.pop("metric"): score for score in found["metrics"]}
    row = {"case": found["case_id"], "method": found["method"], "frames": found["frames"]}
    return scores, row | {metric: score["value"] for metric, score in scores.items()}


def export(sequence, format, out, *, truth=False, scale=None, axes=None):
    """Writes a film in the layout of another program: `respire-bench export`.

    format  `colmap`, `nerfstudio`, `endonerf`, `c3vd`, `tum` or `glb`
    out     a new folder
    truth   also what no method may see
    scale   units of lengths in a millimetre, instead of the layout's own
    axes    of `endonerf`: `opengl` (EndoNeRF, Deform3DGS; the default) or `opencv` (EndoGaussian)

    Returns `out`. Raises as `evaluate`.
    """
    arguments = ["export", _folder(sequence), "--format", format, "--out", os.fspath(out)]
    arguments += ["--truth"] if truth else []
    arguments += ["--scale", scale] if scale is not None else []
    arguments += ["--axes", axes] if axes is not None else []
    _run(*arguments)
    return os.fspath(out)
