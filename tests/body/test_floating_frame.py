"""Floating-frame quantities against closed forms and second methods."""

import numpy as np
import pytest
from helpers import bar, block_from, gather, to_dense

import hpcred
from hpcred import Buckens, Modes
from hpcred.body.floating_frame import _lumped, _meeting_rank, floating_frame
from hpcred.fe.dofs import Dofs
from hpcred.linalg.blocks import apply, create_block, inner
from hpcred.model.rigid_body.modes import rigid_motions
from hpcred.simulation.equations_of_motion import FlexibleBody

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
    found = floating_frame(block, columns, origin)
    columns.destroy()

    def mean(length, start, power):  # of (s - start)^power over 0..length
        return ((length - start) ** (power + 1) - (-start) ** (power + 1)) / ((power + 1) * length)

    mx, my, mz = (mean(*item, 1) for item in ((a, x0), (b, y0), (c, z0)))
    xx, yy, zz = (mean(*item, 2) for item in ((a, x0), (b, y0), (c, z0)))
    assert found.integrals == "consistent"
    assert found.mass == pytest.approx(mass)
    assert found.mc == pytest.approx(mass * np.array([mx, my, mz]))
    inertia = [[yy + zz, -mx * my, -mx * mz], [-mx * my, xx + zz, -my * mz], [-mx * mz, -my * mz, xx + yy]]
    np.testing.assert_allclose(found.J, mass * np.array(inertia), atol=1e-12)
    x, z = mx + x0, mz + z0  # mean of x and z themselves
    x2, z2 = a * a / 3, c * c / 3
    assert found.Ct == pytest.approx(mass * np.array([[x, 0, 0], [0, z, 0]]))
    xz, xx1 = mx * z, x2 - x0 * x  # mean of (x - x0) z and of (x - x0) x
    assert found.Cr[0] == pytest.approx(mass * np.array([0, mz * x, -my * x]))
    assert found.Cr[1] == pytest.approx(mass * np.array([-(z2 - z0 * z), 0, xz]))
    assert found.N[0] == pytest.approx(mass * np.array([[xx1, 0, 0], [my * x, 0, 0], [mz * x, 0, 0]]))
    assert found.S[0, 0] == pytest.approx(mass * np.array([[x2, 0], [0, 0]]))
    assert found.S[1, 1] == pytest.approx(mass * np.array([[0, 0], [0, z2]]))
    assert found.S[0, 1] == pytest.approx(mass * np.array([[0, x * z], [0, 0]]))
    assert found.Me == pytest.approx(mass * np.diag([x2, z2]))


@pytest.mark.mpi
def test_slender_bar_in_closed_form(comm):
    """Six dofs a node; the fields are ones that the beam elements hold exactly."""
    length = 2.0
    with bar(comm, length, 6) as model:
        columns = fields(model, lambda x: (x[0], 0, 0, 0, 0, 0), lambda x: (0, x[0], 0, 0, 0, 1))
        found = floating_frame(model, columns)
        columns.destroy()
    section = np.pi / 4 * 0.022**2
    mass, polar = 7850 * section * length, 7850 * section**2 / (2 * np.pi) * length
    assert found.mass == pytest.approx(mass)
    assert found.mc == pytest.approx([mass * length / 2, 0, 0])
    slender = mass * length**2 / 3
    np.testing.assert_allclose(found.J, np.diag([polar, slender, slender]), atol=1e-9)
    assert found.Ct == pytest.approx(mass * length / 2 * np.eye(3)[:2])
    assert found.Cr == pytest.approx(np.array([[0, 0, 0], [0, 0, mass * length**2 / 3]]), abs=1e-12)
    assert found.integrals == "mean of directions"


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
        found = floating_frame(block, rom.columns, lumped=lumped)
        shapes = gather(rom.columns)
        system = FlexibleBody(found, rom.K, rom.D)
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
    assert found.integrals == ("lumped" if lumped else "consistent")
    change, turned = (new - old for new, old in zip(deformed, at_rest, strict=True))
    inertia = system.floating_frame.mass_matrix(q)[3:6, 3:6]
    assert np.abs(inertia - found.J - change).max() < 1e-10 * np.abs(change).max()
    assert np.abs(np.tensordot(found.Cr1, q, axes=(1, 0)) - turned).max() < 1e-10 * np.abs(turned).max()
    for k, slope in enumerate(found.dJ):
        block_k = found.Gr[:, 3 * k : 3 * k + 3]
        assert (block_k + block_k.T) / 2 == pytest.approx(slope)
    order = [(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)]
    factor = np.array([-0.5, -0.5, -0.5, -1, -1, -1])
    assert found.Oe == pytest.approx(np.array([[slope[i] for i in order] for slope in found.dJ]) * factor)
    # the integral of Phi_i^T skew(w)^2 (R + Phi q), against the derivative of w^T J(q) w / 2
    w = np.array([0.3, -1.0, 0.7])
    monomials = np.array([w[0] ** 2, w[1] ** 2, w[2] ** 2, w[0] * w[1], w[1] * w[2], w[0] * w[2]])
    centrifugal = (found.Oe + np.tensordot(found.Oe1, q, axes=(1, 0))) @ monomials
    slope = found.dJ + 2 * np.tensordot(found.J2, q, axes=(1, 0))
    assert centrifugal == pytest.approx(-0.5 * slope @ w @ w)


