"""Solve the quadratic eigenproblem (s^2 M + s D + K) x = 0 by SLEPc, shifted and inverted, for any real M, D, K.

States z = (x, s x / a), of twice the size, turn it into a linear one, in which a step with (A - shift B)^-1 B takes one
solve with shift^2 M + shift D + K. The factor a, an estimate of |s| for the wanted modes, keeps both halves of a state
alike. Each rank has its rows of x and then those of the second half.
"""

from __future__ import annotations

import numpy as np

from ..parallel.decisions import decided
from ..parallel.failures import ComputationError
from ..parallel.petsc import PETSc, SLEPc, is_complex
from ..parallel.sums import summed
from .blocks import add_product, apply, column_norms, create_block, local_rows, random_block, times, unfold
from .eigensolver import solve_by

TOLERANCE = 1e-11
GUARD = 3  # more poles than are asked for
SAME = 1e-7  # relative difference of poles that is none
SPACE = 60  # vectors of a Krylov space at least: with SLEPc's default, twice the modes, close poles stall
DEPENDENT = 1e-6  # part of a vector beside others that is round-off


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
    # near a real shift a pole comes with its conjugate
    pair = 1 if np.imag(shift) else 2
    wanted, begin = min((count + GUARD) * pair, size), operator.start()
    states, poles, first = [], np.zeros(0), True
    while wanted:
        new = _independent(states, _invariant_states(mat, operator, wanted, states, begin))
        states, before = states + new, poles
        poles, vectors = _upper(mat, states, count, shift)
        if not new or (len(before) == len(poles) and (np.abs(poles - before) <= SAME * np.abs(poles - shift)).all()):
            break
        # one more tells whether there are others; where there are, they may be many
        wanted = min(pair if first else 2 * wanted, size - len(states))
        first, begin = False, operator.random(len(states))
    if not len(poles):
        raise ComputationError(f"SLEPc found none of the {count} poles asked for")
    return poles, _modes(K, states, vectors)


def _invariant_states(mat, operator, wanted, states, begin):
    """Return orthonormal vectors that span, with the `states`, what is invariant of the largest eigenvalues.

    A Krylov sequence from one vector has one mode of a repeated pole; other sequences, orthogonal to the states found,
    have the others.
    """
    eps = SLEPc.EPS().create(comm=mat.comm)
    eps.setOptionsPrefix("damped_")
    eps.setOperators(mat)
    eps.setProblemType(SLEPc.EPS.ProblemType.NHEP)
    eps.setType(SLEPc.EPS.Type.KRYLOVSCHUR)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.LARGEST_MAGNITUDE)
    eps.setDimensions(nev=wanted, ncv=min(max(2 * wanted, SPACE), mat.getSize()[0] - len(states)))
    eps.setTolerances(tol=TOLERANCE, max_it=500)
    start = mat.createVecRight()
    start.setArray(begin)
    eps.setInitialSpace([start])
    if states:
        eps.setDeflationSpace(states)
    eps.setFromOptions()
    solve_by(eps, operator)
    invariant = eps.getInvariantSubspace() if eps.getConverged() else []
    eps.destroy()  # which refers to the solver of the caller
    return invariant


def _independent(states, vectors):
    """Return the vectors, orthonormal to the states and to each other, without those in their span."""
    new = []
    for vector in vectors:
        known, before = states + new, vector.norm()
        for _ in range(2 if known else 0):
            vector.maxpy(-_products(known, vector), known)
        size = vector.norm()
        if size > DEPENDENT * before:
            vector.scale(1 / size)
            new.append(vector)
    return new


class _Operator:
    """(A - shift B)^-1 B of states.

    An exception must not pass through SLEPc, which it would leave in pieces: after one, the operator is the identity.
    """

    def __init__(self, M, D, K, shift, solve):
        self._matrices, self._solve, self.error = (M, D), solve, None
        self._shift = shift if is_complex() else np.real(shift)
        self._in, self._out = create_block(K, 1), create_block(K, 1)
        self._load, self._solution = (create_block(K, 1 + is_complex()) for _ in range(2))
        self._scale, self._layout = 1.0, K
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

    def random(self, seed):
        """Return the rows of a random state."""
        with local_rows(random_block(self._layout, 2, seed)) as rows:
            return rows.T.ravel()

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
                first, second = np.split(state.getArray(readonly=True), 2)
                force = self._times(M, self._shift * first + self._scale * second)
                if D is not None:
                    force += self._times(D, first)
                x = -self._solved(force)
                result.setArray(np.concatenate([x, (first + self._shift * x) / self._scale]))
        except Exception as error:
            self.error = error
        if self.error is not None:
            state.copy(result)


def _products(states, vector) -> np.ndarray:
    """Return the inner products (m,) of states with a vector. Collective."""
    array = vector.getArray(readonly=True)
    local = np.array([np.vdot(state.getArray(readonly=True), array) for state in states])
    return summed(vector.comm.tompi4py(), local)


def _upper(mat, states, count, shift):
    """Return the poles of the upper half plane, nearest to the shift, and their eigenvectors (m, k) in terms of the
    orthonormal states (m), which span an invariant space."""
    small, image = np.zeros((len(states),) * 2, dtype=PETSc.ScalarType), mat.createVecRight()
    for j, state in enumerate(states):
        mat.mult(state, image)
        small[:, j] = _products(states, image)
    values, vectors = decided(mat.comm.tompi4py(), np.linalg.eig, small)
    values, vectors = values[values != 0].astype(complex), vectors[:, values != 0]
    poles = shift + 1 / values
    # what a real matrix has as real, a complex build has but for round-off
    poles = np.where(np.abs(poles.imag) <= 1e-12 * np.abs(poles), poles.real, poles).astype(complex)
    upper = np.flatnonzero(poles.imag >= 0)
    upper = upper[np.argsort(np.abs(poles[upper] - shift), kind="stable")][:count]
    return poles[upper], vectors[:, upper]


def _modes(K, states, vectors):
    """Return the modes, the first halves of combinations of states, as pairs Re, Im of columns."""
    block = create_block(K, 2 * vectors.shape[1])
    with local_rows(block) as rows:
        x = np.zeros((len(rows), vectors.shape[1]), dtype=complex)
        for state, row in zip(states, vectors, strict=True):
            x += state.getArray(readonly=True)[: len(rows), None] * row
        rows[:, 0::2], rows[:, 1::2] = x.real, x.imag
    return block


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
