"""Small projected models against dense matrices: solves, responses, and the exact difference of nested models."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from hpcred.model.operator import Operator
from hpcred.reduction.result.measure import PAPER
from hpcred.reduction.small.pseudo_modal import (
    ROUGH,
    UNDAMPED,
    InputsOutputs,
    Proportional,
    PseudoModal,
    diagonalised,
    difference,
    nested,
    poles_of,
)

relative = PAPER.eps  # of differences and what they are of
F = np.linspace(0.0, 8.0, 23)
DAMPINGS = {"Rayleigh": Proportional(alpha=0.3, beta=1e-3), "loss factor": Proportional(eta=0.02),
        "all": Proportional(0.1, 1e-3, 0.01)}  # fmt: skip


def matrices(seed=0, m=12, l=3, damped=False, symmetric=True):
    """K, L, D of a mass-orthonormal basis."""
    rng = np.random.default_rng(seed)
    q = np.linalg.qr(rng.standard_normal((m, m)))[0]
    K = q * np.linspace(1.0, 60.0, m) ** 2 @ q.T
    X = rng.standard_normal((m, m))
    D = None if not damped else X @ X.T / m + (0.0 if symmetric else 0.5) * (X - X.T)
    return K, rng.standard_normal((m, l)), D


def skew(m):
    """The skew-symmetric part of circulatory forces."""
    X = np.random.default_rng(8).standard_normal((m, m))
    return X - X.T


def dense(K, D, damping, f):
    s = 2j * np.pi * f
    A = (1 + 1j * damping.eta + s * damping.beta) * K + (s * s + s * damping.alpha) * np.eye(len(K))
    return A if D is None else A + s * D


def dense_response(K, L, D, damping, io):
    Lb, Lc = io[:2]
    return np.array([(L @ Lc).T @ np.linalg.solve(dense(K, D, damping, f), L @ Lb) for f in F])


def io_of(kind):
    """B = L Lb and C^T = L Lc."""
    if kind == "other outputs":
        return InputsOutputs(np.eye(3)[:, :2], np.array([[0.0], [1.0], [-2.0]]))
    same = np.eye(3)
    return InputsOutputs(same, same)


@pytest.mark.parametrize("damping", DAMPINGS.values(), ids=DAMPINGS)
@pytest.mark.parametrize("circulatory", [0.0, 40.0])
@pytest.mark.parametrize("damped, symmetric", [(False, True), (True, True), (True, False)])
def test_states_and_responses_are_those_of_the_dense_matrices(damping, damped, symmetric, circulatory):
    K, L, D = matrices(damped=damped, symmetric=symmetric)
    K = K + circulatory * skew(len(K))
    model = diagonalised(K, L, D, damping, symmetric=not circulatory)
    assert np.allclose(model.vectors.T @ model.vectors, np.eye(12), atol=1e-13)
    for transposed in (False, True):
        states = model.vectors @ model.solve(F, model.L, transposed)
        for f, state in zip(F, states, strict=True):
            A = dense(K, D, damping, f)
            expected = np.linalg.solve(A.T if transposed else A, L)
            assert np.linalg.norm(state - expected) < 1e-11 * np.linalg.norm(expected)
    for kind in ("same", "other outputs"):
        expected = dense_response(K, L, D, damping, io_of(kind))
        for H in (replace(model, io=io_of(kind)).response(F), replace(model, io=io_of(kind)).quick_response(F)):
            assert relative(H - expected, H, None).max() < 1e-11


@pytest.mark.parametrize("damping", DAMPINGS.values(), ids=DAMPINGS)
@pytest.mark.parametrize("kind", ["same", "other outputs"])
@pytest.mark.parametrize("circulatory", [0.0, 40.0])
@pytest.mark.parametrize("damped, symmetric", [(False, True), (True, True), (True, False)])
def test_difference_of_nested_models_is_exact(damping, kind, damped, symmetric, circulatory):
    K, L, D = matrices(1, damped=damped, symmetric=symmetric)
    K = K + circulatory * skew(len(K))
    given = {"damping": damping, "io": io_of(kind), "symmetric": not circulatory}
    outer = diagonalised(K, L, D, **given)
    k = 7
    inner = diagonalised(K[:k, :k], L[:k], None if D is None else D[:k, :k], **given)
    E = difference(inner, outer, nested(inner, outer), F)
    part = dense_response(K[:k, :k], L[:k], None if D is None else D[:k, :k], damping, io_of(kind))
    H = dense_response(K, L, D, damping, io_of(kind))
    assert relative(E - (H - part), H, None).max() < 1e-11


@pytest.mark.parametrize("circulatory", [0.0, 40.0])
def test_a_subspace_has_the_response_of_its_dense_projection(circulatory):
    damping = DAMPINGS["all"]
    K, L, D = matrices(2, damped=True, symmetric=False)
    K = K + circulatory * skew(len(K))
    outer = diagonalised(K, L, D, damping, symmetric=not circulatory)
    U = np.linalg.qr(np.random.default_rng(3).standard_normal((12, 5)))[0]
    inner, embedding = outer.restricted(U)
    V = outer.vectors @ embedding
    assert np.allclose(V.T @ V, np.eye(5), atol=1e-13)
    N = 0.0 if inner.N is None else inner.N
    assert np.allclose(V.T @ K @ V, np.diag(inner.eigenvalues) + N, atol=1e-9) and bool(circulatory) == np.any(N)
    expected = dense_response(V.T @ K @ V, V.T @ L, V.T @ D @ V, damping, io_of("same"))
    assert relative(inner.response(F) - expected, expected, None).max() < 1e-11
    outer, inner = (replace(model, io=io_of("other outputs")) for model in (outer, inner))
    E = difference(inner, outer, embedding, F)
    H = [model.response(F) for model in (outer, inner)]
    assert relative(E - (H[0] - H[1]), H[0], None).max() < 1e-11


def test_difference_has_no_cancellation():
    """Two coordinates coupled by d: H_Q - H_V = (d / a)^2 / (b - d^2 / a) with diagonal entries a, b of A."""
    damping, d = Proportional(eta=0.01), 1e-7
    K, L = np.array([[400.0, d], [d, 900.0]]), np.array([[1.0], [0.0]])
    outer, inner = diagonalised(K, L, None, damping), diagonalised(K[:1, :1], L[:1], None, damping)
    E = difference(inner, outer, nested(inner, outer), F)[:, 0, 0]
    s = 2j * np.pi * F
    a, b, c = 400 * (1 + 0.01j) + s**2, 900 * (1 + 0.01j) + s**2, d * (1 + 0.01j)
    expected = (c / a) ** 2 / (b - c**2 / a)
    assert np.abs(expected * a).max() < 1e-17  # relative to H: far below round-off of a subtraction
    assert np.abs(E / expected - 1).max() < 1e-6


def test_poles_without_eigenvectors_are_solved_by_elimination():
    """Critical damping: two equal poles with one eigenvector."""
    K, L = np.diag([4.0, 9.0]), np.eye(2)
    D = 2 * np.sqrt(K)
    model = diagonalised(K, L, D)
    states = model.vectors @ model.solve(F, model.L)
    for f, state in zip(F, states, strict=True):
        assert np.allclose(state, np.linalg.inv(dense(K, D, UNDAMPED, f)), rtol=1e-10, atol=0)


@pytest.mark.parametrize("transposed", [False, True])
def test_coordinates_that_no_load_pushes_follow_right_sides_that_do(transposed):
    """As residuals do, though small ones: rough solves gave zeros there."""
    K, L, D = np.diag([400.0, 900.0, 1600.0]), np.array([[1.0], [0.5], [0.0]]), np.diag([0.3, 0.4, 0.2])
    D[0, 1], D[1, 0] = 0.1, 0.15
    damping, right = Proportional(0.1, 1e-3, 0.01), np.array([[1.0], [2.0], [1e-7]])
    model = diagonalised(K, L, D, damping)
    assert model.idle.tolist() == [False, False, True]
    states = model.vectors @ model.solve(F, model.vectors.T @ right, transposed, ROUGH)
    for f, state in zip(F, states, strict=True):
        A = dense(K, D, damping, f)
        assert np.allclose(state, np.linalg.solve(A.T if transposed else A, right), rtol=1e-10, atol=0)


def test_frequencies_come_in_parts_that_fit(monkeypatch):
    from hpcred.reduction.small import pseudo_modal

    K, L, D = matrices(4, damped=True)
    outer, inner = diagonalised(K, L, D), diagonalised(K[:5, :5], L[:5], D[:5, :5])
    arguments = inner, outer, nested(inner, outer), F
    whole = difference(*arguments), outer.response(F)
    monkeypatch.setattr(pseudo_modal, "NUMBERS_AT_A_TIME", 2000)
    assert len(outer.parts_of(F)) > 1
    parts = difference(*arguments), outer.response(F)
    for a, b in zip(whole, parts, strict=True):
        assert np.allclose(a, b, rtol=1e-9, atol=0)


def test_a_free_motion_beside_a_given_damping_is_infinite_at_0_hz_and_right_elsewhere():
    """A(0) is singular there, and elimination had ended the search with an error of NumPy."""
    rng = np.random.default_rng(0)
    eigenvalues, D = np.array([0.0, 1.0, 4.0]), rng.standard_normal((3, 3))
    same = InputsOutputs(*[np.eye(2)] * 2)
    model = PseudoModal(eigenvalues, rng.standard_normal((3, 2)), np.eye(3), same, operator=Operator.of(D=D))
    frequencies = np.array([0.0, 0.3])
    for poles in (None, poles_of(model)):
        states = replace(model, poles=poles).solve(frequencies, model.L)
        s = 2j * np.pi * 0.3
        assert np.isinf(states[0]).all()
        assert states[1] == pytest.approx(np.linalg.solve(s * s * np.eye(3) + s * D + np.diag(eigenvalues), model.L))


def test_responses_are_computed_once_at_each_frequency(monkeypatch):
    """A search asks for those of one model again and again, at grids that contain each other."""
    rng = np.random.default_rng(0)
    G = rng.standard_normal((6, 6))
    model = diagonalised(G @ G.T, rng.standard_normal((6, 2)), np.diag(np.arange(6.0)))
    asked, solve = [], PseudoModal.solve
    monkeypatch.setattr(PseudoModal, "solve", lambda self, f, *more: asked.extend(f) or solve(self, f, *more))
    first, more = np.array([0.1, 0.3, 0.2]), np.array([0.05, 0.2, 0.1, 0.7])
    for f in (first[:0], first, more, first):
        H, drive = model.responses(f)
        A = model.matrices(f)
        expected = model.Ct.T @ np.linalg.solve(A, np.broadcast_to(model.B.astype(complex), (len(f), *model.B.shape)))
        assert np.allclose(H, expected, rtol=1e-10) and np.allclose(drive, np.einsum("spp->sp", expected), rtol=1e-10)
    assert sorted(asked) == [0.05, 0.1, 0.2, 0.3, 0.7]
    sent = pickle.loads(pickle.dumps(model))  # without what it has computed
    assert model.memory and not sent.memory and not replace(model, tau=0.0).memory
    assert np.array_equal(sent.response(first), model.response(first))


@pytest.mark.parametrize("coupling, is_modal", [(0.0, True), (1e-7, False)])
def test_a_given_damping_of_the_modes_leaves_the_matrices_diagonal(coupling, is_modal):
    """Also of a double eigenvalue; a coupling of 1e-7 of the damping of two modes is none of round-off."""
    K, L, _ = matrices()
    values, q = np.linalg.eigh(K)
    values[4] = values[3]
    ratios = np.diag(2 * np.array([0.002, 0.01, 0.03] * 4) * np.sqrt(values))
    ratios[4, 4] = ratios[3, 3]
    ratios[0, 1] = ratios[1, 0] = coupling * ratios[0, 0]
    K, D = q * values @ q.T, q @ ratios @ q.T
    for damping in DAMPINGS.values():
        model = diagonalised(K, L, D, damping)
        assert model.is_diagonal == is_modal == (model.poles is None)
        exact = dense_response(K, L, D, damping, model.io)
        assert relative(model.response(F) - exact, exact, None).max() < 1e-11
        assert relative(model.quick_response(F) - exact, exact, None).max() < 1e-11
        states = model.solve(F, model.L)
        assert np.abs(model.multiply(F, states) - model.L).max() < 1e-10 * np.abs(model.L).max()
        inner, embedding = model.restricted(np.linalg.qr(np.random.default_rng(1).standard_normal((12, 5)))[0])
        exact_difference = exact - inner.response(F)
        found = difference(inner, model, embedding, F)
        assert np.abs(found - exact_difference).max() < 1e-11 * np.abs(exact).max()
