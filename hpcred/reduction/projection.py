"""Project matrices on bases (20), and diagonalise the reduced stiffness (52-54)."""

import numpy as np

from ..linalg.blocks import apply, copy_of, create_block, from_dense, inner
from ..linalg.eigensolver import symmetric_eigenpairs

WIDTH = 64  # columns projected at a time, which bounds the memory


def project(mat, columns, left=None, width=WIDTH) -> np.ndarray:
    """V^T A V (m, m), or W^T A V with W = left, for the active columns. Collective."""
    left = columns if left is None else left
    first, last = columns.getActiveColumns()
    start, stop = left.getActiveColumns()
    result = np.zeros((stop - start, last - first))
    for low in range(first, last, width):
        high = min(low + width, last)
        columns.setActiveColumns(low, high)
        product = create_block(mat, high - low)
        apply(mat, columns, product)
        columns.setActiveColumns(first, last)
        result[:, low - first : high - first] = inner(left, product)
        product.destroy()
    return result


def project_columns(columns, mat) -> np.ndarray:
    """V^T B (m, p) for a dense B. Collective."""
    block = from_dense(mat)
    result = inner(columns, block)
    block.destroy()
    return result


def diagonalise(basis, stiffness: np.ndarray):
    """V <- V X with the eigenvectors X of V^T K V (53, 54), which diagonalise it; returns omega^2 (m,). Collective."""
    eigenvalues, vectors = symmetric_eigenpairs(stiffness, basis.comm)
    basis.multiply(vectors)
    return eigenvalues


def everywhere(model, framed, columns):
    """A basis of the framed model in all dofs of `model`, as a new block. Collective."""
    if framed.restore is None:
        return copy_of(columns, model.K)
    first, last = columns.getActiveColumns()
    result = create_block(model.K, last - first)
    apply(framed.restore, columns, result)
    return result
