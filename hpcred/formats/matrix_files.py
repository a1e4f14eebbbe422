"""Sparse matrices of other programs: a file enters, entries (row, column, value) leave, some on each rank.

Read are Matrix Market (also .gz), Abaqus' coordinate text, PETSc binary and SciPy .npz. No reader holds the whole
file on one rank; entries come in any order and may repeat.
"""

import gzip
import os
import struct
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..parallel.failures import InputError, agreed
from .text import numbers, pieces, require_file, triples

PETSC_MAT = 1211216  # class id at the start of a PETSc binary matrix


@dataclass
class Entries:
    """`rows`, `columns` (from 0) and `values` of the entries on this rank; `shape` of the whole matrix."""

    shape: tuple[int, int]
    rows: np.ndarray
    columns: np.ndarray
    values: np.ndarray


def read_entries(path, comm) -> Entries:
    """Read a matrix in any of the formats, told by its first bytes. Collective. Raises InputError."""
    with agreed(comm):
        require_file(path)
        with _open(path) as file:
            start = file.read(32)
        if start[:2] == b"PK":
            return_value = _read_npz(path, comm)
        elif start[:4] == struct.pack(">i", PETSC_MAT):
            return_value = _read_petsc(path, comm)
        elif start.lower().startswith(b"%%matrixmarket"):
            return_value = None
        elif start.strip()[:1].isdigit():
            return_value = _read_coordinates(path, comm)
        else:
            raise InputError(
                f"{path}: found a file that begins with {start[:12]!r}, expected Matrix Market, PETSc binary, "
                "SciPy .npz, or text lines of row, column, value"
            )
    if return_value is None:
        return _read_matrix_market(path, comm)
    if return_value.shape == (0, 0):
        size = comm.allreduce(int(max(return_value.rows.max(initial=-1), return_value.columns.max(initial=-1))),
                              op=max) + 1  # fmt: skip
        return_value.shape = (size, size)
    return return_value


def _open(path):
    return gzip.open(path, "rb") if Path(path).suffix == ".gz" else open(path, "rb")


def _joined(parts, columns):
    return np.concatenate(parts) if parts else np.zeros((0, columns))


def _read_coordinates(path, comm):
    """Lines of row, column, value with numbers from 1, both triangles: Abaqus' FORMAT=COORDINATE."""
    i, j, v = _triples(path, comm, 0)
    if (i < 0).any() or (j < 0).any():
        raise InputError(f"{path}: found row or column numbers that are not positive")
    return Entries((0, 0), i, j, v)


def _triples(path, comm, start):
    """Rows and columns from 0, and values, of the lines of this rank."""
    parts = [triples(text, path) for text in pieces(path, comm, start)] or [[np.zeros(0, np.int64)] * 2 + [np.zeros(0)]]
    i, j, v = (np.concatenate(items) for items in zip(*parts, strict=True))
    i -= 1
    j -= 1
    return i, j, v


