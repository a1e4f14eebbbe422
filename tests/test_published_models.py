"""The published models of benchmarks/models: right against SciPy's sparse LU, or refused in a sentence."""

import numpy as np
import pytest

import hpcred
from benchmarks.models import MODELS
from benchmarks.models import __main__ as program
from benchmarks.models.published import find

HERE = [name for name, published in MODELS.items() if find(published.file)]


def published(name):
    """A model whose file is here; the test is skipped where it is not."""
    return MODELS[name] if name in HERE else pytest.skip(f"{MODELS[name].file} is not here")


@pytest.mark.mpi(ranks=(1, 3), build="real")
@pytest.mark.parametrize("name", ["foundation", "concrete", "shaft"])
def test_reduced_to_a_tolerance(comm, name):
    made = published(name)
    given = made.matrices()
    assert given.M.shape == (made.n, made.n)
    with made.model(comm) as model, made.reduce(model) as rom:
        eta = rom.record.accuracy.loss_factor
        assert rom.record.accuracy.reached and rom.size < made.n / 30
        fresh = np.random.default_rng(4).uniform(*made.band, 3)
        s = 2j * np.pi * fresh
        reduced = [rom.C @ np.linalg.solve(x * x * rom.M + x * rom.D + (1 + 1j * eta) * rom.K, rom.B) for x in s]
    full = np.array([given.response(f, eta) for f in fresh])
    # all entries at a frequency beside the largest one: a weaker measure than that of the search
    assert (np.abs(full - reduced).max(axis=(1, 2)) < made.tolerance * np.abs(full).max(axis=(1, 2))).all()


def test_made_into_a_file_with_its_job(tmp_path, capsys, monkeypatch):
    made = published("shaft")
    monkeypatch.chdir(tmp_path)
    assert program.main(["make", "shaft", "--data", str(made.path().parent), "shaft.h5"]) == 0
    (tmp_path / "job.toml").write_text(capsys.readouterr().out)
    job = hpcred.read_job("job.toml")
    assert job.band == made.band
    with hpcred.read_model("shaft.h5") as model:
        assert model.size == 400


def test_a_file_that_is_not_there(tmp_path, capsys):
    assert program.main(["make", "iss12a", "--data", str(tmp_path), "x.h5"]) == 2
    assert capsys.readouterr().err == (
        f"iss12a: found no iss12a.mat in {tmp_path}; download it from slicot.org, Benchmarks for Model Reduction and "
        "name its folder\n"
    )
    assert program.main(["list"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == len(MODELS) + 1
