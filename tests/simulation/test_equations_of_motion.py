"""The equations of motion against derivatives of their energy and of the rotation."""

import numpy as np
import pytest
from helpers import gather, made_up_stiffness, to_dense

import hpcred
from hpcred import Buckens, Modes, Rayleigh
from hpcred.body.body import body_of
from hpcred.body.rotations import of_vector, quaternion_rate, rotation
from hpcred.simulation import Bushing, Joint, LineSpring, SineDrive, SineForce, SineMoment
from hpcred.simulation.equations_of_motion import FlexibleBody
from hpcred.simulation.joints import holds_of
from hpcred.simulation.loads import load_of
from hpcred.simulation.springs import element_of


@pytest.fixture(scope="module", params=["linear", "stiffened"])
def system(request):
    with (
        hpcred.linkage() as model,
        hpcred.reduce(model, [Modes(index=tuple(range(7, 12)))], Buckens(), Rayleigh(2.0, 1e-5)) as rom,
    ):
        body = body_of(model, rom, [1, 20])
    if request.param == "stiffened":
        body = made_up_stiffness(body).stiffened()
    held, loaded = body.nodes
    bushing = Bushing(20, (3e2, 2e2, 1e2), rotational_stiffness=(3.0, 2.0, 1.0))
    start = {held.node: (held, np.array([0.1, 0.2, 0.3]), of_vector([0.3, 0.2, 0.1]))}
    return FlexibleBody(
        body.floating_frame, rom.K, rom.D, (0.0, 0.0, -9.81),
        [load_of(SineForce(20, (1.0, 2.0, 2.0), 3.0, 1.0), loaded),
         load_of(SineMoment(20, (1.0, 2.0, 2.0), 3.0, 1.0, axes="body"), loaded)],
        [element_of(spring, loaded, np.zeros(3), np.eye(3))
         for spring in (LineSpring(20, (3.0, 2.0, 1.0), 100.0, 2.0, 1.0), bushing)],
        holds_of([Joint(1, kind="prismatic", axis=(1.0, 2.0, 0.0))],
                 [SineDrive(node=1, about=(0.0, 1.0, 1.0), amplitude=0.1, frequency=2.0, phase=0.3)], start),
    )  # fmt: skip


def test_rotation_by_hand_and_its_rate():
    quarter = np.array([np.cos(np.pi / 4), 0.0, 0.0, np.sin(np.pi / 4)])
    assert rotation(3 * quarter) == pytest.approx(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]))
    p, w, h = np.array([0.5, -0.1, 0.7, 0.3]), np.array([0.3, -1.2, 0.8]), 1e-6
    p /= np.linalg.norm(p)
    slope = (rotation(p + h * quaternion_rate(p, w)) - rotation(p - h * quaternion_rate(p, w))) / (2 * h)
    skew = np.cross(w, np.eye(3)).T  # omega in body axes: A' = A skew(w)
    assert slope == pytest.approx(rotation(p) @ skew, abs=1e-8)
    assert rotation(np.array([p, quarter]))[1] == pytest.approx(rotation(quarter))


def test_inertia_forces_take_no_power(system):
    """T' of a motion with z' = 0 is z . h, and that is z^T M' z / 2."""
    generator = np.random.default_rng(3)
    q, z = 1e-2 * generator.normal(size=system.size), generator.normal(size=6 + system.size)
    h, u = 1e-4, z[6:]
    rate = (system.floating_frame.mass_matrix(q + h * u) - system.floating_frame.mass_matrix(q - h * u)) / (2 * h)
    forces = system.inertia_forces(q, z, system.floating_frame.mass_matrix(q))
    size = np.abs(forces * z).sum()
    assert abs(z @ forces - 0.5 * z @ rate @ z) < 1e-9 * size and abs(z @ rate @ z) > 1e-6 * size


