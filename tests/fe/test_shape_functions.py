"""Shape functions and integration points, against their definitions and exact integrals."""

from itertools import product
from math import factorial

import numpy as np
import pytest

import hpcred
from hpcred.fe.elements import CORNERS as FACE_CORNERS
from hpcred.fe.elements import FACES, NODES
from hpcred.fe.shape_functions import (
    CORNERS,
    EDGES,
    SOLIDS,
    corner_kind,
    extrapolation,
    gradients_in_space,
    integration_points,
    local_nodes,
    shape_functions,
)

KINDS = (*CORNERS, *EDGES)
SOMEWHERE = np.random.default_rng(3).random((5, 3)) / 3
SIZES = {"triangle": 1 / 2, "quad": 4, "tetra": 1 / 6, "wedge": 1, "hexahedron": 8}
# polynomials that the points integrate: complete degree, or degree in each coordinate
EXACT = {
    ("tetra", "full"): 1, ("tetra10", "full"): 2, ("wedge", "full"): (1, 3), ("wedge15", "full"): (2, 5),
    ("hexahedron", "full"): 3, ("hexahedron", "reduced"): 1, ("hexahedron20", "full"): 5,
    ("hexahedron20", "reduced"): 3, ("triangle", "full"): 1, ("triangle6", "full"): 2, ("quad", "full"): 3,
    ("quad", "reduced"): 1, ("quad8", "full"): 5, ("quad8", "reduced"): 3,
}  # fmt: skip


def points_of(kind):
    return SOMEWHERE[:, : local_nodes(kind).shape[1]]


@pytest.mark.parametrize("kind", KINDS)
def test_shape_functions_are_one_at_their_node_only(kind):
    nodes = local_nodes(kind)
    assert len(nodes) == NODES[kind]
    assert np.allclose(shape_functions(kind, nodes)[0], np.eye(len(nodes)), atol=1e-15)


@pytest.mark.parametrize("kind", KINDS)
def test_the_field_of_a_polynomial_of_the_nodes_is_the_polynomial(kind):
    """Partition of unity, linear completeness, and completeness of second order of the curved kinds."""
    nodes, points = local_nodes(kind), points_of(kind)
    N, dN = shape_functions(kind, points)
    order = 2 if kind in EDGES else 1
    for power in product(range(order + 1), repeat=nodes.shape[1]):
        if sum(power) > order:
            continue
        assert np.allclose(N @ (nodes**power).prod(axis=1), (points**power).prod(axis=1), atol=1e-14)
        for axis, exponent in enumerate(power):
            lower = np.array(power)
            lower[axis] = max(exponent - 1, 0)
            wanted = exponent * (points**lower).prod(axis=1)
            assert np.allclose(dN[..., axis] @ (nodes**power).prod(axis=1), wanted, atol=1e-14)


@pytest.mark.parametrize("kind", KINDS)
def test_local_gradients_are_those_of_finite_differences(kind):
    points, step = points_of(kind), 1e-5
    dN = shape_functions(kind, points)[1]
    for axis in range(points.shape[1]):
        move = step * np.eye(points.shape[1])[axis]
        above, below = (shape_functions(kind, points + sign * move)[0] for sign in (1, -1))
        assert np.allclose(dN[..., axis], (above - below) / (2 * step), atol=1e-9)


