"""Matrix Market: what the format allows is read, all else is refused."""

import gzip

import numpy as np
import pytest
import scipy.io
from foreign import assembled, write

from hpcred import InputError

pytestmark = pytest.mark.mpi(build="real")

HEAD = "%%MatrixMarket matrix coordinate real"


def test_a_dense_file_goes_column_by_column(comm, folder, monkeypatch):
    monkeypatch.setattr("hpcred.files.text.PIECE", 8)
    content = "%%MatrixMarket matrix array real general\n3 2\n" + "".join(f"{k}.5\n" for k in range(6))
    for name, data in (("B.mtx", content.encode()), ("B.mtx.gz", gzip.compress(content.encode()))):
        path = write(folder / name, data, comm)
        assert np.array_equal(assembled(path, comm), [[0.5, 3.5], [1.5, 4.5], [2.5, 5.5]])


@pytest.mark.parametrize("lines", ["1 1 1.0\n2 1 2.0\n", "1 1 1.0\n1 2 2.0\n"])
def test_one_triangle_of_a_symmetric_file(comm, folder, lines):
    path = write(folder / "K.mtx", f"{HEAD} symmetric\n% remark\n2 2 2\n{lines}", comm)
    assert np.array_equal(assembled(path, comm), [[1, 2], [2, 0]])


def test_dense_files_of_one_triangle_as_scipy_writes_them(comm, folder, monkeypatch):
    monkeypatch.setattr("hpcred.files.text.PIECE", 64)
    root = np.random.default_rng(3).standard_normal((7, 7))
    for content in (root + root.T, root - root.T):
        path = folder / "A.mtx"
        if comm.rank == 0:
            scipy.io.mmwrite(path, content)
        comm.Barrier()
        assert b"symmetric\n" in path.read_bytes()
        assert np.allclose(assembled(path, comm), content, rtol=1e-15, atol=0)
        comm.Barrier()


def test_a_skew_symmetric_file(comm, folder):
    path = write(folder / "G.mtx", f"{HEAD} skew-symmetric\n2 2 1\n2 1 3.0\n", comm)
    assert np.array_equal(assembled(path, comm), [[0, -3], [3, 0]])


@pytest.mark.parametrize(
    "content, says",
    [
        ("%%MatrixMarket matrx coordinate real general\n1 1 1\n1 1 1.0\n", "line 1: found '%%MatrixMarket matrx"),
        ("%%MatrixMarkets matrix coordinate real general\n1 1 1\n1 1 1.0\n", "expected a real Matrix Market header"),
        ("%%MatrixMarket matrix coordinate real symetric\n1 1 1\n1 1 1.0\n", "expected a real Matrix Market header"),
        ("%%MatrixMarket matrix coordinate complex general\n1 1 1\n1 1 1 0\n", "expected a real Matrix Market header"),
        ("%%MatrixMarket matrix coordinate pattern general\n1 1 1\n1 1\n", "expected a real Matrix Market header"),
        ("%%MatrixMarket matrix array real symmetric\n2 2\n1\n2\n3\n4\n", "the header says 2 x 2, symmetric: 3"),
        (f"{HEAD} general\n2 2\n1 1 1.0\n", "line 2: found the size line '2 2'"),
        (f"{HEAD} general\n2 2 x\n1 1 1.0\n", "found the size line '2 2 x'"),
        (f"{HEAD} general\n2 2 1 x\n1 1 1.0\n", "found the size line '2 2 1 x'"),
        (f"{HEAD} general\n2 2 -1\n1 1 1.0\n", "found the size line '2 2 -1'"),
        (f"{HEAD} general\n2 2 1\n3 1 1.0\n", "line 3: found '3 1 1.0', expected an entry of the 2 x 2 matrix"),
        (f"{HEAD} general\n12 12 2\n1 1 1.0\n112 1.0\n", "line 4: found '112 1.0', expected 3 numbers a line"),
        (f"{HEAD} general\n2 2 2\n1 1 1.0\n", "found 1 entries, the header says 2"),
        (f"{HEAD} general\n2 2 1\n1 1 1.0\n2 2 1.0\n", "found 2 entries, the header says 1"),
        (f"{HEAD} general\n2 2 2\n1 1 1,5\n2 2 1.0\n", "line 3: found '1 1 1,5', expected 3 numbers a line"),
        (f"{HEAD} general\n2 2 2\n1,1,1.0\n2 2 1.0\n", "line 3: found '1,1,1.0', expected 3 numbers a line"),
        (f"{HEAD} symmetric\n2 2 3\n1 1 1.0\n1 2 3.0\n2 1 3.0\n", "line 4: found '1 2 3.0', expected one triangle"),
        (f"{HEAD} skew-symmetric\n2 2 2\n1 1 1.0\n2 1 3.0\n", "line 3: found '1 1 1.0', expected no diagonal"),
        (f"{HEAD} symmetric\n3 2 1\n3 1 1.0\n", "line 2: found a symmetric matrix of 3 x 2, expected a square one"),
        (f"{HEAD} skew-symmetric\n2 3 1\n2 1 1.0\n", "line 2: found a skew-symmetric matrix of 2 x 3"),
        ("%%MatrixMarket matrix array real general\n2 2\n1 2\n3 4\n", "line 3: found '1 2', expected 1 number a line"),
        ("%%MatrixMarket matrix array real general\n2 2\n1\n2\n3\n", "the header says 2 x 2, general: 4"),
    ],
)
def test_a_matrix_market_file_that_is_not_one_is_refused(comm, folder, content, says):
    path = write(folder / "K.mtx", content, comm)
    with pytest.raises(InputError) as error:
        assembled(path, comm)
    assert says in str(error.value) and str(path) in str(error.value)
