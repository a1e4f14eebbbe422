"""Run named command lines beside each other, and tell how each ended; none outlives its parent."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import deque
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from ..files.locks import begin
from ..files.room import NoRoom, free_bytes
from ..files.system_errors import open_input, writing_to
from ..parallel.failures import HpcredError, InputError
from ..parallel.signals import signals_to
from ..parallel.stopping import Stopped

# Has Linux send SIGTERM when the parent is gone, whatever it died of, and becomes the command. Not done between fork
# and exec of this process: one with much memory may be refused the fork, and yet not a start of something small.
_END_WITH_PARENT = """
import ctypes, os, sys
ctypes.CDLL(None).prctl(1, 15)
if os.getppid() == int(sys.argv[1]):
    os.execvp(sys.argv[2], sys.argv[2:])
"""

LOG = "# hpcred sweep: what a run of it prints"  # the first line of a log
A_PAGE = 2**12  # bytes: with less no line more is printed into a file
PATIENCE = 5.0  # seconds that a process has to end after SIGTERM, before it is killed
LOOK = 0.05  # seconds between two looks at the processes
UNBOUND = {  # several launchers at once would each put their ranks on the first cores
    "OMPI_MCA_hwloc_base_binding_policy": "none", "PRTE_MCA_hwloc_default_binding_policy": "none", "I_MPI_PIN": "0",
    "HYDRA_BINDING": "none",
}  # fmt: skip
# modules do not come from the working folder, which may be another user's; ranks elsewhere may lack the variable, and
# Python 3.10 the option
SAFE = {"PYTHONSAFEPATH": "1"}
SAFELY = ["-P"] if sys.version_info >= (3, 11) else []
HPCRED = [sys.executable, *SAFELY, "-m", "hpcred"]
AS_ROOT = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}  # who is root here wants it there


class Interrupted(HpcredError):
    """The command was told to end, and ended its children first."""

    def __init__(self, number):
        super().__init__(f"ended by {signal.Signals(number).name}; the same command goes on with what is left")
        self.exit_status = 128 + number


@dataclass
class Child:
    """A command with the file for what it prints; once it has ended its `status` (negative: a signal) and `seconds`."""

    name: str
    command: list[str]
    log: Path
    status: int | None = None
    seconds: float = 0.0
    begun: float = 0.0
    process: subprocess.Popen | None = field(default=None, repr=False)

    @property
    def met_full_disk(self) -> bool:
        """Whether it failed for want of room, also for what it prints."""
        return self.status == NoRoom.exit_status or bool(self.status and free_bytes(self.log.parent) < A_PAGE)

    @property
    def last_line(self) -> str:
        """The last sentence of hpcred in the log, or else the last line that has words."""
        with suppress(OSError, InputError), open_input(self.log, "r", encoding="utf-8", errors="replace") as file:
            lines = [line.strip() for line in file.read().splitlines()]
            lines = [line for line in lines if any(map(str.isalnum, line)) and line != LOG]
            own = [line for line in lines if line.startswith("hpcred: ")]
            if not own and self.met_full_disk:
                return f"hpcred: error: {self.log}: the disk is full: what the run printed had no room; make room"
            return (own or lines or [""])[-1]
        return ""


def run_all(children, at_once: int = 1, environment=None, wanted=None, again=None, ended=None, waiting=None):
    """Run the children, so many at the same time, in the order of the list; each is a session of its own.

    `wanted(child)` is asked right before one is begun: one that is not wanted has ended then, and where the answer is
    None it is asked again later. `again(child)` says of one that has ended whether it is to be begun once more, behind
    the others. `ended(child)` is called when one has ended, and says whether no other is to be begun: those that are
    left keep their status None. `waiting(running)` is called with those under way at every look.

    SIGINT and SIGTERM end all of them within seconds and raise Interrupted; SIGUSR1 is handed on to them, no other is
    started, and Stopped is raised when they have ended. Where this process is killed the system ends them.
    """
    here = os.path.samefile(Path(__file__).parents[2], os.curdir)  # where Python finds hpcred itself
    environment = {
        **({} if here else SAFE), **os.environ, **(UNBOUND if at_once > 1 else {}), **({} if os.geteuid() else AS_ROOT),
        **(environment or {}),
    }  # fmt: skip
    left, running, passed_on = deque(children), [], False
    with _noted() as noted:
        try:
            while running or (left and not passed_on):
                if ending := noted & {signal.SIGINT, signal.SIGTERM}:
                    raise Interrupted(min(ending))
                if signal.SIGUSR1 in noted and not passed_on:
                    passed_on = True
                    for child in running:
                        child.process.send_signal(signal.SIGUSR1)
                for _ in range(len(left)):
                    if len(running) >= at_once or passed_on:
                        break
                    child = left.popleft()
                    begin = True if wanted is None else wanted(child)
                    if begin:
                        running.append(_start(child, environment))
                        continue
                    if begin is None:
                        left.append(child)
                        continue
                    child.status = 0
                    if ended is not None:
                        ended(child)
                for child in [child for child in running if child.process.poll() is not None]:
                    running.remove(child)
                    child.status, child.seconds = child.process.returncode, time.monotonic() - child.begun
                    if again is not None and again(child):
                        left.append(child)
                    elif ended is not None and ended(child):
                        left.clear()
                if waiting is not None:
                    waiting(running)
                time.sleep(LOOK)
        finally:
            end(running)
    if passed_on:
        raise Stopped("stopped as asked; the same command goes on with what is left")


@contextmanager
def _noted():
    """Collect the signals that come meanwhile."""
    noted = set()
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)
    with signals_to(lambda number, _: noted.add(number), numbers):
        yield noted


def _start(child, environment):
    child.begun = time.monotonic()
    with writing_to(child.log):
        check_log(child.log)
        begin(child.log)
        child.log.write_text(f"{LOG}\n", encoding="utf-8")
    with open(child.log, "ab") as log:  # of another sweep in this folder nothing is written over
        child.process = subprocess.Popen(
            [*_ending_with_parent(), *child.command], stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
            env=environment, start_new_session=True,
        )  # fmt: skip
    return child


def check_log(path):
    """Raise InputError where a file with the name of a log is none of a sweep."""
    if os.path.isfile(path) and not os.path.islink(path):  # a link is replaced by a file
        with open_input(path) as file:
            start = file.read(len(LOG))
        if start not in (b"", LOG.encode()):
            raise InputError(f"output {path}: found a file that is no log of a sweep; move it or choose another output")


def _ending_with_parent():
    if sys.platform != "linux":
        return []
    return [sys.executable, "-I", "-S", "-c", _END_WITH_PARENT, str(os.getpid())]


def end(children):
    """End the processes and what they started: SIGTERM to each, SIGKILL to what is left after PATIENCE seconds."""
    family, deadline = [], time.monotonic() + PATIENCE
    for child in children:
        with suppress(psutil.NoSuchProcess):
            family += psutil.Process(child.process.pid).children(recursive=True)
        child.process.terminate()  # a launcher ends its ranks itself
    for child in children:  # by their own status, which waiting for them by psutil would take away
        with suppress(subprocess.TimeoutExpired):
            child.process.wait(max(deadline - time.monotonic(), 0.0))
    _, alive = psutil.wait_procs(family, timeout=max(deadline - time.monotonic(), 0.0))
    for process in [*alive, *(child.process for child in children)]:
        with suppress(psutil.NoSuchProcess):
            process.kill()
    for child in children:
        child.status = child.process.wait()
