"""Floating-frame quantities, shapes of nodes, and the equations of motion, against closed forms and second methods."""

import numpy as np
import pytest
import scipy.integrate
from helpers import bar, block_from, gather

import hpcred
from hpcred import Buckens, Chord, ConstantForce, Joint, Krylov, Modes, Rayleigh, Simulation, SineForce, TableForce
from hpcred.linalg.blocks import apply, create_block, inner
from hpcred.model.rigid_body_modes import rigid_motions
from hpcred.multibody.equations_of_motion import FlexibleBody, rotation
from hpcred.multibody.floating_frame import _lumped, floating_frame
from hpcred.multibody.node_shapes import node_shapes
from hpcred.multibody.simulation import simulate
from hpcred.parallel.failures import InputError
from hpcred.workflows.export import Body

EDGES = (0.6, 0.2, 0.1)


@pytest.fixture(scope="module")
def block(comm):
    with hpcred.solid((4, 3, 2), EDGES, 3, clamped=False, comm=comm) as model:
        yield model


def labels(model):
    """Position (n, 3) and direction (n,) of all rows on all ranks."""
    parts = model.comm.allgather((model.dofs.position, model.dofs.direction))
    return (np.concatenate(items) for items in zip(*parts, strict=True))


def fields(model, *functions):
    """A block whose columns are displacement fields: functions of a position (3,) that give six components."""
    positions, direction = labels(model)
    array = np.array([[f(x)[d] for f in functions] for x, d in zip(positions, direction, strict=True)])
    return block_from(model.M, array)


@pytest.mark.mpi
@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.5)])
def test_block_in_closed_form(block, origin):
    """Fields linear in x are exact in trilinear bricks."""
    a, b, c = EDGES
    x0, y0, z0 = origin
    mass = 7850.0 * a * b * c
    columns = fields(block, lambda x: (x[0], 0, 0), lambda x: (0, x[2], 0))
    frame = floating_frame(block, columns, origin)
    columns.destroy()

    def mean(length, start, power):  # of (s - start)^power over 0..length
        return ((length - start) ** (power + 1) - (-start) ** (power + 1)) / ((power + 1) * length)

    mx, my, mz = (mean(*item, 1) for item in ((a, x0), (b, y0), (c, z0)))
    xx, yy, zz = (mean(*item, 2) for item in ((a, x0), (b, y0), (c, z0)))
    assert frame.integrals == "consistent"
    assert frame.mass == pytest.approx(mass)
    assert frame.mc == pytest.approx(mass * np.array([mx, my, mz]))
    inertia = [[yy + zz, -mx * my, -mx * mz], [-mx * my, xx + zz, -my * mz], [-mx * mz, -my * mz, xx + yy]]
    np.testing.assert_allclose(frame.J, mass * np.array(inertia), atol=1e-12)
    x, z = mx + x0, mz + z0  # mean of x and z themselves
    x2, z2 = a * a / 3, c * c / 3
    assert frame.Ct == pytest.approx(mass * np.array([[x, 0, 0], [0, z, 0]]))
    xz, xx1 = mx * z, x2 - x0 * x  # mean of (x - x0) z and of (x - x0) x
    assert frame.Cr[0] == pytest.approx(mass * np.array([0, mz * x, -my * x]))
    assert frame.Cr[1] == pytest.approx(mass * np.array([-(z2 - z0 * z), 0, xz]))
    assert frame.N[0] == pytest.approx(mass * np.array([[xx1, 0, 0], [my * x, 0, 0], [mz * x, 0, 0]]))
    assert frame.S[0, 0] == pytest.approx(mass * np.array([[x2, 0], [0, 0]]))
    assert frame.S[1, 1] == pytest.approx(mass * np.array([[0, 0], [0, z2]]))
    assert frame.S[0, 1] == pytest.approx(mass * np.array([[0, x * z], [0, 0]]))
    assert frame.Me == pytest.approx(mass * np.diag([x2, z2]))


@pytest.mark.mpi
def test_slender_bar_in_closed_form(comm):
    """Six dofs a node; the fields are ones that the beam elements hold exactly."""
    length = 2.0
    with bar(comm, length, 6) as model:
        columns = fields(model, lambda x: (x[0], 0, 0, 0, 0, 0), lambda x: (0, x[0], 0, 0, 0, 1))
        frame = floating_frame(model, columns)
        columns.destroy()
    section = np.pi / 4 * 0.022**2
    mass, polar = 7850 * section * length, 7850 * section**2 / (2 * np.pi) * length
    assert frame.mass == pytest.approx(mass)
    assert frame.mc == pytest.approx([mass * length / 2, 0, 0])
    slender = mass * length**2 / 3
    np.testing.assert_allclose(frame.J, np.diag([polar, slender, slender]), atol=1e-9)
    assert frame.Ct == pytest.approx(mass * length / 2 * np.eye(3)[:2])
    assert frame.Cr == pytest.approx(np.array([[0, 0, 0], [0, 0, mass * length**2 / 3]]), abs=1e-12)
    assert frame.integrals == "mean of directions"


