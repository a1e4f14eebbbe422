"""Bodies to draw: points and elements."""

import numpy as np


def block(n, m, l, size=(1.0, 1.0, 1.0)):
    """Points and hexahedra of a block."""
    axes = [np.linspace(0, edge, count + 1) for edge, count in zip(size, (n, m, l), strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    i = np.arange(len(points)).reshape(n + 1, m + 1, l + 1)
    a, b = slice(None, -1), slice(1, None)
    places = [(a, a, a), (b, a, a), (b, b, a), (a, b, a), (a, a, b), (b, a, b), (b, b, b), (a, b, b)]
    return points, np.stack([i[place].ravel() for place in places], axis=1)


def mapped_block(n, m, l, place, quadratic=False):
    """Points and elements by kind of a block whose points (k, 3) of the unit cube are put in their `place`; those that
    meet are one, as in a ring. Quadratic elements have their middles in place too."""
    fine = 2 if quadratic else 1
    unit, cells = block(fine * n, fine * m, fine * l)
    kind = "hexahedron"
    if quadratic:
        kind, shape = "hexahedron20", (2 * n + 1, 2 * m + 1, 2 * l + 1)
        number = np.arange(len(unit)).reshape(shape)
        i, j, k = (2 * x.ravel() for x in np.meshgrid(range(n), range(m), range(l), indexing="ij"))
        corners = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2)]
        middles = [(1, 0, 0), (2, 1, 0), (1, 2, 0), (0, 1, 0), (1, 0, 2), (2, 1, 2), (1, 2, 2), (0, 1, 2),
                   (0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1)]  # fmt: skip
        cells = np.stack([number[i + a, j + b, k + c] for a, b, c in corners + middles], axis=1)
    points = place(unit)
    _, first, same = np.unique(points.round(9), axis=0, return_index=True, return_inverse=True)
    cells = same.reshape(-1)[cells]
    used, cells = np.unique(cells, return_inverse=True)
    return points[first[used]], {kind: cells.reshape(-1, 20 if quadratic else 8)}


def model_of_mesh(points, cells, comm):
    """A model with x, y, z at every point, numbered from 1, and elements, but for M and K, which are I."""
    import scipy.sparse

    import hpcred
    from hpcred.parallel.shares import row_range

    count = len(points)
    dofs = hpcred.Dofs(np.repeat(np.arange(1, count + 1), 3), np.tile([0, 1, 2], count), np.repeat(points, 3, axis=0))
    mine = {kind: part[slice(*row_range(comm, len(part)))] + 1 for kind, part in cells.items()}
    eye = scipy.sparse.eye(3 * count, format="csr")
    return hpcred.SecondOrderModel.from_scipy(eye, eye, comm=comm, dofs=dofs, elements=mine)
