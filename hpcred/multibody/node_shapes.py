"""Displacements and rotations of single nodes: rows of the basis, as phi (3, m) and psi (3, m)."""

from dataclasses import dataclass

import numpy as np

from ..linalg.blocks import local_rows
from ..model.dofs import SCALAR, require_dofs, target_of
from ..parallel.failures import InputError


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
    """The shapes of nodes from the basis `columns` (a block (n, m)), zero where the model is held.

    Collective. Raises InputError.
    """
    dofs = require_dofs(model, "an interface node")
    found = np.flatnonzero(np.isin(dofs.node, list(nodes)))
    with local_rows(columns) as rows:
        part = dofs.node[found], dofs.direction[found], dofs.position[found], rows.real[found].copy()
    if model.held is not None:
        held = model.held.take(np.isin(model.held.node, list(nodes)))
        zero = np.zeros((len(held.node), part[3].shape[1]))
        part = tuple(np.concatenate(pair) for pair in zip(part, (held.node, held.direction, held.position, zero),
                                                          strict=True))  # fmt: skip
    parts = model.comm.allgather(part)
    return shapes_of_rows(nodes, *(np.concatenate(items) for items in zip(*parts, strict=True)), model.name)


def interface_nodes(model) -> list[int]:
    """The nodes of the inputs and outputs that are named by node, in ascending order."""
    targets = [target_of(name) for name in (*model.input_names, *model.output_names)]
    return sorted({target[0] for target in targets if isinstance(target, tuple)})


def shapes_of_rows(nodes, labels, directions, positions, rows, name) -> list[NodeShape]:
    """The shapes of nodes from rows of the basis (k, m), with their labels (k,), directions (k,), positions (k, 3).

    Raises InputError for a node that has no row.
    """
    shapes = []
    for node in nodes:
        mine = np.flatnonzero(labels == node)
        if not len(mine):
            raise InputError(f"{name}: node {node} does not exist")
        phi, psi = np.zeros((3, rows.shape[1])), np.zeros((3, rows.shape[1]))
        for i in mine:
            direction = int(directions[i])
            if direction < SCALAR:
                (phi if direction < 3 else psi)[direction % 3] = rows[i]
        rotates = bool(((directions[mine] > 2) & (directions[mine] < SCALAR)).any())
        shapes.append(NodeShape(int(node), np.array(positions[mine[0]]), phi, psi, rotates))
    return shapes
