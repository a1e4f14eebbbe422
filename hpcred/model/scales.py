"""Scale inputs and outputs whose units are far from those of the rest, so that their squares are numbers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from math import frexp, inf

import numpy as np

from ..linalg.blocks import dense_matrix
from ..parallel.failures import ComputationError

USUAL = 2.0**160  # largest entries up to this, and down to its inverse, are left as they are


@contextmanager
def in_usual_units(model) -> Iterator[tuple]:
    """The model with B / inputs, and C / outputs where it is not B^T, and these factors: powers of 2, mostly 1.
    Collective."""
    scales = [_scale(model, mat) for mat in (model.B, model.Ct) if mat is not None]
    inputs, outputs = (scales[0], scales[-1]) if scales else (1.0, 1.0)
    if (inputs, outputs) == (1.0, 1.0):
        yield model, 1.0, 1.0
        return
    usual = model.with_input_columns(model.B.getDenseArray().real / inputs, model.input_names)
    if model.rates.direct is not None:
        usual = usual.with_fields(rates=replace(model.rates, direct=model.rates.direct / (inputs * outputs)))
    if model.Ct is not None:
        usual = usual.with_fields(Ct=dense_matrix(model.K, model.Ct.getDenseArray().real / outputs))
    yield usual, inputs, outputs


def unscaled(values: np.ndarray, factor: float) -> np.ndarray:
    """Return values * factor. Raises ComputationError beyond what double precision holds."""
    if factor == 1:
        return values
    with np.errstate(over="ignore", invalid="ignore"):
        values = values * factor
    if not np.isfinite(values).all():
        raise ComputationError(
            "the response is beyond what double precision holds; scale the inputs and outputs to units that fit"
        )
    return values


def _scale(model, mat) -> float:
    largest = max(model.comm.allgather(float(np.abs(mat.getDenseArray().real).max(initial=0.0))))
    if not 0 < largest < inf or 1 / USUAL <= largest <= USUAL:
        return 1.0
    return 2.0 ** min(max(frexp(largest)[1], -1000), 1000)