@pytest.mark.parametrize("kind", SOLIDS)
def test_shape_functions_of_a_face_are_those_of_the_element_on_it(kind):
    """At points of a face, functions of the other nodes vanish, and those of its nodes are those of the face."""
    by_count = {3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8"}
    for face in FACES[kind]:
        other = by_count[len(face)]
        on = points_of(other)
        N = shape_functions(other, on)[0]
        inside = shape_functions(corner_kind(other), on)[0] @ local_nodes(kind)[list(face[: FACE_CORNERS[len(face)]])]
        found = shape_functions(kind, inside)[0]
        assert np.allclose(found[:, face], N, atol=1e-14)
        assert np.allclose(np.delete(found, face, axis=1), 0, atol=1e-14)


def integral(base, power):
    """Return the integral of a monomial over the local element."""

    def along(p):
        return 0 if p % 2 else 2 / (p + 1)

    if base in ("quad", "hexahedron"):
        return np.prod([along(p) for p in power])
    plane = power[:2] if base == "wedge" else power
    # Dirichlet's formula
    flat = np.prod([factorial(p) for p in plane]) / factorial(sum(plane) + len(plane))
    return flat * along(power[2]) if base == "wedge" else flat


@pytest.mark.parametrize(("kind", "scheme"), EXACT)
def test_integration_points_integrate_polynomials(kind, scheme):
    points, weights = integration_points(kind, scheme)
    assert np.isclose(weights.sum(), SIZES[corner_kind(kind)])
    degree, base = EXACT[kind, scheme], corner_kind(kind)
    for power in product(range(6), repeat=points.shape[1]):
        if base in ("triangle", "tetra"):
            exact = sum(power) <= degree
        elif base == "wedge":
            exact = sum(power[:2]) <= degree[0] and power[2] <= degree[1]
        else:
            exact = max(power) <= degree
        if exact:
            assert np.isclose(weights @ (points**power).prod(axis=1), integral(base, power), atol=1e-14)


@pytest.mark.parametrize(("kind", "scheme", "count"), [
    ("tetra", "full", 1), ("tetra10", "full", 4), ("wedge", "full", 2), ("wedge15", "full", 9),
    ("hexahedron", "full", 8), ("hexahedron", "reduced", 1), ("hexahedron20", "full", 27),
    ("hexahedron20", "reduced", 8),
])  # fmt: skip
def test_types_have_as_many_integration_points_as_in_calculix(kind, scheme, count):
    assert len(integration_points(kind, scheme)[0]) == count


def test_the_first_coordinate_runs_fastest():
    assert np.allclose(integration_points("hexahedron")[0][:3] * 3**0.5, [(-1, -1, -1), (1, -1, -1), (-1, 1, -1)])
    assert np.allclose(integration_points("wedge15")[0][1], [2 / 3, 1 / 6, -(0.6**0.5)])
    assert integration_points("tetra10")[0][1].argmax() == 0


@pytest.mark.parametrize("kind", SOLIDS)
def test_gradients_in_space_and_volumes_of_an_affine_element(kind):
    """Of an element that a linear map A makes: gradients of x, y, z are the identity, and the volume is |A| times."""
    rng = np.random.default_rng(5)
    maps = np.eye(3) + 0.3 * rng.random((4, 3, 3))
    positions = local_nodes(kind) @ maps.transpose(0, 2, 1) + rng.random((4, 1, 3))
    points, weights = integration_points(kind)
    gradients, determinants = gradients_in_space(shape_functions(kind, points)[1], positions)
    assert np.allclose(np.einsum("egkx,eky->egxy", gradients, positions), np.eye(3), atol=1e-13)
    assert np.allclose(determinants @ weights, np.linalg.det(maps) * SIZES[corner_kind(kind)])


@pytest.mark.parametrize("kind", SOLIDS)
@pytest.mark.parametrize("scheme", ["full", "reduced"])
def test_linear_fields_are_extrapolated_to_the_nodes(kind, scheme):
    points, nodes = integration_points(kind, scheme)[0], local_nodes(kind)
    matrix = extrapolation(kind, scheme)
    assert np.allclose(matrix.sum(axis=1), 1)
    known = [axis for axis in range(3) if np.ptp(points[:, axis]) > 0]
    assert np.allclose((matrix @ points)[:, known], nodes[:, known], atol=1e-13)


def test_extrapolation_of_27_points_is_that_of_calculix():
    """Digits of CalculiX' table for 27 points; for 8 points its table has the trilinear functions at the corners."""
    matrix = extrapolation("hexahedron20")
    assert np.allclose(matrix[:9, 0], [2.37499, -0.12559, -0.16145, -0.12559, -0.12559, -0.16145, 0.11575, -0.16145,
                                       0.32628], atol=5e-6)  # fmt: skip
    assert np.allclose(extrapolation("hexahedron20", "reduced")[:4, 0], [2.549, -0.683, 0.183, -0.683], atol=5e-5)
    assert np.allclose(extrapolation("wedge15")[:6, 0], [1.63138, -0.32628, -0.32628, -0.52027, 0.10405, 0.10405],
                       atol=5e-6)  # fmt: skip


def test_kinds_and_schemes_that_do_not_exist_are_refused():
    with pytest.raises(hpcred.InputError, match=r"found the kind 'pyramid', expected one of triangle, quad, tetra"):
        local_nodes("pyramid")
    with pytest.raises(hpcred.InputError, match=r"found 'hexahedron', 'half', expected a solid or a face, and full or"):
        integration_points("hexahedron", "half")
    with pytest.raises(hpcred.InputError, match=r"found 'line', 'full', expected a solid"):
        integration_points("line")
