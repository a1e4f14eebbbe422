"""The tables of elements: surfaces of solids are closed, and edges of the same nodes have the same node between."""

from collections import Counter

import numpy as np
import pytest

from hpcred.fe.elements import CORNERS, EDGES, FACES, NODES, free
from hpcred.fe.faces import surface_faces
from hpcred.parallel.petsc import MPI

SOLIDS = [kind for kind in FACES if kind.rstrip("0123456789") in ("tetra", "pyramid", "wedge", "hexahedron")]


def sides(face):
    """The sides of a face as (corner, corner), each with the node between, or None."""
    corners = face[: CORNERS[len(face)]]
    between = face[len(corners) :] or (None,) * len(corners)
    return list(zip(zip(corners, corners[1:] + corners[:1], strict=True), between, strict=True))


@pytest.mark.parametrize("kind", SOLIDS)
def test_the_surface_of_a_solid_is_closed(kind):
    """Each side of a face is the side of one other face, in the other direction; Euler's formula holds."""
    found = [side for face in FACES[kind] for side, _ in sides(face)]
    assert Counter(found) == Counter((b, a) for a, b in found) and set(Counter(found).values()) == {1}
    assert len({corner for side in found for corner in side}) - len(found) // 2 + len(FACES[kind]) == 2


@pytest.mark.parametrize("kind", SOLIDS)
def test_the_node_between_two_corners_is_the_same_on_both_faces(kind):
    known = {}
    for face in FACES[kind]:
        for (a, b), middle in sides(face):
            assert known.setdefault(frozenset((a, b)), middle) == middle
    assert {node for face in FACES[kind] for node in face} == set(range(NODES[kind]))
    if None not in known.values():
        assert len(set(known.values())) == len(known)


@pytest.mark.parametrize("kind", ["triangle", "triangle6", "quad", "quad8"])
def test_a_shell_has_one_face_of_all_its_nodes(kind):
    (face,) = FACES[kind]
    assert face == tuple(range(NODES[kind]))


@pytest.mark.parametrize("kind", EDGES)
def test_edges_are_the_sides_of_the_faces(kind):
    if kind in FACES:
        found = {frozenset(side) for face in FACES[kind] for side, _ in sides(face)}
        assert {frozenset(edge) for edge in EDGES[kind]} == found
    elif kind == "line3":
        assert EDGES[kind] == [(0, 2), (2, 1)]
    else:
        assert EDGES[kind] == [(0, 1)]


def test_faces_of_one_solid_are_free():
    """A quadrilateral that is folded to a triangle is the face of another solid with three of its nodes, and not that
    of a quadrilateral with one node more, which may be node 0; a shell on a solid is its face."""
    solids = np.array([[1, 2, 3, 3], [3, 1, 2, 2], [0, 1, 2, 3], [4, 5, 6, 7], [7, 6, 5, 4], [8, 9, 10, 11]])
    assert free(solids[[0, 2]], np.array([True, True])).tolist() == [True, True]
    assert free(solids, np.ones(6, dtype=bool)).tolist() == [False, False, True, False, False, True]
    shells = np.array([True, True, False, False])
    faces = np.array([[0, 1, 2, 3], [4, 5, 6, 7], [3, 2, 1, 0], [7, 8, 9, 10]])
    assert free(faces, shells).tolist() == [True, True, False, True]


def test_shells_on_each_other_are_one_face():
    """Unlike faces of solids, of which two on each other are inside."""
    quads = surface_faces(MPI.COMM_WORLD, {"quad": np.array([[1, 2, 3, 4], [1, 2, 3, 4]])})
    bricks = surface_faces(MPI.COMM_WORLD, {"hexahedron": np.array([np.arange(1, 9)] * 2)})
    assert (len(quads.corners), len(bricks.corners)) == (1, 0)
