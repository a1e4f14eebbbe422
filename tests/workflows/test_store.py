"""The store from the shell: kill -9, both builds, two runs at once; what `hpcred store` lists, checks and removes."""

import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from helpers import CHORD_JOB, refused
from launch import TWO_BUILDS, mpi_environment

from hpcred import PointStore
from hpcred.cli.main import run

JOB = CHORD_JOB + '[[basis]]\nkind = "krylov"\nfrequency = 200.0\n[[basis]]\nkind = "krylov"\nfrequency = 250.0\n'


def reduce(*arguments):
    """Factorisations of a reduction, and those saved."""
    assert run(["reduce", "job.toml", *arguments, "--json", "found.json"]) == 0
    found = json.loads(Path("found.json").read_text())
    return len(found["factorisations"]), found["factorisations_saved"], found


def arrays(name):
    with h5py.File(name, "r") as file:
        return {key: file[key][...] for key in ("reduced/K", "reduced/B", "basis/V")}


def reduce_and_die():
    """In a process of its own: after two entries of the store it kills itself."""
    save, saved = PointStore.save, []

    def mortal(*arguments):
        save(*arguments)
        saved.append(arguments)
        if len(saved) == 2:
            os.kill(os.getpid(), signal.SIGKILL)

    PointStore.save = mortal
    run(["reduce", "job.toml", "--store", "points"])


def test_kill_9_and_the_same_command_again(linkage_folder):
    Path("job.toml").write_text(JOB)
    assert reduce("--set", "output=alone.h5")[:2] == (3, 0)
    child = multiprocessing.get_context("fork").Process(target=reduce_and_die)
    child.start()
    child.join(120)
    assert child.exitcode == -9 and not Path("result.h5").exists()
    assert reduce("--store", "points")[:2] == (1, 2)
    alone, found = arrays("alone.h5"), arrays("result.h5")
    assert all(np.array_equal(alone[key], found[key]) for key in alone)


def test_the_job_names_the_store(linkage_folder, capsys):
    """Relative to the job file; the record has its full name, and the table says what came from it."""
    Path("job.toml").write_text('store = "points"\n' + JOB)
    folder = os.getcwd()
    os.chdir("/")
    try:
        assert run(["reduce", f"{folder}/job.toml"]) == 0
    finally:
        os.chdir(folder)
    assert len(list(Path("points").iterdir())) == 3
    capsys.readouterr()
    made, saved, found = reduce("--details")
    assert (made, saved) == (0, 3) and found["job"]["store"] == str(Path("points").absolute())
    assert all(item["from_store"] for item in found["components"])
    output = capsys.readouterr().out
    assert "0 factorisations, 3 saved by the store, 0 analyses" in output and output.count(" store") >= 4
    Path("file").touch()
    assert "/file: cannot be created (it is not a folder)" in refused(capsys, "reduce", "job.toml", "--store", "file")


@pytest.mark.skipif(not TWO_BUILDS, reason="only one PETSc build")
def test_both_builds_share_entries(linkage_folder, hpcred):
    Path("job.toml").write_text(JOB)
    assert reduce("--store", "points", "--set", "output=real.h5")[:2] == (3, 0)
    shared = hpcred("reduce", "job.toml", "--store", "points", "--json", "complex.json", "--scalar", "complex")
    assert shared.returncode == 0, shared.stderr
    found = json.loads(Path("complex.json").read_text())
    assert found["scalar"] == "complex" and not found["factorisations"] and found["factorisations_saved"] == 3
    one, other = arrays("real.h5"), arrays("result.h5")
    assert np.abs(one["reduced/K"] - other["reduced/K"]).max() <= 1e-10 * np.abs(one["reduced/K"]).max()


@pytest.mark.slow
def test_two_runs_at_once(linkage_folder):
    Path("job.toml").write_text(JOB)
    command = [sys.executable, "-m", "hpcred", "reduce", "job.toml", "--store", "points"]
    for _ in range(3):
        shutil.rmtree("points", ignore_errors=True)
        runs = [subprocess.Popen([*command, "--set", f"output={name}.h5"], env=mpi_environment()) for name in "abc"]
        assert [item.wait(timeout=120) for item in runs] == [0, 0, 0]
        found = [arrays(f"{name}.h5") for name in "abc"]
        assert all(np.array_equal(found[0][key], other[key]) for other in found[1:] for key in other)
        assert run(["store", "points", "--check"]) == 0


