"""An FMU of a free body moves in other programs as the body does in simulate, while its rotations are small."""

import fmpy
import numpy as np
import pytest

import hpcred
from hpcred.body.body import body_of
from hpcred.simulation.loads import ConstantForce

END, COUNT, FORCE = 0.02, 20, 1e-3


@pytest.fixture(scope="module")
def pushed(tmp_path_factory):
    """The FMU of the linkage, and its elastic coordinates (t, m) and rates under a force by simulate."""
    path = tmp_path_factory.mktemp("fmu") / "arm.fmu"
    damping = hpcred.Rayleigh(2.0, 1e-5)
    with hpcred.linkage() as linkage, linkage.with_inputs([(20, "z")]) as model:
        rom = hpcred.reduce(model, [hpcred.Modes(index=tuple(range(7, 13)))], hpcred.Buckens(), damping)
        body = body_of(model, rom, [20])
    hpcred.writers.write_fmu(path, rom)
    push = ConstantForce(node=20, value=(0.0, 0.0, FORCE))
    setup = hpcred.Simulation(end=END, steps=COUNT, force=(push,), relative_tolerance=1e-10, absolute_tolerance=1e-16)
    motion = hpcred.simulate(body, setup)
    assert np.abs(motion.elastic[-1]).max() > 0
    return path, motion.elastic, motion.elastic_velocity


def close(found, wanted, eps):
    return np.abs(found - wanted).max() < eps * np.abs(wanted).max()


@pytest.mark.peers("fmpy")
@pytest.mark.parametrize("kind, eps", [("CoSimulation", 1e-5), ("ModelExchange", 5e-3)])  # CVode has its tolerance
def test_fmpy_moves_the_body_as_simulate_does(pushed, kind, eps):
    path, q, v = pushed
    names = [[f"{letter}[{k + 1}]" for k in range(q.shape[1])] for letter in "qv"]
    found = fmpy.simulate_fmu(str(path), fmi_type=kind, stop_time=END, output_interval=END / COUNT,
                              relative_tolerance=1e-9, start_values={"force_20_z": FORCE},
                              output=[*names[0], *names[1]])  # fmt: skip
    assert close(np.array([found[name] for name in names[0]]).T, q, eps)
    assert close(np.array([found[name] for name in names[1]]).T, v, eps)


@pytest.mark.peers("fmpy")
def test_omsimulator_moves_the_body_as_simulate_does(pushed, tmp_path, monkeypatch):
    """By its co-simulation. Not in `make test-peers` itself: its installation downloads the program from elsewhere."""
    OMSimulator = pytest.importorskip("OMSimulator")
    monkeypatch.chdir(tmp_path)
    path, q, v = pushed
    model, place = OMSimulator.SSP(), OMSimulator.CRef
    model.addResource(str(path), new_name="resources/arm.fmu")
    model.addComponent(place("default", "arm"), "resources/arm.fmu")
    model.setValue(place("default", "arm", "force_20_z"), FORCE)
    running = model.instantiate()
    running.setResultFile("")
    running.setStopTime(END)
    running.setFixedStepSize(END / COUNT)
    running.initialize()
    running.simulate()
    states = [[running.getValue(place("default", "arm", f"{letter}[{k + 1}]")) for k in range(q.shape[1])]
              for letter in "qv"]  # fmt: skip
    running.terminate()
    running.delete()
    assert close(np.array(states[0]), q[-1], 1e-5) and close(np.array(states[1]), v[-1], 1e-5)
