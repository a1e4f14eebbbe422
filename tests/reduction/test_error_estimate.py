"""The estimate against dense truth, its grid, the next point, and the count of modes."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_models import chain, membrane, unit

from hpcred.linalg.known import ModeCount
from hpcred.reduction.result.measure import MEASURES
from hpcred.reduction.small.error_estimate import (
    FINE,
    PLACES,
    Comparison,
    beside,
    grid,
    is_free,
    largest,
    largest_error,
    maxima,
    measure_over,
    missing,
    next_point,
    off_poles,
    resolved,
    unsettled,
)
from hpcred.reduction.small.pseudo_modal import Proportional, diagonalised, nested


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


def comparison(inner, outer, band, measure="directions", embedding=None):
    embedding = nested(inner, outer) if embedding is None else embedding
    return Comparison(inner, outer, embedding, measure_over(MEASURES[measure], band, outer))


def projected(K, B, V, damping):
    return diagonalised(V.T @ K @ V, V.T @ B, None, damping)


@pytest.mark.parametrize("measure", ["directions", "paper"])
@pytest.mark.parametrize("make, high, blocks", [(chain, 8.0, 13), (chain, 8.0, 15), (membrane, 20.0, 10),
                                                (membrane, 20.0, 12)])  # fmt: skip
def test_one_more_block_tells_the_error(make, high, blocks, measure):
    K, damping, band = make(90 if make is chain else 9)[0], Proportional(eta=2e-3), (0.0, high)
    B = unit(len(K), 2, len(K) // 2)
    V = krylov(K, B, 0.7 * band[1], blocks + 1)
    inner, outer = projected(K, B, V[:, :-2], damping), projected(K, B, V, damping)
    S = grid([outer], band, 60)
    pair = comparison(inner, outer, band, measure)
    said, noise = pair.curve(S), pair.noise(S)
    H, drive = diagonalised(K, B, None, damping).responses(S)
    true = pair.measure.eps(H - inner.response(S), H, drive)
    assert said.max() < 0.1 and 0.8 < said.max() / true.max() < 1.25
    clear = true > 1e-9
    assert clear.sum() > 10
    assert (np.abs(np.log(said / true))[clear] < np.log(1.25)).all()
    assert noise.max() < 1e-8


def poles_at(f, damping):
    """s / (2 pi i) (k,) of undamped frequencies f (k,) in Hz with a loss factor."""
    return f * np.sqrt(1 + 1j * damping.eta)


@pytest.mark.parametrize("eta", [0.02, 1e-5, 1e-8])
@pytest.mark.parametrize("step", [1.0, FINE])
def test_frequencies_of_a_grid_are_nearer_to_each_other_than_to_any_pole(eta, step):
    """So that nothing is hidden between them, however sharp resonances are and how near to each other."""
    damping, band = Proportional(eta=eta), (1.0, 10.0)
    f = np.array([0.2, 1.0001, 3.0, 3.0 * (1 + 3e-6), 6.0, 6.05, 30.0])
    model = diagonalised(np.diag((2 * np.pi * f) ** 2), np.ones((len(f), 1)), None, damping)
    S = grid([model], band, 50, step)
    assert (np.diff(S) > 0).all() and S[0] == 1.0 and S[-1] == 10.0
    assert np.isin(np.linspace(1.0, 10.0, 50), S).all()
    middles = (S[1:] + S[:-1]) / 2
    nearest = np.abs(middles[:, None] - poles_at(f, damping)).min(axis=1)
    assert (np.diff(S) <= 2.2 * step * nearest).all()
    for pole in f[(f > 1.0) & (f < 10.0)]:
        assert np.abs(S - pole).min() < 0.3 * eta * pole
    assert len(S) < 50 + 5 * (4 + 2 * np.arcsinh(5.0 / (0.5 * eta)) / step)


def test_a_grid_has_the_poles_of_all_models_and_may_have_nothing_else():
    damping, band = Proportional(eta=0.02), (1.0, 10.0)
    one, other = (diagonalised(np.array([[(2 * np.pi * f) ** 2]]), np.ones((1, 1)), None, damping) for f in (3.0, 8.0))
    assert len(grid([one, other], band, 50, None)) == 52
    for f in (3.0, 8.0):
        assert (np.abs(grid([one, other], band, 50) / f - 1) < 0.01).sum() >= 2


def test_distances_are_relative_to_the_frequency():
    """A resonance at 1e-11 of the band's end was dropped."""
    f = np.array([1e-9, 2e-9, 80.0])
    S = grid([diagonalised(np.diag((2 * np.pi * f) ** 2), np.ones((3, 1)), None, Proportional(eta=1e-3))], (0.0, 100.0))
    assert np.abs(S[:, None] / f - 1).min(axis=0).max() < 1e-3


