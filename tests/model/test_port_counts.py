"""So many inputs that nothing could be computed with them are refused by their number, before any work."""

import numpy as np
import pytest
from foreign import write

import hpcred
from hpcred import InputError
from hpcred.parallel.shares import row_range
from hpcred.readers.assembly import read_columns

pytestmark = pytest.mark.mpi


@pytest.mark.parametrize("transposed", [False, True])
def test_more_columns_than_dofs_are_refused(comm, folder, transposed):
    """A file of 10^6 columns, of which one has an entry: nothing of that length is made."""
    shape = "1000000 1200" if transposed else "1200 1000000"
    path = write(folder / "B.mtx", f"%%MatrixMarket matrix coordinate real general\n{shape} 1\n1 1 1.0\n", comm)
    starts = np.array([first for first, _ in comm.allgather(row_range(comm, 1200))])
    with pytest.raises(InputError, match="found 1000000 (rows|columns) for a model of 1200 dofs"):
        read_columns(comm, starts, 1200, path, transposed)


@pytest.mark.parametrize("command", ["reduce", "response", "solves"])
def test_responses_that_no_memory_holds_are_counted(comm, monkeypatch, command):
    """16 bytes a pair and frequency: 144^2 pairs at 350 frequencies take 111 MB."""
    monkeypatch.setenv("HPCRED_MEMORY_MB", "100")
    with hpcred.solid((4, 2, 3), comm=comm) as model, model.with_inputs(list(range(1, 145))) as loaded:
        with pytest.raises(InputError, match="144 inputs and 144 outputs: .* 20736 responses at 350 frequencies 111"):
            if command == "reduce":
                hpcred.reduce(loaded, tolerance=1e-2, band=(0.0, 100.0))
            elif command == "response":
                hpcred.full_response(loaded, [1.0, 100.0])
            else:
                hpcred.frequency_response(loaded, np.linspace(0, 100, 350))
        with model.with_inputs([1, 2]) as two:
            assert hpcred.frequency_response(two, [1.0]).shape == (1, 2, 2)
