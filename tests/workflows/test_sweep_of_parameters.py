"""Sweeps over values of parameters: one basis for all of them where it holds, and factors where not."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from helpers import refused, to_dense
from launch import mpi_environment

import hpcred as package
from hpcred.cli.main import run
from hpcred.reduction.parametric import greedy
from hpcred.workflows import shared_basis

JOB = """
model = "model.h5"
inputs = [[20, "z"], [22, "x"]]
tolerance = 1e-3
band = [0.0, 20000.0]
stress = true
at = {m = 0.3}
[parameter_search]
points = 3
[[parameter]]
name = "k"
range = [0.1, 10.0]
[[parameter]]
name = "m"
range = [0.2, 0.5]
[[term]]
of = "K"
file = "K.mtx"
factor = "k"
[[term]]
of = "M"
file = "M.mtx"
factor = "m"
"""
ROUGH = JOB.replace("1e-3", "0.1").replace("stress = true\n", "").replace("20000.0", "5000.0")
SWEEP = """
job = "job.toml"
evaluate = {{points = 5}}
[[vary]]
key = "at.k"
values = [0.2, 3.0]
[launch]
{launch}
"""
ALONE = 'launcher = ""'


def make_body(folder, patch):
    """Write a block as model.h5 and a job with a bushing and an added mass into a folder, and go there."""
    patch.chdir(folder)
    for key, value in (("FRESH", 2), ("CHECKS", {2: 8}), ("SPREAD", 4)):  # errors are measured
        patch.setattr(greedy, key, value)
    with package.solid((3, 2, 2)) as plain:
        model = plain.with_material(package.Material(name="steel", young=2.1e11, poisson=0.3, density=7850.0))
    with model:
        package.write_model("model.h5", model)
        n = model.size
        scale = np.abs(to_dense(model.K)).max(), np.abs(to_dense(model.M)).max()
    for name, rows, size in (("K.mtx", [5, 6], 0.01 * scale[0]), ("M.mtx", [n - 1, n - 2, n - 3], scale[1])):
        values = np.full(len(rows), size)
        scipy.io.mmwrite(name, scipy.sparse.coo_array((values, (rows, rows)), shape=(n, n)))
    Path("job.toml").write_text(JOB)
    Path("sweep.toml").write_text(SWEEP.format(launch=ALONE))
    return folder


@pytest.fixture
def body(tmp_path, monkeypatch):
    return make_body(tmp_path, monkeypatch)


@pytest.fixture(scope="module")
def swept_at_once(tmp_path_factory, forks):
    """A folder with such a body, and the result of a rough job over the ranges of its parameters that two sweeps at the
    same time have made; their exit statuses."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(forks, "commands", True)
        folder = make_body(tmp_path_factory.mktemp("swept"), patch)
        Path("job.toml").write_text(ROUGH)
        Path("sweep.toml").write_text(SWEEP.format(launch=ALONE).replace("evaluate", "# evaluate"))
        command = [sys.executable, "-m", "hpcred", "sweep", "sweep.toml", "--of", "2"]
        tasks = [subprocess.Popen([*command, "--index", i, "--json", f"{i}.json"], env=mpi_environment()) for i in "12"]
        return folder, [each.wait() for each in tasks]


def truth(k, f, m=0.3):
    """Dense M, K, B and H(f) with the loss factor that an undamped model is measured with."""
    with package.read_model("model.h5") as model, model.with_inputs([[20, "z"], [22, "x"]]) as given:
        K = to_dense(given.K) + k * scipy.io.mmread("K.mtx").toarray()
        M = to_dense(given.M) + m * scipy.io.mmread("M.mtx").toarray()
        B = given.B.getDenseArray().real.copy()
    H = [B.T @ np.linalg.solve((1 + 0.002j) * K - (2 * np.pi * each) ** 2 * M, B) for each in f]
    return M, K, B, np.array(H)


