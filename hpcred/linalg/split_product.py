"""Multiply a sparse matrix by columns without round-off of what cancels (Ozaki et al., Numer. Algorithms 59, 2012)."""

import numpy as np

from ..parallel.petsc import MPI, PETSc
from ..parallel.sums import summed
from .blocks import add_product, copy_of, create_block, local_rows, times
from .csr import diagonal_of

BITS = 53  # of a double
LEADING = 22  # bits of the leading part of an entry of the matrix


def terms_of_products(mat, columns) -> np.ndarray:
    """Return x^T |diag(A)| x (m,) of columns, the size of the terms of x^T A x. Collective."""
    diagonal = np.abs(diagonal_of(mat))
    with local_rows(columns) as rows:  # one column at a time: of all, the squares would take as much memory as they do
        return summed(mat.comm.tompi4py(), np.array([diagonal @ np.abs(column) ** 2 for column in rows.T]))


def split_product(mat, block):
    """Return A X as a new block for a symmetric A, with errors of about u |A X| + 2^-22 u |A| |X|. Collective.

    A = A1 + A2 and X = X1 + X2, where the leading parts have so few bits that sums of their products are exact: the
    terms of A1 X1 cancel without round-off, and the rest, A1 X2 + A2 X, is small. Rows and columns are scaled by powers
    of two first, so that units do not matter.
    """
    comm, unit = mat.comm.tompi4py(), np.eye(block.getActiveColumns()[1])
    scale = mat.getDiagonal()
    scale.setArray(_to_one(scale.getArray(readonly=True).real))
    scaled, right = mat.copy(), copy_of(block, mat)
    scaled.diagonalScale(scale, scale)
    factors = scale.getArray(readonly=True).real[:, None].copy()
    # leading parts, of entries relative to the largest of their row, or column
    indptr, indices, values = scaled.getValuesCSR()
    counts = np.diff(indptr)
    rows = np.repeat(np.arange(len(counts)), counts)
    largest = np.zeros(len(counts))
    np.maximum.at(largest, rows, np.abs(values))
    leading = _leading(values, LEADING, largest[rows])
    terms = comm.allreduce(int(counts.max(initial=1)), op=MPI.MAX)
    first, second = copy_of(block, mat), copy_of(block, mat)
    with local_rows(right) as X, local_rows(first) as X1, local_rows(second) as X2:
        X /= factors
        largest = np.abs(X).max(axis=0, initial=0.0)
        comm.Allreduce(MPI.IN_PLACE, largest, op=MPI.MAX)
        X1[...] = _leading(X, BITS - LEADING - int(np.ceil(np.log2(terms))), largest)
        X2[...] = X - X1
    # products, the largest last
    result = create_block(mat, len(unit))
    for left, columns in ((values - leading, right), (leading, second), (leading, first)):
        matrix = PETSc.Mat().createAIJ(mat.getSizes(), csr=(indptr, indices, left), comm=mat.comm)
        add_product(result, times(matrix, columns), unit, beta=0.0 if columns is right else 1.0)
        matrix.destroy()
    scaled.destroy()
    with local_rows(result) as product:
        product /= factors
    return result


def _to_one(diagonal):
    """Return powers of two s with s^2 |a| of about 1; 1 for zeros."""
    sizes = np.where(diagonal != 0, np.abs(diagonal), 1.0)
    return 2.0 ** -np.round(np.log2(sizes) / 2)


def _leading(values, bits, largest):
    """Return values rounded to multiples of 2^-bits of the next power of two above the `largest` of each."""
    size = 2.0 ** (np.ceil(np.log2(np.where(largest > 0, largest, 1.0))) + BITS - bits)
    return (values + size) - size
