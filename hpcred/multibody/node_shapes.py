"""Displacements and rotations of single nodes: rows of the basis, as phi (3, m) and psi (3, m)."""

from dataclasses import dataclass

import numpy as np

from ..linalg.blocks import local_rows
from ..model.dofs import require_dofs, target_of
from ..parallel.failures import InputError

CHUNK = 2**22  # rows of a result file looked through at a time


@dataclass
class NodeShape:
    """Position (3,) of a node and its part of the basis: phi (3, m) displacements, psi (3, m) rotations.

    psi is zero, and `rotates` false, for nodes without rotational dofs.
    """

    node: int
    position: np.ndarray
    phi: np.ndarray
    psi: np.ndarray
    rotates: bool


def node_shapes(model, columns, nodes) -> list[NodeShape]:
    """The shapes of nodes from the basis `columns` (a block (n, m)). Collective. Raises InputError."""
    dofs = require_dofs(model, "an interface node")
    found = np.flatnonzero(np.isin(dofs.node, list(nodes)))
    with local_rows(columns) as rows:
        part = dofs.node[found], dofs.direction[found], dofs.position[found], rows.real[found].copy()
    parts = model.comm.allgather(part)
    return _assemble(nodes, *(np.concatenate(items) for items in zip(*parts, strict=True)), model.name)


def shapes_in_file(file, nodes, name) -> list[NodeShape]:
    """The shapes of nodes from an open result file: those kept for the interface, others from the basis."""
    kept = {}
    if "interface" in file:
        group = file["interface"]
        for i, node in enumerate(group["node"][...]):
            kept[int(node)] = NodeShape(
                int(node), group["position"][i], group["phi"][i], group["psi"][i], bool(group["rotates"][i])
            )
    missing = [node for node in nodes if node not in kept]
    if missing:
        if "basis/V" not in file or "dofs" not in file:
            raise InputError(f"{name}: node {missing[0]} is no interface node, and the file was written without basis")
        columns, dofs = file["basis/V"], file["dofs"]
        rows = []
        for low in range(0, columns.shape[1], CHUNK):
            rows.append(low + np.flatnonzero(np.isin(dofs["node"][low : low + CHUNK], missing)))
        rows = np.concatenate(rows)
        parts = [dofs[key][rows] for key in ("node", "direction", "position")] if len(rows) else [np.zeros(0)] * 3
        basis = np.array([columns[:, row] for row in rows]).reshape(len(rows), columns.shape[0])
        kept |= {shape.node: shape for shape in _assemble(missing, *parts, basis, name)}
    return [kept[node] for node in nodes]


def interface_nodes(model) -> list[int]:
    """The nodes of the inputs and outputs that are named by node, in ascending order."""
    targets = [target_of(name) for name in (*model.input_names, *model.output_names)]
    return sorted({target[0] for target in targets if isinstance(target, tuple)})


def _assemble(nodes, labels, directions, positions, rows, name):
    shapes = []
    for node in nodes:
        mine = np.flatnonzero(labels == node)
        if not len(mine):
            raise InputError(f"{name}: node {node} does not exist")
        phi, psi = np.zeros((3, rows.shape[1])), np.zeros((3, rows.shape[1]))
        for i in mine:
            direction = int(directions[i])
            (phi if direction < 3 else psi)[direction % 3] = rows[i]
        rotates = bool((directions[mine] > 2).any())
        shapes.append(NodeShape(int(node), np.array(positions[mine[0]]), phi, psi, rotates))
    return shapes
