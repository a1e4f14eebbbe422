"""Label the rows of the matrices by node, direction and position, and find rows by these labels.

Each rank has the labels of its own rows.
"""

from dataclasses import dataclass

import numpy as np

from ..parallel.declared import declared
from ..parallel.failures import InputError
from ..parallel.sums import joined

DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz", "scalar", "own1", "own2", "own3", "own4", "own5", "own6")
QUANTITIES = ("displacement", "velocity", "acceleration")  # of outputs, by the number of their derivatives
ABSOLUTE = "absolute "  # before names of outputs on a base that moves, which else are relative to it
SCALAR = 6  # a dof that rigid-body motions do not move: a modal coordinate, a scalar point
SAME_PLACE = 1e-6  # times the largest coordinate
OWN = 7  # and five more: directions 1..6 of a displacement system of the node's own, which are none of x .. rz
INTERFACE_THERE = "declare an [[interface]] with several nodes there, which has all six directions"


@dataclass
class Dofs:
    """Labels of rows: the node, direction and position of each.

    Parameters
    ----------
    node : array_like of int, shape (rows,)
        Number of the node.
    direction : array_like of int, shape (rows,)
        0 to 5: x, y, z, rx, ry, rz; 6: a scalar dof, such as a modal coordinate; 7 to 12: directions 1 to 6 of a
        displacement system of the node.
    position : array_like, shape (rows, 3)
        Of the node in m; zero for scalar dofs.

    Raises
    ------
    InputError
        For arrays of other shapes or types.

    Notes
    -----
    Of the rows of this rank, or of all rows for `SecondOrderModel.from_scipy`.
    """

    node: np.ndarray
    direction: np.ndarray
    position: np.ndarray

    def __post_init__(self):
        self.node, self.direction, self.position = map(np.asarray, (self.node, self.direction, self.position))
        rows = self.node.shape
        for key, array, shape, kinds in (
            ("node", self.node, (self.node.size,), "iu"),
            ("direction", self.direction, rows, "iu"),
            ("position", self.position, (*rows, 3), "iuf"),
        ):
            if array.shape != shape or (array.size and array.dtype.kind not in kinds):
                numbers = "numbers" if "f" in kinds else "whole numbers"
                raise InputError(
                    f"dofs.{key}: found an array {array.shape} of {array.dtype}, expected {numbers} {shape}"
                )

    def take(self, rows) -> "Dofs":
        """Return those of some local `rows`, from 0, or a mask."""
        return Dofs(self.node[rows], self.direction[rows], self.position[rows])


def check_labels(dofs, rows: int, name: str):
    """Raise InputError unless `dofs` is None or labels each of so many rows once, with one position per node."""
    if declared(f"{name}: dofs", dofs, Dofs | None) is None:
        return
    if len(dofs.node) != rows:
        raise InputError(f"{name}: dofs: found {len(dofs.node)}, expected one for each of {rows} rows")
    if not np.isfinite(dofs.position).all():
        raise InputError(f"{name}: dofs.position: found NaN or Inf, expected finite coordinates in m")
    wrong = dofs.direction[(dofs.direction < 0) | (dofs.direction >= len(DIRECTIONS))]
    if wrong.size:
        raise InputError(f"{name}: dofs.direction: found {wrong[0]}, expected 0..5 for x..rz, and so on")
    # rows of one node come together by sorting, where they do not stand so
    node, direction, position = dofs.node, dofs.direction, dofs.position
    if (node[1:] < node[:-1]).any():
        order = np.argsort(node, kind="stable")
        node, direction, position = node[order], direction[order], position[order]
    same = node[1:] == node[:-1]
    if (same & (direction[1:] <= direction[:-1])).any():
        order = np.lexsort((direction, node))
        node, direction, position = node[order], direction[order], position[order]
    twice = np.flatnonzero(same & (direction[1:] == direction[:-1]))
    if twice.size:
        raise InputError(
            f"{name}: dofs: found two rows of node {node[twice[0]]}, {DIRECTIONS[direction[twice[0]]]}, expected one"
        )
    # all rows of a node, but scalar ones, lie at one place
    same &= (direction[1:] != SCALAR) & (direction[:-1] != SCALAR)
    apart = np.abs(position[1:] - position[:-1]).max(axis=1, initial=0.0)
    apart = np.flatnonzero(same & (apart > SAME_PLACE * np.abs(position).max(initial=0.0)))
    if apart.size:
        raise InputError(
            f"{name}: dofs.position: found node {node[apart[0]]} at {position[apart[0]].tolist()} and "
            f"{position[apart[0] + 1].tolist()}, expected one place for all rows of a node"
        )


def direction_index(name, key="direction") -> int:
    """Return the index of a name in DIRECTIONS: 0..5 of x, y, z, rx, ry, rz. Raises InputError."""
    if name not in DIRECTIONS:
        raise InputError(f"{key}: found the direction {name!r}, expected one of {', '.join(DIRECTIONS[:SCALAR])}")
    return DIRECTIONS.index(name)


