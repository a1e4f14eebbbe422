"""Arrays of numbers that are to be real."""

import numpy as np
import pytest

import hpcred
from hpcred.model.checked_arrays import real_values


def test_complex_numbers_are_real_where_all_imaginary_parts_are_zero():
    assert real_values(np.array([1.0 + 0j, 2.0]), "K").tolist() == [1.0, 2.0]
    with pytest.raises(hpcred.InputError, match="K: found 1 entries with imaginary parts"):
        real_values(np.array([1.0 + 1j, 2.0]), "K")
