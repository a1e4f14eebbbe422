"""The published models of benchmarks/models: right against SciPy's sparse LU, or refused in a sentence."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse
import tomllib
from fifty_digits import at_peaks, exact_response, with_other_last_digits
from launch import mpi_environment

import hpcred
from benchmarks.models import MODELS, slicot
from benchmarks.models import __main__ as program
from benchmarks.models.published import find, unit_columns

HERE = [name for name, published in MODELS.items() if find(published.file)]


def published(name):
    """A model whose file is here; the test is skipped where it is not."""
    return MODELS[name] if name in HERE else pytest.skip(f"{MODELS[name].file} is not here")


@pytest.mark.mpi(build="real")
@pytest.mark.costly
@pytest.mark.parametrize("name", ["shaft", "sandwich", *(pytest.param(name, marks=pytest.mark.slow)
                                                       for name in ("foundation", "concrete"))])  # fmt: skip
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


@pytest.mark.parametrize("name, rows", [("concrete", [3]), ("shaft", [39])])
def test_forces_on_dofs_without_mass_are_right_or_said_to_be_wrong(name, rows):
    made = published(name)
    given = made.matrices()
    assert not given.M.diagonal()[rows[-1]]
    given.B = unit_columns(made.n, rows)
    with hpcred.SecondOrderModel(given.M, given.D, given.K, given.B) as model, made.reduce(model) as rom:
        accuracy = rom.record.accuracy
        s = 2j * np.pi * 0.8 * made.band[1]
        K = (1 + 1j * accuracy.loss_factor) * rom.K
        reduced = rom.C @ np.linalg.solve(s * s * rom.M + s * rom.D + K, rom.B)
    full = given.response(0.8 * made.band[1], accuracy.loss_factor)
    assert np.abs(full - reduced).max() < max(made.tolerance, accuracy.largest) * np.abs(full).max()
    assert accuracy.reached or accuracy.sentence.startswith("NOT REACHED")


@pytest.mark.parametrize("top, tolerance", [(300.0, 1e-4), (300.0, 1e-6), (1000.0, 1e-6)])
def test_narrow_bands_and_small_errors_of_the_shaft(top, tolerance):
    """Its first resonance has a damping ratio of 7e-8: right for K as stored, and said to hang on its last digits."""
    made = published("shaft")
    given = made.matrices()
    rows = given.B.argmax(axis=0)
    with hpcred.SecondOrderModel(given.M, given.D, given.K, given.B) as model:
        rom = hpcred.reduce(model, tolerance=tolerance, band=(0.0, top))
    eta, f = rom.record.accuracy.loss_factor, np.array([*at_peaks(rom, 3), top])
    assert rom.record.accuracy.reached and eta == (0.0 if top < 500 else 0.002)
    found = replace(rom, loss_factor=eta).frequency_response(f)
    said = [line for line in rom.record.warnings if "last digits of K, where stiff parts cancel, move its" in line]
    if eta:  # of modes that are without damping; SciPy's solves have the round-off that the warning names
        full = np.array([given.response(at, eta) for at in f])
        assert said and hpcred.relative_error(full, found).max() < 3e-4
        return
    K, M, D = (mat.toarray() for mat in (given.K, given.M, given.D))
    exact = np.array([exact_response(K, M, D, rows, at) for at in f])
    assert said and hpcred.relative_error(exact, found).max() < tolerance
    other = exact_response(with_other_last_digits(K), M, D, rows, f[0])
    assert hpcred.relative_error(exact[:1], other[None]).max() > 0.1


def test_made_into_a_file_with_its_job(tmp_path, capsys, monkeypatch):
    made = published("shaft")
    monkeypatch.chdir(tmp_path)
    assert program.main(["make", "shaft", "--data", str(made.path().parent), "shaft.h5"]) == 0
    (tmp_path / "job.toml").write_text(capsys.readouterr().out)
    job = hpcred.settings.read_job("job.toml")
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


@pytest.mark.slow
def test_a_brake_that_squeals_is_declared(tmp_path):
    made = published("disk-brake")
    given = made.matrices()
    with (
        hpcred.SecondOrderModel(given.M, given.D, given.K, given.B) as undeclared,
        pytest.raises(hpcred.InputError, match="of K that has circulatory forces say circulatory = true"),
    ):
        made.reduce(undeclared)
    with made.model() as model, made.reduce(model) as rom:
        assert rom.record.accuracy.reached and rom.size < made.n
        s = 2j * np.pi * 0.17
        reduced = rom.C @ np.linalg.solve(s * s * rom.M + s * rom.D + rom.K, rom.B)
    full = given.response(0.17)
    assert np.linalg.norm(reduced - full) < 5 * made.tolerance * np.linalg.norm(full)


def test_negative_masses_are_refused():
    with pytest.raises(hpcred.InputError, match="the mass matrix has 100 negative diagonal entries"):
        published("speaker-box").model()


@pytest.fixture
def wiki(tmp_path):
    """Files as those of the MOR Wiki, of small blocks: two bones, and a gyroscope with blank lines."""
    for name, cells in (("BS01", (6, 3, 3)), ("BS10", (8, 4, 4)), ("gyro", (4, 2, 2))):
        with hpcred.solid(cells=cells) as block:
            M, K = (scipy.sparse.csr_matrix(mat.getValuesCSR()[::-1]) for mat in (block.M, block.K))
        B = scipy.sparse.coo_matrix(([2.0], ([M.shape[0] - 1], [0])), (M.shape[0], 1))
        C = scipy.sparse.coo_matrix((np.ones(3), (range(3), range(3))), (3, M.shape[0]))
        for key, matrix in {"M": M, "K": K, "B": B, "C": C}.items():
            with open(tmp_path / f"{name}.{key}", "wb") as file:
                scipy.io.mmwrite(file, matrix, symmetry="symmetric" if key in "MK" else "general", precision=16)
    for key in "MKBC":  # one below the comments and one at the end, as there
        head, comment, rest = (tmp_path / f"gyro.{key}").read_text().split("\n", 2)
        (tmp_path / f"gyro.{key}").write_text(f"{head}\n{comment}\n\n{rest}\n")
    return tmp_path


@pytest.mark.parametrize("name, damping", [("BS01", None), ("gyro", hpcred.Rayleigh(alpha=0.0, beta=1e-6))])
def test_matrix_market_files(wiki, name, damping):
    made = MODELS[name]
    given = made.matrices(wiki)
    assert made.damping == damping
    with made.model(folder=wiki) as model:
        assert (len(model.input_names), len(model.output_names)) == (1, 3)
        H = hpcred.frequency_response(model, [40.0, 70.0], damping=damping)
    full = np.array([given.response(f) for f in (40.0, 70.0)])
    assert np.abs(H - full).max() < 1e-9 * np.abs(full).max()
    (wiki / f"{name}.C").unlink()
    with pytest.raises(hpcred.InputError, match=rf"found no {name}.C beside .*, expected {name}.M, .K, .B and .C"):
        made.model(folder=wiki)


@pytest.mark.parametrize("change, sentence", [
    (lambda lines: lines[:-1], r"found \d+ entries, the header says \d+; the file is damaged"),
    (lambda lines: [*lines[:-1], "3 3\n"], r"line \d+: found '3 3'"),
    (lambda lines: ["%%MatrixMarket matrix coordinate\n", *lines[1:]], "expected a real Matrix Market header"),
    (lambda lines: [*lines[:2], "9 9 x\n"], "found the size line '9 9 x', expected rows, columns and entries"),
    (lambda lines: [], "expected a real Matrix Market header"),
])  # fmt: skip
def test_damaged_files_of_matrix_market(wiki, change, sentence):
    path = wiki / "BS01.K"
    path.write_text("".join(change(path.read_text().splitlines(keepends=True))))
    with pytest.raises(hpcred.InputError, match=f"BS01.K.*{sentence}"):
        MODELS["BS01"].matrices(wiki)


@pytest.mark.slow
def test_a_bone_that_fails_is_left_out_in_one_line(wiki):
    path = wiki / "BS01.K"
    path.write_text(path.read_text()[:2000])
    script = Path(__file__).parents[1] / "benchmarks/bones.py"
    ran = subprocess.run([sys.executable, script, "--data", wiki, "--ranks", "1"], cwd=wiki, capture_output=True,
                         text=True, env=mpi_environment())  # fmt: skip
    assert ran.returncode == 1 and "BS01: left out; hpcred convert ended with status" in ran.stderr
    assert "the file is damaged" in ran.stderr and "Traceback" not in ran.stderr
    assert [row["model"] for row in json.loads((wiki / "bones.json").read_text())["rows"]] == ["BS10"]


@pytest.mark.slow
def test_a_bone_beyond_the_tolerance_has_its_row(wiki):
    script = Path(__file__).parents[1] / "benchmarks/bones.py"
    few = ("--set", "adaptive.size=1")
    ran = subprocess.run([sys.executable, script, "--data", wiki, "--ranks", "1", "BS01", *few], cwd=wiki,
                         env=mpi_environment())  # fmt: skip
    row, = json.loads((wiki / "bones.json").read_text())["rows"]
    assert ran.returncode == 0 and not row["reached"] and row["coordinates"] == 1


@pytest.mark.slow
def test_bones_on_one_curve(wiki):
    script = Path(__file__).parents[1] / "benchmarks/bones.py"
    subprocess.run(
        [sys.executable, script, "--data", wiki, "--ranks", "1"], cwd=wiki, check=True, env=mpi_environment()
    )
    small, large = json.loads((wiki / "bones.json").read_text())["rows"]
    assert (small["model"], large["model"]) == ("BS01", "BS10") and small["dofs"] < large["dofs"]
    assert all(row["reached"] and 0 < row["coordinates"] < 30 and row["error"] <= 1e-4 for row in (small, large))
    assert (wiki / "bones.png").stat().st_size > 10_000


@pytest.fixture
def building(tmp_path):
    """A file as that of SLICOT's building, of a chain: M = 1, Hankel values of its own."""
    n = MODELS["building"].n
    K = 400.0 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    D = 0.1 * np.eye(n) + 1e-3 * K
    B, C = np.eye(n)[:, [n - 1]], np.eye(n)[[n - 1]]
    zero, one = np.zeros((n, n)), np.eye(n)
    file = {"A": np.block([[zero, one], [-K, -D]]), "B": np.vstack([0 * B, B]), "C": np.hstack([0 * C, C])}
    file["hsv"] = np.sort(slicot.hankel_values(one, D, K, B, Cv=C))[:, None]
    scipy.io.savemat(tmp_path / "build.mat", {key: scipy.sparse.csc_matrix(value) for key, value in file.items()})
    return tmp_path, file


