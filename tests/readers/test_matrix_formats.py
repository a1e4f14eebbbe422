"""The same matrix in every format of the table."""

import gzip

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from foreign import assembled, write
from helpers import to_dense

from hpcred import InputError
from hpcred.parallel.petsc import PETSc, is_complex
from hpcred.readers.matrix_formats import read_entries
from hpcred.readers.registry import readers_of

pytestmark = pytest.mark.mpi


@pytest.fixture
def matrix(comm, folder):
    """A sparse symmetric matrix with numbers of all sizes, as files of every format."""
    mat = scipy.sparse.random(60, 60, 0.2, random_state=4, data_rvs=np.random.default_rng(4).standard_normal)
    mat = scipy.sparse.csr_matrix(mat + mat.T)
    mat.data *= 10.0 ** np.random.default_rng(5).integers(-9, 9, mat.nnz)
    mat = (mat + mat.T).tocsr()
    if comm.rank == 0:
        scipy.io.mmwrite(folder / "general.mtx", mat, symmetry="general", precision=17)
        scipy.io.mmwrite(folder / "symmetric.mtx", mat, symmetry="symmetric", precision=17, comment="a comment")
        with gzip.open(folder / "symmetric.mtx.gz", "wb") as file:
            file.write((folder / "symmetric.mtx").read_bytes())
        for kind in ("csr", "csc", "coo"):
            scipy.sparse.save_npz(folder / f"{kind}.npz", mat.asformat(kind))
        coo = mat.tocoo()
        lines = (f"{i + 1}, {j + 1}, {v!r}\n" for i, j, v in zip(coo.row, coo.col, coo.data.tolist(), strict=True))
        (folder / "coordinates.mtx").write_text("".join(lines))
        with open(folder / "petsc.bin", "wb") as file:
            for part in (
                np.array([1211216, 60, 60, mat.nnz]), np.diff(mat.indptr), mat.indices
            ):  # fmt: skip
                file.write(part.astype(">i4").tobytes())
            file.write(mat.data.astype(">f8").tobytes())
    comm.Barrier()
    return mat.toarray()


@pytest.mark.parametrize(
    "name", ["general.mtx", "symmetric.mtx", "symmetric.mtx.gz", "csr.npz", "csc.npz", "coo.npz", "coordinates.mtx",
             "petsc.bin"],
)  # fmt: skip
def test_every_format_gives_the_same_matrix(matrix, folder, comm, name):
    assert np.array_equal(assembled(folder / name, comm), matrix)


@pytest.mark.skipif(is_complex(), reason="PETSc's own reader needs the scalar type of the file")
def test_petsc_reads_what_we_read(matrix, folder, comm):
    mat = PETSc.Mat().load(PETSc.Viewer().createBinary(str(folder / "petsc.bin"), "r", comm=comm))
    assert np.array_equal(to_dense(mat), matrix)


def test_packed_binary_files_and_strangers_are_refused(matrix, folder, comm):
    for content, says in (
        (gzip.compress(b"PK\x03\x04"), "found a gzip file of SciPy .npz; unpack it first"),
        (b"hello\n", "found a file that begins with b'hello\\\\n', expected Matrix Market"),
        (b"", "found a file that begins with b''"),
        (b"\x93NUMPY\x01\x00", "found an array of NumPy .*save_npz"),
        (gzip.compress(b"1 1 1.0\n")[:-9], "found a damaged gzip file"),
    ):
        with pytest.raises(InputError, match=says):
            read_entries(write(folder / "K.mtx", content, comm), comm)
    with pytest.raises(InputError, match="no such file"):
        read_entries(folder / "none.mtx", comm)


def test_the_first_bytes_tell_the_format_never_the_suffix(matrix, folder, comm):
    names = {"symmetric.mtx": "Matrix", "petsc.bin": "PETSc", "csr.npz": "SciPy", "coordinates.mtx": "text"}
    for name, word in names.items():
        start = (folder / name).read_bytes()[:4096]
        assert next(item.name for item in readers_of("matrix") if item.begins(start)).split()[0] == word
        other = write(folder / "any.gz", (folder / name).read_bytes(), comm)
        assert np.array_equal(assembled(other, comm), matrix)
        comm.Barrier()
