"""Gather the displacement and rotation shapes of single nodes from the basis: phi (3, m) and psi (3, m)."""

from dataclasses import dataclass, replace

import numpy as np

from ..fe.dofs import DIRECTIONS, SCALAR, node_of, require_dofs
from ..linalg.blocks import local_rows
from ..parallel.failures import InputError
from ..reduction.run.projection import project_columns


@dataclass
class NodeShape:
    """The part of the basis that belongs to a node.

    Attributes
    ----------
    node : int
        Number of the node.
    position : ndarray, shape (3,)
        In m.
    phi, psi : ndarray, shape (3, m)
        Displacements and rotations by coordinate.
    rotates : bool
        False for nodes without rotational dofs; psi is then zero.
    name : str
        Name of an interface node, else "".
    phi1, psi1 : ndarray, shape (3, m, m), optional
        Hessians of displacements and rotations, symmetric in the coordinates; None: zero.
    """

    node: int
    position: np.ndarray
    phi: np.ndarray
    psi: np.ndarray
    rotates: bool
    name: str = ""
    phi1: np.ndarray | None = None
    psi1: np.ndarray | None = None

    def in_coordinates(self, X: np.ndarray) -> "NodeShape":
        """Return the shapes of a node without second ones in the coordinates z (k,) with q = X z, X (m, k)."""
        return replace(self, phi=self.phi @ X, psi=self.psi @ X)

    def motion(self, q) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return displacement (3,) and rotation (3,) at the coordinates q (m,), and their Jacobians (3, m)."""
        phi, psi = self.phi, self.psi
        if self.phi1 is None:
            return phi @ q, psi @ q, phi, psi
        bent, turned = self.phi1 @ q, self.psi1 @ q
        return (phi + bent / 2) @ q, (psi + turned / 2) @ q, phi + bent, psi + turned

    @property
    def label(self) -> str:
        """The name, or the number of a node without name."""
        return self.name or str(self.node)


def node_shapes(model, columns, nodes) -> list[NodeShape]:
    """Return the shapes of nodes. Collective.

    Parameters
    ----------
    model : SecondOrderModel
        The full model, with nodes.
    columns : SLEPc.BV, shape (n, m)
        The basis V, such as `ReducedModel.columns`.
    nodes : iterable of int
        Numbers of nodes or of interface nodes.

    Returns
    -------
    list of NodeShape
        In the order of `nodes`; zero in held directions.

    Raises
    ------
    InputError
        Without node coordinates, and for a node that does not exist.
    """
    dofs = require_dofs(model, "an interface node")
    references = [interface for interface in model.interfaces if interface.node in nodes]
    if references:
        return _with_references(model, columns, nodes, references)
    chosen = np.flatnonzero(np.isin(dofs.node, list(nodes)))
    with local_rows(columns) as rows:
        own = dofs.node[chosen], dofs.direction[chosen], dofs.position[chosen], rows.real[chosen].copy()
    if model.held is not None:
        held = model.held.take(np.isin(model.held.node, list(nodes)))
        zero = np.zeros((len(held.node), own[3].shape[1]))
        own = tuple(np.concatenate(pair) for pair in zip(own, (held.node, held.direction, held.position, zero),
                                                          strict=True))  # fmt: skip
    gathered = model.comm.allgather(own)
    return shapes_of_rows(nodes, *(np.concatenate(arrays) for arrays in zip(*gathered, strict=True)), model.name)


def _with_references(model, columns, nodes, references):
    """Return the shapes of nodes, among them interface nodes, which move by G V."""
    others = [node for node in nodes if node not in {interface.node for interface in references}]
    known = {shape.node: shape for shape in (node_shapes(model, columns, others) if others else [])}
    motion = project_columns(columns, model.Gt.copy().convert("dense")).T
    for place, interface in enumerate(model.interfaces):
        rows = motion[6 * place : 6 * place + 6]
        position = np.array(interface.position)
        known[interface.node] = NodeShape(interface.node, position, rows[:3], rows[3:], True, interface.name)
    return [known[node] for node in nodes]


def interface_nodes(model) -> list[int]:
    """Return the nodes of the inputs and outputs that are named by node, in ascending order, and the interface
    nodes."""
    nodes = {node_of(name) for name in (*model.input_names, *model.output_names)}
    references = [interface.node for interface in model.interfaces]
    return sorted(node for node in nodes if isinstance(node, int) and node not in references) + references


def shapes_of_rows(nodes, labels, directions, positions, rows, name) -> list[NodeShape]:
    """Return the shapes of nodes from rows of the basis (k, m), with their labels (k,), directions (k,), positions (k,
    3).

    Raises InputError for a node that has no row, or rows whose directions in space are not known.
    """
    shapes = []
    for node in nodes:
        mine = np.flatnonzero(labels == node)
        if not len(mine):
            raise InputError(
                f"{name}: node {node} does not exist; nodes have the numbers of the finite-element program, and "
                "interfaces their names"
            )
        lost = sorted({int(direction) for direction in directions[mine] if direction >= SCALAR})
        if lost and (lost[-1] > SCALAR or len(lost) == len(mine)):
            raise InputError(
                f"{name}: node {node} has the dofs {', '.join(DIRECTIONS[d] for d in lost)}, which are none of x, y, "
                "z, rx, ry, rz, so that its motion in space is not known; choose another node"
            )
        phi, psi = np.zeros((3, rows.shape[1])), np.zeros((3, rows.shape[1]))
        for i in mine:
            direction = int(directions[i])
            if direction < SCALAR:
                (phi if direction < 3 else psi)[direction % 3] = rows[i]
        rotates = bool(((directions[mine] > 2) & (directions[mine] < SCALAR)).any())
        shapes.append(NodeShape(int(node), np.array(positions[mine[0]]), phi, psi, rotates))
    return shapes
