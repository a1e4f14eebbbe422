"""Geometric stiffness of unit states: what the equations of motion, files and units make of it."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import made_up_stiffness

import hpcred
from hpcred import Buckens, Modes, Rayleigh
from hpcred.body.body import body_of
from hpcred.body.geometric_stiffness import GeometricStiffness
from hpcred.body.units import in_units
from hpcred.model.units import Units
from hpcred.parallel.failures import InputError
from hpcred.simulation import ConstantForce, ConstantMoment
from hpcred.simulation.equations_of_motion import FlexibleBody
from hpcred.simulation.loads import load_of
from hpcred.writers import read_sid, write_sid


@pytest.fixture(scope="module")
def body():
    with (
        hpcred.linkage() as model,
        hpcred.reduce(model, [Modes(index=tuple(range(7, 12)))], Buckens(), Rayleigh(2.0, 1e-5)) as rom,
    ):
        return made_up_stiffness(body_of(model, rom, [1, 20], origin=(0.1, 0.0, -0.2)))


def test_states_stiffen_the_body_by_their_values(body):
    """Of a body with any accelerations, velocities and loads, the forces on q change by sum c_i K_i q."""
    rng = np.random.default_rng(3)
    m, q = body.reduced.size, 1e-6 * rng.normal(size=body.reduced.size)
    gravity, force, moment = rng.normal(size=(3, 3))
    v, w = z = rng.normal(size=(2, 3))
    z = np.concatenate([*z, np.zeros(m)])
    zp = np.concatenate([rng.normal(size=6), np.zeros(m)])
    rows = []
    for item in (body, body.stiffened()):
        loads = [load_of(kind(20, tuple(value)), item.nodes[1])
                 for kind, value in ((ConstantForce, force), (ConstantMoment, moment))]  # fmt: skip
        system = FlexibleBody(item.floating_frame, body.reduced.K, body.reduced.D, gravity, loads)
        y, yp = np.zeros((2, 16 + 2 * m))
        y[3], y[7 : 7 + m], y[7 + m : 13 + 2 * m], yp[7 + m : 13 + 2 * m] = 1.0, q, z, zp
        rows.append(system.residual(0.0, y, yp)[13 + m : 13 + 2 * m])
    acceleration = zp[:3] + np.cross(w, v) - gravity
    values = dict(zip(("ax", "ay", "az", "alphax", "alphay", "alphaz"), (*acceleration, *zp[3:6]), strict=True))
    values |= {"wx^2": w[0] ** 2, "wy^2": w[1] ** 2, "wz^2": w[2] ** 2}
    values |= {"wx wy": w[0] * w[1], "wy wz": w[1] * w[2], "wx wz": w[0] * w[2]}
    values |= {f"20:{name}": value for name, value in zip(("x", "y", "z", "rx", "ry", "rz"), (*force, *moment),
                                                           strict=True)}  # fmt: skip
    expected = body.geometric_stiffness.sum(values) @ q
    # rotations of the node are exact: their terms of second order in q are not those of the stiffness
    assert rows[1] - rows[0] == pytest.approx(expected, abs=1e-4 * np.abs(expected).max())


def test_displacements_of_second_order_are_those_of_the_unit_forces(body):
    """Work of a force on its node and of an acceleration on the first moment, by the matrices of their states."""
    q = np.random.default_rng(4).normal(size=body.reduced.size)
    linear, second = (item.nodes[1].motion(q) for item in (body, body.stiffened()))
    found = np.concatenate([second[0] - linear[0], second[1] - linear[1]])
    assert found == pytest.approx(-q @ body.geometric_stiffness.of_node(body.nodes[1]) @ q / 2)
    moments = [item.floating_frame.first_moment(q) for item in (body, body.stiffened())]
    assert moments[1] - moments[0] == pytest.approx(q @ body.geometric_stiffness.of(["ax", "ay", "az"]) @ q / 2)
    h = 1e-5
    step = np.random.default_rng(5).normal(size=len(q))
    node = body.stiffened().nodes[1]
    for place in (0, 1):
        slope = (node.motion(q + h * step)[place] - node.motion(q - h * step)[place]) / (2 * h)
        assert node.motion(q)[place + 2] @ step == pytest.approx(slope)


def test_other_units_are_the_same_stiffness(body):
    """c_i K_i of a state is a stiffness, whose energy is the same in all units."""
    units = Units("mm, t, cs", length=1e-3, mass=1e3, time=1e-2)
    L, M, T = units.length, units.mass, units.time
    other = in_units(body, units)
    g, energy = L * np.sqrt(M), M * L**2 / T**2
    q = np.random.default_rng(4).normal(size=body.reduced.size)
    sizes = {"ax": L / T**2, "alphaz": 1 / T**2, "wx wy": 1 / T**2, "20:y": M * L / T**2, "1:rx": energy}
    for state, size in sizes.items():
        here, there = (item.geometric_stiffness.sum({state: value}) for item, value in ((body, size), (other, 1.0)))
        assert (g * q) @ here @ (g * q) == pytest.approx(energy * (q @ there @ q))
    assert other.geometric_stiffness.origin == pytest.approx([100.0, 0.0, -200.0])


@pytest.mark.mpi
def test_results_keep_it(comm, folder):
    with hpcred.linkage(comm) as model, hpcred.reduce(model, [Modes(index=(7, 8, 9))], Buckens()) as rom:
        stiff = made_up_stiffness(body_of(model, rom, [20])).geometric_stiffness
        hpcred.write_result(folder / "r.h5", rom, model, geometric_stiffness=stiff)
        result = hpcred.read_result(folder / "r.h5", comm)
        found = result.geometric_stiffness
        assert found.states == stiff.states and (found.matrices == stiff.matrices).all()
        assert result.body([20]).stiffened().nodes[0].phi1.any()
        with pytest.raises(InputError, match=r"geometric stiffness: found the origin \[0.0, 0.0, 0.0\] m, expected"):
            hpcred.write_result(folder / "moved.h5", rom, model, origin=(1.0, 0.0, 0.0), geometric_stiffness=stiff)
        hpcred.write_result(folder / "r.h5", rom, model)
        assert hpcred.read_result(folder / "r.h5", comm).geometric_stiffness is None


def test_sid_files_have_it_as_parts_linear_in_q(body, tmp_path):
    """O. Wallrapp (1994): Ct, Cr and Oe are on the side of the inertia, so that they have K of a unit state, phi and
    psi on that of the forces, with the other sign."""
    path = tmp_path / "body.SID_FEM"
    write_sid(path, body)
    sid, stiff = read_sid(path), body.geometric_stiffness
    for name, states in (("Ct", stiff.states[:3]), ("Cr", stiff.states[3:6]), ("Oe", stiff.states[6:12])):
        plain = {"Ct": 0.0, "Cr": body.floating_frame.Cr1, "Oe": body.floating_frame.Oe1}[name]
        assert sid.objects[name].order == 1
        assert sid.objects[name].m1 - plain == pytest.approx(np.moveaxis(stiff.of(states), 0, 2), abs=1e-9)
    for node in sid.nodes:
        assert node.objects["phi"].m1 == pytest.approx(-stiff.of([f"{node.node}:{d}" for d in "xyz"]), abs=1e-9)
        assert node.objects["psi"].m1 == pytest.approx(-stiff.of([f"{node.node}:r{d}" for d in "xyz"]), abs=1e-9)
    # those of velocities are as without
    write_sid(tmp_path / "plain.SID_FEM", replace(body, geometric_stiffness=None))
    plain = read_sid(tmp_path / "plain.SID_FEM")
    for name in ("Ge", "Gr", "Me", "Ke", "J", "mdCM"):
        assert sid.objects[name].m0 == pytest.approx(plain.objects[name].m0)
    assert plain.objects["Ct"].order == 0 and plain.nodes[0].objects["phi"].order == 0


WRONG = [
    (("az", "wz"), np.zeros((2, 3, 3)), r"found the state 'wz', expected one of ax, ay"),
    (("crank:along",), np.zeros((1, 3, 3)), r"found the state 'crank:along', expected one of ax.* crank:x or 20:rz"),
    (("az", "az"), np.zeros((2, 3, 3)), r"found a state twice in az, az"),
    (("az",), np.zeros((3, 3)), r"found matrices \(3, 3\) for 1 states, expected a square one each"),
]


@pytest.mark.parametrize("states, matrices, says", WRONG)
def test_stiffness_that_does_not_fit(states, matrices, says):
    with pytest.raises(InputError, match=says):
        GeometricStiffness(states, matrices, np.zeros(3))


def test_stiffness_of_another_basis(body):
    other = GeometricStiffness(("ax",), np.zeros((1, 3, 3)), body.floating_frame.origin)
    with pytest.raises(InputError, match="found matrices of 3 coordinates, expected 5: it belongs to another basis"):
        replace(body, geometric_stiffness=other)
    with pytest.raises(InputError, match="found no state 'ay'; there are ax"):
        other.sum({"ay": 1.0})
