"""Exports of Nastran become models: frequencies as the programs computed them, nodes, sets and displacement systems."""

from contextlib import closing

import numpy as np
import pytest
from foreign import gathered, unpack, write
from helpers import to_dense

import hpcred
from hpcred import Buckens, InputError, Modes
from hpcred.fe.dofs import DIRECTIONS
from hpcred.model.rigid_body.modes import warnings_of_nodes
from hpcred.readers.assembly import assemble
from hpcred.readers.model_source import load_export, load_source
from hpcred.readers.nastran import exports as nastran
from hpcred.readers.nastran import op2 as nastran_op2
from hpcred.readers.nastran import op4 as nastran_op4
from hpcred.reduction.components import modes
from hpcred.settings.source import Source

pytestmark = pytest.mark.mpi

# file, n, entries, lowest frequencies that the program itself gives, relative digits, rigid-body modes
MODELS = {
    "extseout": ("nas2cam.op4", 54, 2046, [1.6988, 1.767487, 1.85772, 3.419612], 1e-6, 6),
    "notall6": ("nas2cam_notall6_msc2017.op4", 29, 751, [11.30124, 16.91482, 19.794, 23.07029], 1e-6, 6),
    "plate": ("plate.OU1", 216, 3260, [19.29137, 107.7586, 117.4312, 340.4766], 5e-7, 0),
    "test_1": ("test_case.pch1", 10, 46, [21.14057, 21.35569, 128.7332, 129.7476], 1e-6, 2),
    "maewing1": ("sol103_maewing1_femv5p1.pch1", 426, 3466, [7.949976, 12.54754, 15.91975, 18.67089], 3.5e-3, 6),
}


# without a count of modes the complex build solves for all below the band
@pytest.mark.parametrize("name", [
    pytest.param(name, marks=[pytest.mark.costly] * (name == "maewing1")) for name in MODELS])  # fmt: skip
@pytest.mark.costly
def test_frequencies_are_those_of_the_program(comm, folder, name):
    file, size, entries, expected, digits, rigid = MODELS[name]
    unpack(folder, comm, f"nastran/{name}")
    with load_export(folder / file, comm) as model:
        assert (model.size, model.nonzeros) == (size, entries)
        report = hpcred.inspect(model)
        assert report["rigid_body_modes"] == rigid and warnings_of_nodes(model) == []
        # the ten digits of the punch file are too few for an inertia relief
        frame, band = (None, [3.0, 20.0]) if name == "maewing1" else (Buckens() if rigid else None, None)
        basis = [Modes(band=band) if band else Modes(count=4)]
        with hpcred.reduce(model.with_inputs([1]), basis, *([frame] if frame else [])) as rom:
            assert np.allclose(rom.frequencies[:4], expected, rtol=digits, atol=0)


@pytest.mark.mpi
@pytest.mark.costly
def test_few_digits_are_no_end_of_modes(comm, folder, monkeypatch):
    """Where the rigid-body motions of the nodes are too inexact for K, the way out is named, and it is one: that their
    rounded zeros differ from one sequence to the next is no reason to look for more modes."""
    sequences, lowest = [], modes.lowest_modes
    monkeypatch.setattr(modes, "lowest_modes", lambda *given, **more: sequences.append(0) or lowest(*given, **more))
    file, _, _, expected, digits, _ = MODELS["maewing1"]
    unpack(folder, comm, "nastran/maewing1")
    with load_export(folder / file, comm) as model:
        with pytest.raises(hpcred.ComputationError, match="too ill-conditioned .* hpcred modes .* --frame none takes"):
            hpcred.natural_modes(model, 10)
        sequences.clear()
        with closing(hpcred.natural_modes(model, 10, hpcred.NoFrame())) as found:
            assert found.frequencies[:6].max() < 1
            assert np.allclose(found.frequencies[6:], expected, rtol=digits, atol=0)
    assert len(sequences) == 2


