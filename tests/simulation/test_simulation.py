"""Simulations against closed forms, conservation laws and the frequency response."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from helpers import bar, made_up_stiffness

import hpcred
from hpcred import Buckens, Chord, Krylov, Modes, Rayleigh, Simulation, Viscoelastic
from hpcred.body.body import body_of
from hpcred.laws import Maxwell
from hpcred.parallel.failures import InputError
from hpcred.reduction.result.maxwell_states import maxwell_states
from hpcred.simulation import ConstantForce, Joint, RampDrive, SineDrive, SineForce, TableDrive, TableForce
from hpcred.simulation.equations_of_motion import FlexibleBody, rotation
from hpcred.simulation.integration import FEW_EVALUATIONS, FEW_STEPS, Pace
from hpcred.simulation.simulation import simulate

SILENT = SimpleNamespace(say=lambda *_, **__: None)


def reduced_body(model, basis, nodes, damping=None):
    with hpcred.reduce(model, basis, Buckens(), damping) as rom:
        return body_of(model, rom, nodes)


@pytest.fixture(scope="module")
def linkage_body():
    with hpcred.linkage() as model:
        return reduced_body(model, [Modes(index=tuple(range(7, 13)))], [1, 7, 14, 20])


def momenta(body, motion):
    """Linear and angular momentum about the inertial origin at all times."""
    system = FlexibleBody(body.floating_frame, body.reduced.K, body.reduced.D)
    result = []
    for r, p, q, *velocities in zip(
        motion.position, motion.quaternion, motion.elastic, motion.velocity, motion.angular_velocity,
        motion.elastic_velocity, strict=True,
    ):  # fmt: skip
        P = system.floating_frame.mass_matrix(q) @ np.concatenate(velocities)
        A = rotation(p)
        result.append(np.concatenate([A @ P[:3], A @ P[3:6] + np.cross(r, A @ P[:3])]))
    return np.array(result)


@pytest.mark.parametrize("stiffness", [None, pytest.param(3.0, marks=pytest.mark.slow)])
def test_a_free_spinning_body_keeps_energy_and_momentum(linkage_body, stiffness):
    body = linkage_body if stiffness is None else made_up_stiffness(linkage_body, stiffness)
    setup = Simulation(
        end=0.05, velocity=(1.0, -0.5, 0.2), angular_velocity=(3.0, 8.0, -5.0), rotation=(0.2, 0.1, 0.5),
        elastic=(1e-3, -2e-3, 1e-3, 0.0, 0.0, 0.0), steps=50, relative_tolerance=1e-8, absolute_tolerance=1e-11,
    )  # fmt: skip
    motion = simulate(body, setup)
    assert motion.balance < 1e-8
    kept = momenta(body.stiffened(), motion)
    assert np.abs(kept - kept[0]).max() < 1e-7 * np.abs(kept).max()
    rough = replace(setup, geometric_stiffness=False, relative_tolerance=1e-5, absolute_tolerance=1e-8)
    without = simulate(body, rough).elastic
    assert (np.abs(motion.elastic - without).max() > 1e-2 * np.abs(without).max()) == (stiffness is not None)
    assert np.ptp(motion.elastic[:, 0]) > 3e-4 and np.ptp(motion.angular_velocity, axis=0).max() > 1
    assert motion.drift == 0.0 and motion.constraint_force.shape == (51, 0)


TURNING = [
    {"angular_velocity": (0.0, 0.0, 1e6)},
    {"constraint": (Joint(1, kind="revolute", axis=(0.0, 0.0, 1.0)),),
     "drive": (RampDrive(node=1, about=(0.0, 0.0, 1.0), rate=1e6),)},
    {"constraint": (Joint(1, kind="revolute", axis=(0.0, 0.0, 1.0)),),
     "drive": (TableDrive(node=1, about=(0.0, 0.0, 1.0), times=(0.0, 1e6), values=(0.0, 1e12)),)},
    {"constraint": (Joint(1, kind="revolute", axis=(0.0, 0.0, 1.0)),),
     "drive": (SineDrive(node=1, about=(0.0, 0.0, 1.0), amplitude=1e9, frequency=1e-3),)},
]  # fmt: skip


@pytest.mark.parametrize("setup", TURNING)
def test_turns_without_end_are_refused_before_they_begin(linkage_body, setup, monkeypatch):
    """1e12 rad and more, of drives and of a body by itself, in steps that see each turn."""
    monkeypatch.setattr("scipy_dae.integrate.RadauDAE", lambda *_, **__: pytest.fail("was begun"))
    with pytest.raises(InputError, match=r"takes [\d.]+e\+1\d steps of its turns, expected at most 1e\+08; end earl"):
        simulate(linkage_body, Simulation(end=1e6, **setup))


def test_vibrations_without_end_are_refused_after_some_steps(linkage_body, monkeypatch):
    """An undamped body rings at some 100 Hz for as long as it is asked to."""
    monkeypatch.setattr("hpcred.simulation.integration.FEW_STEPS", 100)
    elastic = (1e-3, 0.0, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(InputError, match=r"in 100 steps, .* takes [\d.]+e\+\d+ more, expected at most 1e\+08"):
        simulate(linkage_body, Simulation(end=1e8, elastic=elastic))
    assert simulate(linkage_body, Simulation(end=0.5, elastic=elastic, steps=5)).balance < 1e-2


def test_circulatory_forces_do_work(linkage_body):
    """x'' + d x' + (K + N) x = 0 of the first two coordinates, K_s of which alone stores energy."""
    reduced = linkage_body.reduced
    N, D = np.zeros_like(reduced.K), 20.0 * np.eye(len(reduced.K))
    N[0, 1], N[1, 0] = 0.5 * reduced.K[0, 0], -0.5 * reduced.K[0, 0]
    body = replace(linkage_body, reduced=replace(reduced, K=reduced.K + N, D=D, columns=None, model=None))
    found = simulate(body, Simulation(end=0.02, elastic=(1e-5, *np.zeros(len(D) - 1)), steps=20))
    zero, one = np.zeros_like(D), np.eye(len(D))
    A = np.block([[zero, one], [-reduced.K - N, -D]])
    values, vectors = np.linalg.eig(A)
    start = np.linalg.solve(vectors, np.eye(len(A))[:, 0] * 1e-5)
    exact = (vectors @ (np.exp(values[:, None] * found.t) * start[:, None])).real[: len(D)].T
    assert found.elastic == pytest.approx(exact, abs=1e-3 * np.abs(exact).max())
    assert found.balance < 1e-3 and np.abs(exact[:, 1]).max() > 0.1 * np.abs(exact[:, 0]).max()


