"""The distributed matrices and their common pattern."""

import numpy as np
import pytest
from helpers import dense_model, to_dense

import hpcred

pytestmark = pytest.mark.mpi


def test_symmetric_pattern_of_an_unsymmetric_matrix(solid):
    """D may have entries where D^T has none; all matrices share one pattern, its transpose included."""
    K, M, B = dense_model(solid)
    D = np.zeros_like(K)
    D[0, -1] = 3.0
    with hpcred.SecondOrderModel.from_scipy(K, M, D, solid.comm) as model:
        assert np.array_equal(to_dense(model.D), D)
        transposed = model.D.transpose()
        assert np.array_equal(transposed.getValuesCSR()[1], model.K.getValuesCSR()[1])
        transposed.destroy()
