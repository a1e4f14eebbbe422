"""Loads by name in simulations: against a dense integration of the whole body, statics, and each refusal."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from helpers import dense_model, gather, to_dense

import hpcred
from hpcred import Buckens, InputError, Modes, Nodes, Simulation, StaticCorrection
from hpcred.body.body import body_of
from hpcred.loads import Pressure, Traction
from hpcred.model.rigid_body.modes import rigid_motions
from hpcred.settings.simulation_file import read_simulation
from hpcred.simulation import ConstantForce, ConstantLoad, Joint, SineForce, SineLoad, SineMoment, TableForce, TableLoad

END = Nodes(box=((0.0299, -1.0, -1.0), (0.0301, 1.0, 1.0)))
SIDE = Nodes(box=((-1.0, -1.0, 0.0099), (1.0, 1.0, 0.0101)))
LOADS = [Pressure(name="oil", on=SIDE, value=1e5), Traction(name="push", on=END, value=(0.0, 3e4, 1e4))]


@pytest.fixture(scope="module")
def free():
    """A free block with all its elastic modes, and its full model by numpy."""
    with hpcred.solid((3, 1, 1), clamped=False, inputs=1) as model, model.with_loads(LOADS) as loaded:
        K, M, B = dense_model(loaded)
        R = gather(rigid_motions(loaded))
        pairs = zip(loaded.dofs.node.tolist(), loaded.dofs.direction.tolist(), strict=True)
        rows = {pair: k for k, pair in enumerate(pairs)}
        with hpcred.reduce(loaded, [Modes(count=len(K) - 6)], Buckens()) as rom:
            body = body_of(loaded, rom, [1, 16], origin=(0.01, -0.02, 0.005))
    return body, K, M, B, R, rows


@pytest.mark.parametrize("name", [pytest.param("oil", marks=pytest.mark.slow), "push"])
def test_a_free_body_under_a_load_moves_as_the_full_model(free, name):
    """Small motions: displacements of two nodes by the modes of the full model, rigid ones included."""
    body, K, M, B, R, rows = free
    frequency, end, factor = 20e3, 2e-4, 1e-3
    setup = Simulation(end=end, steps=40, observe=(1, 16), load=(SineLoad(name, factor, frequency),),
                       relative_tolerance=1e-8, absolute_tolerance=1e-19)  # fmt: skip
    motion = hpcred.simulate(body, setup)
    eigenvalues, modes = scipy.linalg.eigh(K, M)
    omega, w = np.sqrt(eigenvalues.clip(min=0.0)), 2 * np.pi * frequency
    omega[:6] = 0.0
    t = motion.t[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        elastic = (np.sin(w * t) - w / omega * np.sin(omega * t)) / (omega**2 - w**2)
    rigid = t / w - np.sin(w * t) / w**2
    q = np.where(omega > 0, elastic, rigid) * factor * (modes.T @ B[:, body.reduced.input_names.index(name)])
    u = q @ modes.T
    for i, node in enumerate((1, 16)):
        expected = u[:, [rows[node, d] for d in range(3)]]
        assert np.abs(motion.node_displacement[:, i] - expected).max() < 1e-5 * np.abs(expected).max()
    assert motion.balance < 1e-5 and motion.energies["work"][-1] > 0
    assert np.abs(R.T @ B).max() > 0


def test_resultants_are_those_of_the_columns(free):
    body, _, _, B, R, _ = free
    assert body.reduced.resultants == pytest.approx((R.T @ B).T, abs=1e-12 * np.abs(R.T @ B).max())
    force, moment = np.split(body.reduced.resultants[1], 2)
    assert force == pytest.approx((0.0, 0.0, -1e5 * 0.03 * 0.01)) and moment[0] == pytest.approx(force[2] * 0.005)


def test_at_rest_it_deflects_as_the_full_model():
    """A block that is clamped by a joint at a rigid face, start = "static" under a constant load, by K^-1 b."""
    faces = [hpcred.Interface(name=name, nodes=Nodes(box=((x - 1e-4, -1.0, -1.0), (x + 1e-4, 1.0, 1.0))), kind=kind)
             for name, x, kind in (("root", 0.0, "rigid"), ("tip", 0.04, "averaging"))]  # fmt: skip
    wind = Pressure(name="wind", on=Nodes(box=((-1.0, -1.0, 0.0199), (1.0, 1.0, 0.0201))), value=1e4)
    with (
        hpcred.solid((4, 2, 2), clamped=False, inputs=1) as model, model.with_interfaces(faces) as marked,
        marked.with_inputs(["root", "tip"]) as forced, forced.with_loads([wind]) as loaded,
        hpcred.reduce(loaded, [Modes(count=6), StaticCorrection()], Buckens()) as rom,
    ):  # fmt: skip
        stiff = body_of(loaded, rom, geometric_stiffness=hpcred.geometric_stiffness(loaded, rom.columns, Buckens()))
        body = body_of(loaded, rom)
        K, _, B = dense_model(loaded)
        G, free = to_dense(loaded.Gt)[:, 6:9].T, loaded.dofs.position[:, 0] > 1e-9
    setup = Simulation(end=1e-4, steps=2, start="static", load=(ConstantLoad("wind", 2.0),),
                       constraint=(Joint("root", kind="fixed"),), observe=("tip",))  # fmt: skip
    motion = hpcred.simulate(body, setup)
    u = np.zeros(len(K))
    u[free] = np.linalg.solve(K[np.ix_(free, free)], 2.0 * B[free, -1])
    tip = motion.node_names.index("tip")
    assert motion.node_displacement[:, tip] == pytest.approx(np.tile(G @ u, (3, 1)), rel=1e-5, abs=1e-12)
    assert abs((G @ u)[2]) > 1e-8
    assert motion.constraint_force[0][2] == pytest.approx(2e4 * 0.04 * 0.02, rel=1e-6)
    said = "geometric stiffness: the stress of the loads wind does not count: there are states of accelerations, "
    assert [note.startswith(said) for note in hpcred.simulate(stiff, setup).notes].count(True) == 1
    assert not any("geometric stiffness" in note and "wind" in note for note in motion.notes)


@pytest.mark.parametrize("frequency", [0.2, 50.0])
def test_steps_see_a_load_that_varies(frequency):
    """Eight in a period, between which a sine is straight to 1 - cos(pi / 8); those of a table up to a time."""
    for load in (SineLoad("oil", 1.0, frequency), SineForce(1, (1.0, 0.0, 0.0), frequency),
                 SineMoment(1, (0.0, 1.0, 0.0), frequency, np.pi / 8)):  # fmt: skip
        assert load.longest_step() == load.longest_step(1e9) == pytest.approx(0.125 / frequency, rel=1e-15)
    h = load.longest_step()
    t = np.linspace(0.0, 8 * h, 801)
    straight = np.interp(t, h * np.arange(9), [load(h * k)[1] for k in range(9)])
    assert np.abs(straight - [load(x)[1] for x in t]).max() == pytest.approx(1 - np.cos(np.pi / 8), rel=1e-3)
    values = [(0.0, 0.0, 1.0)] * 4
    times = (0.0, 1.0, 1.5, 1.6)
    for table in (TableLoad("oil", times, times), TableForce(1, times, values)):
        assert table.longest_step() == pytest.approx(0.1) and table.longest_step(1.2) == pytest.approx(0.5)
    assert ConstantLoad("oil", 1.0).longest_step() == ConstantForce(1, (1.0, 0.0, 0.0)).longest_step() == np.inf


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: ConstantLoad("oil", np.nan), "load.value: found nan, expected a finite number"),
        (lambda: SineLoad("oil", 1.0, -1.0), "load.frequency: found -1, expected a number of more than 0"),
        (lambda: TableLoad("oil", (0.0, 1.0), (2.0,)), "load.values: found 1 values for 2 times, expected as"),
        (lambda: TableLoad("oil", (1.0, 0.0), (2.0, 1.0)), "load.times: found 0 s after 1 s, expected"),
    ],
)
def test_refused_settings(make, says):
    with pytest.raises(InputError, match=says):
        make()


def test_refused_names_and_older_results(free):
    body = free[0]
    setup = Simulation(end=1e-4, load=(ConstantLoad("oli", 1.0),))
    with pytest.raises(InputError, match=r"load.name: the result has no input 'oli' \(did you mean 'oil'\?\); it has"):
        hpcred.simulate(body, setup)
    older = replace(body, reduced=replace(body.reduced, resultants=None))
    with pytest.raises(InputError, match="load 'oil': the result does not have the sums of its inputs, since an"):
        hpcred.simulate(older, Simulation(end=1e-4, load=(ConstantLoad("oil", 1.0),)))


def test_a_file_with_loads(tmp_path, monkeypatch):
    """sim.toml of a result in a file; table between times, and unknown kinds."""
    monkeypatch.chdir(tmp_path)
    with (
        hpcred.solid((3, 1, 1), clamped=False, inputs=1) as model, model.with_loads(LOADS) as loaded,
        hpcred.reduce(loaded, [Modes(count=3)], Buckens()) as rom,
    ):  # fmt: skip
        rom.save("result.h5")
    text = 'body = "result.h5"\nend = 1e-4\nsteps = 4\n[[load]]\nname = "oil"\nkind = "{}"\n{}\n'
    (tmp_path / "sim.toml").write_text(text.format("table", "times = [0.0, 1e-4]\nvalues = [0.0, 1.0]"))
    found = hpcred.simulate_file("sim.toml")
    assert found["energy_defect"] < 1e-4
    (tmp_path / "sim.toml").write_text(text.format("step", "value = 1.0"))
    with pytest.raises(InputError, match=r"load\[0\].kind: found 'step', expected one of constant, sine, table"):
        read_simulation("sim.toml")
