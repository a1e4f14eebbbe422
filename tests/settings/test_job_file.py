"""Job files: each refusal by its sentence; inputs, outputs and matrices by files."""

import re
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from helpers import CHORD_JOB, refused, write_matrices

import hpcred as package
from hpcred.cli.main import run


def replaced(old, new):
    assert old in CHORD_JOB
    Path("job.toml").write_text(CHORD_JOB.replace(old, new))


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
        ("[1, 7, 14]", "[1, 7]", r"frame.nodes: found \[1, 7\], expected \[a whole number"),
        ('"yxz"', '"zyx"', "leave a rotation free"),
        ('"yxz"', '"yyz"', "expected an order of x, y and z"),
        ('[[20, "z"]]', '[[20, "w"]]', "inputs: found the direction 'w', expected one of x, y, z"),
        ('[[20, "z"]]', '"20:z"', r"inputs: found '20:z', expected a list such as \[\[20, 'z'\]\]"),
        ("[frame]", "[adaptive]\nseconds = 60\n[frame]", "adaptive: found limits of a search, but no tolerance"),
        ('[[20, "z"]]', '[["crank", "z"]]', "'crank' is no interface of model.h5; it has none; the job declares them"),
        ('[[20, "z"]]', '[[99, "all"]]', "node 99 does not exist in model.h5; its nodes are numbered 1 to 20"),
        (
            '[frame]\nkind = "chord"\nnodes = [1, 7, 14]\naxes = "yxz"',
            'frame = "chord"',
            r"frame: found 'chord', expected a table, such as \{kind = 'chord'\}",
        ),
        ('[[20, "z"]]', "[121]", "dof 121 does not exist in model.h5; its dofs are numbered 1 to 120"),
        ("order = 1", "order = 200", "basis: 201 vectors asked for, but model.h5 has only 114"),
        ('kind = "krylov"\nfrequency = 100.0\norder = 1', 'kind = "modes"\ncount = 115', "115 elastic modes asked"),
        ('"model.h5"', '"missing.h5"', "missing.h5: no such file"),
        ('"model.h5"', '"job.toml"', "job.toml: found no HDF5 file, expected one of format 'hpcred-model'"),
        ("[frame]", 'output = "nowhere/r.h5"\n[frame]', "the folder nowhere does not exist"),
        ("[frame]", 'output = "/proc/r.h5"\n[frame]', "cannot be written"),
        ("[frame]", '[damping]\nkind = "given"\n[frame]', "needs a damping matrix"),
        ("[frame]", '[damping]\nkind = "rayleigh"\nalpha = -1.0\n[frame]', "neither may be negative"),
        ('kind = "chord"\nnodes = [1, 7, 14]\naxes = "yxz"', 'kind = "tangent"\nnode = 21', "node 21 does not exist"),
        ('[frame]\nkind = "chord"\nnodes = [1, 7, 14]\naxes = "yxz"', "", None),
        ("frequency", "frequency =", "not a TOML file"),
        ("[frame]", '[damping]\nkind = "structural"\nloss_factor = -0.1\n[frame]', "loss_factor: found -0.1"),
        ("[frame]", '[damping]\nkind = "modal"\nratio = -0.1\n[frame]', "damping.ratio: found -0.1, expected 0"),
        ("[frame]", '[damping]\nkind = "modal"\n[frame]', "exactly one of ratio, ratios and table"),
        ("[frame]", '[damping]\nkind = "caughey"\ncoefficients = []\n[frame]', "at least one number"),
        ("[frame]", '[solver]\nkind = "auto"\n[frame]', "it is now kind 'direct' with unfit = 'multigrid'"),
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
def test_a_bad_job_is_refused(linkage_folder, capsys, old, new, says):
    replaced(old, new)
    if says is None:  # a free body at 100 Hz is a fair problem; at 0 Hz it is not
        Path("job.toml").write_text(Path("job.toml").read_text().replace("100.0", "0.0"))
        says = "can move freely; take frame kind 'buckens'"
    assert re.search(says, refused(capsys, "reduce", "job.toml"))


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
    a, b = (package.read_result(f"{name}.h5").reduced for name in "ab")
    assert np.allclose(a.transfer_function(0.3j), b.transfer_function(0.3j), rtol=1e-12)
    assert a.input_names == ("B.mtx:1", "B.mtx:2") and b.input_names == ("dof 4", "dof 1")


def test_all_directions_of_an_interface_or_a_node_are_named_at_once(linkage_folder):
    hub = '[[interface]]\nname = "hub"\nnodes = [1, 7, 14]\n'
    Path("job.toml").write_text(CHORD_JOB.replace('[[20, "z"]]', '[["hub", "all"], [20, "all"], [19, "z"]]') + hub)
    assert run(["reduce", "job.toml"]) == 0
    names = package.read_result("result.h5").reduced.input_names
    directions = ("x", "y", "z", "rx", "ry", "rz")
    assert names == (*(f"{node}:{name}" for node in ("hub", 20) for name in directions), "19:z")


@pytest.mark.mpi
def test_all_directions_of_a_node_are_those_that_it_has():
    with package.solid((2, 1, 1), clamped=False) as model, model.with_inputs([(3, "all"), (1, "y")]) as loaded:
        assert loaded.input_names == ("3:x", "3:y", "3:z", "1:y")


def test_an_output_matrix_of_another_size_is_refused(linkage_folder, capsys):
    scipy.io.mmwrite("C.mtx", np.eye(3, 119))
    replaced("[frame]", 'outputs = "C.mtx"\n[frame]')
    assert "C.mtx: found 3 x 119, expected 120 columns" in refused(capsys, "reduce", "job.toml")


def test_folders_in_a_job_are_relative_to_it(tmp_path, monkeypatch):
    (tmp_path / "jobs/factors").mkdir(parents=True)
    (tmp_path / "jobs/job.toml").write_text(CHORD_JOB.replace("[frame]", 'out_of_core = "factors"\n[frame]'))
    monkeypatch.chdir(tmp_path)
    job = package.read_job("jobs/job.toml")
    assert Path(job.factoring.out_of_core).resolve() == (tmp_path / "jobs/factors").resolve()
    assert Path(job.model) == Path("jobs/model.h5")


@pytest.mark.parametrize(
    "basis, damping, scalar",
    [
        ('kind = "krylov"\nfrequency = 100.0', "", "real"),
        ('kind = "krylov"\nfrequency = 100.0\ndecay = 3.0', "", "complex"),
        ('kind = "second_order_krylov"\nfrequency = 100.0', "", "real"),
        ('kind = "second_order_krylov"\nfrequency = 100.0', '[damping]\nkind = "given"\n', "complex"),
        ('kind = "second_order_krylov"\ndecay = 100.0', '[damping]\nkind = "given"\n', "real"),
    ],
)
def test_the_build_that_fits_is_known_from_the_job(linkage_folder, basis, damping, scalar):
    Path("job.toml").write_text(CHORD_JOB.replace('kind = "krylov"\nfrequency = 100.0', basis) + damping)
    assert package.read_job("job.toml").preferred_scalar == scalar


def test_the_build_that_fits_is_taken(hpcred, tmp_path):
    from hpcred.parallel import startup

    if len(startup.debian_builds()) < 2 or not startup.can_choose():
        pytest.skip("only one PETSc build on this machine")
    package.write_model(tmp_path / "model.h5", package.linkage())
    (tmp_path / "job.toml").write_text(CHORD_JOB.replace("order = 1", "decay = 3.0"))
    run_ = hpcred("reduce", "job.toml")
    assert run_.returncode == 0 and "complex PETSc" in run_.stdout, run_.stderr
