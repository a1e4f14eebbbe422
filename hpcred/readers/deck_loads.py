"""Hold the loads that a finite-element program reads from its input file, before the model places them."""

from dataclasses import dataclass, field

import numpy as np

from ..fe.elements import FACES, NODES
from ..fe.faces import Faces, faces_of, faces_of_elements
from ..parallel.lookup import look_up
from .nodes.table import NodeTable


@dataclass
class DeckLoads:
    """The loads of a step or a number of an input file, in its units; each rank has a share of `nodal` and `faces`.

    `nodal`: node numbers (k,) with forces and moments (k, 6), as a list of pairs. `pressed`: faces with a pressure
    (f,), likewise. `acceleration` (3,) of the whole body. `spins`: squares of angular velocities, a point (3,) and a
    unit vector (3,) of each axis. `remarks`: what to know of them. `nodes`: those of the file. `unknown`: labels of
    dofs whose load is not in the file.
    """

    nodal: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)
    pressed: list[tuple[Faces, np.ndarray]] = field(default_factory=list)
    acceleration: np.ndarray = field(default_factory=lambda: np.zeros(3))
    spins: list[tuple[float, np.ndarray, np.ndarray]] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    nodes: NodeTable | None = None
    unknown: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))

    def at_nodes(self, node, direction, value):
        """Add forces (k,) at nodes (k,) in directions (k,) from 0."""
        table = np.zeros((len(node), 6))
        table[np.arange(len(node)), direction] = value
        self.nodal.append((np.asarray(node, np.int64), table))

    @property
    def faces(self) -> tuple[Faces, np.ndarray]:
        """All faces of this rank with a pressure, and the pressures (f,)."""
        tables = [np.zeros((0, 9), np.int64), *(faces.all_nodes for faces, _ in self.pressed)]
        return faces_of(np.concatenate(tables)), np.concatenate([np.zeros(0), *(value for _, value in self.pressed)])


def find_elements(comm, elements: dict, numbers: dict, wanted) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return places (k,) among `wanted` (w,) numbers of elements, and nodes (k, n), of those of each kind. Collective.

    `elements`, `numbers`: node numbers (e, n) and numbers of elements (e,) of this rank by kind, with the same kinds on
    all ranks.
    """
    members = {}
    for kind in sorted(elements):
        there, nodes = look_up(comm, numbers[kind], list(elements[kind].T), wanted)
        nodes = np.stack(nodes, axis=1) if nodes else np.zeros((len(wanted), NODES[kind]), np.int64)
        members[kind] = np.flatnonzero(there), nodes[there]
    return members


def faces_at(kind: str, nodes: np.ndarray, place: np.ndarray) -> Faces:
    """Return the face at a place (k,) in FACES of each element of a kind, with the nodes (k, n)."""
    every = faces_of_elements({kind: nodes})  # face by face
    return every.take(np.asarray(place, np.int64) * len(nodes) + np.arange(len(nodes)))


def place_of_face(kind: str, corners) -> int | None:
    """Return the place in FACES of the face of a kind with these corners, as places in an element's nodes."""
    wanted = set(corners)
    return next((k for k, face in enumerate(FACES[kind]) if set(face[: len(wanted)]) == wanted), None)
