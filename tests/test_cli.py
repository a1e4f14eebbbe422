"""The command line as users meet it: what it refuses."""

import json
import re
import shlex
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from helpers import refused, write_matrices
from launch import mpi_environment

import hpcred as package
from hpcred.cli.main import run


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the linkage as model.h5."""
    monkeypatch.chdir(tmp_path)
    with package.linkage() as model:
        package.write_model("model.h5", model)
    Path("job.toml").write_text('model = "model.h5"\n[[basis]]\nkind = "modes"\ncount = 2\n')
    return tmp_path


def _set(matrix, *place_and_value):
    *place, value = place_and_value
    matrix[tuple(place)] = value


def _empty(K, M):
    for mat in (K, M):
        mat[2, :] = mat[:, 2] = 0.0


@pytest.mark.parametrize(
    "change, says",
    [
        (lambda K, M: {"K": K[:3]}, r"K.mtx: found 3 x 4, expected a square matrix"),
        (lambda K, M: {"M": M[:3, :3]}, r"M.mtx: found 3 rows, but K \(K.mtx\) has 4"),
        (lambda K, M: _set(K, 1, 2, np.nan), "matrix K has entries that are NaN or Inf, .* dof 2"),
        (lambda K, M: _set(M, 3, 3, np.inf), "found the value inf in M"),
        (lambda K, M: _set(M, 1, 1, -1.0), "1 negative diagonal entries, the first at dof 2: -1"),
        (_empty, "1 dofs have no entry in K nor in M, the first is dof 3"),
    ],
)
def test_bad_matrices_are_refused(tmp_path, monkeypatch, capsys, change, says):
    monkeypatch.chdir(tmp_path)
    write_matrices(change)
    assert re.search(says, refused(capsys, "convert", "-K", "K.mtx", "-M", "M.mtx", "model.h5"))


@pytest.mark.parametrize("key", ["K", "M"])
def test_an_unsymmetric_matrix_is_refused(tmp_path, monkeypatch, capsys, key):
    monkeypatch.chdir(tmp_path)
    write_matrices(lambda K, M: _set({"K": K, "M": M}[key], [0, 1], [1, 0], [2e-6 - (key == "K"), 1e-6 - (key == "K")]))
    assert run(["convert", "-K", "K.mtx", "-M", "M.mtx", "model.h5", "--inputs", "4"]) == 0
    Path("job.toml").write_text('model = "model.h5"\n[[basis]]\nkind = "krylov"\nfrequency = 0.0\n')
    says = rf"matrix {key} is not symmetric: max \|a_ij - a_ji\| / \|a_ij\| = 1.0e-0[36], expected"
    assert re.search(says, refused(capsys, "reduce", "job.toml"))


def test_an_unsymmetric_stiffness_that_is_meant(tmp_path, monkeypatch, capsys):
    """By the job or the model file; the state space has the poles of the dense matrices."""
    monkeypatch.chdir(tmp_path)
    K = np.diag([2.0, 2, 2, 1]) - np.eye(4, k=1) - np.eye(4, k=-1) + 0.3 * (np.eye(4, k=2) - np.eye(4, k=-2))
    write_matrices(lambda **_: {"K": K})
    text = "output = '{0}.h5'\nmodel = '{0}_model.h5'\n{1}damping = {{kind = 'rayleigh', alpha = 1.0, beta = 0.1}}\n"
    basis = "[[basis]]\nkind = 'krylov'\nfrequency = 0.1\norder = 3\n"
    for name, asked, said in (("by_job", [], "circulatory = true\n"), ("by_model", ["--circulatory"], "")):
        given = ["-K", "K.mtx", "-M", "M.mtx", f"{name}_model.h5", "--inputs", "1"]
        assert run(["convert", *given, *asked]) == 0
        assert ("K is not symmetric, and cannot be reduced, unless" in capsys.readouterr().out) == (not asked)
        Path("job.toml").write_text(text.format(name, said) + basis)
        assert run(["reduce", "job.toml"]) == 0
        assert run(["export", f"{name}.h5", "-o", "rom.npz", "--format", "statespace-npz"]) == 0
        assert run(["evaluate", f"{name}.h5", "--full", f"{name}_model.h5", "--frequencies", "0.05,0.1,0.2"]) == 0
        with np.load("rom.npz") as found:
            poles = np.linalg.eigvals(found["A"])
        D = np.eye(4) + 0.1 * K
        expected = np.linalg.eigvals(np.block([[np.zeros((4, 4)), np.eye(4)], [-K, -D]]))
        assert np.sort_complex(poles) == pytest.approx(np.sort_complex(expected), abs=1e-9)
    for file, says in (("by_job.h5", True), ("by_model_model.h5", True), ("by_job_model.h5", False)):
        capsys.readouterr()
        assert run(["info", file]) == 0
        assert ("yes: K and its terms may be unsymmetric" in capsys.readouterr().out) == says
    Path("job.toml").write_text(text.format("by_job", "circulatory = true\n") + basis)
    assert run(["info", "job.toml"]) == 0 and "circulatory" in capsys.readouterr().out
    assert run(["evaluate", "by_job.h5", "by_model.h5", "--full", "by_job_model.h5", "--frequencies", "0.05,0.1"]) == 0
    assert "by_job_model.h5: K is not symmetric, so that the model has no real modes" in capsys.readouterr().out


@pytest.mark.parametrize(
    "text, says",
    [
        ("1 1 2.0\n1 x 3.0\n", "K.mtx, line 2: found '1 x 3.0', expected 3 numbers a line"),
        ("%%MatrixMarket matrix coordinate complex general\n1 1 1\n1 1 1.0 0.0\n", "expected a real Matrix Market"),
        ("%%MatrixMarket matrix coordinate real general\n2 2 2\n1 1 1.0\n", "found 1 entries, the header says 2"),
        ("%%MatrixMarket matrix coordinate real general\n2 2 1\n3 1 1.0\n", "K.mtx, line 3: found '3 1 1.0'"),
        ("hello\n", "found a file that begins with"),
    ],
)
def test_damaged_files_are_refused(tmp_path, monkeypatch, capsys, text, says):
    monkeypatch.chdir(tmp_path)
    Path("K.mtx").write_text(text)
    assert says in refused(capsys, "convert", "-K", "K.mtx", "-M", "K.mtx", "-o", "model.h5")


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["reduse"], "No such command"),
        (["reduce"], "Missing argument"),
        (["reduce", "job.toml", "--set", "basis.7.order=1"], "no place 'basis.7.order'"),
        (["reduce", "job.toml", "--set", "=1"], "--set: found '=1', expected key=value"),
        (["reduce", "job.toml", "--set", "tolerance=1e-3\nband=[1.0, 2.0]"], "band=[1.0, 2.0]', expected key=value"),
        (["reduce", "job.toml", "--store", ""], "--store: found an empty text, expected a value"),
        (["reduce", "job.toml", "--out-of-core", ""], "--out-of-core: found an empty text, expected a value"),
        (["sweep", "job.toml", "--store", ""], "--store: found an empty text, expected a value"),
        (["convert", "model2.h5"], "no matrices"),
        (["convert", "-K", "K.mtx", "model2.h5"], "only K; give the main file of an export, or K and M by -K and -M"),
        (["convert", "model.h5", "model2.h5"], "a model of hpcred, which needs no conversion; a job names"),
        (["info", "."], ".: this is a folder, expected a file"),
        (["reduce", "."], ".: this is a folder, expected a file"),
        (["export", ".", "--format", "sid"], ".: this is a folder, expected a file"),
        (["convert", "block.inp", "model2.h5"], "block.inp: no such file"),
        (["info", "model.h5", "--below", "1,x"], "expected numbers separated by commas"),
        (["evaluate", "model.h5", "--band", "3,1"], "found '3,1', expected two frequencies in Hz, the lower one"),
        (["evaluate", "model.h5"], "expected 'hpcred-result', which hpcred reduce writes"),
        (["reduce", "model.h5"], "model.h5: found a file that is no text, expected a text in TOML"),
        (["export", "rod.h5", "sid"], "write by -o: hpcred export rod.h5 --format sid"),
        (["export", "rod.h5", "a.SID_FEM"], "hpcred export rod.h5 -o a.SID_FEM"),
        (["example", "rod"], "(see hpcred example --help)"),
        (["example", "solid", "--cells", "0", "1", "1", "-o", "x.h5"], "expected three numbers of at least 1"),
        (["--scalar", "quaternion", "info", "model.h5"], "expected 'real' or 'complex'"),
    ],
)
def test_bad_command_lines_are_refused(folder, capsys, arguments, says):
    assert says in refused(capsys, *arguments)


def test_an_empty_file_is_called_so(folder, capsys):
    Path("result.h5").touch()
    for arguments in (["info", "result.h5"], ["convert", "result.h5", "model2.h5"]):
        assert "result.h5: found an empty file" in refused(capsys, *arguments)


def test_a_simulation_into_a_folder_is_refused(folder, capsys):
    Path("sim.toml").write_text('body = "result.h5"\nend = 1.0\noutput = "."\n')
    assert "output .: this is a folder, expected a file name" in refused(capsys, "simulate", "sim.toml")


def test_more_ranks_than_rows_are_refused(hpcred, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_matrices(lambda K, M: {"K": K[:1, :1], "M": M[:1, :1]})
    result = hpcred("convert", "-K", "K.mtx", "-M", "M.mtx", "model.h5", ranks=2)
    assert result.returncode == 2
    assert result.stderr.count("1 rows cannot be distributed over 2 ranks") == 1
    assert not Path("model.h5").exists()


def test_standard_streams_that_are_closed(folder):
    """A result is the same without them: were they only closed, it would be opened in their place."""
    frame = "--set frame.kind=tangent --set frame.node=1"
    command = f"{shlex.quote(sys.executable)} -m hpcred reduce job.toml {frame} <&- >&- 2>&-"
    found = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60)
    assert (found.returncode, found.stderr) == (0, "")
    assert package.read_result("result.h5").reduced.size == 2


def test_standard_output_that_is_full(folder, capsys, monkeypatch):
    with suppress(OSError), open("/dev/full", "w") as full:  # as it is closed with what it could not take
        monkeypatch.setattr(sys, "stdout", full)
        status = run(["reduce", "job.toml", "--set", "frame.kind=tangent", "--set", "frame.node=1"])
    assert status == 1
    assert capsys.readouterr().err.endswith("what is printed cannot be written (No space left on device); make room, "
                                            "or print elsewhere\n")  # fmt: skip
    assert package.read_result("result.h5").reduced.size == 2


def test_job_files_are_utf_8_in_any_locale(folder):
    text = 'job = "job.toml"  # \u00fc\nvary = [{key = "basis.0.count", values = [2]}]\n'
    Path("sweep.toml").write_text(text, encoding="utf-8-sig")
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    program = "from hpcred.settings.sweep_file import read_sweep; print(len(read_sweep('sweep.toml').runs))"
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60,
                           env=mpi_environment(**plain))  # fmt: skip
    assert (found.returncode, found.stdout, found.stderr) == (0, "1\n", "")


def test_the_list_of_commands_has_whole_sentences(capsys, monkeypatch):
    """In 80 columns, where they take several lines."""
    monkeypatch.setenv("COLUMNS", "80")
    for line, sentence in (("--help", "nodes from reduced coordinates over time, and stresses."),
                           ("example --help", "its bearings as the node sets BIG_EYE and SMALL_EYE.")):  # fmt: skip
        assert run(line.split()) == 0
        shown = capsys.readouterr().out
        assert sentence in " ".join(shown.split()) and "..." not in shown.partition("Commands:")[2]
        assert max(map(len, shown.splitlines())) <= 80


def test_json_may_stand_before_the_command(folder, capsys):
    told = []
    for line in ("--json - info model.h5", "--json=- info model.h5", "info model.h5 --json=-"):
        assert run(line.split()) == 0
        told.append(json.loads(capsys.readouterr().out))
    assert told[0] == told[1] == told[2]


def test_info_says_what_errors_of_an_undamped_result_are_measured_with(folder, capsys):
    Path("job.toml").write_text('model = "model.h5"\ntolerance = 1e-2\nband = [0.0, 60.0]\nframe = {kind = "buckens"}\n'
                                'inputs = [[20, "z"]]\n')  # fmt: skip
    assert run(["reduce", "job.toml"]) == 0 and run(["info", "result.h5", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out.partition("hpcred info result.h5 --details")[2].partition("\n")[2])
    assert found["damping"] == "none; errors are measured with the loss factor 0.002 (undamped)"
