"""Read the matrices of terms, which have the rows of a model that is there already."""

from __future__ import annotations

import numpy as np

from ..files.text import warnings_of_end
from ..linalg.blocks import dense_matrix
from ..linalg.csr import assembled
from ..model.second_order_model import SAY_SO
from ..model.units import scale_to_si, units_of
from ..parallel.failures import InputError, agreed
from ..parallel.lookup import look_up
from ..parallel.petsc import PETSc
from .assembly import owned, read_columns
from .entries import Entries, LabelledEntries, label_name, label_of, refuse_one_side, require_sane
from .matrix_formats import matrix_reader, read_entries


def read_term_matrix(model, of: str, path, variable=None, units=None) -> tuple[PETSc.Mat, list[str]]:
    """Return a matrix M, D or K (n, n), B (n, p) or C^T (n, r) in the layout of the model, and what looks wrong in its
    file.

    Labelled rows are found by node and direction, numbered ones are those of the model; entries of dofs that the model
    holds are left out. Collective. Raises InputError where the file does not fit.
    """
    comm = model.comm
    reader = matrix_reader(path, comm)
    with agreed(comm):
        if reader.named and variable is None:
            raise InputError(f"{path}: found a file of named matrices; name that of the term, such as variable = 'G'")
        if variable is not None and not reader.named:
            raise InputError(f"{path}: found the name '{variable}' of a variable for {reader.name}, which has none")
        # what the file is, and its units
        converted = _units_of_term(model, of, path, units)
        remarks = warnings_of_end(path) if reader.line_ended else []
    variables = {of: variable}
    # columns of inputs and rows of outputs are dense
    if of in ("B", "C"):
        local = read_columns(comm, model.row_starts, model.size, path, of == "C", variables)
        return dense_matrix(model.K, local), remarks
    entries = read_entries(path, comm, of, variables, reader)
    with agreed(comm):
        require_sane(entries.values, f"{path}: found", "real")
    # entries in the numbering of the model
    if isinstance(entries, LabelledEntries):
        entries = _numbered(model, entries, path)
    elif entries.shape != (model.size, model.size):
        raise InputError(
            f"{path}: found {entries.shape[0]} x {entries.shape[1]}, expected {model.size} x {model.size}, as the "
            f"matrices of {model.name} have"
        )
    if not (of == "K" and model.may_be_unsymmetric(of)):
        hint = f"; {SAY_SO}, as of a force that acts one way" if of == "K" else ""
        refuse_one_side(comm, entries, path, "both triangles; write it whole, or as a symmetric or skew-symmetric "
                        f"Matrix Market file{hint}")  # fmt: skip
    # the matrix in the model's layout and units
    mat = assembled(model.K, *owned(comm, model.row_starts, entries))
    if converted is not None:
        scale_to_si(model, converted, of, mat)
    return mat, remarks


def _units_of_term(model, of, path, units):
    """Return the units that a matrix is to be converted from, None where it stays as it is."""
    if units is None and model.converted_from:
        raise InputError(
            f"{path}: {model.name} was converted to SI from {model.converted_from}; write units = \"SI\", or the units "
            "of this file, such as \"mm,t,s\""
        )  # fmt: skip
    system = units_of(units or "SI")
    if system == units_of("SI"):
        return None
    if of in ("B", "C") or not model.converted_from:
        expected = "columns in SI" if of in ("B", "C") else f"those of {model.name}, which was not converted"
        raise InputError(f"{path}: found units = '{units}' of a term of {of}, expected {expected}; leave them out")
    return system


def _numbered(model, entries: LabelledEntries, path) -> Entries:
    """Return entries by rows of the model; those of held dofs are left out. Collective."""
    if model.dofs is None:
        raise InputError(f"{path}: it names node and dof of its rows, but {model.name} has no nodes")
    labels = [label_of(dofs.node, dofs.direction) for dofs in (model.dofs, model.held) if dofs is not None]
    rows = [model.first_row + np.arange(model.local_rows), *(np.full(len(dofs), -1) for dofs in labels[1:])]
    wanted = np.concatenate([entries.rows, entries.columns])
    there, (row,) = look_up(model.comm, np.concatenate(labels), [np.concatenate(rows)], wanted)
    with agreed(model.comm):
        if not there.all():
            raise InputError(f"{path}: found {label_name(wanted[~there][0])}, a dof that {model.name} does not have")
    i, j = np.split(row, 2)
    kept = (i >= 0) & (j >= 0)
    return Entries((model.size, model.size), i[kept], j[kept], entries.values[kept])
