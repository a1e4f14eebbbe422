"""Stresses of a basis by a finite-element program: its input files and its answers."""

import shutil
import subprocess
from pathlib import Path

import h5py
import numpy as np
import pytest
from op2_files import displaced, op2, stressed

import hpcred
from hpcred import Buckens, Modes
from hpcred.parallel.failures import InputError
from hpcred.parallel.petsc import MPI
from hpcred.workflows import add_stresses, write_deck
from hpcred.workflows.stress_decks import _whole_text
from hpcred.writers.decks import CalculixDeck, NastranDeck

DECK = "*NODE\n1,10.,0.,0.\n*INCLUDE, INPUT=mesh.inp\n*STEP\n*FREQUENCY\n3\n*END STEP\n"


def result_of(folder, comm):
    """A block of solids with stresses of its own elements in result.h5."""
    with hpcred.solid((2, 1, 1), comm=comm, inputs=1) as model:
        rom = hpcred.reduce(model, [Modes(index=(1, 2, 3))])
        hpcred.write_result(folder / "result.h5", rom, model, stress=hpcred.stress_modes(model, rom.columns))


def arrays(path):
    """Nodes in ascending order, displacements (m, k, 3) and stresses (m, k, 6) of a result."""
    with h5py.File(path) as file:
        node, direction, V = (file[key][...] for key in ("dofs/node", "dofs/direction", "basis/V"))
        label = np.unique(np.concatenate([node, file["held/node"][...]]) if "held" in file else node)
        moved = np.zeros((len(V), len(label), 3))
        moved[:, np.searchsorted(label, node), direction] = V
        order = np.argsort(file["basis/stress_node"][...])
        assert (file["basis/stress_node"][...][order] == label).all()
        return label, moved, file["basis/stress"][...][:, order]


def frd_of(label, moved, stress):
    """The text of a .frd file with steps of displacements and stresses."""

    def block(name, names, values):
        head = f"  100CL  101{1.0:12.9f}{len(label):12d}{'':20}{0:2d}{1:5d}{'':10}{1:2d}\n"
        head += f" -4  {name:8}{len(names):5d}    1\n"
        head += "".join(f" -5  {item:8}    1    4    1    1\n" for item in names)
        rows = "".join(f" -1{n:10d}" + "".join(f"{x:12.5E}" for x in row) + "\n"
                       for n, row in zip(label, values, strict=True))  # fmt: skip
        return head + rows + " -3\n"

    text = "    1C\n" + "    2C" + " " * 18 + f"{0:12d}" + " " * 37 + "1\n -3\n"
    for u, s in zip(moved, stress, strict=True):
        text += "    1PSTEP                         1           1           1\n"
        text += block("DISP", ["D1", "D2", "D3"], u) + block("STRESS", ["SXX", "SYY", "SZZ", "SXY", "SYZ", "SZX"], s)
        text += block("ERROR", ["STR(%)"], u[:, :1])
    return text + " 9999\n"


@pytest.mark.mpi
@pytest.mark.costly
def test_answers_become_stress_modes_of_a_new_result(comm, folder):
    """Those of a file with the numbers of our own solids: to six digits, in the order of the ranks or another."""
    result_of(folder, comm)
    if comm.rank == 0:
        label, moved, stress = arrays(folder / "result.h5")
        (folder / "stress.frd").write_text(frd_of(label, moved, 2 * stress))
    comm.Barrier()
    report = add_stresses(folder / "result.h5", folder / "stress.frd", folder / "with.h5", comm=comm)
    assert report["columns"] == 3 and report["nodes"] == 12
    found = hpcred.read_result(folder / "with.h5", comm).stress_modes()
    if comm.rank == 0:
        assert found.source == "CalculiX, means at nodes in .frd" and (found.node == label).all()
        assert np.abs(found.stress - 2 * stress).max() < 1e-5 * np.abs(stress).max()
        with h5py.File(folder / "result.h5") as old, h5py.File(folder / "with.h5") as new:
            for key in ("basis/V", "reduced/K", "dofs/position", "elements/hexahedron", "record"):
                assert (old[key][()] == new[key][()]).all() if old[key].shape else old[key][()] == new[key][()]
    comm.Barrier()
    assert hpcred.workflows.verify_file(folder / "with.h5", comm=comm)
    about = hpcred.info(folder / "with.h5", comm=comm)
    assert about["stress"] == "12 nodes; CalculiX, means at nodes in .frd"


