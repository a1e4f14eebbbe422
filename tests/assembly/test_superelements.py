"""Bodies that come reduced already: superelements of other programs as results and as bodies of machines."""

import gzip
import re
import shutil
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import refused
from scipy.linalg import eigh

import hpcred
from hpcred.assembly import BushingJoint, MachineBody, RigidJoint
from hpcred.cli.main import run
from hpcred.parallel.petsc import MPI
from hpcred.readers import read_superelement
from hpcred.readers.nastran import op4

DATA = Path(__file__).parents[1] / "data"
NODES = ((1, 0.0, 0.0, 0.0), (2, 0.5, 0.0, 0.0), (3, 0.5, 0.2, 0.1))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Files of two runs of Nastran, and an empty working folder for others."""
    monkeypatch.chdir(tmp_path)
    for name in ("extseout", "external"):
        for file in (DATA / "nastran" / name).iterdir():
            content = file.read_bytes()
            packed = file.suffix == ".gz"
            (tmp_path / (file.stem if packed else file.name)).write_bytes(
                gzip.decompress(content) if packed else content
            )
    return tmp_path


def read(path, **more):
    return read_superelement(path, MPI.COMM_SELF, **more)


def test_superelements_of_one_run_put_together_are_its_residual_structure(folder, capsys):
    """Nastran's own frequencies, of superelements with displacement systems of their own, by rigid joints."""
    for k in (1, 2):
        command = ["convert", "nas2cam.op4", f"se{k}.h5", "--superelement", "--variables", f"K=KAA:{k},M=MAA:{k}"]
        assert run(command) == 0
    said = capsys.readouterr().out
    assert "3, 11, 19, 27" in said and re.search(r"coordinates without place +22", said)
    bodies = [MachineBody(name=name, result=f"se{k}.h5") for k, name in ((1, "out"), (2, "in"))]
    joints = [RigidJoint(bodies=(f"out.{node}", f"in.{node}")) for node in (3, 11, 19, 27)]
    made = hpcred.assemble(bodies, joints)
    comm = MPI.COMM_SELF
    listed = {matrix.name: matrix for matrix in op4.contents("nas2cam.op4", comm)}
    known = np.sqrt(np.maximum(op4.read_matrix("nas2cam.op4", comm, listed["LAMBDA"]).values[-48:], 0)) / (2 * np.pi)
    whole = read("nas2cam.op4").reduced
    assert made.reduced.size == 54 == whole.size
    assert any("the residual structure (0) is taken" in text and "101 by --variables K=KAA:1,M=MAA:1" in text
               for text in whole.record.warnings)  # fmt: skip
    assert made.reduced.frequencies[6:30] == pytest.approx(known[:24], rel=1e-6)
    # nothing is known of their errors, unless they count as exact
    assert made.accuracy is None and [row["error"] for row in made.budget] == [None, None]
    with pytest.raises(
        hpcred.InputError, match="body 'out' is not known; reduce it to a tolerance, or say exact = true"
    ):
        hpcred.assemble(bodies, joints, band=(0.0, 10.0), tolerance=1e-2)
    exact = [MachineBody(name=item.name, result=item.result, exact=True) for item in bodies]
    found = hpcred.assemble(exact, joints, band=(0.0, 10.0), tolerance=1e-2)
    assert found.accuracy.largest == 0.0 and "where 'out' and 'in' count as exact" in found.sentence
    assert "'out' and 'in' count as exact" in found.reduced.record.accuracy.measured


