"""What a run says of its steps: lines in a log, bars on a terminal, and nothing when it is quiet."""

import os
import pty
import subprocess
import sys
import threading
import time

import pytest
from launch import mpi_environment

import hpcred
from hpcred.linalg.solvers.shifted import ShiftedSolver
from hpcred.parallel import progress as module
from hpcred.parallel.petsc import PETSc, without_gil
from hpcred.parallel.progress import LARGE, Progress, in_time


@pytest.fixture
def clock(monkeypatch):
    """Time that passes when a test says so."""
    now = [100.0]
    monkeypatch.setattr(module.time, "perf_counter", lambda: now[0])

    def wait(seconds):
        now[0] += seconds

    return wait


def test_a_line_a_minute_with_the_time_left(comm, capsys, clock):
    progress = Progress(comm, show=True)
    for done in range(5):
        progress.step("blocks", done, 10)
        clock(40.0)
    said = [line.partition("] ")[2] for line in capsys.readouterr().err.splitlines()]
    assert said == ["blocks: 1 of 10 done, about 6 min left", "blocks: 3 of 10 done, about 5 min left"]


def test_steps_without_a_known_end_have_no_time_left(comm, capsys, clock):
    progress = Progress(comm, show=True)
    progress.step("points", 0)
    clock(90.0)
    progress.step("points", 1)
    assert capsys.readouterr().err.endswith("] points: 1 done\n")


def test_short_runs_say_nothing_and_large_models_at_once(comm, capsys, clock):
    progress = Progress(comm)
    progress.expect(LARGE - 1)
    progress.say("short")
    progress.expect(LARGE)
    progress.say("large")
    quiet = Progress(comm, show=False)
    quiet.expect(LARGE)
    quiet.say("quiet")
    assert [line.partition("] ")[2] for line in capsys.readouterr().err.splitlines()] == ["large"]


def test_one_thread_looks_after_all_runs(comm):
    """One for each would meet the limit of a container where a program makes thousands of them."""
    before, runs = threading.active_count(), [Progress(comm) for _ in range(20)]
    for run in runs:
        with run.stage("read"):
            pass
    assert threading.active_count() <= before + 1


@pytest.mark.parametrize("seconds, words", [(0.4, "0 s"), (99, "99 s"), (720, "12 min"), (12000, "3 h 20 min")])
def test_times_in_words(seconds, words):
    assert in_time(seconds) == words


def test_bars_on_a_terminal():
    program = (
        "from mpi4py import MPI\nfrom hpcred.parallel.progress import Progress\n"
        "p = Progress(MPI.COMM_SELF, show=True, bars=True)\n"
        "for i in range(3):\n    p.step('points', i, 2)\n    p.say('a line')\np.close()\n"
    )
    master, slave = pty.openpty()
    run = subprocess.run([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=slave, timeout=60,
                         env=mpi_environment(TERM="xterm", COLUMNS="100"))  # fmt: skip
    os.close(slave)
    shown = os.read(master, 100_000).decode()
    os.close(master)
    assert run.returncode == 0 and not run.stdout
    assert "points" in shown and "2/2" in shown and shown.count("a line") == 3


def said(capsys):
    return [line.partition("] ")[2] for line in capsys.readouterr().err.splitlines()]


def test_a_silent_stage_says_that_it_goes_on_and_what_is_known_of_it(comm, capsys, clock):
    """After ten seconds, then once a minute; operations as soon as the analysis has them."""
    progress, told = Progress(comm, show=True), [""]
    with progress.stage("factor", "30 Hz", lambda: (told[-1], None)):
        for seconds, text in ((9, ""), (2, ""), (20, "2.0e+10 operations"), (41, ""), (20, "")):
            clock(seconds)
            told.append(text)
            progress.look()
    assert said(capsys) == [
        "factor: 30 Hz", "factor, 30 Hz: 11 s so far", "factor, 30 Hz: 2.0e+10 operations",
        "factor, 30 Hz: 92 s so far",
    ]  # fmt: skip


def test_the_time_left_of_a_factor_is_that_of_the_one_before(comm, capsys, clock):
    progress = Progress(comm, show=True)
    with progress.stage("factor", "30 Hz", lambda: ("2.0e+10 operations", 60.0)):
        progress.look()
        clock(20)
        progress.look()
    assert said(capsys)[1:] == ["factor, 30 Hz: 2.0e+10 operations", "factor, 30 Hz: 20 s so far, about 40 s left"]


def test_other_threads_run_while_a_factor_is_made(comm):
    """By petsc4py's own call they do not, and nothing could be said."""
    ticks, done = [], threading.Event()

    def tick():
        while not done.wait(0.01):
            ticks.append(time.perf_counter())

    with hpcred.solid((20, 8, 8), (1.0, 0.4, 0.4), comm=comm) as model:
        solver = ShiftedSolver(model)
        other = threading.Thread(target=tick)
        other.start()
        start = time.perf_counter()
        solver.factor(0.0)
        end = time.perf_counter()
        done.set()
        other.join()
        solver.close()
    during = sum(start < at < end for at in ticks)
    assert during >= (end - start) / 0.05, (during, end - start)


def test_an_error_of_petsc_is_raised_by_a_call_without_the_interpreter():
    ksp = PETSc.KSP().create(PETSc.COMM_SELF)
    ksp.getPC().setType("cholesky")
    with pytest.raises(PETSc.Error) as raised:
        without_gil("KSPSetUp", ksp)
    assert raised.value.ierr == 73  # of the wrong state; PETSc 3.26 has the trace no longer in the text


def test_of_many_lines_in_a_stage_one_is_shown_in_ten_seconds_unless_all_are_asked_for(comm, capsys, clock):
    for show, expected in ((None, ["factor: 0 Hz", "block 3", "points: 4 of 9 done, about 15 s left"]),
                           (True, ["factor: 0 Hz", *(f"block {j}" for j in range(4)), *(["points"] * 4)])):  # fmt: skip
        progress = Progress(comm, show=show)
        progress.expect(LARGE)
        with progress.stage("factor", "0 Hz"):
            for j in range(4):
                clock(3.0)
                progress.say(f"block {j}", minor=True)
        for done in range(5):
            progress.step("points", done, 9, always=True)
            clock(3.0)
        found = said(capsys)
        assert found == expected if show is None else [line.partition(":")[0] if "points" in line else line
                                                       for line in found] == expected  # fmt: skip
