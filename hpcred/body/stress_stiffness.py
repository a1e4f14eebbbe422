"""Compute the stiffness of stresses in solids, K_sigma = integral of G^T [sigma] G with G, gradients of displacements.

The components of a displacement do not mix: an element has the same matrix (k, k) of its nodes for each of them.
"""

from __future__ import annotations

import numpy as np

from ..fe.element_rules import Rule
from ..fe.shape_functions import gradients_in_space, integration_points, shape_functions
from ..linalg.csr import sum_of_entries
from ..parallel.petsc import PETSc

PAIRS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2]])  # places of xx, yy, zz, xy, yz, zx in the tensor


def node_stiffness(kind: str, rule: Rule, position: np.ndarray, stress: np.ndarray) -> np.ndarray:
    """Return the matrices (s, e, k, k) in N/m of elements with stresses of s states, for each component of the
    displacement.

    `position` (e, k, 3) of the nodes in m; `stress` (e, g, 6, s) at the integration points of the rule in Pa.
    """
    points, weights = integration_points(kind, "full" if rule.strain == "mean" else rule.scheme)
    gradients, determinant = gradients_in_space(shape_functions(kind, points)[1], position)
    volumes = determinant * weights
    if rule.strain == "mean":
        whole = volumes.sum(axis=1, keepdims=True)
        gradients = np.einsum("eg,egka->eka", volumes / whole, gradients)[:, None]
        volumes = whole
    tensor = np.moveaxis(stress, 3, 0)[:, :, :, PAIRS]  # (s, e, g, 3, 3)
    left = (gradients * volumes[..., None, None])[None] @ tensor  # (s, e, g, k, 3)
    states, elements, count, nodes, _ = left.shape
    left = left.transpose(0, 1, 3, 2, 4).reshape(states, elements, nodes, 3 * count)
    return left @ gradients.transpose(0, 1, 3, 2).reshape(elements, 3 * count, nodes)


def projected(matrices: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return the sums over elements of V_e^T K_e V_e (s, m, m), from matrices (s, e, k, k) and the displacements
    (e, k, 3, m) of their nodes by the columns of a basis."""
    elements, nodes, _, count = columns.shape
    flat = columns.reshape(elements, nodes, 3 * count)
    rows = columns.reshape(-1, count)
    return np.array([rows.T @ (matrix @ flat).reshape(-1, count) for matrix in matrices]).reshape(-1, count, count)


def assembled(model, pairs) -> PETSc.Mat:
    """Return the sparse matrix (n, n) of elements, from pairs of their matrices (e, k, k) and rows (e, k, 3).
    Collective."""
    rows, columns, values = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0)]
    for matrices, places in pairs:
        shape = (*matrices.shape, 3)
        i, j = (np.broadcast_to(numbers, shape).ravel() for numbers in (places[:, :, None], places[:, None]))
        there = (i >= 0) & (j >= 0)
        rows.append(i[there])
        columns.append(j[there])
        values.append(np.broadcast_to(matrices[..., None], shape).ravel()[there])
    rows, columns, values = (np.concatenate(arrays) for arrays in (rows, columns, values))
    return sum_of_entries(model.K, rows, columns, values)
