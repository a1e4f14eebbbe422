"""Blocks of columns: the numbers of random ones."""

import numpy as np
import pytest
from helpers import gather

import hpcred
from hpcred.linalg.blocks import random_block

pytestmark = pytest.mark.mpi


def test_random_columns_have_no_mean_unit_variance_and_nothing_in_common(comm):
    """Even in -3^(1/2) to 3^(1/2); deviations of 5000 numbers are within five times what chance makes of them."""
    with hpcred.solid((16, 9, 9), comm=comm) as model:
        first, other = (random_block(model.K, 3, seed=seed) for seed in (1, 2))
        x = np.hstack([gather(first), gather(other)])
    assert np.abs(x).max() <= 3**0.5 and np.abs(x).max() > 1.72
    noise = 5 / np.sqrt(len(x))
    assert np.abs(x.mean(axis=0)).max() < noise
    assert np.abs(x.T @ x / len(x) - np.eye(6)).max() < noise
