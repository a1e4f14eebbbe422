"""The worst pair of responses: relative to itself, but for pairs that symmetry makes nothing of."""

import numpy as np
import pytest

from hpcred.analysis.error import relative_error
from hpcred.reduction.pseudo_modal import worst_pair


def test_the_worst_pair_is_relative_to_itself_and_not_to_the_largest():
    """A stiff direction that is 30 % off hides in the norm of all; round-off of a zero does not count."""
    full = np.array([[[1.0, 1e-16], [1e-16, 1e-6]], [[2.0, 0.0], [0.0, 2e-6]]], dtype=complex)
    reduced = full.copy()
    reduced[0, 0, 0] *= 1.001
    reduced[1, 1, 1] *= 1.3
    reduced[0, 0, 1] = 3e-16
    assert relative_error(full, reduced).max() == pytest.approx(1e-3, rel=1e-6)
    i, j, error = worst_pair(full, reduced)
    assert (i, j) == (1, 1) and error == pytest.approx(0.3)
