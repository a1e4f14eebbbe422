"""Solve eigenproblems by SLEPc: modes of (K, M) in a band, the lowest modes, and the small dense problem."""

from contextlib import suppress

import numpy as np

from ..parallel.decisions import decided
from ..parallel.failures import ComputationError
from ..parallel.petsc import PETSc, SLEPc, is_complex, petsc_errors, without_gil
from .blocks import create_block, local_rows
from .options import temporary_options

TOLERANCE = 1e-10


def modes_in_interval(K, M, low, high, options):
    """All eigenpairs of (K, M) with low < eigenvalue < high, by spectrum slicing; a real build only. Collective.

    `options`: for its factors, see Factorisation.slicing.
    Returns eigenvalues (m,) ascending and eigenvectors as a block (n, m), or None for m = 0. The number found is
    compared with the inertias of K - low M and K - high M; raises ComputationError when they disagree.
    """
    for attempt in range(4):
        # an end of the interval that hits an eigenvalue is moved outwards a little
        shift = 1e-6 * attempt * max(abs(low), abs(high))
        eps = _create(K, M)
        eps.setWhichEigenpairs(SLEPc.EPS.Which.ALL)
        eps.setInterval(low - shift, high + shift)
        eps.setDimensions(nev=16)
        eps.getST().setType(SLEPc.ST.Type.SINVERT)
        eps.setKrylovSchurDetectZeros(True)
        ksp = eps.getKrylovSchurKSP()
        ksp.setType("preonly")
        ksp.getPC().setType("cholesky")
        try:
            with temporary_options("modes_st_", options), petsc_errors():
                eps.setFromOptions()
                without_gil("EPSSolve", eps)
            break
        except PETSc.Error as error:
            _give_up(eps)
            if attempt == 3:
                raise _failed("spectrum slicing", error) from error
    # as many as Sylvester's law counts
    inertias = eps.getKrylovSchurInertias()[1]
    expected = int(max(inertias) - min(inertias)) if len(inertias) else eps.getConverged()
    converged = eps.getConverged()
    if converged != expected:
        raise ComputationError(f"spectrum slicing found {converged} modes, the inertia counts {expected}")
    return _pairs(eps, K, converged)


def lowest_modes(K, M, count, most, solve, monitor=None):
    """The `count` lowest eigenpairs of (K, M), or fewer, on the space of dimension `most` where `solve` inverts K, but
    for some of repeated eigenvalues. Collective.

    `solve(x, y)`: y = K^-1 x for vectors; for a free body by inertia relief, which keeps the rigid-body modes
    out. `monitor(found)` is told now and then how many are found. Returns eigenvalues ascending and a block whose
    columns span the eigenvectors: as many, or twice as many in a complex build (see _pairs); None for none.
    """
    eps = _create(K, M)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
    eps.setTarget(0.0)
    eps.setDimensions(nev=min(count, most))
    st = eps.getST()
    st.setType(SLEPc.ST.Type.SINVERT)
    st.setShift(0.0)
    ksp = st.getKSP()
    ksp.setType("preonly")
    pc = ksp.getPC()
    pc.setType("python")
    inverse = _Inverse(solve)
    pc.setPythonContext(inverse)
    if monitor is not None:
        eps.setMonitor(lambda _eps, _iteration, converged, *_: monitor(min(converged, count)))
    eps.setFromOptions()
    solve_by(eps, inverse)
    return _pairs(eps, K, min(count, eps.getConverged()))


def solve_by(eps, operator):
    """Run a solver whose `operator` of Python keeps its exception as `error`, which is raised after it."""
    try:
        with petsc_errors():
            eps.solve()
    except PETSc.Error as error:
        _give_up(eps)
        raise _failed("SLEPc", error) from error
    if operator.error is not None:
        raise operator.error


def _give_up(eps):
    """Free what can be freed of a solver that an error left in pieces."""
    with suppress(PETSc.Error), petsc_errors():
        eps.destroy()


