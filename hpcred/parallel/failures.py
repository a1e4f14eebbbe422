"""The errors that users meet, and the one rule for failures of a rank.

The rule: a rank that fails waits GRACE seconds for the others to fail as well. If all do, and at the same place, the
error is common: it is raised on all ranks, and what they own together is closed on the way out. If not, this rank says
its sentence and ends the job, so that nobody waits for it for ever. Ranks of a group follow the rule among themselves;
what the group raises then reaches all ranks by `agreed`, or ends the job when the other groups are busy.

Ranks tell each other by one kind of message, an Iallgather on a communicator of this module, wherever they are: a rank
that fails and one that comes to the end of a block meet in it, and see that they are not at the same place.
"""

import errno
import fcntl
import logging
import os
import pickle
import re
import shutil
import signal
import stat
import sys
import termios
import time
import zlib
from contextlib import ExitStack, contextmanager, suppress

import numpy as np
from mpi4py import MPI

from .messages import message
from .signals import Terminated

GRACE = 4.0  # seconds that a failed rank waits for the others

FINE, FAILED, ELSEWHERE = 0, 1, 2  # what a rank says at the end of a block; from ELSEWHERE on: where it fails
OFF = ("", "0", "no", "off", "false")  # of HPCRED_TRACEBACK in the environment
LONG_WORD, LONGEST = re.compile(r"\S{1000,}"), 10_000  # letters of words and of messages
IN_HDF5 = re.compile(r"errno = (\d+)(?:.*offset = (\d+))?", re.DOTALL)
FARTHEST = 2**63  # no place of a file
OUT_OF_MEMORY, IN_LIBRARY = 55, 76  # of PETSc
NO_MEMORY_OF_MUMPS = re.compile(r"INFOG?\(1\)\s*=\s*-(5|7|13)\b")  # workspace that was not allocated
ENDING = 1  # tag of the message to rank 0 by which a rank that ends the job says that it has spoken

unfinished: set = set()  # files and folders that must not stay when the job is ended

_left_open: list = []
_private: list = []  # duplicates of communicators, for messages of this module only


def shortened(text: str) -> str:
    """A message without the middle of words, and of a text, that are longer than anybody reads."""
    text = LONG_WORD.sub(lambda word: f"{word[0][:200]}...{word[0][-40:]}", text)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 1000]} ... {text[-1000:]}"


class HpcredError(Exception):
    """Base of the errors whose text is meant for the user; `exit_status` is that of the command line."""

    exit_status = 1

    def __str__(self):
        return shortened(super().__str__())


class InputError(HpcredError, ValueError):
    """The input is at fault: the message names the file or key, what was found, what was expected."""

    exit_status = 2


class ComputationError(HpcredError, RuntimeError):
    """The input is fine as far as one can see, but the computation failed."""


def reason_of(error: BaseException) -> str | None:
    """The words of the system where it refused a file or memory (OSError, errors of HDF5); None for other errors."""
    if isinstance(error, HpcredError | BrokenPipeError):
        return None
    match = IN_HDF5.search(str(error))
    number = int(match[1]) if match else getattr(error, "errno", None)
    if number is None or (match and number == errno.EINVAL and int(match[2] or FARTHEST) >= FARTHEST):
        return None  # an address of a damaged file
    return os.strerror(number)


def is_out_of_memory(error: BaseException) -> bool:
    """Whether memory was refused to Python, PETSc or MUMPS."""
    code = getattr(error, "ierr", None)
    return isinstance(error, MemoryError) or code == OUT_OF_MEMORY or (
        code == IN_LIBRARY and NO_MEMORY_OF_MUMPS.search(str(error)) is not None
    )  # fmt: skip


