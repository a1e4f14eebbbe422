"""Free or held: what K makes of rigid-body motions, and which nodes are not where their rows are."""

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse
from helpers import Rod, beam_element, to_dense

import hpcred
from hpcred import Buckens, Dofs, InputError
from hpcred.model.rigid_body.modes import misfit_of_nodes, remark_on_digits
from hpcred.model.rigid_body.rows_alone import warnings_of_rows_alone
from hpcred.model.rigid_body.support import support_of

pytestmark = pytest.mark.mpi


def block(comm, cells):
    """K and M of a free block, and the labels of its rows, on every rank."""
    with hpcred.solid(cells, (1.0, 0.3, 0.2), clamped=False, comm=comm) as model:
        K, M = (scipy.sparse.csr_matrix(to_dense(mat)) for mat in (model.K, model.M))
        parts = comm.allgather(model.dofs)
    return K, M, Dofs(*(np.concatenate([getattr(part, key) for part in parts])
                        for key in ("node", "direction", "position")))  # fmt: skip


def moved(dofs, position):
    return Dofs(dofs.node, dofs.direction, position)


@pytest.mark.parametrize("cells", [(4, 2, 2), (16, 4, 4)])
@pytest.mark.parametrize("part, free, movable", [(0.0, 6, 6), (1e-9, 3, 6), (1e-5, 3, 3)])
def test_a_mooring_is_seen_on_any_mesh(comm, cells, part, free, movable):
    """Springs to the ground at one node hold three motions; they are `part` of the stiffness of a row there."""
    K, M, dofs = block(comm, cells)
    rows = np.flatnonzero(dofs.node == dofs.node[-1])
    K[rows, rows] += part * np.abs(K).sum(axis=1).max()
    with hpcred.SecondOrderModel.from_scipy(K, M, comm=comm, dofs=dofs) as model:
        support = support_of(model)
        assert (support.free.shape[1], support.movable.shape[1]) == (free, movable)
        R = np.zeros((K.shape[0], 6))
        arm = dofs.position - support.centre
        for k in range(3):
            R[dofs.direction == k, k] = 1.0
            R[:, 3 + k] = np.cross(np.eye(3)[k], arm)[np.arange(len(R)), dofs.direction]
        met = np.abs(K @ R @ support.free)
        assert met.max(initial=0.0) <= 1e-9 * np.abs(R @ support.free).max() * np.abs(K).max()
        assert misfit_of_nodes(model) is None


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_the_decision_has_no_units(comm, scale):
    K, M, dofs = block(comm, (5, 2, 2))
    K[0, 0] *= 1 + 1e-3
    with (
        hpcred.SecondOrderModel.from_scipy(K, M, comm=comm, dofs=dofs) as one,
        hpcred.SecondOrderModel.from_scipy(scale * K, M, comm=comm, dofs=moved(dofs, dofs.position / scale)) as two,
    ):
        first, second = support_of(one), support_of(two)
        assert first.forces == pytest.approx(second.forces, rel=1e-9, abs=1e-14)
        assert first.free.shape == second.free.shape == (6, 5)


def test_coordinates_of_a_grid_have_no_error(comm):
    """A slender bar, held at one end: 1/32 m has few digits, which are all that there are."""
    with hpcred.solid((32, 4, 4), size=(1.0, 0.01, 0.01), inputs=1, comm=comm) as model:
        found = support_of(model)
        assert found.node_digits == 5 and found.free.shape[1] == found.movable.shape[1] == 0


def test_a_body_without_stiffness_is_free(comm):
    K, M, dofs = block(comm, (1, 1, 1))
    with hpcred.SecondOrderModel.from_scipy(0 * K, M, comm=comm, dofs=dofs) as model:
        assert support_of(model).free.shape == (6, 6) and misfit_of_nodes(model) is None


