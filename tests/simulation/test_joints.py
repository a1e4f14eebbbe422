"""Kinematics of nodes, joints, drives and springs against differences, and what is refused of their tables."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hpcred.body.node_shapes import NodeShape
from hpcred.body.rotations import (
    continuous,
    of_vector,
    quaternion,
    quaternion_rate,
    rate_matrix,
    rotation,
    skew,
    vector_of,
)
from hpcred.parallel.failures import InputError
from hpcred.simulation import (
    Bushing,
    ConstantDrive,
    ConstantMoment,
    Joint,
    LineSpring,
    RampDrive,
    SineDrive,
    TableDrive,
)
from hpcred.simulation.equations_of_motion import node_motion
from hpcred.simulation.joints import holds_of
from hpcred.simulation.springs import element_of


def shape(node=7, size=4, rotates=True):
    generator = np.random.default_rng(node)
    phi, psi = generator.normal(size=(2, 3, size))
    return NodeShape(node, generator.normal(size=3), phi, psi * rotates, rotates)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 9.99e-4, 1.001e-3, 0.3, 3.0])
def test_rotation_vectors_and_their_rate(angle):
    generator = np.random.default_rng(1)
    vector = angle * np.array([2.0, -1.0, 2.0]) / 3
    rate, h = generator.normal(size=3), 1e-5
    slope = (of_vector(vector + h * rate) - of_vector(vector - h * rate)) / (2 * h)
    assert slope == pytest.approx(skew(rate_matrix(vector) @ rate) @ of_vector(vector), abs=1e-9)
    assert vector_of(of_vector(vector)) == pytest.approx(vector, abs=1e-14)
    assert rotation(quaternion(vector)) == pytest.approx(of_vector(vector), abs=1e-14)


def test_velocities_of_a_node():
    """B against differences of place and rotation, at large elastic rotations."""
    node, h = shape(), 1e-6
    generator = np.random.default_rng(2)
    r, q, origin, z = (generator.normal(size=size) for size in (3, 4, 3, 10))
    p = quaternion([0.3, -0.8, 0.5])

    def at(s):
        turned = p + s * quaternion_rate(p, z[3:6])
        return node_motion(node, origin, r + s * rotation(p) @ z[:3], rotation(turned), q + s * z[6:])

    now, before, after = at(0.0), at(-h), at(h)
    velocity = now.B @ z
    assert (after.x - before.x) / (2 * h) == pytest.approx(velocity[:3], abs=1e-8)
    assert (after.R - before.R) / (2 * h) == pytest.approx(skew(velocity[3:]) @ now.R, abs=1e-8)
    assert np.linalg.norm(vector_of(rotation(p).T @ now.R)) > 0.5


AXIS, OTHER = (1.0, 2.0, -1.0), (0.0, 1.0, 3.0)
TURN = RampDrive(node=7, about=(0.2, 1.0, 0.5), rate=2.0, duration=0.4, through=(0.1, 0.2, 0.9))
SHIFT = SineDrive(node=7, along=(1.0, 1.0, 0.0), amplitude=0.1, frequency=0.7, phase=0.4)


@pytest.mark.parametrize(
    "joint, free, count",
    [
        (Joint(7), "rotations", 3),
        (Joint(7, ("y",)), "rotations xz", 1),
        (Joint(7, kind="spherical"), "rotations", 3),
        (Joint(7, kind="fixed"), "", 6),
        (Joint(7, kind="revolute", axis=AXIS), "about", 5),
        (Joint(7, kind="prismatic", axis=AXIS), "along", 5),
        (Joint(7, kind="cylindrical", axis=AXIS), "about along", 4),
        (Joint(7, kind="universal", axes=(AXIS, OTHER)), "cross", 4),
    ],
)
@pytest.mark.parametrize("drives", [(), (SHIFT,), (TURN, SHIFT)])
def test_constraints_are_holonomic(joint, free, count, drives):
    """On a motion that a joint allows its gaps are zero, those beside it grow by N (velocity - that of the support)."""
    if len(drives) > 1 and joint.kind not in ("fixed", "prismatic"):
        drives = drives[1:]
    node, generator = shape(), np.random.default_rng(4)
    place, turned = generator.normal(size=3), of_vector([0.4, 0.9, -0.2])
    holds = holds_of([joint], drives, {7: (node, place, turned)})
    assert len(holds[0]) == count and holds[0].label == f"{joint.kind} at 7"
    extra = len(drives) > 0 and (joint.kind in ("prismatic", "cylindrical") or joint.directions is not None)
    assert len(holds) == 1 + extra
    axis = np.array(AXIS) / np.linalg.norm(AXIS)
    hold = holds[0]

    def allowed(t):
        shift, _, G, _ = hold.support.state(t)
        centre = place if hold.support.centre is None else hold.support.centre
        x, R = place, turned
        if "xz" in free:
            x = x + [0.3 * t, 0.0, -0.2 * t]
        if "along" in free:
            x = x + 0.7 * t * axis
        if "about" in free:
            R = of_vector(1.3 * t * axis) @ R
        if "rotations" in free:
            R = of_vector([t, -0.4, 2 * t]) @ R
        if "cross" in free:
            other = np.array(OTHER) / np.linalg.norm(OTHER)
            R = of_vector(0.9 * t * axis) @ of_vector(-1.4 * t * other) @ R
        return centre + shift + G @ (x - centre), G @ R

    t, h = 0.31, 1e-6
    x, R = allowed(t)
    assert np.abs(hold.gap(t, x, R)).max() < 1e-13
    before, after = allowed(t - h), allowed(t + h)
    velocity = np.concatenate([after[0] - before[0], vector_of(after[1] @ before[1].T)]) / (2 * h)
    N = hold.directions(t, R)
    assert N @ velocity == pytest.approx(N @ hold.velocity(t, x), abs=1e-8)
    assert np.abs(velocity).max() > 1e-3 or not (free or drives)
    other = generator.normal(size=6)  # a velocity that the joint does not allow
    gaps = [hold.gap(t + s, x + s * other[:3], of_vector(s * other[3:]) @ R) for s in (-h, h)]
    slope = (gaps[1] - gaps[0]) / (2 * h)
    assert slope == pytest.approx(N @ (other - hold.velocity(t, x)), abs=1e-8) and np.abs(slope).min() > 1e-3
    rank = np.linalg.matrix_rank(np.concatenate([item.directions(t, R) for item in holds]))
    assert rank == sum(map(len, holds))


def test_a_driven_revolute_follows_its_drive_beyond_a_turn():
    place, turned, axis = np.ones(3), of_vector([0.4, 0.9, -0.2]), np.array([0.0, 0.6, 0.8])
    drives = [RampDrive(node=7, about=(0.0, 3.0, 4.0), rate=5.0), RampDrive(node=7, about=(0.0, -3.0, -4.0), rate=1.0)]
    revolute, drive = holds_of([Joint(7, kind="revolute", axis=tuple(axis))], drives, {7: (shape(), place, turned)})
    for t in (0.2, 2.0, 3.0):
        R = of_vector(4.0 * t * axis) @ turned
        assert revolute.gap(t, place, R) == pytest.approx(0, abs=1e-13)
        assert drive.gap(t, place, R) == pytest.approx(0, abs=1e-13)
        assert np.abs(drive.gap(t, place, of_vector(0.1 * axis) @ R)) == pytest.approx(0.1)
    assert drive.directions(0.0, turned) @ drive.velocity(0.0, place) == pytest.approx(
        drive.directions(0.0, turned)[:, 3:] @ axis * 4.0
    )


@pytest.mark.parametrize(
    "drive",
    [
        ConstantDrive(node=7, along=AXIS, value=0.3),
        RampDrive(node=7, along=AXIS, rate=3.0, duration=0.5),
        RampDrive(node=7, along=AXIS, rate=3.0),
        SineDrive(node=7, about=AXIS, amplitude=0.2, frequency=3.0, phase=0.4),
        TableDrive(node=7, about=AXIS, times=(0.1, 0.2, 0.6), values=(0.5, 1.0, -0.5)),
    ],
)
def test_rates_of_drives(drive):
    for t in (0.05, 0.12, 0.31, 0.47, 0.8):
        h = 1e-6
        assert (drive(t + h)[0] - drive(t - h)[0]) / (2 * h) == pytest.approx(drive(t)[1], abs=1e-6)
    assert drive.longest_step() > 0


def test_values_of_drives():
    ramp = RampDrive(node=7, along=AXIS, rate=3.0, duration=0.5)
    assert ramp(0.0) == (0.0, 0.0) and ramp(0.25)[1] == pytest.approx(1.5) and ramp(2.5) == pytest.approx((6.75, 3.0))
    assert ramp(0.5 - 1e-9) == pytest.approx(ramp(0.5))
    for t in (-0.1, 0.1, 0.3, 0.7):
        assert ramp.at(t, 2) == pytest.approx((ramp.at(t + 1e-5, 1) - ramp.at(t - 1e-5, 1)) / 2e-5, abs=1e-6)
    table = TableDrive(node=7, along=AXIS, times=(0.1, 0.2, 0.6), values=(0.5, 1.0, -0.5))
    assert [table(t)[0] for t in (0.0, 0.1, 0.2, 0.6, 9.0)] == pytest.approx([0.5, 0.5, 1.0, -0.5, -0.5])
    assert table(0.1 + 1e-9)[1] == pytest.approx(0, abs=1e-6) and table(0.6 - 1e-9)[1] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(
    "spring",
    [
        LineSpring(7, (0.5, -0.2, 0.1), 300.0, 4.0, 0.4),
        LineSpring(7, (0.5, -0.2, 0.1), 300.0),
        Bushing(7, (10.0, 20.0, 30.0), (1.0, 0.0, 2.0), (5.0, 50.0, 20.0), (0.3, 0.2, 0.1), (0.3, 0.2, 0.1)),
    ],
)
def test_springs_take_the_power_that_they_store_and_lose(spring):
    """wrench . velocity = -energy' - dissipation, and tangents against differences, at large rotations."""
    generator = np.random.default_rng(5)
    start, turned = generator.normal(size=3), of_vector([0.4, 0.9, -0.2])
    element = element_of(spring, shape(), start, turned)
    assert element.energy(start, turned) == 0.0 if spring.kind == "line" and spring.length is None else True
    x, R, velocity, h = generator.normal(size=3), of_vector([-1.0, 0.7, 1.4]) @ turned, generator.normal(size=6), 1e-6
    energies = [element.energy(x + s * velocity[:3], of_vector(s * velocity[3:]) @ R) for s in (-h, h)]
    power = element.wrench(x, R, *np.split(velocity, 2)) @ velocity
    lost = element.dissipation(x, *np.split(velocity, 2))
    assert -power == pytest.approx((energies[1] - energies[0]) / (2 * h) + lost, rel=1e-7)
    K, C = element.tangents(x, R, velocity[:3])
    step, speeds = generator.normal(size=6), np.split(velocity, 2)
    moved = [element.wrench(x + s * step[:3], of_vector(s * step[3:]) @ R, *speeds) for s in (-h, h)]
    assert (moved[0] - moved[1]) / (2 * h) == pytest.approx(K @ step, abs=1e-5)
    still = np.zeros(3)
    damped = element.wrench(x, R, still, still) - element.wrench(x, R, *speeds)
    assert damped == pytest.approx(C @ velocity, abs=1e-10) and velocity @ C @ velocity == pytest.approx(
        element.dissipation(x, *np.split(velocity, 2))
    )
    assert np.linalg.matrix_rank(element.held(x)) == np.linalg.matrix_rank(element.held(x) @ K) == len(element.held(x))


