"""Columns of a compression are turned until fewer suffice: derivatives by differences, errors by dense solves."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_models import Case, chain, dashpots, estimated_and_true, fresh, unit, up_to

import hpcred
from hpcred.model.operator import Operator, Power, Term
from hpcred.model.outputs.rates import Rates
from hpcred.reduction.result.measure import MEASURES
from hpcred.reduction.small import refinement
from hpcred.reduction.small.compression import compressed
from hpcred.reduction.small.error_estimate import Comparison, measure_over
from hpcred.reduction.small.pseudo_modal import UNDAMPED, InputsOutputs, Proportional, diagonalised

BAND = (0.0, 12.0)
S = np.linspace(*BAND, 60)


def damped(kind="D", n=16):
    """A chain with dashpots that are strong, and not proportional to anything, beside itself."""
    K, D = chain(n)[0], dashpots(n, 2 * n, np.random.default_rng(0), (5.0, 60.0))
    if "unsymmetric" in kind:
        D[2, 5], D[5, 2] = 40.0, -40.0
    io = InputsOutputs(*[np.eye(3)] * 2)
    if "outputs" in kind:
        io = InputsOutputs(np.eye(3)[:, :2] * 1e6, np.eye(3)[:, 1:] * 1e-6)
    if "rates" in kind:  # an acceleration, a velocity, and a displacement with a velocity
        parts = np.zeros((3, 3, 2))
        parts[2, 0, 1] = parts[1, 1, 0] = parts[0, 2, 0] = 1.0
        parts[1, 2, 1] = 0.05
        io = InputsOutputs(io.inputs, io.outputs, Rates(parts))
    model = diagonalised(K, unit(n, 3, 12, 15), D, UNDAMPED, io)
    return Comparison(model, model, np.eye(n), measure_over(MEASURES["directions"], BAND, model))


def errors_of(pair, U):
    """Errors by plain subtraction of dense responses."""
    H, drive = pair.outer.responses(S)
    return pair.measure.eps(H - pair.outer.restricted(U)[0].response(S), H, drive)


@pytest.mark.parametrize("fixed", [0, 2])
@pytest.mark.parametrize("kind", ["D", "D, outputs", "unsymmetric D, outputs", "unsymmetric D, outputs, rates"])
def test_derivatives_are_differences(kind, fixed):
    pair, rng = damped(kind), np.random.default_rng(1)
    wide = np.linalg.qr(rng.standard_normal((16, 12)))[0]
    errors = refinement.Errors(pair, S, wide, fixed)
    columns, _ = np.linalg.qr(rng.standard_normal((12, 12)))
    U, N = columns[:, :6], columns[:, 6:]
    at = errors.at(U)
    assert np.isclose(at.largest, errors_of(pair, wide @ U).max(), rtol=1e-9)
    d, step = rng.standard_normal((6, 6 - fixed)), 1e-5
    change = np.zeros_like(U)
    change[:, fixed:] = N @ d
    beside = [errors.at(np.linalg.qr(U + sign * step * change)[0]).errors for sign in (1, -1)]
    differences = (beside[0] - beside[1]) / (2 * step)
    for of in (np.abs(at.errors) >= 0, np.abs(at.errors) > np.median(np.abs(at.errors))):
        found = errors.derivative(at, N, of) @ d.ravel()
        assert np.abs(found - differences[of]).max() < 1e-7 * np.abs(differences).max()


def test_the_terms_of_a_model_add_up_to_its_matrices():
    """With massless coordinates, a loss factor, a D, a skew part of K and an added term."""
    rng = np.random.default_rng(4)
    K, D, N, Kv = (rng.standard_normal((8, 8)) for _ in range(4))
    added = Operator.of(added=[Term(Kv @ Kv.T, Power(3), "Kv")]).added
    masses = np.diag([*np.ones(7), 0.0])
    damping = Proportional(0.2, 1e-3, 0.05)
    model = diagonalised(K @ K.T + N - N.T, np.eye(8)[:, :2], D @ D.T, damping, None, added, False, masses, 0.1)
    terms = model.terms()
    assert np.allclose(terms.summed(model.factors(S)), model.matrices(S), rtol=1e-12, atol=1e-9)
    wide = np.linalg.qr(rng.standard_normal((8, 5)))[0]
    exact = wide.T @ model.matrices(S) @ wide
    assert np.allclose(terms.projected(wide).summed(model.factors(S)), exact, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("fixed", [0, 2])
@pytest.mark.parametrize("goal", [1e-2, 1e-4])
@pytest.mark.parametrize("kind", ["D", "unsymmetric D, outputs"])
def test_fewer_columns_reach_the_goal(monkeypatch, kind, goal, fixed):
    pair = damped(kind)
    fixed = np.linalg.qr(np.random.default_rng(2).standard_normal((16, fixed)))[0]
    U = compressed(pair, S, goal, fixed)
    assert np.allclose(U.T @ U, np.eye(U.shape[1]), atol=1e-12)
    assert np.allclose(U @ (U.T @ fixed), fixed, atol=1e-12)
    assert errors_of(pair, U).max() <= goal * (1 + 1e-6)
    monkeypatch.setattr(refinement, "is_for", lambda model: False)
    assert U.shape[1] < compressed(pair, S, goal, fixed).shape[1]


def test_nothing_is_refined_where_it_cannot_pay(monkeypatch):
    """Proportional damping, a Caughey series beside D, or more work than a step may have."""
    model = damped().outer
    proportional = diagonalised(chain(16)[0], model.L, None, Proportional(eta=0.1))
    assert not refinement.is_for(proportional)
    series = diagonalised(chain(16)[0], model.L, model.D, Proportional(0.1, 1e-5, 0.0, (1e-9,)))
    assert refinement.is_for(model) and not refinement.is_for(series)
    fewer = compressed(damped(), S, 1e-2).shape[1]
    monkeypatch.setattr(refinement, "WORK", 0)
    assert fewer < compressed(damped(), S, 1e-2).shape[1]


def test_a_singular_model_is_left_as_it_is():
    """A free chain has no response at 0 Hz, where the first of the frequencies is."""
    pair = damped()
    eigenvalues, D = pair.outer.eigenvalues.copy(), pair.outer.D.copy()
    eigenvalues[0] = D[0] = D[:, 0] = 0.0
    free = replace(pair.outer, eigenvalues=eigenvalues, operator=Operator.of(D=D), poles=None)
    beside = replace(pair, inner=free, outer=free)
    with np.errstate(invalid="ignore"):
        assert not refinement.Errors(beside, S, np.eye(16)).are_finite
    assert refinement.Errors(beside, S[1:], np.eye(16)).are_finite


@pytest.mark.mpi
@pytest.mark.costly
def test_a_strongly_damped_model_is_smaller_and_within_the_tolerance(comm, monkeypatch):
    K, M = chain(30)
    D = dashpots(30, 40, np.random.default_rng(3), (5.0, 60.0))
    case = Case("dashpots", K, M, unit(30, 4, 22), up_to(K, M, 12), D=D, damping=hpcred.GivenDamping())
    with case.model(comm) as model:
        rom = hpcred.reduce(model, tolerance=1e-3, band=case.band)
        monkeypatch.setattr(refinement, "is_for", lambda model: False)
        plain = hpcred.reduce(model, tolerance=1e-3, band=case.band)
    assert rom.record.accuracy.reached and rom.size < plain.size
    assert not len(rom.unstable_poles())
    estimated, true = estimated_and_true(case, rom, np.append(fresh(case, rom), rom.record.accuracy.worst))
    assert true.max() <= 1e-3 and 0.5 * true[-1] <= estimated[-1] <= 2 * true[-1]
    assert len(set(comm.allgather(rom.size))) == 1
