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


def test_blocks_of_well_separated_columns_are_projected_twice(model, monkeypatch):
    """As blocks of a Krylov sequence; columns that separation enlarges are projected once more."""
    mass, random = to_dense(model.M), np.random.default_rng(4)
    basis, passes, project = Basis(model.M), [], Basis._project
    monkeypatch.setattr(Basis, "_project", lambda *given: passes.append(None) or project(*given))
    counts = []
    for size in (4.0, 4.0, 4.0, 4.0, 1e-2, 4.0):  # of what makes columns others
        columns = random.standard_normal((len(mass), 1)) + size * random.standard_normal((len(mass), 4))
        before = len(passes)
        assert basis.extend(block_from(model.M, columns)).kept == 4
        counts.append(len(passes) - before)
    V = gather(basis.columns)
    assert np.abs(V.T @ mass @ V - np.eye(24)).max() < 1e-14 and basis.defect() < 1e-14
    assert counts == [1, 1, 1, 1, 2, 1]


@pytest.mark.parametrize("keeps, with_images", [(True, True), (False, False)])
def test_a_defect_does_not_grow_with_the_blocks(model, keeps, with_images):
    """Of columns that lie in the basis by nine tenths one projection, with images M V that are combined and never made
    anew, multiplies round-off by two, block after block."""
    mass, random = to_dense(model.M), np.random.default_rng(5)
    root = np.linalg.cholesky(mass)
    basis, V = Basis(model.M, keeps=keeps), np.zeros((len(mass), 0))
    for _ in range(15):
        new = np.linalg.solve(root.T, np.linalg.qr(root.T @ random.standard_normal((len(mass), 2)))[0])
        old = V[:, -2:] if V.shape[1] else 0 * new
        columns = block_from(model.M, 0.9 * old + 0.44 * new)
        images = block_from(model.M, mass @ (0.9 * old + 0.44 * new)) if with_images else None
        assert basis.extend(columns, images).kept == 2
        V = gather(basis.columns)
    assert np.abs(V.T @ mass @ V - np.eye(30)).max() < 3e-15


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


@pytest.mark.parametrize("t", [(0.0, 1.0), (0.6, 0.8)], ids=["axis", "skew"])
def test_directions_that_move_no_mass_are_left_out_and_counted(comm, t):
    """Their M-norm is round-off of either sign, which had been scaled to 1, or called the mark of an indefinite M."""
    n, random = 20, np.random.default_rng(4)
    mass = np.kron(np.diag(10.0 ** random.uniform(-3, 3, n)), np.eye(2) - np.outer(t, t))
    without, full = np.kron(np.eye(n)[:, :3], np.array(t)[:, None]), random.standard_normal((2 * n, 3))
    block = np.hstack([full, 1e3 * without[:, :2], full[:, :1] + 1e3 * without[:, 2:]])
    with hpcred.SecondOrderModel.from_scipy(np.eye(2 * n), mass, comm=comm) as model:
        basis = Basis(model.M)
        found = basis.extend(block_from(model.M, block))
        V = gather(basis.columns)
    assert (found.kept, found.massless) == (3, 3)
    assert np.abs(V.T @ mass @ V - np.eye(3)).max() < 1e-12