def test_a_bushing_turned_about_one_axis_is_a_torsion_spring():
    element = element_of(Bushing(7, rotational_stiffness=(5.0, 50.0, 20.0)), shape(), np.zeros(3), np.eye(3))
    R = Rotation.from_euler("y", 1.2).as_matrix()
    assert element.wrench(np.zeros(3), R, np.zeros(3), np.zeros(3)) == pytest.approx([0, 0, 0, 0, -60.0, 0])
    assert element.energy(np.zeros(3), R) == pytest.approx(0.5 * 50 * 1.2**2)


NAN = float("nan")


@pytest.mark.parametrize(
    "make, says",
    [
        (lambda: Joint(7, at=(0.0, NAN, 0.0)), "constraint.at: found nan"),
        (lambda: Joint(7, kind="revolute"), "constraint.axis: missing; a joint of kind 'revolute' needs it"),
        (lambda: Joint(7, kind="revolute", axis=(0.0, 0.0, 0.0)), r"constraint.axis: found \[0.0, 0.0, 0.0\]"),
        (lambda: Joint(7, kind="prismatic", axis=(0.0, NAN, 0.0)), "constraint.axis: found nan"),
        (lambda: Joint(7, kind="fixed", axis=AXIS), "constraint.axis: found .* at a joint of kind 'fixed'"),
        (lambda: Joint(7, ("x",), kind="fixed"), "constraint.directions: found .* expected it only with point"),
        (lambda: Joint(7, ()), r"constraint.directions: found \[\]"),
        (lambda: Joint(7, kind="universal", axes=(AXIS, (-2.0, -4.0, 2.0))), "constraint.axes: .* are parallel"),
        (lambda: Joint(7, kind="universal", axes=(AXIS, (0.0, 0.0, 0.0))), "constraint.axes: found .* no direction"),
        (lambda: ConstantDrive(node=7, value=1.0), "drive: node 7 needs a direction `along`"),
        (lambda: ConstantDrive(node=7, along=AXIS, about=AXIS, value=1.0), "drive: node 7 needs .*one of them"),
        (lambda: ConstantDrive(node=7, along=AXIS, value=NAN), "drive.value: found nan"),
        (lambda: ConstantDrive(node=7, along=(0.0, 0.0, 0.0), value=1.0), "drive.along: found .* no direction"),
        (lambda: ConstantDrive(node=7, along=AXIS, through=AXIS, value=1.0), "drive.through: found .* without `about`"),
        (lambda: RampDrive(node=7, along=AXIS, rate=1.0, duration=-1.0), "drive.duration: found -1.0"),
        (lambda: SineDrive(node=7, along=AXIS, amplitude=1.0, frequency=0.0), "drive.frequency: found 0"),
        (lambda: TableDrive(node=7, along=AXIS, times=(0.0,), values=(1.0,)), "drive.times: found one time"),
        (lambda: TableDrive(node=7, along=AXIS, times=(0.0, 0.0), values=(1.0, 2.0)), "times: found 0 s after 0 s"),
        (lambda: LineSpring(7, AXIS, -1.0), "spring.stiffness: found -1.0, expected nothing below 0"),
        (lambda: LineSpring(7, AXIS, 1.0, length=-1.0), "spring.length: found -1.0"),
        (lambda: LineSpring(7, AXIS, 0.0), "spring: node 7 has nothing but zeros in stiffness, damping"),
        (lambda: Bushing(7, (1.0, -1.0, 0.0)), "spring.stiffness: found .* nothing below 0"),
        (lambda: Bushing(7, rotational_damping=(1.0, NAN, 0.0)), "spring.rotational_damping: found nan"),
        (lambda: Bushing(7), "spring: node 7 has nothing but zeros"),
        (lambda: ConstantMoment(7, (NAN, 0.0, 0.0)), "moment.value: found nan"),
    ],
)
def test_tables_that_make_no_sense(make, says):
    with pytest.raises(InputError, match=says):
        make()


