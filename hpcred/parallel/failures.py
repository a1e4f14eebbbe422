"""The errors that users meet, and the one rule for failures of a rank.

The rule: a rank that fails waits GRACE seconds for the others to fail as well. If all do, the error is common: it is
raised on all ranks, and what they own together is closed on the way out. If not, this rank says its sentence and ends
the job, so that nobody waits for it for ever. Ranks of a group follow the rule among themselves; what the group raises
then reaches all ranks by `agreed`, or ends the job when the other groups are busy.
"""

import os
import pickle
import sys
import time
from contextlib import ExitStack, contextmanager

from mpi4py import MPI

GRACE = 4.0  # seconds that a failed rank waits for the others

unfinished: set = set()  # files that must not stay when the job is ended

_private: list = []  # duplicates of communicators, for messages of this module only


class HpcredError(Exception):
    """Base of the errors whose text is meant for the user; `exit_status` is that of the command line."""

    exit_status = 1


class InputError(HpcredError, ValueError):
    """The input is at fault: the message names the file or key, what was found, what was expected."""

    exit_status = 2


class ComputationError(HpcredError, RuntimeError):
    """The input is fine as far as one can see, but the computation failed."""


@contextmanager
def agreed(comm):
    """Raise on all ranks what any rank raised inside the block. Collective at the end of the block.

    The block must not communicate: a rank that fails in it leaves early. Of several errors that of the lowest rank
    is raised.
    """
    error = None
    try:
        yield
    except BaseException as caught:
        error = caught
    if comm.size == 1:
        if error is not None:
            raise error
        return
    private = watched(comm)
    failed = bytearray(comm.size)
    request = private.Iallgather(bytearray([error is not None]), failed)
    if error is None:
        request.Wait()
    elif not _in_time(request):
        end_job(error)
    if any(failed):
        first = failed.index(1)
        told = private.bcast(_sendable(error), root=first)
        if comm.rank != first:
            error, told.__cause__ = told, error
        raise common_to(comm, error)


class Owned(ExitStack):
    """Distributed objects that are closed at the end of the block, by all ranks of `comm` together.

    On an exception the rule for failures comes first: closing is collective, and a rank that failed alone would close
    while the others compute.
    """

    def __init__(self, comm):
        super().__init__()
        self._comm = comm

    def owns(self, item):
        """Have `item.close()`, or `item.destroy()` of a PETSc object, called at the end; returns the item."""
        self.callback(item.close if hasattr(item, "close") else item.destroy)
        return item

    def __exit__(self, kind, error, trace):
        if error is not None:
            settle(self._comm, error)
        return super().__exit__(kind, error, trace)


def settle(comm, error: BaseException):
    """Return if all ranks of `comm` fail within GRACE seconds, else say the error and end the job."""
    if getattr(error, "failed_ranks", 1) >= comm.size:
        return
    private = next((item for item in _private if _alike(item, comm)), None)
    if private is None or not _in_time(private.Ibarrier()):
        end_job(error)
    common_to(comm, error)


def common_to(comm, error: BaseException):
    """Mark an error that all ranks of `comm` raise, so that one of them speaks; returns it."""
    error.failed_ranks, error.speaks = comm.size, comm.rank == 0
    return error


def watched(comm):
    """The private duplicate of a communicator, made at the first call. Collective at the first call."""
    for item in _private:
        if _alike(item, comm):
            return item
    _private.append(comm.Dup())
    return _private[-1]


def forget(comm):
    """Free the private duplicate of a communicator that is about to be freed. Collective."""
    for item in [item for item in _private if _alike(item, comm)]:
        _private.remove(item)
        item.Free()


def _alike(one, other):
    return MPI.Comm.Compare(one, other) in (MPI.IDENT, MPI.CONGRUENT)


def fail(error: BaseException) -> int:
    """Report the error of a command once and return the exit status; does not return if it is not common."""
    settle(MPI.COMM_WORLD, error)
    if MPI.COMM_WORLD.rank == 0:
        _say(error)
    return getattr(error, "exit_status", 1)


def end_job(error: BaseException):
    """Say the error of this rank and end all ranks; does not return."""
    if getattr(error, "speaks", True):
        _say(error, f" (rank {MPI.COMM_WORLD.rank})")
    else:
        time.sleep(GRACE)  # the first rank of the group says it
    for path in unfinished:
        path.unlink(missing_ok=True)
    MPI.COMM_WORLD.Abort(getattr(error, "exit_status", 1))


def _say(error, where=""):
    if os.environ.get("HPCRED_TRACEBACK"):
        import traceback

        traceback.print_exception(error)
    if isinstance(error, HpcredError):
        text = f"error{where}: {error}"
    elif isinstance(error, KeyboardInterrupt):
        text = f"interrupted{where}"
    else:
        lines = str(error).strip().splitlines()
        text = f"internal error{where}: {type(error).__name__}: {lines[0] if lines else ''} (--traceback shows where)"
    print(f"hpcred: {text}", file=sys.stderr, flush=True)


def excepthook(kind, error, trace):
    """For scripts that use hpcred as a library: Python's report, and no rank left waiting."""
    if MPI.COMM_WORLD.size > 1:
        settle(MPI.COMM_WORLD, error)
    if MPI.COMM_WORLD.rank == 0:
        sys.__excepthook__(kind, error, trace)


def _in_time(request):
    deadline = time.monotonic() + GRACE
    while not request.Test():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.005)
    return True


def _sendable(error):
    """The error, or its text where it cannot be sent to another rank and be raised there."""
    try:
        pickle.loads(pickle.dumps(error))
        return error
    except Exception:
        return ComputationError(f"{type(error).__name__}: {error}")
