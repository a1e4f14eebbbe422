"""Bulk data: forms of cards, coordinate systems, sets of dofs, against numbers computed by hand or by numpy."""

import numpy as np
import pytest
from foreign import gathered, write

from hpcred import InputError
from hpcred.fe.dofs import OWN
from hpcred.files import text as text_module
from hpcred.parallel.shares import row_range
from hpcred.readers.entries import Entries
from hpcred.readers.nastran import bulk as nastran_bulk
from hpcred.readers.nastran import points as nastran_points
from hpcred.readers.nastran.exports import read_nodes
from hpcred.readers.nastran.sets import hold_rotations_of_solids, mark_sets
from hpcred.readers.nodal_systems import turned_entries

pytestmark = pytest.mark.mpi(build="real")

SMALL = """$ free, small and large fields say the same
GRID    7               1.5     -2.5+3  4.-1            126
GRID    8       2       1.      90.     3.      2
"""
FREE = """GRID,7,,1.5,-2.5+3,4.E-1,,126
GRID, 8 ,2 , 1.0 ,9.D+1,3.,2
"""
LARGE = """GRID*   7                               1.5             -2.5D+3
*       4.E-1                           126
GRID*,8,2,1.0,90.
*,3.0,2
"""
TABS = "GRID\t7\t\t1.5\t-2.5+3\t4.-1\t\t126\ngrid\t8\t2\t1.\t90.\t3.\t2\n"
CHEXA = "CHEXA   1       1       1       2       3       4       5       6\n        7       8\n"
SYSTEM = """CORD2C  2               1.      0.      0.      1.      0.      1.      +A
+A      2.      0.      0.
"""


def points(comm, path):
    deck = nastran_bulk.read_deck(path, comm)
    return nastran_bulk.points_of(deck, comm), deck


@pytest.mark.parametrize("lines", [SMALL, FREE, LARGE, FREE.replace("\n", "\r\n"), TABS],
                         ids=["small", "free", "large", "carriage returns", "tabs"])  # fmt: skip
def test_forms_of_cards(comm, folder, monkeypatch, lines):
    monkeypatch.setattr(text_module, "PIECE", 40)
    found, _ = points(comm, write(folder / "a.bdf", lines + SYSTEM + "PARAM,POST,-1\n", comm))
    label, position, marks = gathered(comm, found.label, found.position, found.marks)
    assert label.tolist() == [7, 8]
    assert np.allclose(position, [[1.5, -2500, 0.4], [1, 1, 3]], atol=1e-15)
    assert (marks == nastran_points.HELD).tolist() == [[True, True, False, False, False, True], [False] * 6]
    turned = comm.allreduce(len(found.turned))
    assert turned == 1
    axes = [axes for axes in comm.allgather(found.axes) if len(axes)][0][0]
    assert np.allclose(axes, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)  # r is y, theta is -x


@pytest.mark.parametrize("lines", [
    "$ remark\n" * 900 + SMALL, TABS, "$\n\nINCLUDE 'grids.bdf'\n", "include grids.bdf\n", "$\n" + 90 * CHEXA + FREE,
    "MAT1,1,2.1+11,,.3\n" + 300 * CHEXA + FREE,
], ids=["remarks", "tabs", "include", "plain include", "elements", "materials"])  # fmt: skip
def test_decks_are_told_by_any_card(comm, folder, lines):
    path = write(folder / "a.bdf", lines, comm)
    assert nastran_bulk.begins(text_module.first_bytes(path))
    assert not nastran_bulk.begins(b"1, 2, 3\n")


def test_a_byte_order_mark_is_no_card(comm, folder):
    if comm.rank == 0:
        (folder / "a.bdf").write_bytes(b"\xef\xbb\xbf" + (FREE + SYSTEM).encode())
    comm.Barrier()
    found, _ = points(comm, folder / "a.bdf")
    assert gathered(comm, found.label)[0].tolist() == [7, 8]


