"""Reduced models that were made by hand, with numbers that are none."""

from dataclasses import replace

import numpy as np
import pytest

import hpcred
from hpcred.formats.body_npz import write_npz
from hpcred.formats.exudyn import write_exudyn
from hpcred.formats.matlab import write_matlab
from hpcred.formats.mbdyn import write_mbdyn
from hpcred.formats.superelement import superelement
from hpcred.multibody.body import body_of
from hpcred.parallel.failures import InputError

WAYS = {
    "sid": lambda path, body: hpcred.write_sid(path, body),
    "npz": lambda path, body: write_npz(path, body),
    "matlab": lambda path, body: write_matlab(path, body),
    "exudyn": lambda path, body: write_exudyn(path, body),
    "mbdyn": lambda path, body: write_mbdyn(path, body),
    "fmu": lambda path, body: hpcred.write_fmu(path, body.reduced),
    "state space": lambda path, body: hpcred.state_space(body.reduced),
    "superelement": lambda path, body: superelement(replace(body.reduced, interfaces=(None,))),
    "simulation": lambda path, body: hpcred.simulate(body, hpcred.Simulation(end=0.01, steps=2)),
    "response": lambda path, body: hpcred.frequency_response(body.reduced, [1.0]),
}


@pytest.fixture(scope="module")
def body():
    with (
        hpcred.linkage() as model,
        model.with_inputs([(20, "z")]) as loaded,
        hpcred.reduce(loaded, [hpcred.Modes(count=2)], hpcred.Buckens()) as rom,
    ):
        return body_of(loaded, rom)


@pytest.mark.parametrize("way", WAYS)
def test_matrices_with_nan_or_inf_are_refused_by_name(body, tmp_path, way):
    for key, wrong in (("M", np.nan), ("D", -np.inf), ("K", np.inf), ("B", np.nan), ("C", np.nan)):
        matrix = getattr(body.reduced, key).copy()
        matrix.flat[-1] = wrong
        with pytest.raises(InputError, match=f"reduced model: {key} has 1 of {matrix.size} numbers that are NaN"):
            WAYS[way](tmp_path / "out", replace(body, reduced=replace(body.reduced, **{key: matrix})))
    assert not list(tmp_path.iterdir())


@pytest.mark.mpi
def test_a_damping_matrix_with_nan_is_refused_on_all_ranks(comm, linkage):
    D = linkage.K.duplicate(copy=True)
    if comm.rank == comm.size - 1:
        D.setValue(119, 119, np.nan)
    D.assemble()
    with pytest.raises(InputError, match=r"matrix D has entries that are NaN or Inf, .* dof 120 \(node 20, rz\)"):
        linkage.with_damping_matrix(D)
    D.destroy()
