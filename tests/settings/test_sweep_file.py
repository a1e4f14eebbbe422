"""Sweep files: the jobs and names that leave, and each refusal by its sentence, before anything is written."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import CHORD_JOB, refused

from hpcred.settings.job_file import plain, read_job
from hpcred.settings.sweep_file import read_sweep
from hpcred.settings.toml_file import as_value
from hpcred.workflows.collect import collect_sweep

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SWEEP = """
job = "job.toml"   # a comment

[[vary]]
key = "basis.0.frequency"
values = [100.0, 150.0]
[[vary]]
key = "basis.0.order"
range = [0, 2, 3]
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a good job, and a model that nobody looks into."""
    monkeypatch.chdir(tmp_path)
    Path("model.h5").touch()
    Path("job.toml").write_text(CHORD_JOB)
    return tmp_path


def sweep(text=SWEEP):
    Path("sweep.toml").write_text(text)
    return read_sweep("sweep.toml")


def places(runs, number=0):
    return [(run.job.basis[number].frequency, run.job.basis[number].order) for run in runs]


@pytest.mark.parametrize(
    "old, new, says",
    [
        ("values", "valus", r"vary\[0\].valus: unknown key \(did you mean 'values'\?\)"),
        ("basis.0.order", "basis.0.ordr", r"run frequency-100_ordr-0: basis\[0\].ordr: unknown key"),
        ("basis.0.order", "basis.3.order", "the job has no place 'basis.3.order'"),
        ("basis.0.order", "basis.0.frequency", "vary.key: found 'basis.0.frequency' twice"),
        ("basis.0.order", "basis.0", "'basis.0' would replace what 'basis.0.frequency' varies"),
        ("basis.0.order", " ", "vary.key: found an empty text"),
        ('job = "job.toml"', 'job = "job.toml"\nevaluate = {kind = "none"}', "evaluate.kind: unknown key"),
        ("basis.0.order", "output", "vary.key: found 'output'"),
        ("[100.0, 150.0]", "[]", "vary 'basis.0.frequency'.values: the list is empty"),
        ("[100.0, 150.0]", '["high"]', r"run frequency-high_order-0: basis\[0\].frequency: found 'high', expected a n"),
        ("[100.0, 150.0]", "[100.0, 100.0]", "two runs would write sweep/frequency-100.0_order-0.h5: basis.0"),
        ("[100.0, 150.0]", "[100.0, inf]", "found inf, expected a number that is finite"),
        ("[100.0, 150.0]", "[100.0, -1.0]", "run frequency--1_order-0: krylov.frequency: found -1"),
        ("[0, 2, 3]", "[0, 2, 4]", r"basis\[0\].order: found 0.0, expected a whole number"),
        ("[0, 2, 3]", "[0, 2]", r"vary\[1\].range: found \[0, 2\], expected \["),
        ("[0, 2, 3]", "[0, 2, 0]", "vary 'basis.0.order'.range: values: found 0"),
        ("[0, 2, 3]", '[0, 2, 3]\nspacing = "log"', "range: found 0 to 2, spacing 'log' needs positive ends"),
        ("[0, 2, 3]", "[0, 2, 3]\nvalues = [1]", "expected values, or range"),
        ("[0, 2, 3]", '[0, 2, 3]\nnames = ["a"]', "vary 'basis.0.order'.names: found 1 names for 3 values"),
        ("[0, 2, 3]", '[0, 2, 3]\nnames = ["a", "b b", "b/b"]', "two runs would write"),
        ("job =", 'combine = "zip"\njob =', "combine: 'zip' needs lists of the same length, found basis.0.freq"),
        ("job =", 'combine = "all"\njob =', "combine: found 'all', expected 'grid' or 'zip'"),
        ("job =", "evaluate = true\njob =", "evaluate.band: missing, and the job has none"),
        ("job =", "evaluate = {points = 1, band = [0.0, 1.0]}\njob =", "evaluate.points: found 1"),
        ("job =", f'evaluate = {{full = "{300 * "y"}", points = 3}}\njob =', "evaluate.full: found a name of 300"),
        ("job =", f'store = "{300 * "y"}"\njob =', "store: found a name of 300 letters"),
        ("job =", 'evaluate = {full = "x.h5", band = [0.0, 1.0]}\njob =', "evaluate.full: ./?x.h5: no such file"),
        ("job =", 'output = "here"\njob =', "here: is there and no result|cannot be created"),
        ('job = "job.toml"', "", "sweep.toml: job: missing; expected a text or a table"),
        ('"job.toml"', '"jib.toml"', "jib.toml: no such file"),
        ('"job.toml"', "3", "job: found 3, expected a text or a table"),
        ('[[vary]]\nkey = "basis.0.frequency"\nvalues = [100.0, 150.0]', '[[run]]\n"band" = [0.0, 1.0]', "not both"),
        ("[0, 2, 3]", "[0, 2, 3]\n[launch]\nranks = 0", "launch.ranks: found 0"),
        ("[0, 2, 3]", '[0, 2, 3]\n[launch]\ntime = "1 h"', "launch.time: found '1 h'"),
        ("[0, 2, 3]", '[0, 2, 3]\n[launch]\naccount = "a; rm"', "launch.account: found 'a; rm', expected a word"),
        ("[0, 2, 3]", '[0, 2, 3]\n[launch]\nlines = ["a\\nb"]', "launch.lines: expected a list of lines"),
    ],
)
def test_bad_sweeps_are_refused_before_anything_runs(folder, capsys, old, new, says):
    assert old in SWEEP
    Path("here").write_text("in the way")
    Path("sweep.toml").write_text(SWEEP.replace(old, new, 1))
    assert re.search(says, refused(capsys, "sweep", "sweep.toml"))


def test_a_missing_model_and_a_foreign_file_are_refused(folder, capsys):
    Path("sweep.toml").write_text(SWEEP + '[[vary]]\nkey = "model"\nvalues = ["model.h5", "m m.h5"]\n')
    assert "run frequency-100_order-0_model-m_m.h5: ./m m.h5: no such file" in refused(capsys, "sweep", "sweep.toml")
    Path("sweep").mkdir()
    Path("sweep/frequency-150_order-1.h5").write_text("mine")
    Path("sweep.toml").write_text(SWEEP)
    assert "is there and no result of a reduction" in refused(capsys, "sweep", "sweep.toml")
    rows = {row["run"]: row["status"] for row in collect_sweep("sweep.toml")["rows"]}
    assert rows.pop("frequency-150_order-1") == "damaged" and set(rows.values()) == {"missing"}


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["--index", "1"], "--index: belongs together with --of"),
        (["--index", "5", "--of", "4"], "--index: found 5 of 4"),
        (["--index", "0", "--of", "4"], "--index: found 0 of 4"),
        (["--parallel", "0"], "--parallel: found 0"),
        (["--submit"], "--submit: belongs to --slurm or --pbs"),
        (["--pbs", "--dry-run"], "a script is written and nothing runs"),
    ],
)
def test_bad_options_are_refused(folder, capsys, arguments, says):
    Path("sweep.toml").write_text(SWEEP)
    assert says in refused(capsys, "sweep", "sweep.toml", *arguments)


def test_a_grid_has_all_pairs_and_a_zip_those_side_by_side(folder):
    found = sweep()
    assert places(found.runs) == [(f, order) for f in (100.0, 150.0) for order in (0, 1, 2)]
    assert [run.name for run in found.runs][:2] == ["frequency-100_order-0", "frequency-100_order-1"]
    assert found.keys == ("basis.0.frequency", "basis.0.order")
    found = sweep('combine = "zip"\n' + SWEEP.replace("[0, 2, 3]", "[1, 4, 2]"))
    assert places(found.runs) == [(100.0, 1), (150.0, 4)]


def test_only_what_is_named_differs_from_the_base_job(folder):
    base = plain(read_job("job.toml"))
    for run in sweep().runs:
        table = plain(run.job)
        assert table.pop("output") == str(Path("sweep").absolute() / f"{run.name}.h5")
        frequency, order = run.values.values()
        assert (table["basis"][0]["frequency"], table["basis"][0]["order"]) == (frequency, order)
        table["basis"][0].update({key: base["basis"][0][key] for key in ("frequency", "order")})
        assert table == {key: value for key, value in base.items() if key != "output"}


def test_a_job_of_its_own_is_the_same_job(folder):
    """The file that a run is started with, read as any job file."""
    for run in sweep().runs:
        Path("own.toml").write_text(run.job_text())
        assert plain(read_job("own.toml")) == plain(run.job)


def test_ranges(folder):
    text = 'job = "job.toml"\n[[vary]]\nkey = "basis.0.frequency"\nrange = [1.0, 1000, 4]\nspacing = "log"\n'
    assert np.allclose([f for f, _ in places(sweep(text).runs)], [1, 10, 100, 1000])
    close = [run.name for run in sweep(text.replace("[1.0, 1000, 4]", "[1.0, 1.0000001, 3]")).runs]
    assert len(set(close)) == 3  # six digits would not tell them apart


def test_tables_lists_and_several_keys(folder):
    found = sweep(
        'job = "job.toml"\n[[vary]]\nkey = "basis"\nnames = ["a b", "c"]\n'
        'values = [[{kind = "krylov", frequency = 1.0}, {kind = "krylov", frequency = 2.0}],\n'
        '[{kind = "krylov", frequency = 3.0}, {kind = "krylov", frequency = 4.0}]]\n'
        '[[vary]]\nkey = ["basis.0.order", "basis.1.order"]\nvalues = [1, 2]\n'
        '[[vary]]\nkey = "damping"\nvalues = [{kind = "none"}, {kind = "rayleigh", alpha = 1.0}]\n'
    )
    orders = [f"basis-a_b_basis.0.order-{order}_damping-{damping}" for order in (1, 2) for damping in (1, 2)]
    assert [run.name for run in found.runs][:4] == orders
    assert places(found.runs[6:7], 0) + places(found.runs[6:7], 1) == [(3.0, 2), (4.0, 2)]
    assert found.runs[7].job.damping.alpha == 1.0


def test_listed_runs(folder):
    found = sweep('job = "job.toml"\n[[run]]\n"basis.0.order" = 2\n[[run]]\nname = "my own"\n"band" = [0.0, 5.0]\n')
    assert [run.name for run in found.runs] == ["order-2", "my_own"]
    assert found.runs[0].job.basis[0].order == 2 and found.runs[1].job.band == (0.0, 5.0)


def test_names_of_files_are_relative_to_the_files_that_say_them(folder, monkeypatch):
    Path("jobs").mkdir()
    Path("jobs/job.toml").write_text(CHORD_JOB.replace("model.h5", "../model.h5"))
    Path("sweeps").mkdir()
    Path("sweeps/s.toml").write_text(SWEEP.replace("job.toml", "../jobs/job.toml"))
    run = read_sweep("sweeps/s.toml").runs[0]
    assert Path(run.job.model).resolve() == Path("model.h5").resolve()
    assert run.output == Path("sweeps/s/frequency-100_order-0.h5")


@pytest.mark.parametrize(
    "value",
    ["", "a b # c", 'quo"te \\ back', "tab\t line\n nul\x01 del\x7f", "ü ∂ 𝄞", True, 0, -3, 1e-300, 0.1, [],
     [[1, 2.5], ["x"]], {"a b": 1, "c": {"d.e": [False]}, "": "x"}],
)  # fmt: skip
def test_values_as_toml_mean_the_same(value):
    assert tomllib.loads(f"value = {as_value(value)}")["value"] == value
