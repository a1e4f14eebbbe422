"""Read binary files of OUTPUT4: all matrices, or the entries of one.

A file is a sequence of Fortran records without a table of contents: rank 0 follows it once, and each rank decodes its
share of the bytes.
"""

import os
import struct

import numpy as np

from ...files.system_errors import damaged_file, mapped, read_bytes, read_numbers
from ...parallel.failures import InputError, agreed
from ...parallel.shares import row_range
from .op4_matrix import COMPLEX, DOUBLE, SMALL, Op4Matrix, matrix_of, real_values

SHARE = 2**22  # bytes of a file decoded at a time


def layout_of(start: bytes) -> tuple[str, int] | None:
    """Return byte order and bytes of a whole number of a file that starts so, or None."""
    for order in "<>":
        for size in (4, 8):
            length = 6 * size
            if len(start) >= length + 8 and struct.unpack_from(order + "i", start)[0] == length:
                header = struct.unpack_from(order + ("4i" if size == 4 else "4q"), start, 4)
                closing = struct.unpack_from(order + "i", start, 4 + length)[0]
                if closing == length and header[0] >= 0 and 0 < header[2] < 100 and header[3] in (1, 2, 3, 4):
                    return order, size
    return None


def contents(path, order: str, size: int) -> list[Op4Matrix]:
    """Return the matrices of a file, from one walk along its records on one rank."""
    matrices, end = [], os.path.getsize(path)
    head = struct.Struct(order + ("ii" if size == 4 else "iq")).unpack_from
    whole = 4 + 6 * size + 4
    with mapped(path) as data:
        at = 0
        while at < end:
            if end - at < whole or head(data, at)[0] != 6 * size:
                raise InputError(
                    f"{path}: found no header of a matrix at byte {at} of {end}, behind "
                    f"{matrices[-1].name if matrices else 'the start'}; the file is damaged or cut off"
                )
            # the header
            numbers = struct.unpack_from(order + ("4i" if size == 4 else "4q"), data, at + 4)
            name = data[at + 4 + 4 * size : at + 4 + 6 * size]
            if size == 8 and not (name[4:8] + name[12:]).strip():
                name = name[:4] + name[8:12]  # four letters a word
            columns = numbers[0]
            at += whole
            # records of columns, up to that of a column behind the last
            starts, column, mark = [at], 0, at + SHARE
            while column <= columns:
                if at + 12 > end:
                    raise InputError(
                        f"{path}: found the end of the file in a matrix after column {column} of {columns}; the file "
                        "is cut off"
                    )
                length, number = head(data, at)
                if length < 3 * size or number <= column or number > columns + 1:
                    raise InputError(
                        f"{path}: found a record of {length} bytes for column {number} behind column {column} of "
                        f"{columns} at byte {at}; the file is damaged"
                    )
                column = number
                if at >= mark or column > columns:
                    starts.append(at)
                    mark = at + SHARE
                at += length + 8
            if at > end:
                raise damaged_file(path, f"{end} bytes, expected {at}", "cut off")
            if struct.unpack_from(order + "i", data, at - 4)[0] != length:
                raise damaged_file(path, f"no end of the record at byte {at - 4}")
            place = {"starts": tuple(starts), "layout": (order, size), "is_text": False}
            matrices.append(matrix_of(path, f"byte {starts[0] - whole}", numbers, name, **place))
    return matrices


