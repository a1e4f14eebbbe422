"""Read files of scipy.sparse.save_npz (CSR, CSC or COO), each rank its share of rows, and whole arrays of other .npz.

The arrays are compressed in a zip archive: each rank unpacks them up to the end of its share, and keeps its share.
"""

import errno
import struct
import zipfile
import zlib
from contextlib import contextmanager
from math import prod

import numpy as np

from ...files.system_errors import damaged_file, reading_from
from ...parallel.failures import InputError, agreed
from ...parallel.memory import MB, node_mb
from ...parallel.shares import row_range
from ..base import Reader
from ..entries import Entries

# what zipfile makes of damage: also places before the file, methods that do not exist, and passwords
DAMAGES = (
    zipfile.BadZipFile, zlib.error, EOFError, OSError, NotImplementedError, RuntimeError, ValueError, struct.error,
)  # fmt: skip
NEEDED = {"coo": ("row", "col"), "csr": ("indptr", "indices"), "csc": ("indptr", "indices")}


def read_arrays(path, names) -> dict[str, np.ndarray]:
    """Return those of these arrays of numbers or texts that a .npz has. On this rank. Raises InputError."""
    arrays = {}
    with _opened(path) as (archive, there):
        for name in names:
            if f"{name}.npy" in there:
                with archive.open(f"{name}.npy") as file:
                    shape, fortran, dtype = _header(path, name, file)
                    array = np.frombuffer(_exactly(path, name, file, prod(shape) * dtype.itemsize), dtype)
                    if file.read(1):
                        raise InputError(f"{path}: the array '{name}' is longer than it says; the file is damaged")
                arrays[name] = array.reshape(shape, order="F" if fortran else "C")
    return arrays


def shapes_of(path) -> dict[str, tuple]:
    """Return the shapes of all arrays of a .npz by name. On this rank. Raises InputError."""
    shapes = {}
    with _opened(path) as (archive, names):
        for name in (name for name in archive.namelist() if name.endswith(".npy")):
            with archive.open(name) as file:  # the head alone
                shapes[name.removesuffix(".npy")], _, _ = _header(path, name, file, objects=True)
    return shapes


@contextmanager
def _opened(path):
    """An archive and the names in it, on this rank. Raises InputError, also for damage that is met later."""
    try:
        with reading_from(path), _no_place_outside(), zipfile.ZipFile(path) as archive:
            names = set(archive.namelist())
            if len(names) < len(archive.namelist()):
                raise damaged_file(path, "an array twice in the archive, expected each name once")
            yield archive, names
    except InputError:
        raise
    except DAMAGES as error:
        raise InputError(f"{path}: found a damaged zip archive ({error})") from error


@contextmanager
def _no_place_outside():
    try:
        yield
    except OSError as error:
        if error.errno == errno.EINVAL:
            raise zipfile.BadZipFile("it names a place outside of the file") from error
        raise


def _read(path, archive, names, comm):
    if not {"format.npy", "shape.npy", "data.npy"} <= names:
        raise InputError(
            f"{path}: found the arrays {sorted(names)}, expected those of scipy.sparse.save_npz, one matrix a file"
        )
    kind = _whole_array(path, archive, "format", 1)
    kind = kind.decode() if isinstance(kind, bytes) else str(kind)
    if kind not in NEEDED:
        raise InputError(f"{path}: found a sparse matrix of format '{kind[:20]}', expected csr, csc or coo; save "
                         "A.tocsr()")  # fmt: skip
    with archive.open("shape.npy") as file:
        _, _, dtype = _header(path, "shape", file)
    if dtype.kind not in "iu":
        raise InputError(f"{path}: found an array 'shape' of type {dtype}, expected whole numbers")
    shape = tuple(int(number) for number in np.atleast_1d(_whole_array(path, archive, "shape", 2)))
    if len(shape) != 2 or min(shape) < 0:
        raise InputError(f"{path}: found the shape {shape}, expected rows and columns")
    for name in NEEDED[kind]:
        if f"{name}.npy" not in names:
            raise InputError(f"{path}: found no array '{name}', which the format {kind} needs")
    # each rank reads its share: of the entries for coo, else of the lines, which need not be as long
    count = _length(path, archive, "data", "fiu")
    if kind == "coo":
        for name in NEEDED[kind]:
            _require(path, name, _length(path, archive, name, "iu"), count)
        low, high = row_range(comm, count)
        i, j = (_part(path, archive, name, low, high).astype(np.int64) for name in ("row", "col"))
    else:
        lines = shape[0] if kind == "csr" else shape[1]
        _require(path, "indices", _length(path, archive, "indices", "iu"), count)
        _require(path, "indptr", _length(path, archive, "indptr", "iu"), lines + 1)
        first, last = row_range(comm, lines)
        indptr = _part(path, archive, "indptr", first, last + 1).astype(np.int64)
        if (np.diff(indptr) < 0).any() or (first == 0 and indptr[0] != 0) or (last == lines and indptr[-1] != count):
            raise InputError(
                f"{path}: found an array 'indptr' that does not ascend from 0 to the number of entries ({count}); "
                "the file is damaged"
            )
        low, high = int(indptr[0]), int(indptr[-1])
        if not 0 <= low <= high <= count:
            raise damaged_file(path, f"an array 'indptr' beyond the {count} entries")
        # the pointers of its lines say which part of the indices is its own
        i = np.repeat(np.arange(first, last), np.diff(indptr))
        j = _part(path, archive, "indices", low, high).astype(np.int64)
        if kind == "csc":
            i, j = j, i
    for name, index, size in (("row", i, shape[0]), ("column", j, shape[1])):
        if len(index) and not 0 <= index.min() <= index.max() < size:
            wrong = index.max() if index.min() >= 0 else index.min()
            raise InputError(f"{path}: found the {name} {wrong} (from 0), expected less than {size}")
    return Entries(shape, i, j, _part(path, archive, "data", low, high).astype(float))


