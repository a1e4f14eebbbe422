"""Project matrices on bases (20), and diagonalise the reduced stiffness (52-54)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...linalg.blocks import copy_of, create_block, from_dense, inner, local_rows, times, view_of
from ...linalg.eigensolver import symmetric_eigenpairs
from ...linalg.pencil import massless_last
from ...linalg.split_product import split_product, terms_of_products
from ...model.interfaces.nodes import InterfaceNode
from ...model.operator import Operator
from ...parallel.decisions import decided

WIDTH = 16  # columns projected at a time, which bounds the memory
TURNS = 3  # diagonalisations of a basis with columns of little mass
CANCELS = 1e-8  # of the terms of x^T K x: round-off of K x is seen in less, where resonances are sharp


class Projection(NamedTuple):
    """A model in its frame projected on the bases `columns` V and `left` W, None for W = V, both in the coordinates of
    the frame: W^T A V of its terms, W^T B (m, p), C V (k, m) of its measured rows, pseudo-frequencies (m,) in Hz, the
    `defect` max |W^T M V - I|, and the `interfaces` whose displacements are the first coordinates."""

    operator: Operator
    B: np.ndarray
    C: np.ndarray
    frequencies: np.ndarray
    columns: object
    defect: float
    left: object = None
    interfaces: tuple[InterfaceNode, ...] = ()


def project(mat, columns, left=None) -> np.ndarray:
    """Return V^T A V (m, m), or W^T A V with W = left, for the active columns. Collective."""
    left = columns if left is None else left
    columns, left = view_of(columns), view_of(left)
    count = columns.stop - columns.first
    result = np.zeros((left.stop - left.first, count))
    for low in range(0, count, WIDTH):
        high = min(low + WIDTH, count)
        result[:, low:high] = inner(left, times(mat, columns.between(low, high)))
    columns.bv.setActiveColumns(columns.first, columns.stop)  # which parts of them have changed
    return result


def project_stiffness(K, columns, cancels=CANCELS) -> np.ndarray:
    """Return V^T K V (m, m) of a symmetric K, with what is small in it beside its terms to all digits. Collective.

    Of soft motions of stiff parts K x is a small difference: round-off of it, 1e-16 of the terms, may be as large as
    x^T K x of a nearly free body. Columns with less than `cancels` of the terms are multiplied in parts whose products
    have no round-off.
    """
    projected = project(K, columns)
    soft = np.flatnonzero(np.abs(np.diag(projected)) < cancels * terms_of_products(K, columns))
    if len(soft):
        chosen = create_block(K, len(soft))
        with local_rows(columns) as rows, local_rows(chosen) as target:
            target[...] = rows[:, soft]
        right = inner(columns, split_product(K, chosen))
        projected[:, soft], projected[soft] = right, right.T
    return projected


def project_columns(columns, mat) -> np.ndarray:
    """Return V^T B (m, p) for a dense B. Collective."""
    return inner(columns, from_dense(mat))


def diagonalise(basis, stiffness: np.ndarray):
    """Replace V by V X with the eigenvectors X of V^T K V (53, 54), which diagonalise it; returns omega^2 (m,).
    Collective."""
    eigenvalues, vectors = symmetric_eigenpairs(stiffness, basis.comm)
    basis.multiply(vectors)
    return eigenvalues


def diagonalise_with_massless(basis, mass, stiffness, tau: float) -> tuple[np.ndarray, int]:
    """Replace V by V X that makes V^T M V and V^T K V diagonal, K by its symmetric part; returns omega^2 (m,),
    ascending, and how many of the last columns have no mass. `stiffness`: makes V^T K V of columns V. Collective.

    Columns have x^T M x = 1, or no mass and tau^2 x^T K x = 1. It is done more than once, since those
    with little mass have the round-off of the others.
    """
    for _ in range(TURNS):
        squares, X, static = decided(basis.comm, massless_last, stiffness(basis.columns),
                                     project(mass, basis.columns), tau)  # fmt: skip
        basis.multiply(X)
    return squares, static


def separate_dampers(basis, damping, static: int):
    """Turn the last columns of a basis, `static` ones without mass of equal stiffness, so that V^T D V is diagonal
    among them, the strongest damping first. Collective."""
    columns = basis.columns_between(basis.size - static, basis.size)
    small = project(damping, columns)
    turn = decided(basis.comm, lambda: np.linalg.eigh(-(small + small.T) / 2)[1])
    whole = np.eye(basis.size)
    whole[-static:, -static:] = turn
    basis.multiply(whole)


def everywhere(model, framed, columns):
    """Return a basis of the framed model in all dofs of `model`, as a new block. Collective."""
    return copy_of(columns, model.K) if framed.restore is None else times(framed.restore, columns)
