"""Read matrices of Nastran's OUTPUT4, text or binary: the table of contents, or the entries of one.

A matrix has a header of columns, rows, form, type and name, then one record per column (number of the column, first row
or 0, number of words, words), and a last record of a column that does not exist. If the first row is 0, the words are
strings, each with the length and the first row of its numbers: two words, or (nonbigmat) both packed in one.
"""

import numpy as np

from ...files.text import first_bytes, refuse_packed
from ...parallel.failures import InputError, agreed
from ..entries import Entries, both_triangles, joined
from . import op4_binary as nastran_op4_binary
from . import op4_text as nastran_op4_text
from .names import single
from .op4_matrix import Op4Matrix

DIAGONAL, SYMMETRIC, IDENTITY = 3, 6, 8
TRIANGLES = (4, 5)


def begins(start: bytes) -> bool:
    """Test whether a file that starts so is one of OUTPUT4."""
    return bool(nastran_op4_binary.layout_of(start) or nastran_op4_text.HEADER.match(start.split(b"\n", 1)[0]))


def contents(path, comm) -> list[Op4Matrix]:
    """Return the matrices of a file, in order. Collective. Raises InputError."""
    with agreed(comm):
        start = first_bytes(path)
        refuse_packed(path, "Nastran OP4")
        layout = nastran_op4_binary.layout_of(start)
        if layout is None and not begins(start):
            raise InputError(f"{path}: found a file that begins with {start[:12]!r}, expected one of OUTPUT4")
    if layout is None:
        return nastran_op4_text.contents(path, comm)
    with agreed(comm):
        found = nastran_op4_binary.contents(path, *layout) if comm.rank == 0 else None
    return comm.bcast(found)


def read_matrix(path, comm, matrix: Op4Matrix) -> Entries:
    """Return the entries of a matrix that `contents` found. Collective. Raises InputError."""
    read_shares = nastran_op4_text.read if matrix.is_text else nastran_op4_binary.read
    return completed(path, comm, matrix, read_shares(path, comm, matrix))


def completed(path, comm, matrix: Op4Matrix, parts) -> Entries:
    """Return the entries of all shares (rows, columns, values) of this rank, with what the form leaves out.
    Collective."""
    if matrix.form in TRIANGLES:
        raise InputError(
            f"{path}: found the matrix {matrix} as a triangular factor (form {matrix.form}), expected a whole matrix"
        )
    i, j, v = joined(parts, (np.int64, np.int64, float))
    del parts
    rows, columns = matrix.shape
    if matrix.form == DIAGONAL and columns == 1 < rows:  # the diagonal as one column
        return Entries((rows, rows), i, i.copy(), v)
    if matrix.form == IDENTITY and not comm.allreduce(len(v)) and rows == columns:
        mine = np.arange(rows * comm.rank // comm.size, rows * (comm.rank + 1) // comm.size)
        return Entries(matrix.shape, mine, mine.copy(), np.ones(len(mine)))
    if matrix.form == SYMMETRIC:
        below, above = (any(comm.allgather(bool(part.any()))) for part in (i > j, i < j))
        if below != above:
            i, j, v = both_triangles(i, j, v)
    return Entries(matrix.shape, i, j, v)


def read(path, comm, key="K", variables=None) -> Entries:
    """Read one matrix of a file, for -K and the like; `variables`: names by key. Collective. Raises InputError."""
    found = contents(path, comm)
    return read_matrix(path, comm, found[single(path, [item.name for item in found], key, variables)])
