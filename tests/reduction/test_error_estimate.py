"""The estimate against dense truth, its grid, the next point, and the count of modes."""

import numpy as np
import pytest
from adaptive_models import chain, membrane, unit

from hpcred.reduction.error_estimate import (
    around_peaks,
    estimate,
    finer,
    grid,
    is_free,
    largest,
    missing,
    next_point,
    off_poles,
    resolved,
    unsettled,
)
from hpcred.reduction.pseudo_modal import Law, diagonalised, nested, relative, response

PORTS = (np.eye(2),) * 2


def krylov(K, B, f, blocks):
    """Orthonormal columns of (A^-1)^j A^-1 B, M = 1, A = K - (2 pi f)^2."""
    A, V, X = K - (2 * np.pi * f) ** 2 * np.eye(len(K)), np.zeros((len(K), 0)), B
    for _ in range(blocks):
        X = np.linalg.solve(A, X)
        for _ in range(2):
            X = X - V @ (V.T @ X)
            X = np.linalg.qr(X)[0]
        V = np.hstack([V, X])
    return V


def projected(K, B, V):
    return diagonalised(V.T @ K @ V, V.T @ B)


@pytest.mark.parametrize("make, high, blocks", [(chain, 8.0, 13), (chain, 8.0, 15), (membrane, 20.0, 10),
                                                (membrane, 20.0, 12)])  # fmt: skip
