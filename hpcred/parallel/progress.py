"""Where the run is and where its time went: stages, shown by rank 0 when a run is long, summed for the result."""

import resource
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass

from .petsc import PETSc

SHORT = 2.0  # seconds of a run that needs no progress


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Seconds by stage (of rank 0), seconds in all, and the largest resident memory of every rank in MB."""

    seconds: dict[str, float]
    elapsed: float
    memory_mb_per_rank: tuple[float, ...]


def memory_mb() -> float:
    """Largest resident memory of this process so far, in MB, by the operating system's account."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


class Progress:
    """Times named stages. A stage inside a stage is taken off the outer one, so the sum is the elapsed time.

    `seconds` holds the time per stage of this rank. `show`: lines on stderr of rank 0, by default once a run has
    lasted SHORT seconds.
    """

    def __init__(self, comm, show: bool | None = None):
        self.comm = comm
        self.seconds: dict[str, float] = {}
        self._after = SHORT if show is None else 0.0 if show else float("inf")
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

    def elapsed(self) -> float:
        """Seconds since the start, on this rank."""
        return time.perf_counter() - self._start

    def say(self, text: str):
        """One line of rank 0, with elapsed time and memory."""
        elapsed = time.perf_counter() - self._start
        if self.comm.rank == 0 and elapsed >= self._after:
            print(f"[{elapsed:8.1f} s {memory_mb():7.0f} MB] {text}", file=sys.stderr, flush=True)

    def tell(self, text: str):
        """One line of rank 0, however short the run is, unless progress is off."""
        if self.comm.rank == 0 and self._after < float("inf"):
            print(text, file=sys.stderr, flush=True)

    def timing(self) -> Timing:
        """Where the time went until now. Collective."""
        self._charge()
        memory = self.comm.allgather(round(memory_mb(), 1))
        seconds = {name: round(value, 4) for name, value in self.seconds.items()}
        elapsed = round(time.perf_counter() - self._start, 4)
        return self.comm.bcast(Timing(seconds=seconds, elapsed=elapsed, memory_mb_per_rank=tuple(memory)))