def test_systems_in_systems(comm, folder):
    """Spherical in cylindrical in a rectangular one of grid points, against rotations by hand."""
    deck = """GRDSET,,3
GRID,1,0,1.,1.,0.
GRID,2,0,1.,1.,5.
GRID,3,0,0.,1.,0.
CORD1R,1,1,2,3
CORD2C,2,1,1.,0.,0.,1.,0.,1.
,1.,1.,0.
CORD2S,3,2,2.,0.,0.,2.,0.,1.
,3.,0.,0.
GRID,4,,2.,90.,90.
GRID,5,2,2.,90.,1.
"""
    found, _ = points(comm, write(folder / "a.bdf", deck, comm))
    label, position = gathered(comm, found.label, found.position)
    at = dict(zip(label.tolist(), position, strict=True))
    # system 1: origin (1, 1, 0), z is z, x is -x, y is -y; 2: origin (0, 1, 0) with r at 0 degrees along y of 1
    assert np.allclose(at[5], [0 + 2, 1, 1])
    # 3: origin at r = 2, angle 0 of 2, which is (0, -1, 0); x of it is -y, y of it is x
    assert np.allclose(at[4], [2, -1, 0])


@pytest.mark.parametrize("kind", [nastran_points.CYLINDRICAL, nastran_points.SPHERICAL])
def test_directions_are_the_slopes_of_the_coordinates(kind):
    rng = np.random.default_rng(2)
    system = nastran_points.System.from_points(kind, *rng.standard_normal((3, 3)))
    coordinates = rng.uniform(0.5, 1.5, (20, 3)) * [1, 40, 1 if kind == nastran_points.CYLINDRICAL else 50]
    place = system.to_basic(coordinates)
    for k in range(3):
        step = np.zeros(3)
        step[k] = 1e-6
        slope = system.to_basic(coordinates + step) - system.to_basic(coordinates - step)
        slope /= np.linalg.norm(slope, axis=1)[:, None]
        assert np.allclose(system.directions(place)[:, :, k], slope, atol=1e-7)


DECK = """SOL 103
CEND
SPC = 4
MPC = 9
BEGIN BULK
SPOINT,101,THRU,103
GRID,1,,0.,0.,0.
GRID,2,,1.,0.,0.
GRID,3,,2.,0.,0.,,6
GRID,4,,3.,0.,0.
SPC1,5,123456,4
SPC,1,1,12,0.,2,3
SPC1,2,3,1,THRU,2
SPCADD,4,1,2
MPC,9,4,1,1.,3,1,-1.
MPC,8,4,2,1.,3,1,-1.
{}
ENDDATA
"""


@pytest.mark.parametrize(
    "cards, letter, missing",
    [
        ("", "A", {1: "123", 2: "3", 3: "6", 4: "1"}),
        ("", "N", {4: "1"}),
        ("", "G", {}),
        ("SUPORT,3,12", "A", {1: "123", 2: "3", 3: "6", 4: "1"}),
        ("SUPORT,3,12", "L", {1: "123", 2: "3", 3: "126", 4: "1"}),
        ("RBE2,7,1,456,2,4,1.-5", "A", {1: "123", 2: "3456", 3: "6", 4: "1456"}),
        ("RBE2,7,1,456,2,4,1.-5,20.", "A", {1: "123", 2: "3456", 3: "6", 4: "1456"}),
        ("RBE3,7,,3,123,1.,123,1,2", "A", {1: "123", 2: "3", 3: "1236", 4: "1"}),
        ("RBE3,7,,3,123,1.,123,1,2\n,UM,1,56", "A", {1: "12356", 2: "3", 3: "6", 4: "1"}),
        ("RBE3,7,,3,1234,1.,123,1,2\n,UM,1,56,2,4,2,5\n,,3,1,\n,ALPHA,1", "A",
         {1: "12356", 2: "345", 3: "16", 4: "1"}),
        ("RBE1,7,1,123456\n,UM,2,12,3,4,4,6", "A", {1: "123", 2: "123", 3: "46", 4: "16"}),
        ("RBAR,7,1,2,123456,,,456", "A", {1: "123", 2: "3456", 3: "6", 4: "1"}),
        ("RBAR,7,1,2,123456", "A", {1: "123", 2: "123456", 3: "6", 4: "1"}),
        ("OMIT1,45,3,4\nOMIT,2,6", "A", {1: "123", 2: "36", 3: "456", 4: "145"}),
        ("ASET1,12,2,THRU,4\nASET,1,456,101\nQSET1,0,102", "A",
         {1: "123", 2: "3456", 3: "3456", 4: "13456", 103: "0"}),
    ],
)  # fmt: skip
def test_sets_of_dofs(comm, folder, cards, letter, missing):
    path = write(folder / "a.bdf", DECK.format(cards), comm)
    found, deck = points(comm, path)
    assert mark_sets(deck, comm, found) is None
    label, there, kept = gathered(comm, found.label, found.there(), found.of_set(letter))
    assert label.tolist() == [1, 2, 3, 4, 101, 102, 103]
    gone = {int(node): "".join("0" if node > 100 else str(k + 1) for k in np.flatnonzero(have & ~keep))
            for node, have, keep in zip(label, there, kept, strict=True) if (have & ~keep).any()}  # fmt: skip
    assert gone == missing