def test_accelerations_are_those_of_all_nodes():
    """Virtual work of the inertia of every node of a block, at places and velocities of their own, in any motion."""
    origin, gravity = np.array([0.3, -0.2, 0.1]), np.array([1.0, -2.0, -9.0])
    basis = [Modes(index=tuple(range(7, 12)))]
    with (
        hpcred.solid((3, 2, 1), (0.6, 0.2, 0.1), 3, clamped=False) as model,
        hpcred.reduce(model, basis, Buckens(), Rayleigh(2.0, 0.0)) as rom,
    ):
        phi, m = gather(rom.columns).reshape(-1, 3, rom.size), to_dense(model.M)[::3, ::3]
        place = model.dofs.position[::3] - origin
        body = body_of(model, rom, [1], origin)
    generator = np.random.default_rng(4)
    p, z = generator.normal(size=4), generator.normal(size=6 + rom.size)
    soft = 1e-9 * rom.K  # so that inertia counts
    p, q, v, w, u = p / np.linalg.norm(p), 0.2 * generator.normal(size=rom.size), z[:3], z[3:6], z[6:]
    _, rates, _ = FlexibleBody(body.floating_frame, soft, rom.D, gravity).start(np.ones(3), p, q, z)
    zp = rates[7 + rom.size : 13 + 2 * rom.size]
    there = place + phi @ q
    jacobian = np.concatenate([np.tile(np.eye(3), (len(there), 1, 1)), np.cross(np.eye(3), there[:, None]).transpose(
        0, 2, 1), phi], axis=2)  # fmt: skip
    acceleration = jacobian @ zp + np.cross(w, v) + np.cross(w, np.cross(w, there)) + 2 * np.cross(w, phi @ u)
    force = m @ (acceleration - rotation(p).T @ gravity)
    work = np.einsum("aik,ai->k", jacobian, force) + np.r_[np.zeros(6), soft @ q + rom.D @ u]
    size = np.einsum("aik,ai->k", np.abs(jacobian), np.abs(m) @ np.abs(acceleration))
    assert (np.abs(work) < 1e-11 * size).all()
    assert np.abs(m @ np.cross(w, phi @ u)).max() > 1e-2 * np.abs(force).max()


def test_jacobians_are_derivatives_of_the_residual(system):
    """Against central differences in random directions, with all joints, springs and loads, far from rest; each kind of
    equations but the powers, which are integrals that nothing depends on, by each kind of unknowns."""
    generator = np.random.default_rng(4)
    y, yp = generator.normal(size=(2, 2 * system.size + 16 + system.multipliers))
    system.split(y)[2][:] *= 0.1
    system.split(y)[1][:] /= 0.9 * np.linalg.norm(system.split(y)[1])
    dy, dyp = system.jacobians(0.1, y, yp)
    scale = [np.abs(part).max() for part in system.split(system.residual(0.1, y, yp))[:5]]
    for unknowns in range(5):
        step = np.zeros(len(y))
        system.split(step)[unknowns][:] = 1e-5 * generator.normal(size=system.split(step)[unknowns].shape)
        for matrix, move in ((dy, (step, 0.0)), (dyp, (0.0, step))):
            ends = [system.residual(0.1, y + sign * move[0], yp + sign * move[1]) for sign in (1, -1)]
            exact, found = system.split(ends[0] - ends[1])[:5], system.split(2 * matrix @ step)[:5]
            for size, one, other in zip(scale, exact, found, strict=True):
                assert np.abs(other - one).max() <= 1e-6 * np.abs(one).max() + 1e-14 * size


def test_a_start_keeps_the_constraints(system):
    """Accelerations at the start are those with which velocities go on to fit, on a turning support that slides."""
    generator = np.random.default_rng(5)
    z = generator.normal(size=6 + system.size)
    held = system.holds[0]
    p, q = np.array([0.9, 0.1, -0.2, 0.3]), 1e-2 * generator.normal(size=system.size)
    r, p, q, moved = system.assemble(held.place, p, q)
    assert moved
    y, yp, _ = system.start(r, p, q, z)
    h, found = 1e-7, []
    for t in (0.0, h):
        r, p, q, z, *_ = system.split(y + t * yp)
        G, rates = system.constraints(t, system.node_motions(r, rotation(p), q))
        found.append(G @ z - rates)
    assert np.abs(found[0]).max() < 1e-10 and np.abs(rates).max() > 0.1
    assert np.abs(found[1] - found[0]).max() < 1e-3 * h * np.abs(G @ system.split(yp)[3]).max()
