"""Describe finite elements as far as their surface is needed: nodes by kind of element, faces and areas."""

import itertools

import numpy as np

from ..parallel.failures import InputError
from ..parallel.lookup import look_up

# nodes of all kinds are in the order of VTK
ABAQUS = {
    "C3D4": "tetra", "C3D10": "tetra10", "C3D8": "hexahedron", "C3D20": "hexahedron20", "C3D6": "wedge",
    "C3D15": "wedge15", "C3D5": "pyramid", "S3": "triangle", "S4": "quad", "S8": "quad8", "STRI3": "triangle",
    "STRI65": "triangle6", "B31": "line", "B33": "line", "B32": "line3", "T3D2": "line", "T3D3": "line3",
    "SC6R": "wedge", "SC8R": "hexahedron", "M3D3": "triangle", "M3D4": "quad", "M3D6": "triangle6", "M3D8": "quad8",
    "CPS3": "triangle", "CPS4": "quad", "CPS6": "triangle6", "CPS8": "quad8", "CPE3": "triangle", "CPE4": "quad",
    "CPE6": "triangle6", "CPE8": "quad8", "B21": "line", "B23": "line", "B22": "line3", "T2D2": "line", "T2D3": "line3",
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
SHELLS = ("triangle", "triangle6", "quad", "quad8")


def check_elements(elements: dict, name: str):
    """Raise InputError unless the elements are node numbers (elements, nodes) by kinds that are known, or None."""
    for kind, nodes in (elements or {}).items():
        if kind not in NODES:
            raise InputError(f"{name}: found elements of the kind '{kind}', expected one of {', '.join(NODES)}")
        nodes = np.asarray(nodes)
        if not nodes.size:
            continue
        if nodes.ndim != 2 or nodes.shape[1] != NODES[kind] or nodes.dtype.kind not in "iu":
            raise InputError(
                f"{name}: elements: found {nodes.dtype} of shape {nodes.shape} for {kind}, expected node numbers "
                f"(elements, {NODES[kind]})"
            )


def abaqus_kind(name: str) -> str | None:
    """Return the kind of an Abaqus element type, whatever its integration: C3D8R is a hexahedron. None if not known."""
    letters = name.upper()
    fitting = [key for key in ABAQUS if letters.startswith(key) and not letters[len(key) :][:1].isdigit()]
    return ABAQUS[max(fitting, key=len)] if fitting else None


def abaqus_nodes_more(name: str) -> int:
    """Return how many nodes an Abaqus element type may name behind those of its kind: beams in space one for the
    direction of their section, C3D15V those in the middle of its sides."""
    letters = name.upper()
    if letters.startswith("C3D15V"):
        return 3
    return int(letters.startswith(("B31", "B32", "B33")))


def edges(kind: str) -> list[tuple[int, int]]:
    """Return pairs of places in the list of an element's nodes; straight edges of the corners for curved kinds."""
    return EDGES.get(kind) or EDGES[kind.rstrip("0123456789")]


def in_vtk_order(kind: str, nodes: np.ndarray) -> np.ndarray:
    """Return nodes in the order of VTK: Abaqus numbers the middle of a line3 second, VTK last; other kinds agree."""
    return nodes[:, [0, 2, 1]] if kind == "line3" else nodes


def all_faces(cells: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return corners (f, 4) and middles (f, 4) of the faces of all elements, and which are of solids (f,).

    `cells`: nodes (elements, k), not negative, by kind. -1 stands where a face has no such node; the middles are those
    of the edges after the corners.
    """
    corners, middles, solid = [np.zeros((0, 4), dtype=int)], [np.zeros((0, 4), dtype=int)], [np.zeros(0, dtype=bool)]
    for kind, nodes in cells.items():
        for face in FACES.get(kind, ()):
            count = CORNERS[len(face)]
            for target, places in ((corners, face[:count]), (middles, face[count:])):
                columns = np.full((len(nodes), 4), -1)
                columns[:, : len(places)] = nodes[:, list(places)]
                target.append(columns)
            solid.append(np.full(len(nodes), kind not in SHELLS))
    return np.concatenate(corners), np.concatenate(middles), np.concatenate(solid)


def nodes_behind(cells: dict[str, np.ndarray]) -> np.ndarray:
    """Return a corner (f,) of the element of each face, as all_faces has them, that is not on the face; -1 for
    shells."""
    behind = [np.zeros(0, dtype=int)]
    for kind, nodes in cells.items():
        for face in FACES.get(kind, ()):
            if kind in SHELLS:
                behind.append(np.full(len(nodes), -1))
                continue
            corners = nodes[:, : NODES[kind.rstrip("0123456789")]]
            off = (corners[:, :, None] != nodes[:, None, list(face)]).all(axis=2)
            behind.append(corners[np.arange(len(nodes)), off.argmax(axis=1)])
    return np.concatenate(behind)


def free(corners: np.ndarray, solid: np.ndarray) -> np.ndarray:
    """Return which faces count (f,): those of one solid only, and shells, each place once.

    A skin of shells on a solid is the face of the solid. One that is folded to a triangle or a line has fewer corners.
    """
    if not len(corners):
        return np.zeros(0, dtype=bool)
    keys = np.sort(corners, axis=1)
    keys[:, 1:][keys[:, 1:] == keys[:, :-1]] = -1
    group = equal_rows(np.sort(keys, axis=1))
    alone = np.bincount(group, weights=solid)[group] == 1
    shells = np.flatnonzero(~solid)
    first = np.zeros(len(group), dtype=bool)
    first[shells[np.unique(group[shells], return_index=True)[1]]] = True
    return (solid & alone) | (first & ~alone)


def equal_rows(keys: np.ndarray) -> np.ndarray:
    """Return the same number for equal rows of keys (f, c), counted from 0."""
    order = np.lexsort(keys.T)
    new = np.any(keys[order[1:]] != keys[order[:-1]], axis=1)
    numbers = np.empty(len(keys), dtype=int)
    numbers[order] = np.concatenate([[0], np.cumsum(new)])
    return numbers


def triangles_of(corners: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Return the triangles (t, 3) of faces, those of curved ones through their middles; without folded ones."""
    three, curved = corners[:, 3] < 0, middles[:, 0] >= 0
    both = np.hstack([corners, middles])  # places 0 to 3 are corners, 4 to 7 the middles of the edges after them
    triangles_by_kind = []
    for chosen, places in (
        (three & ~curved, [(0, 1, 2)]),
        (~three & ~curved, [(0, 1, 2), (0, 2, 3)]),
        (three & curved, [(0, 4, 6), (4, 1, 5), (6, 5, 2), (4, 5, 6)]),
        (~three & curved, [(0, 4, 7), (1, 5, 4), (2, 6, 5), (3, 7, 6), (4, 5, 6), (4, 6, 7)]),
    ):
        triangles_by_kind += [both[chosen][:, list(place)] for place in places]
    triangles = np.concatenate(triangles_by_kind)
    a, b, c = triangles.T
    return triangles[(a != b) & (b != c) & (c != a)]


def surface_triangles(cells: dict[str, np.ndarray]) -> np.ndarray:
    """Return the triangles (t, 3) of what is seen of a body, of curved elements by their corners; nodes as in
    `cells`."""
    corners, middles, solid = all_faces(cells)
    seen = free(corners, solid)
    return triangles_of(corners[seen], np.full_like(middles[seen], -1))


def share_of_faces(comm, elements, nodes) -> float:
    """Return how many of the faces of the surface lie on a set of nodes (k,), ascending; faces between elements of two
    ranks count as surface. 0 without elements. `elements`: as for surface_areas. Collective."""
    corners, _, solid = all_faces(elements)
    seen = corners[free(corners, solid)]
    on = ((seen < 0) | np.isin(seen, nodes)).all(axis=1)
    total, mine = comm.allreduce(len(on)), comm.allreduce(int(on.sum()))
    return mine / total if total else 0.0


def solid_volume(comm, elements, label, position) -> float | None:
    """Return the volume of the elements by their corners, or None where not all of them are solids, or a node has no
    place.

    `elements`: node numbers by kind, of this rank; `label` (k,), no number on two ranks, and `position` (k, 3) of
    nodes. Collective.
    """
    kinds = sorted(set().union(*comm.allgather({kind for kind, table in elements.items() if len(table)})))
    if not kinds or any(kind not in FACES or kind in SHELLS for kind in kinds):
        return None
    total, known = 0.0, True
    for kind in kinds:
        nodes = np.asarray(elements.get(kind, np.zeros((0, NODES[kind]))), dtype=np.int64)
        there, places = look_up(comm, label, list(position.T), nodes.ravel())
        known &= bool(there.all())
        points = np.stack(places, axis=1).reshape(-1, NODES[kind], 3)
        corners = sorted({place for face in FACES[kind] for place in face[: CORNERS[len(face)]]})
        middle = points[:, corners].mean(axis=1)
        for face in FACES[kind]:
            first, *others = (points[:, place] - middle for place in face[: CORNERS[len(face)]])
            for second, third in itertools.pairwise(others):
                total += float(np.abs(np.einsum("ei,ei->e", first, np.cross(second, third))).sum()) / 6
    return comm.allreduce(total) if all(comm.allgather(known)) else None


def surface_areas(comm, elements, nodes, points) -> np.ndarray:
    """Return the area (k,) in m^2 of the faces that lie on a set of nodes, in equal shares of the nodes of each face.

    `elements`: node numbers by kind, of this rank; `nodes` (k,) ascending and `points` (k, 3) of the set, the same on
    all ranks. Collective.
    """
    # an element has a face on the set where it has three of its nodes
    near = {kind: table[np.isin(table, nodes).sum(axis=1) >= 3] for kind, table in elements.items()}
    tables = all_faces(near)
    faces = np.hstack(tables[:2])
    on = ((faces < 0) | np.isin(faces, nodes)).all(axis=1)
    # as large as the set
    by_rank = comm.allgather([table[on] for table in tables])
    corners, middles, solid = map(np.concatenate, zip(*by_rank, strict=True))
    seen = free(corners, solid)
    faces = np.hstack([corners, middles])[seen]
    place, there = np.searchsorted(nodes, faces), faces >= 0
    last = np.where(there[:, 3], 3, 2)
    p0, p1, p2 = (points[place[:, k]] for k in range(3))
    # half the cross product of the diagonals, or of two sides of a triangle
    size = np.linalg.norm(np.cross(p2 - p0, points[place[np.arange(len(faces)), last]] - p1), axis=1) / 2
    areas = np.zeros(len(nodes))
    np.add.at(areas, place[there], np.broadcast_to((size / there.sum(axis=1))[:, None], faces.shape)[there])
    return areas
