"""Campbell diagrams of result files: the command, its files and pictures, and what is refused."""

import errno
import json
import shutil
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
import scipy.io
from helpers import reduce_linkage, refused, to_dense
from pictures import undrawn

import hpcred
from hpcred.cli.main import run
from hpcred.reduction.parametric.reduced import ParametricReducedModel, projected_parts
from hpcred.workflows.campbell import parametric_of

BLADE = """
model = "model.h5"
geometric_stiffness = true
[frame]
kind = "chord"
nodes = [1, 25, 3]
[[interface]]
name = "tip"
nodes = {box = [[0.059999, -1.0, -1.0], [0.060001, 1.0, 1.0]]}
[[basis]]
kind = "modes"
count = 6
"""


@pytest.fixture(scope="module")
def reduced_blade(tmp_path_factory):
    """result.h5 of a held blade along x with geometric stiffness, beside its model and job."""
    folder = tmp_path_factory.mktemp("blade")
    with pytest.MonkeyPatch.context() as patch, hpcred.solid((6, 1, 1), (0.06, 0.004, 0.003), 3, False) as model:
        patch.chdir(folder)
        hpcred.write_model("model.h5", model)
        Path("job.toml").write_text(BLADE)
        assert run(["reduce", "job.toml", "--quiet"]) == 0
    return folder


