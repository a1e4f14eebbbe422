"""Make a block of 8-node hexahedra, for large models; every rank assembles the rows it owns, without communication."""

from itertools import product
from math import prod

import numpy as np

from ..fe.dofs import Dofs
from ..fe.materials import ElementProperties, Material
from ..fe.strain_matrices import elasticity
from ..model.second_order_model import SecondOrderModel
from ..parallel.failures import InputError
from ..parallel.petsc import MPI
from ..parallel.shares import row_range

DEFAULT = 60, 24, 24  # cells


def solid(
    cells=None, size=None, inputs=6, clamped=True, comm=MPI.COMM_WORLD, young=2.1e11, poisson=0.3,
    density=7850.0, dofs: int | None = None,
) -> SecondOrderModel:  # fmt: skip
    """Make a block of hexahedra with forces at one end. Collective.

    Parameters
    ----------
    cells : tuple of three int, default (60, 24, 24)
        Numbers of hexahedra along x, y, z.
    dofs : int, optional
        About so many dofs, in place of `cells`, by blocks of the same shape.
    size : tuple of three floats, optional
        Edges in m; by default 10 mm per cell.
    inputs : int, default 6
        Number of forces, in x, y, z at nodes spread over the face at the largest x.
    clamped : bool, default True
        Whether the nodes at x = 0 are held, and have no rows.
    comm : MPI.Comm, default all ranks
    young, poisson, density : float, default 2.1e11 (N/m^2), 0.3 and 7850 (kg/m^3)
        Of the material; by default steel.

    Returns
    -------
    SecondOrderModel
        Three dofs per node, consistent mass; node numbers run along z first, then y, then x, those of held nodes behind
        all others.

    Raises
    ------
    InputError
        For cells, sizes and numbers of inputs out of range.
    """
    # the numbers, each refused before anything of size n is made
    if dofs is not None:
        if cells is not None:
            raise InputError("dofs: found it beside cells, of which it takes the place; leave one out")
        if not 24 <= dofs < 2**31:
            raise InputError(f"dofs: found {dofs}, expected 24 to 2^31")
        cells = _cells_for(dofs, clamped)
    cells = tuple(int(count) for count in (DEFAULT if cells is None else cells))
    if len(cells) != 3 or min(cells) < 1:
        raise InputError(f"cells: found {list(cells)}, expected three numbers of at least 1")
    if 3 * prod(count + 1 for count in cells) >= 2**31:
        raise InputError(f"cells: found {list(cells)}, expected fewer than 2^31 dofs")
    size = np.array(size if size is not None else [0.01 * count for count in cells], dtype=float)
    if size.shape != (3,) or not ((size > 0) & (size < np.inf)).all():
        raise InputError(f"size: found {size.tolist()}, expected three positive lengths in m")
    grid = np.array(cells) + 1
    skipped = grid[1] * grid[2] if clamped else 0
    count = int(np.prod(grid)) - skipped
    if not 1 <= inputs <= 3 * grid[1] * grid[2]:
        raise InputError(f"inputs: found {inputs}, expected 1 to {3 * grid[1] * grid[2]}")
    # nodes and rows of this rank; the clamped face is x = 0, whose nodes come first
    first, last = row_range(comm, 3 * count, 3)
    nodes = np.arange(first // 3, last // 3) + skipped
    place = np.array(np.unravel_index(nodes, grid)).T
    stiffness, mass = hexahedron(size / cells, young, poisson, density)
    indptr, indices, values = _rows(place, nodes, grid, cells, clamped, skipped, {"K": stiffness, "M": mass})
    dofs = _dofs(nodes, grid, size / cells, skipped)
    held = _dofs(np.arange(*row_range(comm, skipped)), grid, size / cells, skipped) if clamped else None
    material = Material(name="solid", young=young, poisson=poisson, density=density)
    elements = {"hexahedron": _hexahedra(comm, cells, grid, skipped)}
    # inputs are spread over the nodes of the face at the other end
    face = np.linspace(0, grid[1] * grid[2] - 1, -(-inputs // 3)).astype(int) + count - grid[1] * grid[2] + 1
    with SecondOrderModel.from_csr(
        comm, 3 * count, indptr, indices, values, dofs=dofs, held=held, name="solid", elements=elements,
        properties=ElementProperties.of_one(comm, elements, material),
    ) as model:
        return model.with_inputs([(int(node), direction) for node in face for direction in "xyz"][:inputs])


def _cells_for(dofs, clamped):
    """Return the cells of the block of the shape of the default one that comes nearest to a number of dofs."""

    def count(cells):
        return 3 * (cells[0] + (not clamped)) * (cells[1] + 1) * (cells[2] + 1)

    most = range(1, 3 + int((dofs / 3) ** (1 / 3)))
    blocks = ((max(round(DEFAULT[0] / DEFAULT[1] * k), 1), k, k) for k in most)
    return min(blocks, key=lambda cells: abs(count(cells) - dofs))


def _numbers(nodes, grid, skipped):
    """Return the numbers from 1 of nodes by their place in the grid, of which the first `skipped` come last."""
    return (nodes - skipped) % np.prod(grid) + 1


def _dofs(nodes, grid, edges, skipped):
    """Return the dofs of nodes by their place in the grid."""
    position = np.array(np.unravel_index(nodes, grid)).T * edges
    direction = np.tile(np.arange(3, dtype=np.int8), len(nodes))
    return Dofs(np.repeat(_numbers(nodes, grid, skipped), 3), direction, np.repeat(position, 3, axis=0))


def _hexahedra(comm, cells, grid, skipped):
    """Return node numbers (elements of this rank, 8)."""
    place = np.array(np.unravel_index(np.arange(*row_range(comm, prod(cells))), cells)).T
    corner = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
    stride = np.array([grid[1] * grid[2], grid[2], 1])
    return _numbers((place @ stride)[:, None] + corner @ stride, grid, skipped)


def _rows(place, nodes, grid, cells, clamped, skipped, elements):
    """Return CSR rows of the nodes at `place` (nodes, 3): 27 neighbours each, as far as they exist."""
    offsets = np.array(list(product((-1, 0, 1), repeat=3)))
    stride = np.array([grid[1] * grid[2], grid[2], 1])
    neighbour = place[:, None, :] + offsets
    lowest = np.array([1 if clamped else 0, 0, 0])
    exists = ((neighbour >= lowest) & (neighbour < grid)).all(axis=2)
    corners = list(product((0, 1), repeat=3))
    blocks = {key: np.zeros((len(nodes), 27, 3, 3)) for key in elements}
    for a, corner in enumerate(corners):
        cell = place - corner
        inside = ((cell >= 0) & (cell < cells)).all(axis=1)
        for b, other in enumerate(corners):
            offset = np.flatnonzero((offsets == np.subtract(other, corner)).all(axis=1))[0]
            for key, element in elements.items():
                blocks[key][inside, offset] += element[3 * a : 3 * a + 3, 3 * b : 3 * b + 3]
    columns = 3 * (nodes[:, None] + offsets @ stride - skipped)
    wide = np.broadcast_to(exists[:, None, :, None], (len(nodes), 3, 27, 3))
    indices = np.broadcast_to((columns[:, :, None] + np.arange(3))[:, None], wide.shape)[wide]
    values = {key: block.transpose(0, 2, 1, 3)[wide] for key, block in blocks.items()}
    lengths = np.repeat(3 * exists.sum(axis=1), 3)
    return np.concatenate([[0], np.cumsum(lengths)]), indices, values




def hexahedron(edges, young, poisson, density):
    """Return K (24, 24) and consistent M (24, 24) of a trilinear brick with the given edges, by 2 x 2 x 2 Gauss
    points."""
    edges = np.asarray(edges, dtype=float)
    corners = np.array(list(product((-1, 1), repeat=3)))
    elastic = elasticity(young, poisson)
    stiffness, scalar = np.zeros((24, 24)), np.zeros((8, 8))
    volume = np.prod(edges) / 8
    for point in corners / 3**0.5:
        terms = 1 + corners * point
        shape = terms.prod(axis=1) / 8
        gradient = np.array(
            [corners[:, d] * np.delete(terms, d, axis=1).prod(axis=1) / 8 * 2 / edges[d] for d in range(3)]
        )
        strain = np.zeros((6, 24))
        for d in range(3):
            strain[d, d::3] = gradient[d]
        for row, (d, e) in enumerate(((0, 1), (1, 2), (0, 2)), start=3):
            strain[row, d::3], strain[row, e::3] = gradient[e], gradient[d]
        stiffness += volume * strain.T @ elastic @ strain
        scalar += volume * density * np.outer(shape, shape)
    return (stiffness + stiffness.T) / 2, np.kron(scalar, np.eye(3))
