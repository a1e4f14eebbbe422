"""Decide which faces of a surface lie on a cylinder, around a hole or on a pin.

The corners of such a face lie on the cylinder, its normal is approximately radial, and it spans less than a sixth of a
turn, so that the flats of a hexagon are excluded. Edge midpoints may lie on the cylinder or on the chords.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..parallel.petsc import MPI
from .elements import free
from .faces import Faces, faces_of, faces_of_elements, places_of

NEAR = 2e-3  # of the radius: distance of a node from the cylinder that it counts to
DIGITS = 4e-6  # of the largest coordinate: what mesh files with few digits leave of it
WIDEST = np.cos(np.radians(52.0))  # of the angle between the ends of an edge
STEEPEST = 0.8  # cosine between the normal of a face and the axis
RADIAL = 0.4  # cosine between the normal of a face and the direction from the axis, at least


@dataclass(frozen=True, eq=False)
class Cylinder:
    """A cylinder around the line through `point` (3,) along the unit vector `axis` (3,), and its `radius`, all in m."""

    point: np.ndarray
    axis: np.ndarray
    radius: float

    def along(self, points):
        """Return coordinates (k,) of points (k, 3) along the axis, from its point on."""
        return (points - self.point) @ self.axis

    def outwards(self, points):
        """Return vectors (k, 3) from the axis to points (k, 3), at right angles to it."""
        arm = points - self.point
        return arm - (arm @ self.axis)[..., None] * self.axis

    def near(self, points, tolerance: float):
        """Test whether points (k, 3) lie on the cylinder."""
        return np.abs(np.linalg.norm(self.outwards(points), axis=-1) - self.radius) <= tolerance


def slack_of(radius: float, largest: float) -> float:
    """Return how far nodes may be from a cylinder, where the largest coordinate of the body is given."""
    return max(NEAR * radius, DIGITS * largest)


def normals_of(faces: Faces, points):
    """Return unit normals (f, 3) of faces, indices of points (v, 3), away from the nodes behind them; zero of folded
    ones."""
    corners = faces.corners
    last = np.where(corners[:, 3] < 0, corners[:, 2], corners[:, 3])
    a, b, c, d = (points[column] for column in (corners[:, 0], corners[:, 1], corners[:, 2], last))
    normals = np.cross(c - a, d - b)
    size = np.linalg.norm(normals, axis=1)
    scale = np.maximum(np.linalg.norm(c - a, axis=1), np.linalg.norm(d - b, axis=1)) ** 2
    normals = np.where((size > 1e-9 * scale)[:, None], normals / np.maximum(size, 1e-300)[:, None], 0.0)
    solid = faces.behind >= 0
    inwards = ((points[np.where(solid, faces.behind, 0)] - a) * normals).sum(axis=1) > 0
    return np.where((solid & inwards)[:, None], -normals, normals)


def on_cylinder(faces: Faces, points, normals, cylinder: Cylinder, tolerance: float, inwards: bool) -> np.ndarray:
    """Return which faces (f,) lie on a cylinder, `inwards`: around a hole. Shells have no inside, and lie on both."""
    # faces with all corners near the cylinder
    corners, middles = faces.corners, faces.middles
    there = corners >= 0
    place = np.where(there, corners, corners[:, :1])
    near = cylinder.near(points, tolerance)
    hit = near[place].all(axis=1)  # most faces end here
    inside = np.zeros(len(corners), bool)
    corners, middles, there, place = corners[hit], middles[hit], there[hit], place[hit]
    # the cosine of the angle between the ends of each edge, half of it where the middle lies on the cylinder too
    arm = cylinder.outwards(points[place])
    unit = arm / np.maximum(np.linalg.norm(arm, axis=2), 1e-300)[..., None]
    following = np.where(np.roll(there, -1, axis=1)[..., None], np.roll(unit, -1, axis=1), unit[:, :1])
    between = (unit * following).sum(axis=2)
    curved = (middles >= 0) & near[middles]
    between = np.where(curved, np.sqrt((1 + between.clip(-1, 1)) / 2), between)  # of half the angle
    # how much the normal points to the axis, or from it
    mean, normals = unit.mean(axis=1), normals[hit]
    facing = (mean * normals).sum(axis=1) / np.maximum(np.linalg.norm(mean, axis=1), 1e-300)
    facing = np.where(faces.behind[hit] < 0, np.abs(facing), -facing if inwards else facing)
    inside[hit] = (between >= WIDEST).all(axis=1) & (np.abs(normals @ cylinder.axis) <= STEEPEST) & (facing > RADIAL)
    return inside


def nodes_on_cylinder(model, ends, radius: float, inwards: bool) -> np.ndarray:
    """Return the numbers (k,), ascending, of the nodes of the surface on a cylinder between two `ends` (2, 3) of its
    axis, the same on all ranks; `inwards`: around a hole. Collective."""
    # nodes near the cylinder between its ends
    comm, (start, end) = model.comm, np.array(ends)
    length = np.linalg.norm(end - start)
    cylinder = Cylinder(start, (end - start) / length, radius)
    position = model.dofs.position
    tolerance = slack_of(radius, comm.allreduce(float(np.abs(position).max(initial=0.0)), op=MPI.MAX))
    along = cylinder.along(position)
    near = cylinder.near(position, tolerance) & (along >= -tolerance) & (along <= length + tolerance)
    # faces of the elements that have them, of which those between two elements drop out; as large as the set
    nodes = np.unique(np.concatenate(comm.allgather(np.unique(model.dofs.node[near]))))
    beside = {kind: cells[np.isin(cells, nodes).sum(axis=1) >= 3] for kind, cells in model.elements.items()}
    faces = faces_of_elements(beside)
    table = faces.all_nodes[((faces.corners < 0) | np.isin(faces.corners, nodes)).all(axis=1)]
    table = np.concatenate(comm.allgather(table))
    table = table[free(table[:, :4], table[:, 8] >= 0)]
    # places of their nodes, and which of the faces lie on the cylinder
    nodes = np.unique(table[table >= 0])
    there, points = places_of(model, nodes)
    nodes, points = nodes[there], points[there]
    index = np.searchsorted(nodes, table).clip(max=max(len(nodes) - 1, 0))
    placed = ((table < 0) | np.isin(table, nodes)).all(axis=1)
    faces = faces_of(np.where(table < 0, -1, index)[placed])
    on = faces.take(on_cylinder(faces, points, normals_of(faces, points), cylinder, tolerance, inwards))
    indices = np.unique(np.hstack([on.corners, on.middles]))
    return nodes[indices[indices >= 0]]
