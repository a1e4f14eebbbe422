"""Bodies on joints, springs and drives against closed solutions."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate
import scipy.special
from helpers import bar
from scipy.spatial.transform import Rotation

import hpcred
from hpcred import Buckens, Modes, Rayleigh, Simulation
from hpcred.body.body import body_of
from hpcred.examples.linkage import Rod
from hpcred.parallel.failures import InputError
from hpcred.simulation import (
    Bushing,
    ConstantDrive,
    ConstantForce,
    ConstantMoment,
    Joint,
    LineSpring,
    RampDrive,
    SineDrive,
    SineMoment,
)
from hpcred.simulation.integration import integrate
from hpcred.simulation.simulation import POWERS, simulate

FINE = {"relative_tolerance": 1e-7, "absolute_tolerance": 1e-10}
GRAVITY = (0.0, 0.0, -9.81)


def beam_body(comm, modes, beta, **rod):
    """A free beam of 1 m along x with nodes 1 to 3 and stiffness damping, which leaves rigid motion alone."""
    with (
        bar(comm, 1.0, 2, **rod) as model,
        hpcred.reduce(model, [Modes(index=tuple(modes))], Buckens(), Rayleigh(0.0, beta)) as rom,
    ):
        return body_of(model, rom, [1, 2, 3])


@pytest.fixture(scope="module")
def stiff(comm):
    """A beam that hardly bends, with two modes."""
    return beam_body(comm, (7, 8), 1e-3, young=2.1e13)


@pytest.fixture(scope="module")
def flexible(comm):
    """A beam with all elastic modes of its two elements."""
    return beam_body(comm, range(7, 19), 0.0)


def test_a_pendulum_on_a_revolute_joint_has_the_period_of_an_elliptic_integral(stiff):
    """A rod of 1 m let go from 120 degrees: T = 4 sqrt(2 L / (3 g)) K(sin^2(60 degrees))."""
    amplitude = np.radians(120.0)
    period = 4 * np.sqrt(2 / (3 * 9.81)) * scipy.special.ellipk(np.sin(amplitude / 2) ** 2)
    setup = Simulation(
        end=period, gravity=GRAVITY, rotation=(0.0, np.pi / 2 - amplitude, 0.0), steps=100,
        constraint=(Joint(1, kind="revolute", axis=(0.0, 1.0, 0.0)),), relative_tolerance=1e-6, absolute_tolerance=1e-9,
    )  # fmt: skip
    motion = simulate(stiff, setup)
    tip = motion.node_position[:, motion.nodes.index(3)]
    assert tip[0] == pytest.approx([np.sin(amplitude), 0, -np.cos(amplitude)], abs=1e-6)
    assert tip[-1] == pytest.approx(tip[0], abs=2e-4) and tip[50, 0] == pytest.approx(-tip[0, 0], abs=2e-4)
    assert tip[25] == pytest.approx([0, 0, -1], abs=2e-3)
    assert motion.drift < 1e-7 and motion.rotation_drift < 1e-7 and motion.balance < 1e-5
    turned = Rotation.from_rotvec(motion.node_rotation[25, motion.nodes.index(1)])
    assert turned.as_rotvec() == pytest.approx([0, amplitude, 0], abs=2e-3)
    assert motion.moment_names == ["1:rx", "1:rz"]  # none about the axis
    assert np.abs(motion.constraint_moment).max() < 1e-6  # the pendulum swings in its plane


@pytest.mark.parametrize("sign", [1, -1])
def test_drift_and_balance_are_the_largest_of_all_times(stiff, monkeypatch, sign):
    """Of a pendulum that is moved and turned out of its joint afterwards, more and more, and back at the end."""

    def out_of_the_joint(*arguments):
        t, states, *others = integrate(*arguments)
        states = np.array(states)
        states[:3] += sign * 1e-3 * np.sin(3 * t / t[-1])
        states[4] += sign * 1e-3 * np.sin(3 * t / t[-1])  # of the quaternion
        return t, states, *others

    monkeypatch.setattr("hpcred.simulation.simulation.integrate", out_of_the_joint)
    revolute = Joint(1, kind="revolute", axis=(0.0, 1.0, 0.0))
    motion = simulate(stiff, Simulation(end=0.1, gravity=GRAVITY, steps=20, constraint=(revolute,)))
    held = motion.nodes.index(1)
    away = motion.node_position[:, held] - motion.node_position[0, held]
    assert 1e-4 < motion.drift == pytest.approx(np.abs(away).max(), rel=1e-6)
    axis = Rotation.from_rotvec(motion.node_rotation[:, held]).apply([0.0, 1.0, 0.0])
    tilt = np.cross([0.0, 1.0, 0.0], axis)[:, [0, 2]]
    assert 1e-4 < motion.rotation_drift == pytest.approx(np.abs(tilt).max(), rel=1e-6)
    energies = dict(motion.energies)
    spent = energies.pop("work") + energies.pop("drives") - energies.pop("dissipated")
    defect = sum(energies.values()) - sum(energies.values())[0] - spent
    energies["gravity"] = energies["gravity"] - energies["gravity"][0]
    size = max(np.abs(value).max() for value in (*energies.values(), *(motion.energies[key] for key in POWERS)))
    assert 1e-4 < motion.balance == pytest.approx(np.abs(defect).max() / size, rel=1e-6)


def test_a_torsion_bar_under_a_moment(flexible):
    """Angle M L / (G J) at rest; let go, it swings as two linear elements do, to which waves sin(k x) are exact.

    With k h = pi / 4 and 3 pi / 4 and c^2 = G / rho: omega = c / h sqrt(6 (1 - cos k h) / (2 + cos k h)).
    """
    rod, moment = Rod(), 2.0
    shear = rod.young / (2 * (1 + rod.poisson))
    setup = Simulation(
        end=1e-3, start="static", steps=4, constraint=(Joint(1, kind="fixed"),),
        moment=(ConstantMoment(3, (moment, 0.0, 0.0)),),
    )  # fmt: skip
    motion = simulate(flexible, setup)
    angle = moment / (shear * 2 * rod.second_moment)
    expected = angle * np.array([[0, 0, 0], [0.5, 0, 0], [1, 0, 0]])
    assert motion.node_rotation == pytest.approx(np.tile(expected, (5, 1, 1)), abs=1e-6 * angle)
    reaction = dict(zip(motion.moment_names, motion.constraint_moment[-1], strict=True))
    assert reaction == pytest.approx({"1:rx": -moment, "1:ry": 0, "1:rz": 0}, abs=1e-6)
    cosines = np.cos(np.pi / 4 * np.array([1, 3]))
    omega = np.sqrt(shear / rod.density * 6 * (1 - cosines) / (2 + cosines)) / 0.5
    released = Simulation(
        end=4 * np.pi / omega[0], position=tuple(motion.position[0]), elastic=tuple(motion.elastic[0]), steps=40,
        rotation=tuple(Rotation.from_quat(np.roll(motion.quaternion[0], -1)).as_rotvec()),
        constraint=(Joint(1, kind="fixed"),), relative_tolerance=1e-6, absolute_tolerance=1e-11,
    )  # fmt: skip
    motion = simulate(flexible, released)
    share = (1 + np.array([1, -1]) * np.sqrt(0.5)) / 2
    expected = angle * np.cos(np.outer(motion.t, omega)) @ share
    # rotations count from the undeformed beam, whose frame lies turned
    assert motion.node_rotation[:, 2, 0] + released.rotation[0] == pytest.approx(expected, abs=2e-3 * angle)
    assert motion.rotation_drift < 1e-8 and motion.balance < 1e-4


def test_a_clamped_beam_that_a_hub_turns(comm):
    """Stretch of a bar in steady rotation by linear theory: E A u'' = -rho A Omega^2 x, free at the end.

    u = rho Omega^2 / E (L^2 x / 2 - x^3 / 6) to first order of u / L. The frame turns; bending is not stiffened by the
    centrifugal force, because the displacement field is linear in the elastic coordinates. The integrals of beams are
    means of directions, which for two elements leaves 2 %.
    """
    body, rod, rate, rise, axis = beam_body(comm, range(7, 19), 3e-3), Rod(), 30.0, 0.2, (0.0, 0.0, 1.0)
    setup = Simulation(
        end=0.5, steps=50, constraint=(Joint(1, kind="fixed"),),
        drive=(RampDrive(node=1, about=axis, rate=rate, duration=rise),),
    )  # fmt: skip
    motion = simulate(body, setup)
    turn = rate * (motion.t[-1] - rise / 2)
    local = Rotation.from_rotvec(turn * np.array(axis)).inv().apply(motion.node_position[-1])
    along = np.array([0.0, 0.5, 1.0])
    stretch = rod.density * rate**2 / rod.young * (along / 2 - along**3 / 6)
    assert local[:, 0] - along == pytest.approx(stretch, rel=2.5e-2, abs=1e-8)
    assert np.abs(local[:, 1:]).max() < 2e-5
    assert motion.balance < 1e-4 and motion.drift < 1e-6 and motion.rotation_drift < 1e-5
    kinetic = 0.5 * rod.density * rod.area / 3 * rate**2
    assert motion.energies["kinetic"][-1] == pytest.approx(kinetic, rel=1e-3)
    given = motion.energies["drives"][-1] - motion.energies["dissipated"][-1]
    assert given == pytest.approx(kinetic, rel=1e-3) and not motion.energies["work"].any()


def test_a_rotating_guide_lets_a_body_fly_out(stiff):
    """Prismatic on a support that turns with Omega: s'' = Omega^2 (s + 1/2) for the rod's centre; slides from rest."""
    rate = 2.0
    setup = Simulation(
        end=0.8, constraint=(Joint(1, kind="prismatic", axis=(1.0, 0.0, 0.0)),), steps=40,
        drive=(RampDrive(node=1, about=(0.0, 0.0, 1.0), rate=rate),), **FINE,
    )  # fmt: skip
    motion = simulate(stiff, setup)
    place = motion.node_position[:, motion.nodes.index(1)]
    slid = 0.5 * (np.cosh(rate * motion.t) - 1)
    turned = rate * motion.t
    assert place == pytest.approx((slid * [np.cos(turned), np.sin(turned), 0 * turned]).T, abs=1e-5)
    assert motion.balance < 1e-6 and motion.drift < 1e-7
    assert any("velocities did not fit" in note for note in motion.notes)


