"""Geometric stiffness by job files."""

import json

import numpy as np
import pytest
import scipy.linalg
from helpers import block_with_ends, refused

import hpcred
from hpcred.cli.main import run
from hpcred.parallel.failures import InputError

JOB = """
model = "model.h5"
geometric_stiffness = true
body_origin = [0.01, 0.0, 0.0]
[frame]
kind = "buckens"
[[interface]]
name = "left"
nodes = {box = [[-1e-6, -1.0, -1.0], [1e-6, 1.0, 1.0]]}
[[interface]]
name = "right"
nodes = {box = [[0.059999, -1.0, -1.0], [0.060001, 1.0, 1.0]]}
[[basis]]
kind = "modes"
count = 4
"""


@pytest.mark.mpi
def test_a_job_makes_what_python_does(comm, folder):
    with block_with_ends(comm) as model:
        hpcred.write_model(folder / "model.h5", model)
        with hpcred.reduce(model, [hpcred.Modes(count=4)], hpcred.Buckens()) as rom:
            wanted = hpcred.geometric_stiffness(model, rom.columns, hpcred.Buckens(), origin=(0.01, 0.0, 0.0))
    if comm.rank == 0:
        (folder / "job.toml").write_text(JOB)
    comm.Barrier()
    hpcred.reduce_job(folder / "job.toml", comm=comm)
    found = hpcred.read_result(folder / "result.h5", comm).geometric_stiffness
    assert found.states == wanted.states and found.origin.tolist() == [0.01, 0.0, 0.0]
    sizes = np.abs(wanted.matrices).max(axis=(1, 2), keepdims=True)
    assert (np.abs(np.abs(found.matrices) - np.abs(wanted.matrices)) < 1e-6 * sizes).all()


@pytest.mark.mpi
def test_bodies_without_stresses_are_refused_before_the_reduction(comm, folder):
    with hpcred.linkage(comm) as model:
        hpcred.write_model(folder / "model.h5", model)
    if comm.rank == 0:
        (folder / "job.toml").write_text(JOB)
    comm.Barrier()
    with pytest.raises(InputError, match=r"^geometric stiffness: model.h5: stress: found line, expected solids"):
        hpcred.reduce_job(folder / "job.toml", comm=comm, overrides=['inputs=[[20, "z"]]', "interface=[]"])
    assert not (folder / "result.h5").exists()


def test_commands_at_a_preload(folder, capsys):
    """modes, response, evaluate and export have the same stiffening."""
    with hpcred.solid((6, 1, 1), (0.06, 0.004, 0.003), 3, False) as model:
        hpcred.write_model(folder / "model.h5", model)
    model, result = str(folder / "model.h5"), str(folder / "result.h5")
    job = JOB.replace('"buckens"', '"chord"\nnodes = [1, 25, 3]').replace("count = 4", "count = 20")
    (folder / "job.toml").write_text(job.replace("body_origin = [0.01, 0.0, 0.0]", ""))
    hpcred.reduce_job(folder / "job.toml")
    preload = "{omega = [0, 0, 6000], acceleration = [0, 500, 0]}"
    numbers = folder / "numbers.json"
    assert run(["modes", model, "--frame", "chord:1,25,3", "--preload", preload, "--json", str(numbers)]) == 0
    whole = np.array(json.loads(numbers.read_text())["frequencies_hz"])
    assert run(["modes", model, "--frame", "chord:1,25,3", "--json", str(numbers)]) == 0
    plain = np.array(json.loads(numbers.read_text())["frequencies_hz"])
    assert run(["evaluate", result, "--band", "0,100", "--preload", preload, "--json", str(numbers)]) == 0
    found = json.loads(numbers.read_text())
    assert "pseudo-frequencies at the preload (Hz): " in capsys.readouterr().out
    assert found["pseudo_frequencies_hz"][:4] == pytest.approx(whole[:4], rel=2e-3)
    assert np.abs(whole / plain - 1)[:4].max() > 0.02
    arguments = ["response", model, "--frame", "chord:1,25,3", "--frequencies", "0,50", "--inputs", "13:z"]
    assert run([*arguments, "--preload", preload, "--json", str(numbers)]) == 0
    loaded = json.loads(numbers.read_text())["norm"]
    assert run([*arguments, "--json", str(numbers)]) == 0
    assert np.abs(np.array(loaded) / json.loads(numbers.read_text())["norm"] - 1).max() > 0.01
    assert run(["export", result, "--format", "npz", "-o", str(folder / "k.npz"), "--preload", preload]) == 0
    with np.load(folder / "k.npz") as arrays:
        squares = scipy.linalg.eigvalsh(arrays["K"], arrays["M"])
    assert np.sqrt(squares[:4]) / 2 / np.pi == pytest.approx(found["pseudo_frequencies_hz"][:4], rel=1e-9)


def test_preloads_that_a_command_does_not_take(folder, capsys):
    with (
        hpcred.solid((2, 1, 1), None, 3, False) as model,
        hpcred.reduce(model, hpcred.Modes(count=8), hpcred.Buckens()) as rom,
    ):
        rom.save(folder / "r.h5")
        hpcred.write_model(folder / "m.h5", model)
    result, model = str(folder / "r.h5"), str(folder / "m.h5")
    says = refused(capsys, "evaluate", result, "--full", model, "--preload", "{omega = [0, 0, 1]}")
    assert "--preload: cannot be combined with --full, which is without load" in says
    says = refused(capsys, "evaluate", result, "--preload", "{omega = [0, 0, 1]}")
    assert "preload: the result has no geometric stiffness; reduce with geometric_stiffness = true" in says
    assert "is a free body" in refused(capsys, "modes", model, "--preload", "{omega = [0, 0, 1]}")
