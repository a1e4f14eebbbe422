"""`hpcred sweep` and `hpcred collect`: the documented example, interruptions, what is skipped, failures, scripts."""

import csv
import fcntl
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import psutil
import pytest
from helpers import CHORD_JOB
from launch import mpi_environment
from mpi4py import MPI
from pictures import undrawn

import hpcred as package
from hpcred.cli.main import run
from hpcred.files.locks import Taken
from hpcred.files.room import NoRoom
from hpcred.parallel.stopping import Stopped
from hpcred.settings.sweep_file import read_sweep
from hpcred.workflows import sweep
from hpcred.workflows.children import Child, Interrupted, run_all

ROOT = Path(__file__).parent.parent.parent
SWEEP = """
job = "job.toml"
[[vary]]
key = "basis.0.order"
range = [0, {last}, {count}]
[launch]
launcher = ""
"""


@pytest.fixture(scope="module")
def finished(tmp_path_factory, forks):
    """A folder with a finished sweep of two runs."""
    folder = tmp_path_factory.mktemp("finished")
    with package.linkage() as model:
        package.write_model(folder / "model.h5", model)
    (folder / "job.toml").write_text(CHORD_JOB)
    text = SWEEP.format(last=1, count=2) + "[evaluate]\nband = [1.0, 100.0]\npoints = 3\n"
    (folder / "sweep.toml").write_text(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(forks, "commands", True)
        assert package.sweep(folder / "sweep.toml")["finished"] == 2
    return folder


@pytest.fixture
def swept(finished, tmp_path, monkeypatch):
    """A copy of it, as the working folder."""
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)


def results(folder):
    """Reduced models by the names of their files, while nothing writes."""
    return {path.name: package.read_result(path).reduced for path in sorted(Path(folder).glob("*.h5"))}


