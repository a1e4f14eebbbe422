"""What the files of a model say, before they are a model: matrices, names of the rows, nodes and elements."""

from dataclasses import dataclass, field

import numpy as np

from .entries import Entries, LabelledEntries
from .node_table import Nodes


@dataclass
class Parts:
    """What the files of a model say; every rank has slices, in any order.

    `matrices`: K, M and perhaps D, all with numbered or all with labelled rows. `files`: where each came from, for
    messages. `nodes`, `elements` (node numbers (elements, nodes) by kind), `sets` (node numbers by name): where known.
    `row_labels`: labels (see entries.label_of) and the rows (from 0) that have them, where rows are numbered and a file
    names them. `removed`: labels of dofs that the program holds at zero, which have no row. `warnings`: sentences for
    the user, from any rank.
    """

    matrices: dict[str, Entries | LabelledEntries]
    files: dict[str, str]
    nodes: Nodes | None = None
    elements: dict[str, np.ndarray] = field(default_factory=dict)
    row_labels: tuple[np.ndarray, np.ndarray] | None = None
    removed: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    sets: dict[str, np.ndarray] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
