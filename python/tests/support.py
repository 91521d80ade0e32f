"""What the tests share: scenes, the program, and a loud way to skip."""

import atexit
import multiprocessing
import os
import shutil
import subprocess
import sys
import tempfile
import unittest

import numpy as np

sys.path.insert(0, os.path.join(os.path.dirname(__file__), "..", "benchmarks"))

try:
    import torch
except ImportError:
    torch = None

PROGRAM = shutil.which(os.environ.get("RESPIRE_BENCH", "respire-bench"))
EXAMPLES = os.path.join(os.path.dirname(__file__), "..", "examples")


def needs(what, sentence):
    """Skips a class of tests where `what` is missing, and says so."""
    if what is None:
        print(f"SKIPPED: {sentence}", file=sys.stderr)
    return unittest.skipIf(what is None, sentence)


def program(*arguments):
    return subprocess.run([PROGRAM, *arguments], capture_output=True, text=True, check=True).stdout


def forked(compute, seconds=60):
    """What `compute` gives in a fork of this process, which is ended if it hangs."""
    fork = multiprocessing.get_context("fork")
    ours, theirs = fork.Pipe(False)
    child = fork.Process(target=lambda: theirs.send(compute()))
    child.start()
    theirs.close()
    try:
        if not ours.poll(seconds):
            raise AssertionError(f"a forked child has no answer after {seconds} s")
        return ours.recv()
    finally:
        child.kill()
        child.join()


_folders = {}


def films(clinical=False, pinhole=False):
    """The folder of a blind comparison of nine frames: `truth` and `participant`; each kind is filmed once."""
    kind = (clinical, pinhole)
    if kind not in _folders:
        folder = _folders[kind] = tempfile.mkdtemp(prefix="respire-bench-test-")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        more = ["--track", "clinical"] if clinical else []
        more += ["--without", "distortion"] if pinhole else []
        program("simulate", "case4", "--blind", folder, "--frames", "9", "--width", "48", "--spp", "4", *more)
    return _folders[kind]


def scene(n=30, seed=0, dtype=np.float64, width=40, height=32, coefficients=None, channels=3):
    """A cloud of Gaussians before a camera: what `rasterize` takes, without an opacity near a threshold."""
    r = np.random.default_rng(seed)
    quats = r.standard_normal((n, 4))
    colors = (n, channels) if coefficients is None else (n, coefficients, 3)
    arrays = {
        "means": r.uniform([-1.5, -1.2, 3], [1.5, 1.2, 6], (n, 3)),
        "quats": quats / np.linalg.norm(quats, axis=-1, keepdims=True) * r.uniform(0.7, 1.5, (n, 1)),
        "scales": r.uniform(0.08, 0.4, (n, 3)),
        "opacities": r.uniform(0.2, 0.9, n),
        "colors": r.standard_normal(colors) * 0.4,
    }
    turn = np.array([[0.9950, -0.0998, 0.0], [0.0998, 0.9950, 0.0], [0, 0, 1]])
    turn, _ = np.linalg.qr(turn)
    turn *= np.sign(np.diag(turn))
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = turn, [0.1, -0.05, 0.2]
    focal = 0.9 * width
    K = np.array([[focal, 0, width / 2], [0, focal * 1.05, height / 2], [0, 0, 1]])
    arrays |= {"viewmats": viewmat[None], "Ks": K[None]}
    arrays = {name: np.ascontiguousarray(array, dtype=dtype) for name, array in arrays.items()}
    return arrays | {"width": width, "height": height}
