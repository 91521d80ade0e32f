from os import PathLike
from typing import Any, Literal

from .film import Film

class ProgramMissing(RuntimeError): ...

class ProgramFailed(RuntimeError):
    exit_code: int

def evaluate(
    truth: Film | str | PathLike[str],
    predictions: str | PathLike[str],
    *,
    method: str | None = None,
    out: str | PathLike[str] | None = None,
    threads: int | None = None,
) -> tuple[dict[str, dict[str, Any]], dict[str, str | int | float | None]]: ...
def export(
    sequence: Film | str | PathLike[str],
    format: str,
    out: str | PathLike[str],
    *,
    truth: bool = False,
    scale: float | None = None,
    axes: Literal["opengl", "opencv"] | None = None,
    threads: int | None = None,
) -> str: ...
