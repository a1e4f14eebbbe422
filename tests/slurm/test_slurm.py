"""The shipped scripts on a real SLURM of one node: arrays, requeueing, too little memory, bad indices."""

import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from launch import mpi_environment
from slurm_cluster import PROGRAMS, Cluster, program

import hpcred

ROOT = Path(__file__).parent.parent.parent
JOBS = ROOT / "jobs"

pytestmark = [
    pytest.mark.slurm,
    pytest.mark.skipif(any(program(name) is None for name in (*PROGRAMS, "sbatch")),
                       reason="no SLURM on this machine"),
]  # fmt: skip
LONG = """
model = "solid.h5"
band = [0.0, 90000.0]
tolerance = 1e-4
[adaptive]
columns = 1200
[damping]
kind = "rayleigh"
alpha = 100.0
"""
SWEEP = """
[job]
model = "solid.h5"
[[job.basis]]
kind = "krylov"
frequency = 100.0
order = 2
[[vary]]
key = "basis.0.frequency"
range = [100.0, 3100.0, {count}]
[launch]
ranks = 2
launcher = "{launcher}"
memory_mb = 500
time = "00:10:00"
"""


@pytest.fixture(scope="module")
def cluster():
    with tempfile.TemporaryDirectory(prefix="slurm-") as folder:
        cluster = Cluster(folder)
        try:
            yield cluster
        finally:
            cluster.stop()


@pytest.fixture
def folder(tmp_path):
    """A copy of jobs/ with the linkage as model.h5, and a solid beside it."""
    shutil.copytree(JOBS, tmp_path / "jobs")
    with hpcred.linkage() as model:
        hpcred.write_model(tmp_path / "jobs/model.h5", model)
    with hpcred.solid((16, 6, 5)) as model:
        hpcred.write_model(tmp_path / "solid.h5", model)
    return tmp_path


def environment(**more):
    return mpi_environment(HPCRED_PYTHON=sys.executable, PYTHONPATH=str(ROOT), **more)


def log(folder, job):
    return "\n".join(path.read_text() for path in sorted(folder.glob(f"slurm-{job}*.out")))


def stop_and_requeue(cluster, job, folder, ready):
    """Send SIGTERM as ahead of a time limit once there is something to keep; the job puts itself into the queue."""
    deadline = time.monotonic() + 120
    while not ready():
        assert time.monotonic() < deadline, log(folder, job)
        time.sleep(0.05)
    cluster.ask("scancel", "--batch", "--signal=TERM", job)
    while "RUNNING" in (states := cluster.states(job)) or "COMPLETING" in states:
        assert time.monotonic() < deadline, log(folder, job)
        time.sleep(0.2)
    assert states == ["PENDING"], log(folder, job)
    assert "Restarts=1" in cluster.ask("scontrol", "show", "job", job)


def test_an_array_does_its_shares(cluster, folder):
    job = cluster.submit(folder, "--array=1-4", "--mem-per-cpu=1G", "jobs/sweep.slurm", "jobs/sweep.toml",
                         **environment())  # fmt: skip
    assert cluster.wait(job) == ["COMPLETED"] * 4, log(folder, job)
    report = hpcred.collect(folder / "jobs/sweep.toml")
    assert not report["missing"] and all(row["eps"] is not None for row in report["rows"])
    assert all(hpcred.read_result(path).reduced.record.ranks == 2 for path in (folder / "jobs/sweep").glob("f*.h5")
               if not path.name.startswith("full"))  # fmt: skip


@pytest.mark.parametrize("launcher", ["", "srun --mpi=pmix", "mpiexec -n 2"])
def test_one_reduction_with_and_without_pmix(cluster, folder, launcher):
    (folder / "job.toml").write_text('model = "solid.h5"\n[[basis]]\nkind = "modes"\ncount = 4\n')
    job = cluster.submit(folder, "--ntasks=2", "--mem-per-cpu=1G", "jobs/reduce.slurm", "job.toml",
                         **environment(HPCRED_LAUNCHER=launcher))  # fmt: skip
    assert cluster.wait(job) == ["COMPLETED"], log(folder, job)
    assert hpcred.read_result(folder / "result.h5").reduced.record.ranks == 2