def test_what_cannot_be_told_is_said(comm, folder):
    found, deck = points(comm, write(folder / "a.bdf", DECK.format("RSPLINE,1,,2,3,,4"), comm))
    assert "RSPLINE" in mark_sets(deck, comm, found)
    found, deck = points(comm, write(folder / "b.bdf", DECK.split("BULK\n")[1].format(""), comm))
    assert "more than one set of MPC" in mark_sets(deck, comm, found)  # of SPC there is one SPCADD
    subcases = DECK.replace("SPC = 4", "SPC = 4\nSUBCASE 2\nSPC=5").format("")
    found, deck = points(comm, write(folder / "c.bdf", subcases, comm))
    assert "more than one set of SPC" in mark_sets(deck, comm, found)


def test_rotations_of_solids(comm, folder):
    deck = """GRID,1,,0.,0.,0.
GRID,2,,1.,0.,0.
GRID,3,,0.,1.,0.
GRID,4,,0.,0.,1.
GRID,5,,9.,0.,1.
GRID,6,,9.,9.,9.
CTETRA,1,1,1,2,3,4
CBAR,2,1,4,5,0.,0.,1.
"""
    found, deck = points(comm, write(folder / "a.bdf", deck, comm))
    assert hold_rotations_of_solids(deck, comm, found)
    label, kept = gathered(comm, found.label, found.of_set("A"))
    assert kept.sum(axis=1).tolist() == [3, 3, 3, 6, 6, 0]
    elements = {kind: comm.allreduce(nodes.tolist()) for kind, nodes in deck.elements.items()}
    assert elements == {"tetra": [[1, 2, 3, 4]], "line": [[4, 5]]}


def test_includes_are_followed(comm, folder):
    if comm.rank == 0:
        (folder / "parts").mkdir()
        (folder / "parts" / "Grids.DAT").write_text("$ nodes\nGRID,2,,1.,0.,0.\nINCLUDE 'more.dat'\nGRID,4,,3.,0.,0.\n")
        (folder / "more.dat").write_text("GRID,3,,2.,0.,0.\n")
    deck = "BEGIN BULK\nGRID,1\nINCLUDE {}\n$ INCLUDE none\nGRID,5\nENDDATA\nGRID,6\n"
    for name in ("parts\\grids.dat", "'parts/grids.dat'", "'parts/\ngrids.dat'", '"par\n  ts/ \nGrids.DAT"'):
        path = write(folder / "a.bdf", deck.format(name), comm)
        nodes, *_ = read_nodes(path, comm)
        label, place = gathered(comm, nodes.label, nodes.place)
        assert label.tolist() == [1, 2, 3, 4, 5] and place.tolist() == [0, 1, 2, 3, 4]
    with pytest.raises(InputError, match="found INCLUDE '', which is no file"):
        read_nodes(write(folder / "f.bdf", "GRID,1\nINCLUDE ''\n", comm), comm)
    with pytest.raises(InputError, match="d.bdf, line 2: found an INCLUDE without its second quote"):
        read_nodes(write(folder / "d.bdf", "GRID,1\nINCLUDE 'parts/\ngrids.dat\n", comm), comm)
    with pytest.raises(InputError, match="found INCLUDE 'nothing.dat', which is no file"):
        read_nodes(write(folder / "b.bdf", "INCLUDE nothing.dat\nGRID,1\n", comm), comm)
    with pytest.raises(InputError, match="which includes itself"):
        read_nodes(write(folder / "c.bdf", "GRID,1\nINCLUDE 'c.bdf'\n", comm), comm)


