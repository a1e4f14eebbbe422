"""Files of other programs become a model."""

import gzip

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from conftest import DATA
from foreign import gathered, write
from helpers import columns_of

import hpcred
from hpcred import Buckens, Modes
from hpcred.readers.input_file import abaqus_source
from hpcred.readers.model_source import load_export, load_source
from hpcred.settings.source import Source

pytestmark = pytest.mark.mpi


BLOCKS = {"blockC3D8": [438.775, 438.775, 555.888, 967.04], "blockC3D10": [451.333, 452.01, 607.87, 1026.459]}


@pytest.mark.parametrize("name", BLOCKS)
def test_block_of_abaqus(comm, folder, name):
    """Real matrices: mass and frequencies as the program that wrote them gave."""
    with load_source(abaqus_source(DATA / f"{name}.inp"), comm) as model:
        hpcred.write_model(folder / "model.h5", model)
    with hpcred.read_model(folder / "model.h5", comm) as model:
        report = hpcred.inspect(model)
        assert report["mass_kg"] == pytest.approx(11600)
        assert report["rigid_body_modes"] == 6
        assert np.allclose(report["centre_of_mass_m"], [2, 0.5, 0.5])
        model = model.with_inputs([(1, "x"), (20, "y")])
        for basis in ([Modes(count=4)], [Modes(band=(0.0, 1027.0))]):
            with hpcred.reduce(model, basis, Buckens()) as rom:
                assert np.allclose(rom.frequencies[:4], BLOCKS[name], atol=6e-4)


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
    with load_source(source, comm) as model:
        labels = comm.allgather((model.dofs.node, model.dofs.direction, model.dofs.position))
        node, direction, position = (np.concatenate(part) for part in zip(*labels, strict=True))
        assert list(zip(node, direction + 1, strict=True)) == rows
        assert np.array_equal(position, [nodes[n] for n, _ in rows])
        model = model.with_inputs([(30, "z")])
        assert columns_of(model.B)[:, 0].tolist() == [0, 1, 0, 0, 0, 0, 0, 0]
        with pytest.raises(hpcred.InputError, match="no dof in direction y; it has x, z"):
            model = model.with_inputs([(30, "y")])


def test_an_export_is_told_by_its_first_bytes(comm, folder):
    with load_export(DATA / "blockC3D8.inp", comm) as model:
        assert model.size == 528 and comm.allreduce(len(model.elements["hexahedron"])) == 90
    with pytest.raises(hpcred.InputError, match="expected .*an Abaqus or CalculiX input file with"):
        load_export(write(folder / "a.inp", "1 2 3\n", comm), comm)


@pytest.mark.parametrize(
    "sizes, says", [("999999999999 999999999999 3", "found 999999999999 rows and 6 entries"), ("0 0 0", "without rows")]
)
def test_sizes_of_a_damaged_header_are_refused(comm, folder, sizes, says):
    """Before anything is made of that length."""
    lines = "".join(f"{k} {k} 1.0\n" for k in range(1, int(sizes[-1]) + 1))
    K = write(folder / "K.mtx", f"%%MatrixMarket matrix coordinate real general\n{sizes}\n{lines}", comm)
    with pytest.raises(hpcred.InputError, match=says):
        load_source(Source(str(K), str(K)), comm)


@pytest.mark.parametrize("half, side", [(np.tril, "below"), (np.triu, "above")])
@pytest.mark.parametrize("suffix", ["npz", "mat"])
def test_one_triangle_alone_is_refused(comm, folder, half, side, suffix):
    """Of a format that cannot say that it is one half of a symmetric matrix."""
    K, M = scipy.sparse.csr_matrix(half(np.full((6, 6), -1.0) + 7 * np.eye(6))), scipy.sparse.identity(6, format="csr")
    if comm.rank == 0:
        scipy.io.savemat(folder / "a.mat", {"K": K, "M": M})
        scipy.sparse.save_npz(folder / "K.npz", K)
        scipy.sparse.save_npz(folder / "M.npz", M)
    comm.Barrier()
    with pytest.raises(hpcred.InputError, match=f"found entries {side} the diagonal only, expected both triangles"):
        if suffix == "mat":
            load_export(folder / "a.mat", comm)
        else:
            load_source(Source(K=str(folder / "K.npz"), M=str(folder / "M.npz")), comm)


