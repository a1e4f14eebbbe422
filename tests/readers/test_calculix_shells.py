"""Shells beside solids, whose rows CalculiX writes under one name: nodes, mass and rigid-body motions."""

import shutil
import subprocess

import numpy as np
import pytest

import hpcred
from hpcred.readers.model_source import load_export

pytestmark = [pytest.mark.ccx, pytest.mark.skipif(shutil.which("ccx") is None, reason="needs ccx")]
STEP = ["*STEP", "*FREQUENCY, SOLVER=MATRIXSTORAGE", "2", "*END STEP"]


def grid(cells, size, first, bend=0.0):
    """Nodes (x, y, z) by number and quadrilaterals of a sheet in x and y at the height size[2]."""
    nodes, quads = {}, []
    for j in range(cells[1] + 1):
        for i in range(cells[0] + 1):
            x, y = i * size[0] / cells[0], j * size[1] / cells[1]
            nodes[first + len(nodes)] = (x, y, size[2] + bend * x * x)
    width = cells[0] + 1
    for j in range(cells[1]):
        for i in range(cells[0]):
            a = first + j * width + i
            quads.append((a, a + 1, a + 1 + width, a + width))
    return nodes, quads


def body(type_, thickness, tied, section="", bend=0.0):
    """A block of 4 x 2 x 1 bricks and a sheet, tied on its top or apart from it."""
    bottom, faces = grid((4, 2), (4.0, 2.0, 0.0), 1)
    top = {number + 100: (x, y, 1.0) for number, (x, y, _) in bottom.items()}
    sheet, quads = grid((4, 2), (4.0, 2.0, 1.0 + thickness / 2), 1001, bend)
    lines = ["*NODE", *(f"{n}, {x!r}, {y!r}, {z!r}" for n, (x, y, z) in {**bottom, **top, **sheet}.items())]
    lines += ["*ELEMENT, TYPE=C3D8, ELSET=CORE"]
    lines += [f"{k}, {', '.join(map(str, (*face, *(n + 100 for n in face))))}" for k, face in enumerate(faces, 1)]
    lines += [f"*ELEMENT, TYPE={type_}, ELSET=SKIN"]
    lines += [f"{k}, {', '.join(map(str, quad))}" for k, quad in enumerate(quads, 101)]
    lines += ["*MATERIAL, NAME=STEEL", "*ELASTIC", "2.1E11, 0.3", "*DENSITY", "7850.",
              "*SOLID SECTION, ELSET=CORE, MATERIAL=STEEL",
              f"*SHELL SECTION, ELSET=SKIN, MATERIAL=STEEL{section}", f"{thickness!r}"]  # fmt: skip
    if tied:
        lines += ["*SURFACE, NAME=TOP", "CORE, S2", "*SURFACE, NAME=UNDER", "SKIN, S1",
                  "*TIE, NAME=T, POSITION TOLERANCE=0.05", "UNDER, TOP"]  # fmt: skip
    return [*lines, *STEP, ""]


def run(folder, lines):
    (folder / "a.inp").write_text("\n".join(lines))
    done = subprocess.run(["ccx", "a"], cwd=folder, capture_output=True, text=True)
    assert done.returncode in (0, 201), done.stdout[-2000:]
    return load_export(folder / "a.inp", hpcred.parallel.petsc.MPI.COMM_WORLD)


@pytest.mark.parametrize("type_", ["S4R", "S4"])
@pytest.mark.parametrize("tied", [True, False])
def test_a_sheet_on_a_block(tmp_path, type_, tied):
    with run(tmp_path, body(type_, 0.02, tied)) as model:
        report = hpcred.inspect(model)
        named = set(model.dofs.node.tolist())
        assert {*range(1, 16), *range(101, 116)} <= named and not named & set(range(1001, 1016))
        assert report["masses_in_x_y_z_kg"] == pytest.approx([7850 * 8 * (1 + 0.02)] * 3)
        assert max(report["rigid_body_residuals"]) < 1e-12  # each row is where it is named
        assert any("below, in and above the middle surface" in line for line in model.remarks)
        assert np.ptp(model.dofs.position[:, 2]) == pytest.approx(1.02)


def test_places_that_the_section_does_not_tell(tmp_path):
    """With an offset the nodes are named, and it is said that their places are not known; the mass is right."""
    with run(tmp_path, body("S4R", 0.02, False, ", OFFSET=0.5")) as model:
        assert any("up to half of a thickness from where they are" in line for line in model.remarks)
        assert hpcred.inspect(model)["masses_in_x_y_z_kg"] == pytest.approx([7850 * 8 * 1.02] * 3)