@pytest.mark.parametrize("name", ["extseout", "notall6", "nx"])
def test_all_eigenvalues_are_those_in_the_file(comm, folder, name):
    """The eigenvalues that Nastran computed lie beside the matrices; a dense eigensolver is the second method."""
    unpack(folder, comm, f"nastran/{name}")
    path = folder / (MODELS[name][0] if name in MODELS else "nas2cam_notall6_nx2021.op4")
    known = [item for item in nastran_op4.contents(path, comm) if item.name == "LAMBDA"][-1]
    entries = nastran_op4.read_matrix(path, comm, known)
    place, values = gathered(comm, entries.rows, entries.values)
    with load_export(path, comm) as model:
        K, M = to_dense(model.K), to_dense(model.M)
    L = np.linalg.cholesky(M)
    found = np.linalg.eigvalsh(np.linalg.solve(L, np.linalg.solve(L, K).T))
    expected = values[np.argsort(place)][6:]
    assert np.allclose(found[6 : 6 + len(expected)], expected, rtol=1e-7)
    assert np.abs(found[:6]).max() < 1e-7 * expected[0]


def test_fixed_interface_modes_of_a_superelement(comm, folder):
    """Rows of modal coordinates are scalar; with the interface held their frequencies are those of the run."""
    unpack(folder, comm, "nastran/drm12")
    with load_export(folder / "inboard_nas2cam.op4", comm) as model:
        (direction,) = gathered(comm, model.dofs.direction)
        K, M = to_dense(model.K), to_dense(model.M)
        assert hpcred.inspect(model)["rigid_body_modes"] == 6
    scalar = direction == DIRECTIONS.index("scalar")
    assert scalar.sum() == 60 and (np.abs(M[np.ix_(scalar, scalar)] - np.eye(60)) < 1e-12).all()
    found = np.sqrt(np.diag(K)[scalar]) / (2 * np.pi)
    assert np.allclose(np.sort(found)[:4], [6.129346, 6.130134, 23.63188, 70.19714], rtol=2e-7)


def test_an_external_superelement(comm, folder):
    """EXTSEOUT's punch file names the rows; the OP2 beside it has no systems and says nothing."""
    unpack(folder, comm, "nastran/external")
    parts = nastran.read_op4(folder / "inboard.op4", comm)
    said = " ".join(parts.warnings)
    assert "K is KXX, M is MXX" in said and "nodes and sets of dofs are those of" in said and "inboard.pch" in said
    with assemble(parts, comm) as model:
        report = hpcred.inspect(model)
        assert report["rigid_body_modes"] == 6 and max(report["rigid_body_residuals"]) < 1e-13
        assert set(report["warnings"]) <= set(parts.warnings)  # none but what the file's reader said
        node, direction = gathered(comm, model.dofs.node, model.dofs.direction)
    assert node[::6][:4].tolist() == [3, 11, 19, 27] and node[24:].tolist() == list(range(2995001, 2995009))
    assert direction.tolist() == [*range(6)] * 4 + [DIRECTIONS.index("scalar")] * 8


def test_rows_are_turned_to_the_global_axes(comm, folder, monkeypatch):
    """The free plate with nodes in a cylindrical system has rigid-body modes; without turning it has none."""
    unpack(folder, comm, "nastran/plate")
    path, names = folder / "plate.OU1", {"K": "KGG", "M": "mgg"}
    parts = nastran.read_op4(path, comm, names)
    said = " ".join(parts.warnings)
    assert "no supports (SPC) and no rigid elements" in said and "3 rows without stiffness and mass" in said
    assert "4 nodes have displacement systems of their own (CD)" in said
    with assemble(parts, comm) as model:
        report = hpcred.inspect(model)
        assert report["rigid_body_modes"] == 6 and warnings_of_nodes(model) == [] and model.size == 273
        assert np.allclose(report["masses_in_x_y_z_kg"], 0.4 * 0.2 * 0.005 * 7850 + 0.5)
        turned = to_dense(model.K)
    monkeypatch.setattr(nastran, "turned_entries", lambda comm, turn, entries: entries)
    with assemble(nastran.read_op4(path, comm, names), comm) as model:
        report = hpcred.inspect(model)
        assert report["rigid_body_modes"] < 6 and max(report["rigid_body_residuals"]) > 1e-3
        straight = to_dense(model.K)
    assert np.allclose(np.linalg.eigvalsh(turned), np.linalg.eigvalsh(straight), atol=1e-9 * np.abs(turned).max())