@pytest.mark.parametrize(
    "joints, drives, says",
    [
        ([Joint(7)], [TURN], "drive.about: node 7 has no joint that holds its other rotations"),
        ([], [TURN], "drive.about: node 7 has no joint"),
        ([Joint(7, kind="universal", axes=(AXIS, OTHER))], [TURN], "drive.about: node 7 has no joint"),
        ([Joint(7, kind="revolute", axis=AXIS)], [TURN], "drive.about: the axis at node 7 is oblique"),
        ([Joint(7, kind="fixed")], [TURN, RampDrive(node=7, about=AXIS, rate=1.0)], "drives about different axes"),
        ([Joint(7, kind="fixed")], [TURN, RampDrive(node=7, about=TURN.about, rate=1.0)], "through different points"),
        ([Joint(8, kind="fixed")], [], "constraint.kind: node 8 has no rotations, which a joint of kind 'fixed' holds"),
    ],
)
def test_joints_and_drives_that_do_not_fit(joints, drives, says):
    start = {node: (shape(node, rotates=node == 7), np.zeros(3), np.eye(3)) for node in (7, 8)}
    with pytest.raises(InputError, match=says):
        holds_of(joints, drives, start)


def test_springs_that_do_not_fit():
    place = np.array(AXIS)
    with pytest.raises(InputError, match="spring.at: the spring at node 7 begins with no length"):
        element_of(LineSpring(7, AXIS, 1.0), shape(), place, np.eye(3))
    with pytest.raises(InputError, match="spring.rotational_stiffness: node 8 has no rotations"):
        element_of(Bushing(8, rotational_damping=AXIS[:1] * 3), shape(8, rotates=False), place, np.eye(3))


