"""Folders and several outputs: nothing of the user goes, and an error leaves older ones and no new ones."""

import os
from pathlib import Path

import pytest

from hpcred.files import folders
from hpcred.files.folders import atomic_folder, folder_for
from hpcred.files.hdf5 import atomic_output
from hpcred.files.locks import HOST, temporary_name
from hpcred.files.outputs import keep_files
from hpcred.files.room import NotWritten
from hpcred.files.temporary import folder_of_all
from hpcred.files.together import rescued, together
from hpcred.parallel.failures import ComputationError, InputError, agreed, unfinished

GONE = 2**22 - 1  # the number of no process


def is_own(path):
    return path.suffix == ".own"


def write(folder, comm, text="new", fails=None):
    with atomic_folder(folder, comm, is_own) as made:
        with agreed(comm):
            if comm.rank == 0:
                (made / f"{text}.own").write_text(text)
        if fails is not None:
            raise fails


def contents(folder, comm):
    comm.Barrier()
    found = {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*") if path.is_file()}
    comm.Barrier()
    return found


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("exchanges", [True, False])
def test_an_older_folder_is_replaced_or_stays(folder, comm, monkeypatch, exchanges):
    """Also where the file system does not exchange names at once."""
    if not exchanges:
        monkeypatch.setattr(folders, "_libc", object())
    write(folder / "out", comm, "old")
    assert contents(folder, comm) == {"out/old.own": "old"}
    with pytest.raises(ComputationError, match="no"):
        write(folder / "out", comm, fails=ComputationError("no"))
    assert contents(folder, comm) == {"out/old.own": "old"}
    write(folder / "out", comm)
    assert contents(folder, comm) == {"out/new.own": "new"}
    assert [path.name for path in folder.iterdir()] == ["out"] and not unfinished


@pytest.mark.mpi(ranks=(1, 2))
def test_the_folder_is_put_back_where_the_file_beside_it_fails(folder, comm, monkeypatch):
    write(folder / "out", comm, "old")

    def refused(*_):
        raise OSError(5, "Input/output error")

    with pytest.raises(NotWritten, match=r"x\.txt: cannot be written \(Input/output error\)"), together(comm):
        write(folder / "out", comm)
        with atomic_output(folder / "x.txt", comm) as temporary, agreed(comm):
            if comm.rank == 0:
                temporary.write_text("x")
        comm.Barrier()
        monkeypatch.setattr(os, "replace", refused)
    assert contents(folder, comm) == {"out/old.own": "old"}
    assert [path.name for path in folder.iterdir()] == ["out"] and not unfinished


def test_what_is_not_ours_is_refused_before_anything_is_written(tmp_path, comm):
    out, away = tmp_path / "out", tmp_path / "away"
    for make in (lambda: (out / "thesis.txt").write_text("years"), lambda: (out / "deep.own").mkdir(),
                 lambda: (out / "link.own").symlink_to(tmp_path)):  # fmt: skip
        out.mkdir()
        (out / "a.own").touch()
        make()
        before = sorted(out.iterdir())
        with pytest.raises(InputError, match="in this folder, which is not replaced with it; move it"):
            write(out, comm)
        assert sorted(out.iterdir()) == before
        for path in before:
            path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink()
        out.rmdir()
    away.mkdir()
    for make in (lambda: out.symlink_to(away), out.touch, lambda: os.mkfifo(out)):
        make()
        with pytest.raises(InputError, match="found a file or a link there, expected a folder"):
            write(out, comm)
        out.unlink()
    assert list(tmp_path.iterdir()) == [away]


def test_files_that_come_meanwhile_are_not_lost(tmp_path, comm):
    write(tmp_path / "out", comm, "old")
    with pytest.raises(InputError, match=r"found 'mine\.txt'"), atomic_folder(tmp_path / "out", comm, is_own):
        (tmp_path / "out" / "mine.txt").write_text("mine")
    assert contents(tmp_path, comm) == {"out/old.own": "old", "out/mine.txt": "mine"}


def test_keep_leaves_folders_and_files(tmp_path, comm):
    write(tmp_path / "out", comm, "old")
    (tmp_path / "a.json").write_text("[]\n")
    keep_files(True)
    try:
        with pytest.raises(InputError, match="--keep leaves it"):
            write(tmp_path / "out", comm)
        with pytest.raises(InputError, match="--keep leaves it"), atomic_output(tmp_path / "a.json", comm) as temporary:
            temporary.write_text("{}\n")
    finally:
        keep_files(False)
    assert contents(tmp_path, comm) == {"out/old.own": "old", "a.json": "[]\n"}


def test_what_killed_runs_left_goes_but_for_files_of_others(tmp_path, comm):
    left = [temporary_name(tmp_path / "out", GONE), Path(f"{temporary_name(tmp_path / 'out', GONE)}.old"),
            temporary_name(tmp_path / "out", GONE, "elsewhere"),
            temporary_name(tmp_path / "out", os.getppid())]  # fmt: skip
    for path in left:
        path.mkdir()
        (path / "a.own").touch()
    (left[1] / "thesis.txt").write_text("years")
    write(tmp_path / "out", comm)
    assert [path.exists() for path in left] == [False, True, True, True]
    assert [path.name for path in left[1].iterdir()] == ["thesis.txt"]


@pytest.mark.mpi(ranks=(1, 2))
def test_new_folders_go_after_an_error_unless_something_is_in_them(folder, comm):
    with pytest.raises(ComputationError), folder_for(folder / "a" / "b", comm):
        raise ComputationError("no")
    comm.Barrier()
    assert not list(folder.iterdir())
    comm.Barrier()
    with folder_for(folder / "a", comm):
        pass
    with pytest.raises(ComputationError), folder_for(folder / "a" / "b", comm):
        raise ComputationError("no")
    comm.Barrier()
    assert [path.name for path in folder.rglob("*")] == ["a"]
    comm.Barrier()
    if comm.rank == 0:
        (folder / "file").touch()
    comm.Barrier()
    with pytest.raises(InputError, match=r"^output .*file/b: cannot be created \(Not a directory\)"):
        folder_for(folder / "file" / "b", comm, "output ").__enter__()


@pytest.mark.mpi(ranks=(1, 2))
def test_outputs_appear_together_or_not_at_all(folder, comm, monkeypatch):
    def text(name, content):
        with atomic_output(folder / name, comm) as temporary, agreed(comm):
            if comm.rank == 0:
                temporary.write_text(content)

    text("a.json", "[\n1]")
    with together(comm):
        text("a.json", "[\n2]")
        text("b.json", "[\n2]")
        assert contents(folder, comm)["a.json"] == "[\n1]" and not (folder / "b.json").exists()
    assert contents(folder, comm) == {"a.json": "[\n2]", "b.json": "[\n2]"}
    with pytest.raises(ComputationError, match="^no$"), together(comm):
        text("a.json", "[\n3]")
        text("c.json", "[\n3]")
        raise ComputationError("no")
    assert contents(folder, comm) == {"a.json": "[\n2]", "b.json": "[\n2]"} and not unfinished


@pytest.mark.mpi(ranks=(1, 2))
def test_what_took_long_is_kept_elsewhere_where_a_later_output_fails(folder, comm, monkeypatch):
    if comm.rank == 0:
        (folder / "rescue").mkdir()
        (folder / "rescue" / "a.txt").symlink_to(folder / "victim")
    comm.Barrier()
    monkeypatch.setenv("HPCRED_RESCUE_DIR", str(folder / "rescue"))

    def write(path):
        with atomic_output(path, comm) as temporary, agreed(comm):
            if comm.rank == 0:
                temporary.write_text("long")

    with pytest.raises(NotWritten, match=r"^full; what was written of a\.txt is in .*rescue/a-1\.txt$"), together(comm):
        rescued(write, folder / "a.txt", comm)
        raise NotWritten("full")
    assert contents(folder, comm) == {"rescue/a-1.txt": "long"}


@pytest.mark.mpi(ranks=(1, 2))
def test_a_temporary_folder_of_all(folder, comm):
    """What a killed process left is removed; what is of a living one, of another host or of the user is not."""
    stay = [f".hpcred-{HOST}-{os.getpid()}-abcdefgh", f".hpcred-elsewhere-{GONE}-abcdefgh",
            f".hpcred-{HOST}-{GONE}-mine", f".hpcred-{HOST}-{GONE}-alinkalk"]  # fmt: skip
    if comm.rank == 0:
        for name in (*stay[:3], f".hpcred-{HOST}-{GONE}-abcdefgh"):
            (folder / name).mkdir()
            (folder / name / "file").write_text(name)
        (folder / stay[3]).symlink_to(folder / stay[2])
    comm.Barrier()
    stay = comm.bcast(stay)
    with folder_of_all(comm, folder) as made:
        (made / str(comm.rank)).write_text("here")
        comm.Barrier()
        assert len(os.listdir(made)) == comm.size and made in unfinished
        assert sorted(os.listdir(folder)) == sorted([*stay, made.name])
        comm.Barrier()
    assert made not in unfinished
    comm.Barrier()
    assert sorted(os.listdir(folder)) == sorted(stay)
    with pytest.raises(ComputationError, match="no"), folder_of_all(comm, folder):
        raise ComputationError("no")
    comm.Barrier()
    assert sorted(os.listdir(folder)) == sorted(stay)
