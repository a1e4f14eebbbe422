"""The worst pair of responses: relative to itself, but for pairs that symmetry makes nothing of."""

import numpy as np
import pytest

from hpcred.analysis.error import error_integral, relative_error
from hpcred.parallel.failures import InputError
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


def test_a_resonance_that_is_right_does_not_hide_a_pair_that_is_wrong_in_all_of_the_band():
    """A stiff direction that is off everywhere but where it takes a small part in a resonance."""
    full = np.ones((9, 2, 2), dtype=complex)
    full[:, 1, 1] = 1e-2
    full[4] *= 1e4
    reduced = full.copy()
    reduced[:, 1, 1] -= 0.9e-2
    assert np.median(relative_error(full, reduced)) < 1e-2
    i, j, error = worst_pair(full, reduced)
    assert (i, j) == (1, 1) and error == pytest.approx(0.9)


def test_an_error_of_nothing_is_none_and_that_of_no_number_is_no_number():
    full = np.array([0.0, 0.0, np.nan, 1.0])[:, None, None]
    found = relative_error(full, np.array([0.0, 1.0, 1.0, np.nan])[:, None, None])
    assert found[0] == 0 and found[1] == np.inf and np.isnan(found[2:]).all()


@pytest.mark.parametrize("shapes", [((2, 3, 1), (2, 1, 1)), ((2, 1, 1), (1, 1, 1)), ((2,), (2,))])
def test_responses_of_different_shapes_have_no_error(shapes):
    with pytest.raises(InputError, match="^relative_error: found arrays .* of one shape"):
        relative_error(*map(np.ones, shapes))


def test_the_integral_takes_lists_of_one_length():
    assert error_integral([0, 1, 3], [1, 1, 2]) == 4.0
    with pytest.raises(InputError, match=r"^error_integral: found \(1,\) errors for \(3,\) frequencies"):
        error_integral([0, 1, 3], [1.0])
