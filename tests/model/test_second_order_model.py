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


def test_imaginary_parts_are_refused(solid):
    K, M, _ = dense_model(solid)
    with pytest.raises(hpcred.InputError, match="imaginary parts"):
        hpcred.SecondOrderModel.from_scipy(K + 1e-3j * K, M, comm=solid.comm)
    with hpcred.SecondOrderModel.from_scipy(K + 0j, M, comm=solid.comm) as model:
        assert np.array_equal(to_dense(model.K), K)


def test_what_follows_from_a_damping_matrix_goes_with_it(solid):
    """An unsymmetric D that is left out does not make the model unsymmetric."""
    K, M, _ = dense_model(solid)
    D = 1e-5 * K
    D[3, 5] += 10.0
    with hpcred.SecondOrderModel.from_scipy(K, M, D, comm=solid.comm) as model:
        assert not model.symmetric
        with model.with_damping_matrix(None) as undamped:
            assert undamped.symmetric
        assert not model.symmetric


def test_a_model_says_what_it_is(solid):
    lines = str(solid).splitlines()
    assert len(lines) == 3
    assert lines[0].startswith("solid: 144 dofs") and "symmetric" in lines[1] and "inputs" in lines[2]


def test_models_share_their_matrices_and_close_by_themselves(solid):
    expected = to_dense(solid.K)
    with solid.with_inputs([(45, "x")]) as other:
        assert other.input_names == ("45:x",) and solid.input_names != ("45:x",)
    assert np.array_equal(to_dense(solid.K), expected)