@pytest.mark.parametrize("axis", [(0, 0, 1), (1, -2, 2)])
@pytest.mark.parametrize("steps", [97, 100])
def test_rotation_vectors_go_on_beyond_pi(axis, steps):
    """Three turns and back, as they are, also where an output time is at a full turn."""
    angle = 6 * np.pi * np.sin(np.linspace(0, np.pi, steps + 1))
    exact = angle[:, None, None] * np.array(axis) / np.linalg.norm(axis)
    short = vector_of(Rotation.from_rotvec(exact[:, 0]).as_matrix())[:, None]
    assert np.linalg.norm(short, axis=-1).max() < 3.2
    assert continuous(short) == pytest.approx(exact, abs=1e-6)
    below = np.linalg.norm(exact, axis=-1)[:, 0].searchsorted(np.pi)
    assert np.array_equal(continuous(short[:below]), short[:below])


def test_one_node_of_many_turns():
    """From the instants on at which it is beyond pi."""
    angles = np.zeros((20, 10))
    angles[:, 9] = np.arange(20)
    exact = angles[:, :, None] * [0.0, 0.0, 1.0]
    short = vector_of(Rotation.from_rotvec(exact.reshape(-1, 3)).as_matrix()).reshape(exact.shape)
    assert continuous(short) == pytest.approx(exact, abs=1e-9)


