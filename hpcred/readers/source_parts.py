"""Read the files of a Source, single matrices and lists of nodes and dofs, into the parts of a model."""

import numpy as np

from ..files.text import first_bytes, warnings_of_end
from ..parallel.failures import InputError, agreed
from ..parallel.lookup import require_once
from ..settings.source import Source
from .abaqus import input_file as abaqus_input
from .ansys import lists as ansys_lists
from .ansys import nodes as ansys_nodes
from .calculix import frd as calculix_frd
from .calculix import matrix_storage as calculix
from .entries import LARGEST_VALUE, Entries, LabelledEntries, label_name, require_sane
from .matrix_formats import matrix_reader, read_entries
from .nastran import exports as nastran
from .nodes import table as node_table
from .nodes import uff
from .parts import Parts, common_size, hold_nodes_without_rows, labels_in_order
from .unread import refuse_unread

HELD_BY, HELD = 1e36, 1e35  # what Abaqus puts on the diagonal of K for supports, and what counts as that


def read_source(source: Source, comm) -> Parts:
    """Return the parts that the files of a Source hold, but for B and C. Collective. Raises InputError."""
    # the matrices; a file that holds several is opened once
    files = {key: getattr(source, key) for key in ("K", "M", "D") if getattr(source, key)}
    readers = {path: matrix_reader(path, comm) for path in dict.fromkeys(files.values())}
    parts = Parts({key: read_entries(path, comm, key, source.variables, readers[path]) for key, path in files.items()},
                  files)  # fmt: skip
    with agreed(comm):
        for path, reader in readers.items():
            parts.warnings += warnings_of_end(path) if reader.line_ended else []
        parts.open_ended = {key for key, path in files.items() if readers[path].open_ended}
        parts.loose = readers[files["K"]].loose
    # rows of CalculiX are named by its own file of dofs together with its mesh
    if _name_rows_of_calculix(comm, parts, source):
        return parts
    # the nodes, by what their file begins with: each program says what more it knows
    is_input_file, turned, points = False, None, None
    if source.nodes:
        with agreed(comm):
            start = first_bytes(source.nodes)
            is_input_file = abaqus_input.begins(start)
        if uff.begins(start):
            mesh = uff.read(source.nodes, comm)
            parts.nodes = mesh.nodes
            parts.take_mesh(mesh, mesh.remarks)
        elif nastran.begins_bulk(start):
            parts.nodes, deck, points = nastran.read_nodes(source.nodes, comm)
            parts.take_mesh(deck, deck.remarks)
        # an input file says which dofs its boundary holds, other files leave that to the missing rows
        elif is_input_file:
            mesh = abaqus_input.read(source.nodes, comm)
            parts.nodes = mesh.nodes
            parts.take_mesh(mesh, mesh.remarks)
            keywords = [section.keyword for section in mesh.sections]
            parts.all_massive = 0 < keywords.count("material") == keywords.count("density")
        elif calculix_frd.begins(start):
            results = calculix_frd.read(source.nodes, comm)
            if results is None:
                raise InputError(
                    f"{source.nodes}: found results of CalculiX without nodes, as a run that only writes matrices "
                    "leaves them; give those of another run of the same mesh, or the input file"
                )
            parts.nodes = results.nodes
            parts.take_mesh(results, results.notes(source.nodes))
        elif ansys_nodes.begins(start):
            turned = ansys_nodes.read_nodes(source.nodes, comm)
            ansys_nodes.give_mesh(parts, turned)
        else:
            with agreed(comm):
                refuse_unread(source.nodes)
            parts.nodes = node_table.read(source.nodes, comm)
    # the rows, of which the nodes may have more; what has no row is held
    if source.dofs:
        with agreed(comm):
            first_bytes(source.dofs)
            if not source.nodes:
                raise InputError(f"{source.dofs}: found the nodes of the rows, but no coordinates; give --nodes")
            _require_numbered(parts, source)
        parts.row_labels = _read_row_labels(source.dofs, comm, parts.matrices["K"].shape[0])
        _require_rows(comm, parts, source, parts.row_labels[0])
        if is_input_file:
            _hold_by_boundary(comm, parts, mesh)
        else:
            hold_nodes_without_rows(comm, parts, source.nodes, source.dofs)
        if turned is not None:
            ansys_nodes.turn_found(comm, parts, turned)
    # without named rows nothing can be turned back into the global axes
    elif turned is not None:
        with agreed(comm):
            turned.refuse_turned()
    _remove_supports(comm, parts)
    # entries given twice in a file are warned of only where they are still those of the file
    parts.as_written = turned is None
    if points is not None:
        parts.as_written &= not comm.allreduce(len(points.turned))
        nastran.turn_rows(comm, parts, points, source.nodes)
    return parts