TURNED = """GRID,1,,0.,0.,0.
GRID,2,,1.,0.,0.,7
GRID,3,,0.,1.,0.,8
CORD2R,7,,0.,0.,0.,0.,0.,1.
,.8,.6,0.
CORD2C,8,,0.,0.,0.,0.,0.,1.
,1.,0.,0.
"""


@pytest.mark.parametrize("rows", ["in order", "--dofs", "labelled", "one held"])
def test_rows_of_other_files_are_turned_by_the_systems_of_the_deck(comm, folder, rows):
    """x of node 2 is .8 x' - .6 y'; r and t of node 3, at 90 degrees, are y and -x."""
    T = np.eye(9)
    T[3:5, 3:5] = [[0.8, -0.6], [0.6, 0.8]]
    T[6:8, 6:8] = [[0, -1], [1, 0]]
    A = np.random.default_rng(4).standard_normal((2, 9, 9))
    K, M = A @ A.transpose(0, 2, 1) + 9 * np.eye(9)
    labels = [(n, d) for n in (1, 2, 3) for d in (1, 2, 3)]
    kept = np.arange(9) if rows != "one held" else np.delete(np.arange(9), [3, 6])  # x' of node 2 and r of node 3
    own = [(T.T @ item @ T)[np.ix_(kept, kept)] for item in (K, M)]
    files = []
    for key, item in zip("KM", own, strict=True):
        if rows == "labelled":
            lines = [f"DMIG,{key}AA,0,1,2,0,,,9"] + [
                f"DMIG,{key}AA,{n},{d},,{i},{c},{item[r, k]:.14e}"
                for k, (n, d) in enumerate(labels) for r, (i, c) in enumerate(labels)]  # fmt: skip
        else:
            lines = [f"{i + 1} {j + 1} {float(v)!r}" for (i, j), v in np.ndenumerate(item)]
        files.append(str(write(folder / f"{key}.txt", "\n".join(lines) + "\n", comm)))
    nodes = str(write(folder / "deck.bdf", TURNED, comm))
    dofs = "".join(f"{labels[k][0]} {labels[k][1]}\n" for k in kept)
    dofs = str(write(folder / "dofs.txt", dofs, comm)) if rows in ("--dofs", "one held") else None
    with load_source(Source(*files, nodes=nodes, dofs=dofs), comm) as model:
        node, direction = gathered(comm, model.dofs.node, model.dofs.direction)
        names = list(zip(node.tolist(), direction.tolist(), strict=True))
        said = " ".join(model.remarks)
        assert "deck.bdf: 2 nodes have displacement systems of their own (CD); their rows were turned" in said
        assert "given before" not in said  # entries that turning makes twice are no double entries of the file
        if rows != "one held":
            assert names == [(n, d - 1) for n, d in labels]
            assert np.allclose(to_dense(model.K), K) and np.allclose(to_dense(model.M), M)
            return
        # t of node 3 is -x, y' of node 2 is no direction of x, y, z
        own2, own3 = DIRECTIONS.index("own2"), DIRECTIONS.index("own3")
        assert names[3:] == [(2, own2), (2, own3), (3, 0), (3, 2)] and "2 rows of such nodes stay" in said
        sign = np.array([1, 1, 1, 1, 1, -1, 1])
        assert np.allclose(to_dense(model.K), sign[:, None] * own[0] * sign)


def test_the_input_file_stands_for_its_matrices(comm, folder):
    unpack(folder, comm, "nastran/plate")
    with load_export(folder / "plate.bdf", comm) as model:
        assert model.size == 216 and comm.allreduce(len(model.elements["quad"])) == 32
    parts = nastran.read_bulk(folder / "plate.bdf", comm)
    assert comm.allreduce(len(parts.removed)) == 30
    said = " ".join(parts.warnings)
    assert "K is KAA, M is MAA; not read: KGG, KLL, MGG" in said and "30 dofs are held by supports" in said
    assert "30 dofs have no row, since they depend on others" in said


