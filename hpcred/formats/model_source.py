"""Models of other programs: files enter, a SecondOrderModel leaves.

The parts of a model travel as `Parts`: matrices, row labels, nodes and elements, each rank with the slices that it
read. A new format of whole finite-element exports is one module beside this one with

    begins(start: bytes) -> bool
        whether a file that starts so (its first 4096 bytes, unpacked) is of the format. Never by the suffix.
    read_parts(path, comm) -> Parts
        what the file, or the set of files that belongs to it, says. Collective. Each rank reads slices; never a
        file on one rank. Raises InputError on all ranks. Rows that the program removed (supports, dependent dofs)
        have no label and no entry.

and one line in EXPORTS. A format whose files hold several matrices by name has `named`, and read_parts(path, comm,
variables) with the names that the user gave by K, M, D. Single matrices have a table of their own in matrix_formats.
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
from ..parallel.lookup import look_up, number_over_ranks, sort_over_ranks
from ..parallel.memory import MB, give_back, node_mb
from ..parallel.petsc import MPI
from . import (
    abaqus_input,
    abaqus_matrices,
    ansys_full,
    ansys_lists,
    ansys_nodes,
    ansys_text,
    calculix,
    mat_matrices,
    matrix_market,
    nastran,
    nastran_op2,
    nastran_op4,
    node_table,
    uff,
)
from .abaqus_matrices import files_beside
from .entries import LARGEST_VALUE, Entries, LabelledEntries, label_name, label_of, node_and_direction, require_sane
from .matrix_formats import format_of, read_entries
from .model_file import FORMAT as OF_MODELS
from .outputs import HDF5, OTHER, hdf5_kind, kind_of
from .parts import Parts
from .source import Source
from .text import doubts_of_end, first_bytes
from .unread import refuse_unread

OF_LINES = (matrix_market, abaqus_matrices)  # formats whose numbers end where their lines do
HELD_BY, HELD = 1e36, 1e35  # what Abaqus puts on the diagonal of K for supports, and what counts as that


def abaqus_source(path) -> Source:
    """The matrices that Abaqus wrote beside an input file: block.inp with block_STIF1.mtx and block_MASS1.mtx."""
    return Source(**files_beside(path), nodes=str(path))


def load_source(source: Source, comm=MPI.COMM_WORLD, name="model") -> SecondOrderModel:
    """Read the files on all ranks and assemble the model. Collective. Raises InputError."""
    return assemble(read_source(source, comm), comm, name, source.B, source.C, source.variables)


def load_export(path, comm=MPI.COMM_WORLD, name="model", variables=None) -> SecondOrderModel:
    """The model of a whole finite-element export, told by its first bytes. Collective. Raises InputError.

    `variables`: names of matrices by K, M, D, for files that hold several.
    """
    return assemble(read_export(path, comm, variables), comm, name)


def export_of(path):
    """The Export whose files begin as this one, or None. Raises InputError where the file cannot be read."""
    start = first_bytes(path)
    return next((item for item in EXPORTS if item.begins(start)), None)


def _no_export(path) -> InputError:
    """What to raise for a file that is no export."""
    start, what = first_bytes(path), None
    if not start:
        return InputError(f"{path}: found an empty file")
    if nastran_op2.begins(start):
        return InputError(
            f"{path}: found an OP2 of Nastran, of which only nodes and sets of dofs are read; give the .op4 or .pch of "
            "the run, and leave this one beside it"
        )
    refuse_unread(path)
    if start.startswith(HDF5):
        what = kind_of(path)
        if what == hdf5_kind(OF_MODELS):
            return InputError(f"{path}: found a model of hpcred, which needs no conversion; a job names its inputs")
    elif (single := format_of(path)) is not None:
        what = f"{single.name}: give single matrices by -K and -M"
    elif (kind := kind_of(path)) != OTHER:
        what = kind
    expected = ", ".join(item.name for item in EXPORTS)
    return InputError(
        f"{path}: found a file that begins with {start[:12]!r}{f' ({what})' if what else ''}, expected {expected}"
    )


def read_export(path, comm, variables=None) -> Parts:
    """The parts that a whole finite-element export holds. Collective. Raises InputError."""
    with agreed(comm):
        export = export_of(path)
        if export is None:
            raise _no_export(path)
        if variables and not export.named:
            raise InputError(f"--variables: found names of matrices, but {path} is {export.name}, which has no names")
    return export.read_parts(path, comm, variables or {}) if export.named else export.read_parts(path, comm)


def read_source(source: Source, comm) -> Parts:
    """The parts that the files of a Source hold, but for B and C. Collective. Raises InputError."""
    files = {key: getattr(source, key) for key in ("K", "M", "D") if getattr(source, key)}
    parts = Parts({key: read_entries(path, comm, key, source.variables) for key, path in files.items()}, files)
    with agreed(comm):
        for path in dict.fromkeys(files.values()):
            parts.warnings += doubts_of_end(path) if format_of(path).module in OF_LINES else []
    is_input_file, turned = False, None
    if source.nodes:
        with agreed(comm):
            start = first_bytes(source.nodes)
            is_input_file = abaqus_input.begins(start)
        if uff.begins(start):
            parts.nodes, parts.elements = uff.read(source.nodes, comm)
        elif nastran.begins_bulk(start):
            parts.nodes, parts.elements = nastran.read_nodes(source.nodes, comm)
        elif is_input_file:
            mesh = abaqus_input.read(source.nodes, comm)
            parts.nodes, parts.elements, parts.sets = mesh.nodes, mesh.elements, mesh.sets
        elif ansys_nodes.begins(start):
            turned = ansys_nodes.read_nodes(source.nodes, comm)
            parts.nodes, parts.elements = turned.nodes, turned.elements
        else:
            with agreed(comm):
                refuse_unread(source.nodes)
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
        if not is_input_file:
            _hold_nodes_without_rows(comm, parts, source)
        if turned is not None:
            ansys_nodes.turn_found(comm, parts, turned)
    elif turned is not None:
        with agreed(comm):
            turned.refuse_turned()
    _remove_supports(comm, parts)
    return parts


def _remove_supports(comm, parts):
    """Remove the rows that Abaqus holds by 1e36 on the diagonal of K, and keep their labels. Collective."""
    K = parts.matrices["K"]
    size_of = np.abs(K.values)
    held = K.rows[(K.rows == K.columns) & (size_of >= HELD) & (size_of <= LARGEST_VALUE)]  # inf is no support
    held = np.unique(np.concatenate(comm.allgather(np.unique(held))))  # few: those of the supports
    if not len(held):
        return
    with agreed(comm):
        for key, item in parts.matrices.items():
            require_sane(item.values, f"{parts.files[key]}: found", "real")
    what = f"{parts.files['K']}: removed {len(held)} rows that are held by {HELD_BY:g} on the diagonal of K"
    if isinstance(K, LabelledEntries):
        for key, item in parts.matrices.items():
            free = ~(np.isin(item.rows, held) | np.isin(item.columns, held))
            parts.matrices[key] = LabelledEntries(item.rows[free], item.columns[free], item.values[free])
        parts.removed = held[comm.rank :: comm.size]
        names = [label_name(label) for label in held[:4]]
    else:
        size = K.shape[0]
        if parts.nodes is not None and parts.row_labels is None:
            parts.row_labels = _labels_in_order(comm, parts.nodes, size, parts.files["K"])
        for key, item in parts.matrices.items():
            if item.shape != K.shape:
                _common_size(parts)
            free = ~(np.isin(item.rows, held) | np.isin(item.columns, held))
            rows, columns = (ends[free] - np.searchsorted(held, ends[free]) for ends in (item.rows, item.columns))
            parts.matrices[key] = Entries((size - len(held),) * 2, rows, columns, item.values[free])
        names = [str(row + 1) for row in held[:4]]
        if parts.row_labels is not None:
            label, row = parts.row_labels
            gone = np.isin(row, held)
            parts.removed = np.concatenate([parts.removed, label[gone]])
            parts.row_labels = label[~gone], row[~gone] - np.searchsorted(held, row[~gone])
        else:
            what += "; the rows behind them have new numbers"
    parts.warnings.append(f"{what}: {', '.join(names)}{', ...' if len(held) > 4 else ''}")


def _hold_nodes_without_rows(comm, parts, source):
    """Nodes of a table without a row are held in the directions that the others have."""
    node, direction = node_and_direction(parts.row_labels[0])
    node = np.unique(sort_over_ranks(comm, node)[0])
    there, _ = look_up(comm, node, [], parts.nodes.label)
    directions = np.array(sorted(set().union(*comm.allgather(set(direction.tolist())))))
    without = parts.nodes.label[~there]
    parts.removed = label_of(np.repeat(without, len(directions)), np.tile(directions, len(without)))
    if count := comm.allreduce(len(without)):
        parts.warnings.append(
            f"{source.nodes}: {count} of {comm.allreduce(len(there))} nodes have no row in {source.dofs}; they are "
            "taken as held at zero; leave them out where they move with other nodes"
        )


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


def read_input_file(path, comm) -> Parts:
    """An input file of Abaqus or CalculiX, told by the matrices beside it. Collective. Raises InputError."""
    with agreed(comm):
        of_calculix = "K" in calculix.files_of(path)
        if of_calculix and abaqus_matrices.is_beside(path):
            raise InputError(
                f"{path}: found matrices of both Abaqus and CalculiX beside it; give the .sti file in place of it, or "
                "-K and -M of Abaqus with --nodes"
            )
    return calculix.read_parts(path, comm) if of_calculix else read_abaqus(path, comm)


@dataclass(frozen=True)
class Export:
    """A format of whole finite-element exports; see the top of this module.

    `told_by` and `companions`: what tells it, and the files beside it that are read too, for the table of formats.
    `contents`: (path) -> names and sizes of the matrices in a file that holds several, without reading them.
    """

    name: str
    begins: Callable[[bytes], bool]
    read_parts: Callable[..., Parts]
    told_by: str = ""
    companions: str = ""
    named: bool = False
    contents: Callable[[str], dict[str, str]] | None = None


EXPORTS = (
    Export("an Abaqus or CalculiX input file with its matrices beside it", abaqus_input.begins, read_input_file,
           "a keyword such as *Node", "x_STIF1.mtx, x_MASS1.mtx, x_DMPV1.mtx; x.sti, x.mas, x.dof (.gz)"),
    Export("CalculiX .sti, .mas or .dof", calculix.begins, calculix.read_parts,
           "lines of an upper triangle, or of node.direction", "x.sti, x.mas, x.dof (.gz), x.inp"),
    Export("MATLAB .mat (version 4 to 7.3)", mat_matrices.begins, mat_matrices.read_parts,
           "its header, or HDF5 with one", "none: K, M, D, nodes, dofs in one file", True, mat_matrices.contents),
    Export("ANSYS' .full file", ansys_full.begins, ansys_full.read_parts, "the header of its first record",
           ".cdb, .rst or a list with nodes"),
    Export("matrices of ANSYS' HBMAT or *EXPORT,...,MMF", ansys_text.begins, ansys_text.read_parts,
           "its title, or a Matrix Market header with a mapping beside it", "the other matrices, mapping, nodes"),
    Export("Nastran OP4", nastran_op4.begins, nastran.read_op4, "the header of its first matrix",
           "other .op4 files, .op2, .bdf or .dat with nodes", True),
    Export("Nastran DMIG, or an input file with the matrices beside it", nastran.begins_bulk, nastran.read_bulk,
           "DMIG or other cards", ".pch or .op4 with the matrices, .bdf or .dat with nodes", True),
)  # fmt: skip


def assemble(parts: Parts, comm, name="model", inputs=None, outputs=None, variables=None) -> SecondOrderModel:
    """The model of the parts; `inputs` and `outputs`: matrix files of B (n, p) and C (r, n). Collective.

    Labelled rows are ordered by node and direction. `variables`: see Source. Raises InputError.
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
    with agreed(comm):
        for key, item in parts.matrices.items():
            if len(item.values) and np.abs(item.values).max() > LARGEST_VALUE:  # NaN and Inf are found with their row
                raise InputError(
                    f"{parts.files[key]}: found the value {np.abs(item.values).max():g} in {key}, more than any units "
                    "explain; the file is damaged"
                )
    for key in ("K", "M"):
        if not comm.allreduce(int(np.count_nonzero(parts.matrices[key].values))):
            raise InputError(f"{parts.files[key]}: found no number other than zero in {key}, expected a matrix")
    entries = sum(comm.allreduce(len(item.values)) for item in parts.matrices.values())
    if size > entries:  # before anything has its length: a damaged header may say any size
        raise InputError(
            f"{parts.files['K']}: found {size} rows and {entries} entries in all matrices, expected one in each row at "
            "least; the file is damaged, or has rows that no element touches"
        )
    mine = {}
    for key in list(parts.matrices):
        mine[key] = _owned(comm, starts, parts.matrices.pop(key))
        give_back()
    with agreed(comm):
        indptr, indices, values = compress(mine, first, last, size)
    give_back()
    B = read_columns(comm, starts, size, inputs, variables=variables) if inputs else None
    Ct = read_columns(comm, starts, size, outputs, transposed=True, variables=variables) if outputs else None
    dofs = _dofs(comm, parts, size, starts, name) if parts.nodes is not None else None
    held = _held(comm, parts) if parts.nodes is not None else None
    remarks = dict.fromkeys(sentence for sentences in comm.allgather(parts.warnings) for sentence in sentences)
    model = SecondOrderModel.from_csr(
        comm, size, indptr, indices, values, B, Ct, dofs, column_names(inputs, B), column_names(outputs, Ct), name,
        parts.elements, held, parts.sets, tuple(remarks),
    )  # fmt: skip
    del indptr, indices, values
    give_back()
    return model


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
    if not size:
        raise InputError(f"{parts.files['K']}: found a matrix without rows, expected one of at least one row")
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


