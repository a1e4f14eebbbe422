"""Mass, centre, inertia and rigid-body modes of bodies whose nodes do not all move in all directions."""

import numpy as np
import pytest
from helpers import PLACES, to_dense, truss

import hpcred
from hpcred.fe.dofs import Dofs
from hpcred.linalg.blocks import apply, create_block, from_dense, inner, local_rows
from hpcred.model.rigid_body.modes import RigidBodyModes, pushed_motions, rigid_body_quantities, rigid_motions
from hpcred.model.rigid_body.support import support_of
from hpcred.parallel.failures import InputError


@pytest.mark.mpi
def test_two_nodes_of_3_kg_in_a_plane_are_6_kg(comm):
    with truss(comm, (0, 1), places=PLACES[:2]) as model:
        body = rigid_body_quantities(model)
    assert body.mass == 6.0 and body.masses.tolist() == [6.0, 6.0, 0.0]
    assert not body.complete and body.uniform
    assert body.centre == pytest.approx([0.5, 0.25, 5.0])
    assert body.inertia[2, 2] == pytest.approx(3 * 2 * (0.5**2 + 0.25**2))
    assert np.isnan(body.inertia[:2, :2]).all() and np.abs(body.inertia[2, :2]).max() < 1e-12


@pytest.mark.mpi
def test_three_directions_give_the_inertia_of_points(comm):
    with truss(comm, (0, 1, 2)) as model:
        body = rigid_body_quantities(model)
    arms = PLACES - PLACES.mean(axis=0)
    assert body.complete and body.uniform and body.mass == pytest.approx(9.0)
    assert body.centre == pytest.approx(PLACES.mean(axis=0))
    assert body.inertia == pytest.approx(3 * sum((a @ a) * np.eye(3) - np.outer(a, a) for a in arms), abs=1e-12)


@pytest.mark.mpi
def test_held_dofs_take_mass_from_a_direction_only(comm):
    """The third node held in x: the mass of the body is still 9 kg, and the difference is there to be seen."""
    with truss(comm, (0, 1), left_out=[(3, 0)]) as model:
        body = rigid_body_quantities(model)
        report = hpcred.inspect(model)
    assert body.masses.tolist() == [6.0, 9.0, 0.0] and body.mass == 9.0 and not body.uniform
    assert body.centre[0] == pytest.approx(1 / 3)  # seen by the masses in y, of all nodes
    assert report["mass_kg"] == 9.0 and report["masses_in_x_y_z_kg"] == [6.0, 9.0, 0.0]
    assert report["inertia_kg_m2"][0][0] is None and report["inertia_kg_m2"][2][2] > 0


@pytest.mark.mpi
def test_one_direction_alone_has_no_centre_along_it(comm):
    with truss(comm, (2,)) as model:
        body = rigid_body_quantities(model)
    assert body.centre[:2] == pytest.approx(PLACES[:, :2].mean(axis=0)) and np.isnan(body.centre[2])
    x, y = (PLACES - PLACES.mean(axis=0))[:, :2].T
    assert body.inertia[0, 1] == pytest.approx(-3 * (x * y).sum())  # all that motion along z says of the inertia
    assert np.isnan(body.inertia).sum() == 7


@pytest.mark.mpi
@pytest.mark.parametrize(
    "directions, places, count",
    [((0, 1), PLACES, 3), ((0, 1, 2), PLACES, 6), ((0, 1, 2), PLACES[0] + np.outer([0, 1, 3], [1.0, 2.0, -1.0]), 5)],
)
def test_rigid_body_modes_are_those_that_move_a_dof(comm, directions, places, count):
    """Three in a plane, six in space, five of points on a line, whose turn about it moves nothing."""
    with truss(comm, directions, places=places) as model:
        rigid = RigidBodyModes(model)
        assert rigid.count == count and rigid.defect < 1e-12
        force = create_block(model.K, count)
        apply(model.K, rigid.R, force)
        assert np.abs(inner(force, force)).max() < (1e-8 * model.K.norm()) ** 2
        assert inner(rigid.R, rigid.MR) == pytest.approx(np.eye(count), abs=1e-12)
        force.destroy()


def test_a_body_without_mass_is_refused():
    unit = np.eye(3)
    dofs = Dofs(np.array([1, 1, 1]), np.arange(3, dtype=np.int8), np.zeros((3, 3)))
    with (
        hpcred.SecondOrderModel.from_scipy(unit, 0 * unit, dofs=dofs, name="ghost") as model,
        pytest.raises(InputError, match="ghost: the translational masses in x, y, z are 0, 0, 0 kg"),
    ):
        rigid_body_quantities(model)


@pytest.mark.mpi
@pytest.mark.parametrize("stiffness", [0.0, 1.0, 1e4])
def test_supports_are_known_by_the_force_that_translations_meet(comm, stiffness):
    """A triangle of rods in its plane, a spring to the ground in y at one node: its share of the row there."""
    with truss(comm, (0, 1)) as free:
        K, M = to_dense(free.K), to_dense(free.M)
        parts = comm.allgather(free.dofs)
    dofs = Dofs(*(np.concatenate([getattr(part, key) for part in parts]) for key in ("node", "direction", "position")))
    K *= np.pi  # a number with all digits
    K[3, 3] += stiffness
    with hpcred.SecondOrderModel.from_scipy(K, M, comm=comm, dofs=dofs) as model:
        support = support_of(model)
        sizes = np.abs(K).sum(axis=1)
        share = stiffness / max(sizes[3], np.exp(np.log(sizes).mean()))
        # nothing moves in z, and turns about x and y are none
        assert np.abs(support.forces[:3] - [0.0, share, 0.0]).max() < 1e-15 + 1e-12 * share
        assert support.free.shape[1] == (2 if stiffness else 3) == support.movable.shape[1]


@pytest.mark.mpi
@pytest.mark.parametrize("directions", [(0,), (0, 1, 2)])
def test_a_load_pushes_the_motions_that_meet_no_force(comm, directions):
    """Three masses of 3 kg: what f does to M-orthonormal free motions is f^T R (R^T M R)^-1 R^T f in all, here by the
    acceleration of the centre and about it."""
    force = np.zeros(3 * len(directions))
    force[-len(directions)] = 2.0  # in x on the last node
    with truss(comm, directions) as model:
        first = model.first_row
        with model.with_input_columns(force[first : first + model.local_rows, None], ["f"]) as pushed:
            loads = from_dense(pushed.B)
            parts = pushed_motions(pushed, loads)
            loads.destroy()
            R = np.concatenate(comm.allgather(rows_of_motions(pushed)))
    R = np.linalg.qr(R[:, :1] if len(directions) == 1 else R)[0]  # rods let the nodes move in x together only
    assert (parts**2).sum() == pytest.approx(force @ R @ R.T @ force / 3.0)


def rows_of_motions(model):
    """Rigid-body motions of the rows of this rank (rows, 6)."""
    motions = rigid_motions(model)
    with local_rows(motions) as rows:
        mine = rows.real.copy()
    motions.destroy()
    return mine
