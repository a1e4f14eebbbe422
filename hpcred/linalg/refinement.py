"""Improve solutions by iterative refinement, and tell their residuals."""

from math import inf

import numpy as np

from ..parallel.failures import ComputationError
from ..parallel.petsc import PETSc
from .blocks import add_product, apply, column_norms, create_block, local_rows

REFINE_ABOVE = 1e-10  # relative residual above which a step is made
STEPS = 2  # at most, with a full factor
LOW_RANK_STEPS = 12  # at most, when the factor is approximate


class IllConditioned(ComputationError):
    """Solutions with a factor stay inaccurate."""


def refine(matrix, back_substitute, load, solution, scale=None, steps=0, low_rank=None) -> float:
    """Improve solution = matrix^-1 load while its residual is large; returns the relative residual. Collective.

    `back_substitute(load, solution)` solves approximately; residuals are relative to `scale` (columns,), by default
    the norms of the load; `steps` are made in any case. `low_rank`: the accuracy of an approximate factor.
    Raises ComputationError when the residual stays large.
    """
    scale = column_norms(load) if scale is None else scale
    most, before = STEPS if low_rank is None else LOW_RANK_STEPS, inf
    columns = np.diff(load.getActiveColumns())[0]
    residual = create_block(matrix, columns)
    for step in range(most + 1):
        apply(matrix, solution, residual)
        with local_rows(load) as b, local_rows(residual) as rows:
            np.subtract(b, rows, out=rows)
        r, x = column_norms(residual, solution)
        relative = _relative(r, x, scale)
        small_or_stuck = relative <= REFINE_ABOVE or relative > before / 2
        if step == most or not relative < inf or (step >= steps and small_or_stuck):
            break
        correction = create_block(matrix, columns)
        back_substitute(residual, correction)
        add_product(solution, correction, np.eye(columns))
        del correction  # its memory is for the next one
        before = relative
    if relative <= REFINE_ABOVE or (low_rank is None and relative < 1e-6):
        return relative
    backward = inf
    if relative < inf:  # ||r|| / (||A|| ||x|| + ||b||)
        norm = matrix.norm(PETSc.NormType.INFINITY)
        backward = float((r / np.maximum(norm * x + scale, 1e-300))[scale > 0].max())
    if low_rank is not None and backward >= 1e-14:
        raise ComputationError(
            f"low_rank: the residual stays at {relative:.1e} after {most} steps of refinement; take less than "
            f"{low_rank:g}, or leave it out"
        )
    if backward >= 1e-12:
        raise IllConditioned(
            f"the solution has a relative residual of {relative:.1e} (backward error {backward:.1e}): "
            "the matrix is too ill-conditioned to be solved"
        )
    return relative


def _relative(r, x, scale):
    """Largest ||r|| / ||b|| over the columns; infinite where a number is not finite."""
    if not (np.isfinite(r).all() and np.isfinite(x).all()):
        return inf
    loaded = scale > 0
    return float((r[loaded] / scale[loaded]).max(initial=0.0))
