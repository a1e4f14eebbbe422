"""PETSc binary files: damaged ones are refused, and the share of rows of a rank is exact for any number of ranks."""

from types import SimpleNamespace

import numpy as np
import pytest
from foreign import assembled, write

from hpcred import InputError
from hpcred.parallel.shares import row_range

pytestmark = pytest.mark.mpi


def binary(rows=3, columns=3, count=4, lengths=(1, 2, 1), indices=(0, 0, 1, 2), whole=">i4"):
    head = np.array([1211216, rows, columns, count, *lengths, *indices], whole)
    return head.tobytes() + np.arange(1.0, 1 + len(indices)).astype(">f8").tobytes()


@pytest.mark.parametrize("whole", [">i4", ">i8"])
def test_a_petsc_matrix(comm, folder, whole):
    """Of a PETSc with indices of 32 bits, and of one with 64."""
    path = write(folder / "K.bin", binary(whole=whole), comm)
    assert np.array_equal(assembled(path, comm), [[1, 0, 0], [2, 3, 0], [0, 0, 4]])


@pytest.mark.parametrize(
    "content, says",
    [
        (binary(indices=(0, 0, 1, 3)), r"found the column 3 \(from 0\), expected less than 3"),
        (binary(indices=(0, -1, 1, 2)), r"found the column -1 \(from 0\)"),
        (binary(lengths=(1, 2, 2)), "found rows of 5 entries in all, the header says 4"),
        (binary(lengths=(1, 4, -1)), "found a row of -1 entries"),
        (binary()[:-1], "found 75 bytes, expected 76"),
        (binary()[:10], "found 10 bytes"),
        (binary(count=-1), "found a dense PETSc matrix"),
        (binary() + bytes(32), "this looks like a complex matrix"),
        (binary()[:-16], "this looks like a matrix of single precision"),
        (binary() + binary(), "a damaged file, or one of more than a matrix"),
        (binary(whole=">i8")[:-1], "found 119 bytes, expected 120"),
        (binary(whole=">i8", indices=(0, 0, 1, 2**33)), "found the column 8589934592"),
    ],
)
def test_petsc_files_that_do_not_add_up_are_refused(comm, folder, content, says):
    with pytest.raises(InputError, match=says):
        assembled(write(folder / "K.bin", content, comm), comm)


def test_row_numbers_do_not_overflow():
    """10^7 rows, as a 32-bit number from a file, times rank 215 is more than 2^31."""
    rows = np.array([10**7], ">i4")[0]
    shares = [row_range(SimpleNamespace(rank=rank, size=512), rows) for rank in range(512)]
    assert shares[0][0] == 0 and shares[-1][1] == 10**7
    assert all(a[1] == b[0] and b[0] < b[1] for a, b in zip(shares, shares[1:], strict=False))
