"""A fault in any function on one rank of two ends all ranks in seconds, with one sentence and without litter."""

import os
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse
from faults import ERRORS
from helpers import MODES_JOB, SIMULATION, to_dense
from launch import mpi_environment

import hpcred as package
from hpcred.files.checked import CHECKSUM

PROGRAM = Path(__file__).with_name("faults.py")
JOB = MODES_JOB + '[[basis]]\nkind = "krylov"\nfrequency = 150.0\norder = 1\n'
OUTPUTS = ("model.h5", "c.json", "result.h5", "r.json", "e.h5", "result.SID_FEM", "simulation.h5", "simulation.csv",
           "simulation.png")  # fmt: skip
COMMANDS = {
    "convert": "convert -K K.mtx -M M.mtx --nodes nodes.txt --dofs dofs.txt --inputs 20:z -o model.h5 --json c.json",
    "reduce": "reduce job.toml --json r.json",
    "evaluate": "evaluate result.h5 --full model.h5 --frequencies 10,150 -o e.h5",
    "export": "export result.h5 --format sid",
    "simulate": "simulate sim.toml",
}


def launch(folder, task, command):
    """Exit status, lines of hpcred on stderr, all of stderr, and seconds; status None where the job hangs."""
    start = time.monotonic()
    job = subprocess.Popen(
        ["mpiexec", "-n", "2", sys.executable, str(PROGRAM), task, *COMMANDS[command].split()], cwd=folder, text=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, env=mpi_environment(FAULTS_GRACE="1.5"),
    )  # fmt: skip
    try:
        told, status = job.communicate(timeout=60)[1], job.returncode
    except subprocess.TimeoutExpired:
        job.terminate()
        told, status = job.communicate()[1], None
    said = [line for line in told.splitlines() if line.startswith("hpcred: ")]
    return status, said, told, time.monotonic() - start


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    """A folder with the files that all commands read."""
    folder = tmp_path_factory.mktemp("base")
    with package.linkage() as model:
        package.write_model(folder / "model.h5", model)
        for key in "KM":
            scipy.io.mmwrite(folder / f"{key}.mtx", scipy.sparse.coo_matrix(to_dense(getattr(model, key))))
        node, direction, position = model.dofs.node, model.dofs.direction, model.dofs.position
        first = np.unique(node, return_index=True)[1]
        np.savetxt(folder / "dofs.txt", np.column_stack([node, direction + 1]), fmt="%d")
        np.savetxt(folder / "nodes.txt", np.column_stack([node[first], position[first]]), fmt="%d %.9g %.9g %.9g")
    (folder / "job.toml").write_text(JOB)
    (folder / "sim.toml").write_text(SIMULATION.replace("end = 0.05", "end = 0.002").replace("steps = 20", "steps = 2"))
    for command in COMMANDS:
        assert launch(folder, "none", command)[0] == 0, command
    return folder


def calls_of(base, command):
    """Functions that rank 1 calls in a command, with the number of calls."""
    assert launch(base, f"record={base / 'calls'}", command)[0] == 0
    return [(command, name, int(count)) for name, count in map(str.split, (base / "calls").read_text().splitlines())]


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def whole(path):
    """Whether an output that was replaced before the fault came is complete."""
    if path.suffix == ".h5":
        with h5py.File(path, "r") as file:
            return CHECKSUM in file.attrs  # the last that is written
    return path.stat().st_size > 0


def misfortunes(base, folder, command, function, call, error):
    """What is wrong after a fault, in words."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(base, folder)
    before = contents(folder)
    status, said, told, seconds = launch(folder, f"fault={function},{call},{error}", command)
    after = contents(folder)
    found = []
    if status is None or seconds > 30:  # of a busy machine; the ranks wait for 1.5 s
        found.append("hangs")
    if status == 0:
        found.append("exit status 0")
    if status is not None and (len(said) != 1 or "Traceback" in told):
        found.append(told)
    found += [f"left {name}" for name in set(after) - set(before)]
    changed = {name for name in before if after.get(name) != before[name]}
    found += [f"damaged {name}" for name in changed if name not in OUTPUTS or not whole(folder / name)]
    return [f"{command}, {function}, call {call}, {error}: {item}" for item in found]


def sample(base, commands, count, seed):
    """Faults at random functions, calls and errors."""
    found, draw = [item for command in commands for item in calls_of(base, command)], random.Random(seed)
    for command, name, calls in draw.sample(found, min(count, len(found))):
        yield command, name, draw.choice([1, calls, draw.randint(1, calls)]), draw.choice(list(ERRORS))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_fault_on_one_rank_ends_the_job(base, tmp_path, seed):
    command = list(COMMANDS)[seed - 1]
    wrong = [item for fault in sample(base, [command], 5, seed) for item in misfortunes(base, tmp_path / "t", *fault)]
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow
def test_faults_in_many_functions(base, tmp_path):
    """HPCRED_FAULTS functions, by default 100; 1000 are all of them."""
    count, seed = int(os.environ.get("HPCRED_FAULTS", "100")), int(os.environ.get("HPCRED_SEED", time.time()))
    print(f"seed {seed}")
    wrong = []
    for fault in sample(base, COMMANDS, count, seed):
        wrong += misfortunes(base, tmp_path / "t", *fault)
        print(*fault, wrong[-1:], flush=True)
    assert not wrong, "\n".join(wrong)