def test_beside_and_maxima():
    curve = np.array([1.0, 5.0, 2.0, 1.0, 9.0])
    assert np.flatnonzero(maxima(curve)).tolist() == [1, 4]
    assert np.allclose(beside(np.arange(5.0), np.array([4]), 2), [3.5])
    assert np.allclose(beside(np.arange(5.0), np.array([1, 4]), 2), [0.5, 1.5, 3.5])


@pytest.mark.parametrize("measure", ["directions", "paper"])
@pytest.mark.parametrize("row, eta", [(5, 1e-3), (31, 1e-3), (5, 1e-5)])
def test_the_largest_error_lies_nowhere_between_and_the_curve_can_be_interpolated(row, eta, measure):
    """Between two resonances the response has a zero, where scales of the measure dip in a narrow place."""
    K, damping, band = chain(60)[0], Proportional(eta=eta), (0.0, 6.0)
    B = unit(60, row)
    V = krylov(K, B, 4.0, 12)
    inner, outer = projected(K, B, V, damping), projected(K, B, krylov(K, B, 4.0, 30), damping)
    embedding = np.linalg.lstsq(krylov(K, B, 4.0, 30) @ outer.vectors, V @ inner.vectors, rcond=None)[0]
    pair = comparison(inner, outer, band, measure, embedding)
    S, curve = largest(pair, grid([outer, inner], band, 400, FINE))
    near = [f * (1 + eta * np.linspace(-3, 3, 601)) for f in (*outer.frequencies, *inner.frequencies) if f < 6.0]
    dense = np.unique(np.concatenate([np.linspace(*band, 40001), *near]))
    dense = dense[dense <= band[1]]
    true = pair.curve(dense)
    if measure == "directions":
        assert true.max() <= 1.02 * curve.max()
    S, curve = resolved(pair, S, curve, 1e-12)
    assert (np.diff(S) > 0).all()
    said = np.exp(np.interp(dense, S, np.log(np.maximum(curve, 1e-300))))
    clear = true > 1e-11
    assert (np.abs(np.log(said / true))[clear] < np.log(2)).mean() > 0.99


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
    for seed in range(5):  # round-off does not say where
        noise = 1e-17 * np.random.default_rng(seed).random(len(S))
        assert next_point(S, noise, [10.0, 4.0], model, (0.0, 10.0)) == pytest.approx(7.0, rel=3e-3)
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
    before = diagonalised(np.diag((2 * np.pi * np.array([2.0, 5.01, 7.3])) ** 2), np.ones((3, 1)))

    def lack(*counts, low=0.0):
        found = [ModeCount(modes=modes, below=f) for f, modes in counts]
        return missing(model, found, (low, 8.0), lambda: before)

    assert lack() == 0
    assert lack((6.0, 2), (8.0, 3)) == 0
    assert lack((6.0, 4), (8.0, 4)) == 2
    assert lack((6.995, 3)) == 1 and lack((7.005, 3)) == 0  # below means below
    assert lack((8.0, 3), (9.0, 40)) == 0  # beyond the band
    # those below a band do not count, and of the model only what was there before
    assert lack((1.0, 30), (8.0, 33), low=1.0) == 2
    assert lack((1.0, 30), (8.0, 33)) == 30 and lack((6.5, 30), (8.0, 30), low=6.5) == 0
    assert unsettled(model, before, 8.0).tolist() == [2, 1]
    assert unsettled(model, before, 8.0, most=1).tolist() == [2]
    assert unsettled(model, before, 6.0).tolist() == [1]
    # a rigid-body mode whose frequency is round-off stands still
    rigid = [diagonalised(np.diag((2 * np.pi * np.array([zero, 5.0])) ** 2), np.ones((2, 1))) for zero in (1e-7, 3e-7)]
    assert not len(unsettled(*rigid, 8.0))


