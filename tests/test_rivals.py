"""The dense numerics of the rivals that benchmarks compare with, each by a second method."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from launch import mpi_environment

import hpcred

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks/peers"))
import dense_methods as methods
from least_size import searched


def spring_chain(n=12, massless=(), damper=0.02):
    """Masses in a row, held at one end, with a force and a measured place, and dampers that are not proportional."""
    K = sp.diags([np.full(n - 1, -1.0), np.full(n, 2.0), np.full(n - 1, -1.0)], (-1, 0, 1)).tocsc() * 40.0
    mass = 1.0 + 0.1 * np.arange(n)
    mass[list(massless)] = 0.0
    D = damper * K + sp.diags(np.where(np.arange(n) == 4, 0.3, 0.0))
    B, C = np.zeros((n, 2)), np.zeros((1, n))
    B[n - 1, 0] = B[3, 1] = C[0, 6] = 1.0
    return methods.Model(sp.diags(mass).tocsc(), D.tocsc(), K, B, C, np.zeros((1, n)))


@pytest.fixture(scope="module")
def model():
    return methods.prepared(spring_chain(), 12)


F = np.linspace(0.0, 2.5, 80)


def test_prepared_model_has_the_responses_of_sparse_matrices():
    for chain in (spring_chain(), spring_chain(massless=(2, 7))):
        s = 2j * np.pi * F
        exact = [chain.C @ np.linalg.solve((x * x * chain.M + x * chain.D + chain.K).toarray(), chain.B) for x in s]
        assert np.abs(methods.prepared(chain, 12).response(F) - exact).max() < 1e-12


def test_gramians_solve_lyapunov_equations(model):
    A, B, C = methods.first_order(model)
    R, L = methods.gramians(A, B, C)
    for root, a, b in ((R, A, B), (L, A.T, C.T)):
        exact = scipy.linalg.solve_continuous_lyapunov(a, -b @ b.T)
        assert np.abs(root @ root.T - exact).max() < 1e-10 * np.abs(exact).max()


def test_gramians_of_a_band_are_integrals_over_it():
    A, B, C = methods.first_order(methods.prepared(spring_chain(damper=0.2), 12))
    R, L = methods.gramians(A, B, C, (0.0, 0.4))
    nodes, weights = np.polynomial.legendre.leggauss(400)
    omega = 2 * np.pi * 0.4 * nodes
    for root, a, b in ((R, A, B), (L, A.T, C.T)):
        x = np.linalg.solve(1j * omega[:, None, None] * np.eye(len(a)) - a, b[None])
        exact = (0.4 * np.einsum("s,sik,sjk->ij", weights, x, x.conj())).real
        assert np.abs(root @ root.T - exact).max() < 1e-9 * np.abs(exact).max()


def test_hankel_values_and_their_bound(model):
    A, B, C = methods.first_order(model)
    reduced, values = methods.balanced(A, B, C, methods.gramians(A, B, C))
    P, Q = (scipy.linalg.solve_continuous_lyapunov(a, -b @ b.T) for a, b in ((A, B), (A.T, C.T)))
    product = np.sort(np.sqrt(np.abs(np.linalg.eigvals(P @ Q))))[::-1]
    assert np.abs(values[:10] - product[:10]).max() < 1e-8 * values[0]
    size = 8
    error = np.linalg.norm(reduced(size).response(F) - model.response(F), 2, axis=(1, 2)).max()
    assert 0.01 * values[size] < error < 2 * values[size:].sum()  # the bound of Enns and Glover


@pytest.mark.parametrize("kind", ["position", "velocity", "position-velocity", "free velocity"])
@pytest.mark.parametrize("band", [None, (0.0, 1.0)])
def test_second_order_balanced_truncation(model, kind, band):
    roots = methods.gramians(*methods.first_order(model), band)
    reduced, values = methods.balanced_second_order(model, roots, kind)
    H = model.response(F)
    errors = [np.abs(reduced(size).response(F) - H).max() / np.abs(H).max() for size in (3, 6, 12)]
    assert errors[2] < 1e-8  # all of the model
    assert errors[1] < 0.3 and errors[1] < errors[0]
    assert (np.diff(values) <= 0).all()


def test_augmented_modes_are_modes_with_static_corrections(model):
    augmented = methods.truncation_augmentation(model)(8)
    inverse = np.linalg.inv(model.K)
    loads = np.hstack([model.B, model.C.T])
    V = np.linalg.qr(np.hstack([np.eye(12)[:, :5], inverse @ loads]))[0]
    assert np.abs(augmented.response(F) - model.projected(V).response(F)).max() < 1e-10
    assert methods.truncation_augmentation(model)(2) is None  # fewer than the loads


def test_mode_acceleration_is_exact_at_rest(model):
    reduced = methods.modes_with_residual(model)(4)
    H, found = model.response(F), reduced.response(F)
    assert np.abs(found[0] - H[0]).max() < 1e-13 * np.abs(H[0]).max()
    plain = model.projected(np.eye(12)[:, :4]).response(F)
    assert np.abs(found - H)[:5].max() < 0.1 * np.abs(plain - H)[:5].max()


@pytest.mark.mpi(ranks=(1,))
def test_craig_bampton_is_that_of_hpcred(comm):
    with hpcred.solid((4, 2, 2), inputs=3) as solid:
        M, K = (sp.csr_matrix(mat.getValuesCSR()[::-1]) for mat in (solid.M, solid.K))
        B = solid.B.getDenseArray().real.copy()
        full = methods.Model(M.tocsc(), 1e-6 * K.tocsc(), K.tocsc(), B, B.T, 0 * B.T)
        reduced, held = methods.craig_bampton(full, 30)
        # with hpcred's modes of the same fixed interfaces
        inside = np.setdiff1d(np.arange(len(B)), np.flatnonzero(B.any(axis=1)))
        model = hpcred.SecondOrderModel(M[inside][:, inside], None, K[inside][:, inside], np.eye(len(inside))[:, :1])
        with hpcred.reduce(model, hpcred.Modes(count=5)) as modes:
            fixed = modes.frequencies
    found = reduced(held + 5)
    assert np.abs(np.sqrt(np.diag(found.K)[held:] / np.diag(found.M)[held:]) / 2 / np.pi / fixed - 1).max() < 1e-8
    static = B.T @ np.linalg.solve(K.toarray(), B)
    assert np.abs(found.response(np.zeros(1)) - static).max() < 1e-10 * np.abs(static).max()


def test_least_size_is_found_by_bisection():
    class Given:
        sizes, frequencies = [7], F

        def error(self, response):
            return response

    class Small:
        def __init__(self, size):
            self.size = size

        def response(self, frequencies):
            return 10.0 ** -(self.size / 5)

        def unstable(self):
            return 0

    runs = searched(Given(), "rule", lambda size: Small(size) if size != 8 else None, 60, 10)
    assert min(run["size"] for run in runs if run["eps"] <= 1.01e-2) == 10
    assert min(run["size"] for run in runs if run["eps"] <= 1.01e-4) == 20
    assert all(run["size"] != 8 for run in runs)


@pytest.mark.slow
def test_methods_with_sparse_solves_beside_each_other(tmp_path):
    """At a small plate: hpcred is within its tolerances, and modes with corrections come near with more coordinates."""
    script = Path(__file__).parents[1] / "benchmarks/rivals_large.py"
    small = ("--cells", "24", "8", "1", "--top", "2000", "--modes", "30")
    subprocess.run([sys.executable, script, *small], cwd=tmp_path, check=True, env=mpi_environment())
    rows = {row["method"]: row for row in json.loads((tmp_path / "rivals_large.json").read_text())["rows"]}
    loose, close = (int(rows["hpcred"][f"size for {eps:g}"]) for eps in (1e-2, 1e-4))
    assert loose <= close == rows["hpcred"]["largest tried"]
    assert rows["hpcred"][f"error with {loose}"] <= 1e-2 and rows["hpcred"][f"error with {close}"] <= 1e-4
    assert set(rows) == {"hpcred", "rational Krylov", "MTA", "mode acceleration", "Craig-Bampton", "IRKA, turns: 1"}
    assert close <= int(rows["MTA"]["size for 0.0001"])