def read(path, comm, matrix: Op4Matrix) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return rows and columns (from 0) and values of the shares of this rank. Collective. Raises InputError."""
    starts = matrix.starts
    with agreed(comm):
        return [_decode(path, matrix, starts[k], starts[k + 1]) for k in range(*row_range(comm, len(starts) - 1))]


class _Words:
    """The 4-byte words of a share of a file, and whole numbers at some of them."""

    def __init__(self, path, order, size, low, high):
        self.raw = read_numbers(path, order + "u4", (high - low) // 4, offset=low)
        self.order, self.size = order, size

    def markers(self, at):
        return self.raw[at].view(self.order + "i4").astype(np.int64)

    def integers(self, at):
        if self.size == 4:
            return self.markers(at)
        return self.raw[at[:, None] + np.arange(2)].reshape(-1).view(self.order + "i8").astype(np.int64)


def _decode(path, matrix, low, high):
    """Return rows and columns (from 0) and values of the columns in the bytes low..high."""
    order, size = matrix.layout
    rows, columns = matrix.shape

    def damaged(what):
        return damaged_file(path, f"{what} in the matrix {matrix} between the bytes {low} and {high}")

    # records: column, first row, number of words
    begin = _records(path, order, low, high)
    words = _Words(path, order, size, low, high)
    length = words.markers(begin)
    step = size // 4
    head = begin + 1
    finish = head + length // 4
    if (length % 4).any() or (words.markers(finish) != length).any():
        raise damaged("a record without its end")
    column, first, count = (words.integers(head + k * step) for k in range(3))
    if (count * size != length - 3 * size).any():
        raise damaged("a column whose number of words is not that of its record")
    dense = first > 0
    if (first < 0).any() or (column < 1).any() or (column > columns).any():
        raise damaged("a column or row that does not exist")
    # strings of numbers, of a whole column or as their headers say, in the order of the file
    number = size if size == 8 else 8 if matrix.kind in DOUBLE else 4  # bytes
    width = number // 4 * (2 if matrix.kind in COMPLEX else 1)  # words of 4 bytes of an entry
    at = head[dense] + 3 * step
    strings = [(column[dense], first[dense], at, finish[dense])]
    strings += _strings(words, matrix.big, column[~dense], head[~dense] + 3 * step, finish[~dense], damaged)
    column, row, at, stop = (np.concatenate(arrays) for arrays in zip(*strings, strict=True))
    place = np.argsort(at)
    column, row, at, stop = column[place], row[place], at[place], stop[place]
    entries = (stop - at) // width
    if ((stop - at) % width).any() or (row < 1).any() or (row + entries - 1 > rows).any():
        raise damaged("a string of numbers that does not fit its column")
    if dense.any() and not dense.all():
        raise damaged("whole columns beside columns of strings")
    if ((column[1:] == column[:-1]) & (row[1:] < (row + entries)[:-1])).any():
        raise damaged("strings of numbers that do not ascend in their column")
    # the words of numbers are those in strings
    change = np.zeros(len(words.raw) + 1, np.int8)
    np.add.at(change, at, 1)
    np.add.at(change, stop, -1)
    values = words.raw[np.cumsum(change, dtype=np.int8)[:-1].view(bool)].view(f"{order}f{number}").astype(float)
    values = real_values(path, matrix, values)
    i = np.repeat(row - 1 - (np.cumsum(entries) - entries), entries) + np.arange(len(values))
    j = np.repeat(column - 1, entries)
    if dense.any():
        kept = values != 0
        i, j, values = i[kept], j[kept], values[kept]
    return i, j, values


def _records(path, order, low, high):
    """Return the words, counted from low, at which the records of the bytes low..high begin."""
    unpack = struct.Struct(order + "i").unpack_from
    data = read_bytes(path, low, high)
    records, at, end = [], 0, high - low
    while at < end:
        records.append(at)
        at += unpack(data, at)[0] + 8
    if at != end or len(data) < end:
        raise damaged_file(path, f"records that overlap between the bytes {low} and {high}")
    return np.array(records, dtype=np.int64) // 4


def _strings(words, big, column, at, end, damaged):
    """Return (column, row, first word, last word) of strings: the k-th of all columns in one step."""
    step = words.size // 4
    strings = []
    while len(at):
        if big:
            length, row = words.integers(at) - 1, words.integers(np.minimum(at + step, len(words.raw) - step))
            at = at + 2 * step
        else:
            length, row = np.divmod(words.integers(at), SMALL)
            length, at = length - 1, at + step
        stop = at + length * step
        if (length < 1).any() or (stop > end).any():
            raise damaged("a string of numbers that goes beyond its column")
        strings.append((column, row, at, stop))
        unfinished = stop < end
        column, at, end = column[unfinished], stop[unfinished], end[unfinished]
    return strings
