"""Refuse ranges of parameters in which the mass of a reduced model, or its stiffness at 0 Hz, is singular somewhere."""

from __future__ import annotations

import numpy as np

from ...parallel.decisions import decided, shared_out
from ...parallel.failures import InputError
from ..result.parameter_accuracy import in_words
from .training import distances, halfway

NO_MASS = 1e-13  # pivots of M over its diagonal at the reference, relative to the largest, that may be round-off
ROUND_OFF = 1e-14  # eigenvalues of K, relative to the sum of the norms of its parts, that may be
HALVINGS = 20  # of the way between two points, to where K is singular
COUPLED = 1e-8  # part of the inputs and outputs in the motion that meets no force


def factor_of_mass(M: np.ndarray, values: dict[str, float], sizes: np.ndarray | float = 1.0) -> np.ndarray:
    """Return L (m, m) of M = L L^T at values of the parameters; local. Raises InputError where M is not positive
    definite. `sizes` (m,): the diagonal of M at the reference values, whose coordinates may have several units."""
    try:
        factor = np.linalg.cholesky((M + M.T) / 2)
    except np.linalg.LinAlgError:
        factor = np.zeros_like(M)
    pivots = np.diag(factor) ** 2 / sizes
    if not pivots.min(initial=np.inf) > NO_MASS * pivots.max(initial=0.0):
        raise InputError(
            f"at {in_words(values)}: the reduced mass matrix is not positive definite: terms of M leave some motions "
            "without mass; look at their factors, or take ranges without these values"
        )
    return factor


def check_static(projections, points, band):
    """Refuse ranges in which K becomes singular between some of the points, in a band (Hz) that begins at 0 Hz, where
    the response is infinite then. Collective."""
    if band[0]:
        return
    form = projections.form
    comm, parameters = form.parametric.comm, form.parametric.parameters
    # K is singular somewhere between two points with different numbers of eigenvalues below zero
    counts = np.array(shared_out(comm, lambda point: _yielding(projections.at(point)), points))

    def between(level):
        """Return the point where so many eigenvalues are no longer positive."""
        more, fewer = ([points[k] for k in np.flatnonzero(which)] for which in (counts >= level, counts < level))
        fewer = fewer[int(distances(parameters, fewer, more).argmin())]
        more = more[int(distances(parameters, more, [fewer]).argmin())]
        for _ in range(HALVINGS):
            middle = halfway(parameters, fewer, more)
            more, fewer = (middle, fewer) if _yielding(projections.at(middle)) >= level else (more, middle)
        return more

    # a motion that no input pushes, or no output sees, leaves the response finite
    def refuse():
        for point in map(between, np.unique(counts)[1:]):
            if _is_infinite(projections.at(point)):
                raise InputError(
                    f"{form.parametric.name}: K is singular, but for round-off, near {in_words(form.values(point))}, "
                    "where the response at 0 Hz is infinite; give a band that begins above 0, or ranges without these "
                    "values"
                )

    decided(comm, refuse)


def _yielding(models) -> int:
    """Return how many eigenvalues of K are not positive; of an unsymmetric K whether their product is not."""
    zero = ROUND_OFF * models.size_of_k
    if models.symmetric:
        return int((np.linalg.eigvalsh((models.K + models.K.T) / 2) <= zero).sum())
    return int(np.linalg.slogdet(models.K)[0] <= 0 or np.linalg.svd(models.K, compute_uv=False).min() <= zero)


def _is_infinite(models) -> bool:
    """Test whether inputs push, and outputs see, the motion that K resists least."""
    pushed, _, moved = np.linalg.svd(models.K)
    B, Ct = models.L @ models.io.inputs, models.L @ models.io.outputs
    shares = [np.linalg.norm(vector @ block) / np.linalg.norm(block) if block.any() else 0.0
             for vector, block in ((pushed[:, -1], B), (moved[-1], Ct))]  # fmt: skip
    return min(shares) > COUPLED