@pytest.mark.parametrize(("axis", "able"), [((1, 1, 0), (1, 1, 1)), ((-1, 1, 0), (1, 1, 1)), ((1, 0, 0), (0, 1, 1))])
def test_moments_that_a_revolute_joint_can_transmit(axis, able):
    """In all directions that are not along its axis, whatever the signs of those that it holds."""
    axis = tuple(map(float, axis))
    (hold,) = holds_of([Joint(7, kind="revolute", axis=axis)], (), {7: (shape(), np.zeros(3), np.eye(3))})
    assert np.array_equal(hold.components(), [1, 1, 1, *able])


def test_rotation_vectors_beside_a_full_turn():
    """A wobble about another axis has no vector near there at a full turn; the turns are counted on behind it."""
    angle = np.linspace(0, 4 * np.pi, 41)
    turned = Rotation.from_rotvec(np.outer(angle, [1, 0, 0])) * Rotation.from_rotvec([0, 1e-4, 0])
    found = continuous(turned.as_rotvec()[:, None])[:, 0]
    assert (Rotation.from_rotvec(found) * turned.inv()).magnitude().max() < 1e-12
    away = np.abs(angle % (2 * np.pi) - np.pi) < 3.0  # from full turns
    assert found[away, 0] == pytest.approx(angle[away], abs=1e-3)


def test_tumbling_stays_the_same_rotations():
    """Random rotations stay what they are."""
    turned = Rotation.random(200, random_state=1)
    found = continuous(turned.as_rotvec()[:, None])[:, 0]
    assert (Rotation.from_rotvec(found) * turned.inv()).magnitude().max() < 1e-9
