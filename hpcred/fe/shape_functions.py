"""Evaluate shape functions of solid elements and of their faces, and list the points at which programs integrate them.

Nodes are in the order of VTK, which is that of Abaqus and CalculiX. Local coordinates: -1 to 1 for hexahedra and
quadrilaterals; of tetrahedra and triangles from the first node along the edges to the others, each 0 to 1; wedges are
triangles in the first two, and -1 to 1 in the third. Integration points are in the order in which CalculiX prints them.
"""

from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from ..parallel.failures import InputError
from .elements import edges

SQUARE = ((-1, -1), (1, -1), (1, 1), (-1, 1))
TRIANGLE = ((0, 0), (1, 0), (0, 1))
CORNERS = {
    "triangle": TRIANGLE, "quad": SQUARE,
    "tetra": ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "wedge": tuple((*place, level) for level in (-1, 1) for place in TRIANGLE),
    "hexahedron": tuple((*place, level) for level in (-1, 1) for place in SQUARE),
}  # fmt: skip
# of the curved kinds, each with a node in its middle
EDGES = {kind: edges(kind) for kind in ("triangle6", "quad8", "tetra10", "wedge15", "hexahedron20")}
SOLIDS = ("tetra", "tetra10", "wedge", "wedge15", "hexahedron", "hexahedron20")
GAUSS = {1: ((0.0,), (2.0,)), 2: ((-(3**-0.5), 3**-0.5), (1.0, 1.0)),
         3: ((-(0.6**0.5), 0.0, 0.6**0.5), (5 / 9, 8 / 9, 5 / 9))}  # fmt: skip
NEAR, FAR = (5 - 5**0.5) / 20, (5 + 3 * 5**0.5) / 20  # coordinates of four points in a tetrahedron
SIMPLEX = {  # points and total weight
    ("triangle", 1): (((1 / 3, 1 / 3),), 1 / 2),
    ("triangle", 3): (((1 / 6, 1 / 6), (2 / 3, 1 / 6), (1 / 6, 2 / 3)), 1 / 2),
    ("tetra", 1): (((1 / 4, 1 / 4, 1 / 4),), 1 / 6),
    ("tetra", 4): (((NEAR, NEAR, NEAR), (FAR, NEAR, NEAR), (NEAR, FAR, NEAR), (NEAR, NEAR, FAR)), 1 / 6),
}  # fmt: skip
# points of a tetrahedron or triangle, points along each side of a hexahedron or quadrilateral, or both for wedges
POINTS = {
    "full": {"tetra": 1, "tetra10": 4, "wedge": (1, 2), "wedge15": (3, 3), "hexahedron": 2, "hexahedron20": 3,
             "triangle": 1, "triangle6": 3, "quad": 2, "quad8": 3},
    "reduced": {"hexahedron": 1, "hexahedron20": 2, "quad": 1, "quad8": 2},
}  # fmt: skip


def corner_kind(kind: str) -> str:
    """Return the kind of the same shape that has corners only: hexahedron of hexahedron20."""
    return kind.rstrip("0123456789")


def local_nodes(kind: str) -> np.ndarray:
    """Return the local coordinates (k, dim) of the nodes of a kind of element. Raises InputError."""
    if corner_kind(kind) not in CORNERS or (kind not in CORNERS and kind not in EDGES):
        raise InputError(f"elements: found the kind '{kind}', expected one of {', '.join((*CORNERS, *EDGES))}")
    corners = np.array(CORNERS[corner_kind(kind)], dtype=float)
    return np.concatenate([corners, *(corners[list(edge)].mean(axis=0)[None] for edge in EDGES.get(kind, ()))])


