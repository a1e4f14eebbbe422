"""Inputs and outputs in units far from those of the rest enter; a model leaves whose squares of them are numbers."""

from __future__ import annotations

from math import frexp, inf

import numpy as np

from ..parallel.failures import ComputationError

USUAL = 2.0**160  # largest entries up to this, and down to its inverse, are left as they are


def scales_of(model) -> tuple[float, float]:
    """Powers of 2 that the inputs and the outputs of a model are to be divided by, mostly 1. Collective."""
    scales = [_scale(model, mat) for mat in (model.B, model.Ct) if mat is not None]
    return (scales[0], scales[-1]) if scales else (1.0, 1.0)


def scaled(model, inputs: float, outputs: float):
    """The model with B / inputs, and C / outputs where it is not B^T. Collective; the caller closes it."""
    other = model.with_input_columns(model.B.getDenseArray().real / inputs, model.input_names)
    if model.Ct is None:
        return other
    with other:
        return other.with_output_columns(model.Ct.getDenseArray().real / outputs, model.output_names)


def unscaled(values: np.ndarray, factor: float) -> np.ndarray:
    """values * factor. Raises ComputationError beyond what double precision holds."""
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