def columns(path):
    import h5py

    with h5py.File(path) as file:
        return file["basis/V"][...].T


@pytest.mark.usefixtures("forked_commands")
@pytest.mark.parametrize("launch", [ALONE, pytest.param("ranks = 2", marks=pytest.mark.slow)])
def test_one_basis_serves_all_values(body, capsys, monkeypatch, launch):
    for key, value in mpi_environment().items():
        monkeypatch.setenv(key, value)
    Path("sweep.toml").write_text(SWEEP.format(launch=launch))
    report = package.run_sweep("sweep.toml")
    assert report["finished"] == 2 and not report["failed"]
    (ranges,) = Path("sweep").glob("ranges-*.h5")
    family = package.read_result(ranges).reduced
    assert report["factorisations"] == len(family.record.factorisations) > 0
    assert len(list(Path("sweep").glob("full-*.h5"))) == 2
    f = np.linspace(0.0, 20000.0, 21)
    for k in (0.2, 3.0):
        path = Path(f"sweep/k-{k:g}.h5")
        found = package.read_result(path)
        reduced, record = found.reduced, found.reduced.record
        assert record.basis_of == str(ranges.absolute()) and record.job["at"] == {"k": k, "m": 0.3}
        assert record.factorisations == () and record.ranks == (2 if "2" in launch else 1)
        assert record.accuracy.reached and record.accuracy.largest == family.record.accuracy.largest
        M, K, B, H = truth(k, f)
        V = columns(path)
        assert pytest.approx(np.eye(reduced.size), abs=1e-9) == V.T @ M @ V
        assert pytest.approx(reduced.K, abs=1e-9 * reduced.K.max()) == V.T @ K @ V
        assert pytest.approx(V.T @ B, abs=1e-9 * np.abs(reduced.B).max()) == reduced.B
        small = np.array([reduced.C @ np.linalg.solve((1 + 0.002j) * reduced.K - (2 * np.pi * each) ** 2 * reduced.M,
                                                      reduced.B) for each in f])  # fmt: skip
        assert np.abs(small - H).max(axis=(1, 2)) / np.abs(H).max(axis=(1, 2)) == pytest.approx(0, abs=1e-3)
        if k == 0.2:
            continue
        package.reduce_job("job.toml", overrides=[f"at.k={k}", "output='own.h5'"])
        own = package.read_result("own.h5")
        low = own.reduced.frequencies < 20000
        assert reduced.frequencies[: low.sum()] == pytest.approx(own.reduced.frequencies[low], rel=1e-6)
        for key in ("masses", "mc", "J", "origin"):
            expected = getattr(own.floating_frame, key)
            assert getattr(found.floating_frame, key) == pytest.approx(expected, rel=1e-9, abs=1e-12)
        assert found.floating_frame.Me == pytest.approx(np.eye(reduced.size), abs=1e-9)
        assert reduced.resultants == pytest.approx(own.reduced.resultants)
        first, other = (np.linalg.solve(item.reduced.K, item.reduced.B[:, 0]) for item in (found, own))
        stress = [np.tensordot(q, item.stress_modes().stress, axes=1)
                  for q, item in ((first, found), (other, own))]  # fmt: skip
        assert np.linalg.norm(stress[0] - stress[1]) < 0.05 * np.linalg.norm(stress[1])
        shape = found.body().nodes[0]
        expected = own.body().nodes[0].phi @ other
        assert shape.phi @ first == pytest.approx(expected, abs=5e-3 * np.abs(expected).max())
    assert run(["collect", "sweep.toml", "-o", "table.json"]) == 0
    rows = json.loads(Path("table.json").read_text())
    rows = rows["runs"] if isinstance(rows, dict) else rows
    assert [row["factorisations"] for row in rows] == [0, 0]
    assert all(row["eps"] <= 1e-3 for row in rows)
    assert run(["info", "sweep/k-3.h5"]) == 0