@pytest.mark.parametrize(
    "deck, says",
    [
        ("GRID,1,,1.5x\n", "line 1: found 'GRID,1,,1.5x', expected a coordinate, a number"),
        ("GRID,1,,1.5e\n", "expected a coordinate"),
        ("GRID,1,,nan\n", "expected a coordinate"),
        ("GRID,1.\n", "expected the number of a grid point, a whole number of 1"),
        ("GRID,-1\n", "expected the number of a grid point"),
        ("GRID,1,,,,,,17\n", "expected the supports of a grid point, digits of 1 to 6"),
        ("GRID,1\nGRID,2,x\n", "line 2: found 'GRID,2,x', expected the number of a coordinate system"),
        ("GRID,1,,1.,2.,3.,,,,+,9\n", "at most 10 fields a line"),
        ("GRID,1\nGRID,1\n", "found the point 1 more than once"),
        ("GRID,1,,,,,-1\n", "found the fluid point 1"),
        ("GRID,1,4\n", "in the coordinate system 4, which no CORD card defines"),
        ("GRID,1,4\nCORD2R,4,5,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\n", "defined in 5, which no card defines"),
        ("GRID,1,4\nCORD2R,4,,0.,0.,0.,0.,0.,1.\n,0.,0.,2.\n", "line 2: CORD2R: found three points on a line"),
        ("GRID,1,4\nCORD1R,4,1,2,3\n", "found the point 2, which no GRID card defines"),
        ("GRID,1\nCORD2R,0,,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\n", "found the coordinate system 0 a second time"),
        ("GRID*,1,,1.,2.\n1,3.\n", "line 2: found '1,3.', expected a card, or a line that continues one"),
        ("GRID,1,,1.,2.\n,,,,,,,,,\n,3.\n", "expected a grid point of at most eight fields"),
        ("GRID,1,,1.,2.,1.+20\n", "expected finite coordinates"),
        ("GRDSET,,,,,,,1\nGRDSET,,,,,,,1\nGRID,1\n", "line 2: GRDSET: found a second one, expected one for all"),
        ("", "found no points"),
        ("PARAM,POST,-1\n", "found no points, expected GRID cards"),
        ("BEGIN BULK\nGRID,1\n", "found BEGIN BULK but no ENDDATA"),
        ("BEGIN BULK\nGRID,1\nBEGIN SUPER=2\nENDDATA\n", "found 2 sections of bulk data"),
        ("GRID,1\nSPOINT,9,THRU,4\n", "SPOINT: found 9 THRU 4"),
        ("GRID,1\nGRID,2\nGRID,3\nGRID,4\nCTETRA,7,1,1,2,3,4\nCBAR,7,2,1,2\n", "found the element 7 more than once"),
    ],
)
def test_decks_that_cannot_be_are_refused(comm, folder, deck, says):
    path = write(folder / "a.bdf", deck, comm)
    with pytest.raises(InputError) as error:
        points(comm, path)
    assert says in str(error.value) and str(path) in str(error.value)


HALVES = ("CORD2R  4               0.      0.      0.      0.      0.      1.", "0.      1.      0.")


@pytest.mark.parametrize(
    "end, begin", [("+C4", "+C4"), ("CC4", "+C4"), ("*C4", "+C4"), ("", ""), ("text", "+"), ("+", "+")]
)
def test_continuations_below_their_card(comm, folder, end, begin):
    for deck in ("GRID,1,4,1.,2.,3.\n" + f"{HALVES[0]:72s}{end:8s}\n{begin:8s}{HALVES[1]}\n",
                 f"GRID,1,4,1.,2.,3.\nCORD2R,4,,0.,0.,0.,0.,0.,1.,{end}\n{begin},0.,1.,0.\n"):  # fmt: skip
        found, _ = points(comm, write(folder / "a.bdf", deck, comm))
        assert np.allclose(gathered(comm, found.position)[0], [[-2, 1, 3]])
        comm.Barrier()


