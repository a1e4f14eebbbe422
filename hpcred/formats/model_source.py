"""Models of other programs: files enter, a SecondOrderModel leaves.

The parts of a model travel as `Parts`: matrices, row labels, nodes and elements, each rank with the slices that it
read. A new format of whole finite-element exports is one module beside this one with

    begins(start: bytes) -> bool
        whether a file that starts so (its first 4096 bytes, unpacked) is of the format. Never by the suffix.
    read_parts(path, comm) -> Parts
        what the file, or the set of files that belongs to it, says. Collective. Each rank reads slices; never a
        file on one rank. Raises InputError on all ranks. Rows that the program removed (supports, dependent dofs)
        have no label and no entry.

and one line in EXPORTS. Single matrices have a table of their own in matrix_formats.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..linalg.csr import compress
from ..model.dofs import Dofs
from ..model.second_order_model import SecondOrderModel, row_range
from ..parallel.exchange import exchange
from ..parallel.failures import InputError, agreed
from ..parallel.lookup import look_up, number_over_ranks
from ..parallel.petsc import MPI
from . import abaqus_input, ansys_full, ansys_lists, ansys_nodes, ansys_text, node_table
from .abaqus_matrices import files_beside
from .entries import Entries, LabelledEntries, label_of, node_and_direction
from .matrix_formats import read_entries
from .parts import Parts
from .text import first_bytes


@dataclass(frozen=True)
class Source:
    """The files of a model: K and M, perhaps D, B (n, p), C (r, n), `nodes` and `dofs`.

    `nodes`: an Abaqus input file, or text lines of node, x, y, z in the order of the rows. `dofs`: text lines of
    node, direction (1 to 6), one a row of the matrices; without it every node has the same number of dofs (1 to 3
    displacements, or 6), unless the matrices name their rows themselves.
    """

    K: str
    M: str
    D: str | None = None
    B: str | None = None
    C: str | None = None
    nodes: str | None = None
    dofs: str | None = None


def abaqus_source(path) -> Source:
    """The matrices that Abaqus wrote beside an input file: block.inp with block_STIF1.mtx and block_MASS1.mtx."""
    return Source(**files_beside(path), nodes=str(path))


def load_source(source: Source, comm=MPI.COMM_WORLD, name="model") -> SecondOrderModel:
    """Read the files on all ranks and assemble the model. Collective. Raises InputError."""
    return assemble(read_source(source, comm), comm, name, source.B, source.C)


def load_export(path, comm=MPI.COMM_WORLD, name="model") -> SecondOrderModel:
    """The model of a whole finite-element export, told by its first bytes. Collective. Raises InputError."""
    with agreed(comm):
        start = first_bytes(path)
        export = next((item for item in EXPORTS if item.begins(start)), None)
        if export is None:
            expected = ", ".join(item.name for item in EXPORTS)
            raise InputError(f"{path}: found a file that begins with {start[:12]!r}, expected {expected}")
    return assemble(export.read_parts(path, comm), comm, name)


def read_source(source: Source, comm) -> Parts:
    """The parts that the files of a Source hold, but for B and C. Collective. Raises InputError."""
    files = {key: getattr(source, key) for key in ("K", "M", "D") if getattr(source, key)}
    parts, turned = Parts({key: read_entries(path, comm) for key, path in files.items()}, files), None
    if source.nodes:
        with agreed(comm):
            is_input_file = abaqus_input.begins(first_bytes(source.nodes))
            is_ansys = ansys_nodes.begins(first_bytes(source.nodes))
        if is_input_file:
            parts.nodes, parts.elements = abaqus_input.read(source.nodes, comm)
        elif is_ansys:
            turned = ansys_nodes.read_nodes(source.nodes, comm)
            parts.nodes, parts.elements = turned.nodes, turned.elements
        else:
            parts.nodes = node_table.read(source.nodes, comm)
    if source.dofs:
        with agreed(comm):
            first_bytes(source.dofs)
            if not source.nodes:
                raise InputError(f"{source.dofs}: found the nodes of the rows, but no coordinates; give --nodes")
            for key, item in parts.matrices.items():
                if isinstance(item, LabelledEntries):
                    raise InputError(f"{source.dofs}: not needed, since {files[key]} names node and dof of its rows")
        size = parts.matrices["K"].shape[0]
        parts.row_labels = _read_row_labels(source.dofs, comm, size)
        total = comm.allreduce(len(parts.row_labels[0]))
        if total != size:
            raise InputError(f"{source.dofs}: found {total} lines, expected one for each of the {size} rows")
        if turned is not None:
            ansys_nodes.turn_found(comm, parts, turned)
    elif turned is not None:
        with agreed(comm):
            turned.refuse_turned()
    return parts


def _read_row_labels(path, comm, size):
    """Labels and rows of a file of --dofs: lines of node, direction, or what ANSYS writes. Collective."""
    with agreed(comm):
        start = first_bytes(path)
    if ansys_lists.begins_mapping(start):
        return ansys_lists.read_mapping(path, comm)
    if ansys_lists.begins_vector(start):
        return ansys_lists.read_vector(path, comm, size)
    return node_table.read_row_labels(path, comm)


def read_abaqus(path, comm) -> Parts:
    """An Abaqus input file and the matrices beside it. Collective. Raises InputError."""
    with agreed(comm):
        source = abaqus_source(path)
    return read_source(source, comm)


@dataclass(frozen=True)
class Export:
    """A format of whole finite-element exports; see the top of this module."""

    name: str
    begins: Callable[[bytes], bool]
    read_parts: Callable[..., Parts]


EXPORTS = (
    Export("an Abaqus input file with its matrices beside it", abaqus_input.begins, read_abaqus),
    Export("ANSYS' .full file", ansys_full.begins, ansys_full.read_parts),
    Export("matrices of ANSYS' HBMAT or *EXPORT,...,MMF", ansys_text.begins, ansys_text.read_parts),
)


def assemble(parts: Parts, comm, name="model", inputs=None, outputs=None) -> SecondOrderModel:
    """The model of the parts; `inputs` and `outputs`: matrix files of B (n, p) and C (r, n). Collective.

    Labelled rows are ordered by node and direction. Raises InputError.
    """
    _number_rows(comm, parts)
    size = _common_size(parts)
    if comm.size > size:
        raise InputError(f"{name}: {size} rows cannot be distributed over {comm.size} ranks; use fewer ranks")
    ranges = comm.allgather(row_range(comm, size, 6 if size % 6 == 0 else 3 if size % 3 == 0 else 1))
    starts = np.array([first for first, _ in ranges])
    first, last = ranges[comm.rank]
    if "D" in parts.matrices:
        parts.matrices["D"] = with_transposed_pattern(parts.matrices["D"])
    mine = {key: _owned(comm, starts, parts.matrices.pop(key)) for key in list(parts.matrices)}
    with agreed(comm):
        indptr, indices, values = compress(mine, first, last, size)
    del mine
    B = read_columns(comm, starts, size, inputs) if inputs else None
    Ct = read_columns(comm, starts, size, outputs, transposed=True) if outputs else None
    dofs = _dofs(comm, parts, size, starts, name) if parts.nodes is not None else None
    return SecondOrderModel.from_csr(
        comm, size, indptr, indices, values, B, Ct, dofs, column_names(inputs, B), column_names(outputs, Ct), name,
        parts.elements,
    )  # fmt: skip


def _number_rows(comm, parts):
    """Numbers in place of labels, the same for all matrices."""
    labelled = {key: isinstance(item, LabelledEntries) for key, item in parts.matrices.items()}
    if not any(labelled.values()):
        return
    if not all(labelled.values()):
        named, numbered = (next(key for key in labelled if labelled[key] is kind) for kind in (True, False))
        raise InputError(
            f"{parts.files[numbered]}: found numbered rows, but {parts.files[named]} names node and dof of its rows; "
            "expected the same of all matrices"
        )
    ends = [item for matrix in parts.matrices.values() for item in (matrix.rows, matrix.columns)]
    labels, place = number_over_ranks(comm, np.concatenate(ends))
    size = comm.allreduce(len(labels))
    numbers = iter(np.split(place, np.cumsum([len(item) for item in ends])[:-1]))
    parts.matrices = {
        key: Entries((size, size), next(numbers), next(numbers), item.values) for key, item in parts.matrices.items()
    }
    parts.row_labels = labels, (comm.exscan(len(labels)) or 0) + np.arange(len(labels))


def _common_size(parts):
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
    return size


def _dofs(comm, parts, size, starts, name):
    """Labels of the rows of this rank: as the files name them, or by the order of the nodes."""
    label, row = parts.row_labels or _labels_in_order(comm, parts.nodes, size, name)
    label, row = exchange(comm, np.searchsorted(starts, row, side="right") - 1, [label, row])
    label = label[np.argsort(row)]
    node, direction = node_and_direction(label)
    found, position = look_up(comm, parts.nodes.label, list(parts.nodes.position.T), node)
    with agreed(comm):
        if not found.all():
            raise InputError(f"{name}: the node {node[~found][0]}, which has rows, has no coordinates")
    return Dofs(node, direction, np.array(position).T.reshape(-1, 3).copy())


def _labels_in_order(comm, nodes, size, name):
    """Labels and rows where every node has the same number of rows, one node after the other."""
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


def with_transposed_pattern(entries: Entries) -> Entries:
    """The entries, with zeros where only the transposed place has one: D may be unsymmetric, its pattern not."""
    i, j = entries.rows, entries.columns
    values = np.concatenate([entries.values, np.zeros(len(i))])
    return Entries(entries.shape, np.concatenate([i, j]), np.concatenate([j, i]), values)


def _owned(comm, starts, entries):
    owner = np.searchsorted(starts, entries.rows, side="right") - 1
    return exchange(comm, owner, [entries.rows, entries.columns, entries.values])


def read_columns(comm, starts, size, path, transposed=False):
    """The rows of B (n, p) of this rank from a matrix file, or of C^T where the file has C (r, n). Collective.

    `starts` (ranks,): first row of each rank. Raises InputError where the file does not fit n = size.
    """
    entries = read_entries(path, comm)
    if isinstance(entries, LabelledEntries):
        raise InputError(f"{path}: found lines of node, dof, node, dof, value, expected numbered rows and columns")
    if entries.shape[transposed] != size:
        raise InputError(
            f"{path}: found {entries.shape[0]} x {entries.shape[1]}, expected {size} "
            f"{'columns' if transposed else 'rows'} as the matrices have"
        )
    if transposed:
        entries.rows, entries.columns, entries.shape = entries.columns, entries.rows, entries.shape[::-1]
    i, j, v = _owned(comm, starts, entries)
    first, last = starts[comm.rank], np.append(starts[1:], size)[comm.rank]
    local = np.zeros((last - first, entries.shape[1]))
    np.add.at(local, (i - first, j), v)
    return local


def column_names(path, columns) -> list[str]:
    """Names of the columns of a file: B.mtx:1, B.mtx:2, ..."""
    return [] if columns is None else [f"{Path(path).name}:{k + 1}" for k in range(columns.shape[1])]
