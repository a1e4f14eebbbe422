"""Harmonic analysis against dense and direct solves, its files, its check, and what is refused."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse
from helpers import dense_model, refused, to_dense

import hpcred as package
from hpcred import (
    Buckens,
    Caughey,
    Chord,
    GivenDamping,
    InputError,
    ModalDamping,
    Rayleigh,
    SecondOrderModel,
    Structural,
)
from hpcred.analysis.error_check import Check
from hpcred.cli.main import run
from hpcred.settings import texts

BAND = (0.0, 9000.0)


@pytest.fixture
def model_file(tmp_path, monkeypatch):
    """model.h5 of a clamped block with two inputs, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    with package.solid((6, 2, 2), inputs=2) as model:
        package.write_model("model.h5", model)
    return tmp_path


@pytest.mark.parametrize(
    "damping, terms", [(Rayleigh(20.0, 1e-7), (20.0, 1e-7, 0.0)), (Caughey((0.0, 1e-6)), (0.0, 1e-6, 0.0)),
                       (Structural(0.02), (0.0, 0.0, 0.02)), (None, (0.0, 0.0, 0.0))],
)  # fmt: skip
def test_against_dense_solves(solid, damping, terms):
    """At frequencies that no point of the search is near; the estimate holds at each of them."""
    frequencies = np.linspace(*BAND, 61)
    found = package.full_response(solid, frequencies, damping=damping, tolerance=1e-5)
    K, M, B = dense_model(solid)
    alpha, beta, eta = terms
    for f, H, eps in zip(frequencies, found.response, found.eps, strict=True):
        s = 2j * np.pi * f
        exact = B.T @ np.linalg.solve(s * s * M + s * (alpha * M + beta * K) + (1 + 1j * eta) * K, B.astype(complex))
        error = np.linalg.norm(exact - H) / np.linalg.norm(exact)
        assert error <= 1e-5 and error <= 3 * eps + 1e-9
    assert found.reached and found.accuracy.tolerance == 1e-5
    assert len(found.factorisations) == found.accuracy.factorisations <= 4


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.costly
def test_a_free_body_with_a_check(linkage):
    """The elastic response in the Buckens frame from rest on, like direct solves in both builds."""
    frequencies = np.linspace(0.0, 300.0, 31)
    damping = Rayleigh(2.0, 1e-5)
    found = package.full_response(linkage, frequencies, Buckens(), damping, tolerance=1e-6, check=3, seed=5)
    direct = package.frequency_response(linkage, frequencies, Buckens(), damping)
    assert package.relative_error(direct, found.response).max() < 1e-6
    assert found.reached and found.check.passed and found.check.seed == 5
    assert 3 < len(found.check.frequencies) <= 6


def test_dashpots_and_outputs_of_their_own():
    """A given D that is not proportional, and C that differs from B^T."""
    n = 40
    K = scipy.sparse.diags([2.0 * np.ones(n), -np.ones(n - 1), -np.ones(n - 1)], [0, 1, -1]) * 1e4
    D = scipy.sparse.diags(np.where(np.arange(n) % 7 == 3, 5.0, 0.1))
    B, C = np.zeros((n, 1)), np.zeros((n, 2))
    B[n - 1], C[5, 0], C[20, 1] = 1.0, 1.0, 1.0
    frequencies = np.linspace(0.5, 20.0, 50)
    names = {"input_names": ["force"], "output_names": ["left", "middle"]}
    with SecondOrderModel.from_scipy(K, scipy.sparse.identity(n), D, inputs=B, outputs=C, **names) as model:
        found = package.full_response(model, frequencies, damping=GivenDamping(), tolerance=1e-6)
    for f, H in zip(frequencies, found.response, strict=True):
        s = 2j * np.pi * f
        exact = C.T @ np.linalg.solve(s * s * np.eye(n) + s * D.toarray() + K.toarray(), B.astype(complex))
        assert np.linalg.norm(exact - H) <= 1e-6 * np.linalg.norm(exact)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_a_basis_of_all_coordinates_is_exact(n):
    """Nothing is left that could be held back for an estimate."""
    K = scipy.sparse.diags([2.0 * np.ones(n), -np.ones(n - 1), -np.ones(n - 1)], [0, 1, -1]) * 1e4
    frequencies = np.linspace(0.0, 50.0, 20)
    with SecondOrderModel.from_scipy(K, scipy.sparse.identity(n), inputs=np.eye(n)[:, [0]], input_names=["u"]) as model:
        found = package.full_response(model, frequencies, damping=Rayleigh(1.0, 1e-5), tolerance=1e-8)
    assert found.reached
    for f, H in zip(frequencies, found.response, strict=True):
        s = 2j * np.pi * f
        exact = np.linalg.inv(s * s * np.eye(n) + s * (np.eye(n) + 1e-5 * K.toarray()) + K.toarray())[0, 0]
        assert abs(H[0, 0] - exact) < 1e-10 * abs(exact)


