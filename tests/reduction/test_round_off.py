"""Round-off of K, which is common to all models made from one projection: what is said of it against an exact value."""

import time
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg

import hpcred
from hpcred import SecondOrderModel
from hpcred.analysis.error_check import as_measured
from hpcred.linalg.blocks import random_block
from hpcred.linalg.solvers.base import SingularMatrix
from hpcred.model.frames import apply_frame
from hpcred.parallel.failures import Owned
from hpcred.parallel.petsc import is_complex
from hpcred.parallel.progress import Progress
from hpcred.reduction import one_sided
from hpcred.reduction import tolerance_reductor as reductor
from hpcred.reduction.run import run
from hpcred.reduction.run.projection import project
from hpcred.reduction.run.run import Run
from hpcred.reduction.search import outcome, projections
from hpcred.reduction.search.point_solver import PointSolver
from hpcred.reduction.search.projections import Projections
from hpcred.reduction.search.search import Search
from hpcred.reduction.small.pseudo_modal import Proportional

COUNT, STIFF = 24, 2.0**36  # masses of 1 kg, and the springs between them in N/m; the first is held by 1 N/m
OMEGA = 1 / np.sqrt(COUNT)  # of all masses as one
BAND = (0.0, 3 * OMEGA / (2 * np.pi))


@pytest.fixture(autouse=True)
def counts_modes():
    if is_complex():
        pytest.skip("a second proof, in place of a count of modes, is at no regular point: K has no digits left there")


def nearly_free(comm):
    """All numbers are exact in double precision."""
    K = STIFF * (2 * np.eye(COUNT) - np.eye(COUNT, k=1) - np.eye(COUNT, k=-1))
    K[0, 0], K[-1, -1] = STIFF + 1, STIFF
    return SecondOrderModel.from_scipy(K, np.eye(COUNT), comm=comm, inputs=np.eye(COUNT)[:, [-1]])


def exact(frequencies, eta):
    """But for the strain of the springs, 1e-10 of it: the masses move as one."""
    return 1 / ((1 + 1j * eta) - COUNT * (2 * np.pi * frequencies) ** 2)


def error_of(values, frequencies, eta):
    H = exact(frequencies, eta)
    return np.abs(values.ravel() / H - 1)


@pytest.fixture
def plain_products(monkeypatch):
    """Project K as any matrix, so that soft motions have the round-off of stiff parts."""
    for module in (projections, one_sided):
        monkeypatch.setattr(module, "project_stiffness", lambda K, columns, _: project(K, columns))


@pytest.mark.parametrize("tolerance", [1e-6, 1e-1])
def test_soft_motions_have_no_round_off_of_stiff_parts(tolerance, comm):
    with nearly_free(comm) as model, hpcred.reduce(model, tolerance=tolerance, band=BAND) as rom:
        accuracy = rom.record.accuracy
        f = np.array(accuracy.frequencies)
        error = error_of(hpcred.frequency_response(as_measured(rom, accuracy), f), f, accuracy.loss_factor).max()
    assert accuracy.reached and accuracy.noise < 1e-8
    assert error < accuracy.largest + accuracy.noise + 1e-7  # which the strain of the springs makes


