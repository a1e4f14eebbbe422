"""SIGINT, SIGTERM and SIGKILL end a command on all ranks in seconds, with one line and without litter."""

import os
import random
import signal
import subprocess
import sys
import time

import psutil
import pytest
from helpers import SIMULATION
from launch import mpi_environment

LONG = SIMULATION.replace("end = 0.05", "end = 1e4").replace("steps = 20", "steps = 100000")
DEAF = """
from hpcred.parallel import signals
signals.PATIENCE = 0.5
signals.hear()
print("hears", flush=True)
sum(range(10**12))
"""


@pytest.fixture
def simulation(reduced_linkage, folder):
    """A folder with a simulation that lasts for hours."""
    reduced_linkage()
    (folder / "sim.toml").write_text(LONG)
    return folder


def start(folder, ranks, *arguments):
    launcher = ["mpiexec", "-n", str(ranks)] if ranks > 1 else []
    return subprocess.Popen(
        [*launcher, sys.executable, "-m", "hpcred", *arguments], cwd=folder, text=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=mpi_environment(),
    )  # fmt: skip


def ranks_of(job):
    """The processes of the ranks, not those that watch over them, by pid."""
    children = psutil.Process(job.pid).children()
    return sorted((item for item in children if "hpcred" in item.cmdline()), key=lambda item: item.pid)


def end(job, victim, number):
    """Send a signal; what was said on stderr by hpcred, once all processes are gone, which takes at most 10 s."""
    family = psutil.Process(job.pid).children(recursive=True)
    os.kill(victim, number)
    begin = time.monotonic()
    told = job.communicate(timeout=60)[1]
    alive = psutil.wait_procs(family, timeout=10)[1]
    assert not [item for item in alive if item.status() != psutil.STATUS_ZOMBIE]
    assert time.monotonic() - begin < 20  # 10 s, and 10 more where the machine is busy
    assert "Traceback" not in told
    return [line for line in told.splitlines() if line.startswith("hpcred: ") and "[" not in line]


@pytest.mark.parametrize("number, word", [(signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated")])
def test_one_process_ends_with_a_line(simulation, number, word):
    before = sorted(simulation.iterdir())
    job = start(simulation, 1, "simulate", "sim.toml", "--quiet")
    time.sleep(3)
    assert end(job, job.pid, number) == [f"hpcred: {word}"]
    assert job.returncode == 128 + number
    assert sorted(simulation.iterdir()) == before


@pytest.mark.parametrize("whom, number", [("launcher", signal.SIGTERM), ("rank", signal.SIGINT)])
def test_two_ranks_end_with_a_line(simulation, whom, number):
    before = sorted(simulation.iterdir())
    job = start(simulation, 2, "simulate", "sim.toml", "--quiet")
    time.sleep(4)
    told = end(job, job.pid if whom == "launcher" else ranks_of(job)[1].pid, number)
    assert told == ["hpcred: terminated (rank 0)" if whom == "launcher" else "hpcred: interrupted (rank 1)"]
    assert job.returncode != 0
    assert sorted(simulation.iterdir()) == before


def test_a_process_that_does_not_hear_is_killed():
    job = subprocess.Popen([sys.executable, "-c", DEAF], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert job.stdout.readline() == "hears\n"
    time.sleep(0.2)
    job.send_signal(signal.SIGTERM)
    assert job.communicate(timeout=30)[1] == "hpcred: terminated in the middle of a computation\n"
    assert job.returncode == -signal.SIGKILL


@pytest.mark.slow
def test_kills_at_random_moments(reduced_linkage, folder):
    """HPCRED_KILLS of them, by default 30: processes gone, older outputs whole, and a clean second run."""
    reduced_linkage()
    (folder / "sim.toml").write_text(SIMULATION.replace("end = 0.05", "end = 0.01").replace("steps = 20", "steps = 4"))
    commands = (
        "reduce job.toml", "evaluate result.h5 --full model.h5 --points 5 -o e.h5", "export result.h5 --format sid",
        "simulate sim.toml",
    )  # fmt: skip
    seed = int(os.environ.get("HPCRED_SEED", time.time()))
    draw = random.Random(seed)
    print(f"seed {seed}")
    for _ in range(int(os.environ.get("HPCRED_KILLS", "30"))):
        command, whom = draw.choice(commands), draw.choice(["launcher", "rank"])
        number, delay = draw.choice([signal.SIGINT, signal.SIGTERM, signal.SIGKILL]), draw.uniform(0.3, 4.0)
        print(command, whom, number, delay, flush=True)
        job = start(folder, 2, *command.split())
        time.sleep(delay)
        ranks = ranks_of(job) if job.poll() is None else []
        if job.poll() is None and (ranks or whom == "launcher"):
            end(job, job.pid if whom == "launcher" else draw.choice(ranks).pid, number)
        job.communicate()
        for name in ("model.h5", "result.h5"):
            assert subprocess.run(
                [sys.executable, "-m", "hpcred", "info", name], cwd=folder, capture_output=True
            ).returncode == 0  # fmt: skip
    for command in commands:
        job = start(folder, 2, *command.split())
        assert job.communicate()[0] is None and job.returncode == 0
    assert not list(folder.glob("*.tmp-*"))
