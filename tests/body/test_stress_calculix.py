"""Stresses of displacements against those that CalculiX prints, for all solids, where it is installed."""

import shutil

import numpy as np
import pytest
from calculix_runs import input_lines, run_calculix
from helpers import block_from
from solid_meshes import mesh, model_of

import hpcred
from hpcred.fe.element_rules import CALCULIX, rule_of
from hpcred.fe.strain_matrices import elasticity, strain_matrices

pytestmark = [pytest.mark.ccx, pytest.mark.skipif(shutil.which("ccx") is None, reason="needs ccx")]
STEEL = hpcred.fe.Material(name="STEEL", young=2.1e11, poisson=0.3)
TYPES = [(name, kind) for name, kinds in CALCULIX.items() for kind in kinds]
FOR_DAT = [0, 1, 2, 3, 5, 4]  # places of our components among xx, yy, zz, xy, xz, yz


def at_nodes_of(path):
    """Stresses (6,) by node of a .frd file."""
    found, inside = {}, False
    for line in path.read_text().splitlines():
        if line.startswith(" -4"):
            inside = "STRESS" in line
        if inside and line.startswith(" -1"):
            found[int(line[3:13])] = [float(line[k : k + 12]) for k in range(13, 85, 12)]
    return found


def stresses_of_calculix(folder, type_, points, elements, moved):
    """Stresses (e, g, 6) at integration points, and (6,) by node, of displacements of all nodes."""
    lines = [*input_lines(type_, points, elements), "*STEP", "*STATIC", "*BOUNDARY"]
    lines += [f"{n}, {d}, {d}, {u:.12e}" for n, three in enumerate(moved, 1) for d, u in enumerate(three, 1)]
    run_calculix(folder, "a", [*lines, "*EL PRINT, ELSET=EALL", "S", "*EL FILE", "S"])
    rows = [line.split() for line in (folder / "a.dat").read_text().splitlines()]
    table = np.array([row for row in rows if len(row) == 8 and row[0].isdigit()], float)
    order = np.lexsort((table[:, 1], table[:, 0]))
    return table[order][:, 2:].reshape(len(elements), -1, 6)[..., FOR_DAT], at_nodes_of(folder / "a.frd")


@pytest.mark.parametrize(("type_", "kind"), TYPES)
def test_stresses_are_those_of_calculix(tmp_path, comm, type_, kind):
    points, elements = mesh(kind, cells=(2, 2, 1), distortion=0.2)
    rng = np.random.default_rng(8)
    x, y, z = points.T
    moved = 1e-4 * np.stack([x * y + z, y * y - x * z, 2 * x + y * z], axis=1)
    moved += 1e-6 * rng.standard_normal(points.shape)
    at_points, at_nodes = stresses_of_calculix(tmp_path, type_, points, elements, moved)
    rule = rule_of("CalculiX", type_, kind)
    B, _ = strain_matrices(kind, rule, points[elements])
    own = np.einsum("ij,egja,ea->egi", elasticity(2.1e11, 0.3), B, moved[elements].reshape(len(elements), -1))
    scale = np.abs(own).max()
    assert own.shape == at_points.shape
    assert np.abs(own - at_points).max() < 2e-6 * scale  # seven digits
    with model_of(kind, "CalculiX", type_, points, elements, STEEL, comm) as model:
        block = block_from(model.K, moved.reshape(-1, 1))
        found = hpcred.stress_modes(model, block)
        block.destroy()
    at_nodes = np.array([at_nodes[n] for n in found.node])
    assert len(at_nodes) == len(points)
    # CalculiX' tables for 8 and 27 points have four and six digits, and that of C3D6 has 1.1455 in place of 1.3660
    if type_ != "C3D6":
        assert np.abs(found.stress[0] - at_nodes).max() < 5e-5 * np.abs(at_nodes).max()


def test_stresses_of_a_loaded_beam_from_its_own_input_file(tmp_path, comm):
    """The static response of the reduced body to a force, and the stress that CalculiX prints for the same force."""
    points, elements = mesh("tetra10", cells=(6, 1, 1), size=(0.6, 0.1, 0.1), distortion=0.1)
    lines = [*input_lines("C3D10", points, elements), "*BOUNDARY"]
    lines += [f"{n}, 1, 3" for n in np.flatnonzero(points[:, 0] < 0.03) + 1]
    tip = int(points[:, 0].argmax()) + 1
    run_calculix(tmp_path, "m", [*lines, "*STEP", "*FREQUENCY, SOLVER=MATRIXSTORAGE", "10"])
    run_calculix(tmp_path, "s", [*lines, "*STEP", "*STATIC", "*CLOAD", f"{tip}, 3, 100.", "*EL FILE", "S"])
    wanted = at_nodes_of(tmp_path / "s.frd")
    with (
        hpcred.readers.load_export(tmp_path / "m.inp", comm) as bare,
        bare.with_inputs([(tip, "z")]) as model,
        hpcred.reduce(model, [hpcred.Modes(count=4), hpcred.StaticCorrection()]) as rom,
    ):
        assert model.properties.types == ("C3D10",) and model.held is not None
        found = hpcred.stress_modes(model, rom.columns)
        sigma = np.tensordot(np.linalg.solve(rom.K, 100.0 * rom.B[:, 0]), found.stress, axes=(0, 0))
    wanted = np.array([wanted[n] for n in found.node])
    assert found.remarks == () and np.abs(sigma - wanted).max() < 3e-5 * np.abs(wanted).max()
