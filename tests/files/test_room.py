"""A full disk: one sentence with sizes, older outputs whole, no litter, and results in another place."""

import os
import resource
import shutil
import subprocess
import sys
from contextlib import contextmanager, suppress

import numpy as np
import pytest
from helpers import MODES_JOB, SIMULATION
from launch import mpi_environment

import hpcred as package
from hpcred.cli.main import run as command
from hpcred.files.hdf5 import atomic_output, writing
from hpcred.files.room import BASE, NoRoom, rescue_places
from hpcred.files.together import rescued
from hpcred.parallel.failures import agreed

MB = 10**6


@pytest.fixture
def full_disk(tmp_path):
    """A function that makes a disk of so many bytes: a mounted one where that is allowed."""
    mounted = []

    def make(size):
        place = tmp_path / "disk"
        place.mkdir()
        command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(place)]
        if subprocess.run(command, capture_output=True).returncode:
            pytest.skip("mounting a small disk needs root")
        mounted.append(place)
        return place

    yield make
    for place in mounted:
        subprocess.run(["umount", "--lazy", place], check=True)  # matplotlib keeps a .pdf open that it could not write


@contextmanager
def small_files(size):
    """No file may be larger in the block."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def hpcred(folder, *arguments, ranks=1, **environment):
    launcher = ["mpiexec", "-n", str(ranks)] if ranks > 1 else []
    return subprocess.run(
        [*launcher, sys.executable, "-m", "hpcred", *arguments], cwd=folder, capture_output=True, text=True,
        timeout=120, env=mpi_environment(**environment),
    )  # fmt: skip


@pytest.mark.usefixtures("forked_commands")
@pytest.mark.parametrize("ranks", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_result_without_room_is_written_elsewhere(full_disk, tmp_path, ranks):
    disk = full_disk(1_500_000)
    with package.linkage() as model:
        package.write_model(tmp_path / "model.h5", model)
    (disk / "job.toml").write_text(MODES_JOB.replace('"model.h5"', f'"{tmp_path}/model.h5"'))
    (disk / "result.h5").write_bytes(b"")
    with open(disk / "filler", "wb") as file:
        file.write(bytes(1_100_000))
    before = sorted(path.name for path in disk.iterdir())
    (tmp_path / "rescue").mkdir()
    run = hpcred(disk, "reduce", "job.toml", "--quiet", ranks=ranks, HPCRED_RESCUE_DIR=str(tmp_path / "rescue"))
    said = [line for line in run.stderr.splitlines() if line.startswith("hpcred:")]
    assert len(said) == 1 and run.returncode == NoRoom.exit_status
    assert "result.h5: the disk is full: it needs 0." in said[0] and "are free in" in said[0]
    assert f"what was to be written is in {tmp_path}/rescue/result.h5" in said[0]
    assert sorted(path.name for path in disk.iterdir()) == before
    assert package.read_result(tmp_path / "rescue" / "result.h5").reduced.size == 6
    assert package.verify_file(tmp_path / "rescue" / "result.h5")


@pytest.mark.parametrize("left", [0, 5_000, BASE - 4096, BASE + 20_000, 400_000])
def test_any_room_is_enough_or_refused(full_disk, comm, left):
    """Room for nothing, for some of the datasets, or for all: never anything else than a whole file or a sentence."""
    disk = full_disk(2_000_000)
    (disk / "a.h5").write_text("")
    free = shutil.disk_usage(disk).free
    (disk / "filler").write_bytes(bytes(max(free - left, 0) // 4096 * 4096))
    try:
        with writing(disk / "a.h5", comm) as file:
            file.attribute("format", "test")
            for name in "abcdefgh":
                file.rows(name, np.ones(1000))
    except NoRoom as error:
        assert left < 400_000 and "the disk is full: it needs" in str(error)
        assert (disk / "a.h5").read_text() == ""
    else:
        assert left == 400_000
    assert sorted(path.name for path in disk.iterdir()) == ["a.h5", "filler"]


@pytest.mark.mpi(ranks=(1, 2))
def test_texts_without_room_are_refused_in_a_sentence(comm, folder):
    if comm.rank == 0:
        (folder / "a.csv").write_text("f_hz,old\n")
    comm.Barrier()
    with (
        small_files(1000),
        pytest.raises(NoRoom, match="a.csv: the disk is full: it needs more than 1000 bytes, and 1000 bytes are free"),
        atomic_output(folder / "a.csv", comm) as temporary,
        agreed(comm),
    ):
        if comm.rank == 0:
            temporary.write_text("f_hz,new\n" + "1" * 5000)
    comm.Barrier()
    assert [path.name for path in folder.iterdir()] == ["a.csv"]
    assert (folder / "a.csv").read_text() == "f_hz,old\n"


@pytest.mark.mpi(ranks=(1, 2))
def test_hdf5_within_a_limit_of_the_process(comm, folder):
    with (
        small_files(600_000),
        pytest.raises(NoRoom, match="it needs 1.1 MB, and 0.6 MB are free"),
        writing(folder / "a.h5", comm) as file,
    ):
        file.attribute("format", "test")
        file.rows("a", np.ones(100_000 // comm.size))
    comm.Barrier()
    assert not list(folder.iterdir())


def test_places_for_what_has_no_room(tmp_path, monkeypatch, comm):
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.delenv("HPCRED_RESCUE_DIR", raising=False)
    (tmp_path / "r.h5").touch()
    assert next(rescue_places("r.h5")) == tmp_path / "r-1.h5"
    assert not (tmp_path / "r-1.h5").exists()
    (tmp_path / "r-1.h5").symlink_to(tmp_path / "victim")  # laid by others
    assert next(rescue_places("r.h5")) == tmp_path / "r-2.h5"
    tried = []

    def write(path):
        tried.append(str(path))
        raise NoRoom(f"output {path}: no")

    with pytest.raises(NoRoom, match="^output r.h5: no$"):
        rescued(write, "r.h5", comm)
    assert len(tried) == 3 and os.path.dirname(tried[1]) == str(tmp_path)


# what is written at the end of the name
TEXTS = {
    "a.json": "evaluate result.h5 --frequencies 10,20 --json {}", "a.csv": "evaluate result.h5 --points 5 -o {}",
    "a.SID_FEM": "export result.h5 --format sid -o {}", "a.png": "export result.h5 --format png --modes 1 -o {}",
    "a.vtu": "export result.h5 --format vtk -o {}", "a.npz": "export result.h5 --format npz -o {}",
}  # fmt: skip
MORE = {
    **{f"a.{end}": f"export result.h5 --format {end} --modes 1 -o {{}}" for end in ("svg", "pdf", "gif", "webp")},
    **{f"{name}.{end}": f"export result.h5 --format {name} -o {{}}" for name, end in (
        ("matlab", "mat"), ("exudyn", "npz"), ("mbdyn", "fem"), ("mbsim", "hdf5"), ("statespace-mat", "mat"),
        ("fmu", "fmu"), ("uff", "uff"))},
    "a.h5": "evaluate result.h5 --points 5 -o {}", "b.h5": "example linkage -o {}", "r.html": "report result.h5 -o {}",
    "m.png": "modes model.h5 --count 8 --figure {}", "e.png": "evaluate result.h5 --points 5 --figure {}",
    "c.csv": "evaluate result.h5 other.h5 --full model.h5 --points 3 -o {}",
}  # fmt: skip


def fill(folder):
    """Leave no byte free."""
    with suppress(OSError), open(folder / "filler", "wb", buffering=0) as file:
        while True:
            file.write(bytes(4096))


@pytest.mark.parametrize("name", [*TEXTS, *(pytest.param(name, marks=pytest.mark.slow) for name in MORE)])
def test_every_output_without_room_is_refused_in_a_sentence(reduced_linkage, full_disk, monkeypatch, capsys, name):
    folder = reduced_linkage().parent
    disk = full_disk(4_000_000)
    monkeypatch.chdir(folder)
    monkeypatch.setenv("HPCRED_RESCUE_DIR", str(folder / "nowhere"))
    shutil.copy("result.h5", "other.h5")
    words = (TEXTS | MORE)[name].format(disk / name).split()
    assert command(words) == 0
    fill(disk)
    before = {path.name: path.read_bytes() for path in disk.iterdir()}
    others = sorted(folder.iterdir())
    capsys.readouterr()
    assert command(words) == NoRoom.exit_status
    said = [line for line in capsys.readouterr().err.splitlines() if line.startswith("hpcred:")]
    assert len(said) == 1 and f"output {disk}/" in said[0] and ": the disk is full: it needs " in said[0], said
    assert "are free in" in said[0] and "make room" in said[0]
    assert {path.name: path.read_bytes() for path in disk.iterdir()} == before
    assert sorted(folder.iterdir()) == others


@pytest.mark.slow
def test_files_of_a_simulation_without_room(reduced_linkage, full_disk, monkeypatch, capsys):
    """Of four outputs the first one has no room: no other is written, and the older ones stay."""
    folder = reduced_linkage().parent
    disk = full_disk(6_000_000)
    (folder / "sim.toml").write_text(SIMULATION.replace("end = 0.05", "end = 0.002").replace("steps = 20", "steps = 2"))
    monkeypatch.chdir(folder)
    monkeypatch.setenv("HPCRED_RESCUE_DIR", str(folder))
    words = ["simulate", "sim.toml", "--set", f"output='{disk}/s.h5'", "--set", "paraview=true"]
    assert command(words) == 0
    fill(disk)
    before = {path: path.read_bytes() for path in disk.rglob("*") if path.is_file()}
    assert command(words) == NoRoom.exit_status
    assert f"what was to be written is in {folder}/s.h5" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in disk.rglob("*") if path.is_file()} == before
    assert package.verify_file(folder / "s.h5")
