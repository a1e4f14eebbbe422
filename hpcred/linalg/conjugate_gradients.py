"""Solve for a block of loads by conjugate gradients, each column by itself."""

from __future__ import annotations

import numpy as np

from ..parallel.failures import ComputationError
from ..parallel.sums import summed

STALLED = 40  # iterations in which no error came down to half of its best, by its energy
NOISE = 1e-6  # of the first residual: below, a product that is not positive may be round-off


class NotSolved(ComputationError):
    """Conjugate gradients did not come to a small residual."""


class NegativeCurvature(NotSolved):
    """The matrix, or what stands for its inverse, is not positive definite."""


def conjugate_gradients(comm, multiply, precondition, residual, solution, targets, most: int) -> np.ndarray:
    """Add to the solution what takes the residual below the targets, as far as its recurrence knows. Collective.

    Rows of this rank (rows, columns): `residual` = load - A solution, overwritten, and `solution`. `multiply(p, q)`:
    q = A p; `precondition(r, z)`, which may take round-off out of r. `targets` (columns,): of the 2-norms of the
    residuals. At most `most` iterations; they end as well where no column gets better any more (Hestenes & Stiefel,
    J. Res. NBS 49, 1952). Returns the iterations of each column (columns,). Raises NegativeCurvature.
    """
    count = residual.shape[1]
    iterations = np.zeros(count, dtype=int)
    z, q, p = np.empty_like(residual), np.empty_like(residual), np.zeros_like(residual)
    before, best, since, still = np.ones(count), np.full(count, np.inf), 0, np.ones(count, dtype=bool)
    first = None
    for _ in range(most):
        size = np.sqrt(summed(comm, _dot(residual, residual)))
        first = size if first is None else first
        going = still & (size > targets)
        if not going.any() or since > STALLED or not np.isfinite(size).all():
            break
        precondition(residual, z)
        product = summed(comm, _dot(residual, z))
        # about the energy of the error, which falls where the residual of thin bodies rises at first
        better = product < 0.25 * best
        best, since = np.where(better, product, best), 0 if better[going].any() else since + 1
        going &= _positive(product, going, size > NOISE * first, "the approximate inverse")
        for j in np.flatnonzero(going):
            p[:, j] *= product[j] / before[j]
            p[:, j] += z[:, j]
        multiply(p, q)
        curvature = summed(comm, _dot(p, q))
        going &= _positive(curvature, going, size > NOISE * first, "the matrix")
        for j in np.flatnonzero(going):
            solution[:, j] += product[j] / curvature[j] * p[:, j]
            residual[:, j] -= product[j] / curvature[j] * q[:, j]
        before, still = product, going
        iterations += going
    return iterations


def _dot(one, other):
    """Products of columns (columns,) on this rank."""
    return np.array([np.vdot(a, b).real for a, b in zip(one.T, other.T, strict=True)])


def _positive(products, going, large, what):
    """Where products are positive, refused where they are not though the residual is large."""
    positive = products > 0
    if (going & large & ~positive).any():
        raise negative_curvature(what)
    return positive


def negative_curvature(what) -> NegativeCurvature:
    """Return what to raise where the matrix, or the approximate inverse, is not positive definite."""
    return NegativeCurvature(
        f"{what} is not positive definite: conjugate gradients met a negative curvature; K may be indefinite, or "
        "singular, so that the body can move freely: take frame kind 'buckens', 'chord' or 'tangent', or "
        "solver.kind 'direct'; above 0 Hz, the basis may lack a mode below the point"
    )
