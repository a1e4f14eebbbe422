"""What a run says of its steps: lines in a log, bars on a terminal, and nothing when it is quiet."""

import os
import pty
import subprocess
import sys

import pytest
from launch import mpi_environment

from hpcred.parallel import progress as module
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
