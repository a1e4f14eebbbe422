"""Estimate how many iterations conjugate gradients will take, from the eigenvalues that a few of them see."""

from __future__ import annotations

from math import inf, log

import numpy as np

from ..parallel.decisions import decided
from ..parallel.sums import summed

SETTLED, LATELY, LEAST = 0.05, 4, 8  # the least eigenvalue changed by less in the last steps, after so many at least
ROUND_OFF = 1e-12  # of the first residual: what is left has nothing more to tell


def ritz_values(comm, multiply, precondition, residual, steps: int) -> np.ndarray:
    """Return eigenvalues of P A, ascending, as Lanczos' method sees them in at most so many steps. Collective.

    Rows of this rank (rows, 1): `residual` to begin with, overwritten; `multiply(p, q)`: q = A p;
    `precondition(r, z)`: z = P r. Steps end early where the least one settles, and at a negative curvature, of which
    the last value tells: it is then negative, and the only one (Golub & Van Loan, Matrix computations, 2013, 11.3.5).
    """
    z, q, p = np.empty_like(residual), np.empty_like(residual), np.zeros_like(residual)
    before = last = first = None  # of r^T P r, and of the steps
    diagonal, beside, least = [], [], []
    for _ in range(steps):
        # a step of conjugate gradients
        precondition(residual, z)
        product = _dot(comm, residual, z)
        first = product if first is None else first
        if product < 0:
            return np.array([-inf])
        if product <= ROUND_OFF**2 * first:
            break
        ratio = product / before if before else 0.0
        p *= ratio
        p += z
        multiply(p, q)
        curvature = _dot(comm, p, q)
        if curvature <= 0:
            return np.array([-inf])
        step = product / curvature
        residual -= step * q
        # whose lengths are the entries of the tridiagonal matrix of Lanczos
        diagonal.append(1 / step + (ratio / last if last else 0.0))
        if last:
            beside.append(ratio**0.5 / last)
        before, last = product, step
        values = decided(comm, np.linalg.eigvalsh, np.diag(diagonal) + np.diag(beside, 1) + np.diag(beside, -1))
        least.append(values[0])
        if len(least) >= LEAST and least[-LATELY] - least[-1] < SETTLED * least[-1]:
            break
    return values if least else np.ones(1)


def iterations_to(reduction: float, values: np.ndarray) -> int:
    """Return how many iterations take the error below `reduction` at least, by the bound of Chebyshev polynomials."""
    return int(np.ceil((values[-1] / values[0]) ** 0.5 * log(2 / reduction) / 2))


def rate(values: np.ndarray) -> float:
    """Return the factor of the error in an iteration."""
    root = (values[-1] / values[0]) ** 0.5
    return (root - 1) / (root + 1)


def _dot(comm, left, right):
    return float(summed(comm, np.vdot(left, right).real))