def _read_matrix_market(path, comm):
    with agreed(comm):
        kind, symmetry, shape, count, start = _matrix_market_header(path)
        if kind == "array":
            table = _joined([numbers(text, 1, path) for text in pieces(path, comm, start)], 1)
        else:
            i, j, v = _triples(path, comm, start)
    total = comm.allreduce(len(table if kind == "array" else v))
    if total != count:
        raise InputError(f"{path}: found {total} entries, the header says {count}; the file is damaged")
    if kind == "array":
        place = (comm.exscan(len(table)) or 0) + np.arange(len(table))
        if Path(path).suffix == ".gz" and comm.size > 1:
            raise InputError(f"{path}: dense Matrix Market files must be unpacked before reading on several ranks")
        return Entries(shape, place % shape[0], place // shape[0], table[:, 0].copy())
    with agreed(comm):
        if len(i) and (i.min() < 0 or j.min() < 0 or i.max() >= shape[0] or j.max() >= shape[1]):
            raise InputError(f"{path}: found an entry outside of the {shape[0]} x {shape[1]} of the header")
    if symmetry != "general":
        off = i != j
        sign = -1.0 if symmetry == "skew-symmetric" else 1.0
        i, j, v = (np.concatenate(pair) for pair in ((i, j[off]), (j, i[off]), (v, sign * v[off])))
    return Entries(shape, i, j, v)


def _matrix_market_header(path):
    """Format, symmetry, shape, number of entries in the file and the byte where they begin."""
    with _open(path) as file:
        words = file.readline().decode(errors="replace").lower().split()
        if len(words) < 5 or words[2] not in ("coordinate", "array") or words[3] not in ("real", "integer"):
            raise InputError(
                f"{path}: found the header '{' '.join(words)}', expected a real Matrix Market matrix "
                "(coordinate or array)"
            )
        line = file.readline()
        while line.lstrip()[:1] == b"%" or (line and not line.strip()):
            line = file.readline()
        try:
            sizes = [int(word) for word in line.split()]
            shape = sizes[0], sizes[1]
            count = sizes[2] if words[2] == "coordinate" else shape[0] * shape[1]
        except (ValueError, IndexError) as error:
            raise InputError(f"{path}: found the size line {line.decode(errors='replace').strip()!r}, expected "
                             "rows, columns and entries") from error  # fmt: skip
        if words[2] == "array" and words[4] != "general":
            raise InputError(f"{path}: found a {words[4]} dense matrix, expected a general one")
        return words[2], words[4], shape, count, file.tell()


def _read_petsc(path, comm):
    """PETSc binary, real AIJ with 32-bit indices: each rank maps its share of rows."""
    size = os.path.getsize(path)
    _, rows, columns, count = np.fromfile(path, dtype=">i4", count=4)
    expected = 16 + 4 * int(rows) + 12 * int(count)
    if size != expected:
        hint = "a complex matrix" if size == expected + 8 * int(count) else "a damaged file or 64-bit indices"
        raise InputError(
            f"{path}: found {size} bytes, expected {expected} for a real sparse matrix of {rows} rows and "
            f"{count} entries; this looks like {hint}"
        )
    lengths = np.memmap(path, ">i4", "r", offset=16, shape=(int(rows),))
    low, high = rows * comm.rank // comm.size, rows * (comm.rank + 1) // comm.size
    before = int(lengths[:low].sum(dtype=np.int64))
    mine = np.asarray(lengths[low:high], dtype=np.int64)
    number = int(mine.sum())
    offset = 16 + 4 * int(rows)
    j = np.fromfile(path, ">i4", number, offset=offset + 4 * before).astype(np.int64)
    v = np.fromfile(path, ">f8", number, offset=offset + 4 * int(count) + 8 * before).astype(float)
    return Entries((int(rows), int(columns)), np.repeat(np.arange(low, high), mine), j, v)


def _read_npz(path, comm):
    """scipy.sparse.save_npz of CSR, CSC or COO: each rank unpacks the arrays and keeps its share."""
    with zipfile.ZipFile(path) as archive:
        names = set(archive.namelist())
        if not {"format.npy", "shape.npy", "data.npy"} <= names:
            raise InputError(f"{path}: found the arrays {sorted(names)}, expected those of scipy.sparse.save_npz")
        kind = _npy(archive, "format.npy")[()]
        kind = kind.decode() if isinstance(kind, bytes) else str(kind)
        shape = tuple(int(number) for number in _npy(archive, "shape.npy"))
        if kind not in ("csr", "csc", "coo"):
            raise InputError(f"{path}: found a sparse matrix of format '{kind}', expected csr, csc or coo")
        count = _npy_shape(archive, "data.npy")[0]
        low, high = count * comm.rank // comm.size, count * (comm.rank + 1) // comm.size
        values = _npy(archive, "data.npy", low, high)
        if values.dtype.kind == "c":
            raise InputError(f"{path}: found complex values, expected a real matrix")
        if kind == "coo":
            i, j = _npy(archive, "row.npy", low, high), _npy(archive, "col.npy", low, high)
        else:
            indptr = _npy(archive, "indptr.npy")
            i = np.searchsorted(indptr, np.arange(low, high), side="right") - 1
            j = _npy(archive, "indices.npy", low, high)
            if kind == "csc":
                i, j = j, i
    return Entries(shape, i.astype(np.int64), j.astype(np.int64), values.astype(float))


def _npy_shape(archive, name):
    with archive.open(name) as file:
        return _npy_header(file)[0]


def _npy_header(file):
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file)
    return shape, dtype


def _npy(archive, name, low=0, high=None):
    """Elements low..high of a one-dimensional array in the archive."""
    with archive.open(name) as file:
        shape, dtype = _npy_header(file)
        high = (shape[0] if shape else 1) if high is None else high
        file.seek(file.tell() + low * dtype.itemsize)
        array = np.frombuffer(file.read((high - low) * dtype.itemsize), dtype=dtype)
        return array.reshape(shape) if not shape else array
