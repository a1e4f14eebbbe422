"""Entries of matrices before they are rows of PETSc."""

import numpy as np
import pytest

from hpcred.readers.entries import Entries, asymmetry


@pytest.mark.mpi
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [1e3, 1e250])
def test_asymmetry_of_entries_of_any_size(comm, size):
    """Damaged ones may be so large that their squares are no numbers."""
    rows, columns = np.array([0, 1, 2, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 0, 2, 1])
    values = np.array([2.0, 3.0, 4.0, size, size, -1.0, -1.0])
    mine = slice(comm.rank, None, comm.size)
    assert asymmetry(comm, Entries((3, 3), rows[mine], columns[mine], values[mine])) < 1e-15
    values[3] *= -1
    assert asymmetry(comm, Entries((3, 3), rows[mine], columns[mine], values[mine])) > 0.1