def rigid_integrals(model, mass, columns):
    """J (3, 3) and C_r (m, 3) of the nodes where they are."""
    motions, momentum = rigid_motions(model, (0.0, 0.0, 0.0)), create_block(model.M, 6)
    apply(mass, motions, momentum)
    result = inner(motions, momentum)[3:, 3:], inner(momentum, columns)[3:].T
    motions.destroy()
    momentum.destroy()
    return result


@pytest.mark.mpi
@pytest.mark.parametrize("lumped", [False, True])
def test_dependence_on_the_elastic_coordinates(block, lumped):
    """J(q), C_r(q) and Ct against the same integrals over the body with its nodes moved."""
    with hpcred.reduce(block, [Modes(index=tuple(range(7, 12)))], Buckens()) as rom:
        frame = floating_frame(block, rom.columns, lumped=lumped)
        shapes = gather(rom.columns)
        system = FlexibleBody(frame, rom.K, rom.D)
        q = 1e-2 * np.arange(1, 6)
        first = block.first_row
        own = (shapes @ q)[first : first + block.local_rows].reshape(-1, 3)  # three dofs a node, whole nodes a rank
        mass = _lumped(block) if lumped else block.M
        at_rest = rigid_integrals(block, mass, rom.columns)
        saved, block.dofs.position = block.dofs.position, block.dofs.position + np.repeat(own, 3, axis=0)
        deformed = rigid_integrals(block, mass, rom.columns)
        block.dofs.position = saved
        if lumped:
            mass.destroy()
    assert frame.integrals == ("lumped" if lumped else "consistent")
    change, turned = (new - old for new, old in zip(deformed, at_rest, strict=True))
    assert np.abs(system.inertia(q) - frame.J - change).max() < 1e-10 * np.abs(change).max()
    assert np.abs(np.tensordot(frame.Cr1, q, axes=(1, 0)) - turned).max() < 1e-10 * np.abs(turned).max()
    for k, slope in enumerate(frame.dJ):
        block_k = frame.Gr[:, 3 * k : 3 * k + 3]
        assert (block_k + block_k.T) / 2 == pytest.approx(slope)
    order = [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)]
    factor = np.array([-0.5, -0.5, -0.5, -1, -1, -1])
    assert frame.Oe == pytest.approx(np.array([[slope[i] for i in order] for slope in frame.dJ]) * factor)
    # the integral of Phi_i^T skew(w)^2 (R + Phi q), against the derivative of w^T J(q) w / 2
    w = np.array([0.3, -1.0, 0.7])
    monomials = np.array([w[0] ** 2, w[1] ** 2, w[2] ** 2, w[0] * w[1], w[1] * w[2], w[0] * w[2]])
    centrifugal = (frame.Oe + np.tensordot(frame.Oe1, q, axes=(1, 0))) @ monomials
    slope = frame.dJ + 2 * np.tensordot(frame.J2, q, axes=(1, 0))
    assert centrifugal == pytest.approx(-0.5 * slope @ w @ w)


@pytest.mark.mpi
def test_shapes_of_nodes_with_three_and_six_dofs(block, comm):
    with hpcred.linkage(comm) as linkage:
        for model, node, count in ((block, 5, 3), (linkage, 20, 6)):
            with hpcred.reduce(model, [Modes(index=(7, 8))], Buckens()) as rom:
                (shape,) = node_shapes(model, rom.columns, [node])
                rows = gather(rom.columns)[count * (node - 1) : count * node]
                assert (shape.phi == rows[:3]).all()
                assert shape.rotates == (count == 6)
                assert (shape.psi == (rows[3:] if count == 6 else 0)).all()
                with pytest.raises(InputError, match="node 999 does not exist"):
                    node_shapes(model, rom.columns, [999])


def reduced_body(model, basis, nodes, damping=None, frame=None):
    with hpcred.reduce(model, basis, frame or Buckens(), damping) as rom:
        return Body(rom, floating_frame(model, rom.columns), node_shapes(model, rom.columns, nodes))


@pytest.fixture(scope="module")
def linkage_body():
    with hpcred.linkage() as model:
        return reduced_body(model, [Modes(index=tuple(range(7, 13)))], [1, 7, 14, 20])


