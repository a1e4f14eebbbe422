"""Campbell diagrams of result files: the command, its files and pictures, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from helpers import reduce_linkage, refused

import hpcred
from hpcred.cli.main import run

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


@pytest.fixture
def blade(tmp_path, monkeypatch):
    """result.h5 of a held blade along x with geometric stiffness, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    with hpcred.solid((6, 1, 1), (0.06, 0.004, 0.003), 3, False) as model:
        hpcred.write_model("model.h5", model)
    Path("job.toml").write_text(BLADE)
    assert run(["reduce", "job.toml", "--quiet"]) == 0
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
    preload = hpcred.Preload(omega=(0.0, 0.0, 6000.0))
    single = hpcred.read_result("result.h5").at_preload(preload).reduced.frequencies
    assert np.sqrt(squares[-1]) == pytest.approx(single[: squares.shape[1]], rel=1e-8)
    assert Path("c.svg").read_text().count("rpm") and Path("c.csv").read_text().startswith("omega,rpm,f_1_hz")
    first = report["critical_speeds"]
    assert not first or first[0]["frequency"] == pytest.approx(4 * first[0]["value"] / (2 * np.pi), rel=1e-9)
    assert run([*command, "-o", "c.h5"]) == 0  # with the modes above 6000 Hz
    found = hpcred.read_campbell("c.h5")
    assert found.frequencies.shape[1] == 6
    assert found.frequencies[:, : squares.shape[1]] ** 2 == pytest.approx(squares, rel=1e-9)
    assert run([*command, "-o", "c.csv"]) == 0  # of the same kind


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
        (["--range", "0,800", "--nodes", "99999"], "99999"),
        (["--range", "0,800", "-o", "c.txt"], "expected a name that ends in .csv, .h5 or .hdf5"),
        (["--range", "0,800", "--figure", "c.jpg"], "expected a name that ends in .png, .svg, .pdf"),
    ],
)
def test_refusals(blade, capsys, arguments, says):
    assert says in refused(capsys, "campbell", "result.h5", *arguments)


def test_a_result_without_parameters_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    reduce_linkage(tmp_path)
    assert "it has no parameters; reduce a job with [[parameter]]" in refused(capsys, "campbell", "result.h5")
