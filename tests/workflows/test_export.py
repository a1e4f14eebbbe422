"""Files for other programs: SID, MATLAB, NumPy, ParaView and pictures; and simulations from the command line."""

import json
import re
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest
import scipy.io
from conftest import DATA

import hpcred as package
from hpcred import read_body, read_sid, write_sid
from hpcred.cli import run

JOB = """
model = "model.h5"
output = "result.h5"
inputs = [[20, "z"], [1, "x"]]
[frame]
kind = "buckens"
[damping]
kind = "rayleigh"
alpha = 2.0
beta = 1e-5
[[basis]]
kind = "modes"
index = [7, 8, 9, 10, 11, 12]
"""
SIM = """
body = "result.h5"
end = 0.05
steps = 20
observe = [10]
[[force]]
kind = "sine"
node = 20
amplitude = [0.0, 0.0, -10.0]
frequency = 5.0
[[force]]
kind = "table"
node = 1
times = [0.0, 0.01]
values = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
[[constraint]]
node = 1
[[constraint]]
node = 7
directions = ["x", "z"]
[[constraint]]
node = 14
directions = ["z"]
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with the linkage, reduced by a job."""
    folder = tmp_path_factory.mktemp("made")
    with package.linkage() as model:
        package.write_model(folder / "model.h5", model)
    (folder / "job.toml").write_text(JOB)
    assert run(["reduce", str(folder / "job.toml")]) == 0
    return folder


@pytest.fixture
def folder(made, tmp_path, monkeypatch):
    """The current folder, empty but for links to what was made, and a good sim.toml."""
    monkeypatch.chdir(tmp_path)
    for name in ("model.h5", "result.h5", "job.toml"):
        (tmp_path / name).symlink_to(made / name)
    (tmp_path / "sim.toml").write_text(SIM)
    return tmp_path


def refused(capsys, *arguments):
    before = sorted(Path().iterdir())
    capsys.readouterr()
    assert run(list(arguments)) == 2
    message = capsys.readouterr().err
    assert message.startswith("hpcred: error: ") and message.count("\n") == 1, message
    assert sorted(Path().iterdir()) == before
    return message


