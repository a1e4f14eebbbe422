"""Keep outputs to one run at a time: an output belongs to a run until it is written, or is refused.

A run holds a lock (flock) on `.NAME.lock` beside the output NAME, and writes `NAME.tmp-HOST-PROCESS`, which it renames.
The system gives the lock back when the run ends in whatever way, and the next run on that output removes what is left.
Functions are for one rank.
"""

import atexit
import errno
import fcntl
import hashlib
import os
import re
import socket
import stat
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

from ..parallel.failures import InputError, unfinished

LOCK = re.compile(rb"(process \d+ on [^\n]*)?")  # all of a lock: another file is not one, whatever its name
LONGEST_LOCK = 300  # bytes


def host_in_names(host: str) -> str:
    """A host as a part of names of files: different hosts have different ones."""
    if re.fullmatch(r"[A-Za-z0-9._-]{1,40}", host):
        return host
    digest = hashlib.blake2b(os.fsencode(host), digest_size=6).hexdigest()
    return f"{re.sub('[^A-Za-z0-9._-]', '-', host)[:27]}-{digest}"


HOST = host_in_names(socket.gethostname())

_held: dict[Path, int] = {}  # open files by the names of locks


class Taken(InputError):
    """Another run is about to write the output; `holder`: which, in words."""

    exit_status = 73  # EX_CANTCREAT of sysexits.h: a sweep tries again later
    holder = "another process"


def temporary_name(path, process: int | None = None, host: str = HOST) -> Path:
    """The name under which a process writes an output."""
    return path.with_name(f"{path.name}.tmp-{host}-{process or os.getpid()}")


def open_plain(path, flags: int) -> int:
    """Open a file by a name that others can make, in a shared folder: a link is not followed, and a pipe not waited
    for. Raises OSError."""
    file = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    if not stat.S_ISREG(os.fstat(file).st_mode):
        os.close(file)
        raise OSError(errno.ENXIO, "this is a pipe or a device")
    return file


def begin(path: Path):
    """Create an empty file in place of what has the name, which may be a link that others laid in a shared folder."""
    path.unlink(missing_ok=True)
    path.open("xb").close()


def lock_name(path) -> Path:
    return path.with_name(f".{path.name}.lock")


def is_locked_here(path: Path) -> bool:
    """Whether this process keeps other runs from an output."""
    return lock_name(path) in _held


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
            file = open_plain(name, os.O_RDWR | os.O_CREAT)
        except OSError as error:
            raise InputError(
                f"output {called or path}: its lock {name} cannot be opened ({error.strerror}); remove it when no run "
                "is under way, or choose another name"
            ) from error
        # a file of that name that is no lock is left alone
        if _words(file) is None:
            os.close(file)
            raise InputError(
                f"output {called or path}: found a file {name}, which no run wrote and which has the name of its lock; "
                "move it, or choose another name"
            )
        # one process has it; where the file system has no locks nobody does
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            who = _words(file)
            os.close(file)
            taken = Taken(
                f"output {called or path}: another run is about to write it{f' ({who})' if who else ''}; wait for its "
                "end, or choose another name"
            )
            taken.holder = who or taken.holder
            raise taken from None
        except OSError:
            os.close(file)
            with suppress(OSError):
                name.unlink()
            return
        if _is_file(name, file):
            break
        os.close(file)  # the run that had it has ended meanwhile, and removed its name
    # who has it, and what the dead left
    unfinished.add(name)
    with suppress(OSError):  # words for the user, where there is room for them
        os.ftruncate(file, 0)
        os.write(file, f"process {os.getpid()} on {HOST}".encode())
    _held[name] = file
    for other in left_by_the_dead(path):
        with suppress(OSError):
            other.unlink()


def _words(file: int) -> str | None:
    """What an open lock says, nothing perhaps; None where no run wrote it, or where it has other names."""
    text = os.pread(file, LONGEST_LOCK + 1, 0)
    if not LOCK.fullmatch(text) or len(text) > LONGEST_LOCK or os.fstat(file).st_nlink > 1:
        return None
    return text.decode(errors="replace")


def _is_file(name, file: int) -> bool:
    """Whether an open file has this name."""
    try:
        return os.path.samestat(os.fstat(file), os.lstat(name))
    except FileNotFoundError:
        return False


def left_by_the_dead(path: Path) -> list[Path]:
    """What dead processes of this machine left of an output: their temporary names, and those with an ending more."""
    pattern = re.compile(re.escape(f"{path.name}.tmp-{HOST}-") + r"(\d{1,9})(\.[a-z0-9]+)?")
    try:
        names = os.listdir(path.parent)
    except OSError:
        return []
    matches = [match for match in map(pattern.fullmatch, names) if match]
    return [path.with_name(match[0]) for match in matches if not psutil.pid_exists(int(match[1]))]


def unlock(path: Path):
    """Give an output free."""
    _give_back(lock_name(path))


def _give_back(name):
    file = _held.pop(name, None)
    if file is not None:
        with suppress(OSError):
            if _is_file(name, file):
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
