"""Read the header of a matrix in a file of OUTPUT4, and what its form says of its entries."""

from dataclasses import dataclass

import numpy as np

from ...parallel.failures import InputError
from ...parallel.shares import row_range
from ..entries import Entries, both_triangles, joined, sides

DIAGONAL, SYMMETRIC, IDENTITY = 3, 6, 8
TRIANGLES = (4, 5)
SMALL = 65536  # rows from which a string header needs two words
COMPLEX = (3, 4)
DOUBLE = (2, 4)


@dataclass(frozen=True)
class Op4Matrix:
    """The header of a matrix, and the position of its columns in the file.

    `form` and `kind` (1 and 2 real, 3 and 4 complex; even ones of two words a number) as OUTPUT4 numbers them. `starts`
    (shares + 1,): bytes where shares of whole columns begin and, last, where the closing record does; of a text, where
    the lines begin and end. `layout` of a text: width of a number; of a binary file: byte order and bytes of a
    whole number.
    """

    name: str
    shape: tuple[int, int]
    form: int
    kind: int
    big: bool
    starts: tuple[int, ...]
    layout: tuple
    is_text: bool

    def __str__(self):
        return f"{self.name} ({self.shape[0]} x {self.shape[1]})"


def matrix_of(path, where: str, numbers, name: bytes, **place) -> Op4Matrix:
    """Return the matrix of a header with columns, rows, form and type as `numbers`. Raises InputError."""
    columns, rows, form, kind = numbers
    text = name.replace(b"\0", b" ").decode("latin-1").strip()
    if columns < 0 or not 0 < form < 100 or kind not in (1, 2, 3, 4) or not text.isprintable():
        raise InputError(
            f"{path}: found the numbers {columns}, {rows}, {form}, {kind} and the name {text[:8]!r} at {where}, "
            "expected columns, rows, form, type (1 to 4) and name of a matrix; the file is damaged"
        )
    return Op4Matrix(text.upper(), (abs(rows), columns), form, kind, rows < 0 or rows >= SMALL, **place)


def real_values(path, matrix: Op4Matrix, numbers: np.ndarray) -> np.ndarray:
    """Return the values of numbers that may be complex. Raises InputError where they are."""
    if matrix.kind not in COMPLEX:
        return numbers
    if numbers[1::2].any():
        raise InputError(f"{path}: found the complex matrix {matrix}, expected a real one")
    return numbers[::2]


def completed(path, comm, matrix: Op4Matrix, triplets) -> Entries:
    """Return entries from shares (rows, columns, values) of this rank, with what the form leaves out. Collective."""
    if matrix.form in TRIANGLES:
        raise InputError(
            f"{path}: found the matrix {matrix} as a triangular factor (form {matrix.form}), expected a whole matrix"
        )
    i, j, v = joined(triplets, (np.int64, np.int64, float))
    del triplets
    rows, columns = matrix.shape
    if matrix.form == DIAGONAL and columns == 1 < rows:  # the diagonal as one column
        return Entries((rows, rows), i, i.copy(), v)
    if matrix.form == IDENTITY and not comm.allreduce(len(v)) and rows == columns:
        mine = np.arange(*row_range(comm, rows))
        return Entries(matrix.shape, mine, mine.copy(), np.ones(len(mine)))
    if matrix.form == SYMMETRIC:
        below, above = sides(comm, i, j)
        if below != above:
            i, j, v = both_triangles(i, j, v)
    return Entries(matrix.shape, i, j, v)
