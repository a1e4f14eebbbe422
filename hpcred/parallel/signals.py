"""Turn SIGINT and SIGTERM of a command into exceptions, or end the process where it cannot handle them.

Python hears a signal between two of its steps, and a factorisation of an hour is one step. A child of the process,
which does nothing else, is told of signals at once, and kills a process that lives for PATIENCE seconds after one. It
also kills a rank that its launcher leaves alone, as a rank may that MPI is just about to start.
"""

import os
import select
import signal
import sys
from contextlib import contextmanager, suppress

PATIENCE = 8.0  # seconds; more than those that a rank waits for the others
ALONE = 4.0  # seconds that a rank has to end when its launcher is gone
LAUNCHED = ("PMIX_RANK", "PMI_RANK", "OMPI_COMM_WORLD_RANK")  # in the environment of a rank


class Terminated(KeyboardInterrupt):
    """The process was asked to end by SIGTERM."""

    exit_status = 128 + 15


def hear():
    """Have signals raise KeyboardInterrupt (SIGINT) or Terminated (SIGTERM); before MPI is loaded.

    While a module is loaded they end the job at once: modules in C print an exception that comes then, and raise
    another.
    """
    ear, mouth = os.pipe()
    process, launcher = os.getpid(), None
    # with nohup it shall live on when the shell that began it ends
    if any(name in os.environ for name in LAUNCHED) and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        launcher = os.getppid()
    if os.fork() == 0:
        try:
            os.close(mouth)
            _watch(process, ear, launcher)
        finally:
            os._exit(0)
    os.close(ear)
    os.set_blocking(mouth, False)
    signal.set_wakeup_fd(mouth, warn_on_full_buffer=False)
    signal.signal(signal.SIGINT, _hear)
    signal.signal(signal.SIGTERM, _hear)


@contextmanager
def signals_to(handler, numbers):
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


def end(error: BaseException):
    """End the job for what happened while modules were loaded, as far as they are there; does not return."""
    no_more()
    failures = sys.modules.get("hpcred.parallel.failures")
    if hasattr(failures, "LOADED"):
        failures.end_job(error)
    leave(error)


def leave(error: BaseException):
    """End the process with a line, where modules are half loaded and cannot be loaded again; does not return."""
    if isinstance(error, KeyboardInterrupt):
        text = "terminated" if isinstance(error, Terminated) else "interrupted"
    else:
        last = (str(error).strip() or type(error).__name__).splitlines()[-1]
        text = f"error: hpcred cannot be loaded: {last}"
    os.write(2, f"hpcred: {text}\n".encode())
    os._exit(getattr(error, "exit_status", 128 + signal.SIGINT if isinstance(error, KeyboardInterrupt) else 1))


def no_more():
    """Have further signals change nothing: the process is on its way out."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


def _hear(number, frame):
    error = Terminated() if number == signal.SIGTERM else KeyboardInterrupt()
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            end(error)
        frame = frame.f_back
    raise error


def _watch(process, ear, launcher):
    """Wait for a signal of the process, or for the end of its launcher, and then for its own end."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1):  # who reads what the process writes must see its end
        os.dup2(nowhere, descriptor)
    patience, word = PATIENCE, None
    while word is None or word[0] not in (signal.SIGINT, signal.SIGTERM):
        if select.select([ear], [], [], None if launcher is None else 1.0)[0]:
            word = os.read(ear, 1)
            if not word:
                return  # the process has come to its end
        elif _parent_of(process) not in (launcher, None):
            patience, word = ALONE, bytes([signal.SIGTERM])
    while select.select([ear], [], [], patience)[0]:
        if not os.read(ear, 1):
            return
    if os.getppid() == process:
        name = "interrupted" if word[0] == signal.SIGINT else "terminated"
        with suppress(OSError):  # nobody reads it any more
            os.write(2, f"hpcred: {name} in the middle of a computation\n".encode())
        os.kill(process, signal.SIGKILL)


def _parent_of(process):
    """As the system says, which gives those whose parent is gone another one; None where it does not say."""
    try:
        with open(f"/proc/{process}/stat") as file:
            return int(file.read().rpartition(")")[2].split()[1])
    except OSError:
        return None
