"""Apply algebraic multigrid of a positive definite matrix to all columns of a block at once.

The levels are those of linalg.coarsening, below the corners of quadratic elements where these are known. The cycle over
them is done here for all columns of a block at once: a pass over the matrix of a level, which is what costs, serves all
of them, where that of PETSc goes column by column.
"""

from __future__ import annotations

import numpy as np

from ..parallel.failures import ComputationError
from ..parallel.petsc import PETSc
from .blocks import create_dense, multiply_dense, real_rows
from .coarsening import DENSE, STUCK, aggregates, coarse, node_inverses, smoothed
from .ritz_values import ritz_values

ENOUGH = 300  # rows of the coarsest level
COARSEST = 2000  # rows that every rank can have the eigenvectors of
MOST_LEVELS = 20
LOW, HIGH = 0.1, 1.1  # what a smoother damps, of the largest eigenvalue estimated
LANCZOS = 12  # steps of that estimate
SINGULAR = 1e-11  # of the largest eigenvalue of the coarsest matrix: a motion that meets no force


class TooDense(ComputationError):
    """Levels of small aggregates would take more than the matrix."""


class Multigrid:
    """One symmetric V-cycle with `sweeps` Chebyshev sweeps, over blocks of nodes, before and after the coarser level.

    `matrix` is kept, with the size of its blocks; `near_null`: a block (n, k) of motions that meet almost no force;
    `threshold`: entries of the graph of nodes below this share of the diagonal ones are weak; `aggressive`: large
    aggregates on the finest level, else small ones, which take more memory and fewer iterations. `corners`: an
    interpolation from the nodes at the corners of quadratic elements, and their near null vectors; or None. `prefix`:
    of the PETSc options of GAMG. Collective. Raises ComputationError, TooDense.
    """

    def __init__(self, matrix: PETSc.Mat, near_null, prefix: str, threshold: float, sweeps: int, aggressive=True,
                 corners=None):  # fmt: skip
        self.sweeps, self._width, self._levels = sweeps, 0, []
        try:
            self._make_levels(matrix, real_rows(near_null), prefix, threshold, aggressive, corners)
        except PETSc.Error as error:
            lines = str(error).splitlines()
            raise ComputationError(f"multigrid: GAMG of PETSc could not make the levels: {lines[-1]}") from error
        self._coarsest = _coarsest(self._levels[-1].matrix)

    def _make_levels(self, matrix, near_null, prefix, threshold, aggressive, corners):
        """From fine to coarse, each with the interpolation from the next coarser."""
        small = not aggressive and corners is None
        while True:
            level, size = _Level(matrix), matrix.getSize()[0]
            self._levels.append(level)
            if size <= ENOUGH or len(self._levels) == MOST_LEVELS:
                return
            level.estimate()
            block = matrix.getBlockSize()
            if corners is not None:
                level.interpolation, near_null = corners[0], real_rows(corners[1])
                corners = None
            else:
                tentative = aggregates(matrix, near_null, prefix, threshold, aggressive)
                if _stuck(tentative, size) and threshold > 0:
                    threshold = 0.0  # all neighbours are strong
                    tentative = aggregates(matrix, near_null, prefix, threshold, aggressive)
                if _stuck(tentative, size):
                    return
                if small and tentative[0].getSize()[1] > DENSE * size:
                    raise TooDense("multigrid: small aggregates would take more than the matrix")
                aggressive, block = False, near_null.shape[1]
                interpolation, near_null = tentative
                level.interpolation = smoothed(matrix, level.inverses, level.largest, interpolation)
            matrix = coarse(matrix, level.interpolation)
            matrix.setBlockSize(block)

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
            mine = np.ascontiguousarray(level.b.getDenseArray())
            whole = np.empty((len(inverse), mine.shape[1]), mine.dtype)
            counts = np.diff(level.matrix.getOwnershipRanges()) * mine.shape[1]
            level.comm.Allgatherv(mine, [whole, counts])
            level.x.getDenseArray()[...] = inverse[first:last] @ whole
            return
        below = self._levels[k + 1]
        x, r = level.x.getDenseArray(), level.r.getDenseArray()
        x[...] = 0.0
        r[...] = level.b.getDenseArray()
        level.smooth(self.sweeps)
        level.restrict(below)
        self._cycle(k + 1)
        multiply_dense(level.interpolation, below.x, level.d)
        x += level.d.getDenseArray()
        level.subtract_product()
        level.smooth(self.sweeps, residual=False)


def _stuck(tentative, size):
    return tentative is None or tentative[0].getSize()[1] > STUCK * size


class _Level:
    """A matrix, the inverses of its blocks of nodes, the interpolation from the next coarser level, and room for blocks
    of columns: x, b, r = b - A x, d, A d."""

    def __init__(self, matrix, interpolation=None):
        self.matrix, self.interpolation = matrix, interpolation
        self.comm = matrix.comm.tompi4py()

    def estimate(self):
        """Make what smooths: the inverses D of the blocks, and the largest eigenvalue of D A from below."""
        self.inverses = node_inverses(self.matrix)
        first, last = self.matrix.getOwnershipRange()
        start = np.random.default_rng(first).standard_normal((last - first, 1))
        values = ritz_values(self.comm, _product(self.matrix), _product(self.inverses), start, LANCZOS)
        self.largest = values[-1] if values[-1] > 0 else 1.0
        self.top = HIGH * self.largest

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
        x, d = self.x.getDenseArray(), self.d.getDenseArray()
        middle, half = self.top * (1 + LOW) / 2, self.top * (1 - LOW) / 2
        ratio = half / middle
        self.inverses.matMult(self.r, self.d)
        d /= middle
        for sweep in range(sweeps):
            x += d
            if sweep == sweeps - 1:
                if residual:
                    self.subtract_product()
                return
            self.subtract_product()
            before, ratio = ratio, 1 / (2 * middle / half - ratio)
            self.inverses.matMult(self.r, self.product)
            self.product.getDenseArray()[...] *= 2 * ratio / half
            d *= ratio * before
            d += self.product.getDenseArray()


def _product(matrix):
    """p, q -> q = A p for the rows of this rank (rows, 1)."""
    x, y = matrix.createVecs()

    def multiply(p, q):
        x.setArray(p[:, 0])
        matrix.mult(x, y)
        q[:, 0] = y.getArray(readonly=True).real

    return multiply


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
    diagonal = np.diag(whole)
    scale = np.divide(1.0, np.sqrt(np.abs(diagonal)), out=np.zeros(size), where=diagonal > 0)
    eigenvalues, vectors = np.linalg.eigh(scale[:, None] * (whole + whole.T) / 2 * scale)
    regular = eigenvalues > SINGULAR * eigenvalues[-1]
    vectors = scale[:, None] * vectors[:, regular]
    inverse = (vectors / eigenvalues[regular]) @ vectors.T
    return matrix.comm.tompi4py().bcast(inverse), *matrix.getOwnershipRange()