@pytest.mark.parametrize(
    "deck",
    ["GRID*,1,,1.,2.,*A\n*A,3.\n",
     f"{'GRID*':8s}{'1':>16s}{'':16s}{'1.':>16s}{'2.':>16s}*A      00000001\n{'*A':8s}3.\n"],
)  # fmt: skip
def test_continuations_of_large_fields_and_remarks_behind_column_80(comm, folder, deck):
    found, _ = points(comm, write(folder / "a.bdf", deck, comm))
    assert np.allclose(gathered(comm, found.position)[0], [[1, 2, 3]])


@pytest.mark.parametrize(
    "deck",
    [
        f"{HALVES[0]:72s}+C4\nCORD2R,5,4,0.,0.,0.,0.,0.,1.,+C5\n+C5,1.,0.,0.\n+C4     {HALVES[1]}\nGRID,1,4\n",
        f"CORD2R,5,4,0.,0.,0.,0.,0.,1.,+C5\n{HALVES[0]:72s}+C4\n+C5,1.,0.,0.\n+C4     {HALVES[1]}\nGRID,1,4\n",
        f"{HALVES[0]:72s}+C4\nFORCE,1,1,,1.,0.,0.,1.\n+C4,0.,1.,0.\nGRID,1,4\n",
        "RBE3,4,,1,123,1.,123,2,3,+R\nFORCE,1,1,,1.,0.,0.,1.,+F\n+F\n+R,UM,2,1\nGRID,1\n",
    ],
)
def test_continuations_away_from_their_card_are_refused(comm, folder, deck):
    with pytest.raises(InputError, match="expected a line that continues the one above"):
        points(comm, write(folder / "a.bdf", deck, comm))


def test_a_turned_matrix(comm):
    """T A T^T by numpy for nodes with all three directions, with some along the axes, and with some askew."""
    rng = np.random.default_rng(5)
    axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    first, last = row_range(comm, 4)
    rows = np.arange(first, last)
    frames = np.stack([axes, np.eye(3), quarter, axes])[rows]
    masks = np.array([[1, 1, 1, 1, 1, 1], [1, 1, 1, 0, 0, 0], [1, 0, 1, 0, 0, 0], [0, 1, 1, 1, 1, 1]], bool)
    turned = np.flatnonzero(rows != 1)
    found = nastran_points.Points(rows + 1, np.zeros((len(rows), 3)), np.zeros(len(rows), bool),
                                  np.zeros((len(rows), 6), np.uint8), turned, frames[turned])  # fmt: skip
    number = np.full(masks.shape, -1)
    number[masks] = np.arange(masks.sum())
    turn = nastran_points.turn_of(found, masks[rows], number[rows], by_label=False)
    size = int(masks.sum())
    whole = rng.standard_normal((size, size))
    i, j = (part.ravel()[comm.rank :: comm.size] for part in np.indices((size, size)))
    got = np.zeros((size, size))
    item = turned_entries(comm, turn, Entries((size, size), i, j, whole[i, j]))
    np.add.at(got, (item.rows, item.columns), item.values)
    T = np.eye(size)
    T[:3, :3] = T[3:6, 3:6] = axes
    at = number[3, 3:6]
    T[np.ix_(at, at)] = axes
    # x of the quarter turn is y of the global axes; z stays
    assert np.allclose(comm.allreduce(got), T @ whole @ T.T)
    label = np.concatenate(comm.allgather(turn.label))
    assert (label[2, [0, 2]] % 16).tolist() == [1, 2]
    assert (label[3] % 16).tolist() == [0, OWN + 1, OWN + 2, 3, 4, 5]
    assert comm.allreduce(turn.own) == 2