def _name_rows_of_calculix(comm, parts, source) -> bool:
    """Name the rows by a .dof file and an input file or results, as CalculiX reads them; False for others."""
    with agreed(comm):
        if not (source.dofs and source.nodes and calculix.begins_dofs(first_bytes(source.dofs))):
            return False
        start = first_bytes(source.nodes)
        kind = "input" if abaqus_input.begins(start) else "results" if calculix_frd.begins(start) else None
    if kind is None:
        return False
    with agreed(comm):
        _require_numbered(parts, source)
    label, row = calculix.read_dofs(source.dofs, comm)
    _require_rows(comm, parts, source, label)
    try:
        calculix.name_rows(comm, parts, {"dofs": source.dofs, kind: source.nodes, **parts.files}, label, row)
    except calculix.Unnamed as reason:
        raise InputError(f"{source.dofs}: {reason}; the rows cannot be named: leave out --dofs and --nodes") from reason
    return True


def _require_numbered(parts, source):
    """Raise InputError where matrices name their rows themselves."""
    for key, matrix in parts.matrices.items():
        if isinstance(matrix, LabelledEntries):
            raise InputError(f"{source.dofs}: not needed, since {parts.files[key]} names node and dof of its rows")


def _require_rows(comm, parts, source, label):
    """Raise InputError where a list has not one line for each row; `label`: those of this rank."""
    size, total = parts.matrices["K"].shape[0], comm.allreduce(len(label))
    if total != size:
        raise InputError(f"{source.dofs}: found {total} lines, expected one for each of the {size} rows")


def _remove_supports(comm, parts):
    """Remove the rows that Abaqus holds by 1e36 on the diagonal of K, and keep their labels. Collective."""
    # rows with such a number on the diagonal, and sane numbers elsewhere
    K = parts.matrices["K"]
    size_of = np.abs(K.values)
    held = K.rows[(K.rows == K.columns) & (size_of >= HELD) & (size_of <= LARGEST_VALUE)]  # inf is no support
    held = np.unique(np.concatenate(comm.allgather(np.unique(held))))  # few: those of the supports
    if not len(held):
        return
    with agreed(comm):
        for key, matrix in parts.matrices.items():
            require_sane(matrix.values, f"{parts.files[key]}: found", "real")
    remark = f"{parts.files['K']}: removed {len(held)} rows that are held by {HELD_BY:g} on the diagonal of K"
    # named rows go with their entries; behind numbered ones the others move up
    if isinstance(K, LabelledEntries):
        for key, matrix in parts.matrices.items():
            free = ~(np.isin(matrix.rows, held) | np.isin(matrix.columns, held))
            parts.matrices[key] = LabelledEntries(matrix.rows[free], matrix.columns[free], matrix.values[free])
        parts.removed = held[comm.rank :: comm.size]
        names = [label_name(label) for label in held[:4]]
    else:
        size = K.shape[0]
        if parts.nodes is not None and parts.row_labels is None:
            parts.row_labels = labels_in_order(comm, parts.nodes, size, parts.files["K"])
        for key, matrix in parts.matrices.items():
            if matrix.shape != K.shape:
                common_size(parts)
            free = ~(np.isin(matrix.rows, held) | np.isin(matrix.columns, held))
            rows, columns = (ends[free] - np.searchsorted(held, ends[free]) for ends in (matrix.rows, matrix.columns))
            parts.matrices[key] = Entries((size - len(held),) * 2, rows, columns, matrix.values[free])
        names = [str(row + 1) for row in held[:4]]
        if parts.row_labels is not None:
            label, row = parts.row_labels
            gone = np.isin(row, held)
            parts.removed = np.concatenate([parts.removed, label[gone]])
            parts.row_labels = label[~gone], row[~gone] - np.searchsorted(held, row[~gone])
        else:
            remark += "; the rows behind them have new numbers"
    parts.warnings.append(f"{remark}: {', '.join(names)}{', ...' if len(held) > 4 else ''}")


def _hold_by_boundary(comm, parts, mesh):
    """Hold the dofs that *Boundary of an input file names and that have no row. Collective."""
    try:
        parts.removed, _ = calculix.held_by_boundary(comm, mesh, {}, parts.row_labels[0])
    except InputError as reason:  # such as types of supports by name
        parts.warnings.append(f"{reason}; nodes without rows are not taken as held, and their elements have no stress")


def _read_row_labels(path, comm, size):
    """Return labels and rows of a file of --dofs: lines of node, direction, or what ANSYS writes. Collective."""
    with agreed(comm):
        start = first_bytes(path)
    if ansys_lists.begins_mapping(start):
        return ansys_lists.read_mapping(path, comm)
    if ansys_lists.begins_vector(start):
        return ansys_lists.read_vector(path, comm, size)
    if calculix.begins_dofs(start):
        label, row = calculix.read_dofs(path, comm)
        require_once(comm, label, lambda twice: f"{path}: found two rows of {label_name(twice)}, since CalculiX makes "
                     "solids of beams and shells; such rows cannot be named: leave out --dofs and --nodes")  # fmt: skip
        return label, row
    return node_table.read_row_labels(path, comm)
