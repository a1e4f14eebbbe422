"""The International Space Station, part 1R of SLICOT's benchmarks: velocity outputs only, against published numbers."""

import numpy as np
import pytest
import scipy.io

import hpcred
from tests.shared_data import shared

MODES = 135
BAND = (0.0, 12.0)  # Hz, beyond the highest mode


@pytest.fixture(scope="module")
def station():
    """M, D, K, B, Cv from x' = A x + B u, y = C x with x = (q, q'); and the circular frequencies (561,) and sizes
    (561, 3, 3) of the published responses."""
    given = scipy.io.loadmat(shared("real/iss_hylaa.mat"))
    A, B, C = (np.asarray(given[key].todense()) for key in "ABC")
    assert not A[:MODES, :MODES].any() and (A[:MODES, MODES:] == np.eye(MODES)).all()
    assert not B[:MODES].any() and not C[:, :MODES].any()
    matrices = np.eye(MODES), -A[MODES:, MODES:], -A[MODES:, :MODES], B[MODES:], C[:, MODES:]
    return matrices, given["w"].ravel(), given["mag"].reshape(-1, 3, 3).transpose(0, 2, 1)


def model_of(matrices, comm):
    M, D, K, B, Cv = matrices
    return hpcred.SecondOrderModel(M, D, K, B, Cv=Cv, comm=comm)


@pytest.mark.mpi
def test_responses_are_the_published_ones(comm, station):
    matrices, omega, size = station
    H = hpcred.frequency_response(model_of(matrices, comm), omega / (2 * np.pi))
    assert np.abs(np.abs(H) - size).max() < 1e-12 * size.max()
    assert (np.abs(np.abs(H) - size) < 1e-7 * size.max(axis=0)).all()


@pytest.mark.mpi(ranks=(1,))
def test_reduced_to_a_tolerance(comm, station):
    matrices, omega, size = station
    model = model_of(matrices, comm)
    reduced = hpcred.reduce(model, tolerance=1e-3, band=BAND)
    accuracy = reduced.record.accuracy
    assert accuracy.reached and reduced.size < MODES
    # all nine responses, each beside its own size at each frequency of the publication in the band
    inside = omega / (2 * np.pi) <= BAND[1]
    H = reduced.transfer_function(1j * omega[inside])
    full = hpcred.frequency_response(model, omega[inside] / (2 * np.pi))
    assert np.abs(np.abs(full) - size[inside]).max() < 1e-12
    assert np.abs(H - full).max() < 1e-3 * size.max()
    check = hpcred.check_reduced(reduced, model, 12, seed=3)
    assert check.passed, check.sentence
