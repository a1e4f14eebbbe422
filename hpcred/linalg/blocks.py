"""Operate on blocks of distributed column vectors: SLEPc BVs, and views of some of their columns.

A block has the row layout of a matrix and `columns` columns; all functions are collective and act on the active
columns of a BV, or the columns of a View. Small factors (Gram matrices, coefficients) are NumPy arrays, identical on
all ranks.

Nobody destroys a block: Python drops it, and the next one that is created takes its memory.
"""

from __future__ import annotations

from contextlib import contextmanager, suppress
from typing import NamedTuple, TypeAlias

import numpy as np
from mpi4py import MPI

from ..parallel.failures import InputError, agreed
from ..parallel.petsc import PETSc, SLEPc, make_room
from ..parallel.sums import summed


class View(NamedTuple):
    """The columns first .. stop - 1 of a BV, whose memory it shares; other views of the same BV do not change it.

    Functions here take at most one view of a BV at a time, and move the active columns of that BV.
    """

    bv: SLEPc.BV
    first: int
    stop: int

    @property
    def comm(self):
        return self.bv.comm

    def getActiveColumns(self) -> tuple[int, int]:  # noqa: N802  (as of a BV)
        return self.first, self.stop

    def between(self, start: int, stop: int) -> View:
        """A view of the columns start .. stop - 1 of this one."""
        return View(self.bv, self.first + start, self.first + stop)


Block: TypeAlias = "SLEPc.BV | View"  # a text: PETSc is loaded when something is computed


def view_of(block: Block) -> View:
    """The active columns of a block as they are now."""
    return block if isinstance(block, View) else View(block, *block.getActiveColumns())


def _active(block: Block) -> SLEPc.BV:
    """The BV of a block, with its columns as the active ones."""
    if isinstance(block, View):
        block.bv.setActiveColumns(block.first, block.stop)
        return block.bv
    return block


def create_block(mat: PETSc.Mat, columns: int) -> SLEPc.BV:
    """A zero block of `columns` columns that A x = b of `mat` can have as b and x."""
    _make_room(mat, columns)
    block = SLEPc.BV().create(comm=mat.comm)
    rows = mat.getLocalSize()[0]
    if hasattr(block, "setLeadingDimension"):  # SLEPc >= 3.20 pads columns: see `packed`
        with suppress(PETSc.Error):  # debug builds want the same number on all ranks
            block.setLeadingDimension(max(rows, 1))
    block.setSizes((rows, mat.getSize()[0]), columns)
    block.setType(SLEPc.BV.Type.MAT)
    return block


@contextmanager
def dense(block: Block):
    """The active columns as a dense matrix, without a copy."""
    bv = _active(block)
    mat = bv.getMat()
    try:
        yield mat
    finally:
        bv.restoreMat(mat)


@contextmanager
def packed(mat: PETSc.Mat):
    """A dense matrix whose columns follow each other without a gap: `mat`, or a copy that is copied back at the end.

    PETSc's solves by packages ignore the leading dimension of right-hand sides and solutions.
    """
    gap = mat.getDenseLDA() > max(mat.getLocalSize()[0], 1)
    if not mat.comm.tompi4py().allreduce(gap, MPI.LOR):
        yield mat
        return
    copy = create_dense(mat, mat.getSize()[1])
    mat.copy(copy)
    yield copy
    copy.copy(mat)


@contextmanager
def local_rows(block: Block):
    """The rows of this rank of the active columns as a writable numpy view (rows, columns)."""
    with dense(block) as mat:
        view = mat.getDenseArray()
        yield view
        del view  # a view that outlives the matrix would not be noticed
        mat.assemble()


def real_rows(block: Block) -> np.ndarray:
    """Return a copy of the real parts of the rows of this rank (rows, columns)."""
    with local_rows(block) as rows:
        return rows.real.copy()


def copy_of(block: Block, mat: PETSc.Mat) -> SLEPc.BV:
    """A new block with a copy of the active columns; `mat` gives the layout."""
    first, last = block.getActiveColumns()
    new = create_block(mat, max(last - first, 1))
    new.setActiveColumns(0, last - first)
    if first == last:
        return new
    with dense(block) as source, dense(new) as target:
        source.copy(target)
    return new