def test_a_mass_in_another_file_of_the_same_name(comm, folder):
    unpack(folder, comm, "nastran/plate")
    if comm.rank == 0:
        (folder / "plate.OU1").rename(folder / "other.OU1")
        content = (folder / "other.OU1").read_bytes()
        (folder / "plate.OU1").write_bytes(content[content.index(b"KLL     ") - 20 :])
    comm.Barrier()
    parts = nastran.read_op4(folder / "plate.OU1", comm)
    assert parts.files["K"].endswith("plate.OU1, matrix KLL") and parts.files["M"].endswith("plate.OU2, matrix MLL")


@pytest.mark.parametrize(
    "remove, names, says",
    [
        (["plate.bdf"], {}, None),
        ([], {"K": "KAA", "M": "MXX"}, "but none that is M = MXX"),
        ([], {"K": "KAA:2"}, "but none that is K = KAA:2"),
        ([], {"K": "KAA", "M": "MGG"}, "expected square matrices of one size"),
    ],
)
def test_names_that_are_given(comm, folder, remove, names, says):
    unpack(folder, comm, "nastran/plate")
    if comm.rank == 0:
        for name in remove:
            (folder / name).unlink()
    comm.Barrier()
    if says is None:
        parts = nastran.read_op4(folder / "plate.OU1", comm, names)
        assert parts.nodes is None and "the nodes are not known" in " ".join(parts.warnings)
    else:
        with pytest.raises(InputError) as error:
            nastran.read_op4(folder / "plate.OU1", comm, names)
        assert says in str(error.value)


@pytest.mark.parametrize(
    "old, new, says",
    [
        ("SPC1,1,123456,1,2,3,4,5", "SPC1,1,12345,1,2,3,4,5", "has 221 dofs in the set A"),
        ("GRID,38,", "GRIL,38,", "has 210 dofs in the set A"),
        ("SPC = 1", "", "has 246 dofs in the set A"),
        ("SPC1,1,", "SEQGP,1,2\nSPC1,1,", "whose dofs are not known from the input file alone"),
        ("ENDDATA", "", "found BEGIN BULK but no ENDDATA"),
        ("GRID,38,", "GRID,37,", "found the point 37 more than once"),
        ("GRID,21,,0.2,0.,0.,5", "GRID,21,,0.2,0.,0.,6", "in the coordinate system 6, which no CORD card defines"),
    ],
)
def test_an_input_file_that_does_not_fit_is_refused(comm, folder, old, new, says):
    unpack(folder, comm, "nastran/plate")
    deck = (folder / "plate.bdf").read_text()
    assert old in deck
    comm.Barrier()
    write(folder / "plate.bdf", deck.replace(old, new, 1), comm)
    with pytest.raises(InputError) as error:
        nastran.read_op4(folder / "plate.OU1", comm, {"K": "KAA", "M": "MAA"})
    assert says in str(error.value) and str(folder) in str(error.value)
    if "set A" in says and "SPC" in old:  # what nobody insists on is read as the G-set
        said = " ".join(nastran.read_op4(folder / "plate.OU1", comm).warnings)
        assert "K is KGG, M is MGG" in said and says in said


def test_a_file_that_ends_between_two_superelements_is_cut_off(comm, folder):
    unpack(folder, comm, "nastran/extseout")
    path = folder / "nas2cam.op4"
    content = path.read_bytes()
    second = [item for item in nastran_op4.contents(path, comm) if item.name == "SE_START"][1]
    comm.Barrier()
    write(path, content[: second.starts[0] - 32], comm)  # before its header of 24 bytes and the marks of its length
    assert [item.name for item in nastran_op4.contents(path, comm)] == ["SE_START", "ULVS", "MAA", "KAA"]
    with pytest.raises(InputError, match="found matrices SE_START, but no LOOP_END behind the last"):
        nastran.read_op4(path, comm)


def test_an_index_that_is_wrong_shows_as_missing_symmetry(comm, folder):
    unpack(folder, comm, "nastran/extseout")
    path = folder / "nas2cam.op4"
    content = bytearray(path.read_bytes())
    matrix = [item for item in nastran_op4.contents(path, comm) if item.name == "KAA"][-1]
    at = matrix.starts[0] + 4 + 4  # the first row of the first column
    assert content[at] == 1
    content[at] = 2
    comm.Barrier()
    with pytest.raises(InputError, match="expected a symmetric matrix; the file is damaged"):
        nastran.read_op4(write(path, bytes(content), comm), comm)