@pytest.mark.parametrize("kind", ["nastran-op4", "nastran", "abaqus"])
def test_an_external_superelement_is_written_as_one_of_ours(folder, kind):
    """And read again: the same matrices, nodes and places, of EXTSEOUT with all digits."""
    first = read("inboard.op4")
    first = replace(first, reduced=replace(first.reduced, D=1e-4 * first.reduced.K + 2.0 * first.reduced.M))
    assert [item.node for item in first.reduced.interfaces] == [3, 11, 19, 27]
    assert first.reduced.record.frame.kind == "buckens" and first.reduced.rigid_size == 6
    Path("again").mkdir()
    hpcred.write_result("again/body.h5", first.reduced, nodes=first.nodes)
    again = read(hpcred.export("again/body.h5", kind)["output"])
    digits = {"nastran-op4": 1e-14, "nastran": 1e-9, "abaqus": 1e-12}[kind]
    for key in "MKD":
        one, other = (getattr(item.reduced, key) for item in (first, again))
        assert np.abs(one - other).max() < digits * np.abs(one).max()
    assert again.reduced.input_names == first.reduced.input_names
    if kind == "abaqus":
        assert run(["report", "again/body.h5", "-o", "body.html", "--pairs", "3:x/3:x"]) == 0
    assert np.allclose([node.position for node in again.nodes], [node.position for node in first.nodes], atol=1e-9)


def test_several_superelements_of_one_punch_file_are_chosen_by_their_matrices(folder):
    first, text = read("inboard.op4"), ""
    for more, name in ((0, "AAX"), (1000, "BBX")):
        moved = tuple(replace(item, node=item.node + more) for item in first.reduced.interfaces)
        hpcred.write_result("one.h5", replace(first.reduced, interfaces=moved), nodes=first.nodes)
        text += Path(hpcred.export("one.h5", "nastran", f"{name}.pch")["output"]).read_text().replace("AAX", name)
    Path("both.pch").write_text(text)
    for more, name in ((0, "AA"), (1000, "BB")):
        found = read("both.pch", variables={"K": f"K{name}X", "M": f"M{name}X"}).reduced
        assert [item.node for item in found.interfaces] == [3 + more, 11 + more, 19 + more, 27 + more]
        assert np.abs(found.K - first.reduced.K).max() < 1e-9 * np.abs(found.K).max()


def test_sections_of_one_punch_file_are_superelements_of_their_own(folder, capsys):
    """With the same names of matrices and the same numbers of nodes, at other places: chosen by place, and refused
    without; of an OP4 that says the numbers of its superelements, the section of the same number has the nodes."""
    first, text = read("inboard.op4"), ""
    for number, factor in ((101, 1.0), (202, 2.0)):
        scaled = first.reduced.operator.map(lambda matrix, by=factor: by * matrix)
        places = [replace(node, position=factor * node.position) for node in first.nodes]
        nodes = tuple(replace(item, position=tuple(factor * x for x in item.position))
                      for item in first.reduced.interfaces)  # fmt: skip
        hpcred.write_result("one.h5", replace(first.reduced, operator=scaled, interfaces=nodes), nodes=places)
        text += f"BEGIN SUPER={number}\n" + Path(hpcred.export("one.h5", "nastran", "one.pch")["output"]).read_text()
    Path("both.pch").write_text(text)
    K, M = (next(iter(re.findall(rf"DMIG\*? +({key}AAX)", text))) for key in "KM")
    for place in (1, 2):
        found = read("both.pch", variables={"K": f"{K}:{place}", "M": f"{M}:{place}"})
        assert np.abs(found.reduced.K - place * first.reduced.K).max() < 1e-8 * np.abs(found.reduced.K).max()
        for node, other in zip(found.nodes, first.nodes, strict=True):
            assert np.allclose(node.position, place * other.position)
    told = refused(capsys, "convert", "both.pch", "b.h5", "--superelement")
    assert "found matrices of the superelements 101, 202, expected those of one" in told
    told = refused(capsys, "convert", "both.pch", "b.h5", "--superelement", "--variables", f"K={K}:1,M={M}:2")
    assert "found K and M in two sections BEGIN SUPER" in told
    # beside an OP4: the outer one has 22 modes, and is moved here
    section = Path("inboard.pch").read_text()
    modes, names = range(1995001, 1995023), re.findall(r"(?m)^(?:ASET|SPOINT|) +2995.*\n", section)
    for k, line in enumerate(names):
        word, more = line.split(" ")[0], list(modes) * (k in (0, 2, 4))
        step, zero = (8, "") if word == "SPOINT" else (4, f"{0:8d}")
        section_of_modes = "".join(
            f"{word:8}" + "".join(f"{node:8d}{zero}" for node in more[at : at + step]) + "\n"
            for at in range(0, len(more), step))  # fmt: skip
        section = section.replace(line, section_of_modes, 1)
    outer = section.replace("      102", "      101").replace("0.600000000E+03", "0.900000000E+03")
    Path("nas2cam.op2").unlink()
    Path("nas2cam.pch").write_text(outer + Path("inboard.pch").read_text())
    for place, x in ((1, 900.0), (2, 600.0)):
        found = read("nas2cam.op4", variables={"K": f"KAA:{place}", "M": f"MAA:{place}"})
        assert found.nodes[0].node == 3 and found.nodes[0].position[0] == x


