"""The compression reaches its goal with few columns, against dense responses."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from adaptive_models import chain, unit

import hpcred
from hpcred.parallel.decisions import decided_with
from hpcred.reduction.result.measure import MEASURES
from hpcred.reduction.search import outcome
from hpcred.reduction.search.outcome import TRIALS
from hpcred.reduction.small import compression, error_estimate
from hpcred.reduction.small.compression import compressed
from hpcred.reduction.small.error_estimate import Comparison, grid, measure_over
from hpcred.reduction.small.pseudo_modal import UNDAMPED, InputsOutputs, Proportional, columns, diagonalised

BAND = (0.0, 10.0)


def model_of(kind, damping):
    n = 60
    rng = np.random.default_rng(0)
    K = chain(n, rng=rng, spread=0.2)[0]
    L = unit(n, 3, 40, 55)
    D = None
    if "D" in kind:
        D = np.diag(rng.uniform(0, 3, n))
        if "unsymmetric" in kind:
            D[5, 9], D[9, 5] = 4.0, -4.0
    same = np.eye(3)
    other = np.eye(3)[:, :1] * 1e6, np.eye(3)[:, 1:] * 1e-6
    return diagonalised(K, L, D, damping, InputsOutputs(*(other if "outputs" in kind else (same, same))))


def whole(model, kind):
    return Comparison(model, model, np.eye(len(model)), measure_over(MEASURES[kind], BAND, model))


@pytest.mark.parametrize("goal, kind, measured", [
    (1e-2, "plain", "paper"), (1e-5, "plain", "directions"), (1e-5, "outputs", "paper"),
    (1e-2, "outputs", "directions"), (1e-2, "D", "directions"), (1e-2, "unsymmetric D, outputs", "paper"),
    *(pytest.param(*case, marks=pytest.mark.slow) for case in (
        (1e-2, "D", "paper"), (1e-5, "D", "directions"), (1e-5, "unsymmetric D, outputs", "directions"))),
])
def test_goal_is_reached(kind, goal, measured):
    damping = UNDAMPED if "D" in kind else Proportional(eta=2e-3)
    model = model_of(kind, damping)
    S = grid([model], BAND)
    pair = whole(model, measured)
    U = compressed(pair, S, goal)
    assert np.allclose(U.T @ U, np.eye(U.shape[1]), atol=1e-12)
    assert U.shape[1] < 45
    H, drive = model.responses(S)

    def error(columns):
        wrong = H - model.restricted(columns)[0].response(S)
        return pair.measure.eps(wrong, H, drive).max()

    assert error(U) <= goal + 1e-9
    # at least as good as the plain singular vectors
    h, g = (np.where(scale > 0, scale, scale.max(axis=0)) for scale in pair.measure.scales(H, drive))
    states = [model.solve(S, model.B) / g[:, None, :], model.solve(S, model.Ct, transposed=True) / h[:, None, :]]
    states = [state / np.linalg.norm(state) for state in states]
    plain = np.linalg.svd(columns(np.concatenate(states, axis=2)), full_matrices=False)[0]
    assert error(plain[:, : U.shape[1] - 1]) > goal or U.shape[1] == 1
    few = compressed(pair, S, goal, most=4)
    assert few.shape[1] == 4


@pytest.mark.parametrize("goal", [1e-1, 1e-3])
def test_states_of_inputs_and_of_outputs_take_different_parts(monkeypatch, goal):
    """The error is a product of what is left of the two, so that equal parts need more columns."""
    K = chain(60, rng=np.random.default_rng(0), spread=0.2)[0]
    outputs_apart = InputsOutputs(np.eye(4)[:, :2], np.eye(4)[:, 2:])
    model = diagonalised(K, unit(60, 3, 40, 55, 20), None, Proportional(eta=2e-2), outputs_apart)
    S, pair = grid([model], BAND, 50), whole(model, "directions")
    U = compressed(pair, S, goal)
    wrong = model.response(S) - model.restricted(U)[0].response(S)
    assert pair.measure.eps(wrong, *model.responses(S)).max() <= goal + 1e-9
    monkeypatch.setattr(compression, "BALANCES", (1.0,))
    assert U.shape[1] < compressed(pair, S, goal).shape[1]


def test_no_goal_keeps_everything_and_a_zero_response_harms_nothing():
    damping = Proportional(eta=2e-3)
    model = model_of("plain", damping)
    S = grid([model], BAND, 30)
    assert compressed(whole(model, "directions"), S, 0.0).shape[1] == 60
    # two bodies without a tie: nothing arrives
    K = np.kron(np.eye(2), chain(10)[0])
    silent = InputsOutputs(np.eye(2)[:, :1], np.eye(2)[:, 1:])
    apart = diagonalised(K, unit(20, 2, 13), None, damping, silent)
    S = grid([apart], BAND, 30)
    for measured in ("directions", "paper"):
        assert np.isfinite(compressed(whole(apart, measured), S, 1e-3)).all()


def test_the_uncompressed_model_is_kept_where_no_compression_reaches_the_goal(monkeypatch):
    """After TRIALS of them, each with more frequencies than the one before."""
    damping, tried = Proportional(eta=2e-3), []
    model = model_of("plain", damping)
    pair = whole(model, "directions")
    monkeypatch.setattr(outcome, "compressed", lambda _, S, *__: (tried.append(len(S)), np.eye(60)[:, :1])[1])
    judge = SimpleNamespace(settings=hpcred.Adaptive(tolerance=1e-2, band=BAND), noise=1e-12)
    found, _, curve, limited = outcome._reach(judge, pair, 1e-3, np.zeros((60, 0)), 0)
    assert found.embedding.shape == (60, 60) and curve.max() < 1e-9 and not limited
    assert len(tried) == TRIALS == 8 and tried[1] > tried[0]


@pytest.mark.mpi(ranks=(1, 2, 3))
@pytest.mark.parametrize("kind, measured", [
    ("plain", "directions"), ("outputs", "paper"), ("unsymmetric D, outputs", "directions")])  # fmt: skip
def test_any_number_of_ranks_gives_the_same_curves_and_columns(comm, kind, measured, monkeypatch):
    """Each rank computes errors and states at a share of the frequencies; as of one rank alone. Steps of a refinement,
    in single precision, would let round-off grow."""
    monkeypatch.setattr(compression.refinement, "is_for", lambda model: False)
    monkeypatch.setattr(error_estimate, "WORTH_SHARING", 0)
    monkeypatch.setattr(compression, "WORTH_SHARING", 0)
    model = model_of(kind, UNDAMPED if "D" in kind else Proportional(eta=2e-3))
    S, alone = grid([model], BAND, 50), whole(model, measured)

    def shared(team):
        pair = replace(alone, team=team)
        U = compressed(pair, S, 1e-3)
        return U.shape[1], pair.within(U).errors(S)

    count, found = decided_with(comm, shared)
    U = compressed(alone, S, 1e-3)
    expected = alone.within(U).errors(S)
    assert count == U.shape[1]
    assert np.allclose(found.total, expected.total, rtol=1e-3, atol=1e-9)
    assert np.allclose(found.h, expected.h, rtol=1e-9) and np.allclose(found.g, expected.g, rtol=1e-9)
    assert np.allclose(found.outputs, expected.outputs, rtol=1e-3, atol=1e-9) and found.noise.max() < 1e-9
    if measured == "directions":  # that of the paper is a norm of all responses
        assert (found.outputs.max(axis=1) == found.total).all()
