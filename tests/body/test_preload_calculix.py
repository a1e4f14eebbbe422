"""Frequencies of a blade over its speed against those of CalculiX, where it is installed."""

import shutil

import numpy as np
import pytest
from calculix_runs import input_lines, run_calculix
from solid_meshes import mesh

import hpcred
from hpcred import Modes
from hpcred.body import Preload
from hpcred.readers import load_export

pytestmark = [pytest.mark.ccx, pytest.mark.skipif(shutil.which("ccx") is None, reason="needs ccx")]


def frequencies_of_calculix(folder, lines, omega):
    """The lowest frequencies (4,) in Hz of a step with CENTRIF and a step of perturbations."""
    steps = ["*STEP", "*STATIC", "*DLOAD", f"EALL, CENTRIF, {omega**2}, 0., 0., 0., 0., 0., 1.", "*END STEP",
             "*STEP, PERTURBATION", "*FREQUENCY", "4"]  # fmt: skip
    run_calculix(folder, "spin", [*lines, *steps])
    rows = [line.split() for line in (folder / "spin.dat").read_text().splitlines()]
    return np.array([row[3] for row in rows if len(row) == 5 and row[0].isdigit()][:4], float)


TYPES = [("C3D20", "hexahedron20"), ("C3D20R", "hexahedron20"), ("C3D10", "tetra10")]


@pytest.mark.parametrize(("type_", "kind"), TYPES)
def test_a_blade_over_its_speed(tmp_path, comm, type_, kind):
    """Southwell's line: within 5e-5 at 300 rad/s and 4e-4 at 600, where the lowest frequency has risen by 3.7; what
    is left grows with the square of the load, as the displacements that CalculiX has in its stiffness too."""
    points, elements = mesh(kind, cells=(8, 2, 1), size=(0.8, 0.06, 0.02), distortion=0.0)
    points += [0.1, -0.03, -0.01]
    lines = [*input_lines(type_, points, elements), "*BOUNDARY"]
    lines += [f"{n}, 1, 3" for n in np.flatnonzero(points[:, 0] < 0.1001) + 1]
    run_calculix(tmp_path, "m", [*lines, "*STEP", "*FREQUENCY, SOLVER=MATRIXSTORAGE", "10"])
    with load_export(tmp_path / "m.inp", comm) as bare, bare.with_inputs([(int(points[:, 0].argmax()) + 1, "z")]
    ) as model, hpcred.reduce(model, [Modes(count=8)]) as rom:  # fmt: skip
        # a force at a single node moves single elements of C3D20R without strain
        stiffness = hpcred.geometric_stiffness(model, rom.columns, nodes=())
        hpcred.write_result(tmp_path / "r.h5", rom, model, geometric_stiffness=stiffness)
        result = hpcred.read_result(tmp_path / "r.h5", comm)
        for omega, close in ((300.0, 1.5e-4), (600.0, 6e-4)):
            wanted = frequencies_of_calculix(tmp_path, lines, omega)
            preload = Preload(omega=(0.0, 0.0, omega))
            with hpcred.preloaded(model, preload) as spun:
                assert hpcred.natural_modes(spun, 4).frequencies == pytest.approx(wanted, rel=close)
            assert result.at_preload(preload).reduced.frequencies[:4] == pytest.approx(wanted, rel=3 * close)
    assert wanted[0] > 3.5 * rom.frequencies[0]
