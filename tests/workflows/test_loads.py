"""Loads from the job to the result: [[load]] beside inputs, sums in tables and records, accuracy to a tolerance."""

import json
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from helpers import refused

import hpcred
from hpcred.cli.main import run
from hpcred.model.loads.columns import resultants

JOB = """
model = "model.h5"
inputs = [[20, "z"]]
tolerance = 1e-4
band = [0.0, 20000.0]
[[load]]
name  = "oil"
kind  = "pressure"
on    = {box = [[0.039, -1.0, -1.0], [0.041, 1.0, 1.0]]}
value = 1e5
[[load]]
name  = "weight"
kind  = "gravity"
value = [0.0, 0.0, -9.81]
"""


@pytest.fixture
def block(tmp_path, monkeypatch):
    """A folder with a clamped block as model.h5, and the job above."""
    monkeypatch.chdir(tmp_path)
    with hpcred.solid((4, 2, 2)) as model:
        hpcred.write_model("model.h5", model)
    Path("job.toml").write_text(JOB)
    return tmp_path


def test_a_job_with_loads(block, capsys):
    """To a tolerance, against the full model; the sums in the table, the record, and of info, before it too."""
    assert run(["info", "job.toml"]) == 0 and "Loads, and their sums" in capsys.readouterr().out
    loads = hpcred.info("job.toml")["loads"]
    assert [item["load"] for item in loads] == ["oil", "weight"] and loads[0]["Fx (N)"] == pytest.approx(-40.0)
    assert run(["reduce", "job.toml", "--details", "--json", "run.json"]) == 0
    told = capsys.readouterr().out
    assert "Loads, and their sums; moments about the origin" in told and "oil" in told
    record = json.loads(Path("run.json").read_text())
    assert record["inputs"] == ["20:z", "oil", "weight"] == record["outputs"]
    assert [item["name"] for item in record["loads"]] == ["oil", "weight"]
    assert record["loads"][0]["force"] == pytest.approx([-1e5 * 4e-4, 0, 0])
    result = hpcred.read_result("result.h5")
    job = hpcred.settings.read_job("job.toml")
    with (
        hpcred.read_model("model.h5") as model, model.with_inputs([(20, "z")]) as forced,
        forced.with_loads(job.load) as loaded,
    ):  # fmt: skip
        frequencies = np.linspace(0.0, 20000.0, 9)
        full = hpcred.frequency_response(loaded, frequencies)
        resultant = resultants(loaded)
    ours = hpcred.frequency_response(result.reduced, frequencies)
    scale = np.sqrt(np.abs(np.diagonal(full, axis1=1, axis2=2)).max(axis=0))
    assert (np.abs(ours - full) / np.outer(scale, scale)).max() < 1e-4
    assert result.reduced.input_names == ("20:z", "oil", "weight")
    assert np.allclose(result.reduced.resultants, resultant, atol=1e-12)
    assert np.allclose(resultant[1:, :3], [item["force"] for item in record["loads"]], atol=1e-12)
    assert run(["info", "result.h5", "--json", "info.json"]) == 0
    told = json.loads(Path("info.json").read_text())["loads"]
    assert [row["load"] for row in told] == ["oil", "weight"] and told[0]["Fx (N)"] == pytest.approx(-40.0)
    for line in ("--check 2", "--points 3"):  # the loads of the job are not in the model file
        assert run(["evaluate", "result.h5", "--full", "model.h5", *line.split(), "--json", "error.json"]) == 0
    assert json.loads(Path("error.json").read_text())["eps_max"] < 1e-4


def test_loads_alone_are_enough(block):
    with hpcred.read_model("model.h5") as model, model.with_input_columns(None, []) as bare:
        hpcred.write_model("bare.h5", bare)
    Path("job.toml").write_text(JOB.replace('inputs = [[20, "z"]]\n', "").replace("model.h5", "bare.h5"))
    found = hpcred.reduce_job("job.toml")
    assert found.record.inputs == ("oil", "weight")


def test_a_column_of_a_file(block, capsys):
    """Its number, and its sums as those of any column whose name is no node."""
    with hpcred.read_model("model.h5") as model:
        size = model.size
    columns = np.random.default_rng(0).standard_normal((size, 2))
    scipy.io.mmwrite("wind.mtx", scipy.sparse.coo_matrix(columns))
    given = '[[load]]\nname = "wind"\nkind = "given"\nfile = "wind.mtx"\ncolumn = 2\n'
    Path("job.toml").write_text(JOB.replace("tolerance = 1e-4\n", "").partition("[[load]]")[0] + given
                                + '[[basis]]\nkind = "krylov"\nfrequency = 0.0\norder = 1\n')  # fmt: skip
    assert run(["reduce", "job.toml"]) == 0
    record = hpcred.read_result("result.h5").reduced.record
    (load,) = record.loads
    assert (load.name, load.kind) == ("wind", "given")
    assert load.force == pytest.approx(columns[:, 1].reshape(-1, 3).sum(axis=0))
    assert Path(record.job["load"][0]["file"]).is_absolute() and record.job["load"][0]["file"] in record.contents
    Path("job.toml").write_text(Path("job.toml").read_text().replace("column = 2", "column = 3"))
    Path("result.h5").unlink()
    assert "load 'wind': column: found 3, but ./wind.mtx has 2" in refused(capsys, "reduce", "job.toml")


def test_columns_of_a_converted_model_have_sums(block, capsys):
    """-B of `convert`: columns of no node."""
    with hpcred.read_model("model.h5") as model:
        size = model.size
        B = np.zeros((size, 1))
        B[:, 0] = np.where(np.concatenate([model.dofs.direction]) == 2, 1.0, 0.0)
        with model.with_input_columns(B, ["push"]) as pushed:
            hpcred.write_model("pushed.h5", pushed)
    assert run(["info", "pushed.h5", "--json", "info.json"]) == 0
    (row,) = json.loads(Path("info.json").read_text())["loads"]
    assert row["load"] == "push" and row["Fz (N)"] == pytest.approx(size / 3)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('kind  = "pressure"', 'kind = "presure"', r"load[0].kind: found 'presure', expected one of"),
        ('kind  = "pressure"\n', "", "load[0].kind: missing; expected one of pressure, traction"),
        ("value = 1e5", "valeu = 1e5", "load[0].valeu: unknown key (did you mean 'value'?)"),
        ("value = 1e5", 'value = "high"', "load[0].value: found 'high', expected a number"),
        ("value = 1e5", "value = 0.0", "load 'oil': value: found 0.0, which is no load; leave it out"),
        ("[0.041, 1.0, 1.0]]}", "[0.041, 1.0, 1.0]], sphere = [[0.0, 0.0, 0.0], 1.0]}", "nodes: found box, sphere"),
        ('name  = "weight"', 'name = "oil"', "load 'oil': found two inputs of this name, expected each once"),
        ("[[0.039,", "[[0.5,", "load 'oil': on: none lies there; the nodes of model.h5 lie between"),
        ('on    = {box = [[0.039, -1.0, -1.0], [0.041, 1.0, 1.0]]}', 'on = "BORE"',
         "load 'oil': on: model.h5 has no node set or interface 'BORE'; it has none"),
        ("[[load]]", "[load]", "load: found a single table, expected a list of tables; write [[load]] in place of"),
    ],
)  # fmt: skip
def test_refused_jobs(block, capsys, old, new, says):
    text = JOB.partition('[[load]]\nname  = "weight"')[0] if new == "[load]" else JOB
    assert old in text
    Path("job.toml").write_text(text.replace(old, new))
    assert says in refused(capsys, "reduce", "job.toml")
