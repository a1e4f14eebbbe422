"""Rigid-body modes, and nodes that do not belong to the rows."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse
from helpers import columns_of, dense_model, few_on_ranks, to_dense  # noqa: F401

import hpcred
from hpcred import Buckens, Dofs, InputError
from hpcred.model.rigid_body.modes import misfit_of_nodes, warnings_of_nodes
from hpcred.model.rigid_body.support import support_of

pytestmark = pytest.mark.mpi


@pytest.fixture
def free(comm):
    with hpcred.solid((4, 3, 3), inputs=3, clamped=False, comm=comm) as model:
        yield model


def relabelled(model, **labels):
    """The model with other labels on the rows of this rank."""
    return model.with_fields(dofs=replace(model.dofs, **labels))


def test_nodes_in_the_order_of_the_rows_fit(free, solid, linkage):
    for model in (free, solid, linkage):
        assert warnings_of_nodes(model) == []


def test_coordinates_of_other_rows_are_noticed(free):
    with relabelled(free, position=free.dofs.position[:, [1, 0, 2]] + 0.0) as mixed:
        assert "not those of the rows" in misfit_of_nodes(mixed)
        with pytest.raises(hpcred.InputError, match="not those of the rows"):
            hpcred.reduce(mixed, [hpcred.Krylov(100.0)], hpcred.Buckens())


def test_directions_of_other_rows_are_noticed(free):
    """All rows of x first, then y, then z, where the rows go node by node."""
    row = np.arange(free.first_row, free.first_row + free.local_rows)
    direction = (row // (free.size // 3)).astype(np.int8)
    with relabelled(free, direction=direction) as mixed:
        assert "rows" in misfit_of_nodes(mixed)


def test_a_warning_is_kept_in_the_record_where_the_frame_does_not_need_the_nodes(solid):
    mixed = relabelled(solid, position=solid.dofs.position[:, [1, 0, 2]] + 0.0)
    with mixed, hpcred.reduce(mixed, [hpcred.Krylov(100.0)]) as reduced:
        assert len(reduced.record.warnings) == 1


def test_translations_far_from_the_origin_are_motions(free):
    with relabelled(free, position=free.dofs.position + 1e12) as far:
        assert (support_of(far).residuals[:3] < 1e-10).all()


def test_masses_that_differ_are_noticed(comm):
    """Two nodes with three directions whose masses differ from x to y."""
    K = np.kron(np.array([[1.0, -1.0], [-1.0, 1.0]]), np.diag([1.0, 0.0, 0.0])) + 1e-3 * np.eye(6)
    M = np.diag([1.0, 2.0, 1.0, 1.0, 2.0, 1.0])
    rows = np.arange(6)
    dofs = hpcred.Dofs(rows // 3 + 1, (rows % 3).astype(np.int8), np.repeat([[0.0, 0, 0], [1.0, 0, 0]], 3, axis=0))
    with hpcred.SecondOrderModel.from_scipy(K, M, comm=comm, dofs=dofs) as model:
        assert any("masses in x, y and z are 2, 4 and 2 kg" in doubt for doubt in warnings_of_nodes(model))


@pytest.mark.parametrize("digits, stiffness", few_on_ranks([(None, 1e-9), (None, 0.0), (11, 0.0), ("single", 0.0)]))
def test_soft_springs_are_told_from_round_off(digits, stiffness):
    """Springs that each row of a body has too small a share of: said in the Buckens frame, and finite at 0 Hz."""
    with hpcred.solid((5, 2, 2), clamped=False) as block:
        K, M = (scipy.sparse.csr_matrix(to_dense(mat)) for mat in (block.K, block.M))
        labels = [np.concatenate(block.comm.allgather(getattr(block.dofs, key)))
                  for key in ("node", "direction", "position")]  # fmt: skip
    corners = np.array([0, 1, 2, 6, 7, 8, -3, -2, -1]) % K.shape[0]
    K[corners, corners] += stiffness * K.diagonal().max()
    if digits == "single":
        K.data = K.data.astype(np.float32).astype(float)
    elif digits:
        K.data = np.array([float(f"{value:.{digits - 1}e}") for value in K.data])
    load = np.zeros((K.shape[0], 2))
    load[[4, -5], [0, 1]] = 1.0
    with hpcred.SecondOrderModel.from_scipy(K, M, inputs=load, dofs=Dofs(*labels)) as model:
        with hpcred.reduce(model, tolerance=0.1, band=(0.0, 2000.0), frame=Buckens()) as rom:
            assert any("soft springs to the ground" in text for text in rom.record.warnings) == bool(stiffness)
        if not stiffness:
            with pytest.raises(InputError, match="the response at 0 Hz is infinite"):
                hpcred.reduce(model, tolerance=0.1, band=(0.0, 2000.0))
            return
        with hpcred.reduce(model, tolerance=0.1, band=(0.0, 2000.0)) as rom:
            expected = load.T @ np.linalg.solve(K.toarray(), load)
            assert rom.record.accuracy.reached
            assert rom.transfer_function(0.0).real == pytest.approx(expected, rel=1e-4)