REPLICATED = """CORD2R,3,,0.,0.,0.,0.,0.,1.
,1.,0.,0.
GRID    101             1.0     10.5            0       3456
=,*(1),=,*(.2),==  $ the rest as above
$ a remark between
=(3)

=       *(1)    =       =       *-5.-1  ==
GRID, 201, 3, -1., 45., 5.+1
= ,*(10),=,=,*(15.),*(-2.5+0)
=2
=,300,,7.,=,=
GRID,301,,7.,,1.
=,*1,=,=,*(1.5),=
CQUAD4,1,1,101,102,103,104
=,*1,=,*1,*1,*1,*1
=(1)
"""
IN_FULL = """CORD2R,3,,0.,0.,0.,0.,0.,1.
,1.,0.,0.
GRID,101,,1.,10.5,,0,3456
GRID,102,,1.2,10.5,,0,3456
GRID,103,,1.4,10.5,,0,3456
GRID,104,,1.6,10.5,,0,3456
GRID,105,,1.8,10.5,,0,3456
GRID,106,,1.8,10.,,0,3456
GRID,201,3,-1.,45.,50.
GRID,211,3,-1.,60.,47.5
GRID,221,3,-1.,75.,45.
GRID,231,3,-1.,90.,42.5
GRID,300,,7.,90.,42.5
GRID,301,,7.,,1.
GRID,302,,7.,1.5,1.
CQUAD4,1,1,101,102,103,104
CQUAD4,2,1,102,103,104,105
CQUAD4,3,1,103,104,105,106
"""


def test_replicated_cards_are_those_in_full(comm, folder, monkeypatch):
    for size in (2**21, 30):
        monkeypatch.setattr(text_module, "PIECE", size)
        read = [points(comm, write(folder / f"{k}.bdf", lines, comm)) for k, lines in enumerate((REPLICATED, IN_FULL))]
        (found, deck), (expected, other) = read
        for key in ("label", "position", "marks"):
            assert np.array_equal(*(gathered(comm, getattr(item, key))[0] for item in (found, expected)))
        assert np.array_equal(*(gathered(comm, item.elements["quad"])[0] for item in (deck, other)))
        comm.Barrier()


@pytest.mark.parametrize(
    ("lines", "number"),
    [
        ("=,*1,==\n", 1), ("GRID,1,,0.\n=(2)\n", 2), ("GRID,1,,0.\n=,*1.,==\n", 2), ("GRID,1,,0.\n=,*1,,*1,==\n", 2),
        ("GRID,1,,0.\n=,*1,,*(1.\n", 2), ("GRID,1,,0.\n=,*1,==,1.\n", 2),
        ("GRID,1,,0.\n==\n", 2), ("GRID,1,,0.\n=RID,1\n", 2), ("GRID,1,,0.\n=,*1,==\n=(0)\n", 3),
        ("GRID,1,,0.\n=,*1,==\n=(2),1\n", 3), ("GRID,1,,0.\n=,%(5),==\n", 2), ("GRID*,1,,0.\n*,1.\n=,*1,==\n", 3),
        ("GRID,1,,0.\n,\n=,*1,==\n", 3), ("GRID,1,,0.\n=,*1,=1,==\n", 2), ("GRID,1,,1.+9999\n=,*1,,*1.,==\n", 2),
        ("GRID,1\n=,*%s,==\n" % (5000 * "9"), 2), ("GRID,1,,0.\n=,*1,==\nGRID,9\n=(2)\n", 4),
    ],
)  # fmt: skip
def test_replication_that_is_none_is_refused(comm, folder, lines, number):
    with pytest.raises(InputError, match=f"a.bdf, line {number}: found '=.*expected a line that repeats the card"):
        nastran_bulk.read_deck(write(folder / "a.bdf", lines, comm), comm)


def test_lines_below_replicated_cards_keep_their_numbers(comm, folder):
    path = write(folder / "a.bdf", "GRID,1,,0.\n=,*1,==\n=(7)\nGRID,x\n", comm)
    with pytest.raises(InputError, match="line 4: found 'GRID,x', expected the number of a grid point"):
        nastran_bulk.read_deck(path, comm)


