"""Make a connecting rod with two bearings, of 8-node hexahedra; every rank assembles the rows it owns.

In the plane, quadrilaterals mesh two rings, the eyes, and a shank between parts of their outer arcs; the body is layers
of them along z. Every rank has the mesh of the plane, which is small, but only its part of the body.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from ..fe.dofs import Dofs
from ..fe.materials import ElementProperties, Material
from ..fe.strain_matrices import elasticity
from ..model.second_order_model import SecondOrderModel
from ..parallel.failures import InputError
from ..parallel.petsc import MPI
from ..parallel.shares import row_range

LENGTH, THICKNESS = 0.2, 0.02  # m; between the centres of the eyes, along z
EYES = {"BIG_EYE": (0.025, 0.04, 0.6), "SMALL_EYE": (0.012, 0.02, 0.7)}  # radii in m, half of the angle at the shank
CORNERS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])  # of a quadrilateral


def crank(
    dofs: int = 20_000, comm=MPI.COMM_WORLD, young=2.1e11, poisson=0.3, density=7850.0
) -> SecondOrderModel:  # fmt: skip
    """Make a free connecting rod of hexahedra, with node sets BIG_EYE and SMALL_EYE on the bores of its eyes.
    Collective.

    Parameters
    ----------
    dofs : int, default 20000
        Approximate number of dofs, three per node; 500 to 2e9.
    comm : MPI.Comm, default all ranks
    young, poisson, density : float, default 2.1e11 (N/m^2), 0.3 and 7850 (kg/m^3)
        Of the material; by default steel.

    Returns
    -------
    SecondOrderModel
        Without inputs. The centre of the big eye is the origin, that of the small one is at x = 0.2 m.

    Raises
    ------
    InputError
        For a number of dofs out of range.
    """
    if not 500 <= dofs <= 2_000_000_000:
        raise InputError(f"dofs: found {dofs}, expected at least 500 and at most 2e9")
    layers = 1
    while _count(layers) < dofs:
        layers += 1
    layers = min((layers, max(layers - 1, 1)), key=lambda count: abs(_count(count) - dofs))
    points, quads, inner = _plane(layers)
    height, levels = THICKNESS / layers, layers + 1
    size = len(points) * levels
    first, last = (row // 3 for row in row_range(comm, 3 * size, 3))
    nodes = np.arange(first, last)
    stiffness, mass = _elements(points[quads], height, young, poisson, density)
    indptr, indices, values = _rows(quads, layers, first, last, stiffness, mass)
    position = np.column_stack([points[nodes // levels], (nodes % levels) * height - THICKNESS / 2])
    labels = Dofs(np.repeat(nodes + 1, 3), np.tile(np.arange(3, dtype=np.int8), len(nodes)),
                  np.repeat(position, 3, axis=0))  # fmt: skip
    share = slice(*row_range(comm, len(quads) * layers))
    elements = {"hexahedron": _hexahedra(quads, layers, np.arange(len(quads) * layers)[share]) + 1}
    material = Material(name="crank", young=young, poisson=poisson, density=density)
    sets = {name: nodes[np.isin(nodes // levels, plane)] + 1 for name, plane in inner.items()}
    return SecondOrderModel.from_csr(
        comm, 3 * size, indptr, indices, values, dofs=labels, name="crank", elements=elements, sets=sets,
        properties=ElementProperties.of_one(comm, elements, material),
    )


def _cells(layers):
    """Return numbers of cells through an eye, along its part at the shank and the rest, and along the shank."""
    edge = THICKNESS / layers
    across = max(round(2 * EYES["BIG_EYE"][1] * np.sin(EYES["BIG_EYE"][2]) / edge * 0.7), 2)
    along = max(round((LENGTH - EYES["BIG_EYE"][1] - EYES["SMALL_EYE"][1]) / edge), 2)
    eyes = [(max(round((outer - inner) / edge), 2), max(round((2 * np.pi - 2 * half) * (inner + outer) / 2 / edge), 6))
            for inner, outer, half in EYES.values()]  # fmt: skip
    return across, along, eyes


def _count(layers):
    """Return the number of dofs."""
    across, along, eyes = _cells(layers)
    plane = sum((through + 1) * (across + rest) for through, rest in eyes) + (along - 1) * (across + 1)
    return 3 * plane * (layers + 1)


def _plane(layers):
    """Return points (k, 2), quadrilaterals (cells, 4) counterclockwise, and the points on the inner circle of each
    eye."""
    across, along, eyes = _cells(layers)
    points, quads, inner, arcs, start = [], [], {}, [], 0
    for (name, (r0, r1, half)), (through, rest), middle in zip(EYES.items(), eyes, (0.0, np.pi), strict=True):
        angles = middle + np.concatenate([
            np.linspace(-half, half, across + 1), np.linspace(half, 2 * np.pi - half, rest + 1)[1:-1]])  # fmt: skip
        radii = np.linspace(r0, r1, through + 1)
        centre = np.array([0.0 if middle == 0.0 else LENGTH, 0.0])
        ring = radii[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1) + centre
        number = start + np.arange(ring.shape[0] * ring.shape[1]).reshape(ring.shape[:2])
        quads.append(_grid(number, np.roll(number, -1, axis=1)))
        points.append(ring.reshape(-1, 2))
        inner[name] = number[0]
        arcs.append(number[-1, : across + 1])
        start = number.max() + 1
    known = np.concatenate(points)
    left, right = arcs[0], arcs[1][::-1]  # upwards
    share = np.linspace(0, 1, along + 1)[1:-1, None, None]
    points.append(((1 - share) * known[left] + share * known[right]).reshape(-1, 2))
    between = start + np.arange((along - 1) * (across + 1)).reshape(along - 1, across + 1)
    number = np.concatenate([left[None], between, right[None]])
    quads.append(_grid(number[:, :-1], number[:, 1:]))
    return np.concatenate(points), np.concatenate(quads), inner


def _grid(number, beside):
    """Return quadrilaterals of a grid of numbered points; `beside`: the neighbours along the second axis."""
    return np.stack([number[:-1], number[1:], beside[1:], beside[:-1]], axis=-1).reshape(-1, 4)


def _hexahedra(quads, layers, cells):
    """Return points (cells, 8) of the body, from 0; cell = quadrilateral * layers + layer."""
    low = quads[cells // layers] * (layers + 1) + (cells % layers)[:, None]
    return np.concatenate([low, low + 1], axis=1)


def _elements(corners, height, young, poisson, density):
    """Return K (quads, 24, 24) and the mass (quads, 8, 8) of one component, by 2 x 2 x 2 Gauss points."""
    elastic = elasticity(young, poisson)
    stiffness, mass = np.zeros((len(corners), 24, 24)), np.zeros((len(corners), 8, 8))
    level = np.repeat([-1, 1], 4)
    plane = np.tile(CORNERS, (2, 1))
    for point in np.array(list(product((-1, 1), repeat=3))) / 3**0.5:
        xi, eta, zeta = 1 + plane[:, 0] * point[0], 1 + plane[:, 1] * point[1], 1 + level * point[2]
        shape = xi * eta * zeta / 8
        slope = np.array([plane[:, 0] * eta * zeta, plane[:, 1] * xi * zeta]) / 8  # by the coordinates of the square
        jacobian = np.einsum("dk,qkx->qdx", slope, np.tile(corners, (1, 2, 1)))
        gradient = np.empty((len(corners), 3, 8))
        gradient[:, :2] = np.linalg.solve(jacobian, np.broadcast_to(slope, (len(corners), 2, 8)))
        gradient[:, 2] = level * xi * eta / 8 * 2 / height
        volume = np.linalg.det(jacobian) * height / 2
        strain = np.zeros((len(corners), 6, 24))
        for d in range(3):
            strain[:, d, d::3] = gradient[:, d]
        for row, (d, e) in enumerate(((0, 1), (1, 2), (0, 2)), start=3):
            strain[:, row, d::3], strain[:, row, e::3] = gradient[:, e], gradient[:, d]
        stiffness += volume[:, None, None] * (strain.transpose(0, 2, 1) @ (elastic @ strain))
        mass += (density * volume)[:, None, None] * np.outer(shape, shape)
    return (stiffness + stiffness.transpose(0, 2, 1)) / 2, mass


def _rows(quads, layers, first, last, stiffness, mass):
    """Return CSR of the points first .. last - 1, three rows each, from blocks of pairs of points."""
    levels = layers + 1
    # the elements that have points of this rank
    near = np.flatnonzero(((quads * levels < last) & (quads * levels + layers >= first)).any(axis=1))
    cells = (near[:, None] * layers + np.arange(layers)).ravel()
    body = _hexahedra(quads, layers, cells)
    mine = (body >= first) & (body < last)
    total = quads.max() * levels + levels
    # pairs of points (row, column), each once; `place`: that of each pair of an element
    ends = [(a, b, np.flatnonzero(mine[:, a])) for a, b in product(range(8), repeat=2)]
    keys = np.concatenate([(body[kept, a] - first) * total + body[kept, b] for a, b, kept in ends])
    pairs, place = np.unique(keys, return_inverse=True)
    place = place.reshape(-1)
    # three columns for each pair, three rows for each point
    row, column = np.divmod(pairs, total)
    counts = np.bincount(row, minlength=last - first)
    indptr = np.concatenate([[0], np.cumsum(np.repeat(3 * counts, 3))])
    rank = np.arange(len(pairs)) - (np.cumsum(counts) - counts)[row]
    indices = np.empty(indptr[-1], dtype=np.int64)
    values = {"K": np.empty(indptr[-1]), "M": np.zeros(indptr[-1])}
    quad = cells // layers
    # blocks of three by three, of which M has the diagonal only
    scalar = np.bincount(place, weights=np.concatenate([mass[quad[kept], a, b] for a, b, kept in ends]))
    for i, j in product(range(3), repeat=2):
        where = indptr[3 * row + i] + 3 * rank + j
        indices[where] = 3 * column + j
        weights = np.concatenate([stiffness[quad[kept], 3 * a + i, 3 * b + j] for a, b, kept in ends])
        values["K"][where] = np.bincount(place, weights=weights)
        if i == j:
            values["M"][where] = scalar
    return indptr, indices, values