@pytest.mark.parametrize("launcher", ["srun --mpi=pmix", "mpiexec -n 2"])
def test_a_requeued_reduction_goes_on(cluster, folder, launcher):
    (folder / "job.toml").write_text(LONG)
    job = cluster.submit(folder, "--ntasks=2", "--mem-per-cpu=1G", "jobs/reduce.slurm", "job.toml",
                         **environment(HPCRED_LAUNCHER=launcher))  # fmt: skip
    stop_and_requeue(cluster, job, folder, lambda: any((folder / "points").glob("*.h5")))
    assert "stopped as asked, after point" in log(folder, job)
    assert not (folder / "result.h5").exists()
    assert cluster.wait(job) == ["COMPLETED"], log(folder, job)
    again = hpcred.read_result(folder / "result.h5").reduced
    assert again.record.factorisations_saved >= 1
    assert len(again.record.factorisations) < len(again.record.accuracy.points)
    undisturbed = hpcred.reduce_job(folder / "job.toml", overrides=["output=other.h5"])
    other = hpcred.read_result(undisturbed.output).reduced
    grid = np.linspace(200.0, 90000.0, 50)
    error = hpcred.relative_error(hpcred.frequency_response(other, grid), hpcred.frequency_response(again, grid))
    assert error.max() < 3e-4


def test_a_requeued_task_goes_on_with_the_runs_that_are_left(cluster, folder):
    (folder / "grid.toml").write_text(SWEEP.format(count=8, launcher="mpiexec -n {ranks}"))
    job = cluster.submit(folder, "--array=1", "--mem-per-cpu=1G", "jobs/sweep.slurm", "grid.toml", **environment())
    results = folder / "grid"
    stop_and_requeue(cluster, job, folder, lambda: len(list(results.glob("*.h5"))) >= 2)
    made = {path: path.stat().st_mtime_ns for path in results.glob("*.h5")}
    assert 2 <= len(made) < 8
    assert cluster.wait(job) == ["COMPLETED"], log(folder, job)
    assert len(list(results.glob("*.h5"))) == 8
    assert all(path.stat().st_mtime_ns == mtime for path, mtime in made.items())


def test_a_written_script_is_submitted(cluster, folder):
    (folder / "grid.toml").write_text(SWEEP.format(count=2, launcher="srun --mpi=pmix -n {ranks}"))
    run = subprocess.run([sys.executable, "-m", "hpcred", "sweep", "grid.toml", "--slurm", "--submit"], cwd=folder,
                         capture_output=True, text=True, env={**cluster.environment, **environment()})  # fmt: skip
    assert run.returncode == 0, run.stderr
    job = run.stdout.split()[-1]
    states = cluster.wait(job)
    logs = "\n".join(path.read_text() for path in (folder / "grid").glob("*.log"))
    assert states == ["COMPLETED"] * 2, logs
    assert not hpcred.collect(folder / "grid.toml")["missing"]


def test_too_little_memory_is_refused_with_two_numbers(cluster, folder):
    (folder / "job.toml").write_text('model = "solid.h5"\n[[basis]]\nkind = "krylov"\nfrequency = 100.0\n')
    job = cluster.submit(folder, "--ntasks=2", "--mem-per-cpu=5M", "jobs/reduce.slurm", "job.toml",
                         **environment(HPCRED_LAUNCHER="mpiexec -n 2"))  # fmt: skip
    assert cluster.wait(job) == ["FAILED"]
    assert "hpcred: error: " in log(folder, job) and "MB" in log(folder, job)
    assert not (folder / "result.h5").exists()


def test_bad_indices_are_refused(cluster, folder):
    job = cluster.submit(folder, "--array=5", "--mem-per-cpu=1G", "jobs/sweep.slurm", "jobs/sweep.toml",
                         **environment(HPCRED_SHARES="4"))  # fmt: skip
    assert cluster.wait(job) == ["FAILED"]
    assert "--index: found 5 of 4" in log(folder, job)
    job = cluster.submit(folder, "--mem-per-cpu=1G", "jobs/sweep.slurm", "jobs/sweep.toml", **environment())
    assert cluster.wait(job) == ["FAILED"]
    assert "submit this script as an array" in log(folder, job)
    assert not (folder / "jobs/sweep").exists()