@pytest.mark.usefixtures("forked_commands")
def test_the_documented_example(tmp_path, monkeypatch, capsys):
    """Files whose names have blanks; errors against `evaluate` on the full model."""
    undrawn(monkeypatch, ["png"])
    (example,) = re.findall(r'```toml title="sweep.toml"\n(.*?)```', (ROOT / "docs/sweeps.md").read_text(), re.S)
    (tmp_path / "a b").mkdir()
    monkeypatch.chdir(tmp_path / "a b")
    with package.linkage() as model:
        package.write_model("model.h5", model)
    Path("my sweep.toml").write_text(example)
    assert run(["sweep", "my sweep.toml", "--parallel", "2", "--json", "report.json"]) == 0
    assert json.loads(Path("report.json").read_text())["finished"] == 4
    assert len(list(Path("my sweep").glob("full-*.h5"))) == 1
    capsys.readouterr()
    assert run(["collect", "my sweep.toml", "-o", "table.csv", "--figures", "figures"]) == 0
    with open("table.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["run"] for row in rows] == [f"basis-{b}_order-{o}" for b in ("modal", "krylov") for o in (1, 3)]
    assert run(["collect", "my sweep.toml", "-o", "table.h5"]) == 0
    with h5py.File("table.h5") as table:
        for i, row in enumerate(rows):
            result = f"my sweep/{row['run']}.h5"
            if i in (0, 3):
                direct = package.evaluate_result(result, "model.h5", points=31)
                assert np.allclose([float(row["eps"]), float(row["Q"])], [direct["eps_max"], direct["Q"]], rtol=1e-6)
                assert np.allclose(table[f"curves/{row['run']}/eps"], direct["eps"], rtol=1e-6)
            reduced = package.read_result(result).reduced
            made = len(reduced.record.factorisations)
            assert int(row["factorisations"]) == made == table["columns/factorisations"][i]
            assert int(row["size"]) == reduced.size and int(row["basis.1.order"]) == reduced.record.basis[1].order
    drawn = {path.name for path in Path("figures").iterdir()}
    assert drawn == {f"{stem}.{kind}" for stem in ("error_over_size", "error_over_basis.1.order", "errors")
                     for kind in ("png", "svg")}  # fmt: skip


@pytest.mark.parametrize("taken", [
    "error_over_size.png", *(pytest.param(name, marks=pytest.mark.slow)
                             for name in ("error_over_basis.0.order.svg", "errors.svg"))])  # fmt: skip
def test_figures_replace_no_file_of_another_kind(swept, capsys, monkeypatch, taken):
    """Whether it lies in the folder or a link there leads to it; nothing else is written then."""
    undrawn(monkeypatch)
    collect = ["collect", "sweep.toml", "-o", "table.csv", "--figures", "figures"]
    Path("figures").mkdir()
    target, text = Path("figures", taken), "years of notes\n"
    for file in (target, Path("notes.txt")):
        file.write_text(text)
        if file != target:
            target.symlink_to(file.absolute())
        assert run(collect) == 2
        assert f"output {target}: found a file of another kind there" in capsys.readouterr().err
        assert file.read_text() == text and [path.name for path in Path("figures").iterdir()] == [taken]
        assert not Path("table.csv").exists()
        target.unlink()
    assert run(collect) == 0
    assert run(collect) == 0  # of the same kind


def test_finished_runs_are_known_by_what_they_say(swept, capsys, monkeypatch):
    """Not by times: a new model or job is seen, an old file with the same contents is not."""
    def statuses():
        report = package.sweep("sweep.toml", dry_run=True)
        return [row["status"] for row in report["runs"]]

    Path("sweep/order-1.h5").rename("order-1.h5")
    assert statuses() == ["skipped", "missing"]
    Path("order-1.h5").rename("sweep/order-1.h5")
    assert statuses() == ["skipped", "skipped"]
    before = {path: path.stat().st_mtime_ns for path in Path("sweep").iterdir()}
    os.utime("model.h5")
    assert run(["sweep", "sweep.toml"]) == 0
    assert {path: path.stat().st_mtime_ns for path in Path("sweep").iterdir()} == before
    with monkeypatch.context() as patched:  # a folder in which nothing may be written, by any user
        patched.setattr(sweep, "check_writable", lambda *_: pytest.fail("nothing is to be written"))
        assert run(["sweep", "sweep.toml"]) == 0
    Path("model.h5").rename("moved.h5")
    Path("job.toml").write_text(CHORD_JOB.replace("model.h5", "moved.h5"))
    assert statuses() == ["skipped", "skipped"]
    Path("moved.h5").rename("model.h5")
    Path("job.toml").write_text(CHORD_JOB.replace("100.0", "101.0"))
    assert statuses() == ["of another job"] * 2
    Path("job.toml").write_text(f"memory_mb = 1000.0\n{CHORD_JOB}  # no other numbers")
    assert statuses() == ["skipped", "skipped"]
    with package.linkage(inputs=[(19, "z")]) as model:
        package.write_model("model.h5", model)
    assert statuses() == ["of another job"] * 2
    Path("sweep/order-0.h5").write_bytes(Path("sweep/order-0.h5").read_bytes()[:3000])
    with pytest.raises(package.InputError, match="is there and no result"):
        statuses()


@pytest.mark.usefixtures("forked_commands")
def test_keep_replaces_no_result_no_table_and_no_figure(swept, capsys, monkeypatch):
    undrawn(monkeypatch)
    assert run(["sweep", "sweep.toml", "--keep"]) == 0
    collect = ["collect", "sweep.toml", "--keep"]
    for more in (["-o", "table.csv"], ["-o", "table.h5"], ["--figures", "figures"]):
        assert run(collect + more) == 0
        assert run(collect + more) == 2
        assert "--keep leaves it" in capsys.readouterr().err
    Path("job.toml").write_text(CHORD_JOB.replace("100.0", "101.0"))
    before = {path: path.read_bytes() for path in Path("sweep").iterdir()}
    assert run(["sweep", "sweep.toml", "--keep"]) == 2
    assert "output sweep/order-0.h5: it exists, and --keep leaves it" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in Path("sweep").iterdir()} == before
    assert run(["sweep", "sweep.toml", "--index", "1", "--of", "2"]) == 0


@pytest.mark.usefixtures("forked_commands")
@pytest.mark.parametrize("launcher", ["", "false"])
def test_what_another_sweep_has_done_meanwhile_is_finished(swept, launcher):
    """Before it is begun here, or while what is begun here is refused."""
    Path("sweep").rename("done")
    text = SWEEP.format(last=1, count=2)
    Path("sweep.toml").write_text(text.replace('launcher = ""', f'launcher = "{launcher}"'))

    class Other(package.Progress):
        def say(self, line):
            said.append(line)
            for path in Path("done").glob("*.h5" if launcher == "false" else "order-1.h5"):
                path.rename(Path("sweep", path.name))

    said = []
    report = package.sweep("sweep.toml", progress=Other(MPI.COMM_SELF, show=False))
    assert [row["status"] for row in report["runs"]] == ["finished", "skipped"] and not report["failed"]
    assert not Path("sweep/order-1.log").exists()
    assert "2 of 2" in said[-1]


