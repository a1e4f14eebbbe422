"""Loads against CalculiX: displacements of a static step under *DLOAD and *CLOAD are K^-1 b of hpcred's load vector."""

import shutil
import subprocess
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from helpers import columns_of, to_dense

import hpcred
from hpcred.loads import DeckLoad

pytestmark = [pytest.mark.ccx, pytest.mark.skipif(shutil.which("ccx") is None, reason="needs ccx")]

SIZE = np.array([2.0, 1.0, 1.5])
TETRA = [(0, 1, 3, 7), (0, 1, 7, 5), (0, 5, 7, 4), (1, 2, 3, 7), (1, 2, 7, 6), (1, 5, 6, 7)]  # of a hexahedron


def block(kind, cells=(2, 1, 1)):
    """Nodes (n, 3), slightly bent, and elements in the order of CalculiX, from 1."""
    fine = 2 * np.array(cells) + 1
    grid = np.array(list(product(*map(range, fine))))
    number = np.arange(len(grid)).reshape(fine)
    corner = np.array([(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2)])
    edges = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
    found = []
    for low in product(*(range(0, 2 * count, 2) for count in cells)):
        places = np.array(low) + corner
        if kind == "C3D20":
            places = np.concatenate([places, *((places[a] + places[b])[None] // 2 for a, b in edges)])
            found.append(number[tuple(places.T)])
            continue
        for tetra in TETRA:
            own = places[list(tetra)]
            if np.linalg.det((own[1:] - own[0]).astype(float)) < 0:
                own = own[[1, 0, 2, 3]]
            own = np.concatenate([own, *((own[a] + own[b])[None] // 2 for a, b in
                                         [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)])])  # fmt: skip
            found.append(number[tuple(own.T)])
    points = grid / (fine - 1) * SIZE
    points = points + 0.02 * np.sin(2.0 * points[:, [1, 2, 0]])  # curved faces
    used = np.unique(found)
    return points[used], np.searchsorted(used, found) + 1, used


def deck(kind, loads, step):
    points, elements, _ = block(kind)
    fixed = np.flatnonzero(points[:, 0] < 0.1) + 1
    lines = ["*NODE, NSET=NALL", *(f"{k}, {', '.join(f'{x:.14g}' for x in p)}" for k, p in enumerate(points, 1)),
             f"*ELEMENT, TYPE={kind}, ELSET=EALL"]  # fmt: skip
    for k, nodes in enumerate(elements, 1):
        words = [str(k), *map(str, nodes)]
        lines += [", ".join(words[:11]) + ("," if len(words) > 11 else "")]
        lines += [", ".join(words[11:])] * (len(words) > 11)
    lines += ["*NSET, NSET=FIX", *map(str, fixed), "*MATERIAL, NAME=STEEL", "*ELASTIC", "2.1e5, 0.3", "*DENSITY",
              "7.8e-3", "*EXPANSION, ZERO=0.", "1.2e-5", "*SOLID SECTION, ELSET=EALL, MATERIAL=STEEL"]  # fmt: skip
    lines += step(loads)
    return "\n".join(lines) + "\n", fixed


def ccx(name, text):
    Path(f"{name}.inp").write_text(text)
    run = subprocess.run(["ccx", name], capture_output=True, text=True)
    assert run.returncode == 0 and "*ERROR" not in run.stdout, run.stdout[-2000:]


LOADS = {
    "pressure": ["*DLOAD", "1, P1, 3.", "EALL, P2, 1.", "2, P3, -2."],
    "weight": ["*DLOAD", "EALL, GRAV, 9810., 1., 0., -2."],
    "spin": ["*DLOAD", "EALL, CENTRIF, 400., 0.1, 0.2, 0.3, 1., 2., 3."],
    "forces": ["*CLOAD", "20, 1, 5.", "20, 1, 2.", "21, 3, -4."],
}


@pytest.mark.parametrize("kind", ["C3D10", "C3D20"])
def test_displacements_are_those_of_calculix(tmp_path, monkeypatch, kind):
    """The free matrices, supports in numpy, and the displacements of the .frd file, which has six digits."""
    monkeypatch.chdir(tmp_path)
    ccx("free", deck(kind, [], lambda _: ["*STEP", "*FREQUENCY, SOLVER=MATRIXSTORAGE", "2", "*END STEP"])[0])
    hpcred.convert("free.inp", "free.h5")
    for name, lines in LOADS.items():
        text, fixed = deck(kind, lines, lambda loads: ["*STEP", "*STATIC", "*BOUNDARY", "FIX, 1, 3", *loads,
                                                       "*NODE FILE", "U", "*END STEP"])  # fmt: skip
        ccx(name, text)
        with hpcred.read_model("free.h5") as model, model.with_loads(
            [DeckLoad(name="l", file=f"{name}.inp", step=1)]
        ) as loaded:
            K, b = to_dense(loaded.K), columns_of(loaded.B)[:, -1]
            node, direction = model.dofs.node, model.dofs.direction
        free = ~np.isin(node, fixed)
        u = np.zeros(len(b))
        u[free] = np.linalg.solve(K[np.ix_(free, free)], b[free])
        theirs = displacements(f"{name}.frd")
        expected = np.array([theirs[n][d] for n, d in zip(node.tolist(), direction.tolist(), strict=True)])
        assert np.abs(expected).max() > 0
        assert np.abs(u - expected).max() < 2e-5 * np.abs(expected).max(), name


@pytest.mark.parametrize(("kind", "field"), [("C3D10", "uniform"), ("C3D10", "rough"), ("C3D20", "uniform")])
def test_thermal_displacements_are_those_of_calculix(tmp_path, monkeypatch, kind, field):
    """A rise by 30 K everywhere, or other temperatures at each node, of a block that is held at one end.

    CalculiX interpolates temperatures in C3D20 in a way of its own.
    """
    monkeypatch.chdir(tmp_path)
    ccx("free", deck(kind, [], lambda _: ["*STEP", "*FREQUENCY, SOLVER=MATRIXSTORAGE", "2", "*END STEP"])[0])
    hpcred.convert("free.inp", "free.h5")
    points = block(kind)[0]
    uniform = field == "uniform"
    rise = np.full(len(points), 30.0) if uniform else np.random.default_rng(1).uniform(0, 50, len(points))
    lines = ["*TEMPERATURE", *(f"{k}, {value:.14g}" for k, value in enumerate(rise, 1))]
    before = ["*INITIAL CONDITIONS, TYPE=TEMPERATURE", "NALL, 0.", "*STEP", "*STATIC", "*BOUNDARY", "FIX, 1, 3"]
    text, fixed = deck(kind, lines, lambda loads: [*before, *loads, "*NODE FILE", "U", "*END STEP"])
    ccx("hot", text)
    Path("rise.txt").write_text("".join(f"{k} {value:.14g}\n" for k, value in enumerate(rise, 1)))
    given = {"value": 30.0} if uniform else {"file": "rise.txt"}
    load = hpcred.loads.Temperature(name="hot", **given)
    with hpcred.read_model("free.h5") as model, model.with_loads([load]) as loaded:
        K, b = to_dense(loaded.K), columns_of(loaded.B)[:, -1]
        node, direction = model.dofs.node, model.dofs.direction
        assert np.abs(loaded.loads[0].force).max() < 1e-9 * np.abs(b).sum()
    free = ~np.isin(node, fixed)
    u = np.zeros(len(b))
    u[free] = np.linalg.solve(K[np.ix_(free, free)], b[free])
    theirs = displacements("hot.frd")
    expected = np.array([theirs[n][d] for n, d in zip(node.tolist(), direction.tolist(), strict=True)])
    assert np.abs(u - expected).max() < 2e-5 * np.abs(expected).max()


def displacements(path) -> dict:
    """Displacements by node of the only result of a .frd file."""
    found, inside = {}, False
    for line in Path(path).read_text().splitlines():
        if line.startswith(" -4"):
            inside = "DISP" in line
        elif inside and line.startswith(" -1"):
            found[int(line[3:13])] = [float(line[13 + 12 * k : 25 + 12 * k]) for k in range(3)]
        elif line.startswith(" -3"):
            inside = False
    assert found
    return found