def substructure(K, M=None, lines=("1, 2, 3", "3, 1, 2, 3, 4, 5, 6"), nodes=(1, 2, 3, 9001), kind=", LINEAR", **more):
    """The text of a substructure of Abaqus, whose last node has a mode."""

    def half(matrix):
        columns = (", ".join(f"{value:.16e}" for value in matrix[: j + 1, j]) for j in range(len(matrix)))
        return "\n".join(f"{column}," for column in columns)

    text = f"**\n** SUBSTRUCTURE Z1\n*USER ELEMENT, NODES= {len(nodes)}{kind}\n** ELEMENT NODES\n** "
    text += ", ".join(map(str, nodes)) + "\n" + "\n".join(lines) + f"\n*MATRIX,TYPE=STIFFNESS\n{half(K)}\n"
    for key, matrix in {"MASS": M, **more}.items():
        text += "" if matrix is None else f"*MATRIX,TYPE={key}\n{half(matrix)}\n"
    return text


def write_run(text, nodes=NODES):
    Path("sub.mtx").write_text(text)
    lines = "\n".join(", ".join(map(str, node)) for node in nodes)
    Path("job.inp").write_text(f"*NODE\n{lines}\n*NSET, NSET=TIP\n3\n*STEP\n*SUBSTRUCTURE GENERATE\n*END STEP\n")