def test_first_order_models_of_slicot(building):
    folder, file = building
    made = MODELS["building"]
    with made.model(folder=folder) as model, made.reduce(model, tolerance=1e-6) as rom:
        found = slicot.hankel_values(rom.M, rom.D, rom.K, rom.B, rom.C, rom.Cv)
        H = hpcred.frequency_response(model, [1.0])[0]
    s = 2j * np.pi
    assert np.allclose(H, file["C"] @ np.linalg.solve(s * np.eye(48) - file["A"], file["B"]), rtol=1e-10)
    known = slicot.published_hankel_values(made.path(folder))
    assert known[0] > known[-1] and np.abs(found - known[: len(found)]).max() < 1e-4 * known[0]


def test_hankel_values_of_one_oscillator():
    """x'' + d x' + k x = u, y = x': balanced already, with both values 1 / (2 d)."""
    found = slicot.hankel_values(*np.array([1.0, 0.5, 9.0, 1.0]).reshape(4, 1, 1), Cv=np.ones((1, 1)))
    assert np.allclose(found, [1.0, 1.0], rtol=1e-12)


def test_other_first_order_models_are_refused(building):
    folder, file = building
    made = MODELS["building"]
    for key, change in (("A", {"A": file["A"] + np.eye(48)}), ("B", {"B": file["B"][::-1]})):
        scipy.io.savemat(folder / "build.mat", file | change)
        with pytest.raises(hpcred.InputError, match=r"A and B are not \[0 I; -K -D\] and \[0; B\]"):
            made.matrices(folder)
        file.pop(key)
        scipy.io.savemat(folder / "build.mat", file)
        with pytest.raises(hpcred.InputError, match=f"found no variable {key}, only "):
            made.matrices(folder)
        file[key] = np.zeros((48, 1))


