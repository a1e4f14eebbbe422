"""Collect the contents of the files of a model before assembly: matrices, labels of the rows, nodes and elements."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from ..fe.dofs import SCALAR
from ..fe.materials import MATERIAL, TYPE, ElementProperties, Material
from ..files.text import LARGEST_LABEL
from ..model.checked_arrays import real_values
from ..parallel.failures import InputError, agreed
from ..parallel.lookup import look_up, sort_over_ranks
from .entries import Entries, LabelledEntries, label_of, node_and_direction
from .nodes.table import NodeTable

WHOLE = {"number": LARGEST_LABEL, "node": LARGEST_LABEL, "direction": 6}  # the largest of columns of whole numbers


@dataclass
class Parts:
    """The contents of the files of a model, as a Reader returns them; every rank has a share, in any order.

    Attributes
    ----------
    matrices : dict of str to Entries or LabelledEntries
        K, M and optionally D, all with numbered or all with labelled rows.
    files : dict of str to str
        The file of each matrix, for messages.
    nodes : Nodes or None
        Numbers and positions of the nodes, if known.
    elements : dict of str to ndarray, shape (elements, nodes)
        Node numbers by kind of element.
    properties : ElementProperties or None
        Numbers, types and materials of the elements, if known.
    row_labels : tuple of two ndarray, or None
        Labels (of entries.label_of) and the rows, from 0, that have them, if rows are numbered and a file labels them.
    removed : ndarray of int
        Labels of dofs that the program holds at zero, which have no row.
    sets : dict of str to ndarray
        Node numbers by name of the set.
    warnings : list of str
        Messages to the user, from any rank.
    open_ended : set of str
        Keys of matrices whose files have no end mark.
    loose : bool
        Whether nodes may have mass and no stiffness, since K does not contain their connections.
    all_massive : bool
        Whether all solids and shells have materials with a density.
    as_written : bool
        Whether the entries of K and M are those of their files, and not the result of a rotation of axes.
    """

    matrices: dict[str, Entries | LabelledEntries]
    files: dict[str, str]
    nodes: NodeTable | None = None
    elements: dict[str, np.ndarray] = field(default_factory=dict)
    properties: ElementProperties | None = None
    row_labels: tuple[np.ndarray, np.ndarray] | None = None
    removed: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    sets: dict[str, np.ndarray] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    open_ended: set[str] = field(default_factory=set)
    loose: bool = False
    all_massive: bool = False
    as_written: bool = False

    @property
    def ends(self) -> list[np.ndarray]:
        """Rows and columns of all matrices, numbers or labels."""
        return [end for matrix in self.matrices.values() for end in (matrix.rows, matrix.columns)]

    def take_mesh(self, mesh, remarks=()) -> None:
        """Take the elements, properties and sets of a `mesh` that a reader found, as far as it has them, and `remarks`
        for the user."""
        for key in ("elements", "properties", "sets"):
            setattr(self, key, getattr(mesh, key, getattr(self, key)))
        self.warnings += remarks

    @classmethod
    def from_arrays(
        cls, path, comm, K, M, D=None, *, nodes=None, dofs=None, elements=None, held=None, sets=None
    ) -> Parts:
        """Return the parts of a model from arrays, of which each rank gives a share. Collective.

        Parameters
        ----------
        path : str or Path
            The file, for messages.
        K, M, D : sparse matrix, shape (n, n)
            Entries of this rank, any share, with both triangles; those of all ranks are added up. None on a rank
            without entries; D is None on all ranks of a model without damping matrix.
        nodes : array_like, shape (k, 4), optional
            Number, x, y, z of the nodes of this rank; nodes are ordered by rank. Without `dofs` all nodes have the same
            number of rows (1 to 3, or 6), and rows are in the order of the nodes.
        dofs : array_like, shape (r, 2), optional
            Node and direction (1 to 6) of some rows; rows are ordered by rank.
        elements : dict of str to array_like, optional
            Node numbers (e, nodes) of elements by kind, as of SecondOrderModel.
        held : array_like, shape (h, 2), optional
            Node and direction of dofs that are held at zero and have no row.
        sets : dict of str to array_like, optional
            Node numbers by the name of the set; the same names on all ranks.

        Returns
        -------
        Parts
            As Reader.read_model returns it.

        Raises
        ------
        InputError
            For arrays of another shape, and numbers that are not nodes or directions.
        """
        with agreed(comm):
            arrays = dict.fromkeys("KMD")
            values = {}
            for key, array in zip("KMD", (K, M, D), strict=True):
                if array is not None:
                    arrays[key] = sparse.coo_matrix(array)
                    values[key] = real_values(arrays[key].data, f"{path}: {key}")
            nodes = _table(path, "nodes", nodes, ("number", "x", "y", "z"))
            dofs = _table(path, "dofs", dofs, ("node", "direction"))
            held = _table(path, "held", held, ("node", "direction"))
        # a rank may have no entries, so it learns the shapes from the others
        shapes = {key: max(filter(None, comm.allgather(array is not None and array.shape)), default=None)
                  for key, array in arrays.items()}  # fmt: skip
        if lacking := [key for key in "KM" if shapes[key] is None]:
            raise InputError(f"{path}: found no {lacking[0]}, expected K and M")
        matrices = {}
        for key, shape in shapes.items():
            if shape is not None:
                array = sparse.coo_matrix(shape) if arrays[key] is None else arrays[key]
                rows, columns = (ends.astype(np.int64) for ends in (array.row, array.col))
                matrices[key] = Entries(shape, rows, columns, values.get(key, array.data).astype(float))
        # numbers of the first node and of the first row of this rank
        first = [sum(comm.allgather(len(array))[: comm.rank]) for array in (nodes, dofs)]
        parts = cls(matrices, dict.fromkeys(matrices, str(path)), removed=_labels(held))
        if comm.allreduce(len(nodes)):
            parts.nodes = NodeTable(nodes[:, 0].astype(np.int64), nodes[:, 1:], first[0] + np.arange(len(nodes)))
        if comm.allreduce(len(dofs)):
            parts.row_labels = _labels(dofs), first[1] + np.arange(len(dofs))
        for name, given_by_name in (("elements", elements), ("sets", sets)):
            setattr(parts, name, {key: np.array(array, np.int64) for key, array in (given_by_name or {}).items()})
        return parts


def _table(path, name, rows, columns) -> np.ndarray:
    """Return rows of numbers in so many columns, after a check of their ranges. Raises InputError."""
    table = np.array([] if rows is None else rows, float)
    table = table if table.size else table.reshape(0, len(columns))
    expected = f"{path}: {name}: expected rows of {', '.join(columns)}"
    if table.ndim != 2 or table.shape[1] != len(columns):
        raise InputError(f"{expected}, found an array of {' x '.join(map(str, table.shape))}")
    for column, values in zip(columns, table.T, strict=True):
        fits = (values >= 1) & (values <= WHOLE[column]) & (values % 1 == 0) if column in WHOLE else np.isfinite(values)
        if not fits.all():
            raise InputError(f"{expected}, found the {column} {values[~fits][0]:g}")
    return table


def _labels(table):
    return label_of(table[:, 0].astype(np.int64), table[:, 1].astype(np.int8) - 1)


def common_size(parts: Parts) -> int:
    """Return the number of rows of all matrices. Raises InputError if they differ."""
    size = parts.matrices["K"].shape[0]
    for key, matrix in parts.matrices.items():
        file = parts.files[key]
        if matrix.shape[0] != matrix.shape[1]:
            raise InputError(f"{file}: found {matrix.shape[0]} x {matrix.shape[1]}, expected a square matrix")
        if matrix.shape[0] != size:
            raise InputError(
                f"{file}: found {matrix.shape[0]} rows, but K ({parts.files['K']}) has {size}; all matrices need the "
                "same size"
            )
    if not size:
        raise InputError(f"{parts.files['K']}: found a matrix without rows, expected one of at least one row")
    return size


def labels_in_order(comm, nodes: NodeTable, size: int, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return labels and rows, ordered by node, as many of each node. Collective. Raises InputError."""
    count = comm.allreduce(len(nodes.label))
    per_node = size // count if count and size % count == 0 else 0
    if per_node not in (1, 2, 3, 6):
        raise InputError(
            f"{name}: found {count} nodes for {size} rows, expected 3 or 6 rows a node; give the node and direction "
            "of every row by --dofs"
        )
    direction = np.tile(np.arange(per_node), len(nodes.label))
    label, row = (np.repeat(numbers, per_node) for numbers in (nodes.label, nodes.place * per_node))
    return label_of(label, direction), row + direction


