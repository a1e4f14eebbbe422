"""Files of other programs, model and result files."""

import gzip

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse
from conftest import DATA
from helpers import columns_of, gather, to_dense

import hpcred
from hpcred import Buckens, Krylov, Modes
from hpcred.formats.hdf5 import writing
from hpcred.formats.matrix_formats import read_entries
from hpcred.formats.text import pieces
from hpcred.parallel.petsc import PETSc, is_complex
from hpcred.workflows.convert import Source, abaqus_source

pytestmark = pytest.mark.mpi


def assembled(path, comm):
    """A file as dense matrix on all ranks."""
    entries = read_entries(path, comm)
    local = np.zeros(entries.shape)
    np.add.at(local, (entries.rows, entries.columns), entries.values)
    return comm.allreduce(local)


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


def test_every_line_is_read_once_wherever_the_pieces_are_cut(folder, comm, monkeypatch):
    lines = [f"{k} {'x' * (k % 7)}\n".encode() for k in range(200)]
    if comm.rank == 0:
        (folder / "lines.txt").write_bytes(b"".join(lines))
        with gzip.open(folder / "lines.txt.gz", "wb") as file:
            file.write(b"".join(lines))
    comm.Barrier()
    for size in (1, 7, 64, 10**6):
        monkeypatch.setattr("hpcred.formats.text.PIECE", size)
        plain = sum(comm.allgather([line for piece in pieces(folder / "lines.txt", comm)
                                    for line in piece.text.splitlines(True)]), [])  # fmt: skip
        assert plain == lines
        packed = sum(comm.allgather([line for piece in pieces(folder / "lines.txt.gz", comm)
                                     for line in piece.text.splitlines(True)]), [])  # fmt: skip
        assert sorted(packed) == sorted(lines)


BLOCKS = {"blockC3D8": [438.775, 438.775, 555.888, 967.04], "blockC3D10": [451.333, 452.01, 607.87, 1026.459]}


@pytest.mark.parametrize("name", BLOCKS)
def test_block_of_abaqus(comm, folder, name):
    """Real matrices: mass and frequencies as the program that wrote them gave."""
    with hpcred.convert(abaqus_source(DATA / f"{name}.inp"), comm) as model:
        hpcred.write_model(folder / "model.h5", model)
    with hpcred.read_model(folder / "model.h5", comm) as model:
        report = hpcred.inspect(model)
        assert report["mass_kg"] == pytest.approx(11600)
        assert report["rigid_body_modes"] == 6
        assert np.allclose(report["centre_of_mass_m"], [2, 0.5, 0.5])
        model.set_inputs([(1, "x"), (20, "y")])
        for basis in ([Modes(count=4)], [Modes(band=(0.0, 1027.0))]):
            with hpcred.reduce(model, basis, Buckens()) as rom:
                assert np.allclose(rom.frequencies[:4], BLOCKS[name], atol=6e-4)


def test_model_file_keeps_everything(comm, folder):
    with hpcred.linkage(comm) as model:
        model.set_inputs([(20, "z"), (1, "rx")])
        model.set_outputs([(5, "y")])
        K, M, B = to_dense(model.K), to_dense(model.M), columns_of(model.B)
        hpcred.write_model(folder / "a.h5", model)
    with hpcred.read_model(folder / "a.h5", comm) as model:
        for mat, expected in ((model.K, K), (model.M, M)):
            assert np.array_equal(to_dense(mat), expected)
        assert np.array_equal(columns_of(model.B), B)
        assert model.input_names == ["20:z", "1:rx"] and model.output_names == ["5:y"]
        assert columns_of(model.Ct)[25 + 0, 0] == 1.0 or columns_of(model.Ct).sum() == 1.0
        assert (model.dofs.node == (np.arange(120) // 6 + 1)[model.first_row :][: model.local_rows]).all()


def test_result_file_keeps_everything(comm, folder):
    with hpcred.linkage(comm) as model, hpcred.reduce(model, [Krylov(50.0, 2)], Buckens()) as rom:
        hpcred.write_result(folder / "r.h5", rom, model.dofs, comm=comm)
        V = gather(rom.columns)
        read = hpcred.read_result(folder / "r.h5", comm)
        for key in ("M", "D", "K", "B", "C", "frequencies"):
            assert np.array_equal(getattr(read, key), getattr(rom, key))
        assert read.record.ranks == comm.size
        assert read.record.factorisations[0].residual < 1e-9
        with h5py.File(folder / "r.h5", "r") as file:
            assert np.array_equal(file["basis/V"][...], V.T)
        hpcred.write_result(folder / "small.h5", rom, basis=False, comm=comm)
        with h5py.File(folder / "small.h5", "r") as file:
            assert "basis" not in file


def test_a_failed_write_leaves_the_old_file(comm, folder):
    if comm.rank == 0:
        (folder / "r.h5").write_text("old")
    comm.Barrier()
    with pytest.raises(RuntimeError), writing(folder / "r.h5", comm) as file:
        file.attribute("format", "half")
        raise RuntimeError
    comm.Barrier()
    assert (folder / "r.h5").read_text() == "old"
    assert [path.name for path in folder.iterdir()] == ["r.h5"]


def test_nodes_in_any_order_and_dofs_with_gaps(comm, folder):
    """Rows that name their node and direction; node 30 has lost its y."""
    nodes = {10: (0.0, 0.0, 1.0), 30: (2.0, 0.0, 0.0), 20: (0.0, 3.0, 0.0)}
    rows = [(n, d) for n in (30, 10, 20) for d in (1, 2, 3) if (n, d) != (30, 2)]
    K = np.diag(np.arange(1.0, 9.0))
    if comm.rank == 0:
        for key in "KM":
            scipy.io.mmwrite(folder / f"{key}.mtx", scipy.sparse.coo_matrix(K), symmetry="symmetric")
        (folder / "nodes.txt").write_text("".join(f"{n} {x} {y} {z}\n" for n, (x, y, z) in nodes.items()))
        (folder / "dofs.txt").write_text("# node, direction\n" + "".join(f"{n}, {d}\n" for n, d in rows))
    comm.Barrier()
    source = Source(*(str(folder / f) for f in ("K.mtx", "M.mtx")), nodes=str(folder / "nodes.txt"),
                    dofs=str(folder / "dofs.txt"))  # fmt: skip
    with hpcred.convert(source, comm) as model:
        labels = comm.allgather((model.dofs.node, model.dofs.direction, model.dofs.position))
        node, direction, position = (np.concatenate(part) for part in zip(*labels, strict=True))
        assert list(zip(node, direction + 1, strict=True)) == rows
        assert np.array_equal(position, [nodes[n] for n, _ in rows])
        model.set_inputs([(30, "z")])
        assert columns_of(model.B)[:, 0].tolist() == [0, 1, 0, 0, 0, 0, 0, 0]
        with pytest.raises(hpcred.InputError, match="no dof in direction y; it has x, z"):
            model.set_inputs([(30, "y")])
