"""What a reader of matrices gives: entries (row, column, value), some on each rank, in any order.

Entries at the same place are summed. Rows are numbered, or named by node and direction.
"""

from dataclasses import dataclass

import numpy as np

from ..model.dofs import DIRECTIONS
from ..parallel.failures import InputError

LARGEST_VALUE = 1e60  # more than any stiffness in any units
STRIDE = 8  # label of a row: 8 times its node number plus its direction 0..5


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
    """Labels, ascending by node and then direction, from node numbers and directions 0..5."""
    return STRIDE * node.astype(np.int64) + direction


def node_and_direction(label: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Node numbers and directions 0..5 of labels."""
    node, direction = np.divmod(label, STRIDE)
    return node, direction.astype(np.int8)


def label_name(label: int) -> str:
    """ "20:z"."""
    return f"{label // STRIDE}:{DIRECTIONS[label % STRIDE]}"


def joined(parts: list[tuple], kinds: tuple) -> list[np.ndarray]:
    """Arrays of several pieces end to end; `kinds`: types of the arrays, for a rank without pieces."""
    if not parts:
        return [np.zeros(0, kind) for kind in kinds]
    return [np.concatenate(items) for items in zip(*parts, strict=True)]


def require_sane(values: np.ndarray, found: str, what: str):
    """Raise InputError for values that are NaN, Inf, or beyond all units; `found`: how its sentence begins."""
    if len(values) and not (values.max() <= LARGEST_VALUE and values.min() >= -LARGEST_VALUE):
        wrong = values[~(np.abs(values) <= LARGEST_VALUE)][0]
        raise InputError(f"{found} the value {wrong} in a {what} matrix, expected finite numbers")
