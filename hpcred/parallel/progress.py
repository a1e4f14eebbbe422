"""Where the run is and where its time went: stages, shown by rank 0 when a run is long, summed for the result."""

import logging
import math
import resource
import sys
import threading
import time
import weakref
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

from .messages import message, routed
from .petsc import PETSc

SHORT = 2.0  # seconds of a run that needs no progress
LARGE = 30_000  # dofs of a model whose first factorisation may take longer than anybody waits for a line
MINUTE = 60.0  # seconds between lines of steps that are not worth one each, and of a long stage
SILENT = 10.0  # seconds without a line after which a stage says that it goes on
THREAD = "hpcred stages"
Result = TypeVar("Result")

_watched: weakref.WeakSet = weakref.WeakSet()  # runs whose stages the thread looks after
_lock = threading.Lock()


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Seconds by stage (of rank 0), seconds in all, and the largest resident memory of every rank in MB."""

    seconds: dict[str, float]
    elapsed: float
    memory_mb_per_rank: tuple[float, ...]


def memory_mb() -> float:
    """Largest resident memory of this process so far, in MB, by the operating system's account."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@dataclass(kw_only=True)
class Stage:
    """A stage that goes on: since when (s of the run); `known` returns what is known of it by now, as text, and its
    expected seconds, None where these are not known; `told`: whether that text was shown."""

    name: str
    detail: str
    begun: float
    known: Callable[[], tuple[str, float | None]] | None
    told: bool = False


class Progress:
    """Times named stages. A stage inside a stage is taken off the outer one, so the sum is the elapsed time.

    `seconds` holds the time per stage of this rank. Rank 0 gives its lines to the logger "hpcred". A thread of rank 0
    looks after stages that say nothing by themselves.

    Parameters
    ----------
    comm : MPI communicator
    show : bool, optional
        Whether lines are on stderr where the logger has no handler: True shows every line, False none. By default they
        are there once a run has lasted SHORT seconds, one a stage, and of those that come many in a stage one after
        SILENT seconds without any.
    bars : bool
        On a terminal steps are bars below the lines; call close() then.
    """

    def __init__(self, comm, show: bool | None = None, bars: bool = False):
        self.comm = comm
        self.seconds: dict[str, float] = {}
        self.warned: list[str] = []
        self._found: list[str] = []
        self._later: list[str] = []
        self._after = SHORT if show is None else 0.0 if show else math.inf
        self._brief = show is None
        self._bars = Bars() if bars and comm.rank == 0 and sys.stderr.isatty() else None
        self._begun: dict[str, float] = {}
        self._said = -math.inf
        self._open: list[Stage] = []
        self._start = self._mark = time.perf_counter()

    def _charge(self):
        now = time.perf_counter()
        name = self._open[-1].name if self._open else "other"
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._mark
        self._mark = now

    @contextmanager
    def stage(self, name: str, detail: str = "", known: Callable[[], tuple[str, float | None]] | None = None):
        """Charge the time of the block to `name`; also a PETSc log stage, so that -log_view lists it. `detail`: of the
        line at its start. `known`: see Stage; the thread calls it, so that it must not communicate."""
        self._charge()
        if detail:
            self.say(f"{name}: {detail}")
        stage = Stage(name=name, detail=detail, begun=self.elapsed(), known=known)
        self._open.append(stage)
        self._watch()
        log = PETSc.Log.Stage(name)
        log.push()
        try:
            yield
            self._tell_known(stage)
            self._tell_later()
        finally:
            log.pop()
            self._charge()
            self._open.pop()

    def _watch(self):
        """Have the thread look after the stages of this run, unless nothing is shown."""
        if self.comm.rank == 0 and self._after < math.inf:
            with _lock:
                _watched.add(self)
                if not any(thread.name == THREAD for thread in threading.enumerate()):  # none in a process that forked
                    threading.Thread(target=_look_after_all, name=THREAD, daemon=True).start()

    def look(self) -> None:
        """Say what has become known of the present stage, and that it goes on: after SILENT seconds without a line,
        then once a MINUTE."""
        stage = next(iter(self._open[-1:]), None)  # which the other thread may close meanwhile
        if stage is None or not self.shown:
            return
        self._tell_known(stage)
        now, lasted = self.elapsed(), self.elapsed() - stage.begun
        silent = now - max(self._said, stage.begun)
        if silent >= (SILENT if self._said <= stage.begun + SILENT / 2 else MINUTE):
            expected = stage.known()[1] if stage.known is not None else None
            left = f", about {in_time(expected - lasted)} left" if expected and expected > lasted else ""
            self.say(f"{_named(stage)}: {in_time(lasted)} so far{left}")

    def _tell_known(self, stage):
        """Say once what is known of a stage."""
        if stage.known is not None and not stage.told and self.shown and (text := stage.known()[0]):
            stage.told = True
            self.say(f"{_named(stage)}: {text}")

    def elapsed(self) -> float:
        """Seconds since the start, on this rank."""
        return time.perf_counter() - self._start

    @property
    def shown(self) -> bool:
        """Whether lines of this rank are read by anybody by now."""
        return self.comm.rank == 0 and (routed() or self.elapsed() >= self._after)

    def expect(self, size: int) -> None:
        """A model of `size` dofs is worked on: of a large one everything is said from the start."""
        if size >= LARGE and self._after == SHORT:
            self._after = 0.0

    def _is_due(self, patience: float) -> bool:
        """Whether a line is, after so many seconds without one."""
        return self.elapsed() - self._said >= patience

    def say(self, text: str, *, minor: bool = False) -> None:
        """One line of rank 0, `text`, with elapsed time and memory; `minor`: one of many in a stage."""
        if self.shown and not (minor and self._brief and not routed() and not self._is_due(SILENT)):
            self._said = self.elapsed()
            self._give(logging.INFO, text, f"[{self._said:8.1f} s {memory_mb():7.0f} MB] {text}")

    def step(self, what: str, done: int, total: int | None = None, always: bool = False) -> None:
        """So many of the steps `what` are done, of `total` where that is known: a bar, or a line with the time left.

        A line at most once a MINUTE; `always`: at every step, or once in SILENT seconds by default. The time left is
        that of as many steps of the same length.

        Parameters
        ----------
        what : str
            Name of the steps.
        done : int
            Steps so far.
        total : int, optional
            Steps in all.
        always : bool
            Also in short runs.
        """
        now = self.elapsed()
        if done == 0 or what not in self._begun:
            self._begun[what] = now
        if not self.shown:
            return
        if self._bars is not None:
            self._bars.step(what, done, total)
        elif done and (always and not self._brief or self._is_due(SILENT if always else MINUTE)):
            left = in_time((now - self._begun[what]) / done * (total - done)) if total else ""
            self.say(f"{what}: {done}{f' of {total}' if total else ''} done" + (f", about {left} left" if left else ""))

    def close(self) -> None:
        """Take the bars away."""
        if self._bars is not None:
            self._bars.close()

    def tell(self, text: str) -> None:
        """One line of rank 0, `text`, however short the run is, unless progress is off."""
        self._give(logging.INFO, text, text)

    def tell_later(self, text: str) -> None:
        """The same `text` once a stage has ended without an error, such as that which reads the input."""
        self._later.append(text)

    def _tell_later(self):
        while self._later:
            self.tell(self._later.pop(0))

    def warn(self, text: str) -> None:
        """Tell a warning, `text`, while a run goes on; what is `warned` of needs no repetition at its end."""
        self._give(logging.WARNING, text, f"warning: {text}")
        self.warned.append(text)

    def found(self, result: Result) -> Result:
        """Log the warnings of a `result` that are not logged yet, and return it; who shows it shows them."""
        self._tell_later()
        record = getattr(result, "record", result)
        warnings = record.get("warnings", ()) if isinstance(record, dict) else getattr(record, "warnings", ())
        for text in warnings:
            if not text.startswith((*self.warned, *self._found)):  # at the end its largest value may follow
                self._give(logging.WARNING, text, None)
                self._found.append(text)
        return result

    def _give(self, level, text, line):
        if self.comm.rank == 0:
            message(level, text, line if self._after < math.inf else None, self._bars and self._bars.line)

    def timing(self) -> Timing:
        """Where the time went until now; bars are taken away. Collective."""
        self.close()
        self._charge()
        memory = self.comm.allgather(round(memory_mb(), 1))
        seconds = {name: round(value, 4) for name, value in self.seconds.items()}
        elapsed = round(time.perf_counter() - self._start, 4)
        return self.comm.bcast(Timing(seconds=seconds, elapsed=elapsed, memory_mb_per_rank=tuple(memory)))


