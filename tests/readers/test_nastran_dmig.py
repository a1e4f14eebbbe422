"""DMIG cards: small, large and free fields, halves, scalar points; what is damaged is refused."""

import numpy as np
import pytest
from foreign import gathered, write
from helpers import to_dense

from hpcred import InputError
from hpcred.fe.dofs import DIRECTIONS, SCALAR
from hpcred.files import text as text_module
from hpcred.readers.model_source import load_export, load_source
from hpcred.readers.nastran import dmig as nastran_dmig
from hpcred.settings.source import Source

pytestmark = pytest.mark.mpi

K = np.array([[4.0, -1, 0.5], [-1, 3, 0], [0.5, 0, 2]])  # node 1 x, node 1 rz, scalar point 9
M = np.diag([1.0, 2, 3])
LARGE = """DMIG    KAAX           0       6       2       0                       3
DMIG*   KAAX                           1               1
*                      1               1 4.000000000D+00
DMIG*   KAAX                           1               6
*                      1               1-1.000000000D+00
*                      1               6 3.000000000D+00
DMIG*   KAAX                           9               0
*                      1               1 5.000000000D-01
*                      9               0 2.000000000D+00
DMIG    MAAX           0       6       2       0                       3
DMIG*   MAAX                           1               1
*                      1               1 1.000000000D+00
DMIG*   MAAX                           1               6
*                      1               6 2.000000000D+00
DMIG*   MAAX                           9               0
*                      9               0 3.000000000D+00
"""
WIDE = LARGE.replace(  # with large fields in the first card too, as pyNastran writes it
    "DMIG    KAAX           0       6       2       0                       3", f"""DMIG*   KAAX{0:28d}{6:16d}{2:16d}
*      {0:17d}{0:16d}{3:32d}"""
)
FREE = """DMIG,KAAX,0,6,2,0,,,3
DMIG,KAAX,1,1,,1,1,4.
DMIG,KAAX,1,6,,1,1,-1.
,1,6,3.
DMIG,KAAX,9,,,1,1,.5,,
,9,,2.
DMIG,MAAX,0,6,2,0
DMIG,MAAX,1,1,,1,1,1.
DMIG,MAAX,1,6,,1,6,2.
DMIG,MAAX,9,0,,9,0,3.+0
"""
SMALL = """$ both halves of a square matrix
DMIG    K2GG    0       1       2       0                       3
DMIG    K2GG    1       1               1       1       4.
        1       6       -1.             9               .5
DMIG    K2GG    1       6               1       6       3.
        1       1       -1.
DMIG    K2GG    9       0               9       0       2.
        1       1       .5
DMIG    M2GG    0       6       1       0
DMIG    M2GG    1       1               1       1       1.
DMIG    M2GG    1       6               1       6       2.
DMIG    M2GG    9       0               9       0       3.
"""


@pytest.mark.parametrize("text", [LARGE, WIDE, FREE, SMALL, LARGE.replace("\n", "\r\n"), FREE.replace(",", "\t")])
def test_forms_of_cards(comm, folder, monkeypatch, text):
    monkeypatch.setattr(text_module, "PIECE", 100)
    path = write(folder / "a.pch", text, comm)
    with load_export(path, comm) as model:
        assert model.dofs is None and np.array_equal(to_dense(model.K), K) and np.array_equal(to_dense(model.M), M)
    write(folder / "a.bdf", "GRID,1,,1.,2.,3.\nSPOINT,9\nGRID,5\n", comm)
    with load_export(path, comm) as model:
        node, direction, position = gathered(comm, model.dofs.node, model.dofs.direction, model.dofs.position)
        assert node.tolist() == [1, 1, 9] and direction.tolist() == [0, 5, SCALAR]
        assert np.array_equal(position, [[1, 2, 3], [1, 2, 3], [0, 0, 0]]) and DIRECTIONS[SCALAR] == "scalar"
        assert np.array_equal(to_dense(model.K), K)


def test_nodes_in_the_punch_file_itself(comm, folder):
    path = write(folder / "a.pch", "BEGIN BULK\nGRID,1,,1.,2.,3.\nSPOINT,9\n" + LARGE + "ENDDATA", comm)
    with load_export(path, comm) as model:
        assert np.array_equal(to_dense(model.K), K) and model.dofs is not None


