"""Matrices in OP2: written here as pyYeti reads them and as NX Nastran wrote one; what is damaged is refused."""

import shutil

import numpy as np
import pytest
from conftest import DATA
from foreign import unpack, write
from helpers import to_dense

from hpcred import InputError
from hpcred.readers.model_source import load_export, load_source
from hpcred.readers.nastran import op2 as nastran_op2
from hpcred.readers.nastran import op4 as nastran_op4
from hpcred.settings.source import Source

pytestmark = pytest.mark.mpi


def block(name, matrix, form=6, order="<", size=4, kind="f8", strings=1):
    """A matrix of OUTPUT2; each column as so many strings, an empty one as none."""

    def record(data):
        mark = np.array([len(data)], f"{order}i4").tobytes()
        return mark + data + mark

    def words(*numbers):
        return np.array(numbers, f"{order}i{size}").tobytes()

    def keys(*numbers):
        return b"".join(record(words(number)) for number in numbers)

    letters = f"{name:8}".encode()
    if size == 8:
        letters = b"".join(letters[k : k + 4] + b"    " for k in (0, 4))
    rows, columns = matrix.shape
    trailer = record(words(101, columns, rows, form, 2 if kind == "f8" else 1, 0, 0))
    parts = [keys(2), record(letters), keys(-1, 7), trailer, keys(-2, 1, 0, 2), record(letters), keys(-3)]
    for k, column in enumerate(matrix.T):
        parts.append(keys(1, 1))
        for rows in np.array_split(np.flatnonzero(column), strings):
            if len(rows):
                low, high = rows[0], rows[-1] + 1
                values = column[low:high].astype(order + kind).tobytes()
                parts += [keys(1 + high - low), record(words(low + 1) + values)]
        parts.append(keys(-4 - k))
    return b"".join([*parts, keys(1, 0, 0)])


def dense(path, comm, matrix):
    entries = nastran_op4.read_matrix(path, comm, matrix)
    local = np.zeros(entries.shape)
    np.add.at(local, (entries.rows, entries.columns), entries.values)
    return comm.allreduce(local)


def second(path, name):
    """A matrix as pyYeti reads it."""
    from pyyeti.nastran import op2

    file = op2.OP2(str(path))
    file.directory(verbose=False)
    file.set_position(name)
    _, trailer, _ = file.rdop2nt()
    return file.rdop2matrix(trailer)


@pytest.mark.peers("pyyeti")
@pytest.mark.costly
def test_a_matrix_of_nx_nastran(comm):
    path = DATA / "nastran" / "nx" / "nas2cam_notall6_nx2021.op2"
    (found,) = nastran_op4.contents(path, comm)
    assert (found.name, found.shape) == ("MAPS", (29, 34))
    assert np.array_equal(dense(path, comm, found), second(path, "MAPS"))


@pytest.mark.peers("pyyeti")
@pytest.mark.parametrize("order, size, kind", [("<", 4, "f8"), ("<", 4, "f4"), (">", 4, "f8"), ("<", 8, "f8")])
def test_all_forms(comm, folder, monkeypatch, order, size, kind):
    monkeypatch.setattr(nastran_op2, "SHARE", 100)
    matrix = np.random.default_rng(3).standard_normal((7, 5)).round(2)
    matrix[[0, 3, 5]] = 0
    matrix[:, 2] = 0
    matrix = matrix.astype(kind).astype(float)
    other = np.diag(np.arange(1.0, 4))
    content = block("KGG", matrix, 2, order, size, kind, 2) + block("PHGX", other, 6, order, size, kind)
    path = write(folder / "a.op2", content, comm)
    found = nastran_op4.contents(path, comm)
    assert [item.name for item in found] == ["KGG", "PHGX"] and len(found[0].starts) > 3
    assert np.array_equal(dense(path, comm, found[0]), matrix) and np.array_equal(dense(path, comm, found[1]), other)
    if comm.rank == 0:
        assert np.array_equal(second(path, "KGG"), matrix)


def test_matrices_beside_tables_of_points(comm, folder):
    """Those of an OP4 put into the OP2 of its run are the same model."""
    unpack(folder, comm, "nastran/extseout")
    path = folder / "nas2cam.op4"
    content = (folder / "nas2cam.op2").read_bytes()
    with load_export(path, comm) as model:
        K, M = to_dense(model.K), to_dense(model.M)
    for item in nastran_op4.contents(path, comm):
        if item.name in ("KAA", "MAA") and item.shape == K.shape:
            entries = nastran_op4.read_matrix(path, comm, item)
            local = np.zeros(entries.shape)
            np.add.at(local, (entries.rows, entries.columns), entries.values)
            content += block(item.name, comm.allreduce(local))
    comm.Barrier()
    alone = write(folder / "alone.op2", content, comm)
    with load_export(alone, comm) as model:
        assert model.dofs is not None and np.array_equal(to_dense(model.K), K) and np.array_equal(to_dense(model.M), M)
    with load_source(Source(str(alone), str(alone)), comm) as model:
        assert np.allclose(np.linalg.eigvalsh(to_dense(model.K)), np.linalg.eigvalsh(K), rtol=1e-9, atol=1e-3)


def test_matrices_with_the_input_file_beside_them(comm, folder):
    """KGG and MGG of the free plate, with nodes in a cylindrical system, by name of the input file."""
    unpack(folder, comm, "nastran/plate")
    names = {"K": "KGG", "M": "MGG"}
    with load_export(folder / "plate.OU1", comm, variables=names) as model:
        K, size = to_dense(model.K), model.size
    content = b""
    for file in ("plate.OU1", "plate.OU2"):
        for item in nastran_op4.contents(folder / file, comm):
            if item.name in names.values():
                entries = nastran_op4.read_matrix(folder / file, comm, item)
                local = np.zeros(entries.shape)
                np.add.at(local, (entries.rows, entries.columns), entries.values)
                content += block(item.name, comm.allreduce(local))
    path = write(folder / "free.op2", content, comm)
    with load_export(path, comm) as model:
        assert model.dofs is None and model.size == size
        assert any("the nodes are not known" in item for item in model.remarks)
    if comm.rank == 0:
        shutil.copy(folder / "plate.bdf", folder / "free.bdf")
    comm.Barrier()
    for file in (path, folder / "free.bdf"):
        with load_export(file, comm) as model:
            assert np.allclose(to_dense(model.K), K, rtol=0, atol=1e-12 * np.abs(K).max()) and model.dofs is not None


def test_damaged_matrices_are_refused(comm, folder):
    matrix = np.random.default_rng(3).standard_normal((6, 6))
    good = block("KGG", matrix) + block("MGG", matrix @ matrix.T)
    row = good.index(np.array([1], "<i4").tobytes() + matrix[0, :1].tobytes())
    for content, says in (
        (good[:-100], "damaged or cut off"),
        (block("KGG", matrix), "expected a stiffness and a mass matrix of one set"),
        (good.replace(np.array([101, 6, 6], "<i4").tobytes(), np.array([101, 7, 6], "<i4").tobytes(), 1),
         "found 6 columns of the matrix KGG, expected 7"),
        (good[:row] + np.array([2], "<i4").tobytes() + good[row + 4 :], "for the row 2 of column 1 of the matrix KGG"),
        (good, "KGG: found ||A - A^T||"),
    ):  # fmt: skip
        path = write(folder / "a.op2", content, comm)
        with pytest.raises(InputError) as error:
            load_export(path, comm)
        assert says in str(error.value)
        comm.Barrier()
