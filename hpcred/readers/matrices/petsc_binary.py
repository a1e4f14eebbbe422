"""Read PETSc binary files, real AIJ with indices of 32 or 64 bits; each rank reads its share of rows."""

import os

import numpy as np

from ...files.system_errors import damaged_file, read_numbers
from ...files.text import first_bytes
from ...parallel.failures import InputError, agreed
from ...parallel.shares import row_range
from ..base import Reader
from ..entries import Entries

CLASS_ID = 1211216  # of a matrix
HEADER = 4  # whole numbers: that, rows, columns and entries


def _whole(start):
    """Return the type of the whole numbers of a file, that of PetscInt where PETSc wrote it, or None."""
    return next((kind for kind in (">i4", ">i8") if start.startswith(np.array(CLASS_ID, kind).tobytes())), None)


def read(path, comm) -> Entries:
    """Read a real sparse matrix. Collective. Raises InputError."""
    with agreed(comm):
        whole = _whole(first_bytes(path))
        width = np.dtype(whole).itemsize
        rows, columns, count = _header(path, whole, width)
        low, high = row_range(comm, rows)
        lengths = read_numbers(path, whole, high - low, offset=width * (HEADER + low)).astype(np.int64)
        if (lengths < 0).any():
            raise damaged_file(path, f"a row of {lengths.min()} entries")
        mine = int(lengths.sum())
    counts = comm.allgather(mine)
    if sum(counts) != count:
        raise damaged_file(path, f"rows of {sum(counts)} entries in all, the header says {count}")
    before = sum(counts[: comm.rank])
    with agreed(comm):
        start = width * (HEADER + rows)
        j = read_numbers(path, whole, mine, offset=start + width * before).astype(np.int64)
        v = read_numbers(path, ">f8", mine, offset=start + width * count + 8 * before).astype(float)
        if mine and not 0 <= j.min() <= j.max() < columns:
            wrong = j.max() if j.min() >= 0 else j.min()
            raise damaged_file(path, f"the column {wrong} (from 0), expected less than {columns}")
    return Entries((rows, columns), np.repeat(np.arange(low, high), lengths), j, v)


def _header(path, whole, width):
    size = os.path.getsize(path)
    if size < width * HEADER:
        raise damaged_file(path, f"{size} bytes, expected a PETSc matrix", "cut off")
    rows, columns, count = (int(number) for number in read_numbers(path, whole, HEADER)[1:])
    if count == -1:
        raise InputError(f"{path}: found a dense PETSc matrix, expected a sparse one (AIJ), or a dense one as Matrix "
                         "Market or MATLAB file")  # fmt: skip
    expected = width * (HEADER + rows + count) + 8 * count
    if min(rows, columns, count) < 0 or size != expected:
        hints = {expected + 8 * count: "a complex matrix", expected - 4 * count: "a matrix of single precision"}
        hint = hints.get(size, "a damaged file, or one of more than a matrix")
        raise InputError(
            f"{path}: found {size} bytes, expected {expected} for a real sparse matrix of {rows} rows and "
            f"{count} entries; this looks like {hint}"
        )
    return rows, columns, count


class PetscBinary(Reader):
    """Matrices of PETSc's MatView."""

    name, told_by = "PETSc binary", "the number 1211216"
    read_matrix = staticmethod(read)

    def begins(self, start):
        return _whole(start) is not None
