"""Files for the module ExtPtfm of OpenFAST, read back by a reader made here of its two readers' rules."""

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import block_with_ends, interface_model

import hpcred
from hpcred.cli.main import run
from hpcred.parallel.failures import InputError


def tower_base(**kind):
    """The model with one interface node; the six displacements of the other count as modal coordinates."""
    model = interface_model(**kind)
    return replace(model, interfaces=model.interfaces[:1], B=model.B * [1.0, 2.0, 3.0],
                   input_names=("wave 1", "wave 2", "mooring"))  # fmt: skip


def exported(folder, model, **options):
    hpcred.write_result(folder / "jacket.h5", model)
    report = hpcred.export(folder / "jacket.h5", "openfast", options=options)
    return report, folder / "jacket_ExtPtfm.dat"


def sections(path, flex):
    """Numbers below each keyword, as OpenFAST takes them: of as many rows as the dimension."""
    lines, found, size = path.read_text().splitlines(), {}, None
    for k, line in enumerate(lines):
        word = line.upper()
        if word.startswith("!DIMENSION:") and size is None:
            size = int(line[11:])
        for key in ("MASS", "STIFFNESS", "DAMPING", "LOADING", "FORCING", "CONNECTIONS", "DISPLACEMENT",
                    "WEIGHT CONSTANT", "WEIGHT STIFFNESS"):
            if word.startswith(f"!{key}"):
                start = k + 1 + flex  # where the older layout has a line that is skipped
                stop = next((j for j in range(start, len(lines)) if not lines[j].strip()), len(lines))
                found[key] = np.array([[float(x) for x in row.split()] for row in lines[start:stop]])
        if word.startswith(("!TIME INCREMENT IN SIMULATION:", "!TOTAL SIMULATION TIME IN FILE:")):
            found[line[1:5]] = float(line.partition(":")[2])
    return found, size


@pytest.mark.parametrize("layout", ["flex", "keywords"])
def test_matrices_and_loads_are_read_back(tmp_path, layout):
    model, flex = tower_base(damping=10.0, held=True), layout == "flex"
    rng = np.random.default_rng(1)
    u, t = rng.standard_normal((5, 2)), 0.25 * np.arange(5)
    (tmp_path / "waves.csv").write_text(
        "t,mooring,wave 1\n" + "".join(f"{at},{a},{b}\n" for at, (a, b) in zip(t, u.tolist(), strict=True))
    )
    report, path = exported(tmp_path, model, layout=layout, loads=str(tmp_path / "waves.csv"))
    found, size = sections(path, flex)
    assert size == model.size
    for key, matrix in (("MASS", model.M), ("STIFFNESS", model.K), ("DAMPING", model.D)):
        assert np.abs(found[key] - matrix).max() <= 1e-15 * np.abs(matrix).max()
    if flex:
        assert round(found["Tota"] / found["Time"]) + 1 == 5
    else:
        found = sections(tmp_path / "jacket_ExtPtfm_forces.dat", False)[0]
        weight = sections(path, False)[0]
        assert weight["WEIGHT CONSTANT"].shape == (1, size) and weight["WEIGHT STIFFNESS"].shape == (size, size)
        assert not weight["WEIGHT CONSTANT"].any() and not weight["WEIGHT STIFFNESS"].any()  # of a body that is held
    assert any("weight is not in the file" in text for text in report["remarks"])
    history = found["LOADING" if flex else "FORCING"]
    assert np.allclose(history[:, 0], t)
    assert np.allclose(history[:, 1:], u[:, [1]] @ model.B[:, [0]].T + u[:, [0]] @ model.B[:, [2]].T, atol=1e-8)
    inputs = (tmp_path / "jacket_ExtPtfm_input.dat").read_text()
    assert '"jacket_ExtPtfm.dat"' in inputs and ("FileFormat" in inputs) == flex
    assert ('"jacket_ExtPtfm_forces.dat"' in inputs) == (not flex)
    assert any("axes" in text for text in report["remarks"])
    assert hpcred.info(path)["coordinates"] == str(model.size)
    exported(tmp_path, model, layout=layout)  # which replaces its own files


