"""From foreign files to the error of the reduced model, by the command line."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from conftest import DATA

import hpcred as package
from hpcred.cli import run
from hpcred.examples.beam import Rod

JOB = """
model = "model.h5"
inputs = [[20, "z"]]
[frame]
kind = "chord"
nodes = [1, 7, 14]
axes = "yxz"
[[basis]]
kind = "krylov"
frequency = 100.0
order = 1
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the linkage as model.h5 and a good job."""
    monkeypatch.chdir(tmp_path)
    with package.linkage() as model:
        package.write_model("model.h5", model)
    Path("job.toml").write_text(JOB)
    return tmp_path


@pytest.mark.parametrize("ranks", [1, 2])
def test_from_foreign_files_to_the_error(hpcred, tmp_path, ranks):
    """convert, info, reduce, evaluate on real matrices; every table also as JSON."""
    job = """
    model = "model.h5"
    output = "result.h5"
    band = [0.0, 600.0]
    inputs = [[1, "x"], [20, "z"], [100, "y"]]
    [frame]
    kind = "buckens"
    [damping]
    kind = "rayleigh"
    beta = 1e-6
    [[basis]]
    kind = "modes"
    band = [0.0, 600.0]
    [[basis]]
    kind = "krylov"
    frequency = 0.0
    [[basis]]
    kind = "krylov"
    frequency = 500.0
    order = 1
    """
    (tmp_path / "job.toml").write_text(job)
    for arguments in (
        ["convert", DATA / "blockC3D8.inp", "model.h5", "--json", "convert.json"],
        ["info", "model.h5", "--below", "500,1000", "--band-top", "600", "--json", "info.json"],
        ["reduce", "job.toml", "--json", "reduce.json", "--", "-shift_mat_mumps_icntl_14", "77"],
        ["evaluate", "result.h5", "--full", "model.h5", "--points", "13", "--json", "eps.json", "-o", "h.h5"],
    ):
        result = hpcred(*arguments, ranks=ranks)
        assert result.returncode == 0, result.stderr
    info, reduced, eps = (json.loads((tmp_path / f"{key}.json").read_text()) for key in ("info", "reduce", "eps"))
    assert info["elastic_modes_below_hz"][:2] == [[500.0, 2], [1000.0, 5]]
    assert reduced["reduced_size"] == 12 and reduced["symbolic_analyses"] == 1
    assert reduced["petsc_options"]["shift_mat_mumps_icntl_14"] == "77"
    assert reduced["ranks"] == ranks
    assert eps["eps_max"] < 1e-4 and eps["Q"] < 600 * 1e-4
    assert len(eps["eps"]) == 13
    with h5py.File(tmp_path / "h.h5") as file:
        assert np.allclose(np.linalg.norm(file["full"][...], axis=(1, 2)), eps["full_norm"])


def test_a_two_sided_job_with_second_order_krylov(folder):
    """Outputs of their own, Rayleigh damping, and the error against the full model."""
    Path("job.toml").write_text(
        JOB.replace(
            "[frame]", 'outputs = [[17, "z"], [18, "rx"]]\nprojection = "two_sided"\nallow_unstable = true\n[frame]'
        )
        .replace("[[basis]]", '[damping]\nkind = "rayleigh"\nalpha = 2.0\nbeta = 1e-5\n[[basis]]')
        .replace('"krylov"', '"second_order_krylov"')
    )
    assert run(["reduce", "job.toml", "--json", "r.json"]) == 0
    assert run(["evaluate", "result.h5", "--full", "model.h5", "--frequencies", "99,100,101", "--json", "e.json"]) == 0
    record, errors = json.loads(Path("r.json").read_text()), json.loads(Path("e.json").read_text())
    assert record["projection"] == "two_sided" and record["outputs"] == ["17:z", "18:rx"]
    assert errors["eps"][1] < 1e-8 and errors["eps_max"] < 1e-2
    with h5py.File("result.h5") as file:
        assert file["basis/W"].shape == file["basis/V"].shape


def test_another_model_or_other_inputs_are_noticed(folder, capsys):
    """Names and sizes are the same; the matrices, or the columns of the file of inputs, are not."""
    assert run(["reduce", "job.toml"]) == 0
    with package.linkage(rod=Rod(diameter=0.0221)) as model:
        package.write_model("other.h5", model)
    capsys.readouterr()
    assert run(["evaluate", "result.h5", "--full", "other.h5", "--points", "3"]) == 2
    assert "its matrix M differ from what result.h5 was reduced from" in capsys.readouterr().err
    columns = np.zeros((120, 1))
    columns[116] = 1.0
    scipy.io.mmwrite("B.mtx", columns)
    assert run(["reduce", "job.toml", "--set", 'inputs="B.mtx"']) == 0
    assert run(["evaluate", "result.h5", "--full", "model.h5", "--points", "3"]) == 0
    columns[116], columns[117] = 0.0, 1.0
    scipy.io.mmwrite("B.mtx", columns)
    capsys.readouterr()
    assert run(["evaluate", "result.h5", "--full", "model.h5", "--points", "3"]) == 2
    assert "its inputs differ from what result.h5 was reduced from" in capsys.readouterr().err


def test_a_file_of_inputs_is_found_from_another_folder(folder, monkeypatch):
    scipy.io.mmwrite("B.mtx", np.eye(120)[:, [116]])
    assert run(["reduce", "job.toml", "--set", 'inputs="B.mtx"']) == 0
    (folder / "elsewhere").mkdir()
    monkeypatch.chdir(folder / "elsewhere")
    assert run(["evaluate", "../result.h5", "--full", "../model.h5", "--points", "3"]) == 0


@pytest.mark.parametrize("points", ["0", "1", "-3"])
def test_a_grid_needs_two_points(folder, capsys, points):
    assert run(["reduce", "job.toml"]) == 0
    capsys.readouterr()
    assert run(["evaluate", "result.h5", "--points", points]) == 2
    assert "expected at least 2 frequencies" in capsys.readouterr().err


def test_what_the_factors_of_a_reduction_were_told_reaches_the_full_response(folder):
    """A model that fits only out of core can be evaluated."""
    (folder / "factors").mkdir()
    assert run(["reduce", "job.toml", "--set", 'out_of_core="factors"']) == 0
    record = package.read_result("result.h5").reduced.record
    assert record.job["out_of_core"] == str(folder / "factors")
    (folder / "factors").rmdir()
    assert run(["evaluate", "result.h5", "--full", "model.h5", "--points", "3"]) == 2  # the folder is asked for