def skew(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def numbers_of(path):
    """Name of object -> {indices: value}, by an independent reader of the text."""
    objects, name = {}, None
    for line in Path(path).read_text().splitlines():
        words = line.split()
        if len(words) == 1 and words[0] not in ("part", "refmod"):
            name = words[0]
        found = re.match(r"\s*(m\d)\(\s*([\d,\s]+)\)\s*=\s*(\S+)", line)
        if found:
            key = (found[1], *(int(i) for i in found[2].split(",")))
            objects.setdefault(name, {})[key] = float(found[3].replace("D", "e"))
    return objects


@pytest.mark.parametrize("name, modes, nodes", [("balken1m", 1, None), ("beam", 11, None)])
def test_sid_files_of_another_program(name, modes, nodes, tmp_path):
    """They parse, satisfy the definitions of the quantities, and come out again as they were."""
    sid = read_sid(DATA / f"sid/{name}.SID_FEM")
    assert len(sid.coordinates) == modes and sid.mass > 0
    own = sid.objects
    for k in range(modes):
        assert own["mdCM"].m1[:, k, 0] == pytest.approx(own["Ct"].m0[k], rel=1e-9, abs=1e-12)
        gr = own["Gr"].m0[:, 3 * k : 3 * k + 3]
        xx, yy, zz, xy, xz, yz = own["J"].m1[:, k, 0]
        slope = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert (gr + gr.T) / 2 == pytest.approx(slope, rel=1e-8, abs=1e-9)
        assert own["Oe"].m0[k] == pytest.approx([-xx / 2, -yy / 2, -zz / 2, -xy, -yz, -xz], rel=1e-8, abs=1e-9)
    assert own["Cr"].m1 == pytest.approx(-own["Cr"].m1.transpose(1, 0, 2), rel=1e-9, abs=1e-12)
    for frame in sid.frames:
        for k in range(modes):
            assert frame.objects["AP"].m1[:, k, :] == pytest.approx(skew(frame.objects["psi"].m0[:, k]), abs=1e-12)
    write_sid(tmp_path / "again.SID_FEM", sid)
    lines, again = (
        (path).read_text().split("\n") for path in (DATA / f"sid/{name}.SID_FEM", tmp_path / "again.SID_FEM")
    )
    assert [line.rstrip() for line in again] == [line.rstrip() for line in lines]


def test_sid_of_ours(folder):
    assert run(["export", "result.h5", "--format", "sid", "--nodes", "1,7,20"]) == 0
    body, sid = read_body("result.h5", [1, 7, 20]), read_sid("result.SID_FEM")
    frame, count = body.frame, body.rom.size
    assert [item.node for item in sid.frames] == [1, 7, 20]
    assert sid.mass == pytest.approx(frame.mass) and sid.objects["Cr"].m1.shape == (count, count, 3)
    write_sid("again.SID_FEM", sid)
    assert Path("again.SID_FEM").read_text() == Path("result.SID_FEM").read_text()
    text = numbers_of("result.SID_FEM")
    for k in range(count):
        assert text["Ke"]["m0", k + 1, k + 1] == pytest.approx((2 * np.pi * body.rom.frequencies[k]) ** 2, rel=1e-10)
    assert text["mdCM"]["m0", 1, 1] == pytest.approx(frame.mc[0])
    assert text["J"]["m0", 3, 1] == pytest.approx(frame.J[2, 2])
    assert text["De"]["m0", 2, 2] == pytest.approx(body.rom.D[1, 1])
    for i, shape in enumerate(body.nodes):
        objects = sid.frames[i].objects
        assert objects["phi"].m0 == pytest.approx(shape.phi, rel=1e-10, abs=1e-10 * np.abs(shape.phi).max())
        assert objects["psi"].m0 == pytest.approx(shape.psi, rel=1e-10, abs=1e-10 * np.abs(shape.psi).max())
        assert objects["origin"].m0[:, 0] == pytest.approx(shape.position)
        assert objects["origin"].m1[:, :, 0] == pytest.approx(shape.phi, rel=1e-10, abs=1e-10)


def test_arrays_for_matlab_and_numpy(folder):
    for kind in ("matlab", "npz"):
        assert run(["export", "result.h5", "--format", kind]) == 0
    body = read_body("result.h5")
    for file in (scipy.io.loadmat("result.mat"), np.load("result.npz")):
        assert np.allclose(file["K"], body.rom.K, rtol=0) and np.allclose(file["Cr1"], body.frame.Cr1, rtol=0)
        assert file["nodes"].ravel().tolist() == [1, 20]
        assert np.allclose(file["phi"], [shape.phi for shape in body.nodes], rtol=0)


def test_shapes_for_paraview_and_as_a_picture(folder):
    for kind in ("vtk", "png"):
        assert run(["export", "result.h5", "--format", kind]) == 0
    mesh = meshio.read("result.vtu")
    assert [(block.type, len(block.data)) for block in mesh.cells] == [("line", 19)]
    with h5py.File("result.h5") as file:
        V, node, direction = file["basis/V"][...], file["dofs/node"][...], file["dofs/direction"][...]
    assert mesh.point_data["node"].tolist() == list(range(1, 21))
    names = [name for name in mesh.point_data if name != "node"]
    assert names[0] == "pseudo-mode 1: 33.3047 Hz" and len(names) == 6
    for row, name in zip(V, names, strict=True):
        for d in range(3):
            assert mesh.point_data[name][node[direction == d] - 1, d] == pytest.approx(row[direction == d])
    assert Path("result.png").read_bytes()[:4] == b"\x89PNG" and Path("result.png").stat().st_size > 20_000


@pytest.mark.parametrize("name, kind, count", [("blockC3D10", "tetra10", 122), ("blockC3D8", "hexahedron", 90)])
def test_elements_of_abaqus_reach_paraview(tmp_path, monkeypatch, hpcred, name, kind, count):
    monkeypatch.chdir(tmp_path)
    for file in DATA.glob(f"{name}*"):
        (tmp_path / file.name).symlink_to(file)
    assert hpcred("convert", f"{name}.inp", "model.h5", "--inputs", "1:x", ranks=3).returncode == 0
    (tmp_path / "job.toml").write_text(JOB.replace('[[20, "z"], [1, "x"]]', "[1]"))
    assert hpcred("reduce", "job.toml", ranks=2).returncode == 0
    assert run(["export", "result.h5", "--format", "vtk"]) == 0
    mesh = meshio.read("result.vtu")
    cells = mesh.cells_dict[kind]
    assert cells.shape == (count, 10 if kind == "tetra10" else 8)
    corners = mesh.points[cells]
    if kind == "tetra10":  # each middle node lies between its corners
        pairs = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
        for place, (a, b) in enumerate(pairs, start=4):
            assert corners[:, place] == pytest.approx((corners[:, a] + corners[:, b]) / 2, abs=1e-6)
        edges = corners[:, 1:4] - corners[:, :1]
        volume = np.abs(np.linalg.det(edges)).sum() / 6
    else:
        edges = corners[:, [1, 3, 4]] - corners[:, :1]
        volume = np.abs(np.linalg.det(edges)).sum()  # parallelepipeds
    size = np.ptp(mesh.points, axis=0)
    assert volume == pytest.approx(np.prod(size), rel=1e-6)


def test_simulation_from_a_file(folder, capsys, hpcred):
    assert run(["simulate", "sim.toml", "--json", "sim.json", "--set", "velocity=[0.0, 0.0, 1.0]"]) == 0
    said = capsys.readouterr().out
    assert "constraint drift" in said and "note: the initial velocities did not fit the constraints" in said
    report = json.loads(Path("sim.json").read_text())
    assert report["constraint_drift_m"] < 1e-8 and report["energy_defect"] < 1e-4
    table = np.genfromtxt("simulation.csv", delimiter=",", names=True)
    with h5py.File("simulation.h5") as file:
        assert file["nodes/number"][...].tolist() == [1, 7, 10, 14, 20]
        assert file["nodes/displacement"].shape == (21, 5, 3)
        assert file["constraints/name"][...].tolist() == [b"1:x", b"1:y", b"1:z", b"7:x", b"7:z", b"14:z"]
        assert table["t"] == pytest.approx(np.linspace(0, 0.05, 21))
        assert table["displacement_20_z"] == pytest.approx(file["nodes/displacement"][:, 4, 2], abs=1e-10)
        assert table["constraint_force_7_z"] == pytest.approx(file["constraints/force"][:, 4], rel=1e-6, abs=1e-6)
        assert table["energy_work"] == pytest.approx(file["energy/work"][...], abs=1e-9)
        record = json.loads(file["provenance"][()])
        assert record["setup"]["velocity"] == [0.0, 0.0, 1.0] and "hpcred" in record["versions"]
        alone = file["elastic"][...]
    assert Path("simulation.png").read_bytes()[:4] == b"\x89PNG"
    again = hpcred("simulate", "sim.toml", "--set", "velocity=[0.0, 0.0, 1.0]", ranks=3)
    assert again.returncode == 0, again.stderr
    with h5py.File("simulation.h5") as file:
        assert file["elastic"][...] == pytest.approx(alone, abs=1e-7 * np.abs(alone).max())


@pytest.mark.parametrize(
    "change, says",
    [
        ("ende=1.0", r"ende: unknown key \(did you mean 'end'\?\)"),
        ("end=-1.0", "end: found -1, expected more than 0"),
        ("end=soon", "end: found 'soon', expected a number"),
        ("start=rest", "start: found 'rest', expected 'given' or 'static'"),
        ("force.0.kind=cosine", r"force\[0\].kind: found 'cosine', expected one of constant, sine, table"),
        ("force.0.frequency=0.0", "force.frequency: found 0, expected a positive frequency"),
        ("force.1.times=[0.0]", "found 2 forces for 1 times"),
        ("force.1.times=[1.0, 0.0]", "expected ascending times"),
        ("force.0.node=99", "result.h5: node 99 does not exist"),
        ("constraint.1.directions=['x', 'q']", r"constraint.directions: found \['x', 'q'\]"),
        ("gravity=[0.0, 1.0]", r"gravity: found \[0.0, 1.0\], expected \[a number, a number, a number\]"),
        ("body=model.h5", "found an HDF5 file of format 'hpcred-model', expected 'hpcred-result'"),
        ("output=nowhere/out.h5", "the folder nowhere does not exist"),
    ],
)  # fmt: skip
def test_simulations_are_refused(folder, capsys, change, says):
    assert re.search(says, refused(capsys, "simulate", "sim.toml", "--set", change))


def test_static_start_needs_a_held_body(folder, capsys):
    Path("sim.toml").write_text(SIM[: SIM.index("[[constraint]]")])
    message = refused(capsys, "simulate", "sim.toml", "--set", "start=static")
    assert "needs constraints that hold the body, but they leave 6 rigid motions free" in message


def test_exports_are_refused(folder, capsys):
    assert "--format: found 'sidd', expected one of sid, matlab" in refused(
        capsys, "export", "result.h5", "--format", "sidd"
    )
    assert "node 99 does not exist" in refused(capsys, "export", "result.h5", "--nodes", "99")
    assert "'vtk' shows all nodes" in refused(capsys, "export", "result.h5", "--format", "vtk", "--nodes", "1")


def test_a_body_without_coordinates_is_no_body(folder, capsys):
    with package.linkage() as model:
        model.dofs = None
        package.write_model("plain.h5", model)
    job = ["reduce", "job.toml", "--set", "model=plain.h5", "--set", "output=plain_result.h5"]
    Path("job.toml").unlink()
    Path("job.toml").write_text(
        JOB.replace('[frame]\nkind = "buckens"\n', "")
        .replace('[[20, "z"], [1, "x"]]', "[1]")
        .replace('"modes"\nindex = [7, 8, 9, 10, 11, 12]', '"krylov"\nfrequency = 9.0')
    )
    assert run(job) == 0
    for arguments in (["export", "plain_result.h5"], ["simulate", "sim.toml", "--set", "body=plain_result.h5"]):
        assert "no floating-frame quantities; the model had no node coordinates" in refused(capsys, *arguments)
    message = refused(capsys, "export", "plain_result.h5", "--format", "vtk")
    assert "no basis with node coordinates" in message


def test_nodes_without_rotations_are_said(folder, capsys):
    with package.solid((3, 2, 2), inputs=3) as model:
        package.write_model("solid.h5", model)
    Path("solid.toml").write_text(
        'model = "solid.h5"\noutput = "solid_result.h5"\n[[basis]]\nkind = "static_correction"'
    )
    assert run(["reduce", "solid.toml"]) == 0
    capsys.readouterr()
    assert run(["export", "solid_result.h5"]) == 0
    assert "no rotational dofs at nodes 19: psi is zero there" in capsys.readouterr().out
    assert read_sid("solid_result.SID_FEM").frames[0].objects["psi"].structure == 0
