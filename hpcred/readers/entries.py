"""Define the matrix entries that readers return: row, column, value, a share on each rank, in any order.

Entries at the same position are added up. Rows are numbered, or labelled by node and direction.
"""

from dataclasses import dataclass

import numpy as np

from ..fe.dofs import DIRECTIONS
from ..parallel.failures import InputError
from ..parallel.lookup import look_up

STRIDE = 16  # label of a row: 16 times its node number plus its direction, a place in DIRECTIONS

HUGE = 1e100  # so much larger than its diagonals nothing is; its square is still a number
ENTRIES_AT_A_TIME = 2**20  # entries looked at in one step
SMALL = 1e-10
ROOM = 1.2  # times what is foretold; of it no more is touched than is used
LARGEST_VALUE = 1e60  # more than any stiffness in any units


@dataclass
class Entries:
    """`rows`, `columns` (from 0) and `values` of the entries on this rank; `shape` of the whole matrix."""

    shape: tuple[int, int]
    rows: np.ndarray
    columns: np.ndarray
    values: np.ndarray


@dataclass
class LabelledEntries:
    """As Entries of a square matrix, but `rows` and `columns` are labels (see `label_of`) in place of numbers."""

    rows: np.ndarray
    columns: np.ndarray
    values: np.ndarray


def label_of(node: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return Labels, ascending by node and then direction, from node numbers and directions."""
    return STRIDE * node.astype(np.int64) + direction


def node_and_direction(label: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return node numbers and directions of labels."""
    node, direction = np.divmod(label, STRIDE)
    return node, direction.astype(np.int8)


def label_name(label: int) -> str:
    """ "20:z"."""
    return f"{label // STRIDE}:{DIRECTIONS[label % STRIDE]}"


def asymmetry(comm, entries: Entries | LabelledEntries) -> float:
    """Return an estimate of ||S - S^T||_F / ||S||_F of S = D^-1/2 A D^-1/2, D the diagonal of A, at once for all scales
    in A.

    From two products with numbers that look random: where A is exactly symmetric the terms cancel but for round-off.
    Diagonals below SMALL of the largest, or missing, count as that. Collective.
    """
    on = (entries.rows == entries.columns) & (entries.values != 0)
    label, first = np.unique(entries.rows[on], return_index=True)
    diagonal = np.abs(entries.values[on][first])
    least = SMALL * max(comm.allgather(diagonal.max(initial=0.0)))
    total = np.zeros(3)
    for chunk in chunks(comm, len(entries.values)):
        i, j, v = entries.rows[chunk], entries.columns[chunk], entries.values[chunk]
        for name in (i, j):
            distinct, back = np.unique(name, return_inverse=True)
            there, (size,) = look_up(comm, label, [diagonal], distinct)
            v = v / np.sqrt(np.maximum(np.where(there, size, 0.0), least or 1.0))[back]
        v = np.clip(v, -HUGE, HUGE)
        for k in range(2):
            term = v * (_mixed(i, 2 * k) * _mixed(j, 2 * k + 1) - _mixed(j, 2 * k) * _mixed(i, 2 * k + 1))
            total[k] += term.sum()
        total[2] += v @ v
    total = comm.allreduce(total)
    return float(np.abs(total[:2]).max() / np.sqrt(total[2])) if total[2] else 0.0


def chunks(comm, length: int) -> list[slice]:
    """Return slices of the entries of this rank, as many on all ranks, for collective work in little memory."""
    count = max(comm.allgather(-(-length // ENTRIES_AT_A_TIME)))
    return [slice(ENTRIES_AT_A_TIME * k, ENTRIES_AT_A_TIME * (k + 1)) for k in range(count)]


def _mixed(number, seed):
    """Return numbers between -1 and 1 that whole numbers stand for."""
    mixed = (number.astype(np.uint64) + np.uint64(1 + seed)) * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(31))) * np.uint64(0xBF58476D1CE4E5B9)
    return (mixed >> np.uint64(11)).astype(float) * 2.0**-52 - 1


class Collected:
    """Arrays of the pieces of a text end to end, each on memory that is touched once: that costs as much as parsing.

    Room is taken with the first piece, for as many numbers as its share of the text foretells.
    """

    def __init__(self, kinds: tuple):
        self._arrays, self._count = [np.empty(0, kind) for kind in kinds], 0

    def add(self, columns, share: float):
        """Copy arrays of one length to the end; `share`: see text.Piece."""
        end = self._count + len(columns[0])
        if end > len(self._arrays[0]):
            room = int(max(ROOM * end / share, 1.5 * end))
            before, self._arrays = self._arrays, [np.empty(room, array.dtype) for array in self._arrays]
            for array, known in zip(self._arrays, before, strict=True):
                array[: self._count] = known[: self._count]
        for array, column in zip(self._arrays, columns, strict=True):
            array[self._count : end] = column
        self._count = end

    @property
    def arrays(self) -> list[np.ndarray]:
        """The entries added so far."""
        return [array[: self._count] for array in self._arrays]


def both_triangles(i, j, v, sign=1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Rows, columns and values of one triangle and of its mirror image, whose values are `sign` times those."""
    off = i != j
    return np.concatenate([i, j[off]]), np.concatenate([j, i[off]]), np.concatenate([v, sign * v[off]])


def sides(comm, i, j) -> tuple[bool, bool]:
    """Return whether a matrix has entries below and above its diagonal, from rows and columns of ranks. Collective."""
    return tuple(any(comm.allgather(bool(outside.any()))) for outside in (i > j, i < j))


def refuse_one_side(comm, entries, file, expected: str):
    """Raise InputError for entries on one side of the diagonal only, which are nearly always half of a matrix.
    Collective."""
    there = entries.values != 0
    below, above = sides(comm, entries.rows[there], entries.columns[there])
    if above != below:
        side = "above" if above else "below"
        raise InputError(f"{file}: found entries {side} the diagonal only, expected {expected}")


def joined(tables: list[tuple], kinds: tuple) -> list[np.ndarray]:
    """Return arrays of several pieces end to end; `kinds`: types of the arrays, for a rank without pieces."""
    if not tables:
        return [np.zeros(0, kind) for kind in kinds]
    return [np.concatenate(columns) for columns in zip(*tables, strict=True)]


def require_sane(values: np.ndarray, found: str, what: str):
    """Raise InputError for values that are NaN, Inf, or beyond all units; `found`: how its sentence begins."""
    if len(values) and not (values.max() <= LARGEST_VALUE and values.min() >= -LARGEST_VALUE):
        wrong = values[~(np.abs(values) <= LARGEST_VALUE)][0]
        raise InputError(f"{found} the value {wrong} in a {what} matrix, expected finite numbers")