@pytest.mark.parametrize("layout", ["flex", "keywords"])
def test_names_in_other_bytes_than_utf_8(tmp_path, layout):
    """The input file of the module names files by their bytes, from a result and a table of loads with such names."""
    model, loads, result = tower_base(), str(tmp_path / "w\udce9.csv"), str(tmp_path / "j\udcff.h5")
    Path(loads).write_text("t,mooring\n0,1\n0.5,2\n")
    hpcred.write_result(tmp_path / "jacket.h5", model)
    os.rename(tmp_path / "jacket.h5", result)
    options = ["--set", f"openfast.layout={layout}", "--set", f"openfast.loads={loads}"]
    before = set(os.listdir(os.fsencode(tmp_path)))
    assert run(["--quiet", "export", result, "--format", "openfast", *options]) == 0
    made = set(os.listdir(os.fsencode(tmp_path))) - before
    named = re.findall(rb'"(j\xff[^"]*)"', (tmp_path / "j\udcff_ExtPtfm_input.dat").read_bytes())
    assert b"j\xff_ExtPtfm.dat" in named and {*named, b"j\xff_ExtPtfm_input.dat"} == made
    lines = (tmp_path / "j\udcff_ExtPtfm.dat").read_text(errors="surrogateescape")
    (tmp_path / "plain.dat").write_text(lines.replace("\udcff", "y"))
    found, size = sections(tmp_path / "plain.dat", layout == "flex")
    assert size == model.size and np.abs(found["MASS"] - model.M).max() <= 1e-15 * np.abs(model.M).max()


def test_a_floating_body_has_no_stiffness_at_its_interface(tmp_path):
    found, _ = sections(exported(tmp_path, one_free(), layout="keywords")[1], False)
    assert not found["STIFFNESS"][:6].any() and found["STIFFNESS"][6:, 6:].any()
    assert "1                        RBMod" in (tmp_path / "jacket_ExtPtfm_input.dat").read_text()


def test_a_moored_platform_keeps_its_stiffness(tmp_path):
    """A rigid platform whose modes are all far below 1 rad/s."""
    mass, centre, inertia = 2e7, np.array([0.0, 0.0, -10.0]), np.diag([1.25e10, 1.25e10, 2.37e10])
    S = np.cross(np.eye(3), -centre)
    M = np.block([[mass * np.eye(3), -mass * S], [mass * S, inertia - mass * S @ S]])
    K = np.diag([7e4, 7e4, 4e6, 2e9, 2e9, 1.2e8])
    K[0, 4] = K[4, 0] = -1e6
    K[1, 3] = K[3, 1] = 1e6
    dofs = hpcred.Dofs(np.ones(6, int), np.arange(6, dtype=np.int8), np.zeros((6, 3)))
    place = [hpcred.Interface(name="tp", nodes=(1,), kind="rigid")]
    model = hpcred.SecondOrderModel.from_scipy(K, M, dofs=dofs).with_interfaces(place)
    with model, hpcred.reduce(model, tolerance=1e-4, band=(0.0, 1.0), coordinates="interface") as reduced:
        # two rows are coupled with no others
        assert (report := hpcred.inspect(model))["warnings"] == [] and report["rigid_body_modes"] == 0
        report, path = exported(tmp_path, reduced, layout="keywords")
        assert not any("weight is along" in text for text in report["remarks"])
        found, _ = sections(path, False)
        assert np.abs(found["STIFFNESS"] - K).max() < 1e-9 * np.abs(K).max()
        assert "0                        RBMod" in (tmp_path / "jacket_ExtPtfm_input.dat").read_text()
        with pytest.raises(InputError, match="found a body that is held"):
            hpcred.export(tmp_path / "jacket.h5", "simscape")


def test_the_weight_of_a_floating_body_turns_with_it(tmp_path):
    """W0 - K_W x is g times the mass in axes that small angles have turned, as OpenFAST evaluates it; its own checks of
    the first six rows."""
    model = one_free()
    report, path = exported(tmp_path, model, layout="keywords")
    assert "weight is along -z, of 9.80665 m/s^2" in report["remarks"]
    found = sections(path, False)[0]
    W0, K_W = found["WEIGHT CONSTANT"][0], found["WEIGHT STIFFNESS"]
    angles = 1e-6 * np.array([2.0, -3.0, 4.0])
    down = np.array([0.0, 0.0, -9.80665])
    seen = down - np.cross(angles, down)  # the direction that is fixed, from axes that turn by the angles
    x = np.concatenate([[0.0, 0.0, 0.0], angles, np.zeros(model.size - 6)])
    wanted = model.M[:, :3] @ seen
    assert np.abs(W0 - K_W @ x - wanted).max() < 1e-10 * np.abs(wanted).max()


