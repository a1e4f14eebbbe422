"""Compute the stiffness of stresses in solids, K_sigma = integral of G^T [sigma] G with the gradients G of displacements.

The components of a displacement do not mix: an element has the same matrix (k, k) of its nodes for each of them.
"""

import numpy as np

from ..linalg.csr import compress
from ..model.shape_functions import gradients_in_space, integration_points, shape_functions
from ..parallel.exchange import exchange
from ..parallel.petsc import PETSc

PAIRS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2]])  # places of xx, yy, zz, xy, yz, xz in the tensor
NUMBERS_AT_A_TIME = 2**22  # in work arrays of elements


def node_stiffness(kind: str, scheme: str, position: np.ndarray, stress: np.ndarray) -> np.ndarray:
    """Return the matrices (s, e, k, k) of elements with stresses of s states, for each component of the displacement.

    `position` (e, k, 3) of the nodes in m; `stress` (e, g, 6, s) at the integration points of the scheme in Pa.
    """
    points, weights = integration_points(kind, scheme)
    gradients, determinant = gradients_in_space(shape_functions(kind, points)[1], position)
    tensor = np.moveaxis(stress, 3, 0)[:, :, :, PAIRS]  # (s, e, g, 3, 3)
    loaded = np.einsum("egka,segab->segkb", gradients * (weights * determinant)[..., None, None], tensor)
    return np.einsum("segkb,eglb->sekl", loaded, gradients)


def projected(matrices: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return sum over elements of V_e^T K_e V_e (s, m, m), from matrices (s, e, k, k) and the displacements of their
    nodes (e, k, 3, m) by the columns of a basis."""
    elements, nodes, _, count = columns.shape
    flat = columns.reshape(elements, nodes, 3 * count)
    rows = columns.reshape(-1, count)
    return np.array([rows.T @ (matrix @ flat).reshape(-1, count) for matrix in matrices])


def chunks(elements: int, numbers: int):
    """Return slices of elements whose work arrays, of so many numbers an element, have a limited size."""
    step = max(NUMBERS_AT_A_TIME // max(numbers, 1), 1)
    return [slice(low, min(low + step, elements)) for low in range(0, elements, step)]


def assembled(model, parts) -> PETSc.Mat:
    """Return the sparse matrix (n, n) of elements, from pairs of their matrices (e, k, k) and rows (e, k, 3).

    Collective; the caller destroys it.
    """
    rows, columns, values = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0)]
    for matrices, places in parts:
        shape = (*matrices.shape, 3)
        i, j = (np.broadcast_to(item, shape).ravel() for item in (places[:, :, None], places[:, None]))
        there = (i >= 0) & (j >= 0)
        rows.append(i[there])
        columns.append(j[there])
        values.append(np.broadcast_to(matrices[..., None], shape).ravel()[there])
    rows, columns, values = (np.concatenate(part) for part in (rows, columns, values))
    owner = np.searchsorted(model.row_starts, rows, side="right") - 1
    mine = exchange(model.comm, owner, [rows, columns, values])
    first, last = model.first_row, model.first_row + model.local_rows
    indptr, indices, values = compress({"K": tuple(mine)}, first, last, model.size)
    csr = (indptr.astype(PETSc.IntType), indices.astype(PETSc.IntType), values["K"])
    return PETSc.Mat().createAIJ(((model.local_rows, model.size),) * 2, csr=csr, comm=model.K.comm)