def _look_after_all():
    """Look after the stages of each Progress that somebody holds: one thread for all, since a program may make
    thousands of short runs."""
    while True:
        with _lock:
            held = list(_watched)
        while held:
            held.pop().look()
        time.sleep(1.0)


def _named(stage):
    return f"{stage.name}, {stage.detail}" if stage.detail else stage.name


def in_time(seconds: float) -> str:
    """Seconds in words: 40 s, 12 min, 3 h 20 min."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"


class Bars:
    """Bars of rich on a terminal, one for each kind of step, below the lines that are said. Drawn at each step only."""

    def __init__(self):
        self._display, self._tasks = None, {}

    def _start(self):
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Display

        columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
        self._display = Display(
            *columns, console=Console(stderr=True), transient=True, auto_refresh=False, redirect_stdout=False,
            redirect_stderr=False,
        )  # fmt: skip
        self._display.start()

    def line(self, text):
        """A line above the bars."""
        if self._display is None:
            print(text, file=sys.stderr, flush=True)
        else:
            self._display.console.print(text, markup=False, highlight=False, soft_wrap=True)

    def step(self, what, done, total) -> None:
        """Move the bar of `what`; a new one where it begins anew."""
        if self._display is None:
            self._start()
        if done == 0 and what in self._tasks:
            self._display.remove_task(self._tasks.pop(what))
        if what not in self._tasks:
            self._tasks[what] = self._display.add_task(what, total=total)
        self._display.update(self._tasks[what], completed=done, total=total)
        self._display.refresh()

    def close(self) -> None:
        if self._display is not None:
            self._display.stop()
            self._display, self._tasks = None, {}


def counted(count: int, one: str, more: str | None = None) -> str:
    """So many of something, in words."""
    return f"{count} {one if count == 1 else more or one + 's'}"