def test_what_a_second_order_model_has_no_place_for_is_refused(building):
    folder, file = building
    for change, sentence in (
        ({"D": np.ones((1, 1))}, "found D or E, expected x' = A x"),
        ({"E": np.eye(48)}, "found D or E, expected x' = A x"),
        ({"C": np.zeros((1, 48))}, "C has 48 columns with 0 numbers, expected 48 columns, not all of them zero"),
        ({"C": np.ones((1, 96))}, "C has 96 columns with 96 numbers, expected 48 columns"),
        ({"A": "text"}, "variable A has the type <U4, expected numbers"),
    ):
        scipy.io.savemat(folder / "build.mat", file | change)
        with pytest.raises(hpcred.InputError, match=sentence):
            MODELS["building"].matrices(folder)
    scipy.io.savemat(folder / "build.mat", file | {"D": np.zeros((1, 1))})
    assert MODELS["building"].matrices(folder).Cv.any()


@pytest.mark.parametrize("content", [lambda whole: b"", lambda whole: b"some text " * 20, lambda whole: whole[:900]])
def test_damaged_files_of_matlab(building, content):
    folder, _ = building
    path = folder / "build.mat"
    path.write_bytes(content(path.read_bytes()))
    with pytest.raises(hpcred.InputError, match="build.mat: .*; expected a whole MATLAB .mat file of version 4 to 7"):
        MODELS["building"].model(folder=folder)


def test_a_job_with_quotes_in_its_name():
    made = MODELS["building"].job('a "b" \\ é.h5')
    assert tomllib.loads(made)["model"] == 'a "b" \\ é.h5'


@pytest.mark.parametrize(
    "name, sentence",
    [("BS1", "found the name BS1, expected some of BS01, BS10"), ("BS10", "BS10: found no BS10.M in .; download it")],
)
def test_bones_that_are_not_there(tmp_path, name, sentence):
    script = Path(__file__).parents[1] / "benchmarks/bones.py"
    ran = subprocess.run([sys.executable, script, "--data", ".", name], cwd=tmp_path, capture_output=True, text=True)
    assert ran.returncode == 2 and sentence in ran.stderr
