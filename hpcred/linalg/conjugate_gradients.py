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


class EnergyBound:
    """Bounds the energy e^T A e of the error of each column by Gauss-Radau quadrature, where no eigenvalue of P A is
    below 1, with P the approximate inverse (Meurant & Tichy, Numer. Algorithms 62, 2013).

    `taken` (columns,): the energy that the steps have taken of it; `left`: what is left at most. A column is `small`
    where that is at most the `share` of the former.
    """

    def __init__(self, count: int, share: float):
        self.taken, self.left, self.share = np.zeros(count), np.full(count, np.inf), share
        self._bounds, self._products = np.full(count, np.inf), np.ones(count)  # left over r^T P r, and r^T P r

    def step(self, going, products, lengths):
        """Note the next step of the columns `going`: r^T P r before it, and its length."""
        before, growth = self._bounds[going], products[going] / self._products[going]
        bounds = np.divide(before, before + growth, out=np.ones_like(before), where=before < np.inf)
        # less than nothing is left where eigenvalues are below 1, which is no reason to end
        self._bounds[going], self._products[going] = np.abs(bounds - lengths[going]), products[going]
        self.left[going] = self._bounds[going] * products[going]
        self.taken[going] += lengths[going] * products[going]

    @property
    def small(self) -> np.ndarray:
        """Which columns are (columns,)."""
        return self.left <= self.share * self.taken


def conjugate_gradients(
    comm, multiply, precondition, residual, solution, targets, most: int, energy: EnergyBound | None = None
) -> np.ndarray:
    """Add to the solution what takes the residual below the targets, as far as its recurrence knows. Collective.

    Rows of this rank (rows, columns): `residual` = load - A solution, overwritten, and `solution`. `multiply(p, q)`:
    q = A p; `precondition(r, z)`, which may take round-off out of r. `targets` (columns,): of the 2-norms of the
    residuals. At most `most` iterations; they end as well where no column gets better any more (Hestenes & Stiefel,
    J. Res. NBS 49, 1952), and those of a column where its `energy` is small. Returns the iterations of each column
    (columns,). Raises NegativeCurvature.
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
        # z = P r, and the search direction p = z + (r^T z / r^T z before) p
        precondition(residual, z)
        product = summed(comm, _dot(residual, z))
        # about the energy of the error, which falls where the residual of thin bodies rises at first
        better = product < 0.25 * best
        best, since = np.where(better, product, best), 0 if better[going].any() else since + 1
        going &= _positive(product, going, size > NOISE * first, "the approximate inverse")
        for j in np.flatnonzero(going):
            p[:, j] *= product[j] / before[j]
            p[:, j] += z[:, j]
        # the step along p that makes the energy of the error least, r^T z / p^T A p
        multiply(p, q)
        curvature = summed(comm, _dot(p, q))
        going &= _positive(curvature, going, size > NOISE * first, "the matrix")
        lengths = np.divide(product, curvature, out=np.zeros(count), where=going)
        for j in np.flatnonzero(going):
            solution[:, j] += lengths[j] * p[:, j]
            residual[:, j] -= lengths[j] * q[:, j]
        still = going
        if energy is not None:
            energy.step(going, product, lengths)
            still = going & ~energy.small
        before = product
        iterations += going
    return iterations


def _dot(left, right):
    """Products of columns (columns,) on this rank."""
    return np.array([np.vdot(a, b).real for a, b in zip(left.T, right.T, strict=True)])


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
