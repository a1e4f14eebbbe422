"""Files of other programs on the command line: convert, its table of formats, and info of any file."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from conftest import DATA
from helpers import refused, said, write_matrices

import hpcred as package
from hpcred.readers.registry import readers_of


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_format_is_in_the_table_with_what_tells_it(capsys):
    table = said(capsys, "convert", "--list-formats")
    rows = package.list_formats()
    assert len(rows) == len(readers_of("model")) + len(readers_of("matrix")) == 19
    assert all(row["format"] and row["told by"] for row in rows)
    assert "MATLAB .mat" in table and "CalculiX" in table and "%%MatrixMarket" in table


def test_convert_ends_with_a_check(capsys):
    """By options, as for Kratos; the last lines are for people, the JSON for scripts."""
    for name in ("K.mm.gz", "M.mm.gz", "nodes.txt", "dofs.txt"):
        shutil.copy(DATA / "kratos" / name, name)
    text = said(capsys, "convert", "-K", "K.mm.gz", "-M", "M.mm.gz", "--nodes", "nodes.txt", "--dofs", "dofs.txt",
                "model.h5", "--inputs", "99:z", "--json", "report.json")  # fmt: skip
    for expected in ("size 270", "masses in x y z kg 73.2667, 73.2667, 73.2667", "looks like m, kg, s", "a held body",
                     "M, K are symmetric", "extent m 0, 0, 0; 1, 0.1, 0.1", "the mass of 73.2667 is without theirs",
                     "export the body free"):  # fmt: skip
        assert expected in text
    report = json.loads(Path("report.json").read_text())
    assert report["held_dofs"] == 27 and report["units"] == "m, kg, s" and report["inputs"] == ["99:z"]
    again = said(capsys, "info", "model.h5")
    assert "held dofs 27" in again and "9 of 99 nodes have no row" in again and "the mass of 73.2667" in again


def test_outputs_of_their_own_and_a_damping_that_is_not_symmetric_are_said(capsys):
    write_matrices(lambda K, M: None)
    scipy.io.mmwrite("D.mtx", scipy.sparse.diags([[0.5, 0.0, 0.0]], [1]))
    matrices = ("-K", "K.mtx", "-M", "M.mtx", "-D", "D.mtx")
    text = said(capsys, "convert", *matrices, "m.h5", "--inputs", "1", "--outputs", "2,3")
    assert "inputs dof 1 outputs dof 2, dof 3" in text
    assert "not all of M, K, D are symmetric: max |a_ij - a_ji| / |a_ij| is D " in text


@pytest.mark.parametrize(
    "name, expected",
    [
        ("kratos/K.mm.gz", ["Matrix Market", "270 x 270, 12348 entries"]),
        ("kratos/nodes.txt", ["lines of node, x, y, z", "nodes 99"]),
        ("kratos/dofs.txt", ["lines of node, direction", "rows 270"]),
        ("matlab/nas2cam.mat", ["MATLAB .mat", "nas.kaa.k0 54 x 54 dense"]),
        ("blockC3D8.inp", ["Abaqus or CalculiX input file", "528 x 528, 27478 entries", "nodes 176", "hexahedron 90"]),
        ("blockC3D8_MASS1.mtx.gz", ["text lines of row, column, value", "528 x 528, 528 entries"]),
    ],
)
def test_info_says_what_any_file_is(capsys, name, expected):
    text = said(capsys, "info", str(DATA / name))
    assert all(part in text for part in expected), text


@pytest.mark.parametrize("first", ["ID WING,PLATE", "ASSIGN OUTPUT4='plate.op4',UNIT=102,DELETE"])
def test_info_of_an_input_file_that_begins_with_words_and_commas(capsys, first):
    """It is no table (.csv)."""
    Path("plate.bdf").write_text(f"{first}\nSOL 103\nCEND\nBEGIN BULK\nGRID,1,,0.,0.,0.\nENDDATA\n")
    assert "an input file of Nastran without matrices" in refused(capsys, "info", "plate.bdf")


def test_info_of_an_input_file_without_matrices(capsys):
    shutil.copy(DATA / "blockC3D8.inp", "b.inp")
    text = said(capsys, "info", "b.inp")
    assert "nodes 176" in text and "found no matrix K beside it" in text


def test_info_of_results(capsys):
    with package.linkage() as model, package.reduce(model, [package.Modes(count=3)], package.Buckens()) as rom:
        package.write_result("r.h5", rom, model)
    assert "format hpcred result coordinates 3" in said(capsys, "info", "r.h5")
    assert "convert it first" in refused(capsys, "info", "r.h5", "--below", "10")


def test_matrices_are_chosen_by_name(capsys):
    import scipy.io

    K = np.diag([2.0, 2, 2, 1]) - np.eye(4, k=1) - np.eye(4, k=-1)
    scipy.io.savemat("a.mat", {"nas": {"stiff_ness": K, "kaa": 2 * K}, "mass": np.eye(4)})
    assert "took K = nas.kaa" in said(capsys, "convert", "a.mat", "model.h5")
    said(capsys, "convert", "a.mat", "model.h5", "--variables", "K=nas.stiff_ness,M=mass")
    with package.read_model("model.h5") as model:
        assert model.K.getDiagonal().array.real.tolist() == [2, 2, 2, 1]
    said(capsys, "convert", "-K", "a.mat", "-M", "a.mat", "model.h5", "--variables", "K=nas.stiff_ness")
    with package.read_model("model.h5") as model:
        assert model.K.getDiagonal().array.real.tolist() == [2, 2, 2, 1]
    for text, says in (("K", "--variables: found 'K'"), ("Q=a", "found 'Q=a'"), ("K=", "found 'K='")):
        assert says in refused(capsys, "convert", "a.mat", "m.h5", "--variables", text)


def test_what_stands_beside_an_export_is_refused(capsys):
    write_matrices(lambda K, M: None)
    assert "--nodes belong to -K and -M only" in refused(
        capsys, "convert", str(DATA / "blockC3D8.inp"), "m.h5", "--nodes", "x.txt")  # fmt: skip
    assert "Matrix Market: give single matrices by -K and -M" in refused(capsys, "convert", "K.mtx", "m.h5")
    assert "none of the formats" in refused(capsys, "info", __file__)


@pytest.mark.parametrize(
    "nodes, dofs, says",
    [
        (None, "{d}", "found the nodes of the rows, but no coordinates; give --nodes"),
        ("{n}", "1 1\n1 2\n2 1\n", "found 3 lines, expected one for each of the 4 rows"),
        ("{n}", "1 1\n1 2\n2 1\n2 2\n3 1\n", "found 5 lines, expected one for each of the 4 rows"),
        ("{n}", "1 1\n1 2\n2 1\n2\n", "line 4: found '2', expected 2 numbers a line"),
        ("{n}", "1 1\n1 2\n2 1\n1 1\n", "found two rows of 1:x"),
        ("{n}", "1 1\n1 2\n2 1\n7 2\n", "the node 7, which has rows, has no coordinates"),
        ("1 0 0 0\n2 0 0\n", "{d}", "line 2: found '2 0 0', expected 4 numbers a line"),
        ("1 0 0 0\n1 1 0 0\n", "{d}", "found the node 1 more than once"),
        ("1 0 0 0\n2 1 0 0\n3 2 0 0\n", None, "found 3 nodes for 4 rows"),
        ("{d}", "{d}", "expected 4 numbers a line"),
        ("{n}", "{n}", "expected 2 numbers a line"),
    ],
)
def test_nodes_and_dofs_that_do_not_belong_to_the_rows(capsys, nodes, dofs, says):
    good = {"n": "1 0 0 0\n2 1 0 0\n", "d": "1 1\n1 2\n2 1\n2 2\n"}
    write_matrices(lambda K, M: None)
    arguments = []
    for option, text in (("--nodes", nodes), ("--dofs", dofs)):
        if text is not None:
            Path(f"{option[2:]}.txt").write_text(text.format(**good))
            arguments += [option, f"{option[2:]}.txt"]
    assert says in refused(capsys, "convert", "-K", "K.mtx", "-M", "M.mtx", "model.h5", *arguments)


def test_inputs_may_be_columns_of_a_file():
    """As in a job; names are those of the file."""
    write_matrices(lambda K, M: None)
    size = scipy.io.mmread("K.mtx").shape[0]
    columns = np.arange(2.0 * size).reshape(size, 2)
    scipy.io.mmwrite("B.mtx", scipy.sparse.coo_array(columns))
    report = package.convert(package.settings.Source(K="K.mtx", M="M.mtx"), "m.h5", inputs="B.mtx")
    assert len(report["inputs"]) == 2
    with package.read_model("m.h5") as model:
        assert np.array_equal(model.B.getDenseArray().real, columns)


def test_viscoelastic_parts_of_an_iterator_are_not_lost():
    from hpcred.settings.declared_terms import DeclaredTerms, viscoelastic_from

    law = {"kind": "maxwell", "factors": [0.5], "times": [1e-3]}
    terms = DeclaredTerms(viscoelastic=iter(viscoelastic_from([{"file": "Kv.mtx", "law": law}])))
    assert terms.files == ["Kv.mtx"] and len(terms.viscoelastic) == 1
