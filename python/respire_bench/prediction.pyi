from collections.abc import Iterable, Mapping
from os import PathLike

from numpy.typing import ArrayLike

from .film import Film, Mesh

_PerFrame = ArrayLike | Iterable[ArrayLike] | Mapping[int, ArrayLike]

def write_prediction(
    folder: str | PathLike[str],
    film: Film,
    color: _PerFrame,
    *,
    depth_mm: _PerFrame | None = None,
    ahead: _PerFrame | None = None,
    novel: _PerFrame | None = None,
    novel_depth_mm: _PerFrame | None = None,
    phase: _PerFrame | None = None,
    phase_sd: _PerFrame | None = None,
    poses: _PerFrame | None = None,
    targets_mm: _PerFrame | None = None,
    target_covariance_mm2: _PerFrame | None = None,
    mesh: Mesh | tuple[ArrayLike, ArrayLike] | None = None,
    method: str | None = None,
    time_total_s: float | None = None,
    time_cpu_s: float | None = None,
) -> None: ...
