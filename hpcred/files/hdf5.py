"""HDF5 with all ranks: files that appear whole or not at all, rows written and read by the rank that has them."""

import json
import os
from contextlib import contextmanager, suppress
from io import FileIO
from math import prod
from pathlib import Path

import h5py
import numpy as np

from ..parallel.failures import ComputationError, InputError, Owned, agreed, common_to, settle, unfinished
from .checked import CHECKSUM, SUMS, CheckedFile, header_checksum
from .checksums import sums_of, sums_of_parts, tag_of
from .locks import HOST, begin, lock, lock_name, temporary_name, unlock
from .opened_hdf5 import Damaged, damaged, guarded, opened_hdf5, require_whole
from .outputs import HDF5, check_kept, check_kind, check_writable, kind_of
from .room import NotWritten, Room
from .seal import seal
from .system_errors import writing_to
from .text import first_bytes
from .together import Waiting, take

WRITTEN_BY = {"hpcred-model": ", which hpcred convert writes", "hpcred-result": ", which hpcred reduce writes"}


class Target(FileIO):
    """What HDF5 writes to. It may crash, at the latest when it closes a file, where the system refuses a write, so it
    is not told: `error` is what was refused first, and nothing after it is written."""

    error: OSError | None = None

    def __init__(self, path):
        super().__init__(path, "w+")

    def write(self, data):
        left = memoryview(data).cast("B")
        try:
            while self.error is None and len(left):
                left = left[super().write(left) :]
        except OSError as error:
            self.error = error
        return memoryview(data).nbytes

    def truncate(self, size=None):
        try:
            return self.tell() if self.error else super().truncate(size)
        except OSError as error:
            self.error = error
            return size

    @contextmanager
    def refusals_raised(self):
        """Raise what was refused in the block, also in place of what HDF5 made of it. Raises OSError."""
        try:
            yield
        except Exception as error:
            raise self.error or error from None
        if self.error:
            raise self.error


