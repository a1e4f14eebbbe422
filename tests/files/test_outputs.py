"""Nothing that a run reads, and no file of another kind, is ever written over."""

import json
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse
from helpers import CHORD_JOB, SIMULATION

import hpcred as package
from hpcred.cli.main import run
from hpcred.files.hdf5 import writing
from hpcred.files.outputs import check_outputs, check_room, hdf5_kind, kind_of
from hpcred.parallel.failures import ComputationError, InputError

RAYLEIGH = CHORD_JOB.replace("[[basis]]", '[damping]\nkind = "rayleigh"\nalpha = 2.0\n[[basis]]', 1)



@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with one of everything."""
    folder, before = tmp_path_factory.mktemp("made"), os.getcwd()
    os.chdir(folder)
    try:
        with package.linkage() as model:
            package.write_model("model.h5", model)
        for key in "KM":
            scipy.io.mmwrite(f"{key}.mtx", scipy.sparse.coo_matrix(np.diag([2.0, 2, 2, 1])))
        scipy.sparse.save_npz("matrix.npz", scipy.sparse.eye(4, format="csr"))
        scipy.io.savemat("matrix.mat", {"K": np.eye(4), "M": np.eye(4)})
        scipy.io.mmwrite("B.mtx", scipy.sparse.coo_matrix(np.eye(120)[:, :1]))
        Path("job.toml").write_text(RAYLEIGH)
        Path("sim.toml").write_text(SIMULATION.replace("end = 0.05", "end = 0.001").replace("steps = 20", "steps = 2"))
        for line in (
            "reduce job.toml --json r.json", "simulate sim.toml", "evaluate result.h5 --points 3 -o e.csv",
            "response model.h5 --frame buckens --frequencies 10,20 -o f.csv",
            "export result.h5", "export result.h5 --format npz", "export result.h5 --format matlab",
            "export result.h5 --format vtk", "export result.h5 --format uff",
        ):  # fmt: skip
            assert run(["--quiet", *line.split()]) == 0, line
        Path("readonly.h5").write_bytes(Path("result.h5").read_bytes())
        Path("readonly.h5").chmod(0o444)
        os.symlink("model.h5", "link.h5")
        os.link("job.toml", "hard.h5")
        os.mkfifo("pipe.h5")
        os.mkdir("folder.h5")
    finally:
        os.chdir(before)
    return folder


KINDS = {
    "model.h5": "'hpcred-model'", "result.h5": "'hpcred-result'", "simulation.h5": "'hpcred-simulation'",
    "simulation.csv": "simulation", "e.csv": "responses", "f.csv": "responses", "r.json": "JSON",
    "simulation.png": "PNG", "result.SID_FEM": "SID", "result.npz": "zip archive of", "result.mat": "MATLAB",
    "result.vtu": "VTK", "result.uff": "universal", "K.mtx": "Matrix Market", "job.toml": "another kind",
}  # fmt: skip


@pytest.mark.parametrize("name", KINDS)
def test_kinds(made, name):
    assert KINDS[name] in kind_of(made / name)


def snapshot(folder):
    return {path.name: (path.read_bytes() if path.is_file() else path.stat().st_mode, path.lstat().st_mode)
            for path in folder.iterdir()}  # fmt: skip


@pytest.fixture
def folder(made, tmp_path, monkeypatch):
    """The same files again; what a refused command changes is seen."""
    for path in made.iterdir():
        if path.is_fifo():
            os.mkfifo(tmp_path / path.name)
        elif path.is_symlink():
            os.symlink(os.readlink(path), tmp_path / path.name)
        elif path.is_dir():
            os.mkdir(tmp_path / path.name)
        elif path.name != "hard.h5":
            shutil.copy2(path, tmp_path / path.name)
    os.link(tmp_path / "job.toml", tmp_path / "hard.h5")
    monkeypatch.chdir(tmp_path)
    return tmp_path


READS, KIND = "which this run reads", "which is not replaced by"


@pytest.mark.parametrize(
    "line, says",
    [
        ("reduce job.toml --set output=model.h5", READS),
        ("reduce job.toml --set output=job.toml", READS),
        ("reduce job.toml --set output=./x/../model.h5", READS),
        ("reduce job.toml --set output=link.h5", READS),
        ("reduce job.toml --set output=hard.h5", READS),
        ("reduce job.toml --set inputs=B.mtx --set output=B.mtx", READS),
        ("reduce job.toml --set output=sim.toml", KIND),
        ("reduce job.toml --set output=simulation.h5", KIND),
        ("reduce job.toml --set output=readonly.h5", "read-only"),
        ("reduce job.toml --set output=pipe.h5", "a pipe or a device"),
        ("reduce job.toml --set output=/dev/null", "a pipe or a device"),
        ("reduce job.toml --set output=folder.h5", "this is a folder"),
        ("reduce job.toml --set output=/", "this is a folder"),
        ("convert -K K.mtx -M M.mtx -o /", "this is a folder"),
        ("example linkage -o /", "this is a folder"),
        ("export result.h5 -o /", "this is a folder"),
        ("report result.h5 -o /", "this is a folder"),
        ("modes model.h5 --figure .png", "ends in .png"),
        ("reduce job.toml --json model.h5", KIND),
        ("reduce job.toml --json job.toml", KIND),
        ("info model.h5 --json model.h5", KIND),
        ("info model.h5 --json result.SID_FEM", KIND),
        ("evaluate result.h5 -o result.h5", READS),
        ("evaluate result.h5 --full model.h5 -o link.h5", READS),
        ("evaluate result.h5 -o simulation.csv", KIND),
        ("evaluate result.h5 -o simulation.h5", KIND),
        ("response model.h5 --band 0,9 --frame buckens -o model.h5", READS),
        ("response model.h5 --band 0,9 --frame buckens -o simulation.csv", KIND),
        ("response model.h5 --band 0,9 --inputs 1:x -o new.csv --figure link.h5", "ends in .png"),
        ("modes model.h5 --figure link.png", KIND),
        ("export result.h5 -o result.h5", READS),
        ("export result.h5 -o f.csv", KIND),
        ("export result.h5 --format npz -o result.mat", "found a name that ends in .mat, expected .npz"),
        ("convert -K K.mtx -M M.mtx -o K.mtx", READS),
        ("convert -K K.mtx -M M.mtx x/../M.mtx", READS),
        ("convert -K K.mtx -M M.mtx job.toml", KIND),
        ("export result.h5 --format npz -o matrix.npz", KIND),
        ("export result.h5 --format matlab -o matrix.mat", KIND),
        ("convert -K K.mtx -M M.mtx result.h5", KIND),
        ("simulate sim.toml --set output=sim.toml", READS),
        ("simulate sim.toml --set output=result.h5", "which is the body"),
        ("simulate sim.toml --set output=x/../result.h5", READS),
        ("simulate sim.toml --set output=f.h5", KIND),
        ("example linkage -o result.h5", KIND),
        ("example linkage -o K.mtx", KIND),
        ("convert -K K.mtx -M M.mtx " + 300 * "n" + ".h5", "name too long"),
        ("convert -K K.mtx -M M.mtx " + 250 * "n" + ".h5", "name too long"),
        ("reduce job.toml --set output=new.h5 --json new.h5", "writes it twice"),
        ("evaluate result.h5 --points 3 -o x/../new.csv --json new.csv", "writes it twice"),
        ("response model.h5 --frequencies 10 -o new.csv --json new.csv", "writes it twice"),
        ("--keep reduce job.toml", "--keep leaves it"),
        ("reduce job.toml --set output=new.h5 --json r.json --keep", "--keep leaves it"),
        ("export result.h5 --keep", "--keep leaves it"),
        ("--keep example linkage -o model.h5", "--keep leaves it"),
    ],
)
def test_what_must_not_be_written_over_is_refused(folder, capsys, line, says):
    Path("x").mkdir()
    shutil.copy("K.mtx", "link.png")
    before = snapshot(folder)
    assert run(line.split()) == 2
    message = capsys.readouterr().err
    assert says.lower() in message.lower(), message
    assert message.startswith("hpcred: error: ") and message.count("\n") == 1
    assert snapshot(folder) == before


@pytest.mark.parametrize(
    "line, name",
    [
        ("reduce job.toml", "result.h5"), ("reduce job.toml --set output=new.h5 --json r.json", "r.json"),
        ("simulate sim.toml", "simulation.csv"), ("export result.h5", "result.SID_FEM"),
        ("evaluate result.h5 --points 3 -o e.csv", "e.csv"), ("example linkage -o model.h5", "model.h5"),
    ],
)  # fmt: skip
def test_a_file_of_the_same_kind_is_replaced_and_said(folder, capsys, line, name):
    before = Path(name).stat().st_ino
    assert run(line.split()) == 0
    assert re.search(f"{name} (exists and will be|existed and was) replaced\n", capsys.readouterr().err)
    assert Path(name).stat().st_ino != before
    assert run([*line.split(), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_nothing_is_said_to_be_replaced_that_is_not(folder, capsys):
    assert run(["export", "result.h5", "--format", "png", "-o", "a.png"]) == 0
    before = Path("a.png").stat().st_ino
    capsys.readouterr()
    assert run(["export", "result.h5", "--format", "png", "-o", "a.png", "--modes", "99"]) == 2
    message = capsys.readouterr().err
    assert "modes: found 99, expected numbers from 1 to" in message and "replaced" not in message
    assert Path("a.png").stat().st_ino == before


def test_what_is_replaced_is_said_once_the_input_was_read(folder, capsys):
    (folder / "result.h5").rename(folder / "kept.h5")
    for setting, status in (("inputs=[]", 2), ('inputs=[[999, "x"]]', 2), ("basis.0.order=1", 0)):
        assert run(["reduce", "job.toml", "--set", "output=kept.h5", "--set", setting]) == status
        assert ("kept.h5 exists and will be replaced" in capsys.readouterr().err) == (status == 0)


def test_links_are_followed(folder, capsys):
    """A result goes where the link points, which stays a link; also to a file that is not there yet."""
    os.symlink(folder / "folder.h5" / "far.h5", "near.h5")
    for _ in range(2):
        assert run(["reduce", "job.toml", "--set", "output=near.h5"]) == 0
        assert Path("near.h5").is_symlink() and kind_of("folder.h5/far.h5") == hdf5_kind("hpcred-result")
    assert "near.h5 exists and will be replaced" in capsys.readouterr().err
    assert os.listdir("folder.h5") == ["far.h5"]


def test_an_empty_file_may_become_anything(folder):
    Path("new.h5").touch()
    assert run(["example", "linkage", "-o", "new.h5", "--quiet"]) == 0


@pytest.mark.mpi
def test_the_rule_holds_on_all_ranks_and_for_the_library(comm, folder_of_all):
    """Also where a writer is called by itself: after writing, what was there is still there."""
    model, job = folder_of_all / "model.h5", folder_of_all / "job.toml"
    with package.linkage(comm) as linkage:
        package.write_model(model, linkage)
        if comm.rank == 0:
            job.write_text("x = 1\n")
        comm.Barrier()
        for name, reads, says in (("result", (), KIND), ("model", [model], READS)):
            with pytest.raises(InputError, match=says):
                check_outputs({model: hdf5_kind(f"hpcred-{name}")}, comm, reads)
        with pytest.raises(InputError, match=KIND), writing(model, comm) as file:
            file.attribute("format", "hpcred-result")
        with pytest.raises(InputError, match=KIND):
            package.write_model(job, linkage)
    comm.Barrier()
    assert sorted(path.name for path in folder_of_all.iterdir()) == ["job.toml", "model.h5"]
    assert kind_of(model) == hdf5_kind("hpcred-model") and job.read_text() == "x = 1\n"
    comm.Barrier()


@pytest.fixture
def folder_of_all(comm, tmp_path_factory):
    path = Path(comm.bcast(str(tmp_path_factory.mktemp("all")) if comm.rank == 0 else None))
    yield path
    comm.Barrier()


def test_room_is_looked_for_before_the_work(folder, capsys, monkeypatch):
    check_room("result.h5", 1000)
    with pytest.raises(ComputationError, match=r"it needs 1000000000000.0 MB, and .* are free in"):
        check_room("result.h5", 10**18)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: shutil._ntuple_diskusage(10**6, 10**6, 1000))
    before = Path("result.h5").read_bytes()
    assert run(["reduce", "job.toml"]) == 74
    assert "1000 bytes are free" in capsys.readouterr().err and Path("result.h5").read_bytes() == before
    assert json.loads(Path("r.json").read_text())
