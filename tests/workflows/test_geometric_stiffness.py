"""Geometric stiffness by job files."""

import numpy as np
import pytest
from helpers import block_with_ends

import hpcred
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