@pytest.mark.parametrize("digits", [4, 6, 8])
def test_a_list_of_few_digits_is_told_from_a_wrong_order(comm, digits):
    """The error of a rounded coordinate bounds the force that a rotation meets; another order leaves a part of 1."""
    K, M, dofs = block(comm, (7, 3, 3))
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    whole = scipy.sparse.block_diag([turn] * (K.shape[0] // 3)).tocsr()
    K, M, position = whole @ K @ whole.T, whole @ M @ whole.T, dofs.position @ turn.T
    few = np.array([float(f"{value:.{digits - 1}e}") for value in position.ravel()]).reshape(position.shape)
    with hpcred.SecondOrderModel.from_scipy(K, M, comm=comm, dofs=moved(dofs, few)) as model:
        support = support_of(model)
        assert support.free.shape[1] == 6 and misfit_of_nodes(model) is None
        assert f"the coordinates of the nodes have {digits} digits" in remark_on_digits(support)
        assert hpcred.inspect(model)["rigid_body_modes"] == 6
    order = np.random.default_rng(0).permutation(len(few) // 3)
    wrong = moved(dofs, few.reshape(-1, 3, 3)[order].reshape(-1, 3))
    with hpcred.SecondOrderModel.from_scipy(K, M, comm=comm, dofs=wrong) as model:
        assert "check the order of nodes" in misfit_of_nodes(model) and not remark_on_digits(support_of(model))


def frame_of_beams():
    """K and M of a free frame of seven nodes, and their positions."""
    nodes = np.array([[0, 0, 0], [0, 0, 3], [2, 0, 3], [4, 0, 3], [4, 0, 0], [4, 3, 3], [0, 3, 3]], float)
    K, M = np.zeros((2, 42, 42))
    for first, last in [(0, 1), (1, 2), (2, 3), (3, 4), (3, 5), (1, 6), (6, 5)]:
        rows = np.r_[6 * first : 6 * first + 6, 6 * last : 6 * last + 6]
        stiffness, mass = beam_element(nodes[first], nodes[last], Rod())
        K[np.ix_(rows, rows)] += stiffness
        M[np.ix_(rows, rows)] += mass
    return K, M, nodes


@pytest.mark.parametrize("turned", [(4,), (1,), (2, 4)])
def test_nodes_in_other_axes_are_named(comm, turned):
    """K has six motions without force, which are rigid ones of all nodes but those whose rows are turned."""
    K, M, nodes = frame_of_beams()
    T = np.eye(42)
    for first in np.repeat(turned, 2) * 6 + np.tile([0, 3], len(turned)):
        T[first : first + 3, first : first + 3] = scipy.linalg.expm(np.cross(np.eye(3), [0.02, -0.05, 0.1]))
    row = np.arange(42)
    dofs = Dofs(row // 6 + 11, (row % 6).astype(np.int8), nodes[row // 6])
    load = np.eye(42)[:, :3]
    with hpcred.SecondOrderModel.from_scipy(T @ K @ T.T, T @ M @ T.T, inputs=load, comm=comm, dofs=dofs) as model:
        said = f"rigid ones of all nodes but {', '.join(str(node + 11) for node in turned)}: the rows of"
        assert said in misfit_of_nodes(model) and "in other axes" in misfit_of_nodes(model)
        with pytest.raises(InputError, match=said):
            hpcred.reduce(model, tolerance=1e-3, band=(0.0, 20.0), frame=Buckens())
    nodes[3] += [0.1, 0.0, 0.05]
    dofs = Dofs(row // 6 + 11, (row % 6).astype(np.int8), nodes[row // 6])
    with hpcred.SecondOrderModel.from_scipy(K, M, comm=comm, dofs=dofs) as model:
        assert "all nodes but 14: the rows of this node are those of another place" in misfit_of_nodes(model)
    # one that springs hold is no such node
    K[:3, :3] += np.diag([1e5, 2e5, 3e5])
    nodes[3] -= [0.1, 0.0, 0.05]
    dofs = Dofs(row // 6 + 11, (row % 6).astype(np.int8), nodes[row // 6])
    with hpcred.SecondOrderModel.from_scipy(K, M, comm=comm, dofs=dofs) as model:
        assert misfit_of_nodes(model) is None and support_of(model).free.shape[1] == 3


@pytest.mark.parametrize("way", [pytest.param("scipy", marks=pytest.mark.costly), "dense", "petsc", "file"])
def test_supports_on_the_diagonal_are_warned_of(comm, folder, way):
    """Rows with 1 on the diagonal of K and M are modes at 1 / (2 pi) Hz, which the chain does not have."""
    n, held = 30, 4
    K = 1e4 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[:held], K[:, :held] = 0.0, 0.0
    K[range(held), range(held)] = 1.0
    given = {"scipy": scipy.sparse.csr_matrix, "dense": np.array}.get(way, scipy.sparse.csr_matrix)
    with hpcred.SecondOrderModel.from_scipy(given(K), given(np.eye(n)), comm=comm) as made:
        model = made
        if way == "petsc":
            model = hpcred.SecondOrderModel.from_petsc(made.K, made.M, held=[])
        elif way == "file":
            hpcred.write_model(folder / "m.h5", made)
            model = hpcred.read_model(folder / "m.h5", comm)
        said = f"found {held} rows with nothing beside the diagonal, the first is dof 1"
        told = [hpcred.inspect(model)["warnings"]]
        if way == "scipy":  # the same model in all ways
            told += [hpcred.natural_modes(model, 3).warnings, hpcred.damped_modes(model, 3).warnings]
        for found in told:
            assert any(said in text and "4 false modes at 0.159155 Hz" in text for text in found)
    K[range(held), range(held)] = 0.0
    with hpcred.SecondOrderModel.from_scipy(given(K), given(np.eye(n)), comm=comm) as loose:
        assert "4 false modes at 0 Hz" in hpcred.inspect(loose)["warnings"][0]
    K[range(held), range(held)] = 1e-20, 2e-20, 4e-20, 3e-20
    with hpcred.SecondOrderModel.from_scipy(given(K), given(np.eye(n)), comm=comm) as soft:
        assert "4 false modes from 1.592e-11 to 3.183e-11 Hz" in warnings_of_rows_alone(soft)[0]
    K[range(held), range(held)] = 0.0
    with hpcred.SecondOrderModel.from_scipy(np.diag(np.arange(1.0, 9.0)), np.eye(8), comm=comm) as oscillators:
        assert warnings_of_rows_alone(oscillators) == []
    # without mass a row is no oscillator
    M = np.eye(n)
    M[range(held), range(held)] = 0.0
    with hpcred.SecondOrderModel.from_scipy(given(K + np.diag([1.0] * held + [0.0] * (n - held))), given(M),
                                            comm=comm) as still:  # fmt: skip
        assert warnings_of_rows_alone(still) == []
