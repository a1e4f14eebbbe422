"""The solid bends like a beam."""

import numpy as np
import pytest

import hpcred
from hpcred import Modes

pytestmark = pytest.mark.mpi


def test_a_slender_block_bends_like_a_beam(comm):
    """Cantilever of Euler and Bernoulli: f1 = 1.8751^2 / (2 pi L^2) sqrt(E I / (rho A))."""
    first = 1.875104**2 / (2 * np.pi) * np.sqrt(2e11 * 0.02**2 / 12 / 7850)
    model = hpcred.solid((200, 2, 2), (1.0, 0.02, 0.02), 1, young=2e11, poisson=0.0, comm=comm)
    with model, hpcred.reduce(model, [Modes(count=2)]) as rom:
        assert np.allclose(rom.frequencies, first, rtol=0.03)
