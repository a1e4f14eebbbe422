"""HDF5 with all ranks: files that appear whole or not at all, rows written and read by the rank that has them."""

import json
import os
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from ..parallel.failures import InputError, Owned, agreed, unfinished
from .outputs import check_kind, check_writable, kind_of

SLAB = 2**26  # numbers written in one call, well below the 2 GiB that MPI-IO takes


class Writer:
    """A new HDF5 file, written by all ranks. Every method is collective, with the same small values everywhere.

    With an h5py without MPI the ranks write in turn.
    """

    def __init__(self, path, comm):
        self._path, self._comm = str(path), comm
        self._parallel = comm.size > 1 and h5py.get_config().mpi
        self._file = None
        if self._parallel:
            self._file = h5py.File(self._path, "w", driver="mpio", comm=comm)
        elif comm.size == 1:
            self._file = h5py.File(self._path, "w")
        elif comm.rank == 0:
            h5py.File(self._path, "w").close()
        comm.Barrier()

    def close(self):
        if self._file is not None:
            self._file.close()

    def _turns(self, ranks):
        """The open file, or in turn for the ranks named where only one process can have it open."""
        if self._file is not None:
            yield self._file
            return
        for rank in ranks:
            if rank == self._comm.rank:
                with h5py.File(self._path, "a") as file:
                    yield file
            self._comm.Barrier()

    def attribute(self, name, value):
        for file in self._turns([0]):
            file.attrs[name] = value

    def small(self, name, value):
        """A dataset from rank 0: an array, a text, a list of texts, or a dict (as JSON)."""
        value = self._comm.bcast(value)
        if isinstance(value, dict):
            value = json.dumps(value)
        if isinstance(value, str):
            value = np.array(value.encode() or b" ")
        elif isinstance(value, list) and (not value or isinstance(value[0], str)):
            value = np.array([item.encode() for item in value], dtype="S") if value else np.zeros(0, "S1")
        value = np.asarray(value)
        for file in self._turns([0]):
            dataset = file.create_dataset(name, value.shape, value.dtype, track_times=False)
            if self._comm.rank == 0:
                dataset[...] = value

    def rows(self, name, local, axis=0):
        """A dataset whose `axis` is distributed over the ranks in order; `local` is the part of this rank."""
        counts = self._comm.allgather(local.shape[axis])
        start = sum(counts[: self._comm.rank])
        shape = list(local.shape)
        shape[axis] = sum(counts)
        for file in self._turns(range(self._comm.size)):
            dataset = file[name] if name in file else file.create_dataset(
                name, shape=tuple(shape), dtype=local.dtype, track_times=False
            )  # fmt: skip
            step = max(1, SLAB * local.shape[axis] // max(local.size, 1))
            for low in range(0, local.shape[axis], step):
                high = min(low + step, local.shape[axis])
                place = [slice(None)] * len(shape)
                place[axis] = slice(start + low, start + high)
                part = [slice(None)] * len(shape)
                part[axis] = slice(low, high)
                dataset[tuple(place)] = local[tuple(part)]


@contextmanager
def atomic_output(path, comm):
    """A temporary name beside `path` that becomes `path` when the block ends well; links are followed. Collective.

    Raises InputError before the block where the file cannot be written, and after it where what is there is of another
    kind than what was written.
    """
    check_writable(path, comm)
    path = Path(os.path.realpath(path))
    temporary = path.with_name(f"{path.name}.tmp-{comm.bcast(os.getpid())}")
    unfinished.add(temporary)
    try:
        with Owned(comm):
            yield temporary
        comm.Barrier()
        with agreed(comm):
            if comm.rank == 0:
                if path.exists():
                    check_kind(path, kind_of(temporary))
                with open(temporary, "rb") as file:
                    os.fsync(file.fileno())
                os.replace(temporary, path)
    finally:
        unfinished.discard(temporary)
        if comm.rank == 0:
            temporary.unlink(missing_ok=True)


@contextmanager
def writing(path, comm):
    """A Writer on a file that appears under its name when the block ends well. Collective."""
    with atomic_output(path, comm) as temporary, Owned(comm) as owned:
        yield owned.owns(Writer(temporary, comm))


@contextmanager
def reading(path, kind: str, version: int | None = None):
    """The file opened for reading by this rank; `kind` and `version` are its attributes. Raises InputError."""
    path = Path(path)
    if not os.path.isfile(path):
        raise InputError(f"{path}: no such file")
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise InputError(f"{path}: not a readable HDF5 file ({error})") from error
    with file:
        found = file.attrs.get("format", "none")
        if found != kind:
            raise InputError(f"{path}: found an HDF5 file of format '{found}', expected '{kind}'")
        number = int(file.attrs.get("version", 0))
        if version is not None and number != version:
            newer, older = "a newer hpcred wrote it: update this one", "an older hpcred wrote it: make it again"
            what = newer if number > version else older
            raise InputError(f"{path}: found version {number} of the format '{kind}', expected {version}; {what}")
        yield file


def kind_of_file(path) -> str | None:
    """The format that an HDF5 file of hpcred names, or None. Raises nothing."""
    try:
        with h5py.File(path, "r") as file:
            return str(file.attrs.get("format", "")) or None
    except OSError:
        return None


def texts(dataset) -> list[str]:
    """A list of texts from a dataset of fixed-length bytes."""
    return [item.decode() for item in dataset[...]]