@pytest.mark.mpi
@pytest.mark.costly
def test_answers_of_nastran_in_output2(comm, folder):
    """Of a file with the numbers of our own solids: in single precision."""
    result_of(folder, comm)
    if comm.rank == 0:
        label, moved, stress = arrays(folder / "result.h5")
        with h5py.File(folder / "result.h5") as file:
            elements = dict(enumerate(file["elements/hexahedron"][...].tolist(), 1))
        place, tables = {n: k for k, n in enumerate(label.tolist())}, ([], [])
        for number, (u, s) in enumerate(zip(moved, stress, strict=True), 1):
            tables[0].extend(displaced(number, {n: u[k] for n, k in place.items()}))
            tables[1].extend(stressed(number, {e: {n: s[place[n]] for n in nodes} for e, nodes in elements.items()}))
        (folder / "stress.op2").write_bytes(op2([("OUGV1", tables[0]), ("OES1X1", tables[1])]))
    comm.Barrier()
    add_stresses(folder / "result.h5", folder / "stress.op2", folder / "with.h5", comm=comm)
    found = hpcred.read_result(folder / "with.h5", comm).stress_modes()
    if comm.rank == 0:
        assert found.source == "Nastran, means at corner nodes in OUTPUT2" and (found.node == label).all()
        assert np.abs(found.stress - stress).max() < 1e-6 * np.abs(stress).max()


@pytest.mark.mpi
def test_the_input_of_calculix_prescribes_all_displacements(comm, folder):
    """In the units of the original, whose steps are left out, and which may include other files."""
    result_of(folder, comm)
    if comm.rank == 0:
        (folder / "deck.inp").write_text(DECK)
        (folder / "mesh.inp").write_text("*ELEMENT, TYPE=C3D8\n")
    comm.Barrier()
    report = write_deck(folder / "result.h5", "calculix", folder / "deck.inp", folder / "new", units="mm,t,s",
                               comm=comm)  # fmt: skip
    assert report["columns"] == 3 and report["run"].startswith("ccx stress")
    if comm.rank == 0:
        text = (folder / "new" / "stress.inp").read_text()
        assert text.startswith("*NODE\n1,10.,0.,0.\n*ELEMENT, TYPE=C3D8\n*STEP\n*STATIC\n") and "FREQUENCY" not in text
        assert text.count("*STEP") == 3 == text.count("*EL FILE\nS\n")
        with h5py.File(folder / "result.h5") as file:
            node, direction, V = (file[key][...] for key in ("dofs/node", "dofs/direction", "basis/V"))
        for k, column in enumerate(V, 1):
            rows = [line.split(",") for line in (folder / "new" / f"column_{k:04d}.inc").read_text().splitlines()]
            assert [[int(row[0]), int(row[1]), int(row[2])] for row in rows] == [
                [n, d + 1, d + 1] for n, d in zip(node.tolist(), direction.tolist(), strict=True)]  # fmt: skip
            assert all(len(item) <= 20 for row in rows for item in row)
            assert [float(row[3]) for row in rows] == pytest.approx((1e3 * column).tolist(), rel=1e-12)


ARCHIVE = (
    "/PREP7\nNBLOCK,6,SOLID\n(3i9,6e21.13e3)\n        1        0        0 1.0000000000000E-002\nN,R5.3,LOC,       -1,\n"
    "FINISH\n"
)
BULK = "SOL 103\nCEND\nMPC = 4\nMETHOD = 1\nBEGIN BULK\nGRID,1,,0.01,0.,0.\nINCLUDE 'mesh.bdf'\nENDDATA\n"


