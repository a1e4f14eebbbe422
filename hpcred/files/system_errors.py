"""Put what the system refuses of a file (OSError, errors of HDF5) into a sentence with its name.

Files of other programs are opened here, since Python's errors name the file where it cannot be opened, but not where it
cannot be read.
"""

import mmap
import os
import stat
from contextlib import contextmanager

import numpy as np

from ..parallel.failures import InputError, reason_of
from .room import NotWritten, is_full, no_room


@contextmanager
def reading_from(path):
    """Raise InputError with the name of the file for what the system refuses in the block."""
    try:
        yield
    except Exception as error:
        if (reason := reason_of(error)) is None:
            raise
        raise InputError(f"{getattr(error, 'filename', None) or path}: cannot be read ({reason})") from error


@contextmanager
def writing_to(path, temporary=None):
    """Raise NotWritten for what the system refuses in the block of an output; `temporary`: what it is until then."""
    try:
        yield
    except Exception as error:
        if is_full(error):
            raise no_room(path, written=temporary or path) from error
        reason = reason_of(error)
        if reason is None and isinstance(error, OSError) and not isinstance(error, BrokenPipeError):
            reason = str(error).partition("\n")[0]  # of HDF5, where it says no number
        if reason is None:
            raise
        raise NotWritten(f"output {path}: cannot be written ({reason}); choose another folder, or try again") from error


@contextmanager
def open_input(path, mode="rb", **options):
    """As `open`, for reading. Raises InputError for all that the system refuses, and for pipes and devices."""
    with reading_from(path), open(path, mode, opener=_not_waiting, **options) as file:
        yield file


def _not_waiting(path, flags) -> int:
    """An opener that does not wait for a pipe, as `open` does until another process writes to it."""
    file = os.open(path, flags | os.O_NONBLOCK)
    try:
        mode = os.fstat(file).st_mode
        if stat.S_ISDIR(mode):  # which open refuses
            return file
        if stat.S_ISREG(mode):
            os.pread(file, 1, 0)  # some of the kernel's are pipes all the same, such as /proc/kmsg
            return file
    except BlockingIOError:
        pass
    except OSError:
        os.close(file)
        raise
    os.close(file)
    raise InputError(f"{path}: this is a pipe or a device, expected a file")


def damaged_file(path, found: str, how: str = "damaged") -> InputError:
    """What to raise for contents that no program writes; `how` they came to be so."""
    return InputError(f"{path}: found {found}; the file is {how}")


@contextmanager
def mapped(path):
    """The bytes of a file in memory, as far as they are looked at. Raises InputError."""
    with open_input(path) as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        yield data


def read_bytes(path, start: int, stop: int) -> bytes:
    """The bytes start..stop of a file, fewer where it ends before. Raises InputError."""
    with open_input(path) as file:
        file.seek(start)
        return file.read(stop - start)


def read_numbers(path, dtype, count: int, offset: int = 0) -> np.ndarray:
    """Numbers (count,) of a binary file from a byte on. Raises InputError, too where the file ends before."""
    values = np.empty(count, dtype)
    with open_input(path) as file:
        file.seek(offset)
        if file.readinto(values.view(np.uint8)) < values.nbytes:
            raise damaged_file(path, "its end in the middle of numbers", "cut off")
    return values
