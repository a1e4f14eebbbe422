"""SIGINT, SIGTERM and SIGKILL end a command on all ranks in seconds, with one line and without litter."""

import os
import random
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import psutil
import pytest
import scipy.io
import scipy.sparse
from helpers import SIMULATION, to_dense
from launch import mpi_environment
from mpi4py import MPI

import hpcred as package

OPEN_MPI_5 = MPI.Get_library_version().startswith("Open MPI v5")
LONG = SIMULATION.replace("end = 0.05", "end = 1e4").replace("steps = 20", "steps = 100000")
INPUTS = ("K.mtx", "M.mtx", "model.h5", "body.h5", "job.toml", "sim.toml", "sweep.toml")
DEAF = """
from hpcred.parallel import signals
import signal
signals.PATIENCE = signals.ALONE = 0.5
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # which nohup leaves ignored, and then a rank lives on
signals.hear()
print("hears", flush=True)
sum(range(10**10))
"""


@pytest.fixture
def simulation(reduced_linkage, folder):
    """A folder with a simulation that lasts for hours."""
    pytest.importorskip("scipy_dae")
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
    found = []
    for item in psutil.Process(job.pid).children(recursive=True):
        with suppress(psutil.NoSuchProcess):
            if "hpcred" in item.cmdline() and item.parent().name().startswith(("mpiexec", "orterun", "prte")):
                found.append(item)
    return sorted(found, key=lambda item: item.pid)


def computing(job, ranks):
    """The processes of the ranks, once one is in the midst of it; the others may wait for it, asleep. A job that ends
    before is a failure."""
    while len(found := ranks_of(job) if ranks > 1 else [psutil.Process(job.pid)]) < ranks or max(
        sum(process.cpu_times()[:2]) for process in found
    ) < 2.0:  # processor seconds: the same on a busy machine
        assert job.poll() is None, job.stderr.read()
        time.sleep(0.05)
    return found


def gone(processes, seconds):
    """Whether processes end in this time (s); zombies have."""
    alive = psutil.wait_procs(processes, timeout=seconds)[1]
    return all(item.status() == psutil.STATUS_ZOMBIE for item in alive if item.is_running())


def end(job, victim, number, family=None, most=20):
    """Send a signal; what was said on stderr by hpcred, once all processes are gone, which takes at most 10 s, and 10
    more where the machine is busy. `family`: the processes that end, by default all of the job; the job itself has
    `most` seconds."""
    everyone = psutil.Process(job.pid).children(recursive=True)
    begin = time.monotonic()
    os.kill(victim, number)
    assert family is None or gone(family, 20)
    told = job.communicate(timeout=max(most, 60))[1]
    assert gone(everyone, 20)
    assert time.monotonic() - begin < most
    assert "Traceback" not in told
    return [line for line in told.splitlines() if line.startswith("hpcred: ") and "[" not in line]


