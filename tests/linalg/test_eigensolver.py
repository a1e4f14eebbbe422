"""The small symmetric eigenproblem against LAPACK."""

import numpy as np
import pytest

from hpcred.linalg.eigensolver import symmetric_eigenpairs

pytestmark = pytest.mark.mpi


def test_small_eigenproblem_against_lapack(comm):
    random = np.random.default_rng(3)
    matrix = random.standard_normal((12, 12))
    matrix += matrix.T
    values, vectors = symmetric_eigenpairs(matrix, comm)
    assert np.allclose(values, np.linalg.eigvalsh(matrix), atol=1e-12)
    assert np.allclose(matrix @ vectors, vectors * values, atol=1e-11)