def with_parts(body, *laws):
    """The body with laws of parts of its stiffness that differ."""
    rng, K = np.random.default_rng(8), body.reduced.K
    roots = [np.linalg.cholesky(K) @ rng.normal(size=(len(K), 3)) for _ in laws]
    parts = tuple(Viscoelastic(0.2 * root @ root.T, law, f"part {k}")
                  for k, (root, law) in enumerate(zip(roots, laws, strict=True)))  # fmt: skip
    return replace(body, reduced=replace(body.reduced, viscoelastic=parts, columns=None, model=None))


def test_maxwell_elements_of_a_body_that_swings(linkage_body):
    """From a shape that is let go: by the exponential of the state matrix, with elements that are relaxed before."""
    laws = Maxwell(factors=[0.5, 2.0], times=[1e-2, 1e-4]), Maxwell(factors=[1.0], times=[3e-3], constant=1.0)
    body = with_parts(linkage_body, *laws)
    size, states = body.reduced.size, maxwell_states(body.reduced.viscoelastic)
    q = 1e-5 * np.ones(size)
    found = simulate(body, Simulation(end=0.02, elastic=q.tolist(), steps=20, absolute_tolerance=1e-11))
    start = np.concatenate([q, np.zeros(size), states.L.T @ q])
    flow = scipy.linalg.expm(found.t[1] * body.reduced.state_matrix())
    exact = [start]
    for _ in found.t[1:]:
        exact.append(flow @ exact[-1])
    exact = np.array(exact)[:, :size]
    assert found.elastic == pytest.approx(exact, abs=1e-4 * np.abs(exact).max())
    assert found.energies["dissipated"][-1] > 0.1 * found.energies["elastic"][0] and found.balance < 1e-4
    assert f"the Maxwell elements of part 0, part 1 are {states.size} states, relaxed at the start" in found.notes
    elastic = replace(body, reduced=replace(body.reduced, viscoelastic=()))
    other = simulate(elastic, Simulation(end=0.02, elastic=q.tolist(), steps=20))
    assert np.abs(other.elastic - exact).max() > 0.1 * np.abs(exact).max()


