"""Texts of *MATRIX OUTPUT in both forms."""

import numpy as np
import pytest
from foreign import assembled, gathered, write
from helpers import to_dense

from hpcred import InputError
from hpcred.readers.abaqus.matrices import files_beside
from hpcred.readers.matrix_formats import read_entries
from hpcred.readers.model_source import load_source
from hpcred.settings.source import Source

pytestmark = pytest.mark.mpi

ROWS = [(2, 1), (2, 2), (5, 1), (5, 3), (30, 1)]  # node, dof in the order that the rows must have
RNG = np.random.default_rng(3)
ROOT = RNG.standard_normal((5, 5))
K, M = ROOT @ ROOT.T + np.eye(5), np.diag(RNG.uniform(1, 2, 5))
NODES = {2: (0.0, 1.0, 2.0), 5: (3.0, 4.0, 5.0), 30: (6.0, 7.0, 8.0), 31: (9.0, 9.0, 9.0)}


def matrix_input(matrix, keep):
    """Lines of node, dof, node, dof, value of the entries where keep(i, j), in an order of no meaning."""
    lines = [
        f"{ROWS[i][0]},{ROWS[i][1]}, {ROWS[j][0]},{ROWS[j][1]}, {matrix[i, j]!r}\n".replace("np.float64(", "")
        for i in range(5) for j in range(5) if matrix[i, j] and keep(i, j)
    ]  # fmt: skip
    return "".join(lines[k] for k in np.random.default_rng(1).permutation(len(lines))).replace(")", "")


@pytest.mark.parametrize(
    "keep",
    [lambda i, j: i >= j, lambda i, j: i <= j, lambda i, j: True,
     lambda i, j: (i <= j) == ((i + j) % 2 == 0) or i == j],
    ids=["lower", "upper", "both", "one triangle in another order"],
)
def test_five_numbers_a_line_are_node_dof_node_dof_value(comm, folder, keep):
    files = {key: str(write(folder / f"{key}.mtx", matrix_input(mat, keep), comm))
             for key, mat in (("K", K), ("M", M))}  # fmt: skip
    lines = "".join(f"{n}, {x}, {y}, {z}\n" for n, (x, y, z) in NODES.items())
    nodes = write(folder / "block.inp", f"*Node\n{lines}", comm)
    with load_source(Source(**files, nodes=str(nodes)), comm) as model:
        assert np.array_equal(to_dense(model.K), K) and np.array_equal(to_dense(model.M), M)
        parts = comm.allgather((model.dofs.node, model.dofs.direction, model.dofs.position))
        node, direction, position = (np.concatenate(part) for part in zip(*parts, strict=True))
        assert list(zip(node, direction + 1, strict=True)) == ROWS
        assert np.array_equal(position, [NODES[n] for n, _ in ROWS])
    with load_source(Source(**files), comm) as model:
        assert model.dofs is None and np.array_equal(to_dense(model.K), K)


def test_an_unsymmetric_matrix_stays_so(comm, folder):
    path = write(folder / "D.mtx", "1,1,1,1,1.\n1,1,1,2,2.\n1,2,1,1,3.\n1,2,1,2,4.\n", comm)
    entries = read_entries(path, comm)
    found = dict(zip(zip(entries.rows.tolist(), entries.columns.tolist(), strict=True), entries.values, strict=True))
    together = {}
    for part in comm.allgather(found):
        together |= part
    assert together == {(16, 16): 1, (16, 17): 2, (17, 16): 3, (17, 17): 4}


@pytest.mark.parametrize(
    "content, says",
    [
        ("1,1,1,1\n", "of 4 numbers, expected row, column, value or node, dof, node, dof, value"),
        ("1 1 1 1 1 1\n", "of 6 numbers"),
        ("1,1,1,1,2.\n1,7,1,7,1.\n", "line 2: found '1,7,1,7,1.', expected the dof"),
        ("1,1,1,1,2.\n1,0,1,1,1.\n", "line 2: found '1,0,1,1,1.', expected the dof"),
        ("1,1,1,1,2.\n-3,1,1,1,1.\n", "Abaqus' own"),
        ("1,1,1,1,2.\n1.5,1,1,1,1.\n", "expected the node number as a whole number"),
        ("1,1,1,1,2.\n99999999999,1,1,1,1.\n", "expected the node number as a whole number of 1 to 2147483647"),
        ("1,1,1,1,2.\n1,1,1,2\n", "line 2: found '1,1,1,2', expected 5 numbers a line"),
        ("1,1,1,1,2.\n1,1,,2,5.\n", "line 2: found '1,1,,2,5.', expected a number between two commas"),
        ("1,1,1,1,2.\n1,1,1,,2,5.\n", "line 2: found '1,1,1,,2,5.', expected a number between two commas"),
        ("1,1,2.\n2,2,,3.\n", "line 2: found '2,2,,3.', expected a number between two commas"),
        ("%%MatrixMarkex matrix coordinate real general\n2 2 2\n1 1 1.0\n2 2 1.0\n", "line 1: found '%%MatrixMarkex"),
        ("2 2 2\n%%MatrixMarket matrix coordinate real general\n1 1 1.0\n2 2 1.0\n", "line 2: found '%%MatrixMarket"),
        ("1 1\x1b[31m 2.0\n", "found '1 1 [31m 2.0'"),
        ("1 1 2.0\n-24 1 3.0\n", "line 2: found '-24 1 3.0', expected the row number"),
        ("1 1 2.0\n2 1 3.0\n", "found entries below the diagonal only"),
        ("2 2 4\n1 1 2.0\n2 1 3.0\n1 2 3.0\n2 2 4.0\n", "of a Matrix Market file without its header"),
        ("1 1 2.0\n1.5 2 3.0\n", "expected the row number as a whole number"),
    ],
)
def test_matrix_texts_that_cannot_be_are_refused(comm, folder, content, says):
    path = write(folder / "K.mtx", content, comm)
    with pytest.raises(InputError) as error:
        assembled(path, comm)
    assert says in str(error.value) and str(path) in str(error.value)


