"""Check the rows, columns and matrices that a model is made of. Errors are InputErrors."""

from __future__ import annotations

import numpy as np

from ..fe.dofs import DIRECTIONS
from ..parallel.declared import declared
from ..parallel.failures import InputError, agreed


def check_rows(indptr, indices, values, first, name, dofs):
    """Refuse rows that no mechanical model has: those of this rank, from the global row `first` on; `dofs`: their
    labels, or None, for messages."""
    check_finite(indptr, values, first, name, dofs)
    below = np.flatnonzero(values["M"] < 0)
    negative = below[indices[below] == _row_of_entry(indptr, below) + first]
    if negative.size:
        sign = " (no other one is positive: -M?)" if negative.size == len(indptr) - 1 else ""
        raise InputError(
            f"{name}: the mass matrix has {negative.size} negative diagonal entries{sign}, the first at "
            f"{row_name(_row_of_entry(indptr, negative[0]), first, dofs)}: {values['M'][negative[0]]:g}; expected none"
        )
    touched = np.diff(indptr) > 0
    stored = (values["K"] != 0) | (values["M"] != 0)
    touched[touched] = np.logical_or.reduceat(stored, indptr[:-1][touched]) if len(stored) else False
    empty = np.flatnonzero(~touched)
    if empty.size:
        raise InputError(
            f"{name}: {empty.size} dofs have no entry in K nor in M, the first is {row_name(empty[0], first, dofs)}; "
            "no element touches them: remove them from the model"
        )


def check_columns(indptr, indices, size, first, name, dofs):
    """Refuse columns that the matrices do not have, or that a row has twice; the arguments are as for check_rows."""
    if len(indices) and not 0 <= indices.min() <= indices.max() < size:
        wrong = indices.max() if indices.min() >= 0 else indices.min()
        raise InputError(f"{name}: found the column {wrong} (from 0), expected 0 to {size - 1}")
    descends = indices[1:] <= indices[:-1]
    ends = indptr[1:-1] - 1  # the last entries of rows, but for the last row
    descends[ends[(ends >= 0) & (ends < len(descends))]] = False
    if not descends.any():
        return
    row = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
    place = np.sort(row * size + indices)
    twice = place[1:][place[1:] == place[:-1]]
    if twice.size:
        row, column = divmod(int(twice[0]), size)
        raise InputError(
            f"{name}: found the column {column} (from 0) twice in the row of {row_name(row, first, dofs)}, expected "
            "each column once in a row; sum_duplicates of SciPy adds them up"
        )


def check_finite(indptr, values, first, name, dofs):
    """Refuse NaN and Inf in the `values` (nonzeros,) of matrices by name; the rest as for check_rows."""
    for key, data in values.items():
        bad = np.flatnonzero(~np.isfinite(data))
        if bad.size:
            raise InputError(
                f"{name}: matrix {key} has entries that are NaN or Inf, "
                f"the first in the row of {row_name(_row_of_entry(indptr, bad[0]), first, dofs)}"
            )


def _row_of_entry(indptr, place):
    return np.searchsorted(indptr, place, side="right") - 1


def row_name(row, first, dofs) -> str:
    """ "dof 115 (node 20, z)" for a row (from 0) of this rank."""
    if dofs is None:
        return f"dof {first + row + 1}"
    return f"dof {first + row + 1} (node {dofs.node[row]}, {DIRECTIONS[dofs.direction[row]]})"


def named_columns(comm, rows, local, names, what):
    """Return the rows of B or C^T of this rank (rows, columns), and the names of the columns; None and () for None.

    `what` they are, such as "model: inputs". Collective. Raises InputError.
    """
    if local is None:
        return None, ()
    with agreed(comm):
        local = real_columns(local, rows, what)
    widths = comm.allgather(local.shape[1])
    if len(set(widths)) > 1:
        raise InputError(f"{what}: found {min(widths)} to {max(widths)} columns on the ranks, expected as many on each")
    key = what.rpartition(" ")[2].removesuffix("s")
    names = tuple(names) or tuple(f"{key} {k + 1}" for k in range(widths[0]))
    names = declared(f"{what}: names", names, tuple[str, ...])
    if len(names) != widths[0]:
        raise InputError(f"{what}: found {len(names)} names for {widths[0]} columns, expected one for each")
    return local, names


def real_columns(columns, rows, what) -> np.ndarray:
    """Return columns (rows, c) of finite real numbers, from an array, lists or a SciPy sparse matrix. Raises
    InputError."""
    columns = np.asarray(columns.toarray() if hasattr(columns, "toarray") else columns)
    if columns.ndim != 2 or len(columns) != rows or columns.dtype.kind not in "iuf":
        raise InputError(
            f"{what}: found an array {columns.shape} of {columns.dtype}, expected real numbers ({rows}, columns)"
        )
    if not np.isfinite(columns).all():
        raise InputError(f"{what}: found NaN or Inf in column {np.argwhere(~np.isfinite(columns))[0, 1] + 1}")
    return columns.astype(float)


def real_values(values, what) -> np.ndarray:
    """Return the real part of numbers whose imaginary part is zero. Raises InputError."""
    if np.iscomplexobj(values) and values.imag.any():
        raise InputError(
            f"{what}: found {np.count_nonzero(values.imag)} entries with imaginary parts, expected real ones"
        )
    return values.real


def coordinates(key, mat):
    """Return rows, columns, real values and size of a SciPy sparse or a dense matrix. Raises InputError."""
    mat = mat if hasattr(mat, "tocoo") else np.asarray(mat)
    if mat.ndim != 2 or mat.shape[0] != mat.shape[1] or mat.dtype.kind not in "biufc":
        raise InputError(f"{key}: found {mat.shape} of {mat.dtype}, expected a square matrix of numbers")
    if hasattr(mat, "tocoo"):
        mat = mat.tocoo()
        i, j, v = mat.row.astype(np.int64), mat.col.astype(np.int64), mat.data
    else:
        i, j = np.nonzero(mat)
        v = mat[i, j]
    return i, j, real_values(v, key).astype(float), mat.shape[0]
