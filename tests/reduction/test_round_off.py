"""Round-off of K, which is common to all models made from one projection: what is said of it against an exact value."""

import time

import numpy as np
import pytest

import hpcred
from hpcred import SecondOrderModel
from hpcred.analysis.error_check import as_measured
from hpcred.parallel.petsc import is_complex
from hpcred.reduction import reduce, run

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


def test_round_off_of_a_full_response_counts(comm):
    with nearly_free(comm) as model:
        f = OMEGA / (2 * np.pi) * np.linspace(0.99, 1.01, 101)
        found = hpcred.full_response(model, f, damping=hpcred.Structural(2e-3), tolerance=1e-6, band=BAND)
    error = error_of(found.response, f, 2e-3)
    assert 1e-4 < error.max() < 3 * found.eps.max()
    assert not found.reached and found.accuracy.stopped == "limited by round-off"


def test_the_times_of_the_record_have_it_and_loads_are_made_once(comm, monkeypatch):
    made, known = [], reduce.with_round_off
    loads_and_ports = run.loads_and_ports

    def slow(*arguments):
        time.sleep(0.1)
        return known(*arguments)

    monkeypatch.setattr(reduce, "with_round_off", slow)
    monkeypatch.setattr(run, "loads_and_ports", lambda run: made.append(run) or loads_and_ports(run))
    with nearly_free(comm) as model, hpcred.reduce(model, tolerance=1e-1, band=BAND) as rom:
        assert rom.record.timing.seconds["estimate"] >= 0.1
    assert len(made) == 1
