"""The command line as users meet it: what it prints, what it refuses, and the README's example."""

import json
import re
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import scipy.sparse
from conftest import DATA

import hpcred as package
from hpcred.cli import run

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


def refused(capsys, *arguments):
    """The one sentence with which a command line is refused; nothing may have been written."""
    before = sorted(Path().iterdir())
    capsys.readouterr()
    status = run(list(arguments))
    message = capsys.readouterr().err
    assert status == 2, message
    assert message.startswith("hpcred: error: ") and message.count("\n") == 1, message
    assert "Traceback" not in message
    assert sorted(Path().iterdir()) == before
    return message


def replaced(old, new):
    assert old in JOB
    Path("job.toml").write_text(JOB.replace(old, new))


@pytest.mark.parametrize(
    "old, new, says",
    [
        ("order = 1", "ordr = 1", r"basis\[0\].ordr: unknown key \(did you mean 'order'\?\)"),
        ("order = 1", "order = 1.5", r"basis\[0\].order: found 1.5, expected a whole number"),
        ("order = 1", 'order = "1"', r"basis\[0\].order: found '1', expected a whole number"),
        ("order = 1", "order = -1", r"krylov.order: found -1"),
        ("frequency = 100.0", "frequency = -5.0", "krylov.frequency: found -5"),
        ("frequency = 100.0", "", r"krylov: expected frequency \(Hz\), decay"),
        ("frequency = 100.0", "decay = -1.0", "krylov.decay: found -1"),
        ("nodes = [1, 7, 14]", "", r"frame.nodes: missing; expected \["),
        ('kind = "krylov"', 'kind = "krilov"', r"found 'krilov', expected one of .* \(did you mean 'krylov'\?\)"),
        ("[frame]", "band = [300.0, 0.0]\n[frame]", r"band: found \[300.0, 0.0\]"),
        ("[frame]", "band = [-1.0, 2.0]\n[frame]", r"band: found \[-1.0, 2.0\]"),
        ("[frame]", "banf = [0.0, 2.0]\n[frame]", r"banf: unknown key \(did you mean 'band'\?\)"),
        ('kind = "krylov"\nfrequency = 100.0\norder = 1', 'kind = "modes"\nband = [9.0, 1.0]', r"modes.band: found"),
        (
            'kind = "krylov"\nfrequency = 100.0\norder = 1',
            'kind = "modes"\ncount = 3\nband = [0.0, 1.0]',
            "exactly one of count, band and index",
        ),
        ("[1, 7, 14]", "[5, 7, 14]", "collinear: node 5 at"),
        ("[1, 7, 14]", "[1, 7, 99]", "node 99 does not exist in model.h5; its nodes are numbered 1 to 20"),
        ("[1, 7, 14]", "[1, 7]", r"frame.nodes: found \[1, 7\], expected \[a whole number, a whole number"),
        ('"yxz"', '"zyx"', "leave a rotation free"),
        ('"yxz"', '"yyz"', "expected an order of x, y and z"),
        ('[[20, "z"]]', '[[20, "w"]]', "direction: found 'w', expected one of x, y, z"),
        ('[[20, "z"]]', "[121]", "dof 121 does not exist in model.h5; its dofs are numbered 1 to 120"),
        ("order = 1", "order = 200", "basis: 201 vectors asked for, but model.h5 has only 114"),
        ('kind = "krylov"\nfrequency = 100.0\norder = 1', 'kind = "modes"\ncount = 115', "115 elastic modes asked"),
        ('"model.h5"', '"missing.h5"', "missing.h5: no such file"),
        ('"model.h5"', '"job.toml"', "job.toml: not a readable HDF5 file"),
        ("[frame]", 'output = "nowhere/r.h5"\n[frame]', "the folder nowhere does not exist"),
        ("[frame]", 'output = "/proc/r.h5"\n[frame]', "cannot be written"),
        ("[frame]", '[damping]\nkind = "given"\n[frame]', "needs a damping matrix"),
        ("[frame]", '[damping]\nkind = "rayleigh"\nalpha = -1.0\n[frame]', "neither may be negative"),
        ('kind = "chord"\nnodes = [1, 7, 14]\naxes = "yxz"', 'kind = "tangent"\nnode = 21', "node 21 does not exist"),
        ('[frame]\nkind = "chord"\nnodes = [1, 7, 14]\naxes = "yxz"', "", None),
        ("frequency", "frequency =", "not a TOML file"),
        ("[frame]", '[damping]\nkind = "structural"\nloss_factor = -0.1\n[frame]', "loss_factor: found -0.1"),
        ("[frame]", '[damping]\nkind = "modal"\nratio = -0.1\n[frame]', "found the ratio -0.1; it may not be negative"),
        ("[frame]", '[damping]\nkind = "modal"\n[frame]', "exactly one of ratio, ratios and table"),
        ("[frame]", '[damping]\nkind = "caughey"\ncoefficients = []\n[frame]', "at least one number"),
        ("[frame]", 'projection = "oblique"\n[frame]', "found 'oblique', expected 'one_sided' or 'two_sided'"),
        ('kind = "krylov"\nfrequency = 100.0', 'kind = "second_order_krylov"', "expected a point: frequency"),
        (
            'kind = "krylov"\nfrequency = 100.0',
            'kind = "second_order_krylov"\ndecay = 1.0\ns = [0.0, 1.0]',
            "expected s, or frequency and decay, not both",
        ),
        (
            'kind = "krylov"\nfrequency = 100.0',
            'kind = "second_order_krylov"\ns = [-3.0, 1.0]',
            "second_order_krylov.decay: found -3, expected 1/s, not negative",
        ),
    ],
)
def test_a_bad_job_is_refused(folder, capsys, old, new, says):
    replaced(old, new)
    if says is None:  # a free body at 100 Hz is a fair problem; at 0 Hz it is not
        Path("job.toml").write_text(Path("job.toml").read_text().replace("100.0", "0.0"))
        says = "can move freely; take frame kind 'buckens'"
    assert re.search(says, refused(capsys, "reduce", "job.toml"))