def test_files_that_include_each_other_again_and_again_come_to_an_end(comm, folder, monkeypatch):
    monkeypatch.setattr("hpcred.files.included.MOST", 200)
    for k in range(22):
        write(folder / f"n{k}.bdf", f"INCLUDE 'n{k + 1}.bdf'\n" * 2, comm)
    write(folder / "n22.bdf", "$ nothing\n", comm)
    deck = "BEGIN BULK\nGRID,1\nINCLUDE '{}'\nENDDATA\n"
    with pytest.raises(InputError, match="main.bdf: found more than 200 files, as often as they are included, at "):
        read_nodes(write(folder / "main.bdf", deck.format("n0.bdf"), comm), comm)
    nodes, *_ = read_nodes(write(folder / "main.bdf", deck.format("n17.bdf"), comm), comm)
    assert gathered(comm, nodes.label)[0].tolist() == [1]


SETS = """SOL 103
CEND
SET 5 = 1 THRU 6 EXCEPT 3,
  5, 9
SET 6 = ALL
SET 7 = 0.1, 2.0
SET 8 = 1, 2
STRESS(PRINT) = 8
SET 11 = 1, 99
$ SET 12 = 1
set 13=2 thru 99 $ comment, 1
SET 14 = 3
SET 14 = 4
SET 15 = 6 THRU 1
BEGIN BULK
{}
SET1,5,1,2,4
SET1,6,1,THRU,2000000000
SET3,7,GRID,3,THRU,5,9
SET3,8,ELEM,3,THRU,5
SET     20      GRID    LIST                                            +
+       1       THRU    3       9
SET,21,ELEM,LIST,,,,,,+
+,1,2
SET1,30,77
ENDDATA
"""


def test_sets_of_points(comm, folder, monkeypatch):
    """By hand: a list with THRU has the points that are there, numbers behind EXCEPT only those in the range before."""
    monkeypatch.setattr(text_module, "PIECE", 40)
    grids = "\n".join(f"GRID,{number},,{number}.,0.,0." for number in (9, 6, 5, 4, 3, 2, 1))
    deck = nastran_bulk.read_deck(write(folder / "a.bdf", SETS.format(grids), comm), comm)
    assert {name: gathered(comm, points)[0].tolist() for name, points in deck.sets.items()} == {
        "SET 5": [1, 2, 4, 6, 9], "SET 13": [2, 3, 4, 5, 6, 9], "SET1 5": [1, 2, 4], "SET1 6": [1, 2, 3, 4, 5, 6, 9],
        "SET3 7": [3, 4, 5, 9], "SET 20": [1, 2, 3, 9],
    }  # fmt: skip
    (remark,) = deck.remarks
    assert remark.startswith(f"{folder / 'a.bdf'}: SET 7, SET 11, SET 14, SET 15, SET1 30: no sets of points alone")


def test_case_control_in_files_of_its_own_is_the_same(comm, folder):
    """What is included for the solution is none of it."""
    head, _, case = SETS.format("\n".join(f"GRID,{number}" for number in range(1, 8))).partition("CEND\n")
    case, _, bulk = case.partition("BEGIN BULK\n")
    deck = f"{head}CEND\n{case}SPC = 3\nBEGIN BULK\n{bulk}"
    whole = nastran_bulk.read_deck(write(folder / "a.bdf", deck, comm), comm)
    write(folder / "case.inc", f"{case}include 'spc.inc'\n", comm)
    write(folder / "spc.inc", "SPC = 3\n", comm)
    deck = f"{head}INCLUDE 'of_the_solution'\nCEND\nINCLUDE 'case.inc'\nBEGIN BULK\n{bulk}"
    apart = nastran_bulk.read_deck(write(folder / "b.bdf", deck, comm), comm)
    assert whole.case == apart.case and whole.case["SPC"] == {3}
    assert gathered(comm, whole.label)[0].tolist() == gathered(comm, apart.label)[0].tolist()
    assert {name: points.tolist() for name, points in whole.sets.items()} == {
        name: points.tolist() for name, points in apart.sets.items()
    }
