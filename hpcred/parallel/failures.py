"""The two errors that users meet, and the agreement of all ranks on an error."""

from contextlib import contextmanager


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

    The block must not communicate: a rank that fails in it leaves early.
    """
    error = None
    try:
        yield
    except Exception as caught:
        error = caught
    failed = comm.allgather(error is not None)
    if any(failed):
        raise comm.bcast(error, root=failed.index(True)) from error