def test_maxwell_elements_against_the_full_model():
    """A linkage of a viscoelastic material, held by six supports, at 10 Hz; at rest K alone carries its weight."""
    frequency, force, law = 10.0, 1e-3, Maxwell(factors=[0.7, 0.4], times=[1e-2, 1e-3], constant=0.3)
    held = [(1, "x"), (1, "y"), (1, "z"), (7, "x"), (7, "z"), (14, "z")]
    with hpcred.linkage() as elastic, elastic.with_viscoelastic([Viscoelastic(elastic.K, law, "all")]) as model:
        expected = hpcred.frequency_response(model, [frequency], Chord(nodes=(1, 7, 14), axes="yxz"))[0, 0, 0]
        model = model.with_inputs([*held, (20, "z")])
        body = reduced_body(model, [Krylov(frequency=10.0, order=1)], [1, 7, 14, 20])
    joints = Joint(1), Joint(7, ("x", "z")), Joint(14, ("z",))
    setup = Simulation(
        end=0.4, force=(SineForce(20, (0.0, 0.0, force), frequency),), steps=100, constraint=joints,
        relative_tolerance=1e-6, absolute_tolerance=1e-11,
    )  # fmt: skip
    motion = simulate(body, setup)
    last = motion.t > 0.3001
    wave = np.exp(-2j * np.pi * frequency * motion.t[last])
    found = 2j * np.mean(motion.node_displacement[last, -1, 2] * wave) / force
    assert found == pytest.approx(expected, rel=1e-3) and abs(expected.imag) > 0.1 * abs(expected)
    still = Simulation(end=0.05, gravity=(0.0, 0.0, -9.81), start="static", constraint=joints)
    rest = simulate(body, still)
    without = simulate(replace(body, reduced=replace(body.reduced, viscoelastic=())), still)
    assert rest.elastic == pytest.approx(np.array([without.elastic[0]] * len(rest.t)), rel=1e-6, abs=1e-12)


def test_fractional_laws_have_no_states(linkage_body):
    body = with_parts(linkage_body, hpcred.laws.Fractional(low=1.0, high=2.0, time=1e-3, exponent=0.5))
    with pytest.raises(InputError, match="part 0 is fractional, which no .* in a simulation; take kind 'maxwell'"):
        simulate(body, Simulation(end=0.1))


def test_progress_and_warnings_are_told(linkage_body):
    """At twentieths of the time, each once, and before the integration."""
    said, told = [], []
    progress = SimpleNamespace(say=lambda text, **_: said.append(text), warn=told.append)
    elastic = (1e-3, 0.0, 0.0, 0.0, 0.0, 0.0)
    simulate(linkage_body, Simulation(end=0.5, elastic=elastic, steps=5), progress)
    times = [int(20 * float(re.match(r"t = ([\d.e+-]+) s of 0.5 s", text)[1]) / 0.5) for text in said]
    assert times == sorted(set(times)) and times[0] == 0 and len(times) > 15
    assert all(re.search(r", [\d,]+ steps, about .* left$", text) for text in said[1:])
    found = simulate(linkage_body, Simulation(end=1e-4, gravity=(0.0, 0.0, -9810.0), steps=2), progress)
    assert told == ["gravity: found 9810 m/s^2; in SI it is 9.81"] and found.warnings == told


