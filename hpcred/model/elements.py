"""Finite elements as far as pictures need them: the nodes of every element, by kind."""

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
EDGES = {
    "line": [(0, 1)], "line3": [(0, 2), (2, 1)],
    "triangle": [(0, 1), (1, 2), (2, 0)], "quad": [(0, 1), (1, 2), (2, 3), (3, 0)],
    "tetra": [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)],
    "pyramid": [(0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 4), (2, 4), (3, 4)],
    "wedge": [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)],
    "hexahedron": [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)],
}  # fmt: skip
FACES = {
    "triangle": [(0, 1, 2)], "quad": [(0, 1, 2, 3)],
    "tetra": [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)],
    "pyramid": [(0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)],
    "wedge": [(0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)],
    "hexahedron": [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)],
}  # fmt: skip
SHELLS = ("triangle", "quad")


def abaqus_kind(name: str) -> str | None:
    """The kind of an Abaqus element type, whatever its integration: C3D8R is a hexahedron. None if not known."""
    letters = name.upper()
    fitting = [key for key in ABAQUS if letters.startswith(key) and not letters[len(key) :][:1].isdigit()]
    return ABAQUS[max(fitting, key=len)] if fitting else None


def edges(kind: str) -> list[tuple[int, int]]:
    """Pairs of places in the list of an element's nodes; straight edges of the corners for curved kinds."""
    return EDGES.get(kind) or EDGES[linear_kind(kind)]


def linear_kind(kind: str) -> str:
    """The kind with the same corners and no other nodes: hexahedron for hexahedron20."""
    return kind.rstrip("0123456789")


def faces(kind: str) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    """For each face of an element, of a shell itself: places of its corners in order, and of the nodes in the middle
    of the edges that follow them (empty for linear kinds); none for lines.

    The nodes in the middle of edges follow the corners, in the order of `edges`.
    """
    corners = FACES.get(linear_kind(kind), [])
    if kind in EDGES:
        return [(face, ()) for face in corners]
    pairs = [frozenset(pair) for pair in edges(kind)]
    first = NODES[linear_kind(kind)]
    return [
        (face, tuple(first + pairs.index(frozenset(pair)) for pair in zip(face, face[1:] + face[:1], strict=True)))
        for face in corners
    ]


def in_vtk_order(kind: str, nodes: np.ndarray) -> np.ndarray:
    """Abaqus numbers the middle of a line3 second, VTK last; the other kinds agree."""
    return nodes[:, [0, 2, 1]] if kind == "line3" else nodes