@contextmanager
def agreed(comm):
    """Raise on all ranks what any rank raised inside the block. Collective at the end of the block.

    The block must not communicate: a rank that fails in it leaves early. Of several errors that of the lowest rank
    is raised.

    Parameters
    ----------
    comm : MPI communicator
        Whose ranks agree.

    Returns
    -------
    context manager
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
    if isinstance(error, Terminated):
        end_job(error)  # a launcher has no patience
    private = watched(comm)
    told = _meet(private, FINE if error is None else FAILED, None if error is None else GRACE)
    if told is None:
        end_job(error)
    if max(told) >= ELSEWHERE:
        _end_by_one(told, comm, error)
    if any(told):
        first = int(np.argmax(told))
        sent = private.bcast(sendable(error), root=first)
        if comm.rank != first:
            error, sent.__cause__ = sent, error
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
    """Return if all ranks of `comm` fail at the same place within GRACE seconds, else say the error and end the job.

    The place is the line of the `with` block that the error leaves.
    """
    if getattr(error, "failed_ranks", 1) >= comm.size:
        return
    if isinstance(error, Terminated):
        end_job(error)
    frame = sys._getframe(1).f_back or sys._getframe(1)
    place = ELSEWHERE + zlib.crc32(f"{frame.f_code.co_filename}:{frame.f_lineno}".encode())
    private = _private_of(comm)
    told = None if private is None else _meet(private, place, GRACE)
    if told is None:
        end_job(error)
    if any(told != place):
        _end_by_one(told, comm, error)
    common_to(comm, error)


def _meet(private, word: int, patience: float | None):
    """What each rank says (ranks,), or None where some have nothing to say for `patience` seconds. Collective.

    Waiting takes no time of the processor, and signals are heard.
    """
    said, told = np.array([word], np.int64), np.empty(private.size, np.int64)
    request = private.Iallgather(said, told)
    start = time.monotonic()
    if patience is not None:
        patience += 0.1 * min(private.rank, 10)  # of several that fail, one reports
    while not request.Test():
        waited = time.monotonic() - start
        if patience is not None and waited > patience:
            _left_open.append((request, said, told))  # what MPI may still write to
            return None
        if waited > 1e-3:
            time.sleep(min(waited / 20, 0.005))  # what it comes late by
    return told


def _end_by_one(told, comm, error):
    """End the job where ranks fail at several places, by the first of them; does not return."""
    if comm.rank != np.argmax(told >= ELSEWHERE):
        time.sleep(GRACE)
    end_job(error or ComputationError("another rank failed"))


def common_to(comm, error: BaseException):
    """Mark an error that all ranks of `comm` raise, so that one of them reports it; returns it."""
    error.failed_ranks, error.reported_here = comm.size, comm.rank == 0
    return error


def watched(comm):
    """The private duplicate of a communicator, made at the first call. Collective at the first call."""
    if (private := _private_of(comm)) is None:
        _private.append(private := comm.Dup())
    return private


def _private_of(comm):
    return next((duplicate for duplicate in _private if _alike(duplicate, comm)), None)


def forget(comm):
    """Free the private duplicate of a communicator that is about to be freed. Collective."""
    for duplicate in [duplicate for duplicate in _private if _alike(duplicate, comm)]:
        _private.remove(duplicate)
        duplicate.Free()


def _alike(comm, duplicate):
    return MPI.Comm.Compare(comm, duplicate) in (MPI.IDENT, MPI.CONGRUENT)


def fail(error: BaseException) -> int:
    """Report the error of a command once and return the exit status; does not return if it is not common."""
    try:
        settle(MPI.COMM_WORLD, error)
    except BaseException as another:
        end_job(another)
    if MPI.COMM_WORLD.rank == 0:
        _say(error)
    return exit_status(error)


def leave(status: int):
    """End the process of a command."""
    for number, stream in ((1, sys.stdout), (2, sys.stderr)):
        try:
            stream.flush()
        except OSError:  # told already; Python would try once more at its end, and change the exit status
            os.dup2(os.open(os.devnull, os.O_WRONLY), number)
    sys.exit(status)


def exit_status(error: BaseException) -> int:
    if isinstance(error, BrokenPipeError):  # of a standard stream, as shells say it of programs that SIGPIPE ends
        return 128 + signal.SIGPIPE
    return getattr(error, "exit_status", 130 if isinstance(error, KeyboardInterrupt) else 1)


def end_job(error: BaseException):
    """Say the error of this rank and end all ranks; does not return."""
    try:
        if not getattr(error, "reported_here", True):
            time.sleep(GRACE)  # the first rank of the group says it
        elif not (isinstance(error, Terminated) and _others_say_it()):
            _say(error, f" (rank {MPI.COMM_WORLD.rank})" if MPI.COMM_WORLD.size > 1 else "")
        for path in list(unfinished):
            with suppress(OSError):
                if path.is_dir() and not path.is_symlink():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink(missing_ok=True)
        world = _private_of(MPI.COMM_WORLD)
        if world is not None and world.rank:
            world.Isend(bytearray(1), dest=0, tag=ENDING)
    finally:
        if MPI.COMM_WORLD.size == 1:
            os._exit(exit_status(error))
        await_reader(sys.stderr)
        MPI.COMM_WORLD.Abort(exit_status(error))


def await_reader(stream, patience=1.0):
    """Wait until all that was printed into a pipe is read: a launcher may end the job before it has passed it on."""
    with suppress(OSError, ValueError, AttributeError):  # closed, or no file at all
        stream.flush()
        end = time.monotonic() + patience
        while stat.S_ISFIFO(os.fstat(stream.fileno()).st_mode) and time.monotonic() < end:
            unread = fcntl.ioctl(stream.fileno(), termios.FIONREAD, bytes(4))
            if not int.from_bytes(unread, sys.byteorder):
                return
            time.sleep(0.01)


def _others_say_it():
    """Whether another rank says why this one is terminated, as by the launcher for an error of that rank."""
    world = _private_of(MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank:
        time.sleep(3.0)  # rank 0 says it, unless it is this rank alone that is terminated
    elif world is not None:
        for _ in range(5):
            if world.Iprobe(tag=ENDING):
                return True
            time.sleep(0.02)
    return False


def _say(error, where=""):
    if getattr(error, "of_script", False) and not isinstance(error, KeyboardInterrupt):
        sys.__excepthook__(type(error), error, error.__traceback__)
        _end_with(f"this error{where} is not that of all ranks, and ends the job")
        return
    if os.environ.get("HPCRED_TRACEBACK", "").strip().lower() not in OFF:
        import traceback

        traceback.print_exception(error)
    if isinstance(error, HpcredError):
        text = f"error{where}: {error}"
    elif isinstance(error, KeyboardInterrupt):
        text = f"{'terminated' if isinstance(error, Terminated) else 'interrupted'}{where}"
    elif isinstance(error, BrokenPipeError):  # whoever read what is printed has seen enough, such as `head`
        return
    elif isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT) and error.filename is None:
        text = f"error{where}: what is printed cannot be written ({error.strerror}); make room, or print elsewhere"
    elif is_out_of_memory(error):
        text = f"error{where}: out of memory; take more ranks on more nodes, or a smaller model"
    elif isinstance(error, ImportError) or (isinstance(error, OSError) and "shared object" in str(error)):
        text = f"error{where}: {error}; a library is missing, or more memory than this process may take (ulimit -v)"
    elif reason := reason_of(error):
        text = f"error{where}: {getattr(error, 'filename', None) or 'a file'}: refused by the system ({reason})"
    else:
        lines = str(error).strip().splitlines()
        if hasattr(error, "ierr"):  # of PETSc: behind its code come the places, and at the end the reason
            lines = [", ".join(dict.fromkeys((lines[0], lines[-1])))]
        text = f"internal error{where}: {type(error).__name__}: {lines[0] if lines else ''}"
        text += " (--traceback or HPCRED_TRACEBACK=1 shows where)"
    _end_with(text)


def _end_with(text):
    with suppress(BrokenPipeError):  # nobody reads it any more; the exit status is that of the error
        message(logging.CRITICAL, text, f"hpcred: {text}")


def excepthook(kind, error, trace):
    """For scripts that use hpcred as a library: Python's report, and no rank left waiting."""
    if MPI.COMM_WORLD.size > 1:
        error.of_script = True
        settle(MPI.COMM_WORLD, error)
    if MPI.COMM_WORLD.rank == 0:
        sys.__excepthook__(kind, error, trace)


def sendable(error):
    """The error, or its text where it cannot be sent to another rank and be raised there."""
    try:
        pickle.loads(pickle.dumps(error))
        return error
    except Exception:
        return ComputationError(f"{type(error).__name__}: {error}")


LOADED = True  # all of this module, for a signal that comes while modules are loaded
