"""Find the faces that bound a body whose elements are distributed over the ranks.

No rank has all elements. Each keeps the faces that its own elements do not share and sends a face to the rank of its
smallest node number. Faces that occur once there form the surface, which is small compared with the body.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..parallel.exchange import exchange
from ..parallel.lookup import look_up
from .dofs import SCALAR
from .elements import all_faces, free, nodes_behind


@dataclass(frozen=True, eq=False)
class Faces:
    """Faces: `corners` (f, 4) and `middles` (f, 4) as of elements.all_faces, and `behind` (f,), a node of the element
    that is not on the face, -1 for shells."""

    corners: np.ndarray
    middles: np.ndarray
    behind: np.ndarray

    @property
    def all_nodes(self) -> np.ndarray:
        """(f, 9)"""
        return np.column_stack([self.corners, self.middles, self.behind])

    def take(self, chosen) -> Faces:
        """Return some of the faces, by a mask or by numbers."""
        return Faces(self.corners[chosen], self.middles[chosen], self.behind[chosen])


def faces_of(table: np.ndarray) -> Faces:
    """Return the faces of a table (f, 9) of all their nodes."""
    return Faces(table[:, :4], table[:, 4:8], table[:, 8])


def faces_of_elements(elements: dict) -> Faces:
    """Return all faces of elements, those between two of them twice."""
    corners, middles, _ = all_faces(elements)
    return Faces(corners, middles, nodes_behind(elements))


def surface_faces(comm, elements: dict) -> Faces:
    """Return this rank's part of the surface; `elements`: node numbers by kind, of this rank. Collective."""
    # faces that occur once among the elements of this rank
    faces = faces_of_elements(elements)
    shells = faces.behind < 0
    faces = faces.take(free(faces.corners, ~shells) | shells)
    # the two ranks of a face that elements of both have meet at its smallest node number
    smallest = np.where(faces.corners < 0, np.iinfo(np.int64).max, faces.corners).min(axis=1, initial=0)
    table = exchange(comm, smallest % comm.size, list(faces.all_nodes.T))
    faces = faces_of(np.stack(table, axis=1))
    return faces.take(free(faces.corners, faces.behind >= 0))


def places_of(model, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Test whether nodes (k,) have a place, and their positions (k, 3) in m. Collective."""
    node, position = placed_nodes(model)
    there, columns = look_up(model.comm, node, list(position.T), wanted)
    return there, np.stack(columns, axis=1)


def placed_nodes(model) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes (k,) of this rank that have a place, held ones too, and their positions (k, 3) in m."""
    labelled = [(model.dofs, model.dofs.direction != SCALAR)]
    if model.held is not None:
        labelled.append((model.held, np.ones(len(model.held.node), bool)))
    node = np.concatenate([dofs.node[there] for dofs, there in labelled]).astype(np.int64)
    position = np.concatenate([dofs.position[there] for dofs, there in labelled])
    node, first = np.unique(node, return_index=True)
    return node, position[first]


@dataclass(frozen=True, eq=False)
class ModelSurface:
    """The surface of a body: `faces`, as indices of its `nodes` (v,), ascending, with their `points` (v, 3) in m.
    `without_place`: the number of faces that were left out, since one of their nodes has no row and so no place."""

    faces: Faces
    nodes: np.ndarray
    points: np.ndarray
    without_place: int = 0


def gathered_surface(model, more: np.ndarray | tuple = ()) -> ModelSurface | None:
    """Return the whole surface on rank 0, in an order that does not depend on the number of ranks; None on others.
    Collective.

    It grows with the surface of the body, not with its volume. `more`: numbers of nodes that are to be there as well.
    """
    # faces and places of their nodes, gathered
    table = surface_faces(model.comm, model.elements).all_nodes
    mine = np.unique(np.concatenate([table[table >= 0], np.asarray(more, np.int64)]))
    there, points = places_of(model, mine)
    gathered = model.comm.gather((table, mine[there], points[there]))
    if gathered is None:
        return None
    table, nodes, points = (np.concatenate(arrays) for arrays in zip(*gathered, strict=True))
    # each node once, and faces as indices of them, without those of nodes that have no place
    nodes, first = np.unique(nodes, return_index=True)
    points = points[first]
    index = np.searchsorted(nodes, table).clip(max=max(len(nodes) - 1, 0))
    known = (table < 0) | (nodes[index] == table if len(nodes) else False)
    placed = known.all(axis=1)
    index = np.where(table < 0, -1, index)[placed]
    return ModelSurface(faces_of(index[np.lexsort(index.T[::-1])]), nodes, points, int((~placed).sum()))
