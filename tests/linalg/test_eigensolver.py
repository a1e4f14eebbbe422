"""The small symmetric eigenproblem against LAPACK."""

import numpy as np
import pytest
import scipy.linalg
from helpers import dense_model, gather

import hpcred
from hpcred.linalg.eigensolver import symmetric_eigenpairs

pytestmark = pytest.mark.mpi


def test_small_eigenproblem_against_lapack(comm):
    random = np.random.default_rng(3)
    matrix = random.standard_normal((12, 12))
    matrix += matrix.T
    values, vectors = symmetric_eigenpairs(matrix, comm)
    assert np.allclose(values, np.linalg.eigvalsh(matrix), atol=1e-12)
    assert np.allclose(matrix @ vectors, vectors * values, atol=1e-11)


def test_repeated_eigenvalues_have_real_orthonormal_vectors(comm):
    """A complex build must not give back parts of complex vectors."""
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((8, 8)))[0]
    matrix = turn @ np.diag([1.0, 2, 2, 2, 5, 5, 7, 9]) @ turn.T
    values, vectors = symmetric_eigenpairs(matrix, comm)
    assert vectors.dtype == float
    assert np.allclose(vectors.T @ vectors, np.eye(8), atol=1e-12)
    assert np.allclose(matrix @ vectors, vectors * values, atol=1e-12)


def test_double_modes_of_a_square_bar(comm):
    """Bending in y and in z has the same frequencies; in every build, as real M-orthonormal vectors."""
    with hpcred.solid((6, 2, 2), (0.6, 0.1, 0.1), inputs=2, comm=comm) as model:
        K, M, _ = dense_model(model)
        exact = np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True)[:6]) / (2 * np.pi)
        assert exact[1] / exact[0] < 1 + 1e-9
        with hpcred.reduce(model, [hpcred.Modes(count=6)]) as reduced:
            V = gather(reduced.columns)
            assert np.allclose(reduced.frequencies, exact, rtol=1e-8)
            assert np.abs(V.T @ M @ V - np.eye(6)).max() < 1e-10
            assert np.abs(K @ V - M @ V @ reduced.K).max() < 1e-6 * np.abs(K @ V).max()
