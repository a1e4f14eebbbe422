"""Two runs at once on one output: one of them refuses; what dead runs left is removed."""

import fcntl
import os
import subprocess
import sys

import pytest
from launch import mpi_environment

import hpcred as package
from hpcred.cli.main import run
from hpcred.files import locks
from hpcred.files.hdf5 import writing
from hpcred.files.locks import HOST, lock, lock_name, temporary_name, unlock
from hpcred.parallel.failures import InputError, unfinished

HOLDER = """
import sys
from pathlib import Path
from hpcred.files.locks import lock
lock(Path(sys.argv[1]))
print("locked", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def other(tmp_path):
    """Another process that is about to write a.h5."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path / "a.h5")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "locked\n"
    yield process
    process.kill()
    process.communicate()


def test_the_second_run_is_refused(other, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    assert run(["example", "linkage", "-o", "a.h5"]) == locks.Taken.exit_status
    said = capsys.readouterr().err
    assert f"output a.h5: another run is about to write it (process {other.pid} on {HOST}); wait for its end" in said
    assert sorted(tmp_path.iterdir()) == before
    assert run(["example", "linkage", "-o", "b.h5"]) == 0


def test_the_lock_of_a_run_that_was_killed_is_none(other, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    other.kill()
    other.wait()
    assert lock_name(tmp_path / "a.h5").exists()
    temporary_name(tmp_path / "a.h5", other.pid).touch()
    (tmp_path / f"{temporary_name(tmp_path / 'a.h5', other.pid)}.h5").touch()
    mine = temporary_name(tmp_path / "a.h5", os.getppid())  # of a process that lives
    elsewhere = temporary_name(tmp_path / "a.h5", other.pid, "elsewhere")
    for path in (mine, elsewhere):
        path.touch()
    assert run(["example", "linkage", "-o", "a.h5"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["a.h5", mine.name, elsewhere.name])


def test_a_lock_is_given_back_however_a_command_ends(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "job.toml").write_text('model = "missing.h5"\n[[basis]]\nkind = "modes"\ncount = 3\n')
    assert run(["reduce", "job.toml", "--json", "r.json"]) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["job.toml"]
    assert not locks._held


def test_a_workflow_that_fails_gives_its_locks_back(tmp_path, monkeypatch):
    """In a Python session that goes on, others may write the output."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "job.toml").write_text('model = "missing.h5"\n[[basis]]\nkind = "modes"\ncount = 3\n')
    with pytest.raises(InputError, match="missing.h5"):
        package.reduce_job("job.toml")
    assert not locks._held and not unfinished
    assert [path.name for path in tmp_path.iterdir()] == ["job.toml"]


@pytest.mark.slow
def test_two_runs_at_once(linkage_folder):
    """Five times two on one output: each ends with 0 or is refused, and the result is whole."""
    refused = 0
    for number in range(5):
        both = [
            subprocess.Popen([sys.executable, "-m", "hpcred", "reduce", "job.toml"], stderr=subprocess.PIPE,
                             stdout=subprocess.DEVNULL, text=True, env=mpi_environment())
            for _ in range(2)
        ]  # fmt: skip
        for process in both:
            said = process.communicate(timeout=120)[1]
            taken = process.returncode == locks.Taken.exit_status
            assert process.returncode == 0 or (taken and "another run is about to write" in said)
            refused += taken
        assert 0 in {process.returncode for process in both}
        assert package.verify_file("result.h5"), number
        assert sorted(path.name for path in linkage_folder.iterdir()) == ["job.toml", "model.h5", "result.h5"]
    assert refused


def test_a_file_system_without_locks(tmp_path, monkeypatch, comm):
    def no_locks(*_):
        raise OSError(37, "No locks available")

    monkeypatch.setattr(fcntl, "flock", no_locks)
    with writing(tmp_path / "a.h5", comm) as file:
        file.attribute("format", "test")
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def test_a_host_whose_name_begins_alike_is_another_one(tmp_path):
    """Its temporary files stay, whatever the numbers in its name."""
    path = tmp_path / "a.h5"
    others = [temporary_name(path, 2**22 - 1, f"{HOST}{tail}") for tail in ("-1", "-1-2", "-1.foo", "1", ".h5")]
    others += [temporary_name(path, f"{2**22 - 1}-2"), temporary_name(path, "9" * 30)]
    mine = [temporary_name(path, 2**22 - 1), temporary_name(path, f"{2**22 - 1}.h5")]
    for other in (*others, *mine):
        other.touch()
    lock(path)
    unlock(path)
    assert sorted(tmp_path.iterdir()) == sorted(others)


def test_hosts_that_differ_have_names_that_differ():
    long = "n" * 60
    hosts = ["a", "a-1", "A", "a.b", "a/b", "a b", long, f"{long}1", f"{long}2", "\udcff", "ü"]
    found = [locks.host_in_names(host) for host in hosts]
    assert len(set(found)) == len(hosts) and max(map(len, found)) <= 40
    assert not set("".join(found)) & set("/ ")


@pytest.mark.parametrize("content", ["notes\n", "process 1 on here\nnotes\n", "process 1 on " + "x" * 400])
def test_a_file_that_is_no_lock_is_refused(tmp_path, content):
    """A file of the user with the name of a lock is neither emptied nor removed."""
    own = lock_name(tmp_path / "a.h5")
    own.write_text(content)
    with pytest.raises(InputError, match="which no run wrote and which has the name of its lock"):
        lock(tmp_path / "a.h5")
    assert own.read_text() == content


def test_a_lock_with_another_name_is_refused(tmp_path):
    """Others may lay a second name of an empty file of the user."""
    (tmp_path / "mine").touch()
    os.link(tmp_path / "mine", lock_name(tmp_path / "a.h5"))
    with pytest.raises(InputError, match="which no run wrote"):
        lock(tmp_path / "a.h5")
    assert (tmp_path / "mine").read_bytes() == b""


def test_a_pipe_is_neither_a_lock_nor_waited_for(tmp_path):
    os.mkfifo(lock_name(tmp_path / "a.h5"))
    with pytest.raises(InputError, match="cannot be opened .this is a pipe or a device."):
        lock(tmp_path / "a.h5")


def test_a_name_with_signs_of_patterns(tmp_path):
    path = tmp_path / "a[1]*.h5"
    temporary_name(path, 2**22 - 1).touch()
    lock(path)
    with pytest.raises(InputError, match="another run"), monkey_other_process():
        lock(path)
    unlock(path)
    assert not list(tmp_path.iterdir())


class monkey_other_process:
    """As if this process did not know what it has locked."""

    def __enter__(self):
        self.held = dict(locks._held)
        locks._held.clear()

    def __exit__(self, *_):
        locks._held.update(self.held)
