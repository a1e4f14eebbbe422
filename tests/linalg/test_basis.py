"""The mass-orthonormal basis: rank, scaling, what is deflated."""

import numpy as np
import pytest
from helpers import block_from, gather, to_dense

import hpcred
from hpcred.linalg.basis import Basis

pytestmark = pytest.mark.mpi


@pytest.fixture
def model(comm):
    with hpcred.solid((3, 2, 2), inputs=3, comm=comm) as model:
        yield model


@pytest.mark.parametrize("scale", [1.0, 1e12, 1e-12])
def test_basis_finds_the_rank_of_a_block(model, scale):
    """SLEPc's own dependence flag and its Cholesky orthogonalisation fail on these."""
    mass = to_dense(model.M)
    random = np.random.default_rng(1)
    first = random.standard_normal((len(mass), 5))
    basis = Basis(model.M)
    assert basis.extend(block_from(model.M, first)).kept == 5
    block = random.standard_normal((len(mass), 8))
    block[:, 1] = first @ random.standard_normal(5)  # in the span
    block[:, 3] = block[:, 2]  # twice the same
    block[:, 5] = block[:, 4] + 1e-9 * block[:, 5]  # close, but new
    block[:, 7] = 0.0
    block[:, 6] *= 1e6
    assert basis.extend(block_from(model.M, block * scale)).kept == 5
    V = gather(basis.columns)
    assert np.abs(V.T @ mass @ V - np.eye(10)).max() < 1e-13
    assert basis.defect() < 1e-13
    assert basis.extend(block_from(model.M, block)).kept == 0
    spanned = V @ (V.T @ mass @ block)
    assert np.abs(spanned - block).max() < 1e-9 * np.abs(block).max()
    basis.close()


def test_basis_stays_orthogonal_to_what_it_deflates(model):
    mass = to_dense(model.M)
    random = np.random.default_rng(2)
    held = np.linalg.qr(random.standard_normal((len(mass), 4)))[0]
    held = held @ np.linalg.inv(np.linalg.cholesky(held.T @ mass @ held)).T
    basis = Basis(model.M, deflate=block_from(model.M, held))
    assert (
        basis.extend(
            block_from(model.M, np.hstack([held @ np.ones((4, 2)), random.standard_normal((len(mass), 3))]))
        ).kept
        == 3
    )
    assert np.abs(held.T @ mass @ gather(basis.columns)).max() < 1e-13
    basis.close()
