"""Models that the field has published, each from the file of its publishers: `MODELS` by name.

    python -m benchmarks.models list
    python -m benchmarks.models make concrete --data FOLDER concrete.h5

From Python, `MODELS["concrete"].model()` is a SecondOrderModel and `MODELS["concrete"].matrices()` its SciPy matrices.
"""

from . import knuckle, morwiki, nlevp, slicot
from .published import Arrays, Published

_FAMILIES = (slicot, nlevp, knuckle, morwiki)
MODELS: dict[str, Published] = {model.name: model for family in _FAMILIES for model in family.MODELS}

__all__ = ["MODELS", "Arrays", "Published"]
