"""Superelements for other programs: every file is read back, by the house's readers, by others, or by one made here."""

import os
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.io
import scipy.linalg
from foreign import gathered
from helpers import interface_model, refused, to_dense

import hpcred
from hpcred.cli.main import run
from hpcred.fe.dofs import SCALAR
from hpcred.model.units import in_si, units_of
from hpcred.parallel.failures import InputError
from hpcred.readers.model_source import load_export
from hpcred.readers.nastran import dmig as nastran_dmig
from hpcred.workflows.export import export_result
from hpcred.writers.abaqus import UserElement
from hpcred.writers.ansys import Matrix50
from hpcred.writers.nastran import DmigCards, ExternalOp4, number
from hpcred.writers.simscape import FlexibleSolid
from hpcred.writers.superelement import superelement

KINDS = [{"modes": 5, "damping": 10.0}, {"modes": 0}, {"modes": 1, "held": True}, {"modes": 9, "damping": 1.0}]
kinds = pytest.mark.parametrize("kind", KINDS, ids=str)


def written(folder, writer, model, stem="arm", suffix=".txt"):
    """The files of a writer in a folder, and its remarks."""
    content, beside, remarks = writer().make(superelement(model), stem)
    for name, data in {suffix: content, **beside}.items():
        (folder / f"{stem}{name}").write_bytes(data if isinstance(data, bytes) else data.encode())
    return folder / f"{stem}{suffix}", remarks


def frequencies(K, M):
    return np.sqrt(np.abs(scipy.linalg.eigh(K, M, eigvals_only=True))) / (2 * np.pi)


def elastic(model, frequencies):
    """The frequencies that are not those of rigid-body motions."""
    return frequencies[6 if superelement(model).is_free else 0 :]


def check(model, K, M, D=None, tolerance=0.0):
    for found, expected in ((K, model.K), (M, model.M), (D, model.D if model.D.any() else None)):
        assert (found is None) == (expected is None)
        if expected is not None:
            assert np.abs(found - expected).max() <= tolerance * np.abs(expected).max()
    limit = 100 * tolerance or 1e-10  # of a square root, in which stiff parts cancel
    assert elastic(model, frequencies(K, M)) == pytest.approx(elastic(model, model.frequencies), rel=limit)


def check_labels(model, node, direction, places):
    """Rows are the six directions of each interface node, then scalar points."""
    modes = model.size - 12
    assert node.tolist() == [101] * 6 + [205] * 6 + list(range(206, 206 + modes))
    assert direction.tolist() == [*range(6), *range(6), *[SCALAR] * modes]
    assert np.allclose(places[[0, 6]], [item.position for item in model.interfaces], rtol=1e-10)


@kinds
@pytest.mark.parametrize("writer, suffix, tolerance", [(DmigCards, ".pch", 1e-10), (ExternalOp4, ".op4", 0.0)])
def test_nastran_reads_back_with_its_points(tmp_path, comm, kind, writer, suffix, tolerance):
    model = interface_model(**kind)
    path, _ = written(tmp_path, writer, model, suffix=suffix)
    with load_export(path, comm) as found:
        D = None if found.D is None else to_dense(found.D)
        check(model, to_dense(found.K), to_dense(found.M), D, tolerance)
        check_labels(model, *gathered(comm, found.dofs.node, found.dofs.direction, found.dofs.position))


def test_rows_of_op4_ascend_with_the_node_numbers(tmp_path, comm):
    """Whatever the order of the interfaces in the job: the matrices have no numbers of their own."""
    model = interface_model(modes=2, damping=10.0)
    left, right = model.interfaces
    path, _ = written(tmp_path, ExternalOp4, replace(model, interfaces=(replace(left, node=907), right)), suffix=".op4")
    rows = np.r_[6:12, 0:6, 12 : model.size]
    with load_export(path, comm) as found:
        node, _, places = gathered(comm, found.dofs.node, found.dofs.direction, found.dofs.position)
        assert node.tolist() == [205] * 6 + [907] * 6 + [908, 909]
        assert np.allclose(places[[0, 6]], [right.position, left.position], rtol=1e-10)
        for key in "KMD":
            assert np.array_equal(to_dense(found.matrices[key]), getattr(model, key)[np.ix_(rows, rows)])