def test_openfast_finds_the_centre_of_mass_in_the_weight(tmp_path):
    """The entries that ExtPtfm compares for a rigid body, whose first six rows of M are those of its mass."""
    mass, centre = 700.0, np.array([0.3, -0.2, -4.0])
    model = one_free()
    M = model.M.copy()
    M[:6, :6] = [[mass, 0, 0, 0, mass * centre[2], -mass * centre[1]],
                 [0, mass, 0, -mass * centre[2], 0, mass * centre[0]],
                 [0, 0, mass, mass * centre[1], -mass * centre[0], 0],
                 [0, -mass * centre[2], mass * centre[1], 5e4, 0, 0],
                 [mass * centre[2], 0, -mass * centre[0], 0, 5e4, 0],
                 [-mass * centre[1], mass * centre[0], 0, 0, 0, 5e4]]  # fmt: skip
    M[6:, :6] = M[:6, 6:] = 0.0
    found = sections(exported(tmp_path, replace(model, M=M), layout="keywords")[1], False)[0]
    W0, K_W = found["WEIGHT CONSTANT"][0], found["WEIGHT STIFFNESS"]
    weight = W0[2]
    assert weight == pytest.approx(-9.80665 * mass)
    assert W0[:6] == pytest.approx([0, 0, weight, weight * centre[1], -weight * centre[0], 0])
    wanted = np.zeros((6, 6))
    wanted[0, 4], wanted[1, 3], wanted[3, 3], wanted[4, 4] = weight, -weight, weight * centre[2], weight * centre[2]
    wanted[5, 3], wanted[5, 4] = -weight * centre[0], -weight * centre[1]
    assert K_W[:6, :6] == pytest.approx(wanted)


def one_free():
    """A free body with one interface node: rows and columns of K there are round-off."""
    model = interface_model(modes=2)
    K = np.zeros_like(model.K)
    K[6:, 6:] = model.K[6:, 6:] + 1e3 * np.eye(model.size - 6)
    K[0, 0] = 1e-12
    return replace(model, K=K, interfaces=model.interfaces[:1])


def test_connection_points_are_the_other_nodes(tmp_path, comm):
    """The displacements of a node by the coordinates are the outputs there."""
    with block_with_ends(comm, clamped=True) as block:
        node = int(block.dofs.node[40])
        with block.with_inputs([("right", "all"), (node, "all")]) as model:
            with hpcred.reduce(model, hpcred.Modes(count=9), coordinates="interface") as reduced:
                hpcred.write_result(tmp_path / "jacket.h5", reduced, model)
                C = reduced.C[-3:]
            place = model.dofs.position[40]
    hpcred.export(tmp_path / "jacket.h5", "openfast", options={"layout": "keywords"})
    found, _ = sections(tmp_path / "jacket_ExtPtfm_points.dat", False)
    assert np.allclose(found["CONNECTIONS"], place)
    assert np.abs(found["DISPLACEMENT"] - C).max() <= 1e-9 * np.abs(C).max()
    with pytest.raises(InputError, match="known are layout, loads"):
        hpcred.export(tmp_path / "jacket.h5", "openfast", options={"wave": 1})


@pytest.mark.parametrize(
    "text, said",
    [
        ("t,wave 3\n0,1\n1,1\n", "found a column 'wave 3', expected names of inputs: wave 1, wave 2, mooring"),
        ("x,wave 1\n0,1\n1,1\n", "found the first column 'x', expected t or time"),
        ("t,wave 1\n0,1\n", "found 1 instants, expected two or more in ascending order"),
        ("t,wave 1\n0,1\n1,1\n1,2\n", "found 3 instants, expected two or more in ascending order"),
        ("t,wave 1\n0,1\n1,1\n3,2\n", "steps from 1 to 2 s, expected even steps from 0 in this layout"),
    ],
)
def test_loads_that_are_refused(tmp_path, text, said):
    (tmp_path / "waves.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        exported(tmp_path, tower_base(held=True), loads=str(tmp_path / "waves.csv"))


def test_superelements_that_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"found 2 interface nodes \(left, right\), expected one"):
        exported(tmp_path, interface_model())
    with pytest.raises(InputError, match="structural damping"):
        exported(tmp_path, tower_base(loss_factor=0.1))