def write_matrices(change):
    """K.mtx and M.mtx of a chain of four masses, after a change of the arrays."""
    mats = {"K": np.diag([2.0, 2, 2, 1]) - np.eye(4, k=1) - np.eye(4, k=-1), "M": np.eye(4)}
    mats.update(change(**mats) or {})
    for key, mat in mats.items():
        scipy.io.mmwrite(f"{key}.mtx", scipy.sparse.coo_matrix(mat), symmetry="general")


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
        (lambda K, M: _set(K, 1, 2, np.nan), "matrix K has 1 entries that are NaN or Inf, .* dof 2"),
        (lambda K, M: _set(M, 3, 3, np.inf), "matrix M has 1 entries that are NaN or Inf"),
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
    write_matrices(lambda K, M: _set({"K": K, "M": M}[key], 0, 1, 1e-6 - (key == "K")))
    assert run(["convert", "-K", "K.mtx", "-M", "M.mtx", "model.h5", "--inputs", "4"]) == 0
    Path("job.toml").write_text('model = "model.h5"\n[[basis]]\nkind = "krylov"\nfrequency = 0.0\n')
    says = rf"matrix {key} is not symmetric: \|\|A - A\^T\|\| / \|\|A\|\| = \d.\de-0[67]"
    assert re.search(says, refused(capsys, "reduce", "job.toml"))


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
        (["convert", "model2.h5"], "no matrices"),
        (["convert", "block.inp", "model2.h5"], "found no matrix K beside it"),
        (["info", "model.h5", "--below", "1,x"], "expected numbers separated by commas"),
        (["evaluate", "model.h5"], "format 'hpcred-model', expected 'hpcred-result'"),
        (["evaluate", "model.h5", "--band", "3,1"], "--band: found '3,1'"),
        (["example", "solid", "--cells", "0", "1", "1", "-o", "x.h5"], "expected three numbers of at least 1"),
        (["--scalar", "quaternion", "info", "model.h5"], "expected 'real' or 'complex'"),
    ],
)
def test_bad_command_lines_are_refused(folder, capsys, arguments, says):
    assert says in refused(capsys, *arguments)


def test_more_ranks_than_rows_are_refused(hpcred, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_matrices(lambda K, M: {"K": K[:2, :2], "M": M[:2, :2]})
    result = hpcred("convert", "-K", "K.mtx", "-M", "M.mtx", "model.h5", ranks=3)
    assert result.returncode == 2
    assert result.stderr.count("2 rows cannot be distributed over 3 ranks") == 1
    assert not Path("model.h5").exists()


def test_the_demo_prints_its_table(hpcred, tmp_path):
    result = hpcred(ranks=2)
    assert result.returncode == 0, result.stderr
    rows = re.findall(r"^ +(\d) .* 14 +\S+ +(\S+) +(\S+) *$", result.stdout, re.M)
    found = {int(row): float(q) for row, q, _ in rows}
    assert found[1] < 1e-8
    assert found[3] == pytest.approx(8.91e-2, rel=2e-3)
    assert found[4] == pytest.approx(8.39, rel=2e-3)
    assert "result.h5" in result.stdout
    with h5py.File(tmp_path / "result.h5") as file:
        assert file["basis/V"].shape == (14, 120)


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


def test_inputs_as_files_and_matrices_in_the_job(tmp_path, monkeypatch):
    """A job without model.h5, with B from a file: the same as dof numbers."""
    monkeypatch.chdir(tmp_path)
    write_matrices(lambda K, M: None)
    scipy.io.mmwrite("B.mtx", np.eye(4)[:, [3, 0]])
    job = (
        'inputs = {}\noutput = "{}"\n[model]\nK = "K.mtx"\nM = "M.mtx"\n[[basis]]\nkind = "krylov"\nfrequency = 0.01\n'
    )
    Path("a.toml").write_text(job.format('"B.mtx"', "a.h5"))
    Path("b.toml").write_text(job.format("[4, 1]", "b.h5"))
    assert run(["reduce", "a.toml"]) == 0 and run(["reduce", "b.toml"]) == 0
    a, b = (package.read_result(f"{name}.h5") for name in "ab")
    assert np.allclose(a.transfer_function(0.3j), b.transfer_function(0.3j), rtol=1e-12)
    assert a.input_names == ["B.mtx:1", "B.mtx:2"] and b.input_names == ["dof 4", "dof 1"]


def test_an_output_matrix_of_another_size_is_refused(folder, capsys):
    scipy.io.mmwrite("C.mtx", np.eye(3, 119))
    replaced("[frame]", 'outputs = "C.mtx"\n[frame]')
    assert "C.mtx: found 3 x 119, expected 120 columns" in refused(capsys, "reduce", "job.toml")


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


def test_the_example_of_the_readme_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = (Path(__file__).parent.parent / "README.md").read_text()
    (example,) = re.findall(r"```python\n(.*?)```", text, re.S)
    exec(compile(example, "README.md", "exec"), {})
    assert "largest error" in capsys.readouterr().out
