"""The command that finds bores, its lines for a job, and pictures of sets and of interfaces."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers import refused

import hpcred
from hpcred.cli.main import run
from hpcred.settings.job_file import read_job

JOB = """
model = "model.h5"
basis = [{kind = "modes", count = 2}]
frame = {kind = "buckens"}
inputs = ["bore1", ["bore2", "x"]]
"""


@pytest.fixture(scope="module")
def models(module_folder, comm):
    """A folder with a crank as model.h5, a solid, and beams, which have neither sets nor faces."""
    with hpcred.crank(900, comm) as rod, hpcred.solid((2, 2, 2), comm=comm) as solid, hpcred.linkage(comm) as beams:
        for name, model in (("model", rod), ("solid", solid), ("beams", beams)):
            hpcred.write_model(module_folder / f"{name}.h5", model)
    return module_folder


@pytest.fixture
def crank_folder(models, folder, comm, monkeypatch):
    """A copy of that folder, in which the test works."""
    if comm.rank == 0:
        shutil.copytree(models, folder, dirs_exist_ok=True)
    comm.Barrier()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def drawn(monkeypatch):
    """Names of sets and of reference nodes of the pictures that are asked for, on rank 0, in place of the pictures."""
    found = []
    monkeypatch.setattr("hpcred.workflows.set_figure.draw_sets", lambda path, surface, nodes, sets, marks, kind: (
        path.touch(), found.append(tuple([name for name, _ in pairs] for pairs in (sets, marks)))))  # fmt: skip
    return found


@pytest.mark.mpi(build="real")
@pytest.mark.costly
def test_what_bores_prints_is_a_job(crank_folder, comm, drawn, capsys):
    assert run(["bores", "model.h5", "--figure", "bores.png", "--json", "bores.json"]) == 0
    printed = comm.bcast(capsys.readouterr().out)
    report = json.loads(Path("bores.json").read_text())
    names = ["bore1", "bore2", "pin1", "pin2"]
    assert [row["name"] for row in report["bores"]] == names
    assert report["job"] in printed
    if comm.rank == 0:
        Path("job.toml").write_text(JOB + report["job"])
    comm.Barrier()
    job = read_job("job.toml")
    assert job.inputs == ("bore1", ("bore2", "x"))
    with hpcred.read_model("model.h5", comm) as model:
        bores = hpcred.find_bores(model)
        assert job.interface == tuple(item.interface() for item in bores)
        marked = model.with_interfaces(job.interface).interfaces
    assert [item.count for item in marked] == [len(item.nodes) for item in bores]
    assert run(["info", "job.toml", "--figure", "job.png", "--json", "job.json"]) == 0
    rows = json.loads(Path("job.json").read_text())["interfaces"]
    assert [(row["interface"], row["nodes"]) for row in rows] == [(item.name, item.count) for item in marked]
    assert np.allclose([[row[axis] for axis in "xyz"] for row in rows], [item.centre for item in bores])
    assert comm.bcast(drawn) == [(names, []), (names, names)]
    assert run(["reduce", "job.toml"]) == 0
    assert len(hpcred.read_result("result.h5", comm).reduced.input_names) == 7


@pytest.mark.mpi(build="real")
@pytest.mark.costly
def test_all_sets_of_a_model_are_drawn(crank_folder, comm, drawn):
    assert run(["info", "model.h5", "--figure", "sets.png"]) == 0
    assert comm.bcast(drawn) == [(["BIG_EYE", "SMALL_EYE"], [])] and Path("sets.png").exists()


@pytest.mark.mpi(build="real")
@pytest.mark.costly
def test_sets_of_a_model_are_drawn(crank_folder, comm):
    assert run(["info", "model.h5", "--figure", "one.svg", "--sets", "SMALL_EYE"]) == 0
    text = Path("one.svg").read_text()
    assert "SMALL_EYE: 33 nodes" in text and "BIG_EYE" not in text
    if comm.rank == 0:
        Path("beams.toml").write_text(
            'model = "beams.h5"\nbasis = [{kind = "modes", count = 8}]\n'
            '[[interface]]\nname = "end"\nnodes = [1]\nkind = "rigid"\n'
        )
    comm.Barrier()
    assert run(["info", "beams.toml", "--figure", "beams.svg"]) == 0
    assert "end: 1 nodes" in Path("beams.svg").read_text()


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["info", "model.h5", "--figure", "a.png", "--sets", "BIG_EYES"], "no set 'BIG_EYES' (did you mean 'BIG_EYE'"),
        (["info", "model.h5", "--sets", "BIG_EYE"], "--sets: belongs to --figure"),
        (["info", "model.h5", "--figure", "a.gif"], "a.gif: expected a name that ends in .png, .svg, .pdf"),
        (["info", "solid.h5", "--figure", "a.png"], "solid.h5 has no node sets to draw; `hpcred bores` finds"),
        (["info", "K.mtx", "--figure", "a.png"], "K.mtx is no model file and no job"),
        (["info", "model.h5", "--figure", "model.h5.png", "--verify"], "--verify: cannot be combined"),
        (["bores", "model.h5", "--turn", "-1"], "turn: found -1, expected degrees"),
        (["bores", "K.mtx"], "K.mtx"),
        (["bores", "beams.h5"], "beams.h5 has no elements with faces"),
    ],
)
def test_refused(models, monkeypatch, capsys, arguments, says):
    monkeypatch.chdir(models)
    Path("K.mtx").write_text("%%MatrixMarket matrix coordinate real general\n1 1 1\n1 1 1.0\n")
    assert says in refused(capsys, *arguments)
    assert not Path("a.png").exists()


def test_a_body_without_bores_says_so(models, monkeypatch, capsys):
    monkeypatch.chdir(models)
    assert run(["bores", "solid.h5"]) == 0
    assert "solid.h5: no cylinder of 120 degrees or more on its surface; --turn takes less" in capsys.readouterr().out


def test_holes_whose_nodes_have_no_row_are_said(crank_folder, comm, capsys):
    """As of a rigid body in another program."""
    with hpcred.read_model("model.h5", comm) as rod:
        kept = ~np.isin(rod.dofs.node, rod.sets["BIG_EYE"])
        rows = np.eye(kept.sum())
        less = hpcred.SecondOrderModel.from_scipy(rows, rows, dofs=rod.dofs.take(kept), elements=rod.elements)
        with less:
            hpcred.write_model("less.h5", less)
    assert run(["bores", "less.h5"]) == 0
    said = capsys.readouterr().out
    assert "faces of the surface are left out, since a node of theirs has no row" in said
    assert "0.012" in said and "0.025]" not in said
