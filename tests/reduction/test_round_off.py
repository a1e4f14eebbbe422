"""Round-off of K, which is common to all models made from one projection: what is said of it against an exact value."""

import time

import numpy as np
import pytest

import hpcred
from hpcred import SecondOrderModel
from hpcred.analysis.error_check import as_measured
from hpcred.linalg.solvers.base import SingularMatrix
from hpcred.parallel.petsc import is_complex
from hpcred.reduction import run
from hpcred.reduction.tolerance import reductor
from hpcred.reduction.tolerance.point_solver import PointSolver
from hpcred.reduction.tolerance.search import Search

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


@pytest.mark.parametrize("tolerance", [1e-6, 1e-1])
def test_round_off_of_stiff_parts_counts(tolerance, comm):
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


def test_round_off_of_a_full_response_counts(comm):
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
    assert len(made) == 1
