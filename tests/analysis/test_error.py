"""The error of responses in arrays: by directions, and the paper's."""

import numpy as np
import pytest

from hpcred.analysis.error import error_integral, relative_error
from hpcred.parallel.failures import InputError


def test_a_stiff_direction_is_relative_to_itself_and_not_to_the_largest():
    """One that is 30 % off hides in the norm of all; round-off of a zero does not count."""
    full = np.array([[[1.0, 1e-16], [1e-16, 1e-6]], [[2.0, 0.0], [0.0, 2e-6]]], dtype=complex)
    reduced = full.copy()
    reduced[0, 0, 0] *= 1.001
    reduced[1, 1, 1] *= 1.3
    reduced[0, 0, 1] = 3e-16
    assert relative_error(full, reduced, "paper").max() == pytest.approx(1e-3, rel=1e-6)
    assert relative_error(full, reduced).max() == pytest.approx(0.3)
    scale = np.array([1e-3, 1e5])
    assert relative_error(full * scale * scale[:, None], reduced * scale * scale[:, None]).max() == pytest.approx(0.3)


def test_other_outputs_need_drive_points():
    full = np.ones((3, 1, 2), dtype=complex)
    with pytest.raises(InputError, match="^relative_error: 1 outputs and 2 inputs are not the same places; give the"):
        relative_error(full, full)
    with pytest.raises(InputError, match=r"^relative_error: found drive \(3, 1\), expected \(3, 2\)"):
        relative_error(full, full, drive=np.ones((3, 1)))
    with pytest.raises(InputError, match="^measure: found 'norm', expected 'directions' or 'paper'"):
        relative_error(full, full, "norm", drive=np.ones((3, 2)))
    # the second input moves nothing but a little of its own place
    full[:, 0, 1] = 1e-3
    wrong = full * [1.01, 1.5]
    drive = np.ones((3, 2)) * [4.0, 9.0]
    assert relative_error(full, wrong, drive=drive) == pytest.approx(np.full(3, 0.01))
    assert relative_error(full[:, :, 1:], wrong[:, :, 1:], drive=drive[:, 1:]) == pytest.approx(np.full(3, 0.5))


def test_an_error_of_nothing_is_none_and_that_of_no_number_is_no_number():
    full = np.array([0.0, 0.0, np.nan, 1.0])[:, None, None]
    found = relative_error(full, np.array([0.0, 1.0, 1.0, np.nan])[:, None, None])
    assert found[0] == 0 and found[1] == np.inf and np.isnan(found[2:]).all()


@pytest.mark.parametrize("shapes", [((2, 3, 1), (2, 1, 1)), ((2, 1, 1), (1, 1, 1)), ((2,), (2,))])
def test_responses_of_different_shapes_have_no_error(shapes):
    with pytest.raises(InputError, match="^relative_error: found arrays .* of one shape"):
        relative_error(*map(np.ones, shapes))


def test_the_integral_takes_lists_of_one_length():
    assert error_integral([0, 1, 3], [1, 2, 5]) == 8.5
    with pytest.raises(InputError, match=r"^error_integral: found \(1,\) errors for \(3,\) frequencies"):
        error_integral([0, 1, 3], [1.0])
