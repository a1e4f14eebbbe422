"""An empty text is not the same as nothing: each door that takes a text or None refuses it, and names the key."""

import re
from pathlib import Path

import pytest
from helpers import CHORD_JOB, refused

import hpcred as package
from hpcred import InputError
from hpcred.body import LoadedState
from hpcred.cli.main import run


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with package.linkage() as model:
        package.write_model("model.h5", model)
    Path("job.toml").write_text(CHORD_JOB)
    return tmp_path


STATE = '[[geometric_stiffness]]\nstate = "ax"\nvalue = 1.0\nfile = "model.h5"\n'


@pytest.mark.parametrize("text, says", [
    (STATE + 'matrix = ""\n', "geometric_stiffness.matrix: found '', expected a text"),
    (STATE + 'units = " "\n', "geometric_stiffness.units: found ' ', expected a text"),
    ('[[parameter]]\nname = "a"\nrange = [0.0, 1.0]\n[[term]]\nof = "K"\nfile = "k.mtx"\nfactor = "a"\nunits = ""\n',
     r"term\[0\].units: found an empty text"),
    ('[[parameter]]\nname = "a"\nrange = [0.0, 1.0]\n[[term]]\nof = "K"\nfile = "k.mtx"\nfactor = "a"\n'
     'variable = ""\n', r"term\[0\].variable: found an empty text"),
    ('[[viscoelastic]]\nfile = "k.mtx"\nname = ""\nlaw = {kind = "maxwell", factors = [0.5], times = [1e-3]}\n',
     "viscoelastic.name: found '', expected a text"),
])  # fmt: skip
def test_keys_of_a_job(folder, capsys, text, says):
    Path("job.toml").write_text(CHORD_JOB + text)
    assert re.search(says, refused(capsys, "reduce", "job.toml"))


@pytest.mark.parametrize("key", ["store", "out_of_core", "output"])
def test_names_of_files_in_a_job(folder, capsys, key):
    message = refused(capsys, "reduce", "job.toml", "--set", f'{key}=""')
    assert f"{key}: found '', expected the name of a file" in message


@pytest.mark.parametrize("line, says", [
    (["convert", "model.h5", "b.h5", "--units", ""], "--units: found an empty text, expected a value; leave it out"),
    (["convert", "model.h5", "b.h5", "--units="], "--units: found an empty text"),
    (["info", " "], "the word behind 'info': found an empty text"),
    (["response", "model.h5", "--frame", "", "--band", "0,300"], "--frame: found an empty text"),
    (["evaluate", "result.h5", "--at", ""], "--at: found an empty text"),
    (["export", "result.h5", "--format", "fmu", "--set", "fmu.name="], "fmu.name: found '', expected a text"),
    (["export", "result.h5", "--format", "openfast", "--set", "openfast.loads="], "openfast.loads: found '', expected"),
])  # fmt: skip
def test_words_of_a_command_line(folder, capsys, line, says):
    assert re.search(says, refused(capsys, *line))


def test_arguments_in_python(folder):
    for key in ("matrix", "units", "opposite", "file"):
        with pytest.raises(InputError, match=f"geometric_stiffness.{key}: found '', expected a text"):
            LoadedState(**{"state": "ax", "value": 1.0, "file": "a.h5", key: ""})
    with pytest.raises(InputError, match="units: found an empty text, expected one with letters; leave it out"):
        package.export_result("result.h5", "sid", "a.sid", units="")
    with pytest.raises(InputError, match="figure: found an empty text"):
        package.evaluate_result("result.h5", figure="  ")


@pytest.mark.parametrize("key, says", [
    ("basis.0.", "found the key 'basis.0.', expected names and numbers with a dot between two of them"),
    (".band", "found the key '.band', expected names"), ("basis..order", "found the key 'basis..order', expected"),
    ("basis.-1.order", "the job has no place 'basis.-1.order'"),
    ("basis.\u0660.order", "the job has no place 'basis"),
])  # fmt: skip
def test_places_that_no_job_has(folder, capsys, key, says):
    assert re.search(says, refused(capsys, "reduce", "job.toml", "--set", f"{key}=1"))


@pytest.mark.parametrize("line, says", [
    (["response", "model.h5", "--band", "0,300", "--points", "99999999999"], "points: found 1e.11, expected 1 to"),
    (["response", "model.h5", "--band", "0,300", "--points", "1000000000"], "points: found 1e.09, expected"),
    (["export", "result.h5", "--format", "vtk", "--modes", "1.7"], "--modes: found '1.7', expected whole n"),
    (["export", "result.h5", "--format", "vtk", "--modes", "0"], "--modes: found '0', expected whole numbers from 1"),
    (["report", "result.h5", "--full", "model.h5", "--solves", "10000000000"], "solves: found 1e.10, expected 1 to"),
    (["evaluate", "result.h5", "--points", "2000000000"], "points: found 2e.09, expected 1 to"),
])  # fmt: skip
def test_numbers_that_no_command_takes(folder, capsys, line, says):
    with package.linkage() as model, model.with_inputs([(20, "z")]) as loaded:
        job = [package.Krylov(frequency=50.0, order=1)]
        with package.reduce(loaded, job, package.Buckens()) as rom:
            package.write_result("result.h5", rom, loaded)
    assert re.search(says, refused(capsys, *line))


def test_nodes_of_thousands_of_digits_are_names(folder, capsys):
    assert re.search("result.h5: no such file", refused(capsys, "export", "result.h5", "--nodes", "9" * 5000))
    assert run(["export", "result.h5", "--nodes", "\u0661"]) == 2


@pytest.mark.parametrize("text, says", [
    ("range = [0.0, 1.0, 1000000000]", "range: values: found 1e.09, expected 1 to 100000"),
    ("range = [0.0, 1e40, 3]", "range: found 1e.40, expected"),
])  # fmt: skip
def test_ranges_of_sweeps(folder, capsys, text, says):
    Path("sweep.toml").write_text(f'job = "job.toml"\n[[vary]]\nkey = "basis.0.frequency"\n{text}\n')
    assert re.search(says, refused(capsys, "sweep", "sweep.toml"))
    axis = '[[vary]]\nkey = "basis.0.{}"\nrange = [0.0, 1.0, 50000]\n'
    Path("sweep.toml").write_text('job = "job.toml"\n' + axis.format("frequency") + axis.format("order"))
    assert re.search("vary: runs: found 2.5e.09, expected 1 to 100000", refused(capsys, "sweep", "sweep.toml"))
