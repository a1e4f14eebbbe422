"""What the files of a model say, before they are a model: matrices, names of the rows, nodes and elements."""

from dataclasses import dataclass, field

import numpy as np

from ..parallel.failures import InputError
from .entries import Entries, LabelledEntries, label_of
from .nodes.table import Nodes


@dataclass
class Parts:
    """What the files of a model say; every rank has slices, in any order.

    `matrices`: K, M and perhaps D, all with numbered or all with labelled rows. `files`: where each came from, for
    messages. `nodes`, `elements` (node numbers (elements, nodes) by kind), `sets` (node numbers by name): where known.
    `row_labels`: labels (see entries.label_of) and the rows (from 0) that have them, where rows are numbered and a file
    names them. `removed`: labels of dofs that the program holds at zero, which have no row. `warnings`: sentences for
    the user, from any rank. `open_ended`: keys of matrices whose files have no mark of their end (see whole); `loose`:
    whether nodes may have mass and no stiffness, since what joins them is not in K; `all_massive`: whether all solids
    and shells are of materials with a density; `as_written`: whether the entries of K and M are those of their files,
    and none came by turning axes.
    """

    matrices: dict[str, Entries | LabelledEntries]
    files: dict[str, str]
    nodes: Nodes | None = None
    elements: dict[str, np.ndarray] = field(default_factory=dict)
    row_labels: tuple[np.ndarray, np.ndarray] | None = None
    removed: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    sets: dict[str, np.ndarray] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    open_ended: set[str] = field(default_factory=set)
    loose: bool = False
    all_massive: bool = False
    as_written: bool = False


def common_size(parts: Parts) -> int:
    """The number of rows, which all matrices have. Raises InputError."""
    size = parts.matrices["K"].shape[0]
    for key, item in parts.matrices.items():
        file = parts.files[key]
        if item.shape[0] != item.shape[1]:
            raise InputError(f"{file}: found {item.shape[0]} x {item.shape[1]}, expected a square matrix")
        if item.shape[0] != size:
            raise InputError(
                f"{file}: found {item.shape[0]} rows, but K ({parts.files['K']}) has {size}; all matrices need the "
                "same size"
            )
    if not size:
        raise InputError(f"{parts.files['K']}: found a matrix without rows, expected one of at least one row")
    return size


def labels_in_order(comm, nodes: Nodes, size: int, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Labels and rows where every node has the same number of rows, one node after the other. Collective.

    Raises InputError.
    """
    count = comm.allreduce(len(nodes.label))
    per_node = size // count if count and size % count == 0 else 0
    if per_node not in (1, 2, 3, 6):
        raise InputError(
            f"{name}: found {count} nodes for {size} rows, expected 3 or 6 rows a node; give the node and direction "
            "of every row by --dofs"
        )
    direction = np.tile(np.arange(per_node), len(nodes.label))
    label, row = (np.repeat(item, per_node) for item in (nodes.label, nodes.place * per_node))
    return label_of(label, direction), row + direction