@pytest.mark.parametrize("t, refused", [(1e-7, True), (1.0, False)])
def test_the_pace_is_looked_at_after_a_number_of_steps(t, refused):
    """Of FEW_STEPS steps: what is left takes too many where they came to 1e-7 s of 1,000 s, and few where to 1 s."""
    watch = Pace(1000.0, SILENT).stepped
    for k in range(1, FEW_STEPS):
        watch(t * k / FEW_STEPS, None)
    if refused:
        steps = 1000.0 * FEW_STEPS / t
        with pytest.raises(InputError, match=re.escape(f"takes {steps:.1e} more")):
            watch(t, None)
    else:
        watch(t, None)


def test_the_pace_is_that_of_the_last_steps():
    watch = Pace(1000.0, SILENT).stepped
    for k in range(1, FEW_STEPS + 1):
        watch(k / FEW_STEPS, None)
    with pytest.raises(InputError, match=f"the last {FEW_STEPS} of which took 1.0e-07 s"):
        for k in range(1, FEW_STEPS + 1):
            watch(1.0 + 1e-7 * k / FEW_STEPS, None)


def test_steps_that_are_tried_in_vain_count_as_well():
    """None of so many evaluations has brought the time on."""
    pace = Pace(1000.0, SILENT)
    pace.stepped(1e-9, None)
    for _ in range(FEW_EVALUATIONS):
        pace.evaluated()
        if pace.evaluations == FEW_EVALUATIONS - 1:
            break
    with pytest.raises(InputError, match="t = 1e-09 s was reached in 5000 evaluations of the equations, the last 5000"):
        pace.evaluated()


@pytest.mark.parametrize("more", [{"gravity": (0.0, 0.0, 1e30)}, {"force": (ConstantForce(20, (1e19, 0.0, 0.0)),)}])
def test_loads_beyond_all_speeds_are_refused_before_the_first_step(linkage_body, more):
    with pytest.raises(InputError, match="loads and bases give the body a speed of .* beyond that of light; look at"):
        simulate(linkage_body, Simulation(end=0.01, steps=3, **more))


def test_a_stiff_pendulum_is_a_rigid_one(comm):
    """A beam of 1 m on a spherical joint at its end, falling from the horizontal in a plane."""
    with bar(comm, 1.0, 4, young=2.1e13) as model:
        body = reduced_body(model, [Modes(index=(7, 8))], [1, 5], Rayleigh(0.0, 1e-3))
    setup = Simulation(end=1.5, gravity=(0.0, 0.0, -9.81), constraint=(Joint(1),), observe=(5,), steps=100,
                       relative_tolerance=1e-6, absolute_tolerance=1e-9)  # fmt: skip
    motion = simulate(body, setup)
    # angle below the horizontal of a slender rod: 1/3 m L^2 phi'' = m g L/2 cos phi
    rigid = scipy.integrate.solve_ivp(
        lambda _, y: [y[1], 1.5 * 9.81 * np.cos(y[0])], (0, 1.5), [0.0, 0.0], t_eval=motion.t, rtol=1e-10, atol=1e-12
    ).y[0]
    tip = motion.node_position[:, 1]
    assert tip == pytest.approx(np.array([np.cos(rigid), 0 * rigid, -np.sin(rigid)]).T, abs=2e-5)
    assert motion.drift < 1e-8 and motion.balance < 1e-5
    weight = body.floating_frame.mass * 9.81  # at the lowest point the joint carries 2.5 m g
    assert np.linalg.norm(motion.constraint_force, axis=1).max() == pytest.approx(2.5 * weight, rel=2e-2)


def test_small_vibrations_agree_with_the_frequency_response():
    """The constrained free body against the full model held by the same six supports, at 10 Hz."""
    frequency, force, damping = 10.0, 1e-3, Rayleigh(0.0, 2e-2)  # stiffness damping leaves rigid motion alone
    held = [(1, "x"), (1, "y"), (1, "z"), (7, "x"), (7, "z"), (14, "z")]
    with hpcred.linkage() as model:
        expected = hpcred.frequency_response(model, [frequency], Chord(nodes=(1, 7, 14), axes="yxz"), damping)[0, 0, 0]
        model = model.with_inputs([*held, (20, "z")])
        body = reduced_body(model, [Krylov(frequency=10.0, order=1)], [1, 7, 14, 20], damping)
    setup = Simulation(
        end=0.6, force=(SineForce(20, (0.0, 0.0, force), frequency),), steps=300,
        constraint=(Joint(1), Joint(7, ("x", "z")), Joint(14, ("z",))), relative_tolerance=1e-6,
        absolute_tolerance=1e-11,
    )  # fmt: skip
    motion = simulate(body, setup)
    last = motion.t > 0.4
    wave = np.exp(-2j * np.pi * frequency * motion.t[last])
    found = 2j * np.mean(motion.node_displacement[last, -1, 2] * wave) / force
    assert found == pytest.approx(expected, rel=1e-3)