def test_nastran_numbers_use_their_sixteen_columns():
    rng = np.random.default_rng(1)
    values = rng.choice([-1, 1], 2000) * 10.0 ** rng.uniform(-120, 120, 2000)
    for value in [*values.tolist(), 0.0, 1.0, 9.99999999999999e9, -1e-300]:
        text = number(value)
        assert len(text) == 16
        limit = 1e-9 if abs(np.log10(abs(value) or 1)) < 99 else 1e-8
        assert float(text.replace("D", "E")) == pytest.approx(value, rel=limit, abs=0)


def test_structural_damping_for_nastran(tmp_path, comm):
    model = interface_model(loss_factor=0.04)
    path, remarks = written(tmp_path, DmigCards, model, suffix=".pch")
    assert "K42GG = K4AAX" in path.read_text() and "B2GG" not in path.read_text()
    found = nastran_dmig.read(path, comm, "K", {"K": "K4AAX"})
    expected = 0.04 * model.K
    assert np.sort(found.values) == pytest.approx(np.sort(expected[np.nonzero(expected)]), rel=1e-9)
    assert any("PARAM,W4" in remark for remark in remarks)


@pytest.mark.peers("pyyeti")
@pytest.mark.parametrize("kind", KINDS[:2], ids=str)
def test_nastran_files_in_pyyeti(tmp_path, kind):
    """docs/export-superelements.md has what pyYeti and pyNastran found."""
    from pyyeti.nastran import bulk, op4

    model = interface_model(**kind)
    path, _ = written(tmp_path, ExternalOp4, model, suffix=".op4")
    found = op4.read(str(path))
    check(model, found["kxx"], found["mxx"], found.get("bxx"))
    assert len(bulk.rdextrn(str(path.with_suffix(".pch")))) == model.size
    path, _ = written(tmp_path, DmigCards, model, "cards", ".pch")
    found = bulk.rddmig(str(path))
    check(model, *(found[key].to_numpy() if key in found else None for key in ("kaax", "maax", "baax")), 1e-10)


@pytest.mark.peers("pyNastran")
@pytest.mark.parametrize("kind", KINDS[:2], ids=str)
def test_nastran_files_in_pynastran(tmp_path, kind):
    from pyNastran.bdf.bdf import BDF
    from pyNastran.op4.op4 import read_op4

    model = interface_model(**kind)
    path, _ = written(tmp_path, ExternalOp4, model, suffix=".op4")
    found = read_op4(str(path))
    check(model, *(found[key].data if key in found else None for key in ("KXX", "MXX", "BXX")))
    path, _ = written(tmp_path, DmigCards, model, "cards", ".pch")
    deck = BDF(debug=None)
    deck.read_bdf(str(path), xref=False, punch=True)
    found = {key: card.get_matrix(is_sparse=False)[0] for key, card in deck.dmig.items()}
    check(model, found["KAAX"], found["MAAX"], found.get("BAAX"), 1e-10)


SIZES = {"mm,t,s": (1e-3, 1e3, 1.0), "mm-kg-ms": (1e-3, 1.0, 1e-3)}  # of length, mass and time in SI