def _failed(what, error) -> ComputationError:
    return ComputationError(f"{what} failed: {str(error).splitlines()[-1]}; is M positive semidefinite?")


class _Inverse:
    """A preconditioner that hands the shift-invert solves of SLEPc to the factor that the run has anyway.

    An exception must not pass through SLEPc, which it would leave in pieces: after one, the operator is the
    identity, so that SLEPc comes to an end.
    """

    def __init__(self, solve):
        self._solve, self.error = solve, None

    def apply(self, pc, x, y):
        try:
            if self.error is None:
                self._solve(x, y)
        except Exception as error:
            self.error = error
        if self.error is not None:
            x.copy(y)


def symmetric_eigenpairs(matrix: np.ndarray, comm):
    """Eigenvalues (m,) ascending and orthonormal eigenvectors (m, m) of a small symmetric matrix (53).

    Solved once and sent: the same on all ranks. Collective.
    """
    return decided(comm, graded_eigenpairs, (matrix + matrix.T) / 2, _dense_eigenpairs)


def graded_eigenpairs(matrix: np.ndarray, eigenpairs=np.linalg.eigh):
    """Return eigenvalues (m,), ascending, and orthonormal eigenvectors (m, m) of a small symmetric matrix, those of
    soft motions beside stiff ones, and of parts that hardly couple, with as many digits as its entries have. Local.

    `eigenpairs` has errors of 1e-16 of the largest eigenvalue. Groups of coordinates that hardly couple are therefore
    taken one by one; to first order their coupling turns only the eigenvectors. Raises ComputationError for NaN and
    Inf, whose couplings no comparison sees.
    """
    if not np.isfinite(matrix).all():
        raise ComputationError("a projected matrix has entries that are NaN or Inf: numbers of the model, or of a "
                               "solve, are out of range")  # fmt: skip
    group = _groups(_coupled(matrix, np.diag(matrix)))
    while group.any():
        values, vectors = _by_groups(matrix, group, eigenpairs)
        coupling = vectors.T @ matrix @ vectors
        apart = group[:, None] != group
        if not (coupled := _coupled(coupling, values) & apart).any():
            gap = values - values[:, None]
            turned = vectors + vectors @ np.divide(coupling, gap, out=np.zeros(gap.shape), where=apart & (gap != 0))
            order = np.argsort(values, kind="stable")
            return values[order], (turned @ (1.5 * np.eye(len(gap)) - turned.T @ turned / 2))[:, order]
        group = _groups(coupled | ~apart)  # the diagonal did not show how close their eigenvalues are
    return eigenpairs(matrix)


def _coupled(matrix, values):
    """Test which coordinates of a nearly diagonal matrix (m, m) couple so that it shows beyond first order: in their
    eigenvectors, or in the softer of their eigenvalues, which are about `values` (m,)."""
    size = np.abs(values)
    gap = np.abs(values - values[:, None])
    return matrix**2 * len(matrix) > np.finfo(float).eps * gap * np.minimum(gap, np.minimum(size, size[:, None]))


def _groups(coupled) -> np.ndarray:
    """Return the numbers (m,) of groups of coordinates, from 0, that couple with no other; `coupled` is symmetric."""
    # each takes the lowest number among those that it couples with, and then the number of that one, until none changes
    coupled, group = coupled | np.eye(len(coupled), dtype=bool), np.arange(len(coupled))
    while (lowest := np.where(coupled, group, len(group)).min(axis=1, initial=len(group))).tolist() != group.tolist():
        group = lowest[lowest]
    return np.unique(group, return_inverse=True)[1]


def _by_groups(matrix, group, eigenpairs):
    """Return eigenvalues (m,) and eigenvectors (m, m) of the groups of coordinates, each by itself."""
    values, vectors = np.diag(matrix).copy(), np.eye(len(matrix))
    for k in np.flatnonzero(np.bincount(group) > 1):
        members = np.flatnonzero(group == k)
        values[members], vectors[np.ix_(members, members)] = eigenpairs(matrix[np.ix_(members, members)])
    return values, vectors