def _require(path, name, found, expected):
    if found != expected:
        raise InputError(f"{path}: found {found} numbers in the array '{name}', expected {expected}")


def _length(path, archive, name, kinds):
    """Return length of a one-dimensional array of numbers of some kinds of numpy."""
    with archive.open(f"{name}.npy") as file:
        shape, _, dtype = _header(path, name, file)
    if len(shape) != 1 or dtype.kind not in kinds:
        kind = "real" if "f" in kinds else "whole"
        raise InputError(
            f"{path}: found an array '{name}' of shape {shape} and type {dtype}, expected one row of {kind} numbers"
        )
    return shape[0]


def _header(path, name, file, objects=False):
    """Return shape, whether the first index runs fastest, and type of an array; `objects`: also of Python objects."""
    try:
        version = np.lib.format.read_magic(file)
        read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}[version]
        shape, fortran, dtype = read(file)
        if min(shape, default=0) < 0:
            raise ValueError(f"it has the shape {shape}")
    except (ValueError, KeyError) as error:
        raise InputError(f"{path}: the array '{name}' cannot be read ({error})") from error
    if dtype.hasobject and not objects:
        raise InputError(f"{path}: found Python objects in the array '{name}', expected numbers or texts")
    return shape, fortran, dtype


def _whole_array(path, archive, name, largest):
    """Return a scalar or an array of at most `largest` items."""
    with archive.open(f"{name}.npy") as file:
        shape, _, dtype = _header(path, name, file)
        size = prod(shape)
        if size > largest:
            raise InputError(f"{path}: found {size} items in the array '{name}', expected {largest}")
        array = np.frombuffer(_exactly(path, name, file, size * dtype.itemsize), dtype)
    return array.reshape(shape)[()]


def _part(path, archive, name, low, high):
    """Return elements low..high of a one-dimensional array."""
    with archive.open(f"{name}.npy") as file:
        _, _, dtype = _header(path, name, file)
        file.seek(file.tell() + low * dtype.itemsize)
        return np.frombuffer(_exactly(path, name, file, (high - low) * dtype.itemsize), dtype)


def _exactly(path, name, file, count):
    """Read so many bytes. Raises InputError if they do not fit: a small archive may claim any size."""
    if count > MB * (free := node_mb()):
        raise InputError(
            f"{path}: found {count / MB:.0f} MB in the array '{name}', and {free:.0f} MB are free; take more ranks on "
            "more nodes"
        )
    data = file.read(count)
    if len(data) != count:
        raise InputError(f"{path}: the array '{name}' is shorter than it says; the file is damaged")
    return data


class Npz(Reader):
    """Archives of scipy.sparse.save_npz, with a real matrix."""

    name, told_by, vague = "SciPy .npz", "a zip archive", True

    def begins(self, start):
        return start[:2] == b"PK"

    def read_matrix(self, path, comm):
        with agreed(comm), _opened(path) as (archive, names):
            return _read(path, archive, names, comm)