class CheckedWriter:
    """A new HDF5 file that becomes `output`, written by all ranks. Every method is collective, with the same small
    values everywhere.

    HDF5 works on rank 0 alone: ranks that have a file open together wait for each other for ever where one of them
    cannot write. All ranks write rows, to places that belong to them. Datasets get checksums (see files.checked). All
    methods raise ComputationError on all ranks for numbers that are not finite and where the file cannot be written.
    """

    def __init__(self, path, comm, output):
        self._path, self._comm, self._output, self._room = str(path), comm, output, Room(path, comm)
        self._attributes, self._names, self._target, self._file = {}, [], None, None
        with agreed(comm), writing_to(output, path):
            if comm.rank == 0:
                self._target = Target(path)
        with self._on_first():
            if comm.rank == 0:
                self._file = h5py.File(self._target, "w")

    def close(self):
        if self._file is not None:
            self._file.close()
        if self._target is not None:
            self._target.close()

    def finish(self):
        """Write what tells a whole file from a damaged one, and close it."""
        self.attribute(CHECKSUM, header_checksum(self._attributes, self._names))
        with self._on_first():
            self.close()

    @contextmanager
    def _on_first(self):
        """The open file on rank 0, None on others."""
        with agreed(self._comm), writing_to(self._output, self._path):
            if self._target is None:
                yield None
            else:
                with self._target.refusals_raised():
                    yield self._file

    def attribute(self, name, value):
        self._attributes[name] = value
        self._room.take(0)
        with self._on_first() as file:
            if file is not None:
                file.attrs[name] = value

    def small(self, name, value, gaps=False, **about):
        """A dataset from rank 0: an array (`gaps`: nan is what is not known), a text, a list of texts, or a dict (as
        JSON). `about` it: attributes, for readers."""
        value = self._comm.bcast(value)
        if isinstance(value, dict):
            value = json.dumps(value)
        if isinstance(value, str):
            value = np.array(value.encode() or b" ")
        elif isinstance(value, list) and (not value or isinstance(value[0], str)):
            value = np.array([text.encode() for text in value], dtype="S") if value else np.zeros(0, "S1")
        value = np.asarray(value)
        self._check(name, value, gaps)
        self._names.append(name)
        sums = sums_of(value.reshape(-1), 0, tag_of(value.dtype, value.shape, -1))
        self._room.take(value.nbytes + sums.nbytes, datasets=2)
        with self._on_first() as file:
            if file is not None:
                file.create_dataset(name, data=value, track_times=False).attrs.update(about)
                file.create_dataset(f"{SUMS}/{name}", data=sums, track_times=False).attrs["axis"] = -1

    def several(self, values: dict, **about):
        """Datasets as `small` writes them by name; None is left out."""
        for name, value in values.items():
            if value is not None:
                self.small(name, value, **about)

    def rows(self, name, local, axis=0):
        """A dataset whose `axis` is distributed over the ranks in order; `local` is the part of this rank. Parts may
        have types of their own, of which those of empty parts do not count."""
        self._check(name, local)
        kinds = self._comm.allgather((local.size > 0, local.dtype.str))
        full = [kind for there, kind in kinds if there] or [kinds[0][1]]
        local = local.astype(np.result_type(*full), copy=False)
        self._names.append(name)
        shape, start = self._lay(name, local, axis)
        sums = sums_of_parts(self._comm, local, axis, start, tag_of(local.dtype, shape, axis))
        self._lay_sums(name, sums, axis)

    def _lay(self, name, local, axis):
        """Write the parts of all ranks; returns the shape of the whole, and where the part of this rank begins."""
        shape, start, offset = self._make(name, local.shape, axis, local.dtype)
        row = local.dtype.itemsize * prod(shape[axis + 1 :])
        self._put(offset, row * start, row * shape[axis], local, prod(shape[:axis]))
        return shape, start

    def _make(self, name, shape, axis, dtype):
        """Make a dataset of parts with a shape; returns the shape of the whole, where the part of this rank begins
        along the axis, and the byte where the numbers begin."""
        counts = self._comm.allgather(shape[axis])
        shape = [*shape[:axis], sum(counts), *shape[axis + 1 :]]
        self._room.take(dtype.itemsize * prod(shape), datasets=1)
        offset = None
        with self._on_first() as file:
            if file is not None:
                offset = place_of(file, name, shape, dtype)
        return shape, sum(counts[: self._comm.rank]), self._comm.bcast(offset)

    def _put(self, offset, ahead, step, local, count):
        """Write `count` pieces of an array of this rank, `step` bytes from one to the next, the first one so many bytes
        behind an offset. Collective."""
        with agreed(self._comm), writing_to(self._output, self._path):
            if local.size:
                _put(self._path, offset + ahead, step, np.ascontiguousarray(local).reshape(count, -1))

    @contextmanager
    def steps(self, name, count, shape, dtype):
        """A dataset (count, rows, ...) that comes a few steps at a time, with `shape` (rows, ...) of this rank, whose
        rows are distributed over the ranks in order. The block gets a function that takes the next steps (b, rows, ...)
        of this rank, of any type; it is collective."""
        dtype = np.dtype(dtype)
        self._names.append(name)
        whole, start, offset = self._make(name, (count, *shape), 1, dtype)
        row, tag, done, sums = dtype.itemsize * prod(whole[2:]), tag_of(dtype, whole, 1), 0, []

        def put(local):
            nonlocal done
            local = np.ascontiguousarray(local, dtype)
            self._check(name, local)
            self._put(offset, row * (done * whole[1] + start), row * whole[1], local, len(local))
            sums.append(sums_of_parts(self._comm, local, 1, start, tag))
            done += len(local)

        yield put
        self._lay_sums(name, np.concatenate(sums), 1)

    def _lay_sums(self, name, sums, axis):
        self._lay(f"{SUMS}/{name}", sums, 1)
        with self._on_first() as file:
            if file is not None:
                file[f"{SUMS}/{name}"].attrs["axis"] = axis

    def _check(self, name, array, gaps=False):
        with agreed(self._comm):
            if array.dtype.kind in "fc":
                bad = np.count_nonzero(np.isinf(array) if gaps else ~np.isfinite(array))
                if bad:
                    raise ComputationError(
                        f"{name} has {bad} of {array.size} numbers that are not finite, and is not written: the scales "
                        "are beyond what double precision holds, or a matrix is nearly singular"
                    )


def _put(path, offset, step, blocks):
    """Write arrays into an open file, each in one piece, `step` bytes from one to the next."""
    with open(path, "r+b") as file:
        for k, block in enumerate(blocks):
            file.seek(offset + step * k)
            file.write(block.view(np.uint8).data)


def place_of(file, name, shape, dtype) -> int | None:
    """Make a dataset in an open file whose numbers come later; returns the byte where they begin, if there are any."""
    made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    made.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    made.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    made.set_obj_track_times(False)
    group = file.require_group(name.rpartition("/")[0] or "/")
    space, kind = h5py.h5s.create_simple(tuple(shape)), h5py.h5t.py_create(dtype, logical=True)
    return h5py.h5d.create(group.id, name.rpartition("/")[2].encode(), kind, space, made).get_offset()


def written_by_one(path, comm, write, *arguments):
    """Write a file by write(temporary, *arguments) on one rank, see atomic_output. Collective. Raises InputError."""
    with atomic_output(path, comm) as temporary, agreed(comm):
        if comm.rank == 0:
            write(temporary, *arguments)