def test_numbered_and_labelled_matrices_do_not_mix(comm, folder):
    labelled, numbered = write(folder / "K.mtx", "1,1,1,1,2.\n", comm), write(folder / "M.mtx", "1 1 2.\n", comm)
    with pytest.raises(InputError, match="M.mtx: found numbered rows, but .*K.mtx names node and dof"):
        load_source(Source(str(labelled), str(numbered)), comm)


@pytest.mark.parametrize("underscore", ["", "_"])
def test_files_with_and_without_underscore(comm, folder, underscore):
    for name in ("STIF3.mtx", "MASS3.mtx.gz", "DMPV3.mtx"):
        write(folder / f"x{underscore}{name}", "", comm)
    write(folder / "xyz_STIF1.mtx", "", comm)
    found = files_beside(folder / "x.inp")
    assert {key: path.rsplit("x", 1)[0] + "x" + path.rsplit("x", 1)[1] for key, path in found.items()} == found
    assert sorted(found) == ["D", "K", "M"] and found["K"] == str(folder / f"x{underscore}STIF3.mtx")


@pytest.mark.parametrize(
    "names, says",
    [
        (["_STIF1.mtx"], "found no matrix M beside it, expected .*x_MASS1.mtx"),
        (["_STIF1.mtx", "_MASS1.mtx", "_STIF2.mtx", "_MASS2.mtx"], "matrices of the steps 1, 2 beside it"),
        (["_STIF1.mtx", "_MASS1.mtx", "_DMPS1.mtx"], "found a matrix of structural damping"),
    ],
)
def test_files_that_are_not_one_set_are_refused(comm, folder, names, says):
    for name in names:
        write(folder / f"x{name}", "", comm)
    with pytest.raises(InputError, match=says):
        files_beside(folder / "x.inp")


@pytest.mark.parametrize("named", [True, False], ids=["node, dof", "numbered"])
def test_supports_of_1e36_are_removed_and_named(comm, folder, named):
    """What is left are K and M without the held rows; the held node keeps its place."""
    held = [1, 4]  # 2:y and 30:x
    penalised = K + np.diag([0, 1e36, 0, 0, 1e36])
    text = {}
    for key, mat in (("K", penalised), ("M", M)):
        lines = "".join(f"{i + 1} {j + 1} {float(mat[i, j])!r}\n" for i in range(5) for j in range(5))
        text[key] = matrix_input(mat, lambda i, j: i >= j) if named else lines
    files = {key: str(write(folder / f"{key}.mtx", lines, comm)) for key, lines in text.items()}
    free = np.delete(np.arange(5), held)
    expected = K[np.ix_(free, free)], M[np.ix_(free, free)]
    with load_source(Source(**files), comm) as model:
        assert np.array_equal(to_dense(model.K), expected[0]) and np.array_equal(to_dense(model.M), expected[1])
        assert "removed 2 rows that are held by 1e+36 on the diagonal of K" in model.remarks[0]
        assert model.remarks[0].endswith("2:y, 30:x" if named else "have new numbers: 2, 5")
    comm.Barrier()
    coupled = penalised + np.eye(5, k=1) * [0, 1e70, 0, 0, 0] + np.eye(5, k=-1) * [0, 1e70, 0, 0, 0]
    entries = matrix_input(coupled, lambda i, j: i >= j) if named else "".join(
        f"{i + 1} {j + 1} {float(coupled[i, j])!r}\n" for i in range(5) for j in range(5))
    beyond = files | {"K": str(write(folder / "beyond.mtx", entries, comm))}
    with pytest.raises(InputError, match="found the value 1e.70 in a real matrix"):
        load_source(Source(**beyond), comm).close()
    lines = "".join(f"{n} {x} {y} {z}\n" for n, (x, y, z) in NODES.items() if n != 31)
    nodes = write(folder / "nodes.txt", lines, comm)
    dofs = write(folder / "dofs.txt", "".join(f"{n} {d}\n" for n, d in ROWS), comm)
    with load_source(Source(**files, nodes=str(nodes), dofs=None if named else str(dofs)), comm) as model:
        assert np.array_equal(to_dense(model.K), expected[0])
        node, direction = gathered(comm, model.dofs.node, model.dofs.direction)
        assert list(zip(node, direction + 1, strict=True)) == [ROWS[k] for k in free]
        node, direction, position = gathered(comm, model.held.node, model.held.direction, model.held.position)
        assert set(zip(node, direction + 1, strict=True)) == {ROWS[k] for k in held}
        assert {n: tuple(p) for n, p in zip(node, position, strict=True)} == {n: NODES[n] for n in (2, 30)}


def test_element_matrices_are_refused(comm, folder):
    """Of single elements, as Abaqus writes them in two ways."""
    path = write(folder / "K.mtx", "** ELEMENT NUMBER 1\n*USER ELEMENT, NODES=8, LINEAR\n", comm)
    with pytest.raises(InputError, match="keywords such as '.USER ELEMENT, NODES=8, LINEAR' .*Matrix Generate"):
        assembled(path, comm)
    path = write(folder / "K.mtx", "1, 1, 1, 1, 1, 2.0\n1, 1, 1, 1, 2, 3.0\n", comm)
    with pytest.raises(InputError, match="of 6 numbers, as of matrices element by element"):
        assembled(path, comm)