def momenta(body, motion):
    """Linear and angular momentum about the inertial origin at all times."""
    system = FlexibleBody(body.frame, body.rom.K, body.rom.D)
    result = []
    for r, p, q, *velocities in zip(
        motion.position, motion.quaternion, motion.elastic, motion.velocity, motion.angular_velocity,
        motion.elastic_velocity, strict=True,
    ):  # fmt: skip
        P = system.mass_matrix(q) @ np.concatenate(velocities)
        A = rotation(p)
        result.append(np.concatenate([A @ P[:3], A @ P[3:6] + np.cross(r, A @ P[:3])]))
    return np.array(result)


def test_a_free_spinning_body_keeps_energy_and_momentum(linkage_body):
    setup = Simulation(
        "body", 0.2, velocity=(1.0, -0.5, 0.2), angular_velocity=(3.0, 8.0, -5.0), rotation=(0.2, 0.1, 0.5),
        elastic=(1e-3, -2e-3, 1e-3, 0.0, 0.0, 0.0), steps=50, relative_tolerance=1e-8, absolute_tolerance=1e-11,
    )  # fmt: skip
    motion = simulate(linkage_body, setup)
    assert motion.balance < 1e-8
    kept = momenta(linkage_body, motion)
    assert np.abs(kept - kept[0]).max() < 1e-7 * np.abs(kept).max()
    assert np.ptp(motion.elastic[:, 0]) > 3e-4 and np.ptp(motion.angular_velocity, axis=0).max() > 1
    assert motion.drift == 0.0 and motion.constraint_force.shape == (51, 0)


def test_a_stiff_pendulum_is_a_rigid_one(comm):
    """A beam of 1 m on a spherical joint at its end, falling from the horizontal in a plane."""
    with bar(comm, 1.0, 4, young=2.1e13) as model:
        body = reduced_body(model, [Modes(index=(7, 8))], [1, 5], Rayleigh(0.0, 1e-3))
    setup = Simulation("body", 1.5, gravity=(0.0, 0.0, -9.81), constraint=(Joint(1),), observe=(5,), steps=100,
                       relative_tolerance=1e-6, absolute_tolerance=1e-9)  # fmt: skip
    motion = simulate(body, setup)
    # angle below the horizontal of a slender rod: 1/3 m L^2 phi'' = m g L/2 cos phi
    rigid = scipy.integrate.solve_ivp(
        lambda _, y: [y[1], 1.5 * 9.81 * np.cos(y[0])], (0, 1.5), [0.0, 0.0], t_eval=motion.t, rtol=1e-10, atol=1e-12
    ).y[0]
    tip = motion.node_position[:, 1]
    assert tip == pytest.approx(np.array([np.cos(rigid), 0 * rigid, -np.sin(rigid)]).T, abs=2e-5)
    assert motion.drift < 1e-8 and motion.balance < 1e-5
    weight = body.frame.mass * 9.81  # at the lowest point the joint carries 2.5 m g
    assert np.linalg.norm(motion.constraint_force, axis=1).max() == pytest.approx(2.5 * weight, rel=2e-2)


def test_small_vibrations_agree_with_the_frequency_response():
    """The constrained free body against the full model held by the same six supports, at 10 Hz."""
    frequency, force, damping = 10.0, 1e-3, Rayleigh(0.0, 2e-2)  # stiffness damping leaves rigid motion alone
    held = [(1, "x"), (1, "y"), (1, "z"), (7, "x"), (7, "z"), (14, "z")]
    with hpcred.linkage() as model:
        expected = hpcred.frequency_response(model, [frequency], Chord(nodes=(1, 7, 14), axes="yxz"), damping)[0, 0, 0]
        model.set_inputs([*held, (20, "z")])
        body = reduced_body(model, [Krylov(frequency=10.0, order=1)], [1, 7, 14, 20], damping)
    setup = Simulation(
        "body", 1.0, force=(SineForce(20, (0.0, 0.0, force), frequency),), steps=1000,
        constraint=(Joint(1), Joint(7, ("x", "z")), Joint(14, ("z",))), relative_tolerance=1e-6,
        absolute_tolerance=1e-11,
    )  # fmt: skip
    motion = simulate(body, setup)
    last = motion.t > 0.8
    wave = np.exp(-2j * np.pi * frequency * motion.t[last])
    found = 2j * np.mean(motion.node_displacement[last, -1, 2] * wave) / force
    assert found == pytest.approx(expected, rel=1e-3)


