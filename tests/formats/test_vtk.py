"""Shapes for ParaView, read by meshio: against the basis in the result file, and elements against their volume."""

from pathlib import Path
from xml.etree import ElementTree

import h5py
import meshio
import numpy as np
import pytest
from conftest import DATA
from helpers import MODES_JOB, SIMULATION

from hpcred.cli import run
from hpcred.workflows.export import export_result

JOB = """
model = "model.h5"
output = "result.h5"
inputs = [1]
[frame]
kind = "buckens"
[[basis]]
kind = "modes"
index = [7, 8, 9, 10, 11, 12]
"""


def test_shapes_of_the_linkage(tmp_path, monkeypatch, hpcred):
    monkeypatch.chdir(tmp_path)
    assert hpcred("example", "linkage", "-o", "model.h5").returncode == 0
    (tmp_path / "job.toml").write_text(JOB)
    assert hpcred("reduce", "job.toml").returncode == 0
    names = export_result("result.h5", "vtk")["shapes"]
    mesh = meshio.read("result.vtu")
    assert [(block.type, len(block.data)) for block in mesh.cells] == [("line", 19)]
    with h5py.File("result.h5") as file:
        V, node, direction = file["basis/V"][...], file["dofs/node"][...], file["dofs/direction"][...]
    assert mesh.point_data["node"].tolist() == list(range(1, 21))
    assert [name for name in mesh.point_data if name != "node"] == names
    assert names[0] == "pseudo_mode_1_33.3047_Hz" and len(names) == 6
    for row, name in zip(V, names, strict=True):
        for d in range(3):
            assert mesh.point_data[name][node[direction == d] - 1, d] == pytest.approx(row[direction == d])


def test_a_motion_for_paraview(linkage_folder):
    """Displacements of the observed nodes are those of simulation.h5, and distances of a stiff body stay."""
    Path("modes.toml").write_text(MODES_JOB)
    Path("sim.toml").write_text(SIMULATION + "\n")
    assert run(["reduce", "modes.toml"]) == 0
    Path("simulation_vtu").mkdir()
    (Path("simulation_vtu") / "old.vtu").write_text("of an earlier run")
    assert run(["simulate", "sim.toml", "--set", "paraview=true", "--set", "rotation=[0.0, 0.0, 0.3]"]) == 0
    sets = ElementTree.parse("simulation.pvd").getroot().findall("Collection/DataSet")
    with h5py.File("simulation.h5") as file:
        t, nodes, moved = file["t"][...], file["nodes/number"][...], file["nodes/displacement"][...]
        place = file["nodes/position"][...]
    assert [float(item.get("timestep")) for item in sets] == t.tolist()
    assert sorted(path.name for path in Path("simulation_vtu").iterdir()) == [
        Path(item.get("file")).name for item in sets
    ]
    for i in (0, 7, 20):
        mesh = meshio.read(sets[i].get("file"))
        rows = np.searchsorted(mesh.point_data["node"], nodes)
        assert mesh.points[rows] == pytest.approx(place[i], abs=1e-12)
        assert mesh.point_data["displacement"][rows] == pytest.approx(moved[i], abs=1e-12)
        stiff = mesh.points - mesh.point_data["elastic"]
        with h5py.File("model.h5") as file:
            undeformed = file["dofs/position"][::6]
        assert np.linalg.norm(stiff[0] - stiff[19]) == pytest.approx(np.linalg.norm(undeformed[0] - undeformed[19]))
        assert [(block.type, len(block.data)) for block in mesh.cells] == [("line", 19)]


@pytest.mark.parametrize("name, kind, count", [("blockC3D10", "tetra10", 122), ("blockC3D8", "hexahedron", 90)])
def test_elements_of_abaqus_reach_paraview(tmp_path, monkeypatch, hpcred, name, kind, count):
    monkeypatch.chdir(tmp_path)
    for file in DATA.glob(f"{name}*"):
        (tmp_path / file.name).symlink_to(file)
    assert hpcred("convert", f"{name}.inp", "model.h5", "--inputs", "1:x", ranks=3).returncode == 0
    (tmp_path / "job.toml").write_text(JOB)
    assert hpcred("reduce", "job.toml", ranks=2).returncode == 0
    export_result("result.h5", "vtk")
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
