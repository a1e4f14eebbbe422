"""Assemble the parts of a model, of which each rank has slices in any order, to a model distributed by rows."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..fe.dofs import SCALAR, Dofs
from ..fe.elements import NODES
from ..linalg.csr import compress
from ..model.second_order_model import SecondOrderModel
from ..parallel.exchange import exchange
from ..parallel.failures import InputError, agreed
from ..parallel.lookup import look_up, number_over_ranks, sort_over_ranks
from ..parallel.memory import MB, give_back, node_mb
from ..parallel.shares import row_range
from .entries import LARGEST_VALUE, STRIDE, Entries, LabelledEntries, node_and_direction, refuse_one_side, require_sane
from .matrices import harwell_boeing
from .matrix_formats import read_entries
from .parts import Parts, common_size, labels_in_order

MANY_COLUMNS = 1000  # of B, up to which nobody asks whether they are independent
TRANSLATIONS = 3  # the first directions of a node
MANY = 0.05  # of the nodes: so many without mass behind the last row of M are a cut
THIN = ("line", "line3")  # kinds of elements that may be springs
WHAT = {"K": "stiffness", "M": "mass"}
WAY_OUT = "export it again; if it is whole, give it in a format that has its size, such as Matrix Market"


def assemble(
    parts: Parts, comm, name="model", inputs=None, outputs=None, variables=None, rates=None
) -> SecondOrderModel:
    """Return the model of the parts; `inputs` and `outputs`: matrix files of B (n, p) and C (r, n), `rates`: those of
    Cv and Ca by key. Collective.

    Labelled rows are ordered by node and direction. `variables`: see Source. Raises InputError.
    """
    number_rows(comm, parts)
    size = common_size(parts)
    if comm.size > size:
        raise InputError(f"{name}: {size} rows cannot be distributed over {comm.size} ranks; use fewer ranks")
    # rows of this rank, with whole nodes where their number allows it
    ranges = comm.allgather(row_range(comm, size, 6 if size % 6 == 0 else 3 if size % 3 == 0 else 1))
    starts = np.array([first for first, _ in ranges])
    first, last = ranges[comm.rank]
    if "D" in parts.matrices:
        parts.matrices["D"] = with_transposed_pattern(parts.matrices["D"])
    # what cannot be a matrix of a body is refused before it is distributed
    with agreed(comm):
        for key, matrix in parts.matrices.items():
            largest = np.abs(matrix.values).max(initial=0.0)
            if largest > LARGEST_VALUE:  # NaN and Inf are found with their row
                raise InputError(
                    f"{parts.files[key]}: found the value {largest:g} in {key}, more than any units explain; the file "
                    "is damaged"
                )
    for key in ("K", "M"):
        if not comm.allreduce(int(np.count_nonzero(parts.matrices[key].values))):
            raise InputError(f"{parts.files[key]}: found no number other than zero in {key}, expected a matrix")
        refuse_one_side(comm, parts.matrices[key], parts.files[key],
                        f"both triangles of {key}; write it whole, or as a symmetric Matrix Market file")  # fmt: skip
    entries = sum(comm.allreduce(len(matrix.values)) for matrix in parts.matrices.values())
    if size > entries:  # before anything has its length: a damaged header may say any size
        raise InputError(
            f"{parts.files['K']}: found {size} rows and {entries} entries in all matrices, expected one in each row at "
            "least; the file is damaged, or has rows that no element touches"
        )
    # entries go to the rank of their row, matrix by matrix for the memory
    mine = {}
    for key in list(parts.matrices):
        mine[key] = owned(comm, starts, parts.matrices.pop(key))
        give_back()
    labels = _labels(comm, parts, size, starts, name)
    if parts.open_ended:
        parts.warnings += refuse_cut(comm, parts, {key: Rows(first, last, *mine[key]) for key in ("K", "M")}, labels)
    with agreed(comm):
        repeats = {}
        indptr, indices, values = compress(mine, first, last, size, repeats)
    give_back()
    if parts.as_written:
        parts.warnings += _on_repeats(comm, parts, repeats)
    # inputs and outputs
    B = read_columns(comm, starts, size, inputs, variables=variables) if inputs else None
    Ct = read_columns(comm, starts, size, outputs, transposed=True, variables=variables) if outputs else None
    rates = {key: read_columns(comm, starts, size, path, transposed=True, variables=variables, key=key)
             for key, path in (rates or {}).items()}  # fmt: skip
    # nodes of the rows, and of the dofs that the program held
    dofs = held = None
    if parts.nodes is not None:
        dofs, placed = _placed(comm, parts, labels)
        with agreed(comm):
            if not placed.all():
                raise InputError(f"{name}: the node {dofs.node[~placed][0]}, which has rows, has no coordinates")
        held, placed = _placed(comm, parts, np.unique(sort_over_ranks(comm, parts.removed)[0]))
        held = held.take(placed) if comm.allreduce(int(placed.sum())) else None
    remarks = dict.fromkeys(sentence for sentences in comm.allgather(parts.warnings) for sentence in sentences)
    model = SecondOrderModel.from_csr(
        comm, size, indptr, indices, values, B, None if rates else Ct, dofs=dofs, input_names=column_names(inputs, B),
        output_names=() if rates else column_names(outputs, Ct), name=name, elements=parts.elements, held=held,
        sets=parts.sets, remarks=remarks, properties=parts.properties,
    )  # fmt: skip
    del indptr, indices, values
    give_back()
    if rates:
        names = [f"output {k + 1}" for k in range(next(iter(rates.values())).shape[1])]
        with model:
            return model.with_output_columns(Ct, names, **rates)
    return model


def _on_repeats(comm, parts, repeats) -> list[str]:
    """Return sentences on entries of K and M at places that were given before; refused where no place has one alone."""
    remarks = []
    for key in ("K", "M"):
        again, once = comm.allreduce(np.array(repeats[key]))
        if again and not once:
            raise InputError(
                f"{parts.files[key]}: found every entry of {key} more than once, expected each once; was the file "
                "written twice, one behind the other?"
            )
        if again:
            remarks.append(
                f"{parts.files[key]}: {again} entries of {key} stand at places that were given before; they were added "
                "up, as an assembly of elements means it"
            )
    return remarks


def number_rows(comm, parts):
    """Replace labels by row numbers, the same for all matrices."""
    labelled = {key: isinstance(matrix, LabelledEntries) for key, matrix in parts.matrices.items()}
    if not any(labelled.values()):
        return
    if not all(labelled.values()):
        named, numbered = (next(key for key in labelled if labelled[key] is kind) for kind in (True, False))
        raise InputError(
            f"{parts.files[numbered]}: found numbered rows, but {parts.files[named]} names node and dof of its rows; "
            "expected the same of all matrices"
        )
    ends = parts.ends
    labels, place = number_over_ranks(comm, np.concatenate(ends))
    size = comm.allreduce(len(labels))
    numbers = iter(np.split(place, np.cumsum([len(end) for end in ends])[:-1]))
    parts.matrices = {
        key: Entries((size,) * 2, next(numbers), next(numbers), matrix.values) for key, matrix in parts.matrices.items()
    }
    parts.row_labels = labels, (comm.exscan(len(labels)) or 0) + np.arange(len(labels))


def _labels(comm, parts, size, starts, name):
    """Return labels of the rows of this rank, from the files or the order of the nodes; None without either."""
    if parts.row_labels is None and parts.nodes is None:
        return None
    label, row = parts.row_labels or labels_in_order(comm, parts.nodes, size, name)
    label, row = exchange(comm, np.searchsorted(starts, row, side="right") - 1, [label, row])
    return label[np.argsort(row)]


def _placed(comm, parts, label):
    """Return the dofs of labels, and which of them (dofs,) have a place. Collective."""
    node, direction = node_and_direction(label)
    there, position = look_up(comm, parts.nodes.label, list(parts.nodes.position.T), node)
    return Dofs(node, direction, np.array(position).T.reshape(-1, 3).copy()), there


def with_transposed_pattern(entries: Entries) -> Entries:
    """Return the entries, with zeros where only the transposed place has one: D may be unsymmetric, its pattern not."""
    i, j = entries.rows, entries.columns
    values = np.concatenate([entries.values, np.zeros(len(i))])
    return Entries(entries.shape, np.concatenate([i, j]), np.concatenate([j, i]), values)


def owned(comm, starts, entries) -> tuple:
    """Return rows, columns and values of the entries in the rows of this rank. Collective."""
    owner = np.searchsorted(starts, entries.rows, side="right") - 1
    return exchange(comm, owner, [entries.rows, entries.columns, entries.values])


def read_columns(comm, starts, size, path, transposed=False, variables=None, right_hand_sides=False, key=None):
    """Return the rows of B (n, p) of this rank from a matrix file, or of C^T where the file has C (r, n). Collective.

    `starts` (ranks,): first row of each rank; `variables`: see Source; `right_hand_sides`: those of a Harwell-Boeing
    file that has some are taken; `key`: the name of the matrix, by default B or C.
    Raises InputError where the file does not fit n = size.
    """
    # the entries, in the orientation of B
    entries = harwell_boeing.read_right_hand_sides(path, comm) if right_hand_sides else None
    if entries is None:
        entries = read_entries(path, comm, key or ("C" if transposed else "B"), variables)
    if isinstance(entries, LabelledEntries):
        raise InputError(f"{path}: found lines of node, dof, node, dof, value, expected numbered rows and columns")
    if entries.shape[transposed] != size:
        raise InputError(
            f"{path}: found {entries.shape[0]} x {entries.shape[1]}, expected {size} "
            f"{'columns' if transposed else 'rows'} as the matrices have"
        )
    if transposed:
        entries.rows, entries.columns, entries.shape = entries.columns, entries.rows, entries.shape[::-1]
    if entries.shape[1] > max(size, MANY_COLUMNS):
        what = "rows" if transposed else "columns"
        raise InputError(
            f"{path}: found {entries.shape[1]} {what} for a model of {size} dofs, expected no more {what} than it has "
            "dofs; all others are combinations of these"
        )
    # the columns are dense, and a damaged number of them may not take all memory
    i, j, v = owned(comm, starts, entries)
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
    """Return names of the columns of a file: B.mtx:1, B.mtx:2, ..."""
    return [] if columns is None else [f"{Path(path).name}:{k + 1}" for k in range(columns.shape[1])]


# Detect truncated matrices of formats without end mark, by rows that only one of K and M has.
# A text that is cut after a line looks like a smaller matrix. In a complete one, each row with an entry has one on the
# diagonal, and nodes with mass have stiffness. Single nodes may be without mass, but not some corners or edge midpoints
# of solids and shells, nor many nodes after the last row of M. All functions are collective.


class Rows:
    """The rows of this rank, from `first` on, that have an entry in a matrix, and those with one on the diagonal."""

    def __init__(self, first: int, last: int, rows, columns, values):
        there = values != 0
        self.touched, self.on_diagonal = (np.zeros(last - first, bool) for _ in range(2))
        self.touched[rows[there] - first] = True
        self.on_diagonal[rows[there & (rows == columns)] - first] = True


def refuse_cut(comm, parts, rows: dict[str, Rows], labels) -> list[str]:
    """Refuse open-ended matrices that lack rows; return warnings. `labels`: of rows here, or None. Collective."""
    # each row with an entry has one on the diagonal
    for key in sorted(parts.open_ended & set(rows)):  # in one order on all ranks
        if bare := comm.allreduce(int((rows[key].touched & ~rows[key].on_diagonal).sum())):
            raise InputError(
                f"{parts.files[key]}: found {bare} rows of {key} with entries but none on the diagonal, expected one "
                f"in each row; the file is cut off or damaged: {WAY_OUT}"
            )
    if labels is None:
        return []
    # nodes with mass have stiffness
    if "K" in parts.open_ended and not parts.loose:
        only = _only(comm, labels, rows["M"], rows["K"])
        alone = (only.nodes & (labels % STRIDE != SCALAR)) | (only.behind & (labels % STRIDE < TRANSLATIONS))
        if count := comm.allreduce(len(np.unique(labels[alone] // STRIDE))):
            raise _lacks(comm, parts, "K", "M", count, labels[alone])
    if "M" not in parts.open_ended:
        return []
    only = _only(comm, labels, rows["K"], rows["M"])
    # the cut may go through a node, or take nodes of solids
    parted = labels[only.behind & ~only.nodes & (labels % STRIDE < TRANSLATIONS)]  # of the node at the cut
    if comm.allreduce(len(parted)):
        raise _lacks(comm, parts, "M", "K", 1, parted)
    silent = np.unique(labels[only.nodes if parts.all_massive else only.nodes & only.behind] // STRIDE)
    massive = np.unique(labels[rows["M"].touched] // STRIDE)
    for lost, there in zip(*(_of_solids(comm, parts.elements, nodes) for nodes in (silent, massive)), strict=True):
        if comm.allreduce(len(there)) and (count := comm.allreduce(len(lost))):
            raise _lacks(comm, parts, "M", "K", count, lost * STRIDE)
    # some other nodes may be without mass, but not many at the end
    behind = np.unique(labels[only.nodes & only.behind] // STRIDE)
    behind = np.setdiff1d(behind, np.concatenate(_of_solids(comm, parts.elements, behind)))
    count, total = (comm.allreduce(len(some)) for some in (behind, np.unique(labels // STRIDE)))
    if count > MANY * total:
        raise _lacks(comm, parts, "M", "K", count, behind * STRIDE)
    if not count:
        return []
    return [f"{parts.files['M']}: the last {count} nodes of K have no mass, which is so, or the file is cut off"]


class _Only(NamedTuple):
    """Rows that one matrix has and the other has not: those of `nodes` of which the other has no row, and those
    `behind` the last row of the other."""

    nodes: np.ndarray
    behind: np.ndarray


def _only(comm, labels, there: Rows, lacking: Rows) -> _Only:
    mine = there.touched & ~lacking.touched
    known, _ = number_over_ranks(comm, np.unique(labels[lacking.touched] // STRIDE))
    known_there, _ = look_up(comm, known, [], labels[mine] // STRIDE)
    nodes = mine.copy()
    nodes[mine] = ~known_there
    last = max(comm.allgather(int(labels[lacking.touched].max(initial=-1))))
    return _Only(nodes, mine & (labels > last))


def _of_solids(comm, elements, nodes):
    """Return the nodes that are corners of solids and shells, and those in the middle of edges."""
    inside_and_corners = []
    for corners in (False, True):
        nodes_of_kinds = [table[:, : NODES[kind.rstrip("0123456789")] if corners else None].ravel()
                 for kind, table in elements.items() if kind not in THIN]  # fmt: skip
        known, _ = number_over_ranks(comm, np.unique(np.concatenate([np.zeros(0, np.int64), *nodes_of_kinds])))
        inside_and_corners.append(look_up(comm, known, [], nodes)[0])
    inside, corner = inside_and_corners
    return nodes[corner], nodes[inside & ~corner]


def _lacks(comm, parts, key, other, count, labels) -> InputError:
    first = min(comm.allgather(int(labels.min(initial=np.iinfo(np.int64).max)))) // STRIDE
    return InputError(
        f"{parts.files[key]}: found no {WHAT[key]} at {count} nodes that have {WHAT[other]}, the first is {first}; the "
        f"file is cut off, or the two are of different models: {WAY_OUT}"
    )
