"""SIGINT and SIGTERM of a command: they leave as exceptions, or end the process where it does not come to hear them.

Python hears a signal between two of its steps, and a factorisation of an hour is one step. A child of the process,
which does nothing else, is told of signals at once, and kills a process that lives for PATIENCE seconds after one.
"""

import os
import select
import signal
from contextlib import contextmanager

PATIENCE = 8.0  # seconds; more than those that a rank waits for the others


class Terminated(KeyboardInterrupt):
    """The process was asked to end by SIGTERM."""

    exit_status = 128 + 15


def hear():
    """Have signals raise KeyboardInterrupt (SIGINT) or Terminated (SIGTERM); before MPI is loaded."""
    ear, mouth = os.pipe()
    process = os.getpid()
    if os.fork() == 0:
        try:
            os.close(mouth)
            _watch(process, ear)
        finally:
            os._exit(0)
    os.close(ear)
    os.set_blocking(mouth, False)
    signal.set_wakeup_fd(mouth, warn_on_full_buffer=False)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, _terminate)


@contextmanager
def heard_by(handler, numbers):
    """Have the handler hear the signals in the block, however long what it asks for takes."""
    mouth = signal.set_wakeup_fd(-1)
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)
        signal.set_wakeup_fd(mouth, warn_on_full_buffer=False)


def no_longer():
    """Leave signals to the operating system, for which the end of a process is no work."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)


def leave(error: KeyboardInterrupt):
    """End the process with a line, where modules are half loaded and cannot be loaded again; does not return."""
    name = "terminated" if isinstance(error, Terminated) else "interrupted"
    os.write(2, f"hpcred: {name}\n".encode())
    os._exit(getattr(error, "exit_status", 128 + signal.SIGINT))


def no_more():
    """Have further signals change nothing: the process is on its way out."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


def _terminate(*_):
    raise Terminated


def _watch(process, ear):
    """Wait for a signal of the process, and then for its end."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1):  # who reads what the process writes must see its end
        os.dup2(nowhere, descriptor)
    word = os.read(ear, 1)
    while word and word[0] not in (signal.SIGINT, signal.SIGTERM):
        word = os.read(ear, 1)
    if not word:
        return  # the process has come to its end
    while select.select([ear], [], [], PATIENCE)[0]:
        if not os.read(ear, 1):
            return
    if os.getppid() == process:
        name = "interrupted" if word[0] == signal.SIGINT else "terminated"
        os.write(2, f"hpcred: {name} in the middle of a computation\n".encode())
        os.kill(process, signal.SIGKILL)