@pytest.mark.mpi
def test_coriolis_terms_are_those_of_the_nodes(block):
    """Ge and Gr times w: the work of the acceleration 2 w x Phi_k in Phi_i, and its moment about the origin."""
    w = np.array([0.3, -1.0, 0.7])
    with hpcred.reduce(block, [Modes(index=tuple(range(7, 11)))], Buckens()) as rom:
        found = floating_frame(block, rom.columns)
        shapes = gather(rom.columns)
        moved = np.cross(2 * w, shapes.reshape(-1, 3, 4), axisb=1, axisc=1).reshape(shapes.shape)
        acceleration = block_from(block.M, moved)
        work = shapes.T @ to_dense(block.M) @ moved
        turned = rigid_integrals(block, block.M, acceleration)[1]
        acceleration.destroy()
    assert np.einsum("ick,c->ik", found.Ge.reshape(4, 3, 4), w) == pytest.approx(work)
    assert np.einsum("akc,c->ka", found.Gr.reshape(3, 4, 3), w) == pytest.approx(turned)


def point_masses(comm, directions, mass=3.0):
    """Masses in a row along (1, 1, 0); node i + 1 has the directions[i]; springs to the ground."""
    node = np.repeat(np.arange(len(directions)) + 1, [len(item) for item in directions])
    direction = np.concatenate([["xyz".index(name) for name in item] for item in directions]).astype(np.int8)
    dofs = Dofs(node, direction, (node - 1.0)[:, None] * [1.0, 1.0, 0.0] + [2.0, 0.0, 5.0])
    unit = np.eye(len(node))
    return hpcred.SecondOrderModel.from_scipy(1e3 * unit, mass * unit, comm=comm, dofs=dofs, name="points")


@pytest.mark.mpi
def test_matrices_that_couple_directions_have_no_exact_integrals(comm):
    """A third mass of 3 kg between two others follows both, and its x the y of one of them, as in a condensed model."""
    T = np.concatenate([np.eye(6), (np.eye(6)[:3] + np.eye(6)[3:]) / 2])
    places = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    dofs = Dofs(np.repeat([1, 2], 3), np.tile(np.arange(3, dtype=np.int8), 2), np.repeat(places, 3, axis=0))
    kinds = []
    for coupling in (0.0, 0.5):
        T[6, 1] = coupling
        M = 3.0 * T.T @ T
        with hpcred.SecondOrderModel.from_scipy(1e3 * np.eye(6), M, comm=comm, dofs=dofs) as model:
            columns = block_from(model.M, np.eye(6)[:, :3] + 0.5)
            found = floating_frame(model, columns)
            columns.destroy()
        exact = np.abs(np.einsum("aakl->kl", found.S) - found.Me).max() < 1e-12 * found.Me.max()
        kinds.append((found.integrals, exact))
    assert kinds == [("consistent", True), ("mean of directions", False)]


@pytest.mark.mpi
def test_a_planar_body_has_the_mass_of_its_plane(comm):
    """Two nodes of 3 kg with x and y: 6 kg, not the mean with a direction that is not there."""
    places = np.array([[2.0, 0.0, 5.0], [3.0, 1.0, 5.0]])
    with point_masses(comm, ["xy", "xy"]) as model:
        field = np.array([[0.5, 2.0, 1.0, 0.0]]).T  # node 1 in x and y, node 2 in x and y
        columns = block_from(model.M, field)
        found = floating_frame(model, columns)
        columns.destroy()
    assert found.masses.tolist() == [6.0, 6.0, 0.0] and found.mass == 6.0
    assert found.mc == pytest.approx(6 * places.mean(axis=0))
    # M knows the inertia about z, and the products with z; not what motion along z would add
    assert found.J[2, 2] == pytest.approx(3 * (places[:, :2] ** 2).sum())
    assert found.J[0, 2] == pytest.approx(-3 * (places[:, 0] * 5).sum())
    assert np.isnan(found.J[:2, :2]).all()
    u = field.reshape(2, 2)
    assert found.Ct[0] == pytest.approx([*(3 * u.sum(axis=0)), 0.0])
    assert found.N[0] == pytest.approx(3 * places.T @ np.column_stack([u, [0.0, 0.0]]))
    assert found.S[:, :, 0, 0] == pytest.approx(3 * np.array([[1.25, 1.0, 0], [1.0, 4.0, 0], [0, 0, 0]]))


@pytest.mark.mpi
@pytest.mark.parametrize(
    "directions, masses", [(["yz", "yz"], [0, 6, 6]), (["z"] * 4, [0, 0, 12]), (["xyz", "yz", "xyz"], [6, 9, 9])]
)
def test_integrals_come_from_a_direction_that_all_nodes_have(comm, directions, masses):
    """Unit displacement of all nodes in z: S_zz is the mass, N_zz the first moment along z."""
    with point_masses(comm, directions) as model:
        parts = model.comm.allgather(model.dofs.direction)
        columns = block_from(model.M, (np.concatenate(parts) == 2).astype(float)[:, None])
        found = floating_frame(model, columns)
        columns.destroy()
    assert found.masses.tolist() == masses
    assert found.S[2, 2] == pytest.approx(max(masses)) and found.N[0, 2, 2] == pytest.approx(5.0 * max(masses))
    assert found.Ct[0, 2] == pytest.approx(max(masses))


@pytest.mark.parametrize("step, ranks", [(1, 3), (10, 10), (1000, 64), (4096, 16)])
def test_node_numbers_are_shared_evenly(step, ranks):
    """Whatever the step of the numbers, no rank gets the nodes of all."""
    counts = np.bincount(_meeting_rank(step * np.arange(1, 20_001, dtype=np.int32), ranks), minlength=ranks)
    assert counts.sum() == 20_000 and counts.max() < 1.2 * counts.mean()
