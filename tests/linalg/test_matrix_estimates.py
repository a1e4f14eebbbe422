"""Estimates from entries that are taken some at a time, against dense matrices."""

import numpy as np
import pytest
from helpers import to_dense

import hpcred
from hpcred.linalg import matrix_estimates
from hpcred.model.rigid_body import support


@pytest.mark.mpi
def test_symmetry_of_slices(comm, monkeypatch):
    """The one pair that differs most is found whatever the slices are."""
    with hpcred.solid((3, 2, 2), comm=comm) as model:
        K = model.K.copy()
        first, last = K.getOwnershipRange()
        for i, j in ((0, 4), (40, 41), (model.size - 1, model.size - 2)):
            if first <= i < last:
                K.setValue(i, j, 1e-3 * (i + 1) * model.mean_diagonal_of_k, addv=True)
        K.assemble()
        A = to_dense(K).real
        root = np.sqrt(np.diag(A))
        scale = np.maximum(np.maximum(np.abs(A), np.abs(A.T)), 1e-3 * np.outer(root, root))
        expected = [(np.abs(A - sign * A.T) / scale).max() for sign in (1, -1)]
        for most in (10**6, 7):
            monkeypatch.setattr(matrix_estimates, "AT_ONCE", most)
            found = [matrix_estimates.symmetry_defect(K, skew) for skew in (False, True)]
            assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.mpi
def test_forces_of_rows_in_slices(comm, monkeypatch):
    """|K| |R| of a body whose nodes turn, too."""
    with hpcred.linkage(comm) as model:
        monkeypatch.setattr(support, "AT_ONCE", 10**6)
        whole = support._scale_of_rows(model, 2.0)
        K, turns = np.abs(to_dense(model.K)), np.concatenate(comm.allgather(model.dofs.direction >= 3))
        sums = K @ np.where(turns, 0.5, 1.0)
        first, last = model.K.getOwnershipRange()
        kinds = np.array([np.exp(np.log(sums[turns == kind]).mean()) for kind in (False, True)])
        assert whole == pytest.approx(np.maximum(sums, kinds[turns.astype(int)])[first:last], rel=1e-12)
        monkeypatch.setattr(support, "AT_ONCE", 7)
        assert np.array_equal(support._scale_of_rows(model, 2.0), whole)
