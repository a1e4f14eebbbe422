"""Shapes for ParaView: against the basis in the result file, and elements against their volume."""

from pathlib import Path
from xml.etree import ElementTree

import h5py
import numpy as np
import pytest
import vtu_reading
from conftest import DATA
from helpers import MODES_JOB, SIMULATION, exported

import hpcred
from hpcred import InputError
from hpcred.cli.main import run
from hpcred.fe.elements import NODES
from hpcred.workflows.export import export_result
from hpcred.writers import vtk
from hpcred.writers.vtk_series import TYPES

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


def test_shapes_of_the_linkage(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    hpcred.write_model("model.h5", hpcred.linkage())
    (tmp_path / "job.toml").write_text(JOB)
    hpcred.reduce_job("job.toml")
    names = export_result("result.h5", "vtk")["shapes"]
    mesh = vtu_reading.read("result.vtu")
    assert [(code, nodes.shape) for code, nodes in mesh.cells] == [(TYPES["line"], (19, 2))]
    with h5py.File("result.h5") as file:
        V, node, direction = file["basis/V"][...], file["dofs/node"][...], file["dofs/direction"][...]
    assert mesh.point_data["node"].tolist() == list(range(1, 21))
    assert [name for name in mesh.point_data if name != "node"] == names
    assert names[0] == "pseudo_mode_1_33.3047_Hz" and len(names) == 6
    for row, name in zip(V, names, strict=True):
        for d in range(3):
            assert mesh.point_data[name][node[direction == d] - 1, d] == pytest.approx(row[direction == d])


@pytest.mark.peers("meshio")
def test_meshio_reads_the_shapes(tmp_path, monkeypatch):
    import meshio

    monkeypatch.chdir(tmp_path)
    with hpcred.solid((3, 2, 2), inputs=2) as model, hpcred.reduce(model, [hpcred.Modes(count=2)]) as rom:
        hpcred.write_result("result.h5", rom, model)
    export_result("result.h5", "vtk")
    mine, found = vtu_reading.read("result.vtu"), meshio.read("result.vtu")
    assert np.array_equal(found.points, mine.points)
    assert [(block.type, block.data.tolist()) for block in found.cells] == [("hexahedron", mine.cells[0][1].tolist())]
    assert found.point_data.keys() == mine.point_data.keys() and len(mine.point_data) == 3
    for name, values in mine.point_data.items():  # of meshio one number a node has no second axis
        assert np.array_equal(found.point_data[name].reshape(values.shape), values)


def test_a_motion_for_paraview(linkage_folder):
    """Displacements of the observed nodes are those of simulation.h5, and distances of a stiff body stay."""
    Path("modes.toml").write_text(MODES_JOB)
    Path("sim.toml").write_text(SIMULATION.replace("end = 0.05", "end = 0.01").replace("steps = 20", "steps = 4"))
    assert run(["reduce", "modes.toml"]) == 0
    Path("simulation_vtu").mkdir()
    (Path("simulation_vtu") / "simulation_vtu_99999.vtu").touch()  # of an earlier run
    assert run(["simulate", "sim.toml", "--set", "paraview=true", "--set", "rotation=[0.0, 0.0, 0.3]"]) == 0
    sets = ElementTree.parse("simulation.pvd").getroot().findall("Collection/DataSet")
    with h5py.File("simulation.h5") as file:
        t, nodes, moved = file["t"][...], file["nodes/number"][...], file["nodes/displacement"][...]
        place = file["nodes/position"][...]
    assert [float(item.get("timestep")) for item in sets] == t.tolist()
    assert sorted(path.name for path in Path("simulation_vtu").iterdir()) == [
        Path(item.get("file")).name for item in sets
    ]
    for i in (0, 2, 4):
        mesh = vtu_reading.read(sets[i].get("file"))
        rows = np.searchsorted(mesh.point_data["node"], nodes)
        assert mesh.points[rows] == pytest.approx(place[i], abs=1e-12)
        assert mesh.point_data["displacement"][rows] == pytest.approx(moved[i], abs=1e-12)
        stiff = mesh.points - mesh.point_data["elastic"]
        with h5py.File("model.h5") as file:
            undeformed = file["dofs/position"][::6]
        assert np.linalg.norm(stiff[0] - stiff[19]) == pytest.approx(np.linalg.norm(undeformed[0] - undeformed[19]))
        assert [(code, nodes.shape) for code, nodes in mesh.cells] == [(TYPES["line"], (19, 2))]


@pytest.mark.mpi
@pytest.mark.costly
@pytest.mark.parametrize("name, kind, count", [("blockC3D10", "tetra10", 122), ("blockC3D8", "hexahedron", 90)])
def test_elements_of_abaqus_reach_paraview(folder, comm, name, kind, count):
    assert run(["convert", str(DATA / f"{name}.inp"), str(folder / "model.h5"), "--inputs", "1:x"]) == 0
    if comm.rank == 0:
        (folder / "job.toml").write_text(JOB)
    comm.Barrier()
    assert run(["reduce", str(folder / "job.toml")]) == 0
    assert run(["export", str(folder / "result.h5"), "--format", "vtk"]) == 0
    mesh = vtu_reading.read(folder / "result.vtu")
    ((code, cells),) = mesh.cells
    assert code == {"tetra10": 24, "hexahedron": 12}[kind] and cells.shape == (count, NODES[kind])
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


class Shapes:
    """One element of each kind on points at random, with two shapes."""

    names = ("mode 1: 1.5 Hz", "mode 2")

    def __init__(self):
        rng = np.random.default_rng(1)
        self.nodes = np.cumsum(rng.integers(1, 10**9, 30))
        self.points, self.values = rng.standard_normal((30, 3)), rng.standard_normal((2, 30, 3))
        self.cells = {kind: rng.integers(0, 30, (k, NODES[kind])) for k, kind in enumerate(NODES, start=1)}

    def displacement(self, k):
        return self.values[k].T.copy().T  # in the order of Fortran


def test_every_kind_of_element_and_every_digit(tmp_path):
    shapes = Shapes()
    assert exported(vtk.VtkFile, tmp_path / "a.vtu", shapes) == ["mode_1_1.5_Hz", "mode_2"]
    mesh = vtu_reading.read(tmp_path / "a.vtu")
    assert np.array_equal(mesh.points, shapes.points) and np.array_equal(mesh.point_data["node"], shapes.nodes)
    assert np.array_equal([mesh.point_data[name] for name in ("mode_1_1.5_Hz", "mode_2")], shapes.values)
    # the numbers of VTK's handbook
    codes = {"line": 3, "line3": 21, "triangle": 5, "triangle6": 22, "quad": 9, "quad8": 23, "tetra": 10, "tetra10": 24,
             "pyramid": 14, "wedge": 13, "wedge15": 26, "hexahedron": 12, "hexahedron20": 25}  # fmt: skip
    assert [code for code, _ in mesh.cells] == [codes[kind] for kind in NODES]
    assert all(np.array_equal(a, b) for (_, a), b in zip(mesh.cells, shapes.cells.values(), strict=True))
    cells = sum(map(len, shapes.cells.values()))
    assert vtk.describe(tmp_path / "a.vtu") == {
        "points": 30, "cells": cells, "point_data": ["mode_1_1.5_Hz", "mode_2", "node"]}  # fmt: skip


FOREIGN = """<?xml version="1.0"?><VTKFile type="UnstructuredGrid" {head}><UnstructuredGrid>
<Piece NumberOfPoints="3" NumberOfCells="2">
<PointData><DataArray Name="u" type="Float32" {place}><InformationKey /></DataArray>
<DataArray Name="v" type="Float32" {place} /></PointData>
<CellData><DataArray Name="w" type="Int8" {place}>1 2</DataArray></CellData>
<Cells><DataArray Name="types" type="Int32" {types}</DataArray></Cells></Piece></UnstructuredGrid>{end}"""
TEXT = {"head": "", "types": 'format="ascii"> 5 42 ', "place": 'format="ascii"', "end": "</VTKFile>"}
APPENDED = {"head": 'compressor="vtkZLibDataCompressor"', "types": 'format="appended" offset="0">',
            "place": 'format="appended" offset="8"', "end": '<AppendedData encoding="raw">_\x00&<\xff'}  # fmt: skip


def test_files_of_other_programs(tmp_path):
    path = tmp_path / "a.vtu"
    for parts in (TEXT, APPENDED):
        path.write_bytes(FOREIGN.format(**parts).encode("latin-1"))
        assert vtk.describe(path) == {"points": 3, "cells": 2, "point_data": ["u", "v"]}
    path.write_text('<?xml version="1.0"?><VTKFile type="PolyData"><PolyData><Piece /></PolyData></VTKFile>')
    with pytest.raises(InputError, match="found a VTK file of the type PolyData, expected UnstructuredGrid"):
        vtk.describe(path)