@contextmanager
def atomic_output(path, comm, kind=None):
    """A temporary name beside `path` that becomes `path` when the block ends well; links are followed. Collective.

    In a block of `together` it does so at the end of that one.

    Raises InputError before the block where the file cannot be written, and after it where what is there is of another
    kind than what was written, or than a `kind` of outputs.OtherKind.
    """
    check_writable(path, comm)
    # the output belongs to this run, and is written beside its place
    name, path = path, Path(os.path.realpath(path))
    temporary = temporary_name(path, *comm.bcast((os.getpid(), HOST)))
    left, waits = {temporary, lock_name(path)}, False
    with agreed(comm):
        if comm.rank == 0:
            if os.path.exists(path) and os.path.getsize(path):
                check_kept(name)
            lock(path, name)
    unfinished.update(left)
    try:
        with agreed(comm), writing_to(name, temporary):
            if comm.rank == 0:
                begin(temporary)
        with Owned(comm), writing_to(name, temporary):
            yield temporary
        # what is there must be of the same kind; then it is replaced, now or with others
        comm.Barrier()
        with agreed(comm), writing_to(name, temporary):
            if comm.rank == 0:
                if path.exists():
                    check_kind(path, kind or kind_of(temporary))
                with open(temporary, "r+b") as file:
                    os.ftruncate(file.fileno(), os.path.getsize(temporary))  # gives back room that was not needed
                    os.fsync(file.fileno())
        waits = take(Waiting(path, temporary, lambda: os.replace(temporary, path),
                             drop=lambda: temporary.unlink(missing_ok=True)))  # fmt: skip
        with agreed(comm), writing_to(name, temporary):
            if comm.rank == 0 and not waits:
                os.replace(temporary, path)
    except BaseException as error:
        settle(comm, error)  # where this rank fails alone the job ends here, while it still knows what must not stay
        first = comm.bcast(error if comm.rank == 0 and isinstance(error, NotWritten) else None)
        if first is not None:
            raise common_to(comm, first) from error
        raise
    finally:
        if not waits:
            unfinished.difference_update(left)
        if comm.rank == 0 and not waits:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            unlock(path)


@contextmanager
def writing(path, comm, kind: str | None = None, version: int | None = None):
    """A CheckedWriter on a file of a kind and version that appears under its name when the block ends well.
    Collective."""
    with atomic_output(path, comm) as temporary:
        with Owned(comm) as owned:
            file = owned.owns(CheckedWriter(temporary, comm, path))
            for key, value in (("format", kind), ("version", version)):
                if value is not None:
                    file.attribute(key, value)
            yield file
            file.finish()
        with agreed(comm), writing_to(path, temporary):
            if comm.rank == 0:
                seal(temporary)


# versions of files with added terms, which programs of before would leave out
ALSO = {"hpcred-model": 2, "hpcred-result": 3}


@contextmanager
def reading(path, kind: str, version: int | None = None, schema=None):
    """A CheckedFile, opened by this rank; see opened, and files.checked for `schema`. Raises InputError."""
    with opened(path, kind, version) as file:
        yield CheckedFile(file, path, schema)


@contextmanager
def opened(path, kind: str, version: int | None = None):
    """The file opened for reading by this rank; `kind` and `version` are its attributes. Raises InputError."""
    require_name(path)
    path = Path(path)
    require_whole(path)
    if first_bytes(path)[: len(HDF5)] != HDF5:
        by = WRITTEN_BY.get(kind, "")
        raise InputError(f"{path}: found no HDF5 file, expected one of format '{kind}'{by}")
    with opened_hdf5(path) as file:
        with guarded(path, "its attributes"):
            written, number = file.attrs.get("format", "none"), int(file.attrs.get("version", 0))
            written = written.decode() if isinstance(written, bytes) else str(written)
        if written != kind:
            by = WRITTEN_BY.get(kind, "")
            raise InputError(f"{path}: found an HDF5 file of format '{written}', expected '{kind}'{by}")
        if version is not None and "version" not in file.attrs:
            raise InputError(f"{path}: found no attribute 'version', expected {version} for the format '{kind}'")
        if version is not None and number not in (version, ALSO.get(kind)):
            newer, older = "a newer hpcred wrote it: update this one", "an older hpcred wrote it: make it again"
            advice = newer if number > version else older
            raise InputError(f"{path}: found version {number} of the format '{kind}', expected {version}; {advice}")
        yield file


def require_name(path):
    """Raise InputError for what is no name of a file."""
    if not isinstance(path, str | os.PathLike):
        kind = type(path).__name__
        hint = "; hpcred.write_result makes a file of it" if kind == "ReducedModel" else ""
        raise InputError(f"found a {kind}, expected the name of a file{hint}")


def kind_of_file(path) -> str | None:
    """The format that an HDF5 file of hpcred names, or None. Raises InputError where the system refuses to read it."""
    try:
        with opened_hdf5(path) as file, guarded(path, "its attributes"):
            return str(file.attrs.get("format", "")) or None
    except Damaged:
        return None


def texts(dataset) -> list[str]:
    """A list of texts from a dataset of fixed-length bytes. Raises InputError."""
    try:
        return [text.decode() for text in dataset[...]]
    except UnicodeDecodeError as error:
        raise damaged(dataset.path, f"{dataset.name} is no text") from error
