"""Multiply a sparse matrix by columns without round-off of what cancels (Ozaki et al., Numer. Algorithms 59, 2012)."""

import numpy as np

from ..parallel.petsc import MPI, PETSc
from ..parallel.sums import summed
from .blocks import add_product, copy_of, local_rows, times
from .csr import diagonal_of

BITS = 53  # of a double
LEADING = 22  # bits of the leading part of an entry of the matrix


def terms_of_products(mat, columns) -> np.ndarray:
    """Return x^T |diag(A)| x (m,) of columns, the size of the terms of x^T A x. Collective."""
    with local_rows(columns) as rows:
        return summed(mat.comm.tompi4py(), (np.abs(diagonal_of(mat))[:, None] * np.abs(rows) ** 2).sum(axis=0))


def split_product(mat, block):
    """Return A X as a new block, with errors of about u |A X| + 2^-22 u |A| |X|. Collective.

    A = A1 + A2 and X = X1 + X2, where the leading parts have so few bits that sums of their products are exact: the
    terms of A1 X1 cancel without round-off, and the rest, A1 X2 + A2 X, is small.
    """
    indptr, indices, values = mat.getValuesCSR()
    comm, counts = mat.comm.tompi4py(), np.diff(indptr)
    rows = np.repeat(np.arange(len(counts)), counts)
    largest = np.zeros(len(counts))
    np.maximum.at(largest, rows, np.abs(values))
    leading = _leading(values, LEADING, largest[rows])
    bits = BITS - LEADING - int(np.ceil(np.log2(max(comm.allreduce(int(counts.max(initial=1)), op=MPI.MAX), 1))))
    first, second = copy_of(block, mat), copy_of(block, mat)
    with local_rows(block) as X, local_rows(first) as X1, local_rows(second) as X2:
        largest = comm.allreduce(np.abs(X).max(axis=0, initial=0.0), op=MPI.MAX)
        X1[...] = _leading(X, bits, largest)
        X2[...] = X - X1
    A1, A2 = (
        PETSc.Mat().createAIJ(mat.getSizes(), csr=(indptr, indices, part), comm=mat.comm)
        for part in (leading, values - leading)
    )
    result, one = times(A2, block), np.eye(block.getSizes()[1])
    for part in (second, first):  # the largest last
        add_product(result, times(A1, part), one)
    for matrix in (A1, A2):
        matrix.destroy()
    return result


def _leading(values, bits, largest):
    """Return values rounded to multiples of 2^-bits of the next power of two above the `largest` of each."""
    size = 2.0 ** (np.ceil(np.log2(np.where(largest > 0, largest, 1.0))) + BITS - bits)
    return (values + size) - size