@pytest.mark.parametrize("program, text, job", [("ansys", ARCHIVE, "stress.inp"), ("nastran", BULK, "stress.bdf")])
def test_the_input_of_ansys_and_nastran(tmp_path, program, text, job):
    """The model of the original, a load step or subcase a column, and the displacements of all rows."""
    result_of(tmp_path, MPI.COMM_SELF)
    (tmp_path / "part").write_text(text)
    (tmp_path / "mesh.bdf").write_text("GRID,900002,,1.,0.,0.\n")
    write_deck(tmp_path / "result.h5", program, tmp_path / "part", tmp_path / "new")
    main = (tmp_path / "new" / job).read_text()
    with h5py.File(tmp_path / "result.h5") as file:
        node, direction, V = (file[key][...] for key in ("dofs/node", "dofs/direction", "basis/V"))
        held = zip(file["held/node"][...], file["held/direction"][...], strict=True)
    column = (tmp_path / "new" / ("column_0002.inp" if program == "ansys" else "column_0002.bdf")).read_text()
    if program == "ansys":
        assert main.startswith(ARCHIVE.rstrip()) and main.count("SOLVE") == 3 and "/INPUT,column_0002,inp\n" in main
        assert main.index("NROTAT,ALL") < main.index("ANTYPE,STATIC") < main.index("OUTRES,STRS") < main.index("SOLVE")
        rows = [line.split(",") for line in column.splitlines()]
        found = [(int(row[1]), ["UX", "UY", "UZ"].index(row[2]), float(row[3])) for row in rows]
    else:
        assert "METHOD" not in main and "MPC = 4\n" in main and main.endswith("ENDDATA\n")
        assert main.count("GRID,") == 2 and main.count("SUBCASE") == 3 == main.count("  LOAD = 9000000")
        supports = (tmp_path / "new" / "supports.bdf").read_text().splitlines()
        rows = [*zip(node, direction, strict=True), *held]
        assert supports == [f"SPC1,90000000,{d + 1},{n}" for n, d in rows]
        rows = column.splitlines()[::2]
        assert {row[:24] for row in rows} == {f"SPCD*   {90000002:16d}"} and set(column.splitlines()[1::2]) == {"*"}
        found = [(int(row[24:40]), int(row[40:56]) - 1, float(row[56:72])) for row in rows]
    assert [item[:2] for item in found] == list(zip(node.tolist(), direction.tolist(), strict=True))
    assert [item[2] for item in found] == pytest.approx(V[1].tolist(), rel=1e-9)


@pytest.mark.parametrize("change, says", [
    (lambda n, u, s: frd_of(n, u[:2], s[:2]), "found 2 steps with stresses, expected 3"),
    (lambda n, u, s: frd_of(n, u[[0, 2, 1]], s), "displacements in step 2 that differ by .* from column 2"),
    (lambda n, u, s: frd_of(n + 1000, u, s), "found none of the nodes of"),
    (lambda n, u, s: frd_of(n, u, s)[:-6], r"found no end \(9999\)"),
    (lambda n, u, s: frd_of(n, u, s).replace("DISP", "DISX"), "found 0 fields of displacements and 3 of stresses"),
    (lambda n, u, s: frd_of(n, u, s).replace(" -1         2", " -1         x", 1), "found '-1         x"),
    (lambda n, u, s: frd_of(n, u, s).replace(f"{12:12d}", f"{13:12d}"), "found results of 12 nodes, expected 13"),
    (lambda n, u, s: "t,q1\n0,1\n", "found no results of a known program"),
])  # fmt: skip
def test_answers_that_do_not_fit_are_refused(tmp_path, change, says):
    result_of(tmp_path, MPI.COMM_SELF)
    label, moved, stress = arrays(tmp_path / "result.h5")
    (tmp_path / "stress.frd").write_text(change(label, moved, stress))
    with pytest.raises(InputError, match=says):
        add_stresses(tmp_path / "result.h5", tmp_path / "stress.frd", tmp_path / "with.h5")
    assert not (tmp_path / "with.h5").exists()


