"""Stresses under a constant load against those of CalculiX, with and without moments at 0 Hz in the basis."""

import shutil
import subprocess

import numpy as np
import pytest
from calculix_runs import input_lines, run_calculix
from solid_meshes import mesh

import hpcred
from hpcred import Krylov, Modes
from hpcred.parallel.petsc import MPI
from hpcred.readers.stresses.source import read_answers

pytestmark = [pytest.mark.ccx, pytest.mark.skipif(shutil.which("ccx") is None, reason="needs ccx")]
FORCE = 1000.0


@pytest.mark.parametrize("basis, least, most", [
    ([Modes(count=8)], 0.1, 1.0),
    ([Modes(count=3), Krylov(frequency=0.0)], 0.0, 2e-5),
])  # fmt: skip
def test_static_stresses_are_those_of_calculix(tmp_path, monkeypatch, basis, least, most):
    """A clamped bar of elements with internal modes under a force at its rigid end, off its axis.

    The stresses of q = K^-1 B f against those of CalculiX by itself under the force: moments at 0 Hz in the basis have
    them to print precision, modes alone miss much of them. Nodes of the rigid end have no rows.
    """
    monkeypatch.chdir(tmp_path)
    points, elements = mesh("hexahedron", (6, 2, 2), (0.3, 0.05, 0.05))
    left, right = (np.flatnonzero(np.isclose(points[:, 0], x, atol=6e-3)) + 1 for x in (0.0, 0.3))
    lines = input_lines("C3D8I", points, elements)
    lines += ["*NODE", "501, 0.3, 0.1, 0.", "502, 0.3, 0.1, 0.", "*NSET, NSET=LEFT", *map(str, left)]
    lines += ["*NSET, NSET=RIGHT", *map(str, right), "*RIGID BODY, NSET=RIGHT, REF NODE=501, ROT NODE=502"]
    lines += ["*BOUNDARY", "LEFT, 1, 3", "*STEP"]
    run_calculix(tmp_path, "bar", [*lines, "*FREQUENCY, SOLVER=MATRIXSTORAGE", "2"])
    run_calculix(tmp_path, "loaded", [*lines, "*STATIC", "*CLOAD", f"501, 3, {FORCE}", "*NODE FILE", "U", "*EL FILE",
                                      "S"])  # fmt: skip
    hpcred.convert("bar.inp", "model.h5", inputs=[(501, "z")])
    with hpcred.read_model("model.h5") as model, hpcred.reduce(model, basis) as rom:
        hpcred.write_result("result.h5", rom, model)
        q = np.linalg.solve(rom.K, FORCE * rom.B[:, 0])
    hpcred.workflows.write_deck("result.h5", "calculix", "bar.inp", "deck")
    done = subprocess.run(["ccx", "stress"], cwd="deck", capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:]
    hpcred.workflows.add_stresses("result.h5", "deck/stress.frd", "with.h5")
    modes = hpcred.read_result("with.h5").stress_modes()
    loaded = read_answers("loaded.frd", MPI.COMM_SELF)
    order = np.argsort(loaded.node)
    assert np.array_equal(loaded.node[order], modes.node)
    expected = loaded.stress[0][order]
    error = np.abs(np.einsum("m,msc->sc", q, modes.stress) - expected).max() / np.abs(expected).max()
    assert least <= error <= most
