"""Read text tables of nodes (node, x, y, z) and of rows (node, direction); each rank reads a share of the lines."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...files.text import LARGEST_LABEL, numbers, pieces, places, ragged, whole
from ...parallel.failures import InputError, agreed
from ...parallel.lookup import repeated_key
from ...parallel.petsc import MPI
from ..entries import joined, label_name, label_of

LARGEST_COORDINATE = 1e15  # more than a body has, in any unit


@dataclass
class NodeTable:
    """Node numbers `label` (nodes,) and `position` (nodes, 3) on this rank.

    `place` (nodes,): which node of the file, or of the ascending numbers, each is; rows follow in this order.
    """

    label: np.ndarray
    position: np.ndarray
    place: np.ndarray


def read(path, comm) -> NodeTable:
    """Read lines of node, x, y, z in the order of the rows. Collective. Raises InputError."""
    with agreed(comm):
        parts, counts = [], []
        for piece in pieces(path, comm):
            table, lines = numbers(piece, 4)
            finite(piece, table[:, 1:], lines)
            parts.append((whole(piece, table[:, 0], lines, "the node number", 1, LARGEST_LABEL), table[:, 1:]))
            counts.append((piece.start, len(table)))
        label = joined([(part[0],) for part in parts], (np.int64,))[0]
        position = np.concatenate([np.zeros((0, 3)), *(part[1] for part in parts)])
    if not comm.allreduce(len(label)):
        raise InputError(f"{path}: found no nodes, expected lines of node, x, y, z")
    twice = repeated_key(comm, label)
    if twice is not None:
        raise InputError(f"{path}: found the node {twice} more than once, expected one line a node")
    return NodeTable(label, position, places(comm, counts))


def read_node_numbers(path) -> tuple[int, ...]:
    """Return the numbers of nodes in a text, one or several a line, in their order; on this rank. Raises InputError."""
    if not Path(path).is_file():
        raise InputError(
            f"{path}: no such file of node numbers; a node set is {{set = \"{Path(path).name}\"}}"
        )
    found = []
    for piece in pieces(path, MPI.COMM_SELF):
        values, counts, lines = ragged(piece, expected="node numbers")
        found += whole(piece, values, np.repeat(lines, counts), "the node number", 1, LARGEST_LABEL).tolist()
    if not found:
        raise InputError(f"{path}: found no node numbers")
    return tuple(found)


def finite(piece, values, lines):
    """Raise InputError that names the line for a coordinate that is NaN, Inf, or beyond all units."""
    wrong = np.flatnonzero(~(np.abs(values) <= LARGEST_COORDINATE).all(axis=1))
    if wrong.size:
        raise piece.refusal(lines[wrong[0]], "finite node coordinates")


def read_row_labels(path, comm) -> tuple[np.ndarray, np.ndarray]:
    """Return labels (see entries.label_of) of the lines node, direction (1 to 6) on this rank, and the row of each.

    Collective. Raises InputError.
    """
    with agreed(comm):
        parts, counts = [], []
        for piece in pieces(path, comm):
            table, lines = numbers(piece, 2)
            node = whole(piece, table[:, 0], lines, "the node number", 1, LARGEST_LABEL)
            direction = whole(piece, table[:, 1], lines, "the direction (x, y, z, rx, ry, rz)", 1, 6)
            parts.append((label_of(node, direction - 1),))
            counts.append((piece.start, len(table)))
        (label,) = joined(parts, (np.int64,))
    twice = repeated_key(comm, label)
    if twice is not None:
        raise InputError(f"{path}: found two rows of {label_name(twice)}, expected one row a node and direction")
    return label, places(comm, counts)
