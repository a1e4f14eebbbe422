"""Apply algebraic multigrid of a positive definite matrix to all columns of a block at once.

PETSc's GAMG makes the levels by smoothed aggregation from near null vectors, the rigid-body motions (Vanek, Mandel &
Brezina, Computing 56, 1996). The cycle over them is done here for all columns of a block at once: a pass over the
matrix of a level, which is what costs, serves all of them, where that of PETSc goes column by column.
"""

from __future__ import annotations

import numpy as np

from ..parallel.decisions import decided
from ..parallel.failures import ComputationError
from ..parallel.petsc import PETSc
from ..parallel.sums import summed
from .blocks import create_dense, independent, local_rows
from .csr import diagonal_of
from .options import temporary_options

COARSEST = 2000  # rows that every rank can have the eigenvectors of
LOW, HIGH = 0.1, 1.1  # what a smoother damps, of the largest eigenvalue estimated
LANCZOS = 12  # steps of that estimate
DEPENDENT_NEAR_NULL = 1e-12  # squared norm of a combination of unit near null vectors that is round-off
SINGULAR = 1e-11  # of the largest eigenvalue of the coarsest matrix: a motion that meets no force


class Multigrid:
    """One symmetric V-cycle with `sweeps` Chebyshev sweeps, over Jacobi, before and after the coarser level.

    `matrix` is kept; `near_null`: a block (n, k) of motions that meet almost no force; `threshold`: entries of the
    graph of nodes below this share of the diagonal ones are weak. `prefix`: of the PETSc options of GAMG. Collective.
    Raises ComputationError.
    """

    def __init__(self, matrix: PETSc.Mat, near_null, prefix: str, threshold: float, sweeps: int):
        self.sweeps, self._width, self._levels = sweeps, 0, []
        pc = PETSc.PC().create(matrix.comm)
        pc.setOptionsPrefix(prefix)
        pc.setType("gamg")
        pc.setOperators(matrix)
        try:
            _set_near_null(matrix, near_null)
            with temporary_options(prefix + "pc_gamg_", {"threshold": threshold, "agg_nsmooths": 1}):
                pc.setFromOptions()
                pc.setUp()
            count = pc.getMGLevels()
            # from fine to coarse, with the interpolation from the next coarser
            self._levels = [
                _Level(matrix if k == count - 1 else pc.getMGSmoother(k).getOperators()[0],
                       pc.getMGInterpolation(k) if k else None)
                for k in reversed(range(count))
            ]  # fmt: skip
        except PETSc.Error as error:
            lines = str(error).splitlines()
            raise ComputationError(f"multigrid: GAMG of PETSc could not make the levels: {lines[-1]}") from error
        self._coarsest = _coarsest(self._levels[-1].matrix)

    @property
    def levels(self) -> int:
        return len(self._levels)

    @property
    def entries(self) -> int:
        """Stored numbers of all levels. Collective."""
        kind = PETSc.Mat.InfoType.GLOBAL_SUM
        mats = [mat for level in self._levels for mat in (level.matrix, level.interpolation) if mat is not None]
        return int(sum(mat.getInfo(kind)["nz_used"] for mat in mats))

    def apply(self, load: np.ndarray, solution: np.ndarray):
        """solution = B load for the rows of this rank (rows, columns), B positive definite. Collective."""
        if load.shape[1] != self._width:
            self._width = load.shape[1]
            for level in self._levels:
                level.make_room(self._width)
        self._levels[0].b.getDenseArray()[...] = load
        self._cycle(0)
        solution[...] = self._levels[0].x.getDenseArray()

    def _cycle(self, k):
        """x = B b on a level."""
        level = self._levels[k]
        if k == self.levels - 1:
            inverse, first, last = self._coarsest
            whole = np.concatenate(level.comm.allgather(level.b.getDenseArray().copy()))
            level.x.getDenseArray()[...] = inverse[first:last] @ whole
            return
        below = self._levels[k + 1]
        x, r = level.x.getDenseArray(), level.r.getDenseArray()
        x[...] = 0.0
        r[...] = level.b.getDenseArray()
        level.smooth(self.sweeps)
        level.restrict(below)
        self._cycle(k + 1)
        level.interpolation.matMult(below.x, level.d)
        x += level.d.getDenseArray()
        level.subtract_product()
        level.smooth(self.sweeps, residual=False)


