"""From CAD to SID with gmsh and CalculiX, where they are installed: the script in examples/calculix."""

import importlib.util
import shutil
from pathlib import Path

import numpy as np
import pytest

import hpcred

SCRIPT = Path(__file__).parents[2] / "examples" / "calculix" / "lever.py"
MISSING = [name for name in ("ccx",) if shutil.which(name) is None]
MISSING += [name for name in ("gmsh",) if importlib.util.find_spec(name) is None]

pytestmark = [pytest.mark.ccx, pytest.mark.skipif(bool(MISSING), reason=f"needs {' and '.join(MISSING)}")]


@pytest.fixture
def lever(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    spec = importlib.util.spec_from_file_location("lever", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_lever_has_the_frequencies_of_calculix(lever):
    assert lever.main(0.012) < 5e-7  # the .dat file has seven digits
    own = lever.frequencies_of_calculix("lever_modes.dat")[6:8]
    assert np.allclose(own, [1548.8, 2197.0], rtol=3e-3)  # whatever gmsh meshes
    assert hpcred.writers.read_sid("lever.SID_FEM") is not None
    result = hpcred.read_result("lever.h5")
    assert all(node.rotates for node in result.nodes) and len(result.nodes) == 2
    # a bearing that is turned turns about its own node, and does not move it
    assert all(np.abs(node.psi).max() > 0 for node in result.nodes)


def test_supports_of_calculix_are_held(lever):
    """The same lever with a bearing that CalculiX holds: its dofs are listed, and the frequencies agree."""
    parts = lever.mesh(0.02)
    first, _ = lever.write_input("held_modes.inp", "*FREQUENCY", *parts)
    lever.write_input("held.inp", "*FREQUENCY, SOLVER=MATRIXSTORAGE", *parts)
    for name in ("held_modes", "held"):
        text = Path(f"{name}.inp").read_text()
        Path(f"{name}.inp").write_text(text.replace("*STEP", f"*BOUNDARY\n{first}, 1, 3\n{first + 1}, 1, 3\n*STEP"))
        lever.run_calculix(name)
    report = hpcred.convert("held.inp", "held.h5", inputs=[(first + 2, "z")])
    assert report["held_dofs"] == 6
    with hpcred.read_model("held.h5") as model, hpcred.reduce(model, [hpcred.Modes(count=6)]) as rom:
        assert np.allclose(rom.frequencies, lever.frequencies_of_calculix("held_modes.dat")[:6], rtol=5e-7)
        held = set(zip(model.held.node.tolist(), model.held.direction.tolist(), strict=True))
        assert held == {(first, direction) for direction in range(6)}