def shape_functions(kind: str, points: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Return the values N (g, k) and the local gradients dN (g, k, dim) of the shape functions of a solid or a face, by
    its kind, at points (g, dim) in local coordinates. Raises InputError for other kinds."""
    nodes = local_nodes(kind)
    powers = _powers(kind)
    # each shape function is 1 at its node and 0 at the others; all coefficients are multiples of 1/8
    coefficients = np.round(8 * np.linalg.inv(_monomials(nodes, powers))) / 8
    places = np.array(points, dtype=float).reshape(-1, nodes.shape[1])
    gradients = []
    for axis in range(nodes.shape[1]):
        lower = powers.copy()
        lower[:, axis] = np.maximum(lower[:, axis] - 1, 0)
        gradients.append((_monomials(places, lower) * powers[:, axis]) @ coefficients)
    return _monomials(places, powers) @ coefficients, np.stack(gradients, axis=-1)


def _powers(kind):
    """Return the exponents (k, dim) of the monomials that the shape functions of a kind are made of."""
    curved, base = kind in EDGES, corner_kind(kind)
    dim = len(CORNERS[base][0])
    powers = []
    for power in product(range(3 if curved else 2), repeat=dim):
        if base in ("triangle", "tetra"):
            inside = sum(power) <= 1 + curved
        elif base == "wedge":
            inside = sum(power[:2]) <= 1 + curved - (power[2] == 2)
        else:  # serendipity: terms of second order are linear in the other directions
            inside = sum(p for p in power if p == 2) <= 2
        if inside:
            powers.append(power)
    return np.array(powers)


def _monomials(points, powers):
    """Return the values (g, k) of monomials at points (g, dim)."""
    return np.prod(points[:, None, :] ** powers, axis=2)


def integration_points(kind: str, scheme: str = "full") -> tuple[np.ndarray, np.ndarray]:
    """Return integration points and weights of a solid or a face.

    Parameters
    ----------
    kind : str
        Kind of a solid, or of a face.
    scheme : str, default "full"
        "full" or "reduced", as the element types of Abaqus and CalculiX: C3D4 has 1 point, C3D10 4, C3D6 2, C3D15 9,
        C3D8 8, C3D8R 1, C3D20 27, C3D20R 8. Kinds without reduced integration have the full one.

    Returns
    -------
    points : ndarray, shape (g, dim)
        Local coordinates, in the order in which CalculiX prints integration points.
    weights : ndarray, shape (g,)

    Raises
    ------
    InputError
        For other kinds and schemes.
    """
    if scheme not in POINTS or kind not in POINTS["full"]:
        asked = f"'{kind}', '{scheme}'"
        raise InputError(f"integration: found {asked}, expected a solid or a face, and {' or '.join(POINTS)}")
    count, base = POINTS[scheme].get(kind, POINTS["full"][kind]), corner_kind(kind)
    if base in ("triangle", "tetra"):
        points, total = SIMPLEX[base, count]
        weights = np.full(len(points), total / len(points))
    elif base == "wedge":
        plane, total = SIMPLEX["triangle", count[0]]
        heights, along = GAUSS[count[1]]
        points = [(*place, height) for height in heights for place in plane]
        weights = np.repeat(along, len(plane)) * total / len(plane)
    else:
        places, along = GAUSS[count]
        dim = len(CORNERS[base][0])
        points = [place[::-1] for place in product(places, repeat=dim)]  # the first coordinate runs fastest
        weights = np.prod(list(product(along, repeat=dim)), axis=1)
    return np.array(points), np.array(weights)


def gradients_in_space(dN: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradients (e, g, k, 3) of the shape functions in space, and the determinants (e, g) of the Jacobian.

    `dN` (g, k, 3): local gradients of a solid; `positions` (e, k, 3): of the nodes of the elements, in m. The
    gradients are in 1/m; weights times determinants are volumes in m^3. Where a determinant is 0, they are not finite.
    """
    jacobian = np.einsum("gkd,ekx->egdx", dN, positions)
    # the inverse by cross products, for many small matrices at once
    a, b, c = jacobian[..., 0, :], jacobian[..., 1, :], jacobian[..., 2, :]
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-1)  # (e, g, x, d)
    determinant = np.einsum("egx,egx->eg", a, cofactors[..., 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = cofactors / determinant[..., None, None]
    return np.einsum("egxd,gkd->egkx", inverse, dN), determinant


def extrapolation(kind: str, scheme: str = "full") -> np.ndarray:
    """Return the matrix (k, g) that takes values at integration points to the nodes of a solid.

    The least-squares fit of shape functions to the points, evaluated at the nodes: of the shape functions of the kind
    for 27 points, else of the corners only, with mean values in the middle of edges; a constant for a single point.
    """
    points, _ = integration_points(kind, scheme)
    fitted = kind if len(points) > len(local_nodes(kind)) else corner_kind(kind)
    fit = np.linalg.pinv(shape_functions(fitted, points)[0])
    return shape_functions(fitted, local_nodes(kind))[0] @ fit
