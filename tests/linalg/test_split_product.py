"""Products and eigenvalues of soft motions beside stiff ones, against exact arithmetic."""

from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse

import hpcred
from hpcred.linalg.blocks import create_block, local_rows
from hpcred.linalg.eigensolver import graded_eigenpairs
from hpcred.linalg.split_product import split_product
from hpcred.parallel.failures import ComputationError

pytestmark = pytest.mark.mpi


@pytest.mark.parametrize("units", [1, 1000])
def test_products_that_cancel_have_no_round_off(comm, units):
    """A stiff chain, in other units at every second mass, and columns that hardly stretch it; a mass beside it."""
    n, random = 30, np.random.default_rng(3)
    K = np.zeros((n, n))
    for i, stiffness in enumerate(random.uniform(1e6, 9e6, n - 2)):
        K[i : i + 2, i : i + 2] += stiffness * np.array([[1, -1], [-1, 1]])
    scale = np.where(np.arange(n) % 2, 1.0, units)
    K = scale[:, None] * K * scale
    K = (K + K.T) / 2
    X = (1 + 1e-9 * random.normal(size=(n, 2))) / scale[:, None]
    with hpcred.SecondOrderModel.from_scipy(scipy.sparse.csr_matrix(K), np.eye(n), comm=comm) as model:
        block = create_block(model.K, 2)
        first, last = model.K.getOwnershipRange()
        with local_rows(block) as rows:
            rows[...] = X[first:last]
        with local_rows(split_product(model.K, block)) as rows:
            found = rows.real.copy()
    exact = [[sum(Fraction(K[i, j]) * Fraction(X[j, k]) for j in range(n)) for k in range(2)]
             for i in range(first, last)]  # fmt: skip
    terms = np.abs(K[first:last]) @ np.abs(X)
    error = [[float(abs(Fraction(found[i, k]) - exact[i][k])) for k in range(2)] for i in range(last - first)]
    assert (np.array(error) <= 1e-21 * terms + 2e-16 * np.abs(found)).all()


def test_eigenvalues_of_graded_matrices_have_their_digits():
    """Pairs of coordinates, whose small eigenvalue is det / large eigenvalue; in any order."""
    random, soft = np.random.default_rng(5), 10.0 ** np.arange(-9, 0)
    stiff = soft[::-1] * 1e14
    coupling = 1e-9 * np.sqrt(soft * stiff)
    order = random.permutation(18)
    A = np.block([[np.diag(soft), np.diag(coupling)], [np.diag(coupling), np.diag(stiff)]])[np.ix_(order, order)]
    values, vectors = graded_eigenpairs(A)
    assert values == pytest.approx(np.sort(np.r_[soft, stiff]), rel=1e-14)
    assert np.allclose(vectors.T @ vectors, np.eye(18), atol=1e-15)
    size = np.sqrt(values)
    assert np.abs(vectors.T @ A @ vectors / size / size[:, None] - np.eye(18)).max() < 1e-14
    mixed = np.linalg.qr(random.normal(size=(18, 18)))[0]
    assert np.array_equal(graded_eigenpairs(A := mixed @ A @ mixed.T)[0], np.linalg.eigh(A)[0])


def test_parts_that_hardly_couple_keep_what_they_feel_of_each_other():
    """Two dense parts with a tie of 1e-20 of theirs, against perturbation theory; and equal ones without any."""
    random, n = np.random.default_rng(7), 6
    one, other = (X @ X.T + n * np.eye(n) for X in random.normal(size=(2, n, n)))
    tie = 1e-20 * random.normal(size=(n, n))
    values, vectors = graded_eigenpairs(np.block([[one, tie], [tie.T, other]]))
    of_one = np.linalg.norm(vectors[n:], axis=0) < 0.5
    (a, X), (b, Y) = np.linalg.eigh(one), np.linalg.eigh(other)
    assert values == pytest.approx(np.sort(np.r_[a, b]), rel=1e-13)
    felt = Y @ ((Y.T @ tie.T @ X) / (a - b[:, None]))
    signs = np.sign(np.einsum("ij,ij->j", X, vectors[:n, of_one]))
    assert np.abs(vectors[n:, of_one] * signs - felt).max() < 1e-11 * np.abs(felt).max()
    twice, vectors = graded_eigenpairs(np.kron(np.eye(2), one))
    assert twice == pytest.approx(np.repeat(a, 2)) and np.allclose(vectors.T @ vectors, np.eye(2 * n), atol=1e-14)


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_numbers_that_are_none_are_refused(wrong):
    """No comparison of couplings sees them."""
    for place in ((0, 1), (2, 2)):
        matrix = np.diag([1.0, 2.0, 3.0])
        matrix[place] = matrix[place[::-1]] = wrong
        with pytest.raises(ComputationError, match="NaN or Inf"):
            graded_eigenpairs(matrix)