def rows_of_node(model, node: int) -> dict[int, int]:
    """Return the global row of each direction of a node. Collective. Raises InputError if there is no such node."""
    dofs = require_dofs(model, f"node {node}")
    local = np.flatnonzero(dofs.node == node)
    mine = {int(dofs.direction[i]): int(i) + model.first_row for i in local}
    rows = {}
    for theirs in model.comm.allgather(mine):
        rows |= theirs
    if not rows:
        averaged = next((interface for interface in model.interfaces if interface.node == node), None)
        if averaged is not None:
            raise InputError(
                f"interface '{averaged.name}' of {model.name} has no dofs of its own, since it is an averaging one; "
                "take kind = 'rigid' for it, or the Buckens frame"
            )
        held = held_directions(model, node)
        if held:
            raise InputError(
                f"node {node} of {model.name} has no dof: the program that wrote the matrices holds it in "
                f"{', '.join(DIRECTIONS[d] for d in held)}"
            )
        low = model.comm.allgather(int(dofs.node.min()) if dofs.node.size else None)
        high = model.comm.allgather(int(dofs.node.max()) if dofs.node.size else None)
        low, high = (f([v for v in values if v is not None]) for f, values in ((min, low), (max, high)))
        raise InputError(f"node {node} does not exist in {model.name}; its nodes are numbered {low} to {high}")
    return rows


def held_directions(model, node: int) -> list[int]:
    """Return the directions (0..5) in which a node is held and has no row. Collective."""
    mine = [] if model.held is None else model.held.direction[model.held.node == node].tolist()
    return sorted(set(joined(model.comm, mine)))


def position_of_node(model, node: int) -> np.ndarray:
    """Return the coordinates (3,) of a node. Collective."""
    row = next(iter(rows_of_node(model, node).values())) - model.first_row
    mine = model.dofs.position[row] if 0 <= row < model.local_rows else None
    return next(p for p in model.comm.allgather(mine) if p is not None)


def row_of(model, target) -> int:
    """Return the global row (from 0) of a dof, given by number (from 1) or as (node, direction). Collective."""
    if isinstance(target, (int, np.integer)):
        if not 1 <= target <= model.size:
            raise InputError(f"dof {target} does not exist in {model.name}; its dofs are numbered 1 to {model.size}")
        return int(target) - 1
    node, direction = target
    rows = rows_of_node(model, int(node))
    index = direction_index(direction)
    if index not in rows:
        have = ", ".join(DIRECTIONS[d] for d in sorted(rows))
        why = ", which is held by the program that wrote the matrices" if index in held_directions(model, node) else ""
        advice = f"; {INTERFACE_THERE}, and name its direction {direction}" if 3 <= index < SCALAR and not why else ""
        raise InputError(f"node {node} of {model.name} has no dof in direction {direction}{why}; it has {have}{advice}")
    return rows[index]


def require_dofs(model, purpose: str) -> Dofs:
    """Return the dof labels. Raises InputError for a model without nodes."""
    if model.dofs is None:
        raise InputError(f"{model.name} has no node coordinates, which {purpose} needs; convert it with --nodes, or "
                         "give dofs in Python")  # fmt: skip
    return model.dofs


def target_of(name: str):
    """Return the target of a name made by target_name, or None for another name, also of a velocity."""
    if named_quantity(name)[0] != QUANTITIES[0]:
        return None
    head, colon, tail = name.rpartition(":")
    if colon and tail in DIRECTIONS and " " not in head:
        return int(head) if head.isdecimal() else head, tail
    return int(name[4:]) if name.startswith("dof ") and name[4:].isdecimal() else None


def node_of(name: str):
    """Return the node of an input or output by its name, or None, also for scalar dofs and own directions."""
    target = target_of(named_quantity(name)[1])
    return target[0] if isinstance(target, tuple) and DIRECTIONS.index(target[1]) < SCALAR else None


def target_name(target) -> str:
    """Return "20:z" for a pair (node, direction), "dof 115" for a number."""
    return f"dof {target}" if isinstance(target, (int, np.integer)) else f"{target[0]}:{target[1]}"


def quantity_name(quantity: str, name: str) -> str:
    """Return the name of an output: "velocity 20:z" for the velocity of 20:z, and 20:z for its displacement."""
    return name if quantity == QUANTITIES[0] else f"{quantity} {name}"


def named_quantity(name: str) -> tuple[str, str]:
    """Return quantity and place of the name of an output, such as "velocity" and "20:z"."""
    first, _, rest = name.partition(" ")
    return (first, rest) if first in QUANTITIES[1:] and rest else (QUANTITIES[0], name)


def dofs_per_node(dofs: Dofs) -> int:
    """Return the number of dofs per node if it is the same for all and rows are ordered by node, else 1."""
    node = dofs.node
    changes = np.flatnonzero(np.diff(node)) + 1
    block = int(changes[0]) if changes.size else node.size
    if block > 1 and node.size % block == 0 and (node.reshape(-1, block) == node[::block, None]).all():
        return block
    return 1