class _Level:
    """A matrix, the interpolation from the next coarser level, and room for blocks: x, b, r = b - A x, d, A d."""

    def __init__(self, matrix, interpolation):
        self.matrix, self.interpolation = matrix, interpolation
        self.comm = matrix.comm.tompi4py()
        values = diagonal_of(matrix)
        self.inverse = np.divide(1.0, values, out=np.zeros_like(values), where=values > 0)[:, None]
        if interpolation is not None:
            self.top = HIGH * self._largest_eigenvalue()

    def make_room(self, columns):
        self.x = self.b = self.r = self.d = self.product = None  # whose memory is for the next ones
        self.x, self.b, self.r, self.d, self.product = (create_dense(self.matrix, columns) for _ in range(5))

    def subtract_product(self):
        """r -= A d."""
        self.matrix.matMult(self.d, self.product)
        r = self.r.getDenseArray()
        r -= self.product.getDenseArray()

    def restrict(self, below):
        """The load of the coarser level: P^T r."""
        self.interpolation.transposeMatMult(self.r, below.b)

    def smooth(self, sweeps, residual=True):
        """Chebyshev sweeps on x with its residual r, which follows at last where `residual` (Saad, Iterative methods
        for sparse linear systems, 2003, algorithm 12.1)."""
        x, r, d = (mat.getDenseArray() for mat in (self.x, self.r, self.d))
        middle, half = self.top * (1 + LOW) / 2, self.top * (1 - LOW) / 2
        ratio = half / middle
        np.multiply(r, self.inverse / middle, out=d)
        for sweep in range(sweeps):
            x += d
            if sweep == sweeps - 1:
                if residual:
                    self.subtract_product()
                return
            self.subtract_product()
            before, ratio = ratio, 1 / (2 * middle / half - ratio)
            d *= ratio * before
            d += r * (2 * ratio / half * self.inverse)

    def _largest_eigenvalue(self):
        """Of the matrix over its diagonal, from below, by Lanczos' method."""
        scale = np.sqrt(self.inverse[:, 0])
        x, y = self.matrix.createVecs()
        q = np.random.default_rng(self.matrix.getOwnershipRange()[0]).standard_normal(len(scale))
        before, alphas, betas = np.zeros(len(scale)), [], []
        q /= self._norm(q)
        for _ in range(LANCZOS):
            x.setArray(scale * q)
            self.matrix.mult(x, y)
            new = scale * y.getArray(readonly=True).real
            alphas.append(float(summed(self.comm, new @ q)))
            new -= alphas[-1] * q + (betas[-1] if betas else 0.0) * before
            beta = self._norm(new)
            if beta <= 1e-10 * abs(alphas[0]):
                break
            betas.append(beta)
            before, q = q, new / beta
        beside = betas[: len(alphas) - 1]
        return float(np.linalg.eigvalsh(np.diag(alphas) + np.diag(beside, 1) + np.diag(beside, -1)).max())

    def _norm(self, vector):
        return float(summed(self.comm, vector @ vector)) ** 0.5


def _set_near_null(matrix, near_null):
    """Tell the matrix its near null vectors, which PETSc wants orthonormal."""
    comm, vectors = matrix.comm.tompi4py(), []
    with local_rows(near_null) as rows:
        basis = rows.real
        for _ in range(2):
            factor, eigenvalues = decided(comm, independent, summed(comm, basis.T @ basis), DEPENDENT_NEAR_NULL)
            basis = basis @ (factor / np.sqrt(eigenvalues))
        for column in basis.T:
            vectors.append(matrix.createVecRight())
            vectors[-1].setArray(column)
    matrix.setNearNullSpace(PETSc.NullSpace().create(vectors=vectors, comm=matrix.comm))


def _coarsest(matrix):
    """The inverse of a small matrix, but for motions that meet no force, and the rows of this rank in it."""
    size = matrix.getSize()[0]
    if size > COARSEST:
        raise ComputationError(
            f"multigrid: the coarsest level has {size} rows, expected at most {COARSEST}: the nodes are too loosely "
            "coupled to be coarsened; take a smaller solver.threshold, or solver.kind = 'direct'"
        )
    indptr, indices, values = matrix.getValuesCSR()
    local = np.zeros((len(indptr) - 1, size))
    local[np.repeat(np.arange(len(indptr) - 1), np.diff(indptr)), indices] = values.real
    whole = np.concatenate(matrix.comm.tompi4py().allgather(local))
    eigenvalues, vectors = np.linalg.eigh((whole + whole.T) / 2)
    regular = eigenvalues > SINGULAR * eigenvalues[-1]
    inverse = (vectors[:, regular] / eigenvalues[regular]) @ vectors[:, regular].T
    return matrix.comm.tompi4py().bcast(inverse), *matrix.getOwnershipRange()