def test_tables_that_contradict_each_other_are_refused(comm, folder):
    unpack(folder, comm, "nastran/notall6")
    path = next(folder.glob("*.op2"))
    content = path.read_bytes()
    old, new = (label.to_bytes(8, "little") + (61).to_bytes(8, "little") for label in (441, 440))  # in BGPDT
    comm.Barrier()
    write(path, content.replace(old, new), comm)
    with pytest.raises(InputError, match="found numbers of points .* in the table"):
        nastran.read_op4(path.with_suffix(".op4"), comm)


@pytest.mark.parametrize("length", [2, 100, 5000, 9000, 12000])
def test_a_cut_op2_is_refused(comm, folder, length):
    unpack(folder, comm, "nastran/extseout")
    content = (folder / "nas2cam.op2").read_bytes()
    comm.Barrier()
    write(folder / "nas2cam.op2", content[:length], comm)
    with pytest.raises(InputError) as error:
        nastran.read_op4(folder / "nas2cam.op4", comm)
    said = str(error.value)
    assert "expected one of OUTPUT2" in said if length == 2 else "found no" in said and "damaged or cut off" in said
    assert "nas2cam.op2: found" in said


def test_an_op2_in_place_of_the_matrices_is_refused(comm, folder):
    unpack(folder, comm, "nastran/extseout")
    with pytest.raises(InputError, match="nas2cam.op2: found an OP2 of Nastran, .* give the .op4 or .pch of the run"):
        load_export(folder / "nas2cam.op2", comm)


def test_places_without_numbers_are_passed_over(comm, folder):
    """The BGPDT of versions before 2005, of system and place, needs EQEXIN, also where its length fits the new form."""

    def record(words):
        data = np.asarray(words, "<i4").tobytes()
        return len(data).to_bytes(4, "little") + data + len(data).to_bytes(4, "little")

    def keys(*numbers):
        return b"".join(record([number]) for number in numbers)

    places = np.zeros((12, 4), "<f4")
    places[:, 1] = np.linspace(0, 3, 12)
    parts = [keys(2), record(np.frombuffer(b"BGPDTS  ", "<i4")), keys(-1, 7), record(range(7)), keys(-2)]
    for words in ([0, 0], places.view("<i4").ravel()):
        parts += [keys(1, 0, len(words)), record(words), keys(-3)]
    path = write(folder / "a.op2", b"".join([*parts, keys(1, 0, 0, 0)]), comm)
    assert [len(table.records) for table in nastran_op2.walk(path)] == [1]
    assert nastran_op2.points_by_superelement(path, comm) == []


def test_a_table_without_a_name_is_refused(comm, folder):
    unpack(folder, comm, "nastran/extseout")
    content = (folder / "nas2cam.op2").read_bytes()
    comm.Barrier()
    length, words = content[:4], (-5).to_bytes(content[0], "little", signed=True)
    write(folder / "nas2cam.op2", content + length + words + length, comm)
    with pytest.raises(InputError, match="nas2cam.op2: found no name of a table at byte .* damaged or cut off"):
        nastran.read_op4(folder / "nas2cam.op4", comm)


def test_companions_without_the_rows_are_refused(comm, folder):
    unpack(folder, comm, "nastran/notall6")
    unpack(folder, comm, "nastran/extseout")
    content = (folder / "nas2cam.op2").read_bytes()
    comm.Barrier()
    write(folder / "nas2cam_notall6_msc2017.op2", content, comm)
    with pytest.raises(InputError, match="which dofs the rows are cannot be told"):
        nastran.read_op4(folder / "nas2cam_notall6_msc2017.op4", comm)


def test_a_stiffness_alone_is_refused(comm, folder):
    unpack(folder, comm, "nastran/testplate")
    with pytest.raises(InputError, match="found the matrices KGG, expected a stiffness and a mass matrix"):
        nastran.read_op4(folder / "testplate_kgg.op4", comm)
