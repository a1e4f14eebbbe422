"""Files of other programs enter, a SecondOrderModel leaves."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..formats.matrix_files import Entries, read_entries
from ..formats.nodes import read_dofs, read_elements
from ..linalg.csr import compress
from ..model.second_order_model import SecondOrderModel, row_range
from ..parallel.exchange import exchange
from ..parallel.failures import InputError, agreed
from ..parallel.petsc import MPI

ABAQUS = {"K": ("_STIF1", "_STIF2"), "M": ("_MASS1", "_MASS2"), "D": ("_DMPV1", "_DMPV2")}


@dataclass(frozen=True)
class Source:
    """The files of a model: K and M, perhaps D, B (n, p), C (r, n), `nodes` and `dofs` (see nodes.read_dofs)."""

    K: str
    M: str
    D: str | None = None
    B: str | None = None
    C: str | None = None
    nodes: str | None = None
    dofs: str | None = None


def abaqus_source(path) -> Source:
    """The matrices that Abaqus wrote beside an input file: block.inp with block_STIF1.mtx and block_MASS1.mtx."""
    path = Path(path)
    found = {}
    for key, endings in ABAQUS.items():
        for ending in endings:
            for suffix in (".mtx", ".mtx.gz"):
                file = path.with_name(path.stem + ending + suffix)
                if file.is_file():
                    found.setdefault(key, str(file))
    for key in ("K", "M"):
        if key not in found:
            expected = path.with_name(path.stem + ABAQUS[key][0] + ".mtx")
            raise InputError(f"{path}: found no matrix {key} beside it, expected {expected}")
    return Source(**found, nodes=str(path))


def convert(source: Source, comm=MPI.COMM_WORLD, name="model") -> SecondOrderModel:
    """Read the files on all ranks and assemble the model. Collective. Raises InputError."""
    given = {key: getattr(source, key) for key in ("K", "M", "D") if getattr(source, key)}
    entries = {key: read_entries(path, comm) for key, path in given.items()}
    size = entries["K"].shape[0]
    for key, item in entries.items():
        if item.shape[0] != item.shape[1]:
            raise InputError(f"{given[key]}: found {item.shape[0]} x {item.shape[1]}, expected a square matrix")
        if item.shape[0] != size:
            raise InputError(
                f"{given[key]}: found {item.shape[0]} rows, but K ({given['K']}) has {size}; all matrices need "
                "the same size"
            )
    if comm.size > size:
        raise InputError(f"{name}: {size} rows cannot be distributed over {comm.size} ranks; use fewer ranks")
    ranges = comm.allgather(row_range(comm, size, 6 if size % 6 == 0 else 3 if size % 3 == 0 else 1))
    starts = np.array([first for first, _ in ranges])
    first, last = ranges[comm.rank]
    if "D" in entries:
        entries["D"] = with_transposed_pattern(entries["D"])
    mine = {key: _owned(comm, starts, item) for key, item in entries.items()}
    del entries
    with agreed(comm):
        indptr, indices, values = compress(mine, first, last, size)
    del mine
    inputs = read_columns(comm, starts, size, source.B) if source.B else None
    outputs = read_columns(comm, starts, size, source.C, transposed=True) if source.C else None
    dofs = read_dofs(comm, size, starts, source.nodes, source.dofs, name) if source.nodes else None
    model = SecondOrderModel.from_csr(
        comm, size, indptr, indices, values, inputs, outputs, dofs,
        column_names(source.B, inputs), column_names(source.C, outputs), name,
    )  # fmt: skip
    if source.nodes and Path(source.nodes).suffix.lower() == ".inp":
        model.elements = read_elements(comm, source.nodes)
    return model


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
