"""Blocks of columns: the numbers of random ones, combinations, products on ranks without rows."""

import numpy as np
import pytest
from helpers import gather

import hpcred
from hpcred.linalg.blocks import create_block, independent, local_rows, random_block, times
from hpcred.parallel.petsc import PETSc


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


@pytest.mark.mpi
@pytest.mark.parametrize("empty", [0, 1, 2])
def test_products_are_right_where_a_rank_has_rows_but_none_of_the_columns(comm, empty):
    """Row i of the product is row i^2 of what is multiplied, modulo all rows of that."""
    rows, columns = 4, 0 if comm.size > 1 and comm.rank == empty else 3
    taken = np.arange(rows * comm.rank, rows * (comm.rank + 1)) ** 2 % comm.allreduce(columns)
    csr = (np.arange(rows + 1).astype(PETSc.IntType), taken.astype(PETSc.IntType), np.ones(rows))
    matrix = PETSc.Mat().createAIJ(((rows, None), (columns, None)), csr=csr, comm=comm)
    like = PETSc.Mat().createAIJ(((columns, None), (columns, None)), nnz=1, comm=comm)
    like.assemble()
    block = create_block(like, 2)
    with local_rows(block) as values:
        values[...] = like.getOwnershipRange()[0] + np.arange(columns)[:, None] + [[0.0, 100.0]]
    with local_rows(times(matrix, block)) as values:
        assert np.array_equal(values.real, taken[:, None] + [[0.0, 100.0]])
