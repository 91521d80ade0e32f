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
        # Both, since that is what another process makes it anew from.
        super().__init__(sentence, exit_code)
        self.exit_code = exit_code

    def __str__(self):
        return str(self.args[0])


def _program():
    named = os.environ.get("RESPIRE_BENCH")
    found = shutil.which(named or "respire-bench")
    if found is None:
        raise ProgramMissing(f"RESPIRE_BENCH is {named}, which is no program" if named else CURE)
    return found


def _folder(of):
    """A film or a path, as an argument that is no option."""
    path = os.fspath(getattr(of, "folder", of))
    return os.path.join(".", path) if path.startswith("-") else path


def _sentence(said):
    """The last error of a program, in one line; else its last line."""
    lines = [line.strip() for line in said.splitlines()]
    starts = [number for number, line in enumerate(lines) if line.startswith("error: ")]
    if not starts:
        return next((line for line in reversed(lines) if line), "")
    end = lines.index("", starts[-1]) if "" in lines[starts[-1] :] else len(lines)
    return " ".join(lines[starts[-1] : end]).removeprefix("error: ")


def _run(command, *arguments, **options):
    """What the program prints. An option that is `None` is left out."""
    named = [f"--{name}={value}" for name, value in options.items() if value is not None]
    done = subprocess.run([_program(), command, *arguments, *named], capture_output=True, text=True)
    if done.returncode:
        sentence = _sentence(done.stderr) or f"respire-bench {command} failed without a word"
        raise ProgramFailed(sentence, done.returncode)
    return done.stdout


def evaluate(truth, predictions, *, method=None, out=None, threads=None):
    """Scores a folder of predictions against a film with its truth: `respire-bench evaluate`.

    truth        the film (a `Film` or its folder); of a blind comparison, its `truth`
    predictions  the folder of predictions
    method       name of the method in tables; by default the one in `prediction.json`
    out          folder for the whole report: CSV, Markdown, LaTeX, HTML, plots
    threads      how many; by default one per core

    Returns `(scores, row)`. `scores` is a dict by metric: `value` (`None` where there is none), `status`, `interval`,
    `deviation`, `count`, `detail` (docs/metrics.md). `row` is flat: `case`, `method`, `frames`, then the value of each
    metric. Raises `ProgramMissing`, with the cure, or `ProgramFailed`, with the program's sentence.
    """
    said = _run(
        "evaluate",
        "--json",
        sequence=_folder(truth),
        predictions=_folder(predictions),
        method=method,
        out=None if out is None else _folder(out),
        threads=threads,
    )
    found = json.loads(said)
    if isinstance(found, list):
        raise ValueError(
            f"truth: {_folder(truth)} holds {len(found)} films: call evaluate for each; with `out` their report is written"
        )
    scores = {score.pop("metric"): score for score in found["metrics"]}
    row = {"case": found["case_id"], "method": found["method"], "frames": found["frames"]}
    return scores, row | {metric: score["value"] for metric, score in scores.items()}


def export(sequence, format, out, *, truth=False, scale=None, axes=None, threads=None):
    """Writes a film in the layout of another program: `respire-bench export`.

    format  `colmap`, `nerfstudio`, `endonerf`, `c3vd`, `tum` or `glb`
    out     a new folder
    truth   also what no method may see
    scale   units of lengths in a millimetre, instead of the layout's own
    axes    of `endonerf`: `opengl` (EndoNeRF, Deform3DGS; the default) or `opencv` (EndoGaussian)
    threads how many; by default one per core

    Returns `out`. Raises as `evaluate`.
    """
    flags = ["--truth"] if truth else []
    options = {"format": format, "out": _folder(out), "scale": scale, "axes": axes, "threads": threads}
    _run("export", _folder(sequence), *flags, **options)
    return os.fspath(out)
