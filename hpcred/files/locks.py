"""Keep outputs to one run at a time: an output belongs to a run until it is written, or is refused.

A run holds a lock (flock) on `.NAME.lock` beside the output NAME, and writes `NAME.tmp-HOST-PROCESS`, which it renames.
The system gives the lock back when the run ends in whatever way, and the next run on that output removes what is left.
Functions are for one rank.
"""

from __future__ import annotations

import atexit
import fcntl
import os
import socket
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

from ..parallel.failures import InputError, unfinished

UNDER_WAY = "another run is about to write it"  # in the refusal of a second run
HOST = socket.gethostname().replace("/", "-")[:40]

_held: dict[Path, int] = {}  # open files by the names of locks


def temporary_name(path, process: int | None = None, host: str = HOST) -> Path:
    """The name under which a process writes an output."""
    return path.with_name(f"{path.name}.tmp-{host}-{process or os.getpid()}")


def begin(path: Path):
    """Create an empty file in place of what has the name, which may be a link that others laid in a shared folder."""
    path.unlink(missing_ok=True)
    path.open("xb").close()


def lock_name(path) -> Path:
    return path.with_name(f".{path.name}.lock")


def lock(path: Path, called=None):
    """Keep other runs from an output until unlock, or the end of the process. Raises InputError where one has it.

    `called`: its name in messages. What dead processes of this machine left of it is removed. Where the file system
    has no locks nothing is locked.
    """
    name = lock_name(path)
    if name in _held:
        return
    while True:
        try:
            file = os.open(name, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)  # a link may be laid by others
        except OSError as error:
            raise InputError(
                f"output {called or path}: its lock {name} cannot be opened ({error.strerror}); remove it when no run "
                "is under way, or choose another name"
            ) from error
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            who = os.read(file, 200).decode(errors="replace").strip()
            os.close(file)
            raise InputError(
                f"output {called or path}: {UNDER_WAY}{f' ({who})' if who else ''}; wait for its end, or choose "
                "another name"
            ) from None
        except OSError:
            os.close(file)
            with suppress(OSError):
                name.unlink()
            return
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file), os.stat(name)):
                break
        os.close(file)  # the run that had it has ended meanwhile, and removed its name
    unfinished.add(name)
    with suppress(OSError):  # words for the user, where there is room for them
        os.ftruncate(file, 0)
        os.write(file, f"process {os.getpid()} on {HOST}".encode())
    _held[name] = file
    for other in path.parent.glob(glob_of(path)):
        process = other.name.rpartition("-")[2].partition(".")[0]
        if process.isdigit() and not psutil.pid_exists(int(process)):
            with suppress(OSError):
                other.unlink()


def holder_of(path: Path) -> str | None:
    """Which process of another run has the lock of an output, in words; None where no run has it."""
    try:
        file = os.open(lock_name(path), os.O_RDONLY)
    except OSError:
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return os.read(file, 200).decode(errors="replace").strip() or "another process"
    except OSError:  # a file system without locks
        pass
    finally:
        os.close(file)
    return None


def glob_of(path) -> str:
    """A pattern for what processes of this machine write of an output, and files beside that."""
    plain = "".join(f"[{sign}]" if sign in "*?[" else sign for sign in path.name)
    return f"{plain}.tmp-{HOST}-*"


def unlock(path: Path):
    """Give an output free."""
    _give_back(lock_name(path))


def _give_back(name):
    file = _held.pop(name, None)
    if file is not None:
        with suppress(OSError):
            name.unlink()
        unfinished.discard(name)
        os.close(file)


@contextmanager
def locks_given_back():
    """Give all outputs free at the end that were locked in the block, or in the function that this decorates."""
    before = set(_held)
    try:
        yield
    finally:
        for name in set(_held) - before:
            _give_back(name)


@atexit.register
def unlock_all():
    """Give all outputs free that are not written in the end."""
    for name in list(_held):
        _give_back(name)
    unfinished.difference_update([path for path in unfinished if path.name.endswith(".lock")])