def test_a_substructure_of_abaqus_has_its_nodes_as_interfaces(tmp_path, monkeypatch):
    """Two nodes of three directions, one of six with the name of its set, and a mode; in mm, t and s as in SI."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(1)
    X = rng.normal(size=(2, 13, 13))
    K, M = X @ X.transpose(0, 2, 1) + 5 * np.eye(13)
    lines = ("1, 2, 3", "3, 1, 2, 3, 4, 5, 6", "4, 1")
    write_run(substructure(K, M, lines, **{"VISCOUS DAMPING": 0.1 * K}))
    found = read("sub.mtx")
    order = [*range(6, 12), *range(6), 12]  # nodes with six directions first
    assert np.allclose(found.reduced.K, K[np.ix_(order, order)], rtol=1e-14)
    assert np.allclose(found.reduced.D, 0.1 * found.reduced.K) and np.allclose(found.reduced.M, M[np.ix_(order, order)])
    assert found.reduced.input_names == tuple([f"TIP:{d}" for d in ("x", "y", "z", "rx", "ry", "rz")]
                                              + [f"{node}:{d}" for node in (1, 2) for d in "xyz"])  # fmt: skip
    assert [item.name for item in found.reduced.interfaces] == ["TIP"] and found.nodes[0].position.tolist() == [
        0.5,
        0.2,
        0.1,
    ]
    squares = eigh(K, M, eigvals_only=True)
    assert found.reduced.frequencies == pytest.approx(np.sqrt(squares) / (2 * np.pi))
    # the same in other units: lengths 1e3, forces 1 (t mm/s^2 = N), so that a displacement in mm is 1e3 times that in m
    g = np.array([*[1e-3] * 9, 1.0, 1.0, 1.0, 1e-3 * np.sqrt(1e3)])  # of a coordinate, in SI
    in_mm = [np.outer(g, g) * matrix / size for matrix, size in ((K, 1e-3), (M, 1e-3))]
    write_run(substructure(*in_mm, lines), [(node, *(1e3 * x for x in place)) for node, *place in NODES])
    other = read("sub.mtx", units="mm,t,s")
    assert np.allclose(other.reduced.K, found.reduced.K) and np.allclose(other.reduced.M, found.reduced.M)
    assert np.allclose(other.nodes[0].position, found.nodes[0].position) and other.reduced.record.units == "mm,t,s"


def test_a_substructure_of_calculix_is_a_spring_between_its_nodes(tmp_path, monkeypatch):
    """CalculiX 2.20 writes the stiffness of the retained dofs, of which the list names a node once for each."""
    monkeypatch.chdir(tmp_path)
    for file in (DATA / "calculix").glob("substructure.*"):
        shutil.copy(file, tmp_path)
    found = read("substructure.mtx")
    entries = np.loadtxt("substructure.sti")
    K = np.zeros((24, 24))
    i, j = entries[:, 0].astype(int) - 1, entries[:, 1].astype(int) - 1
    K[i, j] = K[j, i] = entries[:, 2]
    labels = [f"{dof.partition('.')[0]}:{'xyz'[int(dof.partition('.')[2]) - 1]}"
              for dof in Path("substructure.dof").read_text().split()]  # fmt: skip
    kept = np.array([labels.index(name) for name in found.reduced.input_names])
    assert np.abs(found.reduced.K - K[np.ix_(kept, kept)]).max() < 1e-12 * np.abs(K).max()
    assert not found.reduced.M.any() and any("without mass" in text for text in found.reduced.record.warnings)


def test_a_spring_of_a_superelement_is_a_bushing(tmp_path, monkeypatch):
    """Between two masses, one of which stands on springs."""
    monkeypatch.chdir(tmp_path)
    stiffness = np.diag([2e5, 1e5, 3e5])
    write_run(substructure(np.kron([[1.0, -1.0], [-1.0, 1.0]], stiffness), nodes=(1, 2), lines=("1, 2, 3",)), NODES[:2])
    spring = read("sub.mtx")
    report = hpcred.convert("sub.mtx", "spring.h5", superelement=True)
    assert report["rigid_body_modes"] is report["lowest_frequencies_hz"] is None  # it has no mass
    write_run(substructure(np.diag([1e4, 2e4, 3e4]), 2.0 * np.eye(3), nodes=(1,), lines=("1, 2, 3",)))
    mass = read("sub.mtx")
    bodies = [MachineBody(name="low", result=mass), MachineBody(name="high", result=mass, position=(0.5, 0.0, 0.0))]
    shown = {"inputs": ["high.1"], "outputs": ["high.1"]}
    one = hpcred.assemble([*bodies, MachineBody(name="s", result=spring)],
                          [RigidJoint(bodies=(f"{name}.1", f"s.{k}"), directions="xyz")
                           for k, name in ((1, "low"), (2, "high"))], **shown)  # fmt: skip
    bodies[1] = MachineBody(name="high", result=mass)  # a bushing has no length
    other = hpcred.assemble(bodies, [BushingJoint(bodies=("low.1", "high.1"), stiffness=np.diag(stiffness))], **shown)
    lines = [0.0, 5.0, 14.0, 60.0]
    assert np.allclose(one.frequency_response(lines), other.frequency_response(lines), rtol=1e-9, atol=1e-14)


def test_only_rigid_motions_that_the_rows_know_have_frequency_zero(tmp_path, monkeypatch):
    """A free chain of three masses, whose nodes move in z alone: one motion at 0 Hz, and two frequencies."""
    monkeypatch.chdir(tmp_path)
    K = 1e4 * np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    line = ((1, 0.0, 0.0, 0.0), (2, 0.0, 0.0, 0.5), (3, 0.0, 0.0, 1.0))
    write_run(substructure(K, 2.0 * np.eye(3), ("3",), nodes=(1, 2, 3)), line)
    found = read("sub.mtx").reduced
    assert found.frequencies == pytest.approx(np.sqrt(1e4 / 2.0 * np.array([0.0, 1.0, 3.0])) / (2 * np.pi), rel=1e-9)
    report = hpcred.convert("sub.mtx", "chain.h5", superelement=True)
    assert report["rigid_body_modes"] == 1 and len(report["lowest_frequencies_hz"]) == 3


DAMPING = "*MATRIX INPUT, NAME=DV, TYPE=SYMMETRIC\n1, 1, 1, 1, 3.0\n1, 1, 1, 3, 2.0D-1\n"
VISCOUS = DAMPING + "*MATRIX ASSEMBLE, VISCOUS DAMPING=DV\n"
ONE = substructure(np.eye(3), np.eye(3), nodes=(1,), lines=("1, 2, 3",))


@pytest.mark.parametrize(("text", "words"), [
    (ONE.replace("NODES= 1", "NODES= 2"), "found 1 nodes of the user element, expected NODES=2"),
    (ONE[:-30], "numbers of MASS, expected 6 for 3 rows; the file is cut off or damaged"),
    (ONE.replace("1, 2, 3\n", "1, 2, 9\n"), "expected the dofs (1 to 6) of the first node"),
    (ONE.replace("1, 2, 3\n", "1, 2, 3\n,\n"), "expected the dofs (1 to 6) of the first node"),
    (ONE.replace("1, 2, 3\n", "1, 1, 3\n"), "found node 1, dof 1 in two rows"),
    (ONE + ONE, "found 2 user elements, expected one"),
    (ONE.replace("STIFFNESS", "MASS", 1), "found two matrices of type MASS"),
    (ONE.replace("STIFFNESS", "LOAD", 1), "found no *MATRIX, TYPE=STIFFNESS"),
    (ONE.replace("1.0000000000000000e+00", "nan", 1), "nan"),
    (ONE.replace("1.0000000000000000e+00", "1.0x", 1), "the file is damaged"),
    (ONE.replace("** 1\n", "** 77\n"), "none of them a direction of a node"),
    (ONE.replace("1.0000000000000000e+00", "1_0", 1), "STIFFNESS: found something else than numbers"),
    (ONE + VISCOUS.replace("1, 3, 2", "1, 3"), "found 9 numbers of *MATRIX INPUT, NAME=DV"),
    (ONE + VISCOUS.replace("1, 3, 2", "2, 3, 2"), "NAME=DV that the user element has not"),
])  # fmt: skip
def test_bad_superelements_are_refused_in_one_sentence(tmp_path, monkeypatch, capsys, text, words):
    monkeypatch.chdir(tmp_path)
    write_run(text)
    message = refused(capsys, "convert", "sub.mtx", "body.h5", "--superelement")
    assert words in message and "Traceback" not in message and not Path("body.h5").exists()


def test_damping_beside_a_user_element(tmp_path, monkeypatch):
    """One triangle or both of *MATRIX INPUT; what is not assembled as viscous damping is told of."""
    monkeypatch.chdir(tmp_path)
    both = VISCOUS.replace("SYMMETRIC", "UNSYMMETRIC").replace("*MATRIX A", "1, 3, 1, 1, 0.2\n*MATRIX A")
    for text in (VISCOUS, both):
        write_run(ONE + text)
        assert np.array_equal(read("sub.mtx").reduced.D, [[3.0, 0.0, 0.2], [0.0, 0.0, 0.0], [0.2, 0.0, 0.0]])
    for text, told in (
        (DAMPING, "*MATRIX INPUT, NAME=DV was not read, as no *MATRIX ASSEMBLE has it"),
        (VISCOUS.replace("VISCOUS", "STRUCTURAL"), "*MATRIX ASSEMBLE, STRUCTURAL DAMPING=DV was not read"),
    ):
        write_run(ONE + text)
        found = read("sub.mtx").reduced
        assert not found.D.any() and f"sub.mtx: {told}" in found.record.warnings


def test_a_negative_stiffness_without_mass(tmp_path, monkeypatch):
    """A negative stiffness without mass is no matter of roots and quotients."""
    monkeypatch.chdir(tmp_path)
    write_run(substructure(np.diag([1.0, -1.0, 1.0]), np.diag([1.0, 0, 0]), nodes=(1,), lines=("1, 2, 3",)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = read("sub.mtx").reduced
    assert np.array_equal(found.K, np.diag([1.0, -1.0, 1.0])) and not found.frequencies.any()


def test_a_superelement_has_no_full_model(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_run(ONE)
    assert run(["convert", "sub.mtx", "body.h5", "--superelement"]) == 0
    told = refused(capsys, "evaluate", "body.h5", "--full", "body.h5", "--frequencies", "1")
    assert "body.h5: is a superelement that was read from sub.mtx, which has no full model" in told


def test_what_is_no_superelement_is_refused(tmp_path, monkeypatch, capsys):
    """Rows without names, too many rows, nodes without coordinates, loads beside it."""
    monkeypatch.chdir(tmp_path)
    for size, words in (
        (4, "its rows are not named"),
        (3001, "found 3001 rows, expected a superelement of at most 3000"),
    ):
        lines = "\n".join(f"{k} {k} 1.0" for k in range(1, size + 1))
        Path("K.mtx").write_text(f"%%MatrixMarket matrix coordinate real general\n{size} {size} {size}\n{lines}\n")
        assert words in refused(capsys, "convert", "-K", "K.mtx", "-M", "K.mtx", "body.h5", "--superelement")
    Path("sub.mtx").write_text(ONE)
    assert "the node 1, which has rows, has no coordinates" in refused(
        capsys, "convert", "sub.mtx", "b.h5", "--superelement"
    )
    write_run(ONE)
    told = refused(capsys, "convert", "sub.mtx", "b.h5", "--superelement", "--inputs", "1:x")
    assert "superelement: has all directions of its nodes as inputs and outputs" in told
    with pytest.raises(hpcred.InputError, match="body 'a' is measured, and has no coordinates"):
        MachineBody(name="a", result="a.unv", kind="measured", exact=True)


@pytest.mark.mpi
def test_ranks_read_the_same_superelement(comm):
    folder = DATA / "calculix"
    found = read_superelement(folder / "substructure.mtx", comm).reduced
    alone = read(folder / "substructure.mtx").reduced
    assert np.array_equal(found.K, alone.K) and found.input_names == alone.input_names
    with pytest.raises(hpcred.InputError, match="no such file"):
        read_superelement(folder / "nothing.mtx", comm)


def test_rows_of_zeros_are_directions_of_their_nodes(tmp_path, monkeypatch):
    """A spring in one direction, whose others are rows of zeros: joined in all directions it holds what one of three
    stiffnesses holds, and beside its direction it may be loose, but neither pushed nor looked at."""
    monkeypatch.chdir(tmp_path)
    write_run(substructure(np.kron([[1.0, -1.0], [-1.0, 1.0]], np.diag([2e5, 0.0, 0.0])), nodes=(1, 2),
                           lines=("1, 2, 3",)), NODES[:2])  # fmt: skip
    spring = read("sub.mtx")
    assert spring.reduced.input_names == tuple(f"{node}:{d}" for node in (1, 2) for d in "xyz")
    write_run(substructure(np.diag([1e4, 2e4, 3e4]), 2.0 * np.eye(3), nodes=(1,), lines=("1, 2, 3",)))
    mass = read("sub.mtx")
    bodies = [MachineBody(name="low", result=mass), MachineBody(name="high", result=mass, position=(0.5, 0.0, 0.0)),
              MachineBody(name="s", result=spring)]  # fmt: skip
    shown = {"inputs": ["high.1"], "outputs": ["high.1"]}
    squares = np.sort([1e4, 1e4 + 4e5, 2e4, 2e4, 3e4, 3e4]) / 2.0
    for directions in ("xyz", "x"):
        joints = [RigidJoint(bodies=(f"{name}.1", f"s.{k}"), directions=directions)
                  for k, name in ((1, "low"), (2, "high"))]  # fmt: skip
        made = hpcred.assemble(bodies, joints, **shown)
        assert made.reduced.frequencies == pytest.approx(np.sqrt(squares) / (2 * np.pi))
    with pytest.raises(hpcred.InputError, match="has 4 motions with neither mass nor stiffness, to which inputs"):
        hpcred.assemble(bodies, joints)
