"""Integrate pressures, tractions and line loads to consistent forces at nodes: f_a = integral of N_a t dA.

The faces and edges stay on the ranks that have them; positions of nodes are looked up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...fe.faces import Faces, places_of
from ...fe.shape_functions import integration_points, shape_functions
from ...parallel.exchange import exchange
from ...parallel.failures import InputError, agreed

FACE_KINDS = {  # places of the nodes in the corners and middles of a face; whether it has three corners, and is curved
    "triangle": ((0, 1, 2), True, False), "triangle6": ((0, 1, 2, 4, 5, 6), True, True),
    "quad": ((0, 1, 2, 3), False, False), "quad8": ((0, 1, 2, 3, 4, 5, 6, 7), False, True),
}  # fmt: skip
LINE_POINTS = np.array([-(0.6**0.5), 0.0, 0.6**0.5]), np.array([5 / 9, 8 / 9, 5 / 9])
NO_NODE = -1


@dataclass(frozen=True, eq=False)
class NodalForces:
    """Forces and moments `value` (k, 6) at nodes (k,) at positions (k, 3) in m; a node may occur several times, and
    each rank has a part. `area`: of the faces of all ranks, in m^2."""

    node: np.ndarray
    value: np.ndarray
    position: np.ndarray
    area: float = 0.0

    @classmethod
    def of_elements(cls, nodes, forces, position) -> NodalForces:
        """Return the forces at nodes (e, k) at positions (e, k, 3), as arrays of 3 e k numbers in this order."""
        value = np.zeros((nodes.size, 6))
        value[:, :3] = forces.reshape(-1, 3)
        return cls(nodes.ravel(), value, position.reshape(-1, 3))

    @classmethod
    def joined(cls, several) -> NodalForces:
        several = [*several, cls(np.zeros(0, np.int64), np.zeros((0, 6)), np.zeros((0, 3)))]
        arrays = (np.concatenate([getattr(forces, key) for forces in several]) for key in ("node", "value", "position"))
        return cls(*arrays, sum(forces.area for forces in several))


def forces_on_faces(model, faces: Faces, where: str, *, pressure=None, traction=None) -> NodalForces:
    """Return the consistent forces of a pressure (f,) or traction (f, 3) in N/m^2 on faces of this rank. Collective.

    A pressure pushes on the faces of solids from outside, on shells along their normal. Raises InputError for nodes
    without a place.
    """
    table = faces.all_nodes
    points = _points_of(model, table, where)
    forces_by_face, area = [], 0.0
    for kind, (places, three, curved) in FACE_KINDS.items():
        mine = np.flatnonzero(((faces.corners[:, 3] < 0) == three) & ((faces.middles[:, 0] >= 0) == curved))
        local, weights = integration_points(kind)
        N, dN = shape_functions(kind, local)
        nodes, x = table[mine][:, list(places)], points[mine][:, list(places)]
        along = np.einsum("gkd,fkx->fgdx", dN, x)
        normal = np.cross(along[:, :, 0], along[:, :, 1])  # (f, g, 3), as long as the area
        sizes = np.linalg.norm(normal, axis=2)
        area += float((sizes @ weights).sum())
        if pressure is not None:
            at_nodes = np.einsum("g,gk,fgx->fkx", weights, N, normal) * pressure[mine, None, None]
            at_nodes *= _inwards(points[mine], x, normal.sum(axis=1), faces.behind[mine])[:, None, None]
        else:
            at_nodes = np.einsum("g,gk,fg->fk", weights, N, sizes)[..., None] * traction[mine, None, :]
        forces_by_face.append(NodalForces.of_elements(nodes, at_nodes, x))
    forces = NodalForces.joined(forces_by_face)
    return NodalForces(forces.node, forces.value, forces.position, model.comm.allreduce(area))


def _inwards(points, x, normal, behind):
    """Return 1 or -1 (f,): the sign that turns the normals of faces to where a pressure pushes."""
    off = points[:, -1] - x.mean(axis=1)
    return np.where((behind >= 0) & ((off * normal).sum(axis=1) < 0), -1.0, 1.0)


def _points_of(model, table, where):
    """Return positions (.., 3) of a table of nodes, zero where it has none (-1). Collective. Raises InputError."""
    wanted = np.unique(table[table >= 0])
    there, points = places_of(model, wanted)
    with agreed(model.comm):
        if not there.all():
            raise InputError(
                f"{where}: node {wanted[~there][0]} of its faces or edges has no row in {model.name}, since it follows "
                "another one or was condensed; leave it out, or export the body with it"
            )
    places = np.zeros((*table.shape, 3))
    places[table >= 0] = points[np.searchsorted(wanted, table[table >= 0])]
    return places


def edges_of(comm, faces: Faces, elements: dict) -> np.ndarray:
    """Return ends and middle (e, 3), -1 for none, of edges of faces and of beams, each once over all ranks.
    Collective."""
    table = [np.zeros((0, 3), np.int64)]
    count = np.where(faces.corners[:, 3] < 0, 3, 4)
    for k in range(4):
        mine = k < count
        after = np.where(k + 1 == count, 0, k + 1)
        ends = faces.corners[np.arange(len(count)), k], faces.corners[np.arange(len(count)), after]
        table.append(np.stack([*ends, faces.middles[:, k]], axis=1)[mine])
    for kind, nodes in elements.items():
        if kind in ("line", "line3"):
            middle = nodes[:, 2] if kind == "line3" else np.full(len(nodes), NO_NODE)
            table.append(np.stack([nodes[:, 0], nodes[:, 1], middle], axis=1))
    edges = np.concatenate(table)
    edges[:, :2] = np.sort(edges[:, :2], axis=1)
    edges = np.unique(edges[edges[:, 0] != edges[:, 1]], axis=0)
    edges = np.stack(exchange(comm, edges[:, 0] % comm.size, list(edges.T)), axis=1)
    return np.unique(edges, axis=0)


def forces_on_edges(model, edges: np.ndarray, where: str, value) -> NodalForces:
    """Return the consistent forces of a load `value` (3,) in N/m on edges (e, 3) of this rank. Collective."""
    points, forces = _points_of(model, edges, where), []
    s, weights = LINE_POINTS
    straight = edges[:, 2] < 0
    for mine, N, dN in (
        (straight, np.stack([(1 - s) / 2, (1 + s) / 2], axis=1), np.stack([-0.5 + 0 * s, 0.5 + 0 * s], axis=1)),
        (~straight, np.stack([s * (s - 1) / 2, s * (s + 1) / 2, 1 - s * s], axis=1),
         np.stack([s - 0.5, s + 0.5, -2 * s], axis=1)),
    ):  # fmt: skip
        nodes, x = edges[mine][:, : N.shape[1]], points[mine][:, : N.shape[1]]
        length = np.linalg.norm(np.einsum("gk,ekx->egx", dN, x), axis=2)
        shares = np.einsum("g,gk,eg->ek", weights, N, length)
        forces.append(NodalForces.of_elements(nodes, shares[..., None] * np.asarray(value), x))
    return NodalForces.joined(forces)
