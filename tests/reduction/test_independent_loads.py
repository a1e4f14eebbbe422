"""Independent loads, against numpy."""

import numpy as np
import pytest

from hpcred.reduction.run.independent_loads import _are_same, _independent_columns


@pytest.mark.parametrize("units", [np.ones(7), 10.0 ** np.arange(-9, 12, 3)], ids=["one unit", "many units"])
def test_dependent_columns_in_terms_of_independent_ones(units):
    rng = np.random.default_rng(1)
    A = rng.standard_normal((40, 7))
    A[:, 2], A[:, 4], A[:, 6] = A[:, 0] - 0.3 * A[:, 1], 2.0 * A[:, 3], A[:, 0] + A[:, 1] + A[:, 5]
    A = A * units
    kept, factor = _independent_columns(A.T @ A, np.linalg.norm(A, axis=0))
    assert len(kept) == 4 == np.linalg.matrix_rank(A[:, kept] / units[kept])
    assert (np.abs(A[:, kept] @ factor - A).max(axis=0) < 1e-12 * np.abs(A).max(axis=0)).all()
    assert np.array_equal(factor[:, kept], np.eye(4))


def test_what_is_left_of_a_rigid_load_is_round_off():
    """Column 0 is 1e-14 of what it was before the rigid-body part was taken out."""
    gram = np.diag([1e-28, 4.0])
    kept, factor = _independent_columns(gram, np.array([1.0, 2.0]))
    assert kept.tolist() == [1] and np.array_equal(factor, [[0.0, 1.0]])
    kept, factor = _independent_columns(np.diag([1e-28, 0.0]), np.array([1.0, 2.0]))
    assert not len(kept) and factor.shape == (0, 2)


@pytest.mark.parametrize("change, are_same", [(0.0, True), (1e-9, False)])
def test_equal_inputs_and_outputs_are_one_array(change, are_same):
    """Each column beside its own size: a change of 1e-9 of the smallest is one."""
    B = np.random.default_rng(0).standard_normal((6, 3)) * [1.0, 1e6, 1e-6]
    C = B.copy()
    C[:, 2] *= 1 + change
    assert _are_same(B, C) == are_same and not _are_same(B, C[:, :2])
