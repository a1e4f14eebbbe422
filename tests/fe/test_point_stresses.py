"""Stresses at integration points, found by element."""

import numpy as np
import pytest

from hpcred import InputError
from hpcred.fe.point_stresses import PointStresses
from hpcred.parallel.petsc import MPI


def test_only_elements_that_count_are_found():
    """One point of each of two tetrahedra, the second of which has no place."""
    stress = np.arange(12.0).reshape(2, 6)
    stresses = PointStresses(MPI.COMM_SELF, np.array([5, 7]), np.array([1, 1]), stress, "stress.dat", "body")
    number, found = np.array([7, 5]), []
    with pytest.raises(InputError, match="found no stresses of element 5 .tetra. of body"):
        for _, mine, sigma in stresses.of_elements("tetra", number, np.array([True, False])):
            found += [(mine.tolist(), sigma.tolist())] if mine.any() else []
    assert found == [([True, False], [[stress[1].tolist()]])] and stresses.used == 1