def symmetric_part(matrix: np.ndarray) -> np.ndarray:
    """Return (A + A^T) / 2."""
    return (matrix + matrix.T) / 2


def congruent(matrix: np.ndarray, X: np.ndarray) -> np.ndarray:
    """Return X^T A X, exactly symmetric where the matrix A is. Local."""
    product = X.T @ matrix @ X
    return (product + product.T) / 2 if np.array_equal(matrix, matrix.T) else product


def eigenpairs_with_gram(K: np.ndarray, gram: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return eigenvalues (m,), ascending, of the small symmetric K on columns whose Gram matrix (m, m) is I but for
    round-off, and X (m, m) that makes them diagonal and orthonormal. Local.

    Of parts that hardly couple, both matrices have the couplings with all digits, which round-off of the columns
    changes in one as in the other: their difference is what the parts feel of each other.
    """
    straight = 1.5 * np.eye(len(gram)) - gram / 2
    eigenvalues, vectors = graded_eigenpairs(congruent((K + K.T) / 2, straight))
    return eigenvalues, straight @ vectors


def _dense_eigenpairs(matrix):
    size = len(matrix)
    if size == 0:
        return np.zeros(0), np.zeros((0, 0))
    values = np.asfortranarray(matrix, dtype=PETSc.ScalarType)
    mat = PETSc.Mat().createDense((size, size), array=values, comm=PETSc.COMM_SELF)
    mat.assemble()
    eps = SLEPc.EPS().create(comm=PETSc.COMM_SELF)
    eps.setOperators(mat)
    eps.setProblemType(SLEPc.EPS.ProblemType.HEP)
    eps.setType(SLEPc.EPS.Type.LAPACK)
    eps.setWhichEigenpairs(SLEPc.EPS.Which.SMALLEST_REAL)
    eps.setDimensions(nev=size)
    eps.setOptionsPrefix("diagonalise_")
    eps.setFromOptions()
    eps.solve()
    vector = mat.createVecRight()
    eigenvalues, vectors = np.zeros(size), np.zeros((size, size), dtype=PETSc.ScalarType)
    for i in range(size):
        eigenvalues[i] = eps.getEigenpair(i, vector).real
        vectors[:, i] = vector.getArray()
    if np.abs(vectors.imag).max() > 1e-12:  # a complex build computes with the real numbers that it was given
        raise ComputationError("the eigenvectors of a real symmetric matrix are not real")
    return eigenvalues, vectors.real.copy()


def _create(K, M):
    eps = SLEPc.EPS().create(comm=K.comm)
    eps.setOptionsPrefix("modes_")
    eps.setOperators(K, M)
    eps.setProblemType(SLEPc.EPS.ProblemType.GHEP)
    eps.setType(SLEPc.EPS.Type.KRYLOVSCHUR)
    eps.setTolerances(tol=TOLERANCE, max_it=500)
    return eps


def _pairs(eps, K, count):
    """The lowest eigenvalues, ascending, with their vectors; destroys the solver.

    A complex build gives every vector an arbitrary phase, and complex mixtures of the vectors of a repeated eigenvalue:
    the real and the imaginary parts, 2 count columns, then span the real eigenvectors.
    """
    if count == 0:
        eps.destroy()
        return np.zeros(0), None
    asked = eps.getDimensions()[0]  # what converged beside these may be round-off
    values = np.array([eps.getEigenvalue(i).real for i in range(min(max(asked, count), eps.getConverged()))])
    lowest = np.argsort(values, kind="stable")[:count]
    block = create_block(K, 2 * count if is_complex() else count)
    vector = K.createVecRight()
    with local_rows(block) as rows:
        for column, i in enumerate(lowest):
            eps.getEigenvector(int(i), vector)
            array = vector.getArray(readonly=True)
            rows[:, column] = array.real
            if is_complex():
                rows[:, count + column] = array.imag
    eps.destroy()  # which has factors, or refers to a solver of ours
    return values[lowest], block
