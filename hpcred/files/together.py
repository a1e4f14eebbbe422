"""Have several outputs of a command appear together when all of them are written, or none after an error."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from ..parallel.failures import HpcredError, agreed, common_to, settle, unfinished
from .locks import lock_name, unlock
from .room import NotWritten, rescue_places
from .system_errors import writing_to

_waiting: list[Waiting] | None = None  # outputs of the block that are written; None outside of one


@dataclass
class Waiting:
    """An output that is written under a temporary name: `put` puts it in its place and `back` undoes that, `drop`
    removes what the temporary name has then. Called on one rank; `path` is locked."""

    path: Path
    temporary: Path
    put: Callable[[], None]
    back: Callable[[], None] = lambda: None
    drop: Callable[[], None] = lambda: None
    dear: bool = False  # whether computing it takes long, so that it is kept elsewhere


@contextmanager
def together(comm):
    """Put the outputs of the block in their places at its end; none where it fails. Collective.

    In a block of another one that one does it.
    """
    global _waiting
    if _waiting is not None:
        yield
        return
    # outputs of the block wait; folders may be older ones from the exchange on
    _waiting = group = []
    try:
        yield
        comm.Barrier()
        folders = [waiting.temporary for waiting in group if waiting.temporary.is_dir()]
        unfinished.difference_update(folders)  # which may be older ones from now on
        with agreed(comm):
            if comm.rank == 0:
                _put(group)
    except BaseException as error:
        # what took long to compute is kept elsewhere where the disk is full
        settle(comm, error)  # where this rank fails alone the job ends here, while it still knows what must not stay
        kept = _kept(group) if comm.rank == 0 and isinstance(error, NotWritten) else ()
        if comm.rank == 0:
            _drop(group)
        if isinstance(error, NotWritten) and (kept := comm.bcast(kept)):
            places = ", ".join(f"{name} is in {place}" for name, place in kept)
            raise common_to(comm, type(error)(f"{error}; what was written of {places}")) from error
        raise
    else:
        if comm.rank == 0:
            _drop(group)
    finally:
        _waiting = None
        unfinished.difference_update(*([waiting.temporary, lock_name(waiting.path)] for waiting in group))
        if comm.rank == 0:
            for waiting in group:
                unlock(waiting.path)


def take(waiting: Waiting) -> bool:
    """Whether an output waits for others now."""
    if _waiting is None:
        return False
    _waiting.append(waiting)
    return True


def rescued(write, path, comm):
    """write(path), or where that fails write(another place), and the error that says so. Collective."""
    try:
        write(path)
        for waiting in _waiting or ():
            waiting.dear = waiting.dear or waiting.path == Path(os.path.realpath(path))
    except NotWritten as error:
        places = rescue_places(path) if comm.rank == 0 else None
        while (place := comm.bcast(next(places, None) if comm.rank == 0 else None)) is not None:
            try:
                with alone():
                    write(place)
            except HpcredError:
                continue
            place = comm.bcast(os.path.abspath(place))
            raise common_to(comm, type(error)(f"{error}; what was to be written is in {place}")) from error
        raise


@contextmanager
def alone():
    """Outputs of the block appear at once."""
    global _waiting
    before, _waiting = _waiting, None
    try:
        yield
    finally:
        _waiting = before


def _put(group):
    """Put outputs in their places, folders first, which can be put back where another one fails."""
    done = []
    try:
        for waiting in sorted(group, key=lambda waiting: not waiting.temporary.is_dir()):
            with writing_to(waiting.path, waiting.temporary):
                waiting.put()
            done.append(waiting)
    except BaseException:
        for waiting in reversed(done):
            with suppress(OSError):
                waiting.back()
        raise


def _drop(group):
    for waiting in group:
        with suppress(OSError):
            waiting.drop()


def _kept(group) -> list[tuple[str, str]]:
    """Copy what takes long to compute to other places; return the names of both."""
    kept = []
    for waiting in group:
        for place in rescue_places(waiting.path) if waiting.dear else ():
            try:
                shutil.copyfile(waiting.temporary, place)
            except OSError:
                os.truncate(place, 0)
                continue
            kept.append((waiting.path.name, os.path.abspath(place)))
            break
    return kept
