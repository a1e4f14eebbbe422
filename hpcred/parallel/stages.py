"""Where the run is and where its time went: stages, shown by rank 0 on a terminal, summed for the result."""

import os
import resource
import sys
import time
from contextlib import contextmanager

from .petsc import PETSc


def memory_mb() -> float:
    """Largest resident memory of this process so far, in MB, by the operating system's account."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _on_terminal():
    """Whether somebody watches: stderr, or that of the launcher that reads it through a pipe, is a terminal."""
    if sys.stderr.isatty():
        return True
    try:
        launched = "OMPI_COMM_WORLD_SIZE" in os.environ or "PMI_SIZE" in os.environ
        return launched and os.readlink(f"/proc/{os.getppid()}/fd/2").startswith(("/dev/pts", "/dev/tty"))
    except OSError:
        return False


class Progress:
    """Times named stages. A stage inside a stage is taken off the outer one, so the sum is the elapsed time.

    `seconds` holds the time per stage of this rank; `show=None` shows lines only if stderr is a terminal.
    """

    def __init__(self, comm, show: bool | None = None):
        self.comm = comm
        self.seconds: dict[str, float] = {}
        self._show = comm.rank == 0 and (_on_terminal() if show is None else show)
        self._open: list[str] = []
        self._start = self._mark = time.perf_counter()

    def _charge(self):
        now = time.perf_counter()
        name = self._open[-1] if self._open else "other"
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._mark
        self._mark = now

    @contextmanager
    def stage(self, name: str, detail: str = ""):
        """Charge the time of the block to `name`; also a PETSc log stage, so that -log_view lists it."""
        self._charge()
        self._open.append(name)
        log = PETSc.Log.Stage(name)
        log.push()
        if detail:
            self.say(f"{name}: {detail}")
        try:
            yield
        finally:
            log.pop()
            self._charge()
            self._open.pop()

    def move(self, source: str, target: str, seconds: float):
        """Charge `seconds` that were measured inside stage `source` to `target` instead."""
        self._charge()
        self.seconds[source] = self.seconds.get(source, 0.0) - seconds
        self.seconds[target] = self.seconds.get(target, 0.0) + seconds

    def say(self, text: str):
        """One line on the terminal of rank 0, with elapsed time and memory."""
        if self._show:
            elapsed = time.perf_counter() - self._start
            print(f"[{elapsed:8.1f} s {memory_mb():7.0f} MB] {text}", file=sys.stderr, flush=True)

    def summary(self) -> dict:
        """Seconds per stage (rank 0), elapsed seconds and the largest memory of any rank in MB. Collective."""
        self._charge()
        memory = self.comm.allgather(memory_mb())
        seconds = {name: round(value, 4) for name, value in self.seconds.items()}
        return self.comm.bcast(
            {
                "seconds": seconds,
                "elapsed": round(time.perf_counter() - self._start, 4),
                "memory_mb_per_rank": [round(value, 1) for value in memory],
            }
        )