def test_a_last_line_without_end_is_warned_of(comm, folder):
    """1.25 may be what is left of 1.257; a file that ends with a line break is whole."""
    if comm.rank == 0:
        for key in "KM":
            (folder / f"{key}.txt").write_text("1 1 1.0\n2 2 1.25" + "\n" * (key == "K"))
    comm.Barrier()
    ranks = comm.Split(comm.rank // 2)
    with load_source(Source(*(str(folder / f"{key}.txt") for key in "KM")), ranks) as model:
        (doubt,) = [sentence for sentence in model.remarks if "line break" in sentence]
    assert doubt.startswith(str(folder / "M.txt"))


def test_rows_without_coordinates_are_refused(comm, folder):
    K = write(folder / "K.mtx", "".join(f"{k} {k} 1.0\n" for k in range(1, 7)), comm)
    nodes = write(folder / "nodes.txt", "1 0 0 0\n2 1 0 0\n", comm)
    dofs = write(folder / "dofs.txt", "1 1\n1 2\n1 3\n2 1\n2 2\n3 3\n", comm)
    with pytest.raises(hpcred.InputError, match="the node 3, which has rows, has no coordinates"):
        load_source(Source(str(K), str(K), nodes=str(nodes), dofs=str(dofs)), comm)
    dofs = write(folder / "dofs.txt", "1 1\n1 2\n", comm)
    with pytest.raises(hpcred.InputError, match="found 2 lines, expected one for each of the 6 rows"):
        load_source(Source(str(K), str(K), nodes=str(nodes), dofs=str(dofs)), comm)
    nodes = write(folder / "nodes.txt", "1 0 0 0\n2 1 0 0\n3 0 0 0\n4 0 0 0\n", comm)
    with pytest.raises(hpcred.InputError, match="found 4 nodes for 6 rows"):
        load_source(Source(str(K), str(K), nodes=str(nodes)), comm)


def test_a_packed_node_table_keeps_its_order(comm, folder, monkeypatch):
    monkeypatch.setattr("hpcred.files.text.PIECE", 16)
    K = write(folder / "K.mtx", "".join(f"{k} {k} 1.0\n" for k in range(1, 121)), comm)
    lines = "".join(f"{n} {n} 0 0\n" for n in range(40, 0, -1))
    nodes = write(folder / "nodes.txt.gz", gzip.compress(lines.encode()), comm)
    with load_source(Source(str(K), str(K), nodes=str(nodes)), comm) as model:
        node, position = gathered(comm, model.dofs.node, model.dofs.position)
    assert np.array_equal(node, np.repeat(np.arange(40, 0, -1), 3)) and np.array_equal(position[:, 0], node)


@pytest.mark.parametrize("number", ["nan", "inf", "1e400", "-1e61"])
def test_what_is_no_number_is_refused(comm, folder, number):
    """Also on the diagonal of K, where a number from 1e35 on is a support."""
    head = "%%MatrixMarket matrix coordinate real general\n"
    square = head + "3 3 3\n1 1 1.0\n2 2 1.0\n3 3 1.0\n"
    write(folder / "K.mtx", square, comm)
    write(folder / "B.mtx", f"{head}3 1 1\n1 1 {number}\n", comm)
    write(folder / "bad.mtx", square.replace("3 3 1.0", f"3 3 {number}"), comm)
    with pytest.raises(hpcred.InputError):
        load_source(Source(folder / "bad.mtx", folder / "K.mtx"), comm)
    with pytest.raises(hpcred.InputError, match="B.mtx.* found the value|B.mtx, line 3"):
        load_source(Source(folder / "K.mtx", folder / "K.mtx", B=folder / "B.mtx"), comm)


def test_more_columns_than_dofs(comm, folder):
    head = "%%MatrixMarket matrix coordinate real general\n"
    for key, columns in (("K", 3), ("B", 99999999999999999999)):
        write(folder / f"{key}.mtx", f"{head}3 {columns} 3\n1 1 1.0\n2 2 1.0\n3 3 1.0\n", comm)
    with pytest.raises(hpcred.InputError, match="B.mtx: found 9{20} columns for a model of 3 dofs"):
        load_source(Source(*[str(folder / "K.mtx")] * 2, B=str(folder / "B.mtx")), comm)