def test_one_more_block_tells_the_error(make, high, blocks):
    K, law, band = make(90 if make is chain else 9)[0], Law(eta=2e-3), (0.0, high)
    B = unit(len(K), 2, len(K) // 2)
    V = krylov(K, B, 0.7 * band[1], blocks + 1)
    inner, outer = projected(K, B, V[:, :-2]), projected(K, B, V)
    S = grid([outer], law, band, 60)
    said, noise = estimate(inner, outer, nested(inner, outer), law, S, PORTS)
    full = diagonalised(K, B)
    H = response(full, law, S, PORTS)
    true = relative(H - response(inner, law, S, PORTS), H)
    assert said.max() < 0.1 and 0.8 < said.max() / true.max() < 1.25
    clear = true > 1e-9
    assert clear.sum() > 10
    assert (np.abs(np.log(said / true))[clear] < np.log(1.25)).all()
    assert noise.max() < 1e-8


def test_grid_has_uniform_points_and_seven_around_each_cluster():
    law, band = Law(eta=0.02), (1.0, 10.0)
    f = np.array([0.2, 3.0, 3.003, 6.0, 30.0])  # the first pair is one cluster, two lie outside of the band
    model = diagonalised(np.diag((2 * np.pi * f) ** 2), np.ones((5, 1)))
    S = grid([model], law, band, 50)
    assert (np.diff(S) > 0).all() and S[0] == 1.0 and S[-1] == 10.0
    assert np.isin(np.linspace(1.0, 10.0, 50), S).all()
    assert len(S) == 50 + 2 * 7
    for pole in (3.0, 6.0):
        near = S[np.abs(S / pole - 1) < 0.0301]
        assert np.abs(near / pole - 1).min() < 1e-12
        for offset in (-0.03, -0.015, -0.006, 0.006, 0.015, 0.03):
            assert np.abs(near / pole - 1 - offset).min() < 1e-12
    assert len(grid([model], law, band, 50, [0.0])) == 50 + 2
    # poles of both models count
    other = diagonalised(np.diag((2 * np.pi * np.array([8.0])) ** 2), np.ones((1, 1)))
    assert len(grid([model, other], law, band, 50)) == 50 + 3 * 7


def test_grid_has_every_sharp_resonance_of_a_cluster():
    """Poles that lie close together are apart where they are sharper still: one of them was left out."""
    f = np.array([3.0, 3.0 * (1 + 1e-6), 6.0])
    model = diagonalised(np.diag((2 * np.pi * f) ** 2), np.ones((3, 1)))
    S = grid([model], Law(eta=1e-8), (1.0, 10.0), 50)
    assert np.abs(S[:, None] / f - 1).min(axis=0).max() < 1e-12
    S = grid([model], Law(eta=1e-5), (1.0, 10.0), 50)
    assert len(S) == 50 + 2 * 7


def test_finer_and_around_peaks():
    S = np.array([0.0, 1.0, 3.0])
    assert np.allclose(finer(S, 2), [0.0, 0.5, 1.0, 2.0, 3.0])
    curve = np.array([1.0, 5.0, 2.0, 1.0, 9.0])
    assert np.allclose(around_peaks(np.arange(5.0), curve, 6.0, 2), [3.5])
    assert np.allclose(around_peaks(np.arange(5.0), curve, 3.0, 2), [0.5, 1.5, 3.5])


def test_curve_finds_narrow_peaks_and_can_be_interpolated():
    """The response has a zero between two resonances, where the relative error has a peak as narrow as its damping."""
    K, law, band = chain(60)[0], Law(eta=1e-3), (0.0, 6.0)
    B = unit(60, 5)
    V = krylov(K, B, 4.0, 12)
    one = (np.eye(1),) * 2
    inner, outer = projected(K, B, V), projected(K, B, krylov(K, B, 4.0, 30))
    embedding = np.linalg.lstsq(krylov(K, B, 4.0, 30) @ outer.vectors, V @ inner.vectors, rcond=None)[0]
    S, curve = largest(inner, outer, embedding, law, finer(grid([outer, inner], law, band)), one)
    dense = np.linspace(*band, 40001)
    true, _ = estimate(inner, outer, embedding, law, dense, one)
    assert true.max() <= 1.01 * curve.max()
    S, curve = resolved(inner, outer, embedding, law, S, curve, one, 1e-12)
    assert (np.diff(S) > 0).all()
    said = np.exp(np.interp(dense, S, np.log(np.maximum(curve, 1e-300))))
    clear = true > 1e-11
    assert (np.abs(np.log(said / true))[clear] < np.log(2)).all()


def test_next_point_is_the_largest_estimate_off_the_points_and_poles():
    f = np.array([2.0, 5.0, 7.0])
    model = diagonalised(np.diag((2 * np.pi * f) ** 2), np.ones((3, 1)))
    S = np.linspace(0.0, 10.0, 1001)
    curve = np.exp(-((S - 5.0) ** 2))
    found = next_point(S, curve, [], model, (0.0, 10.0))
    assert 0.0019 * 5 < abs(found - 5.0) < 0.0045 * 5
    found = next_point(S, curve, [5.0], model, (0.0, 10.0))
    assert 0.2 <= abs(found - 5.0) < 0.22
    assert next_point(S, curve, list(np.linspace(0, 10, 80)), model, (0.0, 10.0)) is None
    assert off_poles(3.0, model, (0.0, 10.0)) == 3.0
    assert off_poles(0.0, model, (0.0, 10.0)) is None
    assert off_poles(10.0, model, (0.0, 9.0)) is None
    band = (5.0 * (1 - 5e-4), 5.0 * (1 + 5e-4))  # a place in a narrow one, too
    found = next_point(np.linspace(*band, 101), np.ones(101), [band[1]], model, band)
    assert found is not None and abs(found - 5.0) > 4e-4
    crowd = diagonalised(np.diag((2 * np.pi * np.linspace(4.9, 5.1, 50)) ** 2), np.ones((50, 1)))
    assert off_poles(5.0, crowd, (0.0, 10.0)) is None


def test_modes_that_are_missing_and_modes_that_move():
    f = np.array([2.0, 5.0, 7.0])
    model = diagonalised(np.diag((2 * np.pi * f) ** 2), np.ones((3, 1)))
    assert missing(model, []) == 0
    assert missing(model, [(6.0, 2), (8.0, 3)]) == 0
    assert missing(model, [(6.0, 4), (8.0, 4)]) == 2
    before = diagonalised(np.diag((2 * np.pi * np.array([2.0, 5.01, 7.3])) ** 2), np.ones((3, 1)))
    assert unsettled(model, before, 8.0).tolist() == [2, 1]
    assert unsettled(model, before, 8.0, most=1).tolist() == [2]
    assert unsettled(model, before, 6.0).tolist() == [1]
    # a rigid-body mode whose frequency is round-off stands still
    rigid = [diagonalised(np.diag((2 * np.pi * np.array([zero, 5.0])) ** 2), np.ones((2, 1))) for zero in (1e-7, 3e-7)]
    assert not len(unsettled(*rigid, 8.0))


@pytest.mark.parametrize("law", [Law(eta=2e-3), Law(1.0, 1e-4)], ids=["undamped", "Rayleigh"])
def test_a_free_body_is_known_by_its_infinite_response(law):
    S = np.linspace(0.0, 5.0, 100)
    for ground, free in ((True, False), (False, True)):
        K = chain(30, ground=True)[0]
        if not ground:
            K[0, 0] -= 1e4
            K[-1, -1] -= 1e4
        assert is_free(diagonalised(K, unit(30, 3, 8)), law, S, PORTS, 1e-12) == free


def test_the_grid_has_the_resonances_that_a_given_damping_makes():
    """A dashpot between two close modes damps their sum and leaves a sharp resonance of their difference."""
    squares, c = (2 * np.pi * np.array([10.0, 10.02])) ** 2, 2.0
    model = diagonalised(np.diag(squares), np.eye(2), c * np.ones((2, 2)))
    sharp = min(model.inverse.poles[model.inverse.poles.imag > 0], key=lambda pole: abs(pole.real))
    width = abs(sharp.real) / (2 * np.pi)
    f = sharp.imag / (2 * np.pi)
    assert width < 1e-4 * f
    S = grid([model], Law(), (1.0, 100.0))
    assert (np.abs(S - f) <= 3.1 * width).sum() >= 7
