"""A body in other units: the same energies, forces and motions."""

import numpy as np
import pytest
from helpers import block_with_ends

import hpcred
from hpcred import Buckens, CraigBampton, Modes
from hpcred.body.body import body_of
from hpcred.body.units import in_units
from hpcred.model.units import Units
from hpcred.simulation.equations_of_motion import FlexibleBody


def bodies(comm, coordinates):
    units = Units("mm, t, cs", length=1e-3, mass=1e3, time=1e-2)
    with block_with_ends(comm, cells=(4, 2, 2)) as model:
        basis = [CraigBampton(count=2)] if coordinates == "interface" else [Modes(count=4)]
        damping = hpcred.Rayleigh(20.0, 1e-7)
        with hpcred.reduce(model, basis, Buckens(), damping, coordinates=coordinates) as rom:
            body = body_of(model, rom, origin=(0.01, 0.0, -0.02))
    return body, in_units(body, units), units


@pytest.mark.parametrize("coordinates", ["modal", "interface"])
def test_energies_and_responses_are_the_same(comm, coordinates):
    """With velocities v L / T and w / T of the body, and q_SI = g q of the coordinates: kinetic energy E of the moving
    body, E_SI = E M L^2 / T^2."""
    body, other, units = bodies(comm, coordinates)
    L, M, T = units.length, units.mass, units.time
    m, rng = body.reduced.size, np.random.default_rng(2)
    g = np.full(m, L * np.sqrt(M))
    if coordinates == "interface":
        g[:12] = np.tile([L, L, L, 1.0, 1.0, 1.0], 2)
    q, rate = 1e-3 * rng.standard_normal((2, m))
    v, w = rng.standard_normal((2, 3))
    energy = L**2 * M / T**2
    systems = [FlexibleBody(item.floating_frame, item.reduced.K, item.reduced.D) for item in (body, other)]
    speeds = np.concatenate([v * L / T, w / T, g * rate / T]), np.concatenate([v, w, rate])
    found = [speed @ system.floating_frame.mass_matrix(state) @ speed
             for speed, system, state in zip(speeds, systems, (g * q, q), strict=True)]  # fmt: skip
    assert found[0] == pytest.approx(energy * found[1])
    assert (g * q) @ body.reduced.K @ (g * q) == pytest.approx(energy * (q @ other.reduced.K @ q))
    power = (g * rate / T) @ body.reduced.D @ (g * rate / T)
    assert power == pytest.approx(energy / T * (rate @ other.reduced.D @ rate))
    assert body.floating_frame.mass == pytest.approx(M * other.floating_frame.mass)
    assert other.floating_frame.origin == pytest.approx(body.floating_frame.origin / L)
    for one, two in zip(body.nodes, other.nodes, strict=True):
        assert one.position == pytest.approx(L * two.position)
        assert one.phi @ (g * q) == pytest.approx(L * two.phi @ q)
        assert one.psi @ (g * q) == pytest.approx(two.psi @ q)
    s = 2j * np.pi * 900.0
    here, there = body.reduced.transfer_function(s), other.reduced.transfer_function(s * T)
    turns = np.tile([False] * 3 + [True] * 3, 2)
    load, motion = np.where(turns, energy, energy / L), np.where(turns, 1.0, L)
    size = np.sqrt(np.multiply.outer(*2 * [np.abs(np.diag(here))]))  # of the units of an entry
    assert np.allclose(here, motion[:, None] * there / load, rtol=1e-9, atol=1e-14 * size)


def test_loads_in_other_units(comm):
    """The factor of a load has no unit, and its output is work: the same work in other units."""
    units = Units("mm, t, cs", length=1e-3, mass=1e3, time=1e-2)
    push = hpcred.loads.Traction(name="push", on="right", value=(1e4, 2e4, 5e3))
    with (
        block_with_ends(comm, cells=(4, 2, 2)) as model, model.with_loads([push]) as loaded,
        hpcred.reduce(loaded, [Modes(count=4)], Buckens()) as rom,
    ):  # fmt: skip
        body = body_of(loaded, rom, origin=(0.01, 0.0, -0.02))
    other = in_units(body, units)
    L, energy = units.length, units.energy
    at = body.reduced.input_names.index("push")
    assert body.reduced.resultants[at, :3] == pytest.approx(other.reduced.resultants[at, :3] * energy / L)
    assert body.reduced.resultants[at, 3:] == pytest.approx(other.reduced.resultants[at, 3:] * energy)
    assert body.reduced.resultants[:, :3] == pytest.approx(
        other.reduced.resultants[:, :3] * np.array([energy / L if i == at else 1.0 if ":r" not in name else 1 / L
                                                    for i, name in enumerate(body.reduced.input_names)])[:, None]
    )  # fmt: skip
    H, G = (item.reduced.transfer_function(s)  # s in rad / time
            for item, s in ((body, 3e4j), (other, 3e4j * units.time)))  # fmt: skip
    assert H[at, at] == pytest.approx(energy * G[at, at])
    assert H[1, at] == pytest.approx(L * G[1, at]) and H[at, 1] == pytest.approx(L * G[at, 1])
