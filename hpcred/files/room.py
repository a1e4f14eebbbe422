"""Take the room of files on the disk before they are written, or refuse them in a sentence.

HDF5 does not survive a disk that is full: what a file needs is taken before it is written.
"""

import ctypes
import errno
import os
import resource
import shutil
import tempfile
from contextlib import suppress
from math import inf
from pathlib import Path

from ..parallel.failures import ComputationError, HpcredError, agreed

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
BASE, A_DATASET = 2**18, 2**12  # bytes of HDF5's own, in all and for each dataset
KEEP_SIZE = 1  # of fallocate: take room, and leave the size as it is

_libc = ctypes.CDLL(None, use_errno=True)


class NotWritten(ComputationError):
    """A file cannot be written."""


class NoRoom(NotWritten):
    """There is no room for a file."""

    exit_status = 74  # EX_IOERR of sysexits.h: a sweep begins no other run


def no_room(path, needed: int | None = None, written=None) -> NoRoom:
    """The error of a file that was to become `path`: of the bytes needed, or of more than was `written` so far."""
    folder = Path(path).resolve().parent
    if needed is None:
        needed = Path(written).stat().st_size if Path(written).exists() else 0
        least = "more than "
    else:
        least = ""
    return NoRoom(
        f"output {path}: the disk is full: it needs {least}{in_bytes(needed)}, and {in_bytes(free_bytes(folder))} are "
        f"free in {folder}; make room, or choose another folder"
    )


def is_full(error: BaseException) -> bool:
    """Whether an error that has no sentence yet comes from a full disk, perhaps by a library that fell over it."""
    if isinstance(error, HpcredError):
        return False
    while error is not None and getattr(error, "errno", None) not in FULL:
        error = error.__cause__ or error.__context__
    return error is not None


def in_bytes(count) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e5 else f"{count} bytes"


def free_bytes(folder) -> int:
    """What a file in a folder may take, by the disk and the limits of the process."""
    return min(shutil.disk_usage(folder).free, limit_of_files())


def limit_of_files() -> float:
    """The largest size of a file that this process may write (ulimit -f)."""
    limit, _ = resource.getrlimit(resource.RLIMIT_FSIZE)
    return inf if limit == resource.RLIM_INFINITY else limit


class Room:
    """What a new file takes on the disk, before it is written; `path` is a temporary name. Methods are collective."""

    def __init__(self, path, comm):
        self._path, self._comm, self._taken = Path(path), comm, BASE
        with agreed(comm):
            if comm.rank == 0 and free_bytes(self._path.parent) < BASE:
                raise no_room(self._name(), BASE)

    def take(self, count: int, datasets: int = 0):
        """Take room for so many bytes more. Raises NoRoom on all ranks."""
        self._taken += count + datasets * A_DATASET
        with agreed(self._comm):
            if self._comm.rank == 0 and not _allocate(self._path, self._taken):
                raise no_room(self._name(), self._taken)

    def _name(self):
        return self._path.with_name(self._path.name.rpartition(".tmp-")[0])


def _allocate(path, size) -> bool:
    """Whether the disk has the room of a file, which it keeps where the file system can."""
    if size > limit_of_files():
        return False
    with open(path, "r+b") as file:
        if hasattr(_libc, "fallocate"):  # of Linux
            if _libc.fallocate(file.fileno(), KEEP_SIZE, ctypes.c_int64(0), ctypes.c_int64(size)) == 0:
                return True
            if ctypes.get_errno() in FULL:
                return False
        there = os.fstat(file.fileno()).st_blocks * 512
    return free_bytes(path.parent) >= size - there


def rescue_places(path):
    """Yield other names for an output without room, each an empty file that was made for it: in HPCRED_RESCUE_DIR, or
    else above the working folder and in TMPDIR.

    Names that are taken are passed over, also by links, which others may lay there to lead to other files. Those that
    are still empty when the next one is asked for are removed. On one rank.
    """
    chosen = os.environ.get("HPCRED_RESCUE_DIR")
    folders = [chosen] if chosen else [os.path.dirname(os.getcwd()), tempfile.gettempdir()]
    path = Path(path)
    for folder in map(Path, folders):
        names = [folder / path.name, *(folder / f"{path.stem}-{k}{path.suffix}" for k in range(1, 100))]
        with suppress(OSError):
            place = next((name for name in names if _made(name)), None)
            if place is not None:
                try:
                    yield place
                finally:
                    if place.stat().st_size == 0:
                        place.unlink()


def _made(name) -> bool:
    """Make an empty file; whether there was none. Raises OSError."""
    try:
        name.open("xb").close()
    except FileExistsError:
        return False
    return True
