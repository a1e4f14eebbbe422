"""Finite elements as far as pictures need them: the nodes of every element, by kind."""

from collections import Counter

import numpy as np

# names of the kinds are those of meshio
ABAQUS = {
    "C3D4": "tetra", "C3D10": "tetra10", "C3D8": "hexahedron", "C3D20": "hexahedron20", "C3D6": "wedge",
    "C3D15": "wedge15", "C3D5": "pyramid", "S3": "triangle", "S4": "quad", "S8": "quad8", "STRI3": "triangle",
    "STRI65": "triangle6", "B31": "line", "B33": "line", "B32": "line3", "T3D2": "line", "T3D3": "line3",
}  # fmt: skip
NODES = {
    "line": 2, "line3": 3, "triangle": 3, "triangle6": 6, "quad": 4, "quad8": 8, "tetra": 4, "tetra10": 10,
    "pyramid": 5, "wedge": 6, "wedge15": 15, "hexahedron": 8, "hexahedron20": 20,
}  # fmt: skip
FACES = {  # the corners first
    "triangle": [(0, 1, 2)], "triangle6": [(0, 1, 2, 3, 4, 5)], "quad": [(0, 1, 2, 3)],
    "quad8": [(0, 1, 2, 3, 4, 5, 6, 7)],
    "tetra": [(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)],
    "tetra10": [(0, 2, 1, 6, 5, 4), (0, 1, 3, 4, 8, 7), (1, 2, 3, 5, 9, 8), (2, 0, 3, 6, 7, 9)],
    "pyramid": [(0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)],
    "wedge": [(0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)],
    "wedge15": [(0, 2, 1, 8, 7, 6), (3, 4, 5, 9, 10, 11), (0, 1, 4, 3, 6, 13, 9, 12), (1, 2, 5, 4, 7, 14, 10, 13),
                (2, 0, 3, 5, 8, 12, 11, 14)],
    "hexahedron": [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)],
    "hexahedron20": [(0, 3, 2, 1, 11, 10, 9, 8), (4, 5, 6, 7, 12, 13, 14, 15), (0, 1, 5, 4, 8, 17, 12, 16),
                     (1, 2, 6, 5, 9, 18, 13, 17), (2, 3, 7, 6, 10, 19, 14, 18), (3, 0, 4, 7, 11, 16, 15, 19)],
}  # fmt: skip
CORNERS = {3: 3, 4: 4, 6: 3, 8: 4}  # of a face with so many nodes
EDGES = {
    "line": [(0, 1)], "line3": [(0, 2), (2, 1)],
    "triangle": [(0, 1), (1, 2), (2, 0)], "quad": [(0, 1), (1, 2), (2, 3), (3, 0)],
    "tetra": [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)],
    "pyramid": [(0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4)],
    "wedge": [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)],
    "hexahedron": [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)],
}  # fmt: skip


def abaqus_kind(name: str) -> str | None:
    """The kind of an Abaqus element type, whatever its integration: C3D8R is a hexahedron. None if not known."""
    letters = name.upper()
    fitting = [key for key in ABAQUS if letters.startswith(key) and not letters[len(key) :][:1].isdigit()]
    return ABAQUS[max(fitting, key=len)] if fitting else None


def edges(kind: str) -> list[tuple[int, int]]:
    """Pairs of places in the list of an element's nodes; straight edges of the corners for curved kinds."""
    return EDGES.get(kind) or EDGES[kind.rstrip("0123456789")]


def in_vtk_order(kind: str, nodes: np.ndarray) -> np.ndarray:
    """Abaqus numbers the middle of a line3 second, VTK last; the other kinds agree."""
    return nodes[:, [0, 2, 1]] if kind == "line3" else nodes


def surface_areas(comm, elements, points: dict) -> dict[int, float]:
    """The area (m^2) of the faces of solids and shells on a set of nodes, in equal shares of the nodes of each face.

    `elements`: node numbers by kind, of this rank; `points`: positions (3,) of the nodes of the set by number, the same
    on all ranks. A face that two elements share lies inside of the body and does not count. Collective.
    """
    numbers = np.array(sorted(points))
    mine = []
    for kind, nodes in elements.items():
        for face in FACES.get(kind, ()):
            found = nodes[:, face]
            mine += found[np.isin(found, numbers).all(axis=1)].tolist()
    faces = [face for part in comm.allgather(mine) for face in part]  # as large as the set
    keys = [tuple(sorted(face)) for face in faces]
    times = Counter(keys)
    areas = dict.fromkeys(points, 0.0)
    for face, key in zip(faces, keys, strict=True):
        if times[key] == 1:
            p = np.array([points[node] for node in face[: CORNERS[len(face)]]])
            # half the cross product of the diagonals, or of two sides of a triangle
            area = np.linalg.norm(np.cross(p[2] - p[0], p[-1] - p[1 if len(p) == 4 else 0])) / 2
            for node in face:
                areas[node] += area / len(face)
    return areas
