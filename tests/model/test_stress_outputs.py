"""Outputs that are stresses: rows of C against stress modes, the tolerance, units, and job files."""

import numpy as np
import pytest
from helpers import columns_of

import hpcred
from hpcred import InputError
from hpcred.model.outputs.stresses import stress_output_of
from hpcred.model.units import unit_of_response
from hpcred.outputs import StressOutput

TARGETS = [(60, "z"), *(StressOutput(node=node, stress=name) for node, name in ((20, "xx"), (60, "yz"), (20, "zx")))]
NAMES = ("60:z", "stress 20:xx", "stress 60:yz", "stress 20:zx")


@pytest.mark.mpi
def test_rows_are_those_of_stress_modes(comm):
    with hpcred.solid((6, 2, 3), None, 3, comm=comm) as bare, bare.with_outputs(TARGETS) as model:
        assert model.output_names == NAMES
        with hpcred.reduce(model, [hpcred.Modes(count=5), hpcred.StaticCorrection()]) as rom:
            found = hpcred.stress_modes(model, rom.columns, [20, 60])
            stress = np.concatenate(comm.allgather(found.stress), axis=1)
            wanted = np.stack([stress[:, 0, 0], stress[:, 1, 4], stress[:, 0, 5]])
            assert np.allclose(rom.C[1:], wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())


@pytest.mark.mpi(build="real")
def test_the_tolerance_holds_for_stresses(comm):
    """Against the full model: errors by the drive-point responses of the inputs, over the largest of each output."""
    frequencies = np.linspace(10, 4000, 40)
    with hpcred.solid((6, 2, 3), None, 3, comm=comm) as bare, bare.with_outputs(TARGETS) as model:
        drive = np.sqrt(np.abs(np.einsum("fii->fi", hpcred.frequency_response(bare, frequencies))))
        with hpcred.reduce(model, adaptive=hpcred.Adaptive(tolerance=1e-4, band=(0, 4000))) as rom:
            exact, own = hpcred.frequency_response(model, frequencies), hpcred.frequency_response(rom, frequencies)
        largest = (np.abs(exact) / drive[:, None]).max(axis=2, keepdims=True)
        error = np.abs(own - exact) / drive[:, None] / largest
        assert error.max() < 1e-4 and rom.record.accuracy.reached


def test_names_and_units():
    assert stress_output_of("stress 20:xx") == StressOutput(node=20, stress="xx")
    assert stress_output_of("20:x") is None and stress_output_of("stress 20:xa") is None
    assert unit_of_response("stress 20:xx", "7:z") == "Pa/N" and unit_of_response("stress 1:xy", "7:rx") == "Pa/(N m)"
    assert unit_of_response("stress 20:xx", "dof 3") == ""


@pytest.mark.mpi
def test_stresses_of_models_in_other_units(comm):
    """A stress of 1 MPa in mm, t, s is one of 1e6 Pa, by the model that is converted before or after."""
    units = hpcred.model.units_of("mm,t,s")
    with (
        hpcred.solid((3, 2, 2), (30.0, 20.0, 20.0), 3, comm=comm, young=2.1e5, density=7.85e-9) as bare,
        bare.with_outputs(TARGETS[1:2]) as before, hpcred.model.in_si(before, units) as made,
        hpcred.model.in_si(bare, units) as converted, converted.with_outputs(TARGETS[1:2]) as after,
    ):  # fmt: skip
        wanted = columns_of(after.Ct)
        assert np.allclose(columns_of(made.Ct), wanted, rtol=0, atol=1e-12 * np.abs(wanted).max())


@pytest.mark.mpi
@pytest.mark.costly
def test_a_job_with_stresses_among_its_outputs(comm, folder):
    with hpcred.solid((6, 2, 3), None, 3, comm=comm) as model:
        hpcred.write_model(folder / "m.h5", model)
    text = """model = "m.h5"
output = "r.h5"
outputs = [[60, "z"], {node = 20, stress = "xx"}, {node = 60, stress = "yz"}, {node = 20, stress = "zx"}]
[[basis]]
kind = "modes"
count = 30
[[basis]]
kind = "static_correction"
"""
    if comm.rank == 0:
        (folder / "job.toml").write_text(text)
    comm.Barrier()
    hpcred.reduce_job(folder / "job.toml", comm=comm)
    assert hpcred.read_result(folder / "r.h5", comm).reduced.output_names == NAMES
    found = hpcred.evaluate(folder / "r.h5", folder / "m.h5", frequencies=[0.0, 50.0], comm=comm)
    assert found["eps_max"] < 1e-6


@pytest.mark.mpi(build="real")
def test_stresses_that_cannot_be_are_refused(comm):
    with pytest.raises(InputError, match=r"outputs.stress: found 'mises', expected 'xx', 'yy'|outputs.stress: found"):
        StressOutput(node=20, stress="mises")
    with pytest.raises(InputError, match=r"outputs.node: found 0, expected"):
        StressOutput(node=0, stress="xx")
    with hpcred.solid((3, 2, 2), None, 3, comm=comm) as model:
        with pytest.raises(InputError, match=r"stress: node 9999 of solid belongs to no solid element"):
            model.with_outputs([StressOutput(node=9999, stress="xx")])
        with pytest.raises(InputError, match=r"inputs"):
            model.with_inputs([StressOutput(node=20, stress="xx")])
        with (
            model.with_fields(properties=None) as bare,
            pytest.raises(InputError, match=r"elements whose types and materials are not known"),
        ):
            bare.with_outputs([StressOutput(node=20, stress="xx")])
