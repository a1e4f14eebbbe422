"""Conjugate gradients for a block of loads, each column by itself: rows of this rank enter, solutions leave."""

from __future__ import annotations

import numpy as np

from ..parallel.failures import ComputationError

STALLED = 40  # iterations in which no residual came down to half of its best


class NegativeCurvature(ComputationError):
    """The matrix, or what stands for its inverse, is not positive definite."""


def conjugate_gradients(comm, multiply, precondition, residual, solution, targets, most: int) -> np.ndarray:
    """Add to the solution what takes the residual below the targets, as far as its recurrence knows. Collective.

    Rows of this rank (rows, columns): `residual` = load - A solution, overwritten, and `solution`. `multiply(p, q)`:
    q = A p; `precondition(r, z)`. `targets` (columns,): of the 2-norms of the residuals. At most `most` iterations;
    they end as well where no column gets better any more (Hestenes & Stiefel, J. Res. NBS 49, 1952). Returns the
    iterations of each column (columns,). Raises NegativeCurvature.
    """
    count = residual.shape[1]
    iterations = np.zeros(count, dtype=int)
    z, q, p = np.empty_like(residual), np.empty_like(residual), np.zeros_like(residual)
    before, best, since = np.ones(count), np.full(count, np.inf), 0
    for _ in range(most):
        size = np.sqrt(comm.allreduce(_dot(residual, residual)))
        going = size > targets
        better = size < 0.5 * best
        best, since = np.where(better, size, best), 0 if better[going].any() else since + 1
        if not going.any() or since > STALLED or not np.isfinite(size).all():
            break
        precondition(residual, z)
        product = comm.allreduce(_dot(residual, z))
        _check(product[going], "the cycle of multigrid")
        for j in np.flatnonzero(going):
            p[:, j] *= product[j] / before[j]
            p[:, j] += z[:, j]
        multiply(p, q)
        curvature = comm.allreduce(_dot(p, q))
        _check(curvature[going], "the matrix")
        for j in np.flatnonzero(going):
            solution[:, j] += product[j] / curvature[j] * p[:, j]
            residual[:, j] -= product[j] / curvature[j] * q[:, j]
        before = product
        iterations += going
    return iterations


def _dot(one, other):
    """Products of columns (columns,) on this rank."""
    return np.array([np.vdot(a, b).real for a, b in zip(one.T, other.T, strict=True)])


def _check(products, what):
    if (products <= 0).any():
        raise NegativeCurvature(f"{what} is not positive definite: conjugate gradients met a negative curvature")
