"""Which faces lie on a cylinder."""

import numpy as np
import pytest

from hpcred.fe.cylinders import Cylinder, on_cylinder
from hpcred.fe.faces import Faces


@pytest.mark.parametrize("first", range(4))
def test_all_corners_of_a_face_lie_on_its_cylinder(first):
    """Whichever node is the first of the model; a triangle has no fourth corner."""
    angles, heights = np.array([0.0, 0.3, 0.3, 0.0]), np.array([0.0, 0.0, 0.2, 0.2])
    order = np.roll(np.arange(4), first)
    points = np.column_stack([np.cos(angles), np.sin(angles), heights])[order]
    faces = Faces(np.array([np.argsort(order), [*np.argsort(order)[:3], -1]]), np.full((2, 4), -1), np.full(2, -1))
    normals = np.tile([np.cos(0.15), np.sin(0.15), 0.0], (2, 1))
    hole = Cylinder(np.zeros(3), np.array([0.0, 0.0, 1.0]), 1.0)
    assert on_cylinder(faces, points, normals, hole, 1e-6, True).tolist() == [True, True]
    for node in range(4):
        moved = points.copy()
        moved[node, :2] *= 1.01
        assert on_cylinder(faces, moved, normals, hole, 1e-6, True).tolist() == [False, order[node] == 3]