@pytest.mark.slow
def test_a_sweep_that_goes_on_finds_its_basis(body):
    package.run_sweep("sweep.toml")
    (ranges,) = Path("sweep").glob("ranges-*.h5")
    before = ranges.read_bytes()
    Path("sweep/k-3.h5").unlink()
    report = package.run_sweep("sweep.toml")
    assert [row["status"] for row in report["runs"]] == ["skipped", "finished"]
    assert report["factorisations"] == 0 and ranges.read_bytes() == before
    file = Path("K.mtx")
    scipy.io.mmwrite(file, 2 * scipy.io.mmread(file))
    report = package.run_sweep("sweep.toml")
    assert report["finished"] == 2 and report["factorisations"] > 0
    bases = {package.read_result(path).reduced.record.basis_of for path in Path("sweep").glob("k-*.h5")}
    assert len(bases) == 1 and str(ranges.absolute()) not in bases


def test_sweeps_at_the_same_time_make_one_basis(swept_at_once, monkeypatch):
    """As the tasks of an array do."""
    folder, statuses = swept_at_once
    monkeypatch.chdir(folder)
    assert statuses == [0, 0]
    reports = [json.loads(Path(f"{i}.json").read_text()) for i in "12"]
    (ranges,) = Path("sweep").glob("ranges-*.h5")
    made = len(package.read_result(ranges).reduced.record.factorisations)
    assert sorted(report["factorisations"] for report in reports) == [0, made]
    assert [report["finished"] for report in reports] == [1, 1]


@pytest.mark.slow
def test_factors_where_the_basis_does_not_reach_the_tolerance(body, capsys):
    text = JOB.replace("[[parameter]]", "[adaptive]\nsize = 9\n[[parameter]]", 1)
    Path("job.toml").write_text(text)
    report = package.run_sweep("sweep.toml")
    assert report["finished"] == 2 and not report["failed"]
    (ranges,) = Path("sweep").glob("ranges-*.h5")
    assert ranges.name.endswith(".not-reached.h5")
    message = refused(capsys, "reduce", "sweep/k-3.toml", "--basis", str(ranges), "--set", "output='own.h5'")
    assert f"--basis {ranges}: it did not reach the tolerance; leave --basis out" in message
    for path in Path("sweep").glob("k-*.h5"):
        record = package.read_result(path).reduced.record
        assert record.basis_of == "" and record.factorisations and record.accuracy.reached
    Path("sweep/k-3.h5").unlink()
    assert package.run_sweep("sweep.toml")["finished"] == 1  # not looked for again


def test_what_is_refused(swept_at_once, capsys, monkeypatch):
    monkeypatch.chdir(swept_at_once[0])
    text = Path("sweep.toml").read_text().replace("3.0]", "11.0]")
    Path("outside.toml").write_text(text)
    message = refused(capsys, "sweep", "outside.toml")
    assert "run k-11: parameter 'k': found 11, expected 0.1 to 10, its range" in message
    (ranges,) = Path("sweep").glob("ranges-*.h5")
    of_job = f"{ranges}: expected the result of this job over the ranges of its parameters, made without its `at`"
    given = ["reduce", "job.toml", "--basis", str(ranges), "--set", "output='own.h5'"]
    for more in ("tolerance=1e-2", "inputs=[[20,'z']]", "at={}"):
        assert of_job in refused(capsys, *given, "--set", more)
    with monkeypatch.context() as patched:
        patched.setattr(shared_basis, "multiply", lambda *_: None)
        message = refused(capsys, *given, "--set", "at={k=9.0,m=0.5}")
    assert f"--basis {ranges}: its basis is not one of model.h5 at k = 9, m = 0.5: V^T M V differs from the" in message
    assert not Path("own.h5").exists()
    assert run(given) == 0
    assert "no factorisation, the basis of" in capsys.readouterr().out
    assert package.read_result("own.h5").reduced.record.basis_of == str(ranges.absolute())
