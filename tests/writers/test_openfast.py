"""Files for the module ExtPtfm of OpenFAST, read back by a reader made here of its two readers' rules."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import block_with_ends, interface_model

import hpcred
from hpcred.parallel.failures import InputError


def tower_base(**kind):
    """The model with one interface node; the six displacements of the other count as modal coordinates."""
    model = interface_model(**kind)
    return replace(model, interfaces=model.interfaces[:1], B=model.B * [1.0, 2.0, 3.0],
                   input_names=("wave 1", "wave 2", "mooring"))  # fmt: skip


def exported(folder, model, **options):
    hpcred.write_result(folder / "jacket.h5", model)
    report = hpcred.export_result(folder / "jacket.h5", "openfast", options=options)
    return report, folder / "jacket_ExtPtfm.dat"


def sections(path, flex):
    """Numbers below each keyword, as OpenFAST takes them: of as many rows as the dimension."""
    lines, found, size = path.read_text().splitlines(), {}, None
    for k, line in enumerate(lines):
        word = line.upper()
        if word.startswith("!DIMENSION:") and size is None:
            size = int(line[11:])
        for key in ("MASS", "STIFFNESS", "DAMPING", "LOADING", "FORCING", "CONNECTIONS", "DISPLACEMENT"):
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
    history = found["LOADING" if flex else "FORCING"]
    assert np.allclose(history[:, 0], t)
    assert np.allclose(history[:, 1:], u[:, [1]] @ model.B[:, [0]].T + u[:, [0]] @ model.B[:, [2]].T, atol=1e-8)
    inputs = (tmp_path / "jacket_ExtPtfm_input.dat").read_text()
    assert '"jacket_ExtPtfm.dat"' in inputs and ("FileFormat" in inputs) == flex
    assert ('"jacket_ExtPtfm_forces.dat"' in inputs) == (not flex)
    assert any("axes" in text for text in report["remarks"])
    assert hpcred.describe_file(path)["coordinates"] == str(model.size)
    exported(tmp_path, model, layout=layout)  # which replaces its own files


def test_a_floating_body_has_no_stiffness_at_its_interface(tmp_path):
    found, _ = sections(exported(tmp_path, one_free(), layout="keywords")[1], False)
    assert not found["STIFFNESS"][:6].any() and found["STIFFNESS"][6:, 6:].any()
    assert "1                        RBMod" in (tmp_path / "jacket_ExtPtfm_input.dat").read_text()


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
    hpcred.export_result(tmp_path / "jacket.h5", "openfast", options={"layout": "keywords"})
    found, _ = sections(tmp_path / "jacket_ExtPtfm_points.dat", False)
    assert np.allclose(found["CONNECTIONS"], place)
    assert np.abs(found["DISPLACEMENT"] - C).max() <= 1e-9 * np.abs(C).max()
    with pytest.raises(InputError, match="known are layout, loads"):
        hpcred.export_result(tmp_path / "jacket.h5", "openfast", options={"wave": 1})


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
