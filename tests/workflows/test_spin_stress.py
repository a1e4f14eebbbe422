"""Stresses of a blade that spins: right with a centrifugal load among its inputs, and told where there is none."""

import numpy as np
import pytest
from helpers import block_with_ends

import hpcred
from hpcred import Krylov, Modes, Tangent
from hpcred.body.body import body_of
from hpcred.body.spin_stress import lacks_spin
from hpcred.loads import Centrifugal

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
body = "%s"
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


@pytest.fixture(scope="module")
def reduced(comm, module_folder):
    """Result files without the load, with it, and without stresses, by name, and the warnings of each."""
    with block_with_ends(comm) as model:
        hpcred.write_model(module_folder / "model.h5", model)
    files, warnings = {}, {}
    jobs = {"without": JOB % "", "with": JOB % "" + SPIN, "no_stress": JOB.replace("stress = true\n", "", 1) % ""}
    for name, text in jobs.items():
        if comm.rank == 0:
            (module_folder / f"{name}.toml").write_text(text)
        comm.Barrier()
        found = hpcred.reduce_job(module_folder / f"{name}.toml", overrides=[f"output='{name}.h5'"], comm=comm)
        files[name], warnings[name] = module_folder / f"{name}.h5", found.record.warnings
    return files, warnings


@pytest.mark.mpi
@pytest.mark.costly
def test_a_reduction_without_such_a_load_is_told(reduced):
    told = {name: any(item.startswith(TOLD) for item in warnings) for name, warnings in reduced[1].items()}
    assert told == {"without": True, "with": False, "no_stress": False}


@pytest.mark.parametrize(
    ("name", "speed", "told"), [("without", 500.0, True), ("without", 1e-3, False), ("with", 500.0, False)]
)
def test_a_simulation_that_spins_is_told(reduced, tmp_path, monkeypatch, name, speed, told):
    monkeypatch.setattr("hpcred.workflows.simulate.has_matplotlib", lambda: False)  # no picture
    text, path = SIMULATION % (reduced[0][name], speed, 0.01 * speed), tmp_path / "sim.toml"
    path.write_text(text)
    warnings = hpcred.simulate_file(path)["warnings"]
    assert any(text.startswith("stress: the body turns by up to") for text in warnings) == told
    if name == "with":
        path.write_text(text + '[[load]]\nname = "spin"\nkind = "constant"\nvalue = 4.0\n')
        notes = hpcred.simulate_file(path)["notes"]
        assert "load 'spin': a body that turns has its centrifugal forces without it; these are added to them" in notes
