"""The integrator: its order, what it damps, and stiff bodies in few steps."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import bar

import hpcred
from hpcred import Buckens, Krylov, Modes, Simulation
from hpcred.body.body import body_of
from hpcred.parallel.failures import InputError
from hpcred.parallel.petsc import MPI
from hpcred.simulation import Bushing, Joint
from hpcred.simulation.integration import amplification, note_on_damping, step_of
from hpcred.simulation.simulation import simulate

HINGE = Joint(1, kind="revolute", axis=(0.0, 1.0, 0.0))
WEIGHT = (0.0, 0.0, -9.81)


@pytest.fixture(scope="module")
def beam():
    """A free undamped steel beam, whose static corrections are pseudo-modes far above its first frequencies."""
    with (
        bar(MPI.COMM_SELF, 1.0, 6, young=2.1e11, density=7850.0, diameter=0.01) as bare,
        bare.with_inputs([(1, "all"), (7, "all")]) as model,
        hpcred.reduce(model, [Modes(index=(7, 8, 9, 10)), Krylov(frequency=0.0)], Buckens()) as rom,
    ):
        return body_of(model, rom, [1, 7])


def vibration(body, times, periods, amplitude=1e-7):
    """Elastic coordinate and exact values of the first mode of a free body, let go, in steps of `times` a radian."""
    values, shapes = np.linalg.eigh(body.reduced.K)
    omega, shape = np.sqrt(values[0]), shapes[:, 0]
    setup = Simulation(
        end=periods * 2 * np.pi / omega, steps=8 * periods, elastic=tuple(amplitude * shape), relative_tolerance=1e-9,
        absolute_tolerance=1e-16, damp_above=times * omega / (2 * np.pi),
    )  # fmt: skip
    motion = simulate(body, setup)
    assert any(note.startswith("damp_above: steps of") for note in motion.notes)
    return motion.elastic @ shape / amplitude, np.cos(omega * motion.t)


def test_the_order_is_five(beam):
    """Errors of a free vibration, in steps that are halved; output times of 8 a period are no steps."""
    errors = []
    for times in (2.0, 4.0):
        found, exact = vibration(beam, times, 4)
        errors.append(np.abs(found - exact)[::32].max())
    assert 4.5 < np.log2(errors[0] / errors[1]) < 5.7 and errors[1] < 1e-3


@pytest.mark.parametrize("times", [1.0, 0.25])
def test_only_vibrations_above_the_frequency_are_damped(beam, times):
    """By the factor |R(i omega h)| a step; at the frequency itself a thousandth a period is lost."""
    found, _ = vibration(beam, times, 20)
    loss = abs(amplification(1j / times)) ** (20 * 2 * np.pi * times)
    assert np.abs(found[-8:]).max() == pytest.approx(loss, abs=0.02)
    assert loss > 0.98 if times == 1.0 else loss < 0.01


def test_an_undamped_pendulum_keeps_its_energy_in_few_steps(beam):
    """It starts undeformed under its weight; against a much smaller tolerance."""
    setup = Simulation(end=0.1, gravity=WEIGHT, constraint=(HINGE,), steps=20)
    rough, fine = (simulate(beam, replace(setup, relative_tolerance=r, absolute_tolerance=a))
                   for r, a in ((1e-5, 1e-8), (1e-7, 1e-10)))  # fmt: skip
    way = np.abs(fine.node_displacement).max()
    assert np.abs(rough.node_displacement - fine.node_displacement).max() < 1e-4 * way and way > 0.04
    assert rough.balance < 1e-4 and fine.balance < 1e-6 and rough.drift < 1e-7
    stiffest = np.sqrt(np.linalg.eigvalsh(beam.reduced.K)[-1]) / (2 * np.pi)
    assert rough.integrator_steps < 100 < stiffest * setup.end  # periods of the stiffest pseudo-mode


def test_a_very_stiff_bushing_takes_few_steps(beam):
    """1e12 N/m, which as a spring of the beam has a period of nanoseconds, is as good as a joint."""
    setup = Simulation(end=0.01, gravity=WEIGHT, constraint=(Joint(1, kind="fixed"),), steps=10)
    spring = simulate(beam, replace(setup, spring=(Bushing(7, (1e12, 1e12, 1e12)),)))
    joint = simulate(beam, replace(setup, constraint=(*setup.constraint, Joint(7))))
    assert spring.integrator_steps < 75 and spring.drift < 1e-9
    assert np.abs(spring.node_displacement[:, 1]).max() < 1e-10
    assert spring.elastic == pytest.approx(joint.elastic, abs=1e-2 * np.abs(joint.elastic).max())


@pytest.mark.parametrize("value, says", [
    (0.0, "damp_above: found 0"), (-5.0, "damp_above: found -5"), (np.nan, "damp_above: found nan"),
    (1e11, r"damp_above = 1e\+11 takes 6.3e\+11 steps"),
])  # fmt: skip
def test_frequencies_that_no_integrator_takes(beam, value, says):
    with pytest.raises(InputError, match=says):
        simulate(beam, Simulation(end=1.0, damp_above=value))


def test_the_step_of_a_frequency():
    assert step_of(100.0) == pytest.approx(1 / (200 * np.pi))
    z = 1e-2j  # R(z) is exp(z) up to z^6
    assert abs(amplification(z) - np.exp(z)) < 1e-14 and abs(amplification(1e6j)) < 1e-5
    # by the stages of the method, over as many steps as a period has
    root = np.sqrt(6.0)
    A = np.array([[88 - 7 * root, 296 - 169 * root, -2 + 3 * root], [296 + 169 * root, 88 + 7 * root, -2 - 3 * root],
                  [16 - root, 16 + root, 1]]) / [[360, 1800, 225], [1800, 360, 225], [36, 36, 9]]  # fmt: skip
    lost = [1 - abs(1 + z * A[2] @ np.linalg.solve(np.eye(3) - z * A, np.ones(3))) ** (2 * np.pi / abs(z))
            for z in (1j, 2j, 4j)]  # fmt: skip
    words = note_on_damping(SimpleNamespace(damp_above=50.0))
    assert [float(word) for word in re.findall(r"([\d.e-]+) %", words)] == [
        float(f"{100 * part:.{digits}g}") for part, digits in zip(lost, (1, 1, 2), strict=True)]  # fmt: skip