def test_static_start_is_at_rest_and_carries_the_weight(linkage_body):
    setup = Simulation(
        "body", 0.05, start="static", gravity=(0.0, 0.0, -9.81), force=(ConstantForce(20, (0.0, 0.0, 50.0)),), steps=5,
        constraint=(Joint(1), Joint(7, ("x", "z")), Joint(14, ("z",))),
    )  # fmt: skip
    motion = simulate(linkage_body, setup)
    assert np.abs(motion.node_displacement - motion.node_displacement[0]).max() < 1e-8
    assert np.abs(motion.node_displacement[0, -1, 2]) > 1e-4
    vertical = [name.endswith("z") for name in motion.constraint_names]
    weight = 9.81 * linkage_body.frame.mass
    assert motion.constraint_force[:, vertical].sum(axis=1) == pytest.approx(weight - 50.0, rel=1e-6)


def test_what_does_not_fit_is_moved_and_said(linkage_body):
    at = tuple(linkage_body.nodes[0].position + [0.0, 0.0, 0.01])
    setup = Simulation("body", 0.01, steps=2, constraint=(Joint(1, at=at),), velocity=(0.0, 0.0, 1.0))
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
    assert table.longest_step() == 1.0 and SineForce(1, (1.0, 0.0, 0.0), 2.0).longest_step() < 0.1


@pytest.mark.parametrize(
    "change, says",
    [
        ({"start": "static", "constraint": (Joint(1),)}, "leave 3 rigid motions free"),
        ({"constraint": (Joint(1), Joint(1, ("z",)))}, "depend on each other"),
        ({"constraint": (Joint(1, at=(9.0, 0.0, 0.0)), Joint(20))}, "away from the given places"),
        ({"elastic": (1.0,)}, "elastic: found 1 numbers, expected 6"),
    ],
)
def test_simulations_that_make_no_sense(linkage_body, change, says):
    with pytest.raises(InputError, match=says):
        simulate(linkage_body, Simulation("body", 0.1, **change))


def test_rigid_body_modes_are_not_elastic():
    with hpcred.linkage() as model:
        body = reduced_body(model, [Modes(index=(7,))], [20])
        columns = fields(model, lambda x: (1.0, -x[2], x[1], 1.0, 0, 0))
        body.frame = floating_frame(model, columns)
        columns.destroy()
    with pytest.raises(InputError, match="rigid-body motions"):
        simulate(body, Simulation("body", 0.1))


def test_exudyn_moves_the_body_as_we_do(linkage_body, tmp_path):
    """The linkage spinning freely with vibrations: Exudyn's reduced-order object against our simulation."""
    exudyn = pytest.importorskip("exudyn")
    from exudyn.FEM import ObjectFFRFreducedOrderInterface

    from hpcred.workflows.export import export_exudyn

    export_exudyn(linkage_body, tmp_path / "body.npz")
    spin, push, size, end = (4.0, 20.0, 12.0), (0.1, 0.0, 0.3), linkage_body.rom.size, 0.1
    interface = ObjectFFRFreducedOrderInterface()
    interface.LoadFromFile(str(tmp_path / "body.npz"))
    mbs = exudyn.SystemContainer().AddSystem()
    own = interface.AddObjectFFRFreducedOrder(
        mbs, positionRef=[0, 0, 0], initialVelocity=list(push), initialAngularVelocity=list(spin),
        gravity=[0, 0, -9.81],
    )  # fmt: skip
    mbs.Assemble()
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.numberOfSteps, settings.timeIntegration.endTime = 4000, end
    settings.solution.file.write = False
    settings.timeIntegration.verboseMode = 0
    mbs.SolveDynamic(settings)
    theirs = np.array(mbs.GetNodeOutput(own["nGenericODE2"], exudyn.OutputVariableType.Coordinates))
    place = np.array(mbs.GetNodeOutput(own["nRigidBody"], exudyn.OutputVariableType.Position))
    turn = np.array(mbs.GetNodeOutput(own["nRigidBody"], exudyn.OutputVariableType.RotationMatrix)).reshape(3, 3)
    setup = Simulation("body", end, gravity=(0.0, 0.0, -9.81), velocity=push, angular_velocity=spin, steps=10,
                       relative_tolerance=1e-8, absolute_tolerance=1e-12)  # fmt: skip
    ours = simulate(linkage_body, setup)
    assert theirs.shape == (size,)
    assert ours.elastic[-1] == pytest.approx(theirs, abs=2e-3 * np.abs(ours.elastic).max())
    assert ours.position[-1] == pytest.approx(place, abs=5e-6)
    assert rotation(ours.quaternion[-1]) == pytest.approx(turn, abs=1e-4)
    assert np.abs(ours.elastic[-1]).max() > 5e-5
