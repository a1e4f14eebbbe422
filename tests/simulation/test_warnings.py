"""Motions beyond what the equations describe are told, with their numbers; those within are not."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import bar

import hpcred
from hpcred import Buckens, Krylov, Modes, Simulation
from hpcred.body.body import body_of
from hpcred.body.node_shapes import interface_nodes
from hpcred.model.interfaces.nodes import Interface, Nodes
from hpcred.parallel.failures import ComputationError
from hpcred.parallel.petsc import MPI
from hpcred.parallel.progress import Progress
from hpcred.simulation import ConstantForce, Joint, RampDrive
from hpcred.simulation.equations_of_motion import FlexibleBody
from hpcred.simulation.joints import holds_of
from hpcred.simulation.simulation import _at_outputs, simulate
from hpcred.simulation.warnings import first_frequency, warnings_of_inputs

LENGTH, DIAMETER, DENSITY, YOUNG = 10.0, 0.5, 1000.0, 7.5e8
UNIT = np.sqrt(YOUNG * DIAMETER**2 / 16 / DENSITY) / LENGTH**2  # rad/s: sqrt(E I / (rho A L^4)), 1.08
TURNED = Joint(1, kind="revolute", axis=(0.0, 0.0, 1.0))


@pytest.fixture(scope="module")
def beam():
    """A free slender beam whose ends move as static loads need."""
    with (
        bar(MPI.COMM_SELF, LENGTH, 6, young=YOUNG, density=DENSITY, diameter=DIAMETER) as bare,
        bare.with_inputs([(1, "all"), (7, "all")]) as model,
        hpcred.reduce(model, [Modes(index=(7, 8, 9, 10)), Krylov(frequency=0.0)], Buckens()) as rom,
    ):
        return body_of(model, rom, [1, 7])


@pytest.mark.parametrize("joints, factor", [
    ((Joint(1, kind="fixed"),), 3.51602), ((TURNED,), 3.51602), ((Joint(1, kind="spherical"),), 15.4182), ((), 22.3733),
])  # fmt: skip
def test_the_first_frequency_is_that_of_a_beam_as_joints_hold_it(beam, joints, factor):
    """Against Euler's beams: clamped, hinged and free; a hinge about z leaves it clamped in the other plane."""
    start = {shape.node: (shape, shape.position - beam.floating_frame.origin, np.eye(3)) for shape in beam.nodes}
    system = FlexibleBody(beam.floating_frame, beam.reduced.K, beam.reduced.D, holds=holds_of(joints, (), start))
    found = first_frequency(system, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(beam.reduced.size))
    assert found == pytest.approx(factor * UNIT, rel=2e-3)


@pytest.fixture(scope="module")
def block():
    """A slender block of solids, whose integrals are exact, with an interface at one end and at the other."""
    ends = [Interface(name=name, nodes=Nodes(box=((x - 1e-6, -1, -1), (x + 1e-6, 1, 1))))
            for name, x in (("hub", 0.0), ("tip", 1.0))]  # fmt: skip
    with (
        hpcred.solid((6, 1, 1), [1.0, 0.1, 0.1], 3, False, young=2e6) as bare,
        bare.with_interfaces(ends) as plain,
        plain.with_inputs(["hub", "tip"]) as model,
        hpcred.reduce(model, [Modes(index=(7, 8, 9)), Krylov(frequency=0.0)], Buckens()) as rom,
    ):
        return body_of(model, rom, interface_nodes(model))