def listed(*arguments):
    status = run(["store", "points", *arguments, "--json", "rows.json"])
    return status, {row["entry"]: row for row in json.loads(Path("rows.json").read_text())}


def test_list_check_and_prune(linkage_folder, capsys):
    Path("job.toml").write_text(JOB + '[[basis]]\nkind = "modes"\ncount = 3\n')
    reduce("--store", "points")
    capsys.readouterr()
    status, rows = listed("--check")
    said = capsys.readouterr().out
    assert status == 0 and len(rows) == 4 and "4 entries" in said
    assert sum(line.split()[:1] in (["krylov"], ["modes"]) for line in said.splitlines()) == 4  # one line an entry
    points = sorted((row["point"], row["blocks"], row["columns"], row["model"]) for row in rows.values())
    assert points == [("100 Hz", 2, 2, "model.h5"), ("200 Hz", 1, 1, "model.h5"), ("250 Hz", 1, 1, "model.h5"),
                      ("lowest", 1, 3, "model.h5")]  # fmt: skip
    folder = Path("points")
    assert all(row["bytes"] == (folder / name).stat().st_size for name, row in rows.items())
    # what is no entry is not listed, and stays whatever is asked for
    (folder / "notes.txt").write_text("mine")
    (folder / ("krylov-" + "0" * 31 + ".h5")).write_text("a name that is too short")
    shutil.copy("result.h5", folder / ("krylov-" + "0" * 32 + ".h5"))
    (folder / ("krylov-" + "1" * 32 + ".h5")).symlink_to(Path("model.h5").absolute())
    (folder / ("modes-" + "2" * 32 + ".h5")).mkdir()
    others = {path.name for path in folder.iterdir()} - set(rows)
    assert len(others) == 5 and listed()[1].keys() == rows.keys()
    # a file that a run is writing, one that was left by another, and a block that is damaged
    running, left = (folder / (f"krylov-{'a' * 32}.h5.tmp-{number}") for number in ("0" * 16, "1" * 16))
    for path in (running, left):
        path.touch()
    os.utime(left, (time.time() - 7200,) * 2)
    damaged = next(name for name, row in rows.items() if row["point"] == "200 Hz")
    content = bytearray((folder / damaged).read_bytes())
    with h5py.File(folder / damaged, "r") as file:
        content[file["blocks/0"].id.get_offset() + 8] ^= 1
    (folder / damaged).write_bytes(content)
    assert listed()[0] == 0  # headers are fine
    status, found = listed("--check")
    assert status == 1 and [name for name, row in found.items() if not row["valid"] and ".tmp" not in name] == [damaged]
    assert found[damaged]["reason"] == "blocks/0 does not have its checksum"
    assert listed("--prune", "--broken")[1].keys() == {damaged, left.name}
    # by age of use, by model, by size
    oldest, newer, *_ = sorted(rows.keys() - {damaged})
    for name, days in ((oldest, 40), (newer, 20)):
        os.utime(folder / name, (time.time() - 86400 * days,) * 2)
    assert not listed("--prune", "--model", "another.h5")[1]
    assert listed("--prune", "--older", "30d", "--model", "model.h5")[1].keys() == {oldest}
    total = sum(row["bytes"] for row in listed()[1].values())
    assert listed("--prune", "--below", f"{(total - 1) / 1000}k")[1].keys() == {newer}
    assert len(listed("--prune", "--below", "0G")[1]) == 1
    assert {path.name for path in folder.iterdir()} == others | {running.name}


def test_use_keeps_an_entry_young(linkage_folder):
    Path("job.toml").write_text(JOB)
    reduce("--store", "points")
    for path in Path("points").iterdir():
        os.utime(path, (0, 0))
    reduce("--store", "points", "--set", "basis.0.frequency=200.0")
    assert len(listed("--prune", "--older", "30d")[1]) == 1


@pytest.mark.parametrize(("arguments", "said"), [
    (["none"], "store none: no such folder"), ([".", "--prune"], "--prune: say what is to go"),
    ([".", "--broken"], "--broken: belongs to --prune"), ([".", "--below", "3G"], "--below: belongs to --prune"),
    ([".", "--prune", "--older", "30"], "--older: found '30', expected a number and one of the units m, h, d, w"),
    ([".", "--prune", "--below", "-1G"], "--below: found '-1G'"),
    ([".", "--prune", "--below", "nanG"], "--below: found"),
])  # fmt: skip
def test_refusals(tmp_path, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert said in refused(capsys, "store", *arguments)
