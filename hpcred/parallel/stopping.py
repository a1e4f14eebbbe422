"""End a run after the current point where a signal to any rank asks for it, on all ranks at the same place.

A batch system or a launcher sends SIGTERM or SIGUSR1 ahead of the time limit; some of the ranks get it, at some moment.
While somebody listens the signal is only noted, and stop_if_asked() ends the run where its state is safe.
"""

import signal
from contextlib import contextmanager

from mpi4py import MPI

from .failures import HpcredError, common_to
from .signals import signals_to

SIGNALS = (signal.SIGTERM, signal.SIGUSR1)

_listeners = 0
_asked = False


class Stopped(HpcredError):
    """The run was asked to stop and did, after the current point; started again it goes on from what it kept."""

    exit_status = 75  # EX_TEMPFAIL of sysexits.h: try again


@contextmanager
def listening(wanted: bool = True):
    """Note the signals inside of the block instead of dying of them. `wanted`: the same on all ranks."""
    global _listeners, _asked
    if not wanted:
        yield
        return
    _listeners += 1
    try:
        with signals_to(_note, SIGNALS):
            yield
    finally:
        _listeners -= 1
        _asked = _asked and _listeners > 0


def _note(*_):
    global _asked
    _asked = True


def stop_if_asked(comm, place: str):
    """Raise Stopped on all ranks if one of them was asked to stop; `place` of the run in words. Collective.

    Without a listener nothing is asked and nothing is sent.
    """
    if _listeners and comm.allreduce(_asked, MPI.LOR):
        raise common_to(comm, Stopped(f"stopped as asked, after {place}; the same command goes on from what was kept"))
