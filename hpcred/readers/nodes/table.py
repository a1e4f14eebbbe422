"""Read text tables of nodes (node, x, y, z) and of rows (node, direction); each rank reads a share of the lines."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...fe.elements import NODES
from ...files.text import pieces, read_lines
from ...files.text_numbers import labels, numbers, ragged, whole
from ...parallel.failures import InputError
from ...parallel.lookup import require_once, sort_over_ranks
from ...parallel.petsc import MPI
from ..entries import label_name, label_of

LARGEST_COORDINATE = 1e15  # more than a body has, in any unit
# places of the nodes in the order of VTK where a program numbers the vertical edges before those of the top
VERTICAL_FIRST = {
    "hexahedron20": [*range(12), *range(16, 20), *range(12, 16)], "wedge15": [*range(9), 12, 13, 14, 9, 10, 11],
}  # fmt: skip
GROUP = 2**32  # keys of elements: GROUP times the number of their instance, plus their own


@dataclass
class NodeTable:
    """Node numbers `label` (nodes,) and `position` (nodes, 3) on this rank.

    `place` (nodes,): which node of the file, or of the ascending numbers, each is; rows follow in this order.
    """

    label: np.ndarray
    position: np.ndarray
    place: np.ndarray

    @classmethod
    def as_given(cls, comm, label, position):
        """Return nodes in the order of the ranks. Collective."""
        return cls(label, position, (comm.exscan(len(label)) or 0) + np.arange(len(label)))

    @classmethod
    def ascending(cls, comm, label, position):
        """Return nodes by number over the ranks. Collective."""
        label, *columns = sort_over_ranks(comm, label, list(position.T))
        return cls.as_given(comm, label, np.stack(columns, axis=1))


def elements_of(comm, tables: dict[str, list[np.ndarray]], order=None) -> dict[str, np.ndarray]:
    """Return node numbers (elements of this rank, nodes), `order` of them by kind, the same kinds on all ranks."""
    kinds = sorted(set().union(*comm.allgather(set(tables))))
    elements = {kind: np.concatenate([np.zeros((0, NODES[kind]), np.int64), *tables.get(kind, [])]) for kind in kinds}
    return {kind: nodes[:, (order or {}).get(kind, slice(None))] for kind, nodes in elements.items()}


def require_elements_once(path, comm, keys):
    """Raise InputError where two elements have one number; `keys`: arrays of those of this rank, of elements of several
    instances GROUP times that of the instance more. Collective."""
    require_once(comm, np.concatenate([np.zeros(0, np.int64), *keys]), lambda key: (
        f"{path}: found the element {key % GROUP} more than once, expected each once; was a part of the file written "
        "or included twice?"
    ))  # fmt: skip


def read(path, comm) -> NodeTable:
    """Read lines of node, x, y, z in the order of the rows. Collective. Raises InputError."""

    def decode(piece):
        table, lines = numbers(piece, 4)
        finite(piece, table[:, 1:], lines)
        return labels(piece, table[:, 0], lines), table[:, 1:]

    label, position, place = read_lines(path, comm, decode)
    if not comm.allreduce(len(label)):
        raise InputError(f"{path}: found no nodes, expected lines of node, x, y, z")
    require_once(comm, label, lambda node: f"{path}: found the node {node} more than once, expected one line a node")
    return NodeTable(label, position, place)


def in_ranges(numbers, ranges) -> np.ndarray:
    """Test which of the numbers are in any of the ranges (n, 2) from the first to the last number."""
    table = np.reshape(ranges, (-1, 2))
    if not len(table):
        return np.zeros(len(numbers), bool)
    low, high = table[np.argsort(table[:, 0])].T
    place = np.searchsorted(low, numbers, side="right") - 1
    return (place >= 0) & (numbers <= np.maximum.accumulate(high)[place])


def read_node_numbers(path) -> tuple[int, ...]:
    """Return the numbers of nodes in a text, one or several a line, in their order; on this rank. Raises InputError."""
    if not Path(path).is_file():
        raise InputError(f'{path}: no such file of node numbers; a node set is {{set = "{Path(path).name}"}}')
    numbers = []
    for piece in pieces(path, MPI.COMM_SELF):
        values, counts, lines = ragged(piece, expected="node numbers")
        numbers += labels(piece, values, np.repeat(lines, counts)).tolist()
    if not numbers:
        raise InputError(f"{path}: found no node numbers")
    return tuple(numbers)


def finite(piece, values, lines):
    """Raise InputError that names the line for a coordinate that is NaN, Inf, or beyond all units."""
    piece.require((np.abs(values) <= LARGEST_COORDINATE).all(axis=1), lines, "finite node coordinates")


def read_row_labels(path, comm) -> tuple[np.ndarray, np.ndarray]:
    """Return labels of the lines node, direction (1 to 6) on this rank, and the row of each. Collective."""

    def decode(piece):
        table, lines = numbers(piece, 2)
        direction = whole(piece, table[:, 1], lines, "the direction (x, y, z, rx, ry, rz)", 1, 6)
        return (label_of(labels(piece, table[:, 0], lines), direction - 1),)

    label, row = read_lines(path, comm, decode)
    require_once(comm, label, lambda twice: f"{path}: found two rows of {label_name(twice)}, expected one row a node "
                                            "and direction")  # fmt: skip
    return label, row
