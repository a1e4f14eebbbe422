"""Natural modes against closed solutions and a dense eigensolver."""

from contextlib import closing

import numpy as np
import pytest
from helpers import PLACES, bar, dense_model, few_on_ranks, truss
from scipy.linalg import block_diag, eigh

import hpcred
from hpcred.model.second_order_model import SecondOrderModel

pytestmark = pytest.mark.mpi

HELD = hpcred.Tangent(node=1)


def test_a_cantilever_moves_the_mass_that_books_say(comm):
    """8 / (pi^2 (2 j - 1)^2) of the mass along the axis; 61.31 % and 18.83 % in the first two bending modes."""
    with bar(comm, 1.0, 24, diameter=0.3) as model, closing(hpcred.natural_modes(model, 16, HELD)) as found:
        share = found.effective_masses[:, :3] / found.masses[:3]
        axial = share[:, 0].max(), np.sort(share[:, 0])[-2]
        assert axial == pytest.approx((8 / np.pi**2, 8 / (9 * np.pi**2)), rel=2e-3)
        bending = np.sort(share[:, 1] + share[:, 2])[::-1][:4]  # of two planes
        assert bending == pytest.approx([0.6131, 0.6131, 0.1883, 0.1883], rel=5e-3)
        assert found.rigid == 0 and found.residual < 1e-8


def test_all_modes_together_move_the_whole_mass(comm):
    """All modes of a clamped block, against numpy."""
    with hpcred.solid((2, 1, 1), size=(0.4, 0.1, 0.15), comm=comm) as model:
        K, M, _ = dense_model(model)
        with closing(hpcred.natural_modes(model, model.size)) as found:
            eigenvalues = eigh(K, M, eigvals_only=True)
            assert found.frequencies == pytest.approx(np.sqrt(eigenvalues) / (2 * np.pi), rel=1e-9)
            assert found.effective_masses.sum(axis=0) == pytest.approx(found.masses, rel=1e-9)


@pytest.mark.parametrize("frame", [None, hpcred.Buckens(), hpcred.NoFrame()])
def test_a_free_body_shows_its_rigid_body_modes_at_zero(linkage, frame):
    """By inertia relief, or by a shifted K; elastic modes have no part in the motion of the whole."""
    K, M, _ = dense_model(linkage)
    elastic = np.sqrt(eigh(K, M, eigvals_only=True)[6:10]) / (2 * np.pi)
    with closing(hpcred.natural_modes(linkage, 10, frame)) as found:
        assert found.rigid == 6 and found.frequencies[:6].tolist() == [0.0] * 6
        assert found.frequencies[6:] == pytest.approx(elastic, rel=1e-8)
        assert found.effective_masses[:6].sum(axis=0) == pytest.approx(found.masses, rel=1e-8)
        assert found.effective_masses[6:].max() < 1e-12 * found.masses.min()


@pytest.mark.parametrize("key", ["K", "M"])
def test_matrices_of_both_signs_have_no_natural_frequency(comm, key):
    mats = {"K": np.eye(4), "M": np.eye(4)}
    mats[key][0, 1] = mats[key][1, 0] = 2.0
    with (
        SecondOrderModel.from_scipy(**mats, comm=comm) as model,
        pytest.raises(hpcred.InputError, match="which have no natural frequency"),
    ):
        hpcred.natural_modes(model, 2)


@pytest.mark.costly
def test_null_vectors_that_no_node_tells_of(comm):
    """A free chain without nodes, and a count of rigid-body modes only."""
    K = 2 * np.eye(9) - np.eye(9, k=1) - np.eye(9, k=-1)
    K[0, 0] = K[8, 8] = 1
    with SecondOrderModel.from_scipy(K, np.eye(9), comm=comm) as model:
        with closing(hpcred.natural_modes(model, 4)) as found:
            exact = 2 * np.sin(np.arange(4) * np.pi / 18) / (2 * np.pi)
            assert found.frequencies == pytest.approx(exact, rel=1e-9)
            assert found.rigid == 1 and found.masses is None and found.effective_masses is None
        with pytest.raises(hpcred.InputError, match="10 modes asked for, model has 9"):
            hpcred.natural_modes(model, 10)


@pytest.mark.parametrize("soft", few_on_ranks([1e-6, 1e-1, 1e-3, 1e-4]))
@pytest.mark.costly
def test_soft_modes_stand_beside_stiff_ones(comm, soft):
    """Six chains, each on a spring of 1e-7 to 1e-12 of theirs: what a stiff mode has of soft ones would take all
    digits of its direction in a step of inverse iteration."""
    n, k = 20, 1e6
    chain = k * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    chain[0, 0], chain[-1, -1] = k + soft, k
    elastic = np.repeat(2 * np.sqrt(k) * np.sin(np.arange(1, 4) * np.pi / (2 * n)), 6)[:14] / (2 * np.pi)
    with (
        SecondOrderModel.from_scipy(block_diag(*[chain] * 6), np.eye(6 * n), comm=comm) as model,
        closing(hpcred.natural_modes(model, 20)) as found,
    ):
        assert found.frequencies[6:] == pytest.approx(elastic, rel=3e-7)
        if found.rigid:
            assert found.rigid == 6 and soft < 1e-5
        else:  # the first mode of a rigid mass, but for soft / k n
            assert found.frequencies[:6] == pytest.approx([np.sqrt(soft / n) / (2 * np.pi)] * 6, rel=1e-5)


def test_fewer_than_the_rigid_body_modes(linkage):
    with closing(hpcred.natural_modes(linkage, 3)) as found:
        assert found.rigid == 3 and found.frequencies.tolist() == [0.0] * 3 and found.shapes is None


def test_modes_of_a_plane_body_are_shown_in_its_plane(comm, folder):
    """Out of it nodes have no mass to move; the sums of what is shown are the whole."""
    with truss(comm, (0, 1)) as model:
        hpcred.write_model(folder / "plane.h5", model)
    report = hpcred.modes(folder / "plane.h5", 6, comm=comm)
    shares, factors = hpcred.workflows.tables_of_modes(report)
    assert list(shares[0]) == list(factors[0]) == ["mode", "f (Hz)", "x", "y", "rz"]
    assert [shares[-1][key] for key in ("x", "y", "rz")] == [100.0, 100.0, 100.0]
    inertia = 3 * ((PLACES - PLACES.mean(axis=0))[:, :2] ** 2).sum()
    assert hpcred.workflows.mass_in_words(report) == f"mass 9 (x), 9 (y) kg; inertia {inertia:.6g} (rz) kg m^2"