def test_a_body_on_an_inclined_guide_falls_freely_along_it(stiff):
    axis = np.array([0.6, 0.0, -0.8])
    setup = Simulation(end=0.5, gravity=GRAVITY, constraint=(Joint(2, kind="prismatic", axis=tuple(axis)),), steps=20,
                       **FINE)  # fmt: skip
    motion = simulate(stiff, setup)
    moved = motion.node_displacement[:, motion.nodes.index(2)]
    assert moved == pytest.approx(0.5 * 9.81 * 0.8 * motion.t[:, None] ** 2 * axis, abs=1e-6)
    weight = stiff.floating_frame.mass * 9.81
    force = motion.constraint_force[-1] @ [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert force == pytest.approx(-weight * (np.array([0, 0, -1]) - 0.8 * axis), abs=1e-2 * weight)
    assert force @ axis == pytest.approx(0, abs=1e-6 * weight)


def test_a_prismatic_and_a_cylindrical_joint_differ_by_the_rotation(stiff):
    axis = (1.0, 0.0, 0.0)
    load = {"force": (ConstantForce(1, (3.0, 0.0, 0.0)),), "moment": (ConstantMoment(1, (1e-3, 0.0, 0.0)),)}
    mass, inertia = stiff.floating_frame.mass, stiff.floating_frame.J[0, 0]
    for kind, turned in (("prismatic", 0.0), ("cylindrical", 0.5 * 1e-3 / inertia * 0.2**2)):
        setup = Simulation(end=0.2, constraint=(Joint(1, kind=kind, axis=axis),), steps=10, **load, **FINE)
        motion = simulate(stiff, setup)
        assert motion.node_displacement[-1, 0] == pytest.approx([0.5 * 3.0 / mass * 0.2**2, 0, 0], rel=1e-3, abs=1e-6)
        assert motion.node_rotation[-1, 0] == pytest.approx([turned, 0, 0], rel=1e-3, abs=1e-7)
        assert motion.energies["work"][-1] == pytest.approx(
            3.0 * motion.node_displacement[-1, 0, 0] + 1e-3 * motion.node_rotation[-1, 0, 0], rel=1e-6
        )


def test_a_universal_joint_turns_about_its_cross_and_transmits_a_moment_normal_to_it(stiff):
    """Hung at its middle with a cross of y (ground) and z (node), and moments about all axes."""
    setup = Simulation(
        end=0.4, constraint=(Joint(2, kind="universal", axes=((0.0, 1.0, 0.0), (0.0, 0.0, 1.0))),), steps=20,
        moment=(ConstantMoment(2, (5.0, 0.8, 0.0)), SineMoment(2, (0.0, 0.0, 0.6), 2.0)), **FINE,
    )  # fmt: skip
    motion = simulate(stiff, setup)
    R = Rotation.from_rotvec(motion.node_rotation[:, motion.nodes.index(2)]).as_matrix()
    other = R @ [0.0, 0.0, 1.0]
    assert np.abs(other[:, 1]).max() < 1e-8  # the cross stays square
    beta, alpha = np.arcsin(R[:, 1, 0]), np.arctan2(other[:, 0], other[:, 2])
    expected = Rotation.from_euler("YZ", np.array([alpha, beta]).T).as_matrix()
    assert R == pytest.approx(expected, abs=1e-7)  # noqa: SIM300
    assert np.abs(alpha).max() > 0.1 and np.abs(beta).max() > 0.05
    assert motion.moment_names == ["2:rx", "2:ry", "2:rz"]
    normal = np.cross(other, [0.0, 1.0, 0.0])
    moment = motion.constraint_moment
    assert np.abs(moment[:, 1]).max() < 1e-8 and np.abs((moment * other).sum(axis=1)).max() < 1e-8
    assert np.abs((moment * normal).sum(axis=1)).min() > 1.0
    assert motion.balance < 1e-6 and motion.rotation_drift < 1e-8


def test_a_mass_on_a_spring_damper_decays(stiff):
    """x = x0 exp(-d t) (cos w t + d / w sin w t), d = c / (2 m), w^2 = k / m - d^2."""
    mass = stiff.floating_frame.mass
    k, c, pulled = 400.0 * mass, 4.0 * mass, 0.1
    setup = Simulation(
        end=1.0, steps=100, constraint=(Joint(1, kind="prismatic", axis=(1.0, 0.0, 0.0)),),
        spring=(LineSpring(1, (-1.0, 0.0, 0.0), k, c, 1.0 - pulled),), **FINE,
    )  # fmt: skip
    motion = simulate(stiff, setup)
    d = c / (2 * mass)
    w = np.sqrt(k / mass - d * d)
    expected = pulled * np.exp(-d * motion.t) * (np.cos(w * motion.t) + d / w * np.sin(w * motion.t)) - pulled
    assert motion.node_displacement[:, 0] == pytest.approx(np.outer(expected, [1, 0, 0]), abs=1e-6)
    assert motion.spring_energy[0, 0] == pytest.approx(0.5 * k * pulled**2)
    assert motion.energies["springs"] == pytest.approx(motion.spring_energy[:, 0])
    lost = motion.spring_energy[0, 0] - motion.spring_energy[-1, 0] - motion.energies["kinetic"][-1]
    assert motion.energies["dissipated"][-1] == pytest.approx(lost, rel=1e-5) and lost > 0
    assert motion.balance < 1e-6 and motion.spring_names == ["1:1"]
    assert motion.spring_force[0, 0] == pytest.approx([-k * pulled, 0, 0])


def test_a_body_on_bushings(stiff):
    """Held by one bushing at its middle: at rest under its weight and a moment, then turning as a torsion spring."""
    mass = stiff.floating_frame.mass
    weight, moment, stiffness = 9.81 * mass, 0.7, (10.0, 20.0, 30.0)
    bushing = Bushing(2, (1e5, 1e5, 1e4), rotational_stiffness=stiffness)
    setup = Simulation(
        end=0.05, start="static", gravity=GRAVITY, steps=10, spring=(bushing,),
        moment=(ConstantMoment(2, (0.0, moment, 0.0)),), **FINE,
    )  # fmt: skip
    motion = simulate(stiff, setup)
    assert motion.node_displacement[:, 1] == pytest.approx(np.tile([0, 0, -weight / 1e4], (11, 1)), abs=1e-8)
    assert motion.node_rotation[:, 1] == pytest.approx(np.tile([0, moment / 20, 0], (11, 1)), abs=1e-7)
    assert motion.spring_force[-1, 0, 2] == pytest.approx(weight)
    assert motion.spring_moment[-1, 0, 1] == pytest.approx(-moment)
    # of the rod about its middle, turned about z
    inertia, amplitude = mass / 12, 1.0
    omega = np.sqrt(stiffness[2] / inertia)
    constraint = (Joint(2, kind="revolute", axis=(0.0, 0.0, 1.0)),)
    setup = Simulation(
        end=np.pi / omega, constraint=constraint, angular_velocity=(0.0, 0.0, amplitude * omega),
        spring=(bushing,), steps=20, position=(-0.5, 0.0, 0.0), velocity=(0.0, -0.5 * amplitude * omega, 0.0),
    )  # fmt: skip
    motion = simulate(stiff, setup)
    assert motion.node_rotation[:, 1, 2] == pytest.approx(amplitude * np.sin(omega * motion.t), abs=1e-3)
    assert motion.balance < 1e-4


def test_a_support_that_shakes(stiff):
    """A pendulum whose pivot is driven, small angles: L_r phi'' + g phi = -a'', L_r = 2 L / 3."""
    shake = SineDrive(node=1, along=(1.0, 0.0, 0.0), amplitude=1e-3, frequency=1.5, phase=0.0)
    setup = Simulation(
        end=1.0, gravity=GRAVITY, rotation=(0.0, np.pi / 2, 0.0), steps=50, drive=(shake,),
        constraint=(Joint(1, kind="revolute", axis=(0.0, 1.0, 0.0)),), **FINE,
    )  # fmt: skip
    motion = simulate(stiff, setup)
    omega, length = 2 * np.pi * 1.5, 2 / 3
    start = -omega * 1e-3 / length  # of the angle: the rod's end at the pivot moves at once, by an impulse
    found = scipy.integrate.solve_ivp(
        lambda t, y: [y[1], (-9.81 * y[0] + 1e-3 * omega**2 * np.sin(omega * t)) / length], (0, 1), [0, start],
        t_eval=motion.t, rtol=1e-9, atol=1e-12,
    )  # fmt: skip
    pivot, tip = (motion.node_displacement[:, motion.nodes.index(node)] for node in (1, 3))
    assert pivot == pytest.approx(np.outer(1e-3 * np.sin(omega * motion.t), [1, 0, 0]), abs=1e-8)
    assert tip[:, 0] - pivot[:, 0] == pytest.approx(found.y[0], abs=2e-6)
    assert np.abs(found.y[0]).max() > 1e-3
    assert motion.balance < 1e-5 and np.abs(motion.energies["drives"]).max() > 1e-6


def test_a_clamp_that_is_displaced_strains_the_beam(flexible):
    """Both ends clamped, one moved aside at rest: 12 E I d / L^3 and 6 E I d / L^2 of a beam."""
    rod, moved = Rod(), 1e-4
    setup = Simulation(
        end=1e-3, start="static", steps=2, constraint=(Joint(1, kind="fixed"), Joint(3, kind="fixed")),
        drive=(ConstantDrive(node=3, along=(0.0, 0.0, 2.0), value=moved),),
    )  # fmt: skip
    motion = simulate(flexible, setup)
    force = dict(zip(motion.constraint_names, motion.constraint_force[0], strict=True))
    moment = dict(zip(motion.moment_names, motion.constraint_moment[0], strict=True))
    bending = rod.young * rod.second_moment * moved
    assert [force["3:z"], force["1:z"]] == pytest.approx([12 * bending, -12 * bending], rel=1e-4)
    assert [moment["3:ry"], moment["1:ry"]] == pytest.approx([6 * bending, 6 * bending], rel=1e-4)


def test_a_force_that_follows_its_node_turns_with_it(stiff):
    """A rod on a hinge with a force normal to it: the angle grows with M t^2 / (2 J), the work with M times it."""
    force, inertia = 2.0, stiff.floating_frame.mass / 3
    for load in (
        {"force": (ConstantForce(3, (0.0, force, 0.0), axes="body"),)},
        {"moment": (ConstantMoment(3, (0.0, 0.0, force), axes="body"),)},
    ):
        setup = Simulation(end=1.5, steps=30, constraint=(Joint(1, kind="revolute", axis=(0.0, 0.0, 1.0)),), **load)
        motion = simulate(stiff, setup)
        angle = 0.5 * force / inertia * motion.t**2
        tip = motion.node_position[:, motion.nodes.index(3)]
        assert tip == pytest.approx(np.array([np.cos(angle), np.sin(angle), 0 * angle]).T, abs=2e-3)
        assert motion.energies["work"][-1] == pytest.approx(force * angle[-1], rel=1e-3) and angle[-1] > 1.0


def test_dependent_joints_are_named(stiff):
    """Two clamps on a body with two elastic coordinates cannot be, and say so; a third joint has no part in it."""
    setup = Simulation(end=0.1, constraint=(Joint(1, kind="fixed"), Joint(3, kind="fixed")))
    with pytest.raises(InputError, match=r"depend on each other \(fixed at 1, fixed at 3\).* more elastic coordinates"):
        simulate(stiff, setup)
    setup = Simulation(end=0.1, constraint=(Joint(1), Joint(3, ("y",)), Joint(1, ("z",))))
    with pytest.raises(InputError, match=r"depend on each other \(point at 1\)"):
        simulate(stiff, setup)


def test_what_needs_rotations_is_refused_at_solid_nodes(comm):
    with (
        hpcred.solid((3, 1, 1), inputs=3, clamped=False, comm=comm) as model,
        hpcred.reduce(model, [Modes(index=(7, 8))], Buckens()) as rom,
    ):
        body = body_of(model, rom, [1])
    for table, says in (
        ({"moment": (ConstantMoment(1, (1.0, 0.0, 0.0)),)}, "moment.node: node 1 has no rotations, which a moment"),
        ({"force": (ConstantForce(1, (1.0, 0.0, 0.0), axes="body"),)}, "force.node: node 1 .*axes = 'body' needs"),
        ({"constraint": (Joint(1, kind="fixed"),)}, r"constraint.kind: node 1 has no rotations.*\[\[interface\]\]"),
        ({"spring": (Bushing(1, rotational_damping=(1.0, 0.0, 0.0)),)}, "spring.rotational_stiffness: node 1 has no"),
    ):
        with pytest.raises(InputError, match=says):
            simulate(body, Simulation(end=0.1, **table))


def test_nodes_have_names(stiff):
    body = replace(stiff, nodes=[replace(stiff.nodes[0], name="bearing"), *stiff.nodes[1:]])
    setup = Simulation(
        end=0.01, steps=2, constraint=(Joint("bearing", kind="fixed"),), observe=("bearing", 3),
        spring=(Bushing("bearing", (1.0, 1.0, 1.0)),),
    )  # fmt: skip
    assert setup.nodes == [3, "bearing"]
    motion = simulate(body, setup)
    assert motion.nodes == [1, 2, 3] and motion.node_names == ["bearing", "2", "3"]
    assert motion.constraint_names[0] == "bearing:x" and motion.spring_names == ["1:bearing"]
    with pytest.raises(InputError, match="node 'bearing': no interface of this name; no node of the body has a name"):
        simulate(stiff, setup)
    with pytest.raises(InputError, match="node 'hub': no interface of this name; its interfaces are bearing"):
        simulate(body, replace(setup, observe=("hub",)))


@pytest.mark.parametrize("steps", [50, 1])
def test_a_bushing_that_is_twisted_too_far_is_refused(stiff, steps):
    """Also where all output times are before or behind the half turn at which rotation vectors go round."""
    setup = Simulation(
        end=1.0, constraint=(Joint(1, kind="revolute", axis=(0.0, 0.0, 1.0)),), steps=steps,
        drive=(RampDrive(node=1, about=(0.0, 0.0, 1.0), rate=4.0),),
        spring=(Bushing(1, rotational_stiffness=(1.0, 1.0, 1.0)),),
    )  # fmt: skip
    with pytest.raises(hpcred.ComputationError, match=r"node 1 was twisted by more than 3 rad at t = 0\.7[5-9]"):
        simulate(stiff, setup)