@pytest.mark.parametrize("number, word", [(signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated")])
def test_one_process_ends_with_a_line(simulation, number, word):
    before = sorted(simulation.iterdir())
    job = start(simulation, 1, "simulate", "sim.toml", "--quiet")
    computing(job, 1)
    assert end(job, job.pid, number) == [f"hpcred: {word}"]
    assert job.returncode == 128 + number
    assert sorted(simulation.iterdir()) == before


@pytest.mark.parametrize("whom, number", [("launcher", signal.SIGTERM), ("rank", signal.SIGINT)])
def test_two_ranks_end_with_a_line(simulation, whom, number):
    before = sorted(simulation.iterdir())
    job = start(simulation, 2, "simulate", "sim.toml", "--quiet")
    ranks = computing(job, 2)
    told = end(job, job.pid if whom == "launcher" else ranks[1].pid, number)
    if whom == "rank":
        # on a busy machine rank 0 hears how MPI ends it
        assert set(told) - {"hpcred: terminated (rank 0)"} == {"hpcred: interrupted (rank 1)"}
    else:  # Open MPI 5 no longer passes on what ranks print once the launcher ends
        assert told == ["hpcred: terminated (rank 0)"] or (OPEN_MPI_5 and not told)
    assert job.returncode != 0
    assert sorted(simulation.iterdir()) == before


def test_a_process_that_does_not_hear_is_killed():
    job = subprocess.Popen([sys.executable, "-c", DEAF], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert job.stdout.readline() == "hears\n"
    time.sleep(0.2)
    job.send_signal(signal.SIGTERM)
    assert job.communicate(timeout=30)[1] == "hpcred: terminated in the middle of a computation\n"
    assert job.returncode == -signal.SIGKILL


@pytest.mark.parametrize("number, word", [(signal.SIGINT, "interrupted"), (signal.SIGTERM, "terminated")])
def test_a_signal_while_a_module_is_loaded_ends_with_a_line(tmp_path, number, word):
    """As modules of Fortran do, the one here makes an exception into another."""
    (tmp_path / "late.py").write_text(
        f"import os\ntry:\n    os.kill(os.getpid(), {int(number)})\n    sum(range(10**6))\n"
        "except BaseException:\n    raise ImportError('failed to import')\n"
    )
    program = "from hpcred.parallel import failures, signals\nsignals.hear()\nimport late"
    run = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=30)
    assert (run.returncode, run.stderr) == (128 + number, f"hpcred: {word}\n")


def test_a_rank_without_its_launcher_is_killed():
    """A rank that is in no place where MPI would see that its launcher is gone."""
    launch = [sys.executable, "-c", "import subprocess, sys; subprocess.run([sys.executable, '-c', sys.argv[1]])", DEAF]
    job = subprocess.Popen(launch, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                           env={**os.environ, "PMIX_RANK": "0"})  # fmt: skip
    assert job.stdout.readline() == "hears\n"
    family = psutil.Process(job.pid).children(recursive=True)
    job.kill()
    assert gone(family, 10)
    assert job.communicate()[1] == "hpcred: terminated in the middle of a computation\n"


COMMANDS = {
    "convert": "convert -K K.mtx -M M.mtx --inputs 115 -o c.h5 --json c.json", "simulate": "simulate sim.toml",
    "reduce": "reduce job.toml --json r.json",
    "evaluate": "evaluate result.h5 --full model.h5 --points 5 -o e.h5",
    "export": "export result.h5 --format sid", "recover": "recover body.h5 simulation.h5 -o motion.pvd",
    "report": "report result.h5 --full model.h5 --solves 2 --csv tables --png figures -o report.html",
    "sweep": "sweep sweep.toml --parallel 2",
}  # fmt: skip
SWEEP = 'job = "job.toml"\n[[vary]]\nkey = "damping.alpha"\nvalues = [1.0, 2.0]\n[launch]\n' \
        'launcher = "mpiexec -n {ranks}"\nranks = 2\n'  # fmt: skip


def begin(folder, command, ranks):
    return start(folder, 1 if command == "sweep" else ranks, *COMMANDS[command].split())


def wait_until_it_hears(process):
    """Until hpcred is there to hear signals: before, Python answers SIGINT itself, with a traceback."""
    hearing = 1 << (signal.SIGTERM - 1)
    while process.is_running() and process.status() != psutil.STATUS_ZOMBIE:
        caught = re.search(r"SigCgt:\s*(\w+)", Path(f"/proc/{process.pid}/status").read_text())
        if int(caught[1], 16) & hearing:
            return
        time.sleep(0.01)


def kill(folder, command, ranks, whom, number, delay):
    """A command that is sent a signal after a while (s), if it is still there; whether it was."""
    for path in (folder / "sweep").glob("*.h5"):
        path.unlink()
    job = begin(folder, command, ranks)
    time.sleep(delay)
    with suppress(psutil.NoSuchProcess, ProcessLookupError, FileNotFoundError):
        if job.poll() is None:
            if whom == "job":
                if ranks == 1 or command == "sweep":
                    wait_until_it_hears(psutil.Process(job.pid))
                end(job, job.pid, number)
                return True
            if found := ranks_of(job):
                victim, family, most = random.choice(found), None, 20
                wait_until_it_hears(victim)
                if command == "sweep":  # goes on with its other runs
                    launcher = victim.parent()
                    family, most = [launcher, *launcher.children(recursive=True)], 200
                end(job, victim.pid, number, family, most)
                return True
    job.communicate()
    return False


def finished(folder, command, ranks):
    job = begin(folder, command, ranks)
    told = job.communicate(timeout=120)[1]
    assert job.returncode == 0, told


def contents(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.slow
def test_kills_at_random_moments(reduced_linkage, folder):
    """HPCRED_KILLS of them, by default 30: processes gone, older outputs whole, and a clean second run."""
    reduced_linkage().rename(folder / "body.h5")
    simulation = SIMULATION.replace("result.h5", "body.h5")
    (folder / "sim.toml").write_text(simulation.replace("end = 0.05", "end = 0.01").replace("steps = 20", "steps = 4"))
    (folder / "sweep.toml").write_text(SWEEP)
    with package.linkage() as model:
        for key in "KM":
            scipy.io.mmwrite(folder / f"{key}.mtx", scipy.sparse.coo_matrix(to_dense(getattr(model, key))))
    lasts = {}
    for command in COMMANDS:
        for ranks in (1, 2):
            since = time.monotonic()
            finished(folder, command, ranks)
            lasts[command, ranks] = time.monotonic() - since
    before = contents(folder)
    seed, tally = int(os.environ.get("HPCRED_SEED", time.time())), Counter()
    draw = random.Random(seed)
    print(f"seed {seed}")
    while tally.total() < int(os.environ.get("HPCRED_KILLS", "30")):
        command, (ranks, whom) = draw.choice(list(COMMANDS)), draw.choice([(1, "job"), (2, "job"), (2, "rank")])
        number = draw.choice([signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
        delay = draw.uniform(0.5, lasts[command, ranks])
        print(command, ranks, whom, number.name, f"{delay:.2f} s", end=" ", flush=True)
        tally[command, ranks, whom, number.name] += kill(folder, command, ranks, whom, number, delay)
        print(tally.total(), flush=True)
        after = contents(folder)
        for name in before:
            if name.startswith("sweep/") and (name not in after or name.endswith(".log")):
                continue  # a result that was removed above, or what a run printed up to its end
            if after.get(name) != before[name]:
                assert name not in INPUTS and whole(folder / name, before[name]), name
    print(*sorted(tally.items()), sep="\n")
    for command in COMMANDS:
        finished(folder, command, 2)
    assert set(contents(folder)) == set(before)


def whole(path, before=b""):
    """Whether an output that may have been replaced is complete: some have the times in them that they took."""
    if path.suffix == ".h5":
        return bool(package.verify_file(path))
    return path.stat().st_size > 0.8 * len(before)
