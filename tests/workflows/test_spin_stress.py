"""Stresses of a blade that spins: right with a centrifugal load among its inputs, and told where there is none."""

import numpy as np
import pytest
from helpers import block_with_ends

import hpcred
from hpcred import Krylov, Modes, Tangent
from hpcred.body.body import body_of
from hpcred.body.spin_stress import lacks_spin
from hpcred.loads import Centrifugal
from hpcred.parallel.petsc import MPI

SPIN = '[[load]]\nname = "spin"\nkind = "centrifugal"\naxis = [0.0, 0.0, 1.0]\n'
JOB = """
model = "model.h5"
stress = true
geometric_stiffness = true
%s
[frame]
kind = "tangent"
node = "left"
[[interface]]
name = "left"
kind = "rigid"
nodes = {box = [[-1e-6, -1.0, -1.0], [1e-6, 1.0, 1.0]]}
[[interface]]
name = "right"
nodes = {box = [[0.059999, -1.0, -1.0], [0.060001, 1.0, 1.0]]}
[[basis]]
kind = "modes"
count = 4
[[basis]]
kind = "static_correction"
"""
TOLD = "stress: no input of the reduction is a centrifugal load, without which stresses under spin may be 10 % off"
SIMULATION = """
body = "result.h5"
end = 2e-5
steps = 2
angular_velocity = [0.0, 0.0, %g]
velocity = [%g, 0.0, 0.0]  # by which the hinge rests
[[force]]
node = "right"
kind = "constant"
value = [0.0, 10.0, 0.0]
[[constraint]]
node = "left"
kind = "revolute"
axis = [0.0, 0.0, 1.0]
"""


@pytest.mark.mpi
@pytest.mark.costly
def test_static_stresses_under_spin_are_those_of_the_full_model(comm):
    """S q of the reduced body under the centrifugal forces that its floating frame has, against E B u of a solve."""
    with block_with_ends(comm, "rigid") as model:
        frame, errors = Tangent("left"), []
        with model.with_loads([Centrifugal(name="spin", axis=(0.0, 0.0, 1.0))]) as loaded:
            alone = loaded.with_input_columns(loaded.B.getDenseArray().real[:, -1:], ["spin"])
            with hpcred.reduce(alone, [Krylov(frequency=0.0)], frame) as rom:
                exact = hpcred.stress_modes(alone, rom.columns).stress[0] * (rom.B[0, 0] / rom.K[0, 0])
            for used in (loaded, model):
                with hpcred.reduce(used, [Modes(count=4), Krylov(frequency=0.0)], frame) as rom:
                    modes = hpcred.stress_modes(used, rom.columns)
                    q = np.linalg.solve(rom.K, -body_of(used, rom).floating_frame.Oe[:, 2])
                    assert lacks_spin(rom.record) == (used is model)
                found = np.tensordot(q, modes.stress, axes=1)
                parts = comm.allgather((np.abs(found - exact).max(initial=0.0), np.abs(exact).max(initial=0.0)))
                errors.append(np.max(parts, axis=0)[0] / np.max(parts, axis=0)[1])
    assert errors[0] < 1e-7 and errors[1] > 0.02


@pytest.mark.mpi
@pytest.mark.costly
def test_a_reduction_without_such_a_load_is_told(comm, folder):
    with block_with_ends(comm) as model:
        hpcred.write_model(folder / "model.h5", model)
    warnings = []
    jobs = {"without": JOB % "", "with": JOB % "" + SPIN, "no_stress": JOB.replace("stress = true\n", "", 1) % ""}
    for name, text in jobs.items():
        if comm.rank == 0:
            (folder / f"{name}.toml").write_text(text)
        comm.Barrier()
        found = hpcred.reduce_job(folder / f"{name}.toml", overrides=[f"output='{name}.h5'"], comm=comm)
        warnings.append(any(item.startswith(TOLD) for item in found.record.warnings))
    assert warnings == [True, False, False]


@pytest.mark.parametrize(("load", "speed", "told"), [("", 500.0, True), ("", 1e-3, False), (SPIN, 500.0, False)])
def test_a_simulation_that_spins_is_told(tmp_path, monkeypatch, load, speed, told):
    monkeypatch.chdir(tmp_path)
    with block_with_ends(MPI.COMM_SELF) as model:
        hpcred.write_model("model.h5", model)
    (tmp_path / "job.toml").write_text(JOB % "" + load)
    hpcred.reduce_job("job.toml")
    text = SIMULATION % (speed, 0.01 * speed)
    (tmp_path / "sim.toml").write_text(text)
    warnings = hpcred.simulate_file("sim.toml")["warnings"]
    assert any(text.startswith("stress: the body turns by up to") for text in warnings) == told
    if load:
        (tmp_path / "sim.toml").write_text(text + '[[load]]\nname = "spin"\nkind = "constant"\nvalue = 4.0\n')
        notes = hpcred.simulate_file("sim.toml")["notes"]
        assert "load 'spin': a body that turns has its centrifugal forces without it; these are added to them" in notes
