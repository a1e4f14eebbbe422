"""Rows of all ranks in one array on the first one, by shared memory and by messages."""

import numpy as np
import pytest

from hpcred.parallel import parts
from hpcred.parallel.parts import Parts


@pytest.mark.mpi
@pytest.mark.parametrize("shared", [True, False])
def test_rows_go_to_the_first_rank_and_back(comm, monkeypatch, shared):
    """In places that stay apart whatever the number of columns; one rank has no rows."""
    if not shared:
        monkeypatch.setattr(parts, "SHARED", "/nowhere")
    counts = [5, 0, 3][: comm.size]
    array = Parts(comm, counts[comm.rank], 4, float)
    assert (array.whole.size == 4 * sum(counts)) == (comm.rank == 0 or shared)
    for columns in (2, 4, 1):
        offered = [np.arange(rows * columns, dtype=float).reshape(rows, columns) + 100 * r
                   for r, rows in enumerate(counts)]  # fmt: skip
        array.gather(offered[comm.rank])
        if comm.rank == 0:
            for rank, expected in enumerate(offered):
                assert np.array_equal(array.place(rank, columns), expected)
                array.place(rank, columns)[...] *= 2
        found = np.zeros_like(offered[comm.rank])
        array.scatter(found)
        assert np.array_equal(found, 2 * offered[comm.rank])
    array.close()