@pytest.mark.parametrize(
    "format, ending", [("nastran", ".pch"), ("nastran-op4", "_external.op4"), ("abaqus", "_abaqus.inp")]
)
def test_names_in_other_bytes_than_utf_8(tmp_path, comm, capsys, format, ending):
    """Files have the bytes of the name, cards too, and matrices are read back; ANSYS has no such names."""
    model = interface_model(modes=5, damping=10.0)
    hpcred.write_result(tmp_path / "arm.h5", model)
    source = str(tmp_path / "arm\udcff.h5")
    os.rename(tmp_path / "arm.h5", source)
    before = set(os.listdir(os.fsencode(tmp_path)))
    assert run(["--quiet", "export", source, "--format", format]) == 0
    path = tmp_path / f"arm\udcff{ending}"
    made = set(os.listdir(os.fsencode(tmp_path))) - before
    assert made == {b"arm\xff" + ending.encode(), *([b"arm\xff_external.pch"] if format == "nastran-op4" else [])}
    assert hpcred.info(path)["format"]
    if format == "abaqus":
        matrices = abaqus(path.read_text(encoding="latin-1"))[2]
        assert np.allclose(matrices["STIFFNESS"], model.K, rtol=1e-9, atol=1e-10 * np.abs(model.K).max())
        assert "a name that commands of ANSYS cannot hold" in refused(capsys, "export", source, "--format", "ansys")
        return
    with load_export(path, comm) as found:
        check(model, *(to_dense(found.matrices[key]) for key in "KMD"), tolerance=1e-9)
    if format == "nastran-op4":
        assert b"the matrices of arm\xff_external.op4;" in path.with_suffix(".pch").read_bytes()


@pytest.mark.parametrize("text", SIZES)
def test_superelements_in_other_units(tmp_path, comm, text):
    """By formula for forces, moments and modal coordinates, read back from every program; frequencies stay in Hz."""
    model = interface_model(modes=5, damping=10.0)
    hpcred.write_result(tmp_path / "arm.h5", model)
    L, M, T = SIZES[text]
    names = ("nastran", "nastran-op4", "ansys", "abaqus")
    files = {name: Path(export_result(tmp_path / "arm.h5", name, units=text)["output"]) for name in names}
    # an energy is 1/2 q^T K q, a length of the program is L m, and modal coordinates keep V^T M V = I
    g = np.array([*[L, L, L, 1, 1, 1] * 2, *[L * np.sqrt(M)] * 5])
    both, inertia = np.outer(g, g), M * L**2
    expected = {"K": both * model.K * T**2 / inertia, "M": both * model.M / inertia, "D": both * model.D * T / inertia}
    assert np.allclose(np.diag(expected["M"])[12:], 1)
    found = {}
    for name in names[:2]:
        with load_export(files[name], comm) as read:
            found[name] = {key: to_dense(mat) for key, mat in read.matrices.items()}
            assert np.allclose(read.dofs.position[0] * L, model.interfaces[0].position)
            with in_si(read, units_of(text)) as back:  # another way: rows of interface nodes are those of SI
                assert np.allclose(to_dense(back.K)[:12, :12], model.K[:12, :12], rtol=1e-8)
                eigenvalues = scipy.linalg.eigh(to_dense(back.K), to_dense(back.M), eigvals_only=True)
    assert np.sqrt(eigenvalues[6:]) / (2 * np.pi) == pytest.approx(model.frequencies[6:], rel=1e-8)
    nodes, _, matrices = abaqus(files["abaqus"].read_text())
    assert np.allclose(np.array(nodes[205]) * L, model.interfaces[1].position)
    found["abaqus"] = {"K": matrices["STIFFNESS"], "M": matrices["MASS"], "D": matrices["VISCOUS DAMPING"]}
    found["ansys"] = {key: scipy.io.mmread(tmp_path / f"arm_ansys_{key}.mtx") for key in "KMD"}
    for name, key in ((name, key) for name in names for key in "KMD"):
        assert np.allclose(found[name][key], expected[key], rtol=1e-9, atol=1e-10 * np.abs(expected[key]).max()), name
    with pytest.raises(InputError, match="'simscape' is in SI"):
        export_result(tmp_path / "arm.h5", "simscape", units=text)


