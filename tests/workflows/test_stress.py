"""Stress modes in result.h5 by the key `stress` of a job."""

import numpy as np
import pytest
from foreign import gathered

import hpcred
from hpcred.parallel.failures import InputError

JOB = """model = "crank.h5"
output = "r.h5"
inputs = [[1, "x"], [7, "z"]]
%s
[frame]
kind = "buckens"
[[basis]]
kind = "modes"
count = 9
"""


def job(folder, comm, lines, **properties):
    with hpcred.crank(600, comm=comm) as model, model.with_fields(**properties) as changed:
        hpcred.write_model(folder / "crank.h5", changed)
    if comm.rank == 0:
        (folder / "job.toml").write_text(JOB % lines)
    comm.Barrier()
    return folder / "job.toml"


@pytest.mark.mpi
def test_a_job_writes_stresses_of_all_nodes_or_of_some(comm, folder):
    """They are those of the basis in the same file, whatever the rank."""
    hpcred.reduce_job(job(folder, comm, "stress = true"), comm=comm)
    result = hpcred.read_result(folder / "r.h5", comm)
    found = result.stress_modes()
    with hpcred.read_model(folder / "crank.h5", comm) as model:
        from hpcred.files.result_file import read_basis

        basis = read_basis(folder / "r.h5", model)
        own = hpcred.stress_modes(model, basis)
        basis.destroy()
    node, stress = gathered(comm, own.node)[0], np.concatenate(comm.allgather(own.stress), axis=1)
    assert np.array_equal(found.node, node) and found.source == own.source and result.reduced.record.warnings == ()
    assert np.allclose(found.stress, stress, rtol=0, atol=1e-9 * np.abs(stress).max())
    some = result.stress_modes([17, 3])
    assert some.node.tolist() == [3, 17] and np.array_equal(some.stress, found.stress[:, [2, 16]])
    with pytest.raises(InputError, match=r"r.h5: no stress of node 9999; it has those of \d+ nodes"):
        result.stress_modes([3, 9999])
    comm.Barrier()
    hpcred.reduce_job(folder / "job.toml", overrides=['stress=["SMALL_EYE", 1]', "output='s.h5'"], comm=comm)
    few = hpcred.read_result(folder / "s.h5", comm).stress_modes()
    assert few.node[0] == 1 and 3 < len(few.node) < len(node)
    scale = np.abs(stress).max()
    same = np.abs(few.stress) - np.abs(found.stress[:, np.searchsorted(node, few.node)])  # signs of modes are free
    assert np.abs(same).max() < 1e-6 * scale


@pytest.mark.mpi
def test_results_without_stresses_say_how_to_get_them(comm, folder):
    hpcred.reduce_job(job(folder, comm, ""), comm=comm)
    with pytest.raises(InputError, match=r"r.h5: no stress modes; reduce with stress = true, or let the"):
        hpcred.read_result(folder / "r.h5", comm).stress_modes()


@pytest.mark.mpi(ranks=(1, 3), build="real")
def test_models_without_materials_are_refused_before_the_reduction(comm, folder):
    path = job(folder, comm, "stress = true", properties=None)
    with pytest.raises(InputError, match=r"crank.h5: stress: found elements whose types and materials are not known"):
        hpcred.reduce_job(path, comm=comm)
    with pytest.raises(InputError, match=r"stress: crank.h5 has no node set 'EYE'; it has BIG_EYE, SMALL_EYE"):
        hpcred.reduce_job(job(folder, comm, 'stress = ["EYE"]'), comm=comm)
    assert not (folder / "r.h5").exists()


@pytest.mark.parametrize(("lines", "says"), [
    ("stress = true\nwrite_basis = false", r"stress: found it with write_basis = false; stresses belong to the basis"),
    ("stress = []", r"stress: found an empty list, expected nodes and names of node sets, true or false"),
    ("stress = [0]", r"stress: found 0, expected 1 to 2147483647|stress: found 0, expected 1 to 2.147"),
    ("stress = [1.5]", r"stress"), ('stress = "A"', r"stress"),
])  # fmt: skip
def test_other_values_of_the_key_are_refused(tmp_path, lines, says):
    (tmp_path / "job.toml").write_text(JOB % lines)
    with pytest.raises(InputError, match=says):
        hpcred.read_job(tmp_path / "job.toml")
