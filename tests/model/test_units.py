"""A model in other units, converted, is the same model that was built in SI; and back."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from helpers import bar, close, columns_of, few_on_ranks, refused, to_dense, with_columns

import hpcred
from hpcred.body.units import fields_in
from hpcred.cli.main import run
from hpcred.fe.dofs import Dofs
from hpcred.model.interfaces.nodes import InterfaceNode
from hpcred.model.second_order_model import SecondOrderModel
from hpcred.model.units import unit_of_response, units_of
from hpcred.parallel.failures import InputError

POUND = 0.45359237 * 9.80665
# sizes in SI of the units of length and mass, the time, and a bar of steel in them, by the tables of handbooks
SYSTEMS = {
    "SI": (1.0, 1.0, 1.0),
    "m,kg,s": (1.0, 1.0, 1.0),
    "mm,t,s": (1e-3, 1e3, 1.0),
    "mm-t-s": (1e-3, 1e3, 1.0),
    "mm-N-s": (1e-3, 1e3, 1.0),
    "mm-kg-ms": (1e-3, 1.0, 1e-3),
    "mm, kN, ms": (1e-3, 1.0, 1e-3),
    "mm-kg-s": (1e-3, 1.0, 1.0),
    "mm,g,ms": (1e-3, 1e-3, 1e-3),
    "inch-lbf-s": (0.0254, POUND / 0.0254, 1.0),
    "s in lbf": (0.0254, POUND / 0.0254, 1.0),
    "ft-slug-s": (0.3048, POUND / 0.3048, 1.0),
    "cm,mN,us": (1e-2, 1e-13, 1e-6),
}


@pytest.mark.parametrize("text", SYSTEMS)
def test_systems_by_name(text):
    found = units_of(text)
    assert (found.length, found.mass, found.time) == pytest.approx(SYSTEMS[text])
    assert found.energy == pytest.approx(SYSTEMS[text][1] * SYSTEMS[text][0] ** 2 / SYSTEMS[text][2] ** 2)


@pytest.mark.parametrize(("text", "length", "mass", "time"), [
    ("um,mg,ms", 1e-6, 1e-6, 1e-3), ("in,lbm,us", 0.0254, 0.45359237, 1e-6), ("ft,slug,s", 0.3048, POUND / 0.3048, 1),
    ("cm,kgf,s", 0.01, 980.665, 1), ("m,MN,s", 1, 1e6, 1), ("mm,g,s", 1e-3, 1e-3, 1), ("cm,t,us", 0.01, 1e3, 1e-6),
])  # fmt: skip
def test_units_by_handbooks(text, length, mass, time):
    found = units_of(text)
    assert (found.length, found.mass, found.time) == pytest.approx((length, mass, time), rel=1e-12)


@pytest.mark.parametrize("text", ["", "mm", "mm,t", "mm,t,s,s", "mm,N,t", "mm,mm,s", "MM,T,S", "mm,t,h", "nan,t,s"])
def test_what_is_no_system_is_refused(text):
    with pytest.raises(hpcred.InputError, match="expected SI, or three words such as mm,t,s"):
        units_of(text)


def steel(comm, text):
    """A free bar of steel with a moment, a force, and a force with its moment, in some units; damped."""
    length, mass, time = SYSTEMS[text]
    rod = {"young": 2.1e11 * length * time**2 / mass, "density": 7850 * length**3 / mass, "diameter": 0.03 / length}
    with bar(comm, 0.8 / length, 5, **rod) as model:
        K, M = to_dense(model.K), to_dense(model.M)
        B = np.zeros((model.size, 3))
        B[31, 0] = B[3, 1] = B[31, 2] = 1.0  # force, moment, and a force
        B[35, 2] = 0.02 / length  # with its lever
        D = 3.0 * time * M + 1e-5 / time * K
        D[32, 32] += 50.0 * time / mass
        first, last = model.first_row, model.first_row + model.local_rows
        mine = {key: mat[first:last].ravel() for key, mat in (("K", K), ("M", M), ("D", D))}
        indptr = model.size * np.arange(last - first + 1)
        held = Dofs(np.array([77]), np.array([0], np.int8), np.array([[0.5, 0.1, 0.0]]) / length)
        made = SecondOrderModel.from_csr(
            comm, model.size, indptr, np.tile(np.arange(model.size), last - first), mine, dofs=model.dofs,
            held=held if comm.rank == 0 else Dofs(*(part[:0] for part in (held.node, held.direction, held.position))),
        )  # fmt: skip
    with made:
        return with_columns(made, "input", B)


@pytest.mark.mpi
@pytest.mark.parametrize("text", few_on_ranks(["mm,t,s", "mm-kg-ms", "inch-lbf-s"]))
@pytest.mark.costly
def test_a_converted_model_is_the_one_built_in_si(comm, text):
    """Blocks of translations and rotations scale differently; to round-off, entry by entry."""
    with steel(comm, "SI") as expected, steel(comm, text) as other, hpcred.model.in_si(other, units_of(text)) as found:
        assert found.converted_from == units_of(text).name
        for key, mat in expected.matrices.items():
            a, b = to_dense(found.matrices[key]), to_dense(mat)
            size = np.sqrt(np.outer(np.diag(b), np.diag(b)))
            assert (np.abs(a - b) <= 1e-12 * size).all()
        assert close(columns_of(found.B), columns_of(expected.B)) < 1e-14
        assert np.allclose(found.dofs.position, expected.dofs.position, rtol=1e-14)
        assert np.allclose(found.held.position, expected.held.position, rtol=1e-14)
        one, two = (hpcred.natural_modes(model, 10) for model in (found, expected))
        assert one.frequencies == pytest.approx(two.frequencies, rel=1e-9)
        assert one.masses == pytest.approx(two.masses, rel=1e-9)
        for item in (one, two):
            item.close()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write_block(length, mass, time):
    """K, M, nodes and dofs of a free block of steel with some units, as files."""
    with hpcred.solid((3, 2, 2), (0.3, 0.1, 0.08), inputs=1, clamped=False) as model:
        for key, mat, unit in (("K", model.K, mass / time**2), ("M", model.M, mass)):
            scipy.io.mmwrite(f"{key}.mtx", scipy.sparse.coo_matrix(to_dense(mat) / unit), precision=17)
        dofs = model.dofs
        np.savetxt("nodes.txt", np.c_[dofs.node, dofs.position / length][::3], "%d %.17g %.17g %.17g")


CONVERT = ("convert", "-K", "K.mtx", "-M", "M.mtx", "--nodes", "nodes.txt", "model.h5", "--inputs", "36:z")


@pytest.mark.parametrize("text", ["mm,t,s", "mm-kg-ms", "inch,lbf,s"])
def test_units_on_the_command_line(folder, capsys, text):
    write_block(*SYSTEMS[text.replace("inch,lbf,s", "inch-lbf-s")])
    assert run([*CONVERT, "--units", text, "--json", "c.json"]) == 0
    report = json.loads(Path("c.json").read_text())
    assert report["masses_in_x_y_z_kg"] == pytest.approx([7850 * 0.3 * 0.1 * 0.08] * 3)
    assert report["units"] == "m, kg, s" and report["converted_from"] and not report["warnings"]
    assert run(["info", "model.h5", "--modes", "7", "--json", "i.json"]) == 0
    report = json.loads(Path("i.json").read_text())
    with hpcred.solid((3, 2, 2), (0.3, 0.1, 0.08), inputs=1, clamped=False) as model:
        expected = hpcred.inspect(model, modes=7)
    assert report["lowest_frequencies_hz"] == pytest.approx(expected["lowest_frequencies_hz"], rel=1e-8)
    assert np.diag(report["inertia_kg_m2"]) == pytest.approx(np.diag(expected["inertia_kg_m2"]))
    assert report["converted_from"] == units_of(text).name and not report["warnings"]


@pytest.mark.parametrize("text, words", [("mm,t,s", "mm,t,s"), ("mm-kg-ms", "mm,kg,ms"), ("inch-lbf-s", "inch,lbf,s")])
def test_numbers_that_are_not_in_si_are_noticed(folder, capsys, text, words):
    write_block(*SYSTEMS[text])
    for command in (CONVERT, ("info", "model.h5"), ("info", "model.h5", "--modes", "7")):
        capsys.readouterr()
        assert run(list(command)) == 0
        said = " ".join(capsys.readouterr().out.split())
        assert "not SI; convert with --units" in said and words in said.split("--units")[1]
    assert "and a first frequency of" in said
    assert run([*CONVERT, "--units", words]) == 0 and run(["info", "model.h5"]) == 0
    assert "not SI" not in capsys.readouterr().out
    wrong = "mm,t,s" if words != "mm,t,s" else "mm,kg,ms"
    assert run([*CONVERT, "--units", wrong]) == 0
    assert f"the numbers look like {units_of(words).name.split(', ')[0]}" in " ".join(capsys.readouterr().out.split())


def test_units_that_cannot_be_are_refused(folder, capsys):
    write_block(1, 1, 1)
    assert "expected SI, or three words" in refused(capsys, *CONVERT, "--units", "mm")
    without = [word for word in CONVERT if word not in ("--nodes", "nodes.txt", "--inputs", "36:z")]
    assert "has no nodes" in refused(capsys, *without, "--units", "mm,t,s")


JOB = 'model = "model.h5"\ninputs = [[3, "y"], [6, "rz"]]\n[frame]\nkind = "tangent"\nnode = 1\n' \
      '[damping]\nkind = "rayleigh"\nalpha = {}\nbeta = {}\n[[basis]]\nkind = "krylov"\n' \
      'frequency = 0.0\norder = 1\n'  # fmt: skip


def test_an_export_in_other_units_is_that_of_a_model_in_them(folder, capsys, comm):
    """The SID file and the arrays of a model that is in mm, t, s all the way, up to the signs of coordinates."""
    arrays, sids = [], []
    for text in ("SI", "mm,t,s"):
        with steel(comm, text) as model:
            bare = SecondOrderModel.assembled(model.M.copy(), model.K.copy(), dofs=model.dofs, name=model.name)
            with bare:
                hpcred.write_model("model.h5", bare)
        Path("job.toml").write_text(JOB.format(2.0, 1e-5))
        assert run(["reduce", "job.toml"]) == 0
        for kind in ("sid", "npz"):
            name = f"{len(sids)}.{kind}"
            units = "mm,t,s" if text == "SI" else "SI"
            assert run(["export", "result.h5", "--format", kind, "-o", name, "--units", units]) == 0
        sids.append(hpcred.writers.read_sid("0.sid" if not sids else "1.sid"))
        arrays.append(dict(np.load(f"{len(arrays)}.npz")))
    one, two = arrays
    sign = np.sign(np.einsum("kcm,kcm->m", one["phi"], two["phi"]))
    for key, axes in (("K", (0, 1)), ("D", (0, 1)), ("M", (0, 1)), ("B", (0,)), ("C", (1,)), ("Ct", (0,)), ("Cr", (0,)),
                      ("N", (0,)), ("S", (2, 3)), ("phi", (2,)), ("psi", (2,)), ("J", ()), ("mc", ()), ("masses", ()),
                      ("positions", ()), ("dJ", (0,))):  # fmt: skip
        turned = two[key]
        for axis in axes:
            turned = turned * np.expand_dims(sign, [k for k in range(turned.ndim) if k != axis])
        assert np.allclose(one[key], turned, rtol=1e-7, atol=1e-7 * np.abs(turned).max()), key
    assert sids[0].mass == pytest.approx(sids[1].mass) and sids[0].mass < 0.01
    assert sids[0].objects["J"].m0 == pytest.approx(sids[1].objects["J"].m0, rel=1e-9)
    assert "is in SI" in refused(capsys, "export", "result.h5", "--format", "vtk", "--units", "mm,t,s")


@pytest.mark.parametrize("output, given, unit", [
    ("20:z", "1:x", "m/N"), ("crank:rx", "1:x", "rad/N"), ("20:z", "a:b:ry", "m/(N m)"), ("1:rz", "1:rz", "rad/(N m)"),
    ("3:own1", "3:own6", "m/(N m)"), ("7:scalar", "1:x", ""), ("dof 3", "1:x", ""), ("1:x", "input 1", ""),
])  # fmt: skip
def test_units_of_responses(output, given, unit):
    assert unit_of_response(output, given) == unit


@pytest.mark.mpi
def test_loads_are_made_in_si(comm):
    with (
        hpcred.solid((2, 1, 1), comm=comm) as model,
        model.with_loads([hpcred.loads.Gravity(name="g", value=(0.0, 0.0, -9.81))]) as loaded,
        pytest.raises(InputError, match="units: solid has loads already, which are in SI; convert it before they"),
    ):
        hpcred.model.in_si(loaded, units_of("mm,t,s"))


def test_interface_nodes_have_places_in_other_units():
    node, one = InterfaceNode(name="pin", node=7, position=(1.0, -2.0, 0.5)), np.eye(8)
    reduced = SimpleNamespace(size=8, interfaces=(node,), M=one, D=None, K=one)
    (found,) = fields_in(reduced, units_of("mm,t,s"))["interfaces"]
    assert found.position == pytest.approx((1000.0, -2000.0, 500.0)) and found.name == "pin"