def abaqus(text):
    """Nodes, nodes and directions of the rows, and matrices of an input file, as the Keywords Reference says."""
    nodes, rows, matrices, assembled = {}, [], {}, {}
    keyword, given, half, places = "", {}, [], []
    for line in [line for line in text.splitlines() if not line.startswith("**")] + ["*END"]:
        assert len(line) <= 256
        if not line.startswith("*"):
            fields = [field.strip() for field in line.split(",")]
            assert max(map(len, fields)) <= 20  # of a number
            if keyword == "*NODE":
                nodes[int(fields[0])] = [float(field) for field in fields[1:]]
            elif keyword == "*USER ELEMENT":
                first, *rest = map(int, fields)
                places.append((1, [first, *rest]) if not places else (first, rest))
            elif keyword == "*MATRIX":
                assert len(fields) > 1  # a number that stands alone has a comma behind it
                fields = [field for field in fields if field]
                assert len(fields) <= 4
                half[-1].extend(map(float, fields))
                if len(half[-1]) == len(half):  # a column ends on the diagonal, and the next begins on a new line
                    half.append([])
            elif keyword == "*ELEMENT":
                places.append(("nodes", [int(field) for field in fields if field]))
                assert len(fields) <= 16
            elif keyword == "*MATRIX INPUT":
                *pair, value = fields
                assembled[given["NAME"]].append((*map(int, pair), float(value)))
            continue
        if keyword == "*MATRIX":
            assert half.pop() == []
            size = len(half)
            matrix = np.zeros((size, size))
            for j, column in enumerate(half):
                matrix[: j + 1, j] = matrix[j, : j + 1] = column
            matrices[given["TYPE"]] = matrix
        keyword, *options = (part.strip() for part in line.split(","))
        given = dict(part.split("=") for part in options if "=" in part)
        half = [[]]
        if keyword == "*MATRIX INPUT":
            assembled[given["NAME"]] = []
        if keyword == "*USER ELEMENT":
            assert "LINEAR" in options and int(given["TYPE"][1:]) < 10000
            count = int(given["NODES"])
        if keyword == "*MATRIX ASSEMBLE":
            matrices.update({key: assembled.pop(name) for key, name in given.items()})
    assert not assembled
    order = [node for key, numbers in places if key == "nodes" for node in numbers][1:]
    assert len(order) == count
    starts = [item for item in places if item[0] != "nodes"]
    for place, node in enumerate(order, 1):
        directions = [found for first, found in starts if first <= place][-1]
        rows += [(node, direction) for direction in directions]
    for key, entries in matrices.items():
        if isinstance(entries, list):
            matrices[key] = np.zeros((len(rows), len(rows)))
            for a, b, c, d, value in entries:
                i, j = rows.index((a, b)), rows.index((c, d))
                matrices[key][i, j] = matrices[key][j, i] = value
    return nodes, rows, matrices