def test_static_start_is_at_rest_and_carries_the_weight(linkage_body):
    setup = Simulation(
        end=0.05, start="static", gravity=(0.0, 0.0, -9.81), force=(ConstantForce(20, (0.0, 0.0, 50.0)),), steps=5,
        constraint=(Joint(1), Joint(7, ("x", "z")), Joint(14, ("z",))),
    )  # fmt: skip
    motion = simulate(linkage_body, setup)
    assert np.abs(motion.node_displacement - motion.node_displacement[0]).max() < 1e-8
    assert np.abs(motion.node_displacement[0, -1, 2]) > 1e-4
    vertical = [name.endswith("z") for name in motion.constraint_names]
    weight = 9.81 * linkage_body.floating_frame.mass
    assert motion.constraint_force[:, vertical].sum(axis=1) == pytest.approx(weight - 50.0, rel=1e-6)


def test_what_does_not_fit_is_moved_and_said(linkage_body):
    at = tuple(linkage_body.nodes[0].position + [0.0, 0.0, 0.01])
    setup = Simulation(end=0.01, steps=2, constraint=(Joint(1, at=at),), velocity=(0.0, 0.0, 1.0))
    motion = simulate(linkage_body, setup)
    assert motion.node_position[0, 0] == pytest.approx(at, abs=1e-12)
    assert motion.drift < 1e-8
    assert any("velocities did not fit" in note for note in motion.notes)
    assert any("position did not fit" in note for note in motion.notes)


def test_forces_over_time():
    table = TableForce(1, (0.0, 1.0, 3.0), ((0.0, 0.0, 0.0), (2.0, 0.0, -2.0), (2.0, 4.0, 0.0)))
    assert table(0.5) == pytest.approx([1, 0, -1]) and table(2.0) == pytest.approx([2, 2, -1])
    assert table(-1.0) == pytest.approx([0, 0, 0]) and table(9.0) == pytest.approx([2, 4, 0])
    assert SineForce(1, (3.0, 0.0, 0.0), 2.0, np.pi / 2)(0.25) == pytest.approx([-3, 0, 0])
    late = TableForce(1, (-1.0, -0.9, 0.0, 1.0, 3.0, 3.1), ((0.0, 0.0, 0.0),) * 6)
    assert late.longest_step(2.0) == 1.0 and late.longest_step(0.5) == 1.0 and late.longest_step(4.0) < 0.11
    assert table.longest_step() == 1.0 and SineForce(1, (1.0, 0.0, 0.0), 2.0).longest_step() < 0.1


@pytest.mark.parametrize(
    "change, says",
    [
        ({"start": "static", "constraint": (Joint(1),)}, "leave 3 rigid motions free"),
        ({"constraint": (Joint(1), Joint(1, ("z",)))}, "depend on each other"),
        ({"constraint": (Joint(1, at=(9.0, 0.0, 0.0)), Joint(20))}, "away from the given places"),
        ({"elastic": (1.0,)}, "elastic: found 1 numbers, expected 6"),
        ({"observe": (5,)}, "node 5 is none of the nodes of the body, 1, 7, 14, 20"),
        ({"gravity": (0.0, 0.0, np.nan)}, "gravity: found nan"),
        ({"end": np.inf}, "end: found inf, expected a finite number"),
    ],
)
def test_simulations_that_make_no_sense(linkage_body, change, says):
    with pytest.raises(InputError, match=says):
        simulate(linkage_body, Simulation(**{"end": 0.1, **change}))
