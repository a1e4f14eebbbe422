"""The International Space Station, part 1R of SLICOT's benchmarks: velocity outputs only, against published numbers."""

import numpy as np
import pytest
import scipy.io

import hpcred
from benchmarks.models import MODELS
from benchmarks.models.slicot import hankel_values, published_hankel_values
from tests.shared_data import shared

STATION = MODELS["iss"]
MODES = STATION.n


@pytest.fixture(scope="module")
def station():
    """The circular frequencies (561,) and sizes (561, 3, 3) of the published responses."""
    given = scipy.io.loadmat(shared("real/iss_hylaa.mat"))
    return given["w"].ravel(), given["mag"].reshape(-1, 3, 3).transpose(0, 2, 1)


@pytest.mark.mpi
def test_responses_are_the_published_ones(comm, station):
    omega, size = station
    H = hpcred.frequency_response(STATION.model(comm), omega / (2 * np.pi))
    assert np.abs(np.abs(H) - size).max() < 1e-12 * size.max()
    assert (np.abs(np.abs(H) - size) < 1e-7 * size.max(axis=0)).all()


@pytest.mark.slow
@pytest.mark.mpi(ranks=(1,))
def test_reduced_to_a_tolerance(comm, station):
    omega, size = station
    model = STATION.model(comm)
    reduced = hpcred.reduce(model, tolerance=1e-3, band=STATION.band)
    accuracy = reduced.record.accuracy
    assert accuracy.reached and reduced.size < MODES
    # all nine responses, each beside its own size at each frequency of the publication in the band
    inside = omega / (2 * np.pi) <= STATION.band[1]
    H = reduced.transfer_function(1j * omega[inside])
    full = hpcred.frequency_response(model, omega[inside] / (2 * np.pi))
    assert np.abs(np.abs(full) - size[inside]).max() < 1e-12
    assert np.abs(H - full).max() < 1e-3 * size.max()
    check = hpcred.check_reduced(reduced, model, 12, seed=3)
    assert check.passed, check.sentence


def test_full_model_has_the_published_hankel_values(station):
    given = STATION.matrices()
    published = published_hankel_values(STATION.path())
    found = hankel_values(given.M.toarray(), given.D.toarray(), given.K.toarray(), given.B, Cv=given.Cv)
    assert (np.abs(found - published) < 1e-10 * published[0]).all()


@pytest.mark.slow
@pytest.mark.mpi(ranks=(1,))
def test_reduced_model_keeps_the_published_hankel_values(comm, station):
    published = published_hankel_values(STATION.path())
    with STATION.model(comm) as model, STATION.reduce(model, tolerance=1e-3) as rom:
        found = hankel_values(rom.M, rom.D, rom.K, rom.B, rom.C, rom.Cv)
    kept = len(found)
    assert kept < 0.6 * len(published)
    # the error of each is at most that of the model in the Hankel norm, and the large ones have theirs much closer
    assert np.abs(found - published[:kept]).max() < 1e-5 * published[0]
    assert np.abs(found / published[:kept] - 1)[: kept // 2].max() < 1e-2