def test_the_command_and_its_files(model_file, capsys):
    command = ["response", "model.h5", "--band", "0,9000", "--points", "101", "--damping", "rayleigh:20,1e-7"]
    command += ["--tolerance", "1e-5"]
    more = ["--check", "3", "--seed", "4", "--figure", "r.svg", "--json", "r.json"]
    assert run([*command, *more, "-o", "r.h5"]) == 0
    shown = capsys.readouterr().out
    assert "(tolerance 0.001 %) over 0 to 9000 Hz" in shown and "): largest error" in shown
    assert run([*command, "-o", "r.csv"]) == 0
    report, stored = json.loads(Path("r.json").read_text()), package.read_responses("r.h5")
    assert report["reached"] and report["check"]["seed"] == 4 and report["proofs"]
    assert stored.record["proofs"] == report["proofs"] and stored.record["sentences"] == report["sentences"]
    with open("r.csv", newline="") as file:
        head, *lines = csv.reader(file)
    values = np.array(lines, dtype=float)
    name = stored.input_names[1]
    column = head.index(f"re_{stored.output_names[0]}/{name}")
    assert np.array_equal(values[:, column] + 1j * values[:, column + 1], stored.response[:, 0, 1])
    assert np.array_equal(values[:, -1], report["eps"])
    with package.read_model("model.h5") as model:
        direct = package.frequency_response(model, stored.frequencies[[7, 60]], damping=Rayleigh(20.0, 1e-7))
    assert package.relative_error(direct, stored.response[[7, 60]]).max() < 1e-5
    effort = "1 factorisation" if report["factorisations"] == 1 else f"{report['factorisations']} factorisations"
    assert f"<!-- model.h5: 101 frequencies, {effort} -->" in Path("r.svg").read_text()


def test_a_tolerance_below_round_off_is_said_first(model_file, capsys):
    """Written all the same, with exit status 1."""
    assert run(["response", "model.h5", "--band", "0,9000", "--tolerance", "1e-14", "-o", "r.csv"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("NOT REACHED") and "limited by" in lines[1] and Path("r.csv").is_file()
    assert run(["response", "model.h5", "--band", "0,9000", "--tolerance", "1e-14", "--quiet"]) == 1
    said = capsys.readouterr()
    assert not said.out and said.err.splitlines()[:2] == lines[:2]


def test_a_check_can_fail():
    check = Check(seed=7, bound=1e-4, frequencies=(1.0, 2.0), estimated=(1e-5, 1e-5), measured=(1e-5, 2e-3))
    assert not check.passed
    assert "ABOVE at 1 of them, largest error 0.2 % (tolerance 0.01 %), at 2 Hz (estimated 0.001 %)" in check.sentence
    assert not Check(seed=7, bound=1e-4, frequencies=(1.0,), estimated=(1e-5,), measured=(float("nan"),)).passed


def test_texts_of_frames_and_laws():
    assert texts.frame("chord:1,7,14:yxz", "") == Chord(nodes=(1, 7, 14), axes="yxz")
    assert texts.frame("buckens", "") == Buckens()
    assert texts.damping("loss:0.02", "") == Structural(0.02)
    assert texts.damping("rayleigh:20,1e-7", "") == Rayleigh(20.0, 1e-7)


@pytest.mark.parametrize(
    "arguments, says",
    [
        ([], "no frequencies; give the band in Hz"),
        (["--band", "300,0"], "expected two frequencies in Hz"),
        (["--band", "0,300", "--frequencies", "10,400"], "expected one with all frequencies, which go from 10 to 400"),
        (["--frequencies", "10"], "found only 10 Hz"),
        (["--band", "0,300", "--tolerance", "0"], "tolerance: found 0"),
        (["--band", "0,300", "--points", "1"], "points: found 1, expected at least 2"),
        (["--band", "0,300", "--frame", "chord:1,7"], "--frame: found 'chord:1,7', expected none, buckens"),
        (["--band", "0,300", "--frame", "tangent:one"], "--frame: found 'tangent:one'"),
        (["--band", "0,300", "--damping", "rayleigh:20"], "--damping: found 'rayleigh:20', expected none, given"),
        (["--band", "0,300", "--damping", "loss:nan"], "--damping: found nan"),
        (["--band", "0,300", "--damping", "loss:-1"], "damping.loss_factor: found -1, expected 0"),
        (["--band", "0,300", "--damping", "given"], "'given' needs a damping matrix"),
        (["--band", "0,300", "-o", "r.txt"], "expected a name that ends in .csv, .h5, .hdf5, .unv, .uff or .npz"),
        (["--band", "0,300", "-o", "r.npz", "--polar"], "--polar: is of a .csv, and r.npz has complex numbers"),
        (["--band", "0,300", "--figure", "r.jpg"], "expected a name that ends in .png, .svg, .pdf"),
        (["--band", "0,300", "--check", "-1"], "check: found -1"),
        (["--band", "0,300", "-o", "nowhere/r.csv"], "the folder nowhere does not exist"),
    ],
)
def test_refusals(model_file, capsys, arguments, says):
    assert says in refused(capsys, "response", "model.h5", *arguments)


def test_what_has_no_full_response_is_refused(linkage, solid):
    with pytest.raises(InputError, match="0 Hz, where linkage, which is free, has none; begin above"):
        package.full_response(linkage, np.linspace(0, 300, 11))
    with pytest.raises(InputError, match="modal ratios belong to a reduced model"):
        package.full_response(solid, [1.0, 2.0], damping=ModalDamping(ratio=0.01))
    with pytest.raises(InputError, match="Caughey series of more terms"):
        package.full_response(solid, [1.0, 2.0], damping=Caughey((1.0, 1e-6, 1e-12)))


def test_an_undamped_pole_is_refused(solid):
    """A frequency of one of the modes to the last digits."""
    import scipy.linalg

    pole = np.sqrt(scipy.linalg.eigh(to_dense(solid.K), to_dense(solid.M), eigvals_only=True)[0]) / (2 * np.pi)
    assert package.full_response(solid, [0.0, pole, 2 * pole], damping=Rayleigh(1.0), tolerance=1e-3).reached
    with pytest.raises(InputError, match=f"frequency {pole:.10g} Hz is a pole"):
        package.full_response(solid, [0.0, pole, 2 * pole], tolerance=1e-8)
