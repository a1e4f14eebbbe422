"""Small distorted meshes of each kind of solid, and models of them with their own stiffness."""

import numpy as np
import scipy.sparse
from bodies import block

import hpcred
from hpcred.fe.shape_functions import EDGES, corner_kind, gradients_in_space, integration_points, shape_functions
from hpcred.fe.strain_matrices import elasticity, stiffness_matrices
from hpcred.parallel.shares import row_range

PARTS = {  # of a hexahedron
    "hexahedron": [range(8)], "wedge": [(0, 1, 2, 4, 5, 6), (0, 2, 3, 4, 6, 7)],
    "tetra": [(0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)],
}  # fmt: skip


def mesh(kind, cells=(2, 2, 1), size=(1.0, 1.0, 1.0), distortion=0.1, seed=2):
    """Points (k, 3) and elements (e, nodes), from 0; nodes inside and on edges are moved at random."""
    points, hexahedra = block(*cells, size)
    elements = np.concatenate([hexahedra[:, list(part)] for part in PARTS[corner_kind(kind)]])
    if kind in EDGES:
        pairs = np.sort(elements[:, np.array(EDGES[kind])], axis=2)
        middles, place = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
        elements = np.hstack([elements, place.reshape(pairs.shape[:2]) + len(points)])
        points = np.concatenate([points, points[middles].mean(axis=1)])
    edge = np.array(size) / cells
    points = points + distortion * edge * (np.random.default_rng(seed).random(points.shape) - 0.5)
    return points, elements


def mass(kind, points, elements, density):
    """Consistent M (n, n), sparse, three dofs a point, by full integration."""
    places, weights = integration_points(kind)
    N, dN = shape_functions(kind, places)
    _, determinant = gradients_in_space(dN, points[elements])
    blocks = density * np.einsum("g,eg,gk,gl->ekl", weights, determinant, N, N)
    i, j = (np.broadcast_to(part, blocks.shape) for part in (elements[:, :, None], elements[:, None]))
    scalar = scipy.sparse.coo_array((blocks.ravel(), (i.ravel(), j.ravel())), (len(points),) * 2)
    return scipy.sparse.kron(scalar, scipy.sparse.eye(3), format="csr")


def stiffness(kind, rule, points, elements, young, poisson):
    """K (n, n), sparse, of elements of one type and material, three dofs a point."""
    blocks = stiffness_matrices(kind, rule, points[elements], elasticity(young, poisson))
    rows = (3 * elements[:, :, None] + np.arange(3)).reshape(len(elements), -1)
    i = np.repeat(rows, rows.shape[1], axis=1)
    j = np.tile(rows, (1, rows.shape[1]))
    size = 3 * len(points)
    return scipy.sparse.coo_array((blocks.ravel(), (i.ravel(), j.ravel())), (size, size)).tocsr()


def model_of(kind, program, type_, points, elements, material, comm, K=None, held=(), M=None, **more):
    """A model with nodes from 1, elements over the ranks; K and M are I if not given. Points `held` have no rows."""
    size = 3 * len(points)
    K, M = (scipy.sparse.eye(size, format="csr") if item is None else item for item in (K, M))
    dofs = hpcred.Dofs(np.repeat(np.arange(1, len(points) + 1), 3), np.tile(np.arange(3), len(points)),
                       np.repeat(points, 3, axis=0))  # fmt: skip
    stuck = np.isin(dofs.node - 1, held)
    share = slice(*row_range(comm, len(elements)))
    table = np.zeros((len(elements), 3), int)
    table[:, 0] = np.arange(1, len(elements) + 1)
    properties = hpcred.fe.ElementProperties(program, (type_,), (material,), {kind: table[share]})
    free = np.flatnonzero(~stuck)
    given = dofs.take(stuck).take(slice(*row_range(comm, int(stuck.sum())))) if stuck.any() else None
    return hpcred.SecondOrderModel.from_scipy(
        K[free][:, free], M[free][:, free], comm=comm, dofs=dofs.take(~stuck),
        held=given, elements={kind: elements[share] + 1}, properties=properties, **more,
    )  # fmt: skip