def _held(comm, parts):
    """The dofs without row that have a place, each once, or None where there is none."""
    label = np.unique(sort_over_ranks(comm, parts.removed)[0])
    node, direction = node_and_direction(label)
    found, position = look_up(comm, parts.nodes.label, list(parts.nodes.position.T), node)
    if not comm.allreduce(int(found.sum())):
        return None
    return Dofs(node, direction, np.array(position).T.reshape(-1, 3)).take(found)


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


def read_columns(comm, starts, size, path, transposed=False, variables=None):
    """The rows of B (n, p) of this rank from a matrix file, or of C^T where the file has C (r, n). Collective.

    `starts` (ranks,): first row of each rank; `variables`: see Source. Raises InputError where the file
    does not fit n = size.
    """
    entries = read_entries(path, comm, "C" if transposed else "B", variables)
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
    with agreed(comm):
        require_sane(v, f"{path}: found", "real")
        needed, free = int(last - first) * entries.shape[1] * 8 / MB, node_mb()
        if needed > free:
            what = "rows" if transposed else "columns"
            raise InputError(
                f"{path}: found {entries.shape[1]} {what}, which take {needed:.0f} MB, and {free:.0f} MB are free; the "
                "file is damaged, or there are too many"
            )
    local = np.zeros((last - first, entries.shape[1]))
    np.add.at(local, (i - first, j), v)
    return local


def column_names(path, columns) -> list[str]:
    """Names of the columns of a file: B.mtx:1, B.mtx:2, ..."""
    return [] if columns is None else [f"{Path(path).name}:{k + 1}" for k in range(columns.shape[1])]