@pytest.mark.usefixtures("forked_commands")
@pytest.mark.parametrize("finishes", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_run_that_another_sweep_computes_is_waited_for(swept, finishes):
    """Also where its lock is there before it is begun here; what the other leaves undone is done here."""
    Path("sweep/order-0.h5").rename("order-0.h5")
    Path("sweep/order-1.h5").unlink()
    locked, said = [], []

    class Other(package.Progress):
        def say(self, line):
            said.append(line)
            if "order-1: done" in line:  # behind which the other one is waited for
                if finishes:
                    Path("order-0.h5").rename("sweep/order-0.h5")
                os.close(locked.pop())

    locked.append(os.open("sweep/.order-0.log.lock", os.O_RDWR | os.O_CREAT))
    fcntl.flock(locked[0], fcntl.LOCK_EX)
    os.write(locked[0], b"process 7 on elsewhere")
    report = package.sweep("sweep.toml", progress=Other(MPI.COMM_SELF, show=False))
    assert [row["status"] for row in report["runs"]] == ["skipped" if finishes else "finished", "finished"]
    assert not report["failed"] and len(list(Path("sweep").glob("order-*.h5"))) == 2
    (line,) = [line for line in said if "computed by another sweep" in line]
    assert line.startswith("order-0: is being computed by another sweep (process 7 on elsewhere)")


def test_a_run_that_is_refused_by_a_lock_is_begun_again(tmp_path):
    """Where two sweeps begin it at the same moment."""
    (tmp_path / "a.sh").write_text(f"if [ -e {tmp_path}/there ]; then exit 0; fi; touch {tmp_path}/there; "
                                   f"exit {Taken.exit_status}")  # fmt: skip
    child = Child("a", ["sh", str(tmp_path / "a.sh")], tmp_path / "a.log")
    silent = package.Progress(MPI.COMM_SELF, show=False)
    others = sweep._beside_others(silent, lambda _: False)
    ended = []
    run_all([child], ended=ended.append, **others)
    assert child.status == 0 and ended == [child]


@pytest.mark.usefixtures("forked_commands")
def test_failed_runs_are_listed_with_their_sentence(linkage_folder, capsys):
    Path("sweep.toml").write_text(SWEEP.format(last=200, count=2))  # 201 vectors for 114 coordinates
    assert run(["sweep", "sweep.toml", "--json", "report.json"]) == 1
    report = json.loads(Path("report.json").read_text())
    assert [row["status"] for row in report["runs"]] == ["finished", "failed"]
    told = capsys.readouterr()
    assert "FAILED order-200: error: basis: 201 vectors asked for" in told.out
    assert told.err.splitlines()[-1].startswith("hpcred: error: 1 of 2 runs failed, the first of them order-200: basis")
    assert run(["collect", "sweep.toml"]) == 1
    assert "1 of 2 runs have no result of their job: order-200" in capsys.readouterr().out


def test_a_full_disk_ends_a_sweep(linkage_folder):
    """Of three runs the first finds the disk full; the others are not begun, and are no failures."""
    script = f"import sys; sys.exit({NoRoom.exit_status})"
    Path("sweep.toml").write_text(SWEEP.format(last=2, count=3))
    found = read_sweep("sweep.toml")
    children = [Child(run.name, [sys.executable, "-c", script], Path(f"{run.name}.log")) for run in found.runs]
    run_all(children, **sweep._told(package.Progress(MPI.COMM_SELF), 3))
    assert [child.status for child in children] == [NoRoom.exit_status, None, None]
    states, ended = sweep.states_of(found), {child.name: child for child in children}
    report = sweep._report(found, found.runs, states, set(), ended)
    assert [row["status"] for row in report["runs"]] == ["failed", "missing", "missing"]


@pytest.mark.usefixtures("forked_commands")
def test_a_tolerance_that_is_not_reached_is_said_each_time(linkage_folder, capsys):
    Path("sweep.toml").write_text(
        '[job]\nmodel = "model.h5"\nband = [1.0, 60.0]\n[job.frame]\nkind = "chord"\nnodes = [1, 7, 14]\naxes = "yxz"'
        '\n[[run]]\n"tolerance" = 1e-3\n[[run]]\n"tolerance" = 1e-8\n"adaptive.size" = 3\n[launch]\nlauncher = ""\n'
    )
    for _ in range(2):
        assert run(["sweep", "sweep.toml"]) == 1
        assert "FAILED tolerance-1e-08_size-3: tolerance not reached" in capsys.readouterr().out
    rows = package.collect_sweep("sweep.toml")["rows"]
    assert [row["status"] for row in rows] == ["finished", "not reached"] and rows[0]["estimate"] < 1e-3


@pytest.mark.usefixtures("forked_commands")
def test_a_store_saves_factorisations_and_changes_no_number(linkage_folder, capsys):
    Path("sweep.toml").write_text(
        'job = "job.toml"\nstore = "my points"\n[[vary]]\nkey = "basis.0.order"\nvalues = [1, 0]\n[[vary]]\n'
        'key = "damping"\nvalues = [{kind = "none"}, {kind = "rayleigh", alpha = 2.0}]\n[launch]\nlauncher = ""\n'
    )
    assert run(["sweep", "sweep.toml"]) == 0
    assert "1 factorisations made, 3 saved" in capsys.readouterr().out
    grid = np.linspace(5, 300, 30)
    for name, reduced in list(results("sweep").items())[::3]:  # one of each order and damping
        job = package.read_job(Path("sweep", name).with_suffix(".toml"), overrides=["output='alone.h5'"])
        alone = package.reduce_job(replace(job, store=None))
        assert len(alone.record.factorisations) == 1
        other = package.read_result(alone.output).reduced
        responses = [package.frequency_response(item, grid) for item in (other, reduced)]
        assert package.relative_error(*responses).max() < 1e-9


def start_sweep(count):
    """A sweep of the linkage on two ranks each, as a process."""
    with package.linkage() as model:
        package.write_model("model.h5", model)
    Path("job.toml").write_text(CHORD_JOB)
    Path("sweep.toml").write_text(SWEEP.format(last=count - 1, count=count).replace('launcher = ""', "ranks = 2"))
    return again()


def again():
    return subprocess.Popen([sys.executable, "-m", "hpcred", "sweep", "sweep.toml", "--parallel", "2"],
                            env=mpi_environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # fmt: skip


def check_undisturbed(count):
    """All results are there, and are those of jobs that nobody disturbed."""
    found, grid = results("sweep"), np.linspace(5, 300, 30)
    assert len(found) == count
    for name, reduced in found.items():
        alone = package.reduce_job(Path("sweep", name).with_suffix(".toml"), overrides=["output='alone.h5'"])
        undisturbed = package.read_result(alone.output).reduced
        assert reduced.record.ranks == 2 and undisturbed.size == reduced.size
        responses = [package.frequency_response(item, grid) for item in (undisturbed, reduced)]
        assert package.relative_error(*responses).max() < 1e-9


@pytest.mark.slow
def test_kill_9_of_a_sweep_and_the_same_command_again(tmp_path, monkeypatch):
    """On two ranks; the results are those of an undisturbed run, and nobody is left behind."""
    monkeypatch.chdir(tmp_path)
    process, deadline = start_sweep(3), time.monotonic() + 120
    while len(list(Path("sweep").glob("*.h5"))) < 1:
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.02)
    family = psutil.Process(process.pid).children(recursive=True)
    process.kill()
    process.wait()
    assert family and not psutil.wait_procs(family, timeout=20)[1]
    done = {path: path.stat().st_mtime_ns for path in Path("sweep").glob("*.h5")}
    assert again().wait(200) == 0
    assert all(path.stat().st_mtime_ns == mtime for path, mtime in done.items())
    check_undisturbed(3)


@pytest.mark.slow
def test_kill_9_of_launchers_and_sweeps_at_random_moments(tmp_path, monkeypatch):
    """Ten times mpiexec or the sweep itself."""
    monkeypatch.chdir(tmp_path)
    random = np.random.default_rng(7)
    for number in range(10):
        process = start_sweep(12) if number == 0 else again()
        time.sleep(random.uniform(1.0, 5.0))
        family = psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []
        launchers = [item for item in family if item.is_running() and item.name().startswith(("mpiexec", "orterun"))]
        if launchers and number % 2:
            launchers[0].kill()
            status = process.wait(300)  # 0 only where the job was done when its launcher was killed
            assert status == 1 or (status == 0 and len(list(Path("sweep").glob("*.h5"))) == 12)
        else:
            process.kill()
            process.wait()
        assert not psutil.wait_procs(family, timeout=30)[1]
    assert again().wait(300) == 0
    check_undisturbed(12)


STUBBORN = """
import signal, subprocess, sys, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
child = [] if "child" in sys.argv else [subprocess.Popen([sys.executable, __file__, "child"])]
open(sys.argv[1] if child else "child.ready", "w").close()
time.sleep(60)
"""


def after(path, number):
    """Send a signal to this process once a file is there."""
    def wait():
        while not path.exists():
            time.sleep(0.02)
        os.kill(os.getpid(), number)

    threading.Thread(target=wait, daemon=True).start()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_all_children_and_theirs_in_seconds(tmp_path, monkeypatch, number):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("hpcred.workflows.children.PATIENCE", 0.5)
    Path("stubborn.py").write_text(STUBBORN)
    children = [Child(name, [sys.executable, "stubborn.py", name], Path(f"{name}.log")) for name in ("one", "two")]
    after(Path("child.ready"), number)
    start = time.monotonic()
    with pytest.raises(Interrupted) as caught:
        run_all(children, at_once=1)
    assert time.monotonic() - start < 20
    assert caught.value.exit_status == 128 + number
    assert not Path("two").exists()
    left = [item for item in psutil.process_iter(["cmdline", "cwd"]) if "stubborn.py" in (item.info["cmdline"] or [])
            and item.info["cwd"] == str(tmp_path)]  # fmt: skip
    assert not left
    assert signal.getsignal(number) is not None


def test_usr1_is_handed_on_and_no_other_is_started(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    program = (
        "import pathlib, signal, sys, time\nsignal.signal(signal.SIGUSR1, lambda *_: sys.exit(75))\n"
        "pathlib.Path(sys.argv[1]).touch()\ntime.sleep(60)\n"
    )
    children = [Child(name, [sys.executable, "-c", program, name], Path(f"{name}.log")) for name in ("one", "two")]
    after(Path("one"), signal.SIGUSR1)
    with pytest.raises(Stopped):
        run_all(children, at_once=1)
    assert children[0].status == 75 and not Path("two").exists()


@pytest.fixture
def jobs(tmp_path, monkeypatch):
    """A copy of jobs/ with its model."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "jobs", "jobs")
    with package.linkage() as model:
        package.write_model("jobs/model.h5", model)
    return tmp_path


def bash(*arguments, **environment):
    environment = mpi_environment(HPCRED_PYTHON=sys.executable, PYTHONPATH=str(ROOT), **environment)
    return subprocess.run(["bash", *arguments], capture_output=True, text=True, env=environment, timeout=200)


@pytest.mark.parametrize("script", sorted(path.name for path in (ROOT / "jobs").iterdir() if path.suffix != ".toml"))
def test_scripts_are_bash(script):
    assert bash("-n", str(ROOT / "jobs" / script)).returncode == 0


@pytest.mark.slow
def test_the_script_for_pbs_with_the_variables_of_pbs(jobs):
    given = {"PBS_O_WORKDIR": str(jobs), "SWEEP": "jobs/sweep.toml", "SHARES": "4"}
    done = bash("jobs/sweep.pbs", PBS_ARRAY_INDEX="3", **given)
    assert done.returncode == 0, done.stderr
    assert list(results("jobs/sweep")) == ["frequency-150_order-1.h5"]
    bad = bash("jobs/sweep.pbs", PBS_ARRAY_INDEX="5", **given)
    assert bad.returncode == 2 and "--index: found 5 of 4" in bad.stderr
    assert "submit this script as an array" in bash("jobs/sweep.pbs", **given).stderr
    assert bash("jobs/sweep.pbs", PBS_ARRAY_INDEX="1").returncode != 0


@pytest.mark.slow
def test_the_script_for_one_reduction_with_the_variables_of_pbs(jobs, tmp_path):
    """On as many ranks as the file of nodes has lines, with factors on the local disk of the job."""
    Path("job.toml").write_text('model = "jobs/model.h5"\n[frame]\nkind = "buckens"\n'
                                '[[basis]]\nkind = "krylov"\nfrequency = 100.0\norder = 1\n')  # fmt: skip
    Path("nodes").write_text("localhost\n" * 2)
    Path("local").mkdir()
    given = {"PBS_O_WORKDIR": str(jobs), "PBS_NODEFILE": "nodes", "JOB": "job.toml", "TMPDIR": str(tmp_path / "local")}
    for options, folder in (({}, None), ({"OPTIONS": "--out-of-core $TMPDIR"}, str(tmp_path / "local"))):
        done = bash("jobs/reduce.pbs", **given, **options)
        assert done.returncode == 0, done.stderr
        with h5py.File("result.h5") as file:
            record = json.loads(file["record"][()])
        assert record["ranks"] == 2 and record["job"]["out_of_core"] == folder and Path("points").is_dir()
    assert "usage: qsub" in bash("jobs/reduce.pbs", **given | {"JOB": ""}).stderr


@pytest.mark.parametrize("kind", ["slurm", "pbs"])
def test_written_scripts_say_what_launch_says(jobs, capsys, kind):
    text = Path("jobs/sweep.toml").read_text().replace("ranks = 2", (
        'ranks = 8\nnodes = 2\naccount = "me"\npartition = "short"\nmodules = ["petsc/3.20"]\nat_once = 2\n'
        f'setup = ["echo \'set up\'"]\nlines = ["#{"SBATCH --qos" if kind == "slurm" else "PBS -W x"}=high"]'
    ))  # fmt: skip
    Path("jobs/my sweep.toml").write_text(text)
    assert run(["sweep", "jobs/my sweep.toml", f"--{kind}"]) == 0
    script = Path(f"jobs/my sweep/my sweep.{kind}")
    assert str(script) in capsys.readouterr().out
    assert bash("-n", str(script)).returncode == 0
    lines = script.read_text().splitlines()
    expected = {
        "slurm": ["--array=1-4%2", "--nodes=2", "--ntasks=8", "--mem-per-cpu=1000M", "--time=00:10:00", "--account=me",
                  "--partition=short", "--qos=high", "--signal=B:TERM@60"],
        "pbs": ["-J 1-4%2", "-l select=2:ncpus=4:mpiprocs=4:ompthreads=1:mem=4000mb", "-l walltime=00:10:00", "-A me",
                "-q short", "-W x=high"],
    }[kind]  # fmt: skip
    head = lines[: lines.index("set -euo pipefail")]
    assert [f"#{'SBATCH' if kind == 'slurm' else 'PBS'} {line}" in head for line in expected] == [True] * len(expected)
    assert "module load petsc/3.20" in lines and "echo 'set up'" in lines
    assert not results("jobs/my sweep")


@pytest.mark.parametrize("folder, log", [("it's", "it's"), ("a#b", "a#b"), ("100%x", "100%%x"), ("a b", "a b")])
def test_names_of_folders_in_the_head_of_a_script(jobs, folder, log):
    """SLURM takes # for a comment, ' for a quotation mark and %x for the name of the job."""
    Path("jobs").rename(folder)
    assert run(["sweep", f"{folder}/sweep.toml", "--slurm"]) == 0
    lines = Path(f"{folder}/sweep/sweep.slurm").read_text().splitlines()
    log, mark = f"{jobs}/{log}/sweep/share-%a.log", "" if "%%" in log else '"'
    assert f"#SBATCH --output={mark}{log}{mark}" in lines


@pytest.mark.parametrize("folder", ['a"b', "a\\b"])
def test_names_of_folders_that_no_head_of_a_script_takes(jobs, folder, capsys):
    Path("jobs").rename(folder)
    assert run(["sweep", f"{folder}/sweep.toml", "--slurm"]) == 2
    assert "cannot stand in the head of a batch script" in capsys.readouterr().err


def test_submitting_needs_the_batch_system(jobs, capsys, monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    assert run(["sweep", "jobs/sweep.toml", "--slurm", "--submit"]) == 2
    assert "--submit: there is no sbatch on this machine" in capsys.readouterr().err
