"""Models that the field has published, each from the file of its publishers: `MODELS` by name.

    python -m benchmarks.models list
    python -m benchmarks.models make concrete --data FOLDER concrete.h5

From Python, `MODELS["concrete"].model()` is a SecondOrderModel and `MODELS["concrete"].matrices()` its SciPy matrices.
"""

from . import knuckle, nlevp, slicot
from .published import Arrays, Published

MODELS: dict[str, Published] = {model.name: model for model in (*slicot.MODELS, *nlevp.MODELS, *knuckle.MODELS)}

__all__ = ["MODELS", "Arrays", "Published"]
