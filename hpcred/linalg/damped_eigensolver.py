"""Solve the quadratic eigenproblem (s^2 M + s D + K) x = 0 by SLEPc, shifted and inverted, for any real M, D, K.

States z = (x, s x / a), of twice the size, turn it into a linear one, in which a step with (A - shift B)^-1 B takes one
solve with shift^2 M + shift D + K. The factor a, an estimate of |s| for the wanted modes, keeps both halves of a state
alike. Each rank has its rows of x and then those of the second half.
"""

from __future__ import annotations

import numpy as np

from ..parallel.failures import ComputationError
from ..parallel.petsc import PETSc, SLEPc, is_complex
from .blocks import add_product, apply, column_norms, create_block, local_rows, random_block, times, unfold
from .eigensolver import solve_by

TOLERANCE = 1e-11
GUARD = 3  # more poles than are asked for


def damped_eigenpairs(M, D, K, count: int, shift: complex, solve):
    """Return poles (count or fewer,) nearest to the shift with imaginary parts of at least 0, by |s - shift|, and their
    modes x as pairs Re, Im of columns (see blocks.fold). Collective.

    D may be None. A complex shift needs a complex build. `solve(right, solution)` solves with shift^2 M + shift D + K
    for blocks that are a column in a real build, and the pair Re, Im of one in a complex build. Raises
    ComputationError.
    """
    operator = _Operator(M, D, K, shift, solve)
    rows, size = (2 * number for number in K.getLocalSize()[:1] + K.getSize()[:1])
    mat = PETSc.Mat().createPython(((rows, size), (rows, size)), operator, comm=K.comm)
    mat.setUp()
    eps = SLEPc.EPS().create(comm=K.comm)
    eps.setOptionsPrefix("damped_")
    eps.setOperators(mat)
    eps.setProblemType(SLEPc.EPS.ProblemType.NHEP)
    eps.setType(SLEPc.EPS.Type.KRYLOVSCHUR)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.LARGEST_MAGNITUDE)
    # near a real shift a pole comes with its conjugate
    wanted = min((count + GUARD) * (1 if np.imag(shift) else 2), size)
    eps.setDimensions(nev=wanted)
    eps.setTolerances(tol=TOLERANCE, max_it=500)
    start = mat.createVecRight()
    start.setArray(operator.start())
    eps.setInitialSpace([start])
    eps.setFromOptions()
    solve_by(eps, operator)
    poles, block = _upper(eps, K, count, shift, min(wanted, eps.getConverged()))
    eps.destroy()  # which refers to the solver of the caller
    if not len(poles):
        raise ComputationError(f"SLEPc found none of the {count} poles asked for")
    return poles, block


class _Operator:
    """(A - shift B)^-1 B of states.

    An exception must not pass through SLEPc, which it would leave in pieces: after one, the operator is the identity.
    """

    def __init__(self, M, D, K, shift, solve):
        self._matrices, self._solve, self.error = (M, D), solve, None
        self._shift = shift if is_complex() else np.real(shift)
        self._in, self._out = create_block(K, 1), create_block(K, 1)
        self._load, self._solution = (create_block(K, 1 + is_complex()) for _ in range(2))
        self._scale = 1.0
        self._begin = self._lowest(random_block(K, 1))

    def _lowest(self, block):
        """Return rows of a vector with much of the wanted modes, by solves with M, and set the scale from them."""
        sizes = []
        for _ in range(3):
            apply(self._matrices[0], block, self._out)
            with local_rows(self._out) as rows:
                force = rows[:, 0].copy()
            x = self._solved(force)
            with local_rows(block) as rows:
                rows[:, 0] = x
            sizes.append(column_norms(block)[0])
            with local_rows(block) as rows:
                rows[...] /= sizes[-1] or 1.0
        self._scale = sizes[-1] ** -0.5 if 0 < sizes[-1] < np.inf else 1.0
        with local_rows(block) as rows:
            return rows[:, 0].copy()

    def start(self):
        """Return the rows of a state to begin with."""
        return np.concatenate([self._begin, self._begin])

    def _times(self, mat, array):
        with local_rows(self._in) as rows:
            rows[:, 0] = array
        apply(mat, self._in, self._out)
        with local_rows(self._out) as rows:
            return rows[:, 0].copy()

    def _solved(self, force):
        with local_rows(self._load) as rows:
            if is_complex():
                rows[:, 0], rows[:, 1] = force.real, force.imag
            else:
                rows[:, 0] = force
        self._solve(self._load, self._solution)
        with local_rows(self._solution) as rows:
            return rows[:, 0] + 1j * rows[:, 1] if is_complex() else rows[:, 0].copy()

    def mult(self, _mat, state, result):
        try:
            if self.error is None:
                M, D = self._matrices
                one, two = np.split(state.getArray(readonly=True), 2)
                force = self._times(M, self._shift * one + self._scale * two)
                if D is not None:
                    force += self._times(D, one)
                x = -self._solved(force)
                result.setArray(np.concatenate([x, (one + self._shift * x) / self._scale]))
        except Exception as error:
            self.error = error
        if self.error is not None:
            state.copy(result)


def _upper(eps, K, count, shift, found):
    """Return the poles of the upper half plane, and their modes as pairs."""
    values = np.array([eps.getEigenvalue(i) for i in range(found)], dtype=complex)
    poles = shift + 1 / values
    # what a real matrix has as real, a complex build has but for round-off
    poles = np.where(np.abs(poles.imag) <= 1e-12 * np.abs(poles), poles.real, poles).astype(complex)
    upper = np.flatnonzero(poles.imag >= 0)
    upper = upper[np.argsort(np.abs(poles[upper] - shift), kind="stable")][:count]
    block = create_block(K, max(2 * len(upper), 1))
    re, im = (eps.getOperators()[0].createVecRight() for _ in range(2))
    with local_rows(block) as rows:
        for column, i in enumerate(upper):
            eps.getEigenvector(int(i), re, im)
            state = re.getArray(readonly=True)
            state = state if is_complex() else state + 1j * im.getArray(readonly=True)
            x = state[: len(rows)]
            rows[:, 2 * column], rows[:, 2 * column + 1] = x.real, x.imag
    return poles[upper], block


def damped_residuals(M, D, K, poles, block) -> np.ndarray:
    """Return ||(s^2 M + s D + K) x|| / (|s|^2 ||M x|| + |s| ||D x|| + ||K x||) of pairs of columns x. Collective."""
    total = times(K, block)
    size = _pair_norms(total)
    for mat, factor in ((D, poles), (M, poles**2)):
        if mat is not None:
            product = times(mat, block)
            size = size + np.abs(factor) * _pair_norms(product)
            add_product(total, product, unfold(np.diag(factor)))
    return _pair_norms(total) / np.maximum(size, 1e-300)


def _pair_norms(block):
    norms = column_norms(block)
    return np.hypot(norms[0::2], norms[1::2])
