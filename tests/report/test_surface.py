"""The surface of a body: closed, of the right area and volume, with the edges that a person would draw."""

import numpy as np
import pytest
from bodies import block

from hpcred.fe.elements import FACES, NODES, edges
from hpcred.report.surface import SIDES, surface_of, thinned

CORNERS = {
    "tetra": ([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], 1 / 6),
    "pyramid": ([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1)], 1 / 3),
    "wedge": ([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1)], 1 / 2),
    "hexahedron": ([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)], 1.0),
}
QUADRATIC = {"tetra10": "tetra", "wedge15": "wedge", "hexahedron20": "hexahedron"}


def one(kind):
    """Points of one element, those in the middle of edges too, and its volume."""
    corners, volume = CORNERS[QUADRATIC.get(kind, kind)]
    corners = np.array(corners, dtype=float)
    middles = [corners[list(pair)].mean(axis=0) for pair in edges(kind)] if kind in QUADRATIC else []
    return np.concatenate([corners, np.reshape(middles, (-1, 3))]), volume


def areas(surface):
    a, b, c = (surface.points[surface.triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a) / 2


def lengths(points, pairs):
    return np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)


@pytest.mark.parametrize("kind", [*CORNERS, *QUADRATIC])
def test_faces_enclose_the_element(kind):
    """By the divergence theorem, with triangles all the same way round but for wedges, which come in both ways."""
    points, volume = one(kind)
    assert len(points) == NODES[kind] and {k for face in FACES[kind] for k in face} == set(range(NODES[kind]))
    surface = surface_of(points, {kind: np.arange(len(points))[None]})
    middle = points.mean(axis=0)
    a = surface.points[surface.triangles[:, 0]]
    assert np.abs((areas(surface) * (a - middle)).sum(axis=1)).sum() / 3 == pytest.approx(volume)
    outwards = areas(surface) * np.sign((areas(surface) * (a - middle)).sum(axis=1))[:, None]
    assert np.abs(outwards.sum(axis=0)).max() < 1e-14  # closed
    assert lengths(surface.points, surface.outline).sum() == pytest.approx(
        sum(np.linalg.norm(points[i] - points[j]) for i, j in edges(kind))
    )


def test_a_block_has_its_faces_and_twelve_edges():
    size = 2.0, 3.0, 0.5
    points, cells = block(4, 5, 3, size)
    surface = surface_of(points, {"hexahedron": cells})
    inside = (points > 0).all(axis=1) & (points < size).all(axis=1)
    assert sorted(surface.nodes) == sorted(np.flatnonzero(~inside))
    assert surface.points == pytest.approx(points[surface.nodes])
    assert len(surface.triangles) == 2 * 2 * (4 * 5 + 5 * 3 + 3 * 4)
    assert np.linalg.norm(areas(surface), axis=1).sum() == pytest.approx(2 * (6 + 1.5 + 1))
    assert lengths(surface.points, surface.outline).sum() == pytest.approx(4 * sum(size))
    assert len(surface.edges) == 2 * (4 * 5 + 5 * 3 + 3 * 4) * 4 / 2


def test_elements_of_different_kinds_share_faces():
    """A pyramid on a hexahedron, and a wedge that is written as a hexahedron with two nodes twice."""
    points = np.array([*CORNERS["hexahedron"][0], (0.5, 0.5, 2), (2, 0, 0), (2, 0, 1)], dtype=float)
    cells = {
        "hexahedron": np.array([[0, 1, 2, 3, 4, 5, 6, 7], [1, 9, 9, 2, 5, 10, 10, 6]]),
        "pyramid": np.array([[4, 5, 6, 7, 8]]),
    }
    surface = surface_of(points, cells)
    roof = np.sqrt(0.25 + 1) / 2
    expected = 4 * roof + 4 + (2 * 0.5 + 1 + np.sqrt(2))  # pyramid, block, wedge
    assert np.linalg.norm(areas(surface), axis=1).sum() == pytest.approx(expected)
    shell = surface_of(points, {**cells, "quad": np.array([[4, 5, 6, 7]])})
    assert len(shell.triangles) == len(surface.triangles) + 2  # seen whatever it lies on


def test_beams_are_tubes_and_lone_nodes_points():
    points = np.array([(0, 0, 0), (1, 0, 0), (1, 0, 2.0)])
    surface = surface_of(points, {"line": np.array([[0, 1], [1, 2]])})
    assert surface.nodes[:3].tolist() == [0, 1, 2] and len(surface.points) == 3 + 2 * 2 * SIDES
    away = np.linalg.norm(surface.points - points[surface.nodes], axis=1)[3:]
    assert away.max() < 0.03 and np.ptp(away) < 1e-12
    assert surface.outline.tolist() == [[0, 1], [1, 2]]
    cloud = surface_of(points, {})
    assert cloud.points is points and not len(cloud.triangles) and cloud.nodes.tolist() == [0, 1, 2]


def test_thinned_surfaces_keep_their_shape():
    points, cells = block(40, 30, 10, (4.0, 3.0, 1.0))
    whole = surface_of(points, {"hexahedron": cells})
    few = thinned(whole, 1000)
    assert 600 < len(few.points) <= 1000 and few.whole == len(whole.points)
    assert few.points == pytest.approx(points[few.nodes])
    assert np.linalg.norm(areas(few), axis=1).sum() == pytest.approx(38, rel=0.1)
    assert np.ptp(few.points, axis=0) == pytest.approx([4, 3, 1], rel=0.15)
    assert thinned(whole, 10**6) is whole
