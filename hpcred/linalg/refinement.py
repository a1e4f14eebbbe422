"""Improve solutions by iterative refinement, and tell their residuals."""

from math import inf

import numpy as np

from ..parallel.failures import ComputationError
from ..parallel.petsc import PETSc
from ..parallel.sums import summed
from .blocks import add_product, apply, column_norms, create_block, local_rows, random_block, times

REFINE_ABOVE = 1e-10  # relative residual above which a step is made
STEPS = 2  # at most, with a full factor
APPROXIMATE_STEPS = 20  # at most, when the factor is approximate
SURE, SURE_STEPS, COLUMNS = 1e-6, 20, 4  # what is left of random columns, after so many steps, if they converge
KEPT = 4  # of the last corrections, beside which the next one is chosen then


class IllConditioned(ComputationError):
    """Solutions with a factor stay inaccurate."""


def refine(matrix, back_substitute, load, solution, scale=None, steps=0, approximate=None) -> float:
    """Improve solution = matrix^-1 load while its residual is large; returns the relative residual. Collective.

    `back_substitute(load, solution)` solves approximately; residuals are relative to `scale` (columns,), by default
    the norms of the load; `steps` are made in any case. `approximate`: the sentence for a factor which is, with {} for
    what was found. Raises ComputationError when the residual stays large.
    """
    scale = column_norms(load) if scale is None else scale
    most, enough = (STEPS, 0.5) if approximate is None else (APPROXIMATE_STEPS, 0.9)
    before, kept = inf, []
    columns = np.diff(load.getActiveColumns())[0]
    residual = create_block(matrix, columns)
    # r = b - A x, and x + A^-1 r in place of x, while that makes r smaller
    for step in range(most + 1):
        apply(matrix, solution, residual)
        with local_rows(load) as b, local_rows(residual) as rows:
            np.subtract(b, rows, out=rows)
        r, x = column_norms(residual, solution)
        relative = _relative(r, x, scale)
        small_or_stuck = relative <= REFINE_ABOVE or relative > enough * before
        if step == most or not relative < inf or (step >= steps and small_or_stuck):
            break
        correction = create_block(matrix, columns)
        back_substitute(residual, correction)
        if approximate is None:
            add_product(solution, correction, np.eye(columns))
        else:
            kept = _least_residual(matrix, correction, residual, solution, kept)
        del correction  # its memory is for the next one
        before = relative
    if relative <= REFINE_ABOVE or (approximate is None and relative < 1e-6):
        return relative
    # a large residual is right where x is large: the backward error ||r|| / (||A|| ||x|| + ||b||) decides
    backward = inf
    if relative < inf:
        norm = matrix.norm(PETSc.NormType.INFINITY)
        backward = float((r / np.maximum(norm * x + scale, 1e-300))[scale > 0].max())
    if approximate is not None and backward >= 1e-14:
        raise ComputationError(
            approximate.format(f"the residual stays at {relative:.1e} after {step} steps of refinement")
        )
    if backward >= 1e-12:
        raise IllConditioned(
            f"the solution has a relative residual of {relative:.1e} (backward error {backward:.1e}): "
            "the matrix is too ill-conditioned to be solved"
        )
    return relative


def refinement_converges(matrix, back_substitute) -> bool:
    """Test whether plain refinement converges on random columns: then a symmetric factor F has the inertia of A.

    The errors of refinement are multiplied by F^-1 (F - A). Where all eigenvalues of that are below 1, no matrix
    F - t (F - A), 0 <= t <= 1, is singular, so that no eigenvalue changes its sign from F to A. F^-1 of random columns
    has most of the eigenvectors that F is nearly singular for, where signs change first. Collective.
    """
    load, error, image = random_block(matrix, COLUMNS), create_block(matrix, COLUMNS), create_block(matrix, COLUMNS)
    back_substitute(load, error)
    first = column_norms(error)
    for _ in range(SURE_STEPS):
        apply(matrix, error, image)
        back_substitute(image, load)
        with local_rows(load) as rows, local_rows(error) as errors:
            errors -= rows
        left = float((column_norms(error) / first).max())
        if not left < 1.0 / SURE:  # it grows, or has become NaN
            return False
        if left <= SURE:
            return True
    return False


def _least_residual(matrix, correction, residual, solution, kept):
    """Add to each column of the solution what of a correction, beside the last ones, leaves the smallest residual.

    Corrections of a factor that is far off, alone, would not converge (generalised conjugate residuals: Eisenstat,
    Elman & Schultz, SIAM J. Numer. Anal. 20(2), 1983). `kept`: pairs of corrections and their orthonormal images,
    returned with this one. Collective.
    """
    comm = matrix.comm.tompi4py()
    image = times(matrix, correction)
    with local_rows(correction) as d, local_rows(image) as q, local_rows(residual) as r:
        for earlier, its_image in kept:
            share = summed(comm, (its_image.conj() * q).sum(axis=0))
            d -= share * earlier
            q -= share * its_image
        size = np.sqrt(summed(comm, (abs(q) ** 2).sum(axis=0)))
        length = np.where(size > 0, size, 1.0)
        d /= length
        q /= length
        with local_rows(solution) as x:
            x += summed(comm, (q.conj() * r).sum(axis=0)) * d
        return [*kept, (d.copy(), q.copy())][-KEPT:]


def _relative(r, x, scale):
    """Largest ||r|| / ||b|| over the columns; infinite where a number is not finite."""
    if not (np.isfinite(r).all() and np.isfinite(x).all()):
        return inf
    loaded = scale > 0
    return float((r[loaded] / scale[loaded]).max(initial=0.0))
