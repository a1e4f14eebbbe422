"""The beam of Simo and Vu-Quoc on a motor, of solids, against a geometrically exact one."""

from functools import cache

import numpy as np
import pytest
from helpers import face
from solid_meshes import mass, mesh, model_of, stiffness

import hpcred
from hpcred import Modes, Simulation, Tangent
from hpcred.body.body import body_of
from hpcred.body.rotations import rotation
from hpcred.fe import Material
from hpcred.fe.element_rules import rule_of
from hpcred.simulation import Joint, RampDrive
from hpcred.simulation.simulation import simulate

# J. C. Simo and L. Vu-Quoc, J. Appl. Mech. 53 (1986) 849: EI, EA, mass a length and length; 15 s to the full speed
EI, EA, MASS, LENGTH, RISE = 1.4e4, 2.8e7, 1.2, 10.0, 15.0
# displacements (m) of the tip normal to the rotating axis, over time (s), of 16 ObjectANCFCable2D of Exudyn 1.13.6 in
# steps of 5 ms
EXACT = {
    6.0: [(2.0034, -0.102627), (4.0034, -0.342548), (5.0034, -0.468897), (6.0034, -0.543812), (7.0034, -0.571228),
          (8.0034, -0.542904), (9.0034, -0.460062), (10.0034, -0.362524), (12.0034, -0.150688)],
    2.0: [(2.0, -0.034233), (4.0037, -0.114924), (5.0037, -0.158801), (6.0037, -0.18878), (7.0037, -0.206499),
          (8.0037, -0.205309), (9.0037, -0.184222), (10.0037, -0.153124), (12.0037, -0.068031)],
}  # fmt: skip


@cache
def beam():
    height = np.sqrt(12 * EI / EA)
    young, density = EA / height**2, MASS / height**2
    kind, points_and_cells = "hexahedron20", mesh("hexahedron20", (20, 1, 1), (LENGTH, height, height), 0.0)
    material = Material(name="beam", young=young, poisson=0.0, density=density)
    K = stiffness(kind, rule_of("hpcred", kind, kind), *points_and_cells, young, 0.0)
    M = mass(kind, *points_and_cells, density)
    from mpi4py import MPI

    with model_of(kind, "hpcred", kind, *points_and_cells, material, MPI.COMM_SELF, K=K, M=M) as plain:
        ends = [face("left", 0.0, kind="rigid"), face("right", LENGTH, kind="rigid")]
        with plain.with_interfaces(ends) as model, hpcred.reduce(model, [Modes(count=6)], Tangent("left")) as rom:
            assert rom.frequencies[0] == pytest.approx(1.8751041**2 / 2 / np.pi * np.sqrt(EI / MASS / LENGTH**4), 2e-3)
            stiff = hpcred.geometric_stiffness(model, rom.columns, Tangent("left"))
            return body_of(model, rom, geometric_stiffness=stiff)


def tip(speed, **more):
    """Times and displacements (nt, 3) of the tip in the axes of the hub."""
    setup = Simulation(
        end=12.5, steps=250, constraint=(Joint("left", kind="fixed"),), observe=("right",),
        drive=(RampDrive(node="left", about=(0.0, 0.0, 1.0), rate=speed, duration=RISE),), **more,
    )  # fmt: skip
    motion = simulate(beam(), setup)
    place = motion.node_position[:, motion.node_names.index("right")] - motion.position
    return motion.t, np.einsum("tji,tj->ti", rotation(motion.quaternion), place)


@pytest.mark.parametrize("speed", [pytest.param(6.0, marks=pytest.mark.slow), 2.0])
def test_the_spin_up_of_a_beam_is_that_of_a_geometrically_exact_one(speed):
    t, place = tip(speed)
    when, exact = np.array(EXACT[speed]).T
    found = np.interp(when, t, place[:, 1] - place[0, 1])
    assert np.abs(found - exact).max() < 0.01 * np.abs(exact).max()
    # the beam becomes shorter, by about 0.6 / L of the square of the displacement
    deepest = place[:, 1].argmin()
    shorter = LENGTH - place[deepest, 0]
    assert shorter == pytest.approx(0.6 * (place[deepest, 1] - place[0, 1]) ** 2 / LENGTH, rel=0.1)


def test_without_geometric_stiffness_it_leaves():
    t, place = tip(2.0, geometric_stiffness=False)
    when, exact = np.array(EXACT[2.0]).T
    found = np.interp(when, t, place[:, 1] - place[0, 1])
    assert 0.1 < np.abs(found - exact).max() / np.abs(exact).max() < 0.3