@pytest.mark.parametrize("rate, kinds", [
    (0.2, []), (1.0, ["large deflection", "fast rotation"]),
    (10.0, ["large deflection", "fast rotation", "rotation too fast", "the simulation diverges"]),
])  # fmt: skip
def test_turning_faster_than_the_first_frequency_is_told_while_it_runs_and_noted(block, rate, kinds):
    """On a motor (Simo's spin-up): a body that nothing stiffens has no stability beyond its first frequency."""
    told = []
    setup = Simulation(
        end=1.5, steps=10, relative_tolerance=1e-4, absolute_tolerance=1e-6,
        constraint=(Joint("hub", kind="revolute", axis=(0.0, 0.0, 1.0)),),
        drive=(RampDrive(node="hub", about=(0.0, 0.0, 1.0), rate=rate, duration=1.0),),
    )  # fmt: skip
    warnings = simulate(block, setup, SimpleNamespace(say=lambda text, **_: None, warn=told.append)).warnings
    assert [text.partition(":")[0] for text in told] == kinds
    assert [re.sub(r" \(largest: .*\)$", "", text) for text in warnings] == told
    if rate == 10.0:
        speed, first, most = map(float, re.search(
            r"turns by ([\d.]+) rad/s.*hold it, ([\d.]+) rad/s \(0\.381 Hz\).*\(largest: ([\d.]+) rad/s\)", warnings[-2]
        ).groups())  # fmt: skip
        assert first <= speed < 1.5 * first and most >= speed  # printed in three digits
        place = re.search(r"node hub is ([\d.e+]+) m from .* size is ([\d.]+) m", warnings[-1])
        moved, size = map(float, place.groups())
        assert moved >= size == 1.0  # as printed, to three digits


@pytest.mark.parametrize("share, noted", [(0.1, False), (0.6, True)])
def test_a_deflection_of_more_than_a_twentieth_of_the_body_is_noted(block, share, noted):
    """A sudden force at the tip of a clamped block; half of its deflection is in the mean axes of the body."""
    force = (ConstantForce(node="tip", value=(0.0, 0.0, share * 3 * 2e6 * 0.1**4 / 12)),)
    setup = Simulation(end=1.5, steps=10, constraint=(Joint("hub", kind="fixed"),), force=force)
    notes = [note for note in simulate(block, setup).warnings if note.startswith("large deflection")]
    assert len(notes) == noted
    if noted:
        assert re.search(r"node (hub|tip) is 0\.0\d+ m .* size of the body, 1 m; .* \(largest: 0\.\d+ m\)", notes[0])


def test_a_motion_that_overflows_says_that_it_diverged(beam, monkeypatch):
    """The error carries what was seen before the end."""
    monkeypatch.setattr("hpcred.simulation.simulation._at_outputs",
                        lambda *given: _at_outputs(*given) | {"position": np.full((1, 3), np.inf)})  # fmt: skip
    with pytest.raises(ComputationError, match=r"rotation too fast: .*; the motion has numbers that overflow"):
        simulate(beam, Simulation(end=0.1, steps=2, angular_velocity=(0.0, 0.0, 30.0)))


class Told(Exception):
    pass


class StopsAtNote(Progress):
    """A Progress that ends the run at the first note."""

    def tell(self, text):
        if text.startswith("note: steps"):
            raise Told(text)


def test_a_start_that_costs_very_many_steps_is_told_before_them(beam):
    """Weight at once on an undeformed beam sets it vibrating; at rest, for a short time or for rough tolerances there
    are few steps."""
    at_once = Simulation(end=1000.0, steps=50, gravity=(0.0, 0.0, -0.01), constraint=(Joint(1, kind="fixed"),))
    with pytest.raises(Told, match=r"Hz in its stiffest mode .* output steps of 2e\+07 us; .* about \de\+0\d steps"):
        simulate(beam, at_once, StopsAtNote(MPI.COMM_SELF))
    for change in ({"start": "static"}, {"end": 0.01}, {"absolute_tolerance": 1.0, "end": 1.0}):
        motion = simulate(beam, replace(at_once, **change), StopsAtNote(MPI.COMM_SELF))
        assert not any("stiffest mode" in note for note in motion.notes)


@pytest.mark.parametrize("key", ["force", "moment", "spring"])
def test_forces_and_moments_are_inputs_by_their_kind(key):
    """Forces of a node are inputs, its moments are none."""
    both = np.eye(6)
    body = SimpleNamespace(nodes=[SimpleNamespace(node=4, label="tip", phi=both[:3], psi=both[3:])],
                           reduced=SimpleNamespace(B=both[:, :3]))  # fmt: skip
    setup = SimpleNamespace(**({"force": (), "moment": (), "spring": ()} | {key: (SimpleNamespace(node=4),)}))
    found = warnings_of_inputs(body, setup, [], {}, np.eye(3))
    assert [text.startswith("node tip: moments there (moment) are no inputs") for text in found] == [True] * (
        key == "moment")  # fmt: skip