def test_single_matrices_by_name(comm, folder):
    path = write(folder / "a.pch", LARGE.replace("MAAX", "MASS"), comm)
    for key, expected in (("K", 4.0), ("M", 1.0)):
        entries = nastran_dmig.read(path, comm, key)
        i, j, v = gathered(comm, entries.rows, entries.columns, entries.values)
        assert v[(i == 16) & (j == 16)].tolist() == [expected]
    with load_source(Source(str(path), str(path)), comm) as model:
        assert np.array_equal(to_dense(model.K), K)
    with pytest.raises(InputError, match="found the matrices KAAX, MASS, but none that is K = KGG"):
        nastran_dmig.read(path, comm, "K", {"K": "KGG"})


def test_the_digits_are_said(comm, folder):
    path = write(folder / "a.pch", LARGE, comm)
    wanted = dict(zip("KM", nastran_dmig.contents(path, comm), strict=True))
    (sentence,) = nastran_dmig.read_matrices(path, comm, wanted)[1]
    assert "the numbers have 10 digits" in sentence and "rigid-body modes" in sentence


CUT = LARGE.index("DMIG*   KAAX                           9")


@pytest.mark.parametrize(
    "damage, says",
    [
        (lambda t: t[:-8], "without an end; the file is cut off"),
        (lambda t: t + "     ", "the last line of 5 blanks without an end; the file is cut off"),
        (lambda t: t + "$ nothing", "the last line '$ nothing' without an end; the file is cut off"),
        (lambda t: t + "*", "the last line '*' without an end; the file is cut off"),
        (lambda t: t[:CUT], "expected a stiffness and a mass matrix"),
        (lambda t: t[:CUT] + t[t.index("DMIG    MAAX") :], "found 2 columns of the matrix KAAX, expected 3"),
        (lambda t: t.replace("1-1.0", "1 1,0"), "in"),
        (lambda t: t.replace("-1.000000000D+00", "-1.00000000xD+00"), "line 5: "),
        (lambda t: t.replace("-1.000000000D+00", " " * 16), "node, direction and value of an entry"),
        (lambda t: t.replace("6 3.000", "7 3.000"), "the direction of a row, a whole number of 0 to 6"),
        (lambda t: t.replace(" 1               6 3", "-1               6 3"), "the node of"),
        (lambda t: t.replace("DMIG*   KAAX                           1               6", "DMIG*   KAAY"
                             "                           1               6"), "found DMIG cards of 'KAAY'"),
        (lambda t: t.replace("DMIG*   MAAX                           1               6", "DMIG(   MAAX"
                             "                           1               6"), "cards"),
        (lambda t: t.replace("DMIG    KAAX           0       6", "DMIG    KAAX           0       2"), "form 2"),
        (lambda t: t.replace("DMIG    KAAX           0       6       2", "DMIG    KAAX           0       6       4")
         .replace("4.000000000D+00", "4.000000000D+00 1.000000000D+00"), "found the complex matrix KAAX"),
        (lambda t: t.replace("4.000000000D+00", "4.000000000D+00 1.000000000D+00"), "no imaginary part"),
        (lambda t: t.replace("*                      1               6 3", "*                      1               1-1"
                             ".000000000D+00\n*                      1               6 3"), None),
    ],
)  # fmt: skip
def test_damaged_cards_are_refused(comm, folder, damage, says):
    text = damage(LARGE)
    assert text != LARGE
    path = write(folder / "a.pch", text, comm)
    if says is None:  # entries at one place are summed, as everywhere
        return
    with pytest.raises(InputError) as error:
        load_export(path, comm)
    assert says in str(error.value) and str(path) in str(error.value)


@pytest.mark.parametrize("piece", [60, 2**19])
def test_nothing_but_remarks_stands_behind_the_end(comm, folder, monkeypatch, piece):
    monkeypatch.setattr(text_module, "PIECE", piece)
    for end in ("ENDDATA", " enddata,\r\n", "ENDDATA 4e9d3b64\n\n", "ENDDATA $ x\n$ y\n  \n$ z"):
        with load_export(write(folder / "a.pch", LARGE + end, comm), comm) as model:
            assert np.array_equal(to_dense(model.K), K)
        comm.Barrier()
    for end in ("ENDDATA xyz", "ENDDATA 5.", "ENDDATADMIG\n", "ENDDATA\nxyz", "ENDDATA\n$ x\n  5.", " ENDDATA\n5.\n",
                "ENDDATA\nGRID,1,,1.", "ENDDATA\n" + LARGE[LARGE.index("DMIG    MAAX") :]):  # fmt: skip
        with pytest.raises(InputError, match="expected nothing behind ENDDATA"):
            load_export(write(folder / "a.pch", LARGE + end, comm), comm)
        comm.Barrier()


DECK = "GRID,1,,1.,2.,3.\nSPOINT,9\nGRID,5\nSPC1,1,2345,1\nSPC1,1,123456,5\n"