@pytest.mark.parametrize("program, deck, target, says", [
    ("nastrn", DECK, "new", "deck: found 'nastrn', expected calculix or calculix-dat or ansys or nastran"),
    ("ansys", DECK, "new", "found no nodes .NBLOCK., expected an archive of ANSYS"),
    ("nastran", DECK, "new", "found no GRID in the bulk data"),
    ("calculix", "GRID,1,,0.,0.,0.\n", "new", "deck.inp: found no keyword .NODE"),
    ("calculix", DECK, "new", r"deck.inp: found node 1 at \(10, 0, 0\) m .units: SI., expected it at \(0.01, 0, 0\)"),
    ("calculix", DECK, ".", "in this folder, which is not replaced with it"),
])  # fmt: skip
def test_decks_that_cannot_be_written_are_refused(tmp_path, program, deck, target, says):
    with hpcred.solid((1, 1, 1), inputs=1) as model:
        hpcred.write_result(tmp_path / "result.h5", hpcred.reduce(model, [Modes(index=(1,))]), model)
    (tmp_path / "deck.inp").write_text(deck)
    (tmp_path / "mesh.inp").write_text("*ELEMENT, TYPE=C3D8\n")
    with pytest.raises(InputError, match=says):
        write_deck(tmp_path / "result.h5", program, tmp_path / "deck.inp", tmp_path / target)
    assert sorted(item.name for item in tmp_path.iterdir()) == ["deck.inp", "mesh.inp", "result.h5"]


@pytest.mark.ccx
@pytest.mark.skipif(shutil.which("ccx") is None, reason="needs ccx")
@pytest.mark.parametrize("program, answers, close", [
    ("calculix", "stress.frd", 1e-4), ("calculix-dat", "stress.dat", 2e-6)
])  # fmt: skip
def test_calculix_computes_the_stresses_of_a_basis(tmp_path, program, answers, close):
    """End to end, against E B V of our own solids; CalculiX extrapolates to nodes with factors of four digits."""
    for source in (Path(__file__).parents[1] / "data" / "calculix").glob("quadratic.*"):
        shutil.copy(source, tmp_path)
    with hpcred.readers.load_export(tmp_path / "quadratic.inp") as model:
        rom = hpcred.reduce(model.with_inputs([(1, "z")]), [Modes(index=(7, 8, 9))], Buckens())
        hpcred.write_result(tmp_path / "result.h5", rom, model)
        own = hpcred.stress_modes(model, rom.columns)
    write_deck(tmp_path / "result.h5", program, tmp_path / "quadratic.inp", tmp_path / "job")
    subprocess.run(["ccx", "stress"], cwd=tmp_path / "job", check=True, capture_output=True)
    add_stresses(tmp_path / "result.h5", tmp_path / "job" / answers, tmp_path / "with.h5")
    found = hpcred.read_result(tmp_path / "with.h5").stress_modes(own.node)
    assert np.abs(found.stress - own.stress).max() < close * np.abs(own.stress).max()


def test_scalar_rows_are_left_to_the_program(tmp_path, monkeypatch):
    """As internal modes of C3D8I are, which CalculiX numbers as nodes of its own."""
    monkeypatch.chdir(tmp_path)
    dofs = hpcred.Dofs(np.array([1, 1, 1, 9]), np.array([0, 1, 2, 6]), np.zeros((4, 3)))
    model = hpcred.SecondOrderModel(np.eye(4), None, np.diag([1.0, 2, 3, 4]), dofs=dofs).with_inputs([(1, "x")])
    hpcred.write_result("result.h5", hpcred.reduce(model, [Modes(count=4)]), model)
    Path("deck.inp").write_text("*NODE\n1,0.,0.,0.\n")
    write_deck("result.h5", "calculix", "deck.inp", "new")
    for number in range(1, 5):
        lines = (Path("new") / f"column_{number:04d}.inc").read_text().splitlines()
        assert [line.split(",")[:3] for line in lines] == [["1", str(d), str(d)] for d in (1, 2, 3)]


def test_original_files_with_includes(tmp_path):
    """Texts of files in the place of the lines that name them, in all forms of Nastran; many of them are refused."""
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "a.bdf").write_text("GRID,2\n")
    for name in ("'sub/a.bdf'", "sub/a.bdf", '"sub/\n  a.bdf"', "'sub/a.bdf' $ points"):
        (tmp_path / "m.bdf").write_text(f"GRID,1\nINCLUDE {name}\nGRID,3\n")
        assert _whole_text(tmp_path / "m.bdf", NastranDeck.include) == "GRID,1\nGRID,2\nGRID,3\n"
    for k in range(19):
        (tmp_path / f"x{k}.inp").write_text(f"*INCLUDE, INPUT=x{k + 1}.inp\n" * 3)
    (tmp_path / "x19.inp").write_text("** text\n")
    with pytest.raises(InputError, match="x0.inp: found more than 10000 files"):
        _whole_text(tmp_path / "x0.inp", CalculixDeck.include)