def _make_room(like, columns):
    size = like.getSize()[0] * columns * np.dtype(PETSc.ScalarType).itemsize
    make_room(like.comm, size // like.comm.size)


def create_dense(like: PETSc.Mat, columns: int) -> PETSc.Mat:
    """A dense matrix of `columns` columns with the rows of another matrix."""
    _make_room(like, columns)
    mat = PETSc.Mat().createDense(((like.getLocalSize()[0], like.getSize()[0]), (None, columns)), comm=like.comm)
    mat.setUp()
    mat.assemble()
    return mat


def dense_matrix(like: PETSc.Mat, local: np.ndarray) -> PETSc.Mat:
    """A dense matrix with the row layout of `like` from the rows of this rank. Collective."""
    mat = create_dense(like, local.shape[1])
    mat.getDenseArray()[...] = local
    mat.assemble()
    return mat


def from_dense(mat: PETSc.Mat | np.ndarray, like: PETSc.Mat | None = None) -> SLEPc.BV:
    """Return a new block with a copy of the columns of a dense matrix. Collective.

    Parameters
    ----------
    mat : PETSc.Mat or ndarray, shape (n, k)
        Of an array each rank gives its own rows (rows, k); (rows,) is one column.
    like : PETSc.Mat, optional
        Beside an array: a matrix with the same rows on the same ranks, such as `run.model.K`; by default all ranks
        share the rows as they give them.

    Raises
    ------
    InputError
        For an array with another number of rows than this rank has, or of columns than another has, or with numbers
        that are not finite or not real.
    """
    if not isinstance(mat, PETSc.Mat):
        comm = MPI.COMM_WORLD if like is None else like.comm.tompi4py()
        with agreed(comm):
            local = _own_rows(mat, like)
        if len(counts := sorted(set(comm.allgather(local.shape[1])))) > 1:
            raise InputError(f"columns: found {counts[0]} on one rank and {counts[-1]} on another, expected as many")
        if like is None:
            like = PETSc.Mat().createDense(((len(local), None), (None, local.shape[1])), comm=PETSc.COMM_WORLD)
        mat = dense_matrix(like, local)
    new = create_block(mat, mat.getSize()[1])
    with dense(new) as target:
        mat.copy(target)
    return new


def multiply_dense(mat: PETSc.Mat, source: PETSc.Mat, target: PETSc.Mat):
    """target = mat source, with a sparse matrix and dense ones.

    PETSc 3.25 crashes where a rank has rows of the sparse matrix but none of the dense one, as it then writes the first
    entry of an array that has as many entries as that rank has rows. There the columns go one by one.
    """
    rows, columns = np.diff(mat.getOwnershipRanges()), np.diff(mat.getOwnershipRangesColumn())
    if not (rows[columns == 0] > 0).any():
        mat.matMult(source, target)
        return
    x, y = mat.createVecs()
    factors, products = source.getDenseArray(readonly=True), target.getDenseArray()
    for k in range(source.getSize()[1]):
        x.setArray(factors[:, k])
        mat.mult(x, y)
        products[:, k] = y.getArray(readonly=True)
    target.stateIncrease()
    for vector in (x, y):
        vector.destroy()


def _own_rows(array, like) -> np.ndarray:
    """Return an array of the rows of this rank as real (rows, k). Raises InputError."""
    local = np.asarray(array)
    local = local[:, None] if local.ndim == 1 else local
    rows = like.getLocalSize()[0] if like is not None else len(local) if local.ndim else 0
    if local.ndim != 2 or len(local) != rows:
        raise InputError(f"columns: found an array of shape {np.shape(array)}, expected ({rows}, columns), the rows "
                         "of this rank")  # fmt: skip
    if local.dtype.kind not in "biuf" or not np.isfinite(local).all():
        raise InputError(f"columns: found an array of {local.dtype} with numbers that are not real or not finite; real "
                         "and imaginary parts are columns of their own")  # fmt: skip
    return local


def apply(mat: PETSc.Mat, block: Block, result: Block):
    """result = mat block."""
    with dense(block) as source, dense(result) as target:
        multiply_dense(mat, source, target)


def times(mat: PETSc.Mat, block: Block) -> SLEPc.BV:
    """mat block, a new block."""
    first, last = block.getActiveColumns()
    result = create_block(mat, last - first)
    apply(mat, block, result)
    return result


def inner(left: Block, right: Block) -> np.ndarray:
    """left^T right (columns of left, columns of right), with left real."""
    (l0, l1), (r0, r1) = left.getActiveColumns(), right.getActiveColumns()
    if l0 == l1 or r0 == r1:
        return np.zeros((l1 - l0, r1 - r0))
    product = _active(right).dot(_active(left))  # whose memory the array shares
    values = product.getDenseArray()[l0:l1, r0:r1].copy()
    return values if np.iscomplexobj(values) and values.imag.any() else values.real.copy()


def stacked_inner(lefts, right: Block, diagonal: np.ndarray) -> list[np.ndarray]:
    """left^T right for several blocks, and x^T diag x (1, k) of the columns x of the last of them, with one message
    between the ranks; real numbers, in both builds of PETSc. `diagonal`: the rows of this rank."""
    products = []
    with local_rows(right) as y:
        for left in lefts:
            with local_rows(left) as x:
                products.append((x.T @ y).real)
    with local_rows(lefts[-1]) as x:
        products.append(np.array([[diagonal @ column**2 for column in x.real.T]]))
    total = summed(right.comm.tompi4py(), np.concatenate(products))
    return np.split(total, np.cumsum([len(product) for product in products])[:-1])


def independent(gram: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Orthogonal combinations (k, m) of columns from their Gram matrix (k, k), and their squared lengths (m,).

    Of columns scaled to length 1; combinations whose squared length is not above `least` are left out.
    """
    size = np.sqrt(np.diag(gram))
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    eigenvalues, turn = np.linalg.eigh(gram * np.outer(scale, scale))
    kept = eigenvalues > least
    return scale[:, None] * turn[:, kept], eigenvalues[kept]


def column_norms(*blocks: Block) -> np.ndarray:
    """2-norms of the active columns (blocks, columns), without the first axis for one block."""
    squared = []
    for block in blocks:
        with local_rows(block) as rows:
            squared.append((np.abs(rows) ** 2).sum(axis=0))
    norms = np.sqrt(summed(blocks[0].comm.tompi4py(), np.array(squared)))
    return norms if len(blocks) > 1 else norms[0]


def add_product(result: Block, block: Block, factor: np.ndarray, alpha=1.0, beta=1.0):
    """result = beta result + alpha block factor, with factor (columns of block, columns of result)."""
    (b0, b1), (r0, r1) = block.getActiveColumns(), result.getActiveColumns()
    if b0 == b1 or r0 == r1:
        return
    _active(result).mult(alpha, beta, _active(block), _small(factor, b0, b1, r0, r1))


def multiply(block: Block, factor: np.ndarray):
    """block = block factor; the first columns are overwritten when factor has fewer columns than rows."""
    first, last = block.getActiveColumns()
    stop = first + factor.shape[1]
    _active(block).multInPlace(_small(factor, first, last, first, stop), first, stop)


def fold(gram: np.ndarray) -> np.ndarray:
    """X^H Y (k, b) of complex columns from the real products (2k, 2b) of their parts.

    Complex columns are kept as pairs of real ones, Re and Im side by side, in both builds of PETSc.
    """
    real = gram[0::2, 0::2] + gram[1::2, 1::2]
    return real + 1j * (gram[0::2, 1::2] - gram[1::2, 0::2])


def unfold(factor: np.ndarray) -> np.ndarray:
    """The real factor (2k, 2b) that does to pairs of columns what a complex one (k, b) does to complex columns."""
    result = np.zeros((2 * factor.shape[0], 2 * factor.shape[1]))
    result[0::2, 0::2] = result[1::2, 1::2] = factor.real
    result[0::2, 1::2] = factor.imag
    result[1::2, 0::2] = -factor.imag
    return result


def as_pairs(block: Block, mat: PETSc.Mat) -> SLEPc.BV:
    """Real columns as pairs with zero imaginary parts, a new block."""
    first, last = block.getActiveColumns()
    pairs = create_block(mat, 2 * (last - first))
    with local_rows(block) as x, local_rows(pairs) as z:
        z[:, 0::2] = x
    return pairs


def _small(factor, row0, row1, column0, column1):
    values = np.zeros((row1, column1), dtype=PETSc.ScalarType, order="F")
    values[row0:, column0:] = factor
    mat = PETSc.Mat().createDense((row1, column1), array=values, comm=PETSc.COMM_SELF)
    mat.assemble()
    return mat


def random_block(mat: PETSc.Mat, columns: int, seed: int = 0) -> SLEPc.BV:
    """A new block of random numbers of mean 0 and variance 1 that do not depend on the number of ranks.

    Entry (i, j) is a hash of i, j and the seed (Steele, Lea & Flood, OOPSLA 2014: SplitMix64).
    """
    block = create_block(mat, columns)
    first, last = mat.getOwnershipRange()
    place = np.arange(first, last, dtype=np.uint64)[:, None] * np.uint64(columns) + np.arange(columns, dtype=np.uint64)
    z = (place + np.uint64(1 + (seed << 40))) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    with local_rows(block) as rows:
        rows[...] = (z.astype(float) / 2**63 - 1.0) * 3**0.5
    return block
