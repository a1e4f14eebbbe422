"""Open HDF5 files for reading: the one place where files of others meet HDF5.

HDF5 follows links, virtual datasets and raw storage into other files, believes sizes of which nothing is stored, and
raises errors of many kinds on damaged files, on some of which it crashes or does not end. Files without the seal of
hpcred are therefore read by a process of its own first, and names, attributes and numbers are read `guarded`.
"""

import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from functools import lru_cache
from math import prod
from pathlib import Path

import h5py

from ..parallel.failures import HpcredError, InputError, reason_of
from .seal import is_broken, is_sealed
from .text import absent

ERRORS = (OSError, RuntimeError, LookupError, TypeError, ValueError, ArithmeticError, MemoryError)
PROBE = Path(__file__).with_name("hdf5_probe.py")
PATIENCE, SLOWEST = 30.0, 2e7  # seconds for any file, and bytes a second
CRASHES = tuple(-number for number in (signal.SIGSEGV, signal.SIGFPE, signal.SIGABRT, signal.SIGBUS, signal.SIGILL))
PACKED = 1100  # times what is stored is the most that deflate makes of it: a file that says more is not to be believed


class Damaged(InputError):
    """An HDF5 file that is damaged, or refers to other files."""


def damaged(path, what) -> Damaged:
    return Damaged(f"{path}: {what}; the file is damaged: make it again, or take a copy")


def require_whole(path):
    """Refuse a file that is not there, or on which HDF5 crashes. Raises InputError; on this rank."""
    if not os.path.isfile(path):
        raise absent(path)
    if is_broken(path):
        raise damaged(path, "what HDF5 keeps of its own does not have its checksum")
    if not is_sealed(path):
        about = os.stat(path)
        if not _survives(os.path.realpath(path), about.st_size, about.st_mtime_ns):
            raise damaged(path, "HDF5 crashes on it, or does not end")


@lru_cache(maxsize=64)
def _survives(path, size, mtime) -> bool:
    """Whether a process that reads all of an HDF5 file comes to its end."""
    if not sys.executable:
        return True
    command = [sys.executable, str(PROBE), path]
    patience = PATIENCE + size / SLOWEST
    try:
        run = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                             timeout=patience, env=os.environ | {"PYTHONSAFEPATH": "1"})  # fmt: skip
    except subprocess.TimeoutExpired:
        return False
    except OSError:  # no process, which is no fault of the file
        return True
    return run.returncode not in CRASHES


@contextmanager
def opened_hdf5(path):
    """The file opened by this rank. Raises InputError."""
    require_whole(path)
    with guarded(path, "HDF5"):
        file = h5py.File(path, "r")
    with file:
        yield file


@contextmanager
def guarded(path, what: str):
    """Raise InputError for whatever HDF5 raises in the block, which reads `what` of a file."""
    try:
        yield
    except HpcredError:
        raise
    except ERRORS as error:
        if reason := reason_of(error):
            raise InputError(f"{path}: {what} cannot be read ({reason})") from error
        raise damaged(path, f"{what} cannot be read ({' '.join(str(error).split())[:120]})") from error


def own_item(group, name, path):
    """The group or dataset of a name in a group, None without one. Raises InputError for what lies elsewhere."""
    link = group.get(name, getlink=True)
    if link is None:
        return None
    place = f"{group.name.rstrip('/')}/{name}"
    if not isinstance(link, h5py.HardLink):
        raise damaged(path, f"{place} is a link to something else, which is not followed")
    member = group[name]
    if isinstance(member, h5py.Dataset):
        require_own(member, path, place)
    return member


def require_own(dataset, path, place: str):
    """Raise InputError for a dataset whose numbers are kept in other files, or are not there."""
    if dataset.external or dataset.is_virtual:
        raise damaged(path, f"{place} is kept in another file, which is not followed")
    most = dataset.id.get_storage_size() * (1 if dataset.chunks is None else PACKED)
    if dataset.shape is not None and dataset.dtype.itemsize * prod(dataset.shape) > most:
        raise damaged(path, f"{place} is not whole")


def real_numbers(group, name, path):
    """The real numbers of a dataset as an array of floats, None without one. Raises InputError for other contents."""
    dataset = own_item(group, name, path)
    if dataset is None:
        return None
    if not isinstance(dataset, h5py.Dataset) or dataset.shape is None or dataset.dtype.kind not in "fiu":
        content = f"numbers of the kind {dataset.dtype}" if isinstance(dataset, h5py.Dataset) else "no array"
        raise InputError(f"{path}: {name} has {content}, expected an array of real numbers")
    return dataset[()].astype(float)