@pytest.mark.parametrize("kind", [*KINDS, {"modes": 40, "loss_factor": 0.03}], ids=str)
def test_abaqus_reads_back(tmp_path, kind):
    model = interface_model(**kind)
    path, _ = written(tmp_path, UserElement, model)
    nodes, rows, matrices = abaqus(path.read_text())
    assert rows[:12] == [(node, direction) for node in (101, 205) for direction in range(1, 7)]
    assert rows[12:] == [(206 + k // 3, 1 + k % 3) for k in range(model.size - 12)]
    assert set(nodes) == {node for node, _ in rows}
    for item in model.interfaces:
        assert nodes[item.node] == pytest.approx(item.position, rel=1e-13)
    check(model, matrices["STIFFNESS"], matrices["MASS"], matrices.get("VISCOUS DAMPING"), 1e-13)
    if model.loss_factor:
        assert np.allclose(matrices["STRUCTURAL DAMPING"], 0.03 * model.K, rtol=1e-12, atol=0)


@kinds
def test_ansys_reads_back(tmp_path, kind):
    model = interface_model(**kind)
    path, _ = written(tmp_path, Matrix50, model, suffix=".inp")
    lines = [line.split("!")[0].strip() for line in path.read_text().splitlines()]
    assert max(map(len, lines)) <= 128
    table = np.zeros((model.size, 2), int)
    for match in filter(None, (re.fullmatch(r"HPC_R\((\d+),(\d)\)=(.*)", line) for line in lines)):
        values = match[3].split(",")
        assert len(values) <= 10
        table[int(match[1]) - 1 : int(match[1]) - 1 + len(values), int(match[2]) - 1] = values
    assert table[:12].tolist() == [[node, direction] for node in (101, 205) for direction in range(1, 7)]
    assert table[12:].tolist() == [[206 + k // 3, 1 + k % 3] for k in range(model.size - 12)]
    taken = dict(re.findall(r"^\*DMAT,(HPC_\w),D,IMPORT,MMF,(.*)$", "\n".join(lines), re.M))
    given = [line.split(",")[1:] for line in lines if line.startswith("*EXPORT")]
    assert [item[-1] for item in given] == ["WAIT"] * (len(given) - 1) + ["DONE"]
    assert {(*item[1:3], item[4]) for item in given} == {("SUB", "arm.sub", "HPC_ROWS")}
    found = {kind: scipy.io.mmread(tmp_path / taken[name]) for name, _, _, kind, *_ in given}
    check(model, found["STIFF"], found["MASS"], found.get("DAMP"))
    points = {int(n): list(map(float, xyz)) for n, *xyz in (line.split(",")[1:] for line in lines if line[:2] == "N,")}
    assert set(points) == set(table[:, 0])
    assert np.allclose([points[item.node] for item in model.interfaces], [item.position for item in model.interfaces])
    assert "SE,arm" in lines
    # nothing that a second body would make again is left
    made = {line.split(",")[1] for line in lines if line.startswith(("*DIM", "*DMAT"))}
    given_back = {line.split(",")[1] for line in lines if line.startswith(("*DEL", "*FREE"))}
    assert made == given_back == {"HPC_R", "HPC_ROWS", *taken}


@pytest.mark.parametrize("kind", [KINDS[0], KINDS[1]], ids=str)
def test_simscape_reads_back_and_is_free(tmp_path, kind):
    model = interface_model(**kind)
    path, _ = written(tmp_path, FlexibleSolid, model, suffix=".mat")
    found = scipy.io.loadmat(path)
    check(model, found["K"], found["M"], found["D"] if model.D.any() else None)
    assert found["D"].shape == found["K"].shape
    assert np.array_equal(found["origins"], [item.position for item in model.interfaces])
    assert [str(item[0]) for item in found["frames"].ravel()] == ["left", "right"]
    assert found["orientations"].tolist() == [[1, 0, 0, 0]] * 2
    # a rotation about the origin in the order Tx Ty Tz Rx Ry Rz of each frame meets no force
    axis = np.array([0.3, -0.5, 0.8])
    motion = np.concatenate([[*np.cross(axis, origin), *axis] for origin in found["origins"]])
    forces = found["K"][:, :12] @ motion
    assert np.abs(forces).max() < 1e-10 * np.abs(found["K"][:12, :12]).max()
    assert (frequencies(found["K"], found["M"])[:7] < 0.01).tolist() == [True] * 6 + [False]


def test_one_frame_of_a_free_body_is_free():
    """Its K is zero up to round-off."""
    model = interface_model()
    kept = np.r_[0:6, 12 : model.size]
    T = np.zeros((model.size, 6 + model.size - 12))
    T[:6, :6], T[12:, 6:] = np.eye(6), np.eye(model.size - 12)
    T[6:12, :6] = -np.linalg.solve(model.K[6:12, 6:12], model.K[6:12, :6])
    one = replace(model, K=T.T @ model.K @ T, M=T.T @ model.M @ T, D=np.zeros((len(kept),) * 2), B=model.B[kept],
                  C=model.C[:, kept], interfaces=model.interfaces[:1])  # fmt: skip
    assert superelement(one).is_free
    # with a single node nothing but the reduction tells round-off from soft springs
    rigid = replace(one, **{key: getattr(one, key)[:6, :6] for key in "KMD"}, B=one.B[:6], C=one.C[:, :6])
    assert not superelement(rigid).is_free
    assert superelement(replace(rigid, record=SimpleNamespace(rigid_body_modes=6))).is_free
    assert not superelement(replace(one, record=SimpleNamespace(rigid_body_modes=0))).is_free
    massless = replace(one, M=np.diag([0.0, *np.ones(one.size - 1)]))
    with pytest.raises(InputError, match="not positive definite"):
        FlexibleSolid().make(superelement(massless), "arm")
    assert not superelement(interface_model(held=True)).is_free


def test_what_is_refused():
    model = interface_model(loss_factor=0.02)
    with pytest.raises(InputError, match=r'write coordinates = "interface" and a table \[\[interface\]\]'):
        superelement(replace(model, interfaces=()))
    for writer in (Matrix50, FlexibleSolid):
        with pytest.raises(InputError, match=r"loss factor 0.02\) has no meaning in time.*ratio = 0.01"):
            writer().make(superelement(model), "arm")
    with pytest.raises(InputError, match="found a body that is held.*without supports"):
        FlexibleSolid().make(superelement(interface_model(held=True)), "arm")
    with pytest.raises(InputError, match="33 characters.*shorter one by -o"):
        Matrix50().make(superelement(interface_model()), "a" * 33)
    for name in ("my arm", "arm.v2", "arm,left", "arm!", "träger"):
        with pytest.raises(InputError, match=f"output {name}: found a name that .* '_' and '-'; choose another by -o"):
            Matrix50().make(superelement(interface_model()), name)
    D = np.zeros((model.size,) * 2)
    D[0, 1], D[1, 0] = 1, -1
    with pytest.raises(InputError, match="matrix D that is not symmetric.*gyroscopic"):
        superelement(replace(model, D=D))
    far = tuple(replace(item, node=10**8 + k) for k, item in enumerate(model.interfaces))
    with pytest.raises(InputError, match="found the node number 100000001, expected at most 8 digits.*give node = "):
        DmigCards().make(superelement(replace(model, interfaces=far)), "arm")


def test_inputs_that_are_no_direction_of_an_interface_are_said():
    model = interface_model()
    assert superelement(model).remarks == ()
    B = model.B.copy()
    B[13, 1] = 0.5
    other = superelement(replace(model, B=B, C=2 * model.C))
    assert other.remarks == (
        "inputs that are no direction of an interface node are left out: left y",
        "outputs that are no direction of an interface node are left out: right x, right y",
    )
    Cv = np.zeros_like(model.C)
    Cv[0, 0] = 1.0
    first = model.output_names[0]
    remark = f"outputs that are no direction of an interface node are left out: {first}"
    assert superelement(replace(model, Cv=Cv)).remarks == (remark,)


def test_loads_come_with_the_matrices_of_simscape(tmp_path):
    """The load of a rigid face: its force and moment at the frame, and its column in interface coordinates."""
    with hpcred.solid((6, 2, 3), clamped=False) as model:
        ends = [hpcred.Interface(name=name, nodes=hpcred.Nodes(box=((x - 1e-3, -1.0, -1.0), (x + 1e-3, 1.0, 1.0))),
                                 kind="rigid") for name, x in (("left", 0.0), ("right", 0.06))]  # fmt: skip
        push = hpcred.loads.Traction(name="push", on="right", value=(1e4, 2e4, 0.0))
        with (
            model.with_interfaces(ends) as marked, marked.with_inputs(["left", "right"]) as forced,
            forced.with_loads([push]) as loaded,
            hpcred.reduce(loaded, [hpcred.CraigBampton(count=4)], hpcred.Buckens(), coordinates="interface") as rom,
        ):  # fmt: skip
            path, remarks = written(tmp_path, FlexibleSolid, rom, suffix=".mat")
            (sums,) = loaded.loads
            at = np.array(loaded.interfaces[1].position)
    found = scipy.io.loadmat(path)
    assert [str(name[0]) for name in found["load_names"].ravel()] == ["push"]
    column = found["loads"][:, 0]
    wrench = [*sums.force, *np.subtract(sums.moment, np.cross(at, sums.force))]
    assert column[6:12] == pytest.approx(wrench, abs=1e-9 * np.abs(wrench).max())
    assert np.abs(column[:6]).max() < 1e-9 * np.abs(wrench).max() and np.abs(column[12:]).max() < 1e-6
    assert remarks[-1] == "`loads` in the file has the forces of push on frames and modal coordinates"
