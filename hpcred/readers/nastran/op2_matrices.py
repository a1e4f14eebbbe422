"""Read matrices (KGG, MGG, ...) of a file of Nastran's OUTPUT2.

A column is a sequence of records, each with the number of its first row and the values from there on; keys between
them announce their lengths. Rank 0 follows the sequence once, and each rank decodes its share of whole columns.
"""

from dataclasses import dataclass

import numpy as np

from ...files.system_errors import damaged_file, mapped
from ...parallel.failures import InputError, agreed
from .op2 import columns_of, walk
from .op4_matrix import COMPLEX, DOUBLE, Op4Matrix, matrix_of, real_values


@dataclass(frozen=True)
class Op2Matrix(Op4Matrix):
    """As Op4Matrix; `columns` (shares + 1,): so many columns lie in front of each of `starts`."""

    columns: tuple[int, ...] = ()


def contents(path) -> list[Op2Matrix]:
    """Return the matrices of a file, from one walk along its records on one rank."""
    return [_matrix(path, block) for block in walk(path) if block.columns]


def _matrix(path, block):
    """Return the Op2Matrix of a block with columns. Raises InputError."""
    _, columns, rows, form, kind, *_ = block.trailer
    starts, before = zip(*block.columns, strict=True)
    if before[-1] != columns:
        raise damaged_file(path, f"{before[-1]} columns of the matrix {block.name}, expected {columns}")
    place = {"starts": starts, "layout": (block.order, block.size), "is_text": False}
    matrix = matrix_of(path, f"byte {starts[0]}", (columns, rows, form, kind), block.name.encode("latin-1"), **place)
    return Op2Matrix(**vars(matrix) | {"columns": before})


def read(path, comm, matrix: Op2Matrix) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return rows and columns (from 0) and values of the shares of this rank. Collective. Raises InputError."""
    shares = len(matrix.starts) - 1
    low, high = shares * comm.rank // comm.size, shares * (comm.rank + 1) // comm.size
    with agreed(comm), mapped(path) as data:
        return [_decode(path, data, matrix, k) for k in range(low, high)]


def _decode(path, data, matrix, share):
    """Return rows and columns (from 0) and values of a share of columns."""
    order, size = matrix.layout
    number = size if size == 8 else 8 if matrix.kind in DOUBLE else 4  # bytes
    width = number * (2 if matrix.kind in COMPLEX else 1)
    rows, values, counts, columns = [], [], [], []
    for column, strings in columns_of(path, data, matrix, share):
        last = 0
        for place, count in strings:
            first = int(np.frombuffer(data, f"{order}i{size}", 1, place)[0])
            length, rest = divmod(count - size, width)
            if rest or length < 1 or first <= last or first + length - 1 > matrix.shape[0]:
                raise InputError(
                    f"{path}: found {count} bytes for the row {first} of column {column + 1} of the matrix {matrix}, "
                    "expected strings of numbers that ascend in their column; the file is damaged"
                )
            last = first + length - 1
            rows.append(first - 1)
            columns.append(column)
            counts.append(length)
            values.append(np.array(np.frombuffer(data, f"{order}f{number}", (count - size) // number, place + size)))
    counts = np.array(counts, np.int64)
    values = real_values(path, matrix, np.concatenate([np.zeros(0), *values]))
    i = np.repeat(np.array(rows, np.int64) - (np.cumsum(counts) - counts), counts) + np.arange(len(values))
    j = np.repeat(np.array(columns, np.int64), counts)
    there = values != 0
    return i[there], j[there], values[there]