@pytest.fixture
def blade(reduced_blade, tmp_path, monkeypatch):
    """A copy of it, as the working folder."""
    shutil.copytree(reduced_blade, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_blade_over_its_speed(blade, capsys):
    """Southwell's line: squared frequencies over the squared speed, as at single preloads."""
    command = ["campbell", "result.h5", "--range", "0,6000", "--points", "5", "--orders", "4", "--json", "c.json"]
    assert run([*command, "--figure", "c.svg", "-o", "c.csv", "--highest", "6000"]) == 0
    shown = capsys.readouterr().out
    assert "stable for omega = 0 to 6000 rad/s" in shown and "Coriolis forces are left out" in shown
    report = json.loads(Path("c.json").read_text())
    speeds, squares = np.array(report["values"]), np.array(report["frequencies_hz"]) ** 2
    fit = np.polynomial.Polynomial.fit(speeds**2, squares[:, 0], 1)
    assert fit(speeds**2) == pytest.approx(squares[:, 0], rel=5e-3) and squares[-1, 0] > 1.02 * squares[0, 0]
    preload = hpcred.body.Preload(omega=(0.0, 0.0, 6000.0))
    single = hpcred.read_result("result.h5").at_preload(preload).reduced.frequencies
    assert np.sqrt(squares[-1]) == pytest.approx(single[: squares.shape[1]], rel=1e-8)
    assert Path("c.svg").read_text().count("rpm") and Path("c.csv").read_text().startswith("omega,rpm,f_1_hz")
    first = report["critical_speeds"]
    assert not first or first[0]["frequency"] == pytest.approx(4 * first[0]["value"] / (2 * np.pi), rel=1e-9)
    assert run([*command, "-o", "c.h5"]) == 0  # with the modes above 6000 Hz
    found = hpcred.files.read_campbell("c.h5")
    assert found.frequencies.shape[1] == 6
    assert found.frequencies[:, : squares.shape[1]] ** 2 == pytest.approx(squares, rel=1e-9)
    assert run([*command, "-o", "c.csv"]) == 0  # of the same kind


def test_what_info_says_of_the_file_of_a_diagram(blade, capsys):
    """In words and numbers, after its checksums, and nothing of a file that is damaged."""
    assert run(["campbell", "result.h5", "--range", "0,6000", "--points", "3", "-o", "c.h5"]) == 0
    found = hpcred.files.read_campbell("c.h5")
    capsys.readouterr()
    assert run(["info", "c.h5", "--json", "i.json"]) == 0
    shown, report = " ".join(capsys.readouterr().out.split()), json.loads(Path("i.json").read_text())
    assert "hpcred Campbell diagram" in shown and "omega in rad/s" in shown
    assert report["from_to"] == [0.0, 6000.0] and report["values"] == 3 and report["modes"] == found.poles.shape[1]
    assert report["critical_speeds"] == [item.value for item in found.critical_speeds]
    assert report["stability_limit"] is None and "Coriolis forces are left out" in report["warnings"][0]
    with h5py.File("c.h5") as file:
        names = []
        file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
    own = [name for name in names if not name.startswith("checksums/")]
    assert run(["info", "c.h5", "--verify", "--json", "v.json"]) == 0
    verified = json.loads(Path("v.json").read_text())
    assert verified["verified_datasets"] == len(own) > 2
    with h5py.File("c.h5", "a") as file:
        file["poles"][0, 0] *= 1.0 + 1e-9
    assert "poles" in refused(capsys, "info", "c.h5", "--verify") and "poles" in refused(capsys, "info", "c.h5")


@pytest.mark.parametrize("error, status", [(OSError(errno.ENOSPC, "No space left on device"), 74), (ValueError(), 1)])
@pytest.mark.parametrize("name", ["c.csv", "c.h5"])
def test_both_outputs_or_none(blade, monkeypatch, capsys, name, error, status):
    """The table is written before the picture, of which nothing can be written here; older ones stay as they were."""
    command = ["campbell", "result.h5", "--range", "0,6000", "--points", "3", "-o", name, "--figure", "c.svg"]

    def fail(*_, **__):
        raise error

    monkeypatch.setenv("TMPDIR", str(blade / "elsewhere"))
    before = sorted(blade.rglob("*"))
    with monkeypatch.context() as patch:
        patch.setattr("hpcred.workflows.campbell.campbell_figure", fail)
        assert run(command) == status
        assert sorted(blade.rglob("*")) == before
        assert run(command[:-2]) == 0
        older = Path(name).read_bytes()
        assert run([*command, "--highest", "5000"]) == status and Path(name).read_bytes() == older
    assert run(command) == 0 and Path("c.svg").stat().st_size > 1000 and Path(name).stat().st_size


@pytest.mark.parametrize(
    "arguments, says",
    [
        ([], "range: a result with geometric stiffness has no range of omega"),
        (["--range", "0"], "--range: found '0', expected two values"),
        (["--range", "800,0"], "values: found 41 values of omega, expected at least 2 that ascend"),
        (["--range", "0,800", "--points", "1"], "points: found 1, expected at least 2"),
        (["--range", "0,800", "--over", "stiffness"], "over: found 'stiffness', expected omega"),
        (["--range", "0,800", "--axis", "1,0"], "axis: found [1.0, 0.0]"),
        (["--range", "0,800", "--orders", "0"], "orders: found 0"),
        (["--range", "0,800", "--at", "omega"], "--at: found 'omega', expected such as omega=300"),
        (["--range", "0,800", "--at", "omega=3"], "at: found a value of omega, but result.h5 has no parameters"),
        (["--range", "0,800", "--nodes", "99999"], "99999"),
        (["--range", "0,800", "-o", "c.txt"], "expected a name that ends in .csv, .h5 or .hdf5"),
        (["--range", "0,800", "-o", "c.npz"], "expected a name that ends in .csv, .h5 or .hdf5"),
        (["--range", "0,800", "--figure", "c.jpg"], "expected a name that ends in .png, .svg, .pdf"),
    ],
)
def test_refusals(blade, capsys, arguments, says):
    assert says in refused(capsys, "campbell", "result.h5", *arguments)


def test_a_free_body_in_interface_coordinates_is_refused():
    reduced = SimpleNamespace(rigid_size=6)
    with pytest.raises(hpcred.InputError, match="found 6 rigid-body coordinates, expected none"):
        parametric_of(SimpleNamespace(path="free.h5", reduced=reduced, geometric_stiffness=object()), "omega", "z")


def test_a_result_without_parameters_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    reduce_linkage(tmp_path)
    assert "it has no parameters; reduce a job with [[parameter]]" in refused(capsys, "campbell", "result.h5")


@pytest.fixture(scope="module")
def reduced_shaft(tmp_path_factory):
    """result.h5 of modes of a clamped block over the speed about x, in its turning frame, and model.h5; the record has
    the job that a reduction of the same would have."""
    folder = tmp_path_factory.mktemp("shaft")
    with hpcred.solid((4, 1, 1), (0.4, 0.02, 0.016), inputs=2) as plain:
        hpcred.write_model(folder / "model.h5", plain)
        omega = hpcred.Parameter("omega", (0.0, 3000.0), unit="rad/s", reference=0.0)
        damping = hpcred.Parameter("e", (0.0, 1.0), reference=0.0)
        terms = [*hpcred.rotation_terms(plain, "x"), hpcred.Term("D", to_dense(plain.K), "1e-7*(1 + e)")]
        with hpcred.ParametricModel(plain, [omega, damping], terms) as model, model.at() as reference:
            rom = hpcred.reduce(reference, [hpcred.Modes(count=24)])
            parts = projected_parts(model, rom, rom.record.damping)
            scipy.io.mmwrite(folder / "damping.mtx", to_dense(plain.K))
            job = {
                "parameter": [{"name": "omega", "range": [0.0, 3000.0], "unit": "rad/s", "reference": 0.0},
                              {"name": "e", "range": [0.0, 1.0], "reference": 0.0}],
                "term": [{"kind": "coriolis", "axis": "x", "factor": "omega"},
                         {"kind": "spin_softening", "axis": "x", "factor": "omega^2"},
                         {"of": "D", "file": str(folder / "damping.mtx"), "factor": "1e-7*(1 + e)"}],
            }  # fmt: skip
            known = {item.name: getattr(rom, item.name) for item in fields(rom)}
            known |= {"model": reference, "record": replace(rom.record, job=job)}
            ParametricReducedModel(**known, parameters=model.parameters, **parts).save(folder / "result.h5")
    return folder


@pytest.fixture
def shaft(reduced_shaft, tmp_path, monkeypatch):
    """A copy of it, as the working folder."""
    shutil.copytree(reduced_shaft, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_result_with_parameters_beside_its_model(shaft, capsys):
    """The bending frequencies of a section of 20 mm by 16 mm, between which the turning shaft is unstable; the axis is
    that of the terms of the job."""
    assert run(["campbell", "result.h5", "--full", "model.h5", "--solves", "2", "--points", "21", "--json", "c.json",
                "-o", "c.h5", "--highest", "2000", "--figure", "c.png"]) == 0  # fmt: skip
    shown = " ".join(capsys.readouterr().out.split())
    assert "UNSTABLE from omega = " in shown and "rpm) on, without vibration" in shown
    report, found = json.loads(Path("c.json").read_text()), hpcred.files.read_campbell("c.h5")
    bending = sorted(f for f in found.frequencies[0] if f < 2000)[0]
    assert report["stability_limit"] == pytest.approx(2 * np.pi * bending, rel=5e-3)
    assert [item.value for item in found.full] == pytest.approx([0.0, 3000.0])
    assert max(row["distance"] for row in report["full"] if row["value"] == 0.0) < 1e-7
    assert max(row["distance"] for row in report["full"]) < 1e-2 and report["residual"] < 1e-6
    words = np.array(found.whirl)
    slow = np.flatnonzero((found.values > 0) & (found.values < 0.9 * found.stability_limit))
    assert {"forward", "backward"} <= set(words[slow].ravel())
    assert run(["campbell", "result.h5", "--over", "e", "--at", "omega=100", "--points", "5"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "stable for e = 0 to 1" in shown and "Critical" not in shown


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["--over", "speed"], "over: found the parameter 'speed', expected one of omega, e"),
        (["--range", "0,5000"], "omega"),
        (["--at", "f=3"], "f"),
        (["--at", "omega=3"], "at: found a value of omega, which the diagram is over"),
        (["--full", "model.h5", "--solves", "0"], "solves: found 0, expected 1 to 1e"),
        (["--full", "other.h5"], "other.h5: has "),
        (["-o", "model.h5", "--full", "model.h5"], "model.h5"),
    ],
)
def test_refusals_of_parameters(shaft, capsys, arguments, says):
    with hpcred.solid((2, 1, 1)) as other:
        hpcred.write_model("other.h5", other)
    assert says in refused(capsys, "campbell", "result.h5", *arguments)


def test_a_report_has_the_diagram_of_each_parameter(shaft, monkeypatch):
    """As a picture, tables and files."""
    undrawn(monkeypatch)
    monkeypatch.setattr("hpcred.analysis.campbell.POINTS", 11)
    assert run(["report", "result.h5", "-o", "r.html", "--svg", "svg", "--csv", "csv"]) == 0
    page = Path("r.html").read_text()
    assert "Poles over parameters" in page and "UNSTABLE from omega" in page and "stable for e = 0 to 1" in page
    assert page.count('alt="poles of result over') == 2
    assert Path("svg/poles_over_omega_result.svg").is_file()
    assert Path("csv/poles_over_e_result.csv").read_text().startswith("e,f_1_hz")


@pytest.mark.mpi(ranks=(1, 2))
def test_on_several_ranks(comm, folder):
    """A blade over its speed, by all ranks."""
    frame = hpcred.Chord(nodes=(1, 25, 3))
    model = hpcred.solid((6, 1, 1), (0.06, 0.004, 0.003), 3, False, comm=comm)
    with model, hpcred.reduce(model, [hpcred.Modes(count=4)], frame) as rom:
        stiffness = hpcred.geometric_stiffness(model, rom.columns, frame)
        rom.save(folder / "r.h5", geometric_stiffness=stiffness)
    report = hpcred.campbell_file(folder / "r.h5", range=(0.0, 3000.0), points=3, output=folder / "c.h5", comm=comm)
    assert report["frequencies_hz"][0] == pytest.approx(rom.frequencies, rel=1e-9)
    assert hpcred.files.read_campbell(folder / "c.h5").frequencies.tolist() == report["frequencies_hz"]