def slosh(seed):
    """A stiff row of masses on soft springs, with slosh masses at it; K (n, n), the masses (n,) and B (n, 2)."""
    random, masses, slosh = np.random.default_rng(seed), 10, 3
    n = masses + slosh
    K, m = np.zeros((n, n)), np.r_[random.uniform(50, 200, masses), random.uniform(5, 20, slosh)]
    springs = [(i, i + 1, 1e8 * random.uniform(0.5, 2)) for i in range(masses - 1)]
    springs += [(masses + t, int(random.integers(masses)), m[masses + t] * random.uniform(1e-3, 0.1))
                for t in range(slosh)]  # fmt: skip
    for i, j, stiffness in springs:
        K[np.ix_((i, j), (i, j))] += stiffness * np.array([[1, -1], [-1, 1]])
    K[0, 0] += random.uniform(0.5, 2)
    return K, m, np.eye(n)[:, [0, 5]]


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("band", [(0.0, 0.1), (1e-3, 150.0)])
def test_soft_modes_beside_stiff_ones_are_reached(seed, band, comm):
    """Against modes of the exact K, by solves in long double; their round-off was more than the tolerance."""
    K, m, B = slosh(seed)
    with (
        SecondOrderModel.from_scipy(K, np.diag(m), inputs=B, comm=comm) as model,
        hpcred.reduce(model, tolerance=1e-5, band=band) as rom,
    ):
        accuracy = rom.record.accuracy
        f = np.array(accuracy.frequencies)[:: max(1, len(accuracy.frequencies) // 40)]
        f = np.unique(np.r_[f, rom.frequencies[rom.frequencies < band[1]]])
        found = as_measured(rom, accuracy).frequency_response(f)
    H = np.array([B.T @ solved((1 + 1j * accuracy.loss_factor) * K.astype(np.clongdouble)
                               - np.diag(m * (2 * np.pi * np.longdouble(x)) ** 2), B) for x in f])  # fmt: skip
    true = accuracy.measure.eps(H - found, H, np.einsum("sii->si", H)).max()
    assert accuracy.reached and accuracy.noise < 1e-6 and true <= accuracy.largest + 1e-6


def solved(A, B):
    """A^-1 B by elimination in the precision of A, which LAPACK does not have."""
    A, X = A.copy(), B.astype(A.dtype)
    for k in range(len(A)):
        rows = k + np.argmax(np.abs(A[k:, k]))
        A[[k, rows]], X[[k, rows]] = A[[rows, k]], X[[rows, k]]
        factors = A[k + 1 :, k] / A[k, k]
        A[k + 1 :] -= np.outer(factors, A[k])
        X[k + 1 :] -= np.outer(factors, X[k])
    for k in reversed(range(len(A))):
        X[k] = (X[k] - A[k, k + 1 :] @ X[k + 1 :]) / A[k, k]
    return X


@pytest.mark.parametrize("tolerance", [1e-6, 1e-1])
def test_round_off_of_stiff_parts_counts(tolerance, comm, plain_products):
    with nearly_free(comm) as model, hpcred.reduce(model, tolerance=tolerance, band=BAND) as rom:
        accuracy = rom.record.accuracy
        f = np.array(accuracy.frequencies)
        error = error_of(hpcred.frequency_response(as_measured(rom, accuracy), f), f, accuracy.loss_factor).max()
    assert 1e-4 < error < 3 * (accuracy.largest + accuracy.noise)
    assert accuracy.reached == (tolerance > 1e-2)
    assert accuracy.reached or accuracy.stopped == "limited by round-off"


@pytest.mark.parametrize("points", [(BAND[1], BAND[1] / 3), (BAND[1] / 3,)])
def test_a_point_that_round_off_lets_nobody_factor_ends_a_search_that_has_a_model(comm, monkeypatch, points):
    """As a second proof without a count of modes may be: all was lost there."""
    known = PointSolver._pivots

    def pivots(self):
        if self.factored > -((np.pi * BAND[1]) ** 2):
            raise SingularMatrix
        return known(self)

    monkeypatch.setattr(PointSolver, "_pivots", pivots)
    monkeypatch.setattr(Search, "_may_prove_nearby", lambda self: False)
    asked = hpcred.Adaptive(tolerance=1e-1, band=BAND, points=points)
    with nearly_free(comm) as model:
        if len(points) == 1:
            with pytest.raises(hpcred.ComputationError, match="or the body is nearly free"):
                hpcred.reduce(model, adaptive=asked)
            return
        with hpcred.reduce(model, adaptive=asked) as rom:
            accuracy = rom.record.accuracy
    assert not accuracy.reached and accuracy.stopped.startswith("since no point near ")
    assert accuracy.largest + accuracy.noise < 1e-2


def test_solutions_that_are_lost_to_round_off_are_not_blamed_on_the_mass(comm):
    asked = hpcred.Adaptive(tolerance=1e-1, band=BAND, points=(BAND[1] / 3,))
    with nearly_free(comm) as model, pytest.raises((hpcred.InputError, hpcred.ComputationError), match="nearly free"):
        hpcred.reduce(model, adaptive=asked)


def test_round_off_of_a_full_response_counts(comm, plain_products):
    with nearly_free(comm) as model:
        f = OMEGA / (2 * np.pi) * np.linspace(0.99, 1.01, 101)
        found = hpcred.full_response(model, f, damping=hpcred.Structural(2e-3), tolerance=1e-6, band=BAND)
    error = error_of(found.response, f, 2e-3)
    assert 1e-4 < error.max() < 3 * found.eps.max()
    assert not found.reached and found.accuracy.stopped == "limited by round-off"


def test_the_times_of_the_record_have_it_and_loads_are_made_once(comm, monkeypatch):
    made, known = [], reductor.with_round_off
    independent_loads = run.independent_loads

    def slow(*arguments):
        time.sleep(0.1)
        return known(*arguments)

    monkeypatch.setattr(reductor, "with_round_off", slow)
    monkeypatch.setattr(run, "independent_loads", lambda run: made.append(run) or independent_loads(run))
    with nearly_free(comm) as model, hpcred.reduce(model, tolerance=1e-1, band=BAND) as rom:
        assert rom.record.timing.seconds["estimate"] >= 0.1
    assert len(made) == len(set(map(id, made))), "once for each run"


def chain(count, *springs):
    """K of masses in a row, 1e4 N/m between them, and springs to the ground at its ends."""
    K = 1e4 * (2 * np.eye(count) - np.eye(count, k=1) - np.eye(count, k=-1))
    K[0, 0] = K[-1, -1] = 1e4
    for place, spring in zip((0, -1), springs, strict=False):
        K[place, place] += spring
    return K


@pytest.mark.parametrize("free, tolerance", [(6, 1e-2), (10, 1e-5)])
def test_a_free_part_under_forces_in_equilibrium_has_a_response_at_rest(comm, free, tolerance):
    """The pair of forces stretches it; round-off of what pushes it is nothing. Against dense solves above 0 Hz."""
    held, top = 18, 6.0
    K, n = scipy.linalg.block_diag(chain(held, 1e4, 1e4), chain(free)), held + free
    B = np.zeros((n, 2))
    B[5, 0], B[held, 1], B[-1, 1] = 1.0, 1.0, -1.0
    with (
        SecondOrderModel.from_scipy(K, np.eye(n), inputs=B, comm=comm) as model,
        hpcred.reduce(model, damping=hpcred.Structural(0.02), tolerance=tolerance, band=(0.0, top)) as rom,
    ):
        accuracy = rom.record.accuracy
        assert accuracy.reached and accuracy.noise < 1e-10 and len(rom.frequencies) < 10
        f = np.linspace(1e-3, top, 100)
        H = np.array([B.T @ np.linalg.solve((1 + 0.02j) * K - (2 * np.pi * x) ** 2 * np.eye(n), B) for x in f])
        drive = np.einsum("sii->si", H)
        assert accuracy.measure.eps(H - rom.frequency_response(f), H, drive).max() <= tolerance


def test_a_free_part_without_load_brings_no_round_off(comm):
    """Beside a held part with both inputs, damped in proportion."""
    K, n = scipy.linalg.block_diag(100 * chain(12, 1e4, 1e4), 100 * chain(12)), 24
    B = np.eye(n)[:, [3, 9]]
    with (
        SecondOrderModel.from_scipy(K, np.eye(n), 1e-6 * K, inputs=B, comm=comm) as model,
        hpcred.reduce(model, tolerance=1e-4, band=(0.0, 200.0)) as rom,
    ):
        assert rom.record.accuracy.reached and rom.record.accuracy.noise < 1e-8
        f = np.linspace(0.1, 200.0, 50)
        H = np.array([B.T @ np.linalg.solve((1 + 2e-6j * np.pi * x) * K - (2 * np.pi * x) ** 2 * np.eye(n), B)
                      for x in f])  # fmt: skip
        drive = np.einsum("sii->si", H)
        assert rom.record.accuracy.measure.eps(H - rom.frequency_response(f), H, drive).max() <= 1e-4


def test_a_singular_stiffness_names_the_frequency_and_a_way_out(comm):
    """As the free axial motion of a rotor has at rest, which damping does not bound."""
    K, n = scipy.linalg.block_diag(chain(6, 1e4), chain(6)), 12
    B = np.eye(n)[:, [1]]
    with SecondOrderModel.from_scipy(K, np.eye(n), 1e-5 * K, inputs=B, comm=comm) as model:
        for ask in (lambda: hpcred.frequency_response(model, [0.0]), lambda: hpcred.reduce(model, [hpcred.Krylov(0.0)]),
                    lambda: hpcred.reduce(model, [hpcred.Modes(count=2)]),
                    lambda: hpcred.reduce(model, [hpcred.SecondOrderKrylov(0.0)])):  # fmt: skip
            with pytest.raises(hpcred.InputError, match="can move freely; take frame kind 'buckens'.*above 0 Hz"):
                ask()
    error = SingularMatrix(1e-14)
    error.point = "0 Hz"
    assert str(error).startswith("0 Hz: the matrix is singular") and "above 0 Hz" in str(error)
    error.point = "12 Hz"
    assert "12 Hz" in str(error) and "move it a little" in str(error)


@pytest.mark.parametrize(
    "mixed, measured, turns, left",
    [(0, 1.0, 0, 1e-9), (2, 5e-7, 0, 5e-7), (2, 1e-10, 0, 1e-9), (2, 2e-6, 2, 1e-12), (17, 0.0, 2, 1e-12)],
)
def test_few_mixed_modes_are_measured_before_all_columns_are_projected_again(
    monkeypatch, mixed, measured, turns, left
):  # fmt: skip
    monkeypatch.setattr(outcome, "ask_for_digits", lambda *_: (False, mixed))
    changes, asked = [1e-7, 1e-12], []
    noise = outcome.project_until_settled(
        None, SimpleNamespace(goal=1e-5), None, 1e-9, lambda: changes.pop(0),
        noise_of=lambda count: asked.append(count) or measured,
    )  # fmt: skip
    assert noise == left and len(changes) == 2 - turns and asked == [2] * (mixed == 2)


def test_the_lowest_modes_are_projected_again_by_themselves(comm):
    """Errors of the projected K, as round-off of stiff columns makes them, are gone from these."""
    with Owned(comm) as owned:
        model = owned.owns(hpcred.solid((4, 2, 2), inputs=2, comm=comm))
        run = owned.owns(Run(apply_frame(model), Progress(comm, show=False), 1e-9))
        projected = Projections(run, run.new_basis(20), Proportional(), damped=False)
        projected.extend(random_block(model.K, 20))
        exact, random = projected.model(), np.random.default_rng(1).standard_normal((20, 20))
        assert projected.is_stiffness_alone
        error = 1e-6 * exact.eigenvalues[-1] * (random + random.T) / 40
        projected.small = [operator.map(lambda K: K + error) for operator in projected.small]
        projected._models, projected._earlier = {}, {}
        first = projected.model()
        again = projected.with_lowest_again(first, 3)
    off, left = (np.abs(found.eigenvalues / exact.eigenvalues - 1)[:3].max() for found in (first, again))
    assert off > 1e-7 and left < 1e-4 * off
    assert np.allclose(np.abs(exact.vectors.T @ first.vectors @ again.vectors)[:3, :3], np.eye(3), atol=1e-6)