def test_columns_of_supports_may_be_counted(comm, folder):
    """Simcenter Nastran says the number of all dofs, here 13, where supports leave three."""
    text = LARGE.replace(f"{3:24d}", f"{13:24d}")
    path = write(folder / "a.pch", text, comm)
    with load_export(path, comm) as model:
        assert np.array_equal(to_dense(model.K), K)
    write(folder / "a.bdf", DECK, comm)
    with load_export(path, comm) as model:
        assert np.array_equal(to_dense(model.K), K) and np.array_equal(to_dense(model.M), M)
        assert any("counts all 13 dofs" in item and "10 have no row" in item for item in model.remarks)
        assert not any("AUTOSPC" in item for item in model.remarks)
        assert comm.allreduce(len(model.held.node)) == 10
    write(folder / "a.bdf", DECK.replace("SPC1,1,123456,5", "CROD,1,1,1,5"), comm)
    with load_export(path, comm) as model:
        assert np.array_equal(to_dense(model.K), K)
        assert any("6 of these no card of" in item and "AUTOSPC" in item for item in model.remarks)


@pytest.mark.parametrize("deck", [DECK, ""])
def test_other_columns_may_not_be_missing(comm, folder, deck):
    """A column of rows that are there, and one with mass; any count that is not that of the model's dofs is told."""
    counted = LARGE.replace(f"{3:24d}", f"{13:24d}")
    middle = counted.index("DMIG*   KAAX                           1               1")
    last = counted.index("DMIG*   KAAX                           9")
    write(folder / "a.bdf", deck, comm)
    for text, says in (
        (counted[:middle] + counted[counted.index("DMIG*   KAAX                           1               6") :],
         "found 2 columns of the matrix KAAX, expected 13; the file is cut off or damaged"),
        (counted[:last] + counted[counted.index("DMIG    MAAX") :], "found 2 columns of the matrix KAAX, expected 13.*"
         "9:scalar has mass but no stiffness"),
    ):  # fmt: skip
        path = write(folder / "a.pch", text, comm)
        with pytest.raises(InputError, match=says):
            load_export(path, comm)
    for count in (14, 66, 99_999_999):
        path = write(folder / "a.pch", LARGE.replace(f"{3:24d}", f"{count:24d}"), comm)
        with load_export(path, comm) as model:
            assert np.array_equal(to_dense(model.K), K) and np.array_equal(to_dense(model.M), M)
            said = f"the header card of KAAX says {count} columns, and 3 are there, all those of M"
            assert any(said in item for item in model.remarks)
        comm.Barrier()


def test_entries_below_the_first_card_are_refused(comm, folder):
    for text, entry in ((WIDE, f"*      {1:17d}{1:16d}{2.0:16.1f}\n"), (LARGE, "        1       1               2.\n")):
        cut = text.index("DMIG*   KAAX                           1")
        text = text[:cut] + entry + text[cut:]
        with pytest.raises(InputError, match="expected no entries below the card with form and type"):
            load_export(write(folder / "a.pch", text, comm), comm)
        comm.Barrier()


def test_both_halves_of_a_symmetric_matrix_are_refused(comm, folder):
    path = write(folder / "a.pch", SMALL.replace("0       1       2", "0       6       2"), comm)
    with pytest.raises(InputError, match="found both halves of the symmetric matrix K2GG"):
        load_export(path, comm)


@pytest.mark.parametrize(
    "text, says",
    [
        (f"{'':8}{1:<8}{6:<8}3.0\n" + LARGE, "line 1: found .*expected a card"),
        (LARGE + "1 1 1 1 1\n", "expected a card, or a line that continues one"),
        (LARGE + "=,*1,==\n", "expected a card, or a line that continues one"),
        ("=,*1,==\n" + LARGE, "line 1: found .*expected a card"),
        (LARGE + "ENDDATA\n\n*                      9               0 2.000000000D+00\n", "nothing behind ENDDATA"),
    ],
)
def test_lines_that_belong_to_no_card(comm, folder, text, says):
    write(folder / "a.pch", text, comm)
    with pytest.raises(InputError, match=says):
        load_source(Source(folder / "a.pch", folder / "a.pch", variables={"K": "KAAX", "M": "MAAX"}), comm)


def test_other_cards_may_be_repeated(comm, folder):
    """An input file that is looked into for DMIG."""
    found = [nastran_dmig.contents(write(folder / name, lines + LARGE, comm), comm)
             for name, lines in (("a.bdf", "GRID,1,,0.\n=,*1,==\n=3\n"), ("b.bdf", ""))]  # fmt: skip
    assert found[0] == found[1]