def used_properties(comm, program: str, types: list[str], materials: list[Material], tables) -> ElementProperties:
    """Return the properties of elements, with the types and materials that some rank has.

    `tables` (elements, 3) by kind, as of ElementProperties, which are renumbered. Collective.
    """
    kept = []
    for column, entries in ((TYPE, types), (MATERIAL, materials)):
        used = np.zeros(len(entries), bool)
        for table in tables.values():
            used[table[table[:, column] >= 0, column]] = True
        used = np.any(comm.allgather(used), axis=0)
        kept.append(tuple(entry for entry, there in zip(entries, used, strict=True) if there))
        places = np.append(np.cumsum(used) - 1, -1)  # the last one stands for none
        for table in tables.values():
            table[:, column] = places[table[:, column]]
    return ElementProperties(program, *kept, tables)


def hold_nodes_without_rows(comm, parts: Parts, nodes: str, dofs: str):
    """Mark nodes of a table or of results without a row as held in the directions that the others have. `nodes`,
    `dofs`: the files, for a warning. Collective."""
    node, direction = node_and_direction(parts.row_labels[0])
    node = np.unique(sort_over_ranks(comm, node)[0])
    there, _ = look_up(comm, node, [], parts.nodes.label)
    directions = np.array(sorted(set().union(*comm.allgather(set(direction[direction < SCALAR].tolist())))), np.int8)
    without = parts.nodes.label[~there]
    parts.removed = label_of(np.repeat(without, len(directions)), np.tile(directions, len(without)))
    if count := comm.allreduce(len(without)):
        parts.warnings.append(
            f"{nodes}: {count} of {comm.allreduce(len(there))} nodes have no row in {dofs}; they are taken as held at "
            "zero; leave them out where they move with other nodes"
        )
