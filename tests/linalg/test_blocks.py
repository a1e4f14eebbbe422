"""Blocks of columns: the numbers of random ones."""

import numpy as np
import pytest
from helpers import gather

import hpcred
from hpcred.linalg.blocks import independent, random_block


@pytest.mark.mpi
def test_random_columns_have_no_mean_unit_variance_and_nothing_in_common(comm):
    """Even in -3^(1/2) to 3^(1/2); deviations of 5000 numbers are within five times what chance makes of them."""
    with hpcred.solid((16, 9, 9), comm=comm) as model:
        first, other = (random_block(model.K, 3, seed=seed) for seed in (1, 2))
        x = np.hstack([gather(first), gather(other)])
    assert np.abs(x).max() <= 3**0.5 and np.abs(x).max() > 1.72
    noise = 5 / np.sqrt(len(x))
    assert np.abs(x.mean(axis=0)).max() < noise
    assert np.abs(x.T @ x / len(x) - np.eye(6)).max() < noise


def test_combinations_of_columns_of_any_size_are_orthogonal():
    """One column is zero, and one the sum of two others: three combinations are left of five columns."""
    A = np.random.default_rng(2).standard_normal((20, 5)) * [1.0, 1e9, 1e-9, 1.0, 1.0]
    A[:, 3], A[:, 4] = 0.0, A[:, 0] + 1e-9 * A[:, 1]
    factor, eigenvalues = independent(A.T @ A, 1e-12)
    found = A @ factor
    assert eigenvalues.shape == (3,) and np.allclose(found.T @ found, np.diag(eigenvalues), atol=1e-12)