@pytest.mark.parametrize("damping", [Proportional(eta=2e-3), Proportional(1.0, 1e-4)], ids=["undamped", "Rayleigh"])
def test_a_free_body_is_known_by_its_infinite_response(damping):
    S = np.linspace(0.0, 5.0, 100)
    for ground, free in ((True, False), (False, True)):
        K = chain(30, ground=True)[0]
        if not ground:
            K[0, 0] -= 1e4
            K[-1, -1] -= 1e4
        assert is_free(diagonalised(K, unit(30, 3, 8), None, damping), S, 1e-12) == free


def test_the_grid_has_the_resonances_that_a_given_damping_makes():
    """A dashpot between two close modes damps their sum and leaves a sharp resonance of their difference."""
    eigenvalues, c = (2 * np.pi * np.array([10.0, 10.02])) ** 2, 2.0
    model = diagonalised(np.diag(eigenvalues), np.eye(2), c * np.ones((2, 2)))
    sharp = min(model.poles.values[model.poles.values.imag > 0], key=lambda pole: abs(pole.real))
    width = abs(sharp.real) / (2 * np.pi)
    f = sharp.imag / (2 * np.pi)
    assert width < 1e-4 * f
    S = grid([model], (1.0, 100.0))
    assert (np.abs(S - f) <= 3.1 * width).sum() >= 3


def test_a_grid_ends_on_a_curve_of_round_off():
    """Every second point of such a curve is a maximum, and each round would have three times as many points."""
    rng = np.random.default_rng(3)

    class Noise:
        def curve_and_dips(self, frequencies):
            return rng.uniform(1.0, 2.0, len(frequencies)), np.zeros(len(frequencies))

    S, curve = largest(Noise(), np.linspace(0.0, 1.0, 2000))
    assert 2000 < len(S) == len(curve) <= 2000 + 4 * 6 * PLACES


@pytest.mark.parametrize("columns", [6, 11, 12])
@pytest.mark.parametrize("wrong", [0.0, 1e-6, np.nan])
def test_the_largest_error_is_that_of_exact_differences(columns, wrong):
    """Also where plain subtraction has other digits: of poles that are wrong, and of a complete model."""
    random, band = np.random.default_rng(3), (0.0, 8.0)
    X, B = random.standard_normal((12, 12)), random.standard_normal((12, 2))
    outer = diagonalised(np.diag(np.linspace(1.0, 60.0, 12) ** 2), B, X @ X.T / 12)
    q = np.linalg.qr(np.hstack([B, np.eye(12)[:, :10] + 0.1 * X[:, :10]]))[0]
    inner, embedding = outer.restricted(q[:, :columns])
    outer = replace(outer, poles=outer.poles._replace(right=outer.poles.right * (1 + wrong)))
    pair = comparison(inner, outer, band, embedding=embedding, measure="paper")
    S = grid([outer], band)
    curve = pair.curve(S)
    for look in (lambda pair: (S, pair.curve(S)), lambda pair: largest(pair, S)):
        error, frequency = largest_error(pair, look, S[::8])
        at, exact = look(pair)
        assert np.isclose(error, exact.max(), rtol=1e-2) and np.isclose(pair.curve(np.array([frequency]))[0], error)
    assert error >= 0.99 * curve.max() and (columns == 12) == (error < 1e-15)


def test_poles_are_found_once():
    model = diagonalised(np.diag(np.linspace(1.0, 60.0, 5) ** 2), np.ones((5, 1)), np.diag(np.ones(4), 1) + np.eye(5))
    first = grid([model], (0.0, 8.0))
    known = model.memory["upper poles"]
    assert (grid([model], (0.0, 8.0)) == first).all() and model.memory["upper poles"] is known
    assert "upper poles" not in replace(model, damping=Proportional(alpha=3.0)).memory
