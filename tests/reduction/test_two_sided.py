"""Oblique projection: twice the moments, biorthogonality, unstable models."""

import numpy as np
import pytest
from helpers import close, columns_of, damped, dense_model, gather, moments, second_order_moments, with_columns

import hpcred
from hpcred import GivenDamping, Krylov, Rayleigh, SecondOrderKrylov
from hpcred.reduction.two_sided import _paired

pytestmark = pytest.mark.mpi


@pytest.mark.parametrize("unsymmetric", [False, True])
def test_two_sided_projection_matches_twice_the_moments(solid, unsymmetric):
    model, K, M, D, B = damped(solid, unsymmetric)
    C = np.zeros((3, len(K)))
    C[0, 50] = C[1, 20] = C[2, 8] = 1.0
    with model:
        model = with_columns(model, "output", C.T)
        for point, two_sided in (({"frequency": 700.0, "order": 1}, True), ({"decay": 2000.0, "order": 1}, False)):
            component = SecondOrderKrylov(**point)
            projection = "two_sided" if two_sided else "one_sided"
            with hpcred.reduce(
                model, [component], None, GivenDamping(), projection=projection, allow_unstable=True
            ) as rom:
                count = 4 if two_sided else 2
                full = second_order_moments(K, M, D, B, C, component.point, count)
                small = second_order_moments(rom.K, rom.M, rom.D, rom.B, rom.C, component.point, count)
                assert max(close(a, b) for a, b in zip(full, small, strict=True)) < 1e-9
                if two_sided:
                    V, W = gather(rom.columns), gather(rom.left_columns)
                    assert np.abs(W.T @ M @ V - np.eye(rom.size)).max() < 1e-10
                    assert close(rom.K, W.T @ K @ V) < 1e-9


def test_an_unstable_two_sided_model_is_refused(solid):
    C = np.zeros((2, solid.size))
    C[0, 50] = C[1, 20] = 1.0
    solid = with_columns(solid, "input", dense_model(solid)[2][:, :2])
    solid = with_columns(solid, "output", C.T)
    basis = [Krylov(700.0, 1), Krylov(0.0)]
    with hpcred.reduce(solid, basis, projection="two_sided", allow_unstable=True) as rom:
        unstable = rom.record.unstable_poles
        assert len(rom.record.factorisations) == len(basis)  # which both sides use
    assert unstable
    with pytest.raises(hpcred.InputError, match="is unstable, with .* take projection = 'one_sided'"):
        hpcred.reduce(solid, basis, projection="two_sided")
    with hpcred.reduce(solid, basis, damping=Rayleigh(1.0, 1e-7)) as rom:
        assert not rom.record.unstable_poles


def test_an_unsymmetric_damping_matrix_that_is_left_out_does_no_harm(solid):
    """The two-sided model is that of the body without D."""
    model, K, M, D, B = damped(solid, unsymmetric=True)
    C = np.zeros((3, len(K)))
    C[0, 50] = C[1, 20] = C[2, 8] = 1.0
    s = 2j * np.pi * 700.0
    expected = C @ np.linalg.solve(s * s * M + K, B + 0j)
    with model, with_columns(model, "output", C.T) as both:
        settings = {"projection": "two_sided", "allow_unstable": True}
        with hpcred.reduce(both, [Krylov(700.0, 1)], None, hpcred.NoDamping(), **settings) as rom:
            assert close(expected, rom.transfer_function(s)) < 1e-9
            assert close(np.sort(np.abs(rom.poles()))[::2], 2 * np.pi * rom.frequencies) < 1e-9
            assert all(record.kind == "LDL^T" for record in rom.record.factorisations)


def test_one_vector_on_each_side_matches_two_moments(comm):
    with hpcred.solid((4, 2, 2), inputs=1, comm=comm) as clamped, clamped.with_outputs([(20, "x")]) as model:
        K, M, B = dense_model(model)
        C = columns_of(model.Ct).T
        basis = [Krylov(700.0, 0)]
        with hpcred.reduce(model, basis, projection="two_sided", allow_unstable=True) as rom:
            assert rom.size == 1
            shift = -((2 * np.pi * 700.0) ** 2)
            full, small = (moments(*system, shift, 2) for system in ((K, M, B, C), (rom.K, rom.M, rom.B, rom.C)))
            assert max(close(a, b) for a, b in zip(full, small, strict=True)) < 1e-9


def test_the_defect_of_bi_orthogonal_bases_is_round_off(comm):
    with hpcred.solid((4, 2, 2), inputs=2, comm=comm) as clamped, clamped.with_outputs([(20, "x"), (8, "y")]) as model:
        M = dense_model(model)[1]
        with hpcred.reduce(model, [Krylov(700.0, 1)], projection="two_sided", allow_unstable=True) as rom:
            V, W = gather(rom.columns), gather(rom.left_columns)
            defect = rom.record.orthonormality_defect
    assert np.abs(W.T @ M @ V - np.eye(rom.size)).max() < 1e-12 + 10 * defect and defect < 1e-12


@pytest.mark.parametrize("damped", [False, True])
def test_pairs_with_and_without_mass_are_decoupled(damped):
    """W^T M V = I and W^T K V = I / tau^2, each on its own pairs, and nothing between both."""
    random, n, massless, tau = np.random.default_rng(8), 7, 3, 0.1
    K = 40.0 * np.eye(n) + random.normal(size=(n, n))
    M = np.eye(n)[:, massless:] @ (np.eye(n) + 0.1 * random.normal(size=(n, n)))[massless:]
    D = np.diag([5.0, *np.zeros(n - 1)]) if damped else None
    W, V, static = _paired(K, M, D, tau)
    moving = slice(0, n - static)
    still = slice(n - static, n)
    assert static == massless
    mass, stiffness = W.T @ M @ V, tau**2 * W.T @ K @ V
    expected = np.diag([1.0] * (n - static) + [0.0] * static)
    assert np.allclose(mass, expected, atol=1e-12)
    assert np.allclose(stiffness[still], np.eye(n)[still], atol=1e-12)
    assert np.allclose(stiffness[moving, still], 0.0, atol=1e-12)
