from .film import Film as Film, Frame as Frame, Lazy as Lazy, Mesh as Mesh, TruthHidden as TruthHidden, load as load
from .prediction import write_prediction as write_prediction
from .program import ProgramFailed as ProgramFailed, ProgramMissing as ProgramMissing
from .program import evaluate as evaluate, export as export
from .splat import Meta as Meta, rasterize as rasterize

__version__: str

class Error(Exception):
    """What went wrong, in one sentence."""
