"""Films of a breathing airway, predictions, scores, and a differentiable Gaussian rasteriser on CPU.

    film = load(folder)                what a method may see of a film; truth=True opens the rest
    write_prediction(folder, film, ..) an answer, as `respire-bench check` wants it
    evaluate(film, folder)             scores as a dict, and one flat row (runs `respire-bench`)
    export(film, format, folder)       a film in the layout of another program (runs `respire-bench`)
    rasterize(..)                      gsplat's `rasterization` on CPU, for torch or numpy

Millimetres, seconds, radians; camera axes as OpenCV (x right, y down, z forward).
"""

from ._native import Error, __version__
from .film import Film, Frame, Lazy, Mesh, TruthHidden, load
from .prediction import write_prediction
from .program import ProgramFailed, ProgramMissing, evaluate, export
from .splat import Meta, rasterize

__all__ = [
    "Error",
    "Film",
    "Frame",
    "Lazy",
    "Mesh",
    "Meta",
    "ProgramFailed",
    "ProgramMissing",
    "TruthHidden",
    "evaluate",
    "export",
    "load",
    "rasterize",
    "write_prediction",
]
