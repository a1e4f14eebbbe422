"""Files of scipy.sparse.save_npz: damaged ones are refused."""

import io
import zipfile

import numpy as np
import pytest
import scipy.sparse
from foreign import assembled, write

from hpcred import InputError

pytestmark = pytest.mark.mpi(build="real")


def archive(**changes):
    """A 3 x 3 matrix as CSR; `changes` of its arrays, None to leave one out."""
    arrays = {
        "format": np.array(b"csr"), "shape": np.array([3, 3]), "data": np.array([1.0, 2.0, 3.0, 4.0]),
        "indptr": np.array([0, 1, 3, 4]), "indices": np.array([0, 0, 1, 2]),
    }  # fmt: skip
    arrays.update(changes)
    file = io.BytesIO()
    np.savez_compressed(file, **{key: value for key, value in arrays.items() if value is not None})
    return file.getvalue()


def test_an_array_twice_is_refused(comm, folder):
    path = write(folder / "K.npz", archive(), comm)
    if comm.rank == 0:
        with zipfile.ZipFile(path, "a") as file, pytest.warns(UserWarning, match="Duplicate name"):
            file.writestr("data.npy", file.read("data.npy"))
    comm.Barrier()
    with pytest.raises(InputError, match="found an array twice in the archive"):
        assembled(path, comm)


def test_an_archive(comm, folder):
    path = write(folder / "K.npz", archive(), comm)
    assert np.array_equal(assembled(path, comm), [[1, 0, 0], [2, 3, 0], [0, 0, 4]])
    path = write(folder / "T.npz", archive(format=np.array("csc")), comm)
    assert np.array_equal(assembled(path, comm), [[1, 2, 0], [0, 3, 0], [0, 0, 4]])


@pytest.mark.parametrize(
    "content, says",
    [
        (archive(indices=np.array([0, 0, 1, 3])), r"found the column 3 \(from 0\), expected less than 3"),
        (archive(indices=np.array([0, 0, -1, 2])), r"found the column -1 \(from 0\)"),
        (archive(indices=np.array([0, 0, 1])), "found 3 numbers in the array 'indices', expected 4"),
        (archive(indices=np.array([0.0, 0.0, 1.0, 2.0])), "expected one row of whole numbers"),
        (archive(indptr=np.array([0, 1, 4])), "found 3 numbers in the array 'indptr', expected 4"),
        (archive(indptr=np.array([0, 3, 1, 4])), "'indptr' that does not ascend from 0"),
        (archive(indptr=np.array([0, 1, 3, 3])), "'indptr' that does not ascend from 0"),
        (archive(indptr=np.array([1, 1, 3, 4])), "'indptr' that does not ascend from 0"),
        (archive(data=np.array([1.0, 2.0])), "found 4 numbers in the array 'indices', expected 2"),
        (archive(data=np.ones((2, 2))), "expected one row of real numbers"),
        (archive(data=np.ones(4, complex)), "expected one row of real numbers"),
        (archive(data=None), "expected those of scipy.sparse.save_npz"),
        (archive(indptr=None), "found no array 'indptr'"),
        (archive(format=np.array("bsr")), "found a sparse matrix of format 'bsr', .* save A.tocsr"),
        (archive(shape=np.array([3, 3, 3])), "found 3 items in the array 'shape'"),
        (archive(shape=np.array([9])), r"found the shape \(9,\)"),
        (archive()[:-30], "found a damaged zip archive"),
        (archive()[:100] + archive()[140:], "found a damaged zip archive"),
        (archive(data=np.array([1.0, None, 2.0, 3.0], object)), "found Python objects in the array 'data'"),
        (archive(format=np.array("csr", object)), "found Python objects in the array 'format'"),
        (archive(shape=np.array([3, -3])), r"found the shape \(3, -3\)"),
        (archive(shape=np.array([3.0, 3.5])), "'shape' of type float64, expected whole numbers"),
        (archive(shape=np.array([2**40, 3])), "found 4 numbers in the array 'indptr', expected 1099511627777"),
        (archive(indptr=np.array([0, -1, 3, 4])), "'indptr' that does not ascend from 0"),
        (archive(indptr=np.array([0, 9, 9, 4])), "'indptr' (that does not ascend|beyond)"),
        (archive(indptr=np.array([0, 2**62, 2**62, 4])), "'indptr' (that does not ascend|beyond)"),
    ],
)
def test_archives_that_do_not_add_up_are_refused(comm, folder, content, says):
    with pytest.raises(InputError, match=says):
        assembled(write(folder / "K.npz", content, comm), comm)


@pytest.mark.parametrize("compressed", [False, True])
def test_damage_is_refused_or_makes_no_difference(comm, folder, compressed):
    """Bits turned, ends cut off, pieces cut out: the checksums of the archive tell, on any number of ranks."""
    matrix = scipy.sparse.random(20, 20, 0.2, format="csr", random_state=3) + scipy.sparse.eye(20, format="csr")
    file, random = io.BytesIO(), np.random.default_rng(5)
    scipy.sparse.save_npz(file, matrix, compressed=compressed)
    taken = 0
    for trial in range(60):
        data = bytearray(file.getvalue())
        a, b = sorted(random.integers(len(data), size=2))
        if trial % 3 == 0:
            data[a] ^= 1 << int(random.integers(8))
        elif trial % 3 == 1:
            del data[a:]
        else:
            del data[a:b]
        path = write(folder / "K.npz", bytes(data), comm)
        try:
            found = assembled(path, comm)
        except InputError:
            continue
        taken += 1
        assert np.array_equal(found, matrix.toarray())
    assert taken < 12


def test_an_archive_larger_than_the_memory(comm, folder, monkeypatch):
    monkeypatch.setattr("hpcred.readers.matrices.npz.node_mb", lambda: 1e-5)
    with pytest.raises(InputError, match=r"found 0 MB in the array '\w+', and 0 MB are free"):
        assembled(write(folder / "K.npz", archive(), comm), comm)
