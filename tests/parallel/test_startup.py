"""Which PETSc is taken: of Debian's two builds, of another origin, of the wheel from PyPI."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from launch import TWO_BUILDS, mpi_environment

from hpcred.parallel import failures, how_to_install, startup

two_builds = pytest.mark.skipif(not TWO_BUILDS, reason="needs Debian's two builds, and none chosen")


def output(program, *paths):
    path = os.pathsep.join([*map(str, paths), os.environ.get("PYTHONPATH", "")])
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env=mpi_environment(PYTHONPATH=path)
    )
    assert run.returncode == 0, run.stderr
    return run.stdout.split()


@two_builds
def test_the_link_to_the_default_build_is_no_choice(tmp_path):
    """The development files of PETSc bring a link by which Python finds one build, also with DOLFINx."""
    (tmp_path / "default").symlink_to(startup.debian_builds()["real"][0])
    program = "from hpcred.parallel import startup as s; print(s.can_choose(), s.start('complex'))"
    assert output(program, tmp_path / "default") == ["True", "complex"]


@two_builds
def test_a_petsc_that_is_loaded_is_taken(tmp_path):
    folders = startup.debian_builds()["complex"]
    program = "from petsc4py import PETSc; from hpcred.parallel import startup as s; print(s.can_choose(), s.start())"
    assert output(program, *folders) == ["False", "complex"]


@two_builds
def test_a_petsc_of_another_origin_is_taken(tmp_path):
    (tmp_path / "petsc4py").mkdir()
    (tmp_path / "petsc4py" / "__init__.py").touch()
    assert output("from hpcred.parallel import startup as s; print(s.can_choose())", tmp_path) == ["False"]


@two_builds
def test_a_petsc_dir_without_petsc4py_is_named():
    """As a module of a cluster sets it, which has no Python in it."""
    found = subprocess.run([sys.executable, "-m", "hpcred", "info", __file__], capture_output=True, text=True,
                           env=mpi_environment(PETSC_DIR="/nowhere"))  # fmt: skip
    assert found.returncode == 2
    assert "error: found no petsc4py for PETSC_DIR=/nowhere; install it for this PETSc" in found.stderr


@pytest.fixture
def wheel(tmp_path):
    """A module that stands for the wheel of PETSc from PyPI."""
    path = tmp_path / "dolfinx_solver.py"
    path.touch()
    return path


def test_the_wheel_of_petsc_is_imported_between_mpi_and_petsc(wheel):
    wheel.write_text("import sys; print(*[name in sys.modules for name in ('mpi4py.MPI', 'petsc4py')])")
    program = "from hpcred.parallel import startup as s; s.start(); s.start()"
    assert output(program, wheel.parent) == ["True", "False"]


def test_what_the_wheel_of_petsc_refuses_is_an_error_of_the_user(wheel):
    """As a petsc4py of another PETSc beside it."""
    wheel.write_text("raise ImportError('petsc4py would be imported from elsewhere')")
    program = "import hpcred; hpcred.linkage()"
    for command, status in ((["-m", "hpcred"], 2), (["-c", program], 1)):
        found = subprocess.run([sys.executable, *command], capture_output=True, text=True,
                               env=mpi_environment(PYTHONPATH=str(wheel.parent)))  # fmt: skip
        assert found.returncode == status
        assert found.stderr.splitlines()[-1].endswith(": petsc4py would be imported from elsewhere")


@pytest.mark.parametrize(("given", "left"), [({}, "None"), ({"OMPI_MCA_pml": "ob1,ucx"}, "ob1,ucx")])
def test_what_a_single_process_starts_may_look_for_networks(given, left):
    """As the ranks of a sweep must, or the job that it submits."""
    program = (
        "import os, sys; from hpcred.__main__ import _alone; _alone(); "
        "print(os.environ.get('OMPI_MCA_pml'), 'mpi4py.MPI' in sys.modules)"  # which has read it where it was set
    )
    environment = {name: word for name, word in mpi_environment().items() if name != "OMPI_MCA_pml"}
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment | given)
    assert run.stdout.split() == [left, str(not given)], run.stderr


@pytest.mark.parametrize("name, number, says", [
    ("SLURM_STEP_NUM_TASKS", "SLURM_PROCID", "srun started 4 ranks, .* finds one: take `srun --mpi=pmix`"),
    ("PMI_SIZE", "PMI_RANK", "the mpiexec of MPICH or Intel MPI started 4 ranks"),
])  # fmt: skip
def test_ranks_that_do_not_find_each_other_are_refused_by_one_of_them(hpcred, name, number, says):
    """Each would do the whole job. A launcher of another MPI shows by its variables alone."""
    run = hpcred("info", **{name: "4", number: "0"})
    assert run.returncode == 2 and len(run.stderr.splitlines()) == 1 and re.search(says, run.stderr)


def test_the_others_of_them_end_silently_and_after_the_first_one(monkeypatch):
    """A launcher that ends a job at the first failure would end the rank that says why."""
    calls = []

    def ended(status):
        calls.append(status)
        raise SystemExit(status)

    for name in startup.SIZES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PMI_SIZE", "4")
    monkeypatch.setenv("PMI_RANK", "2")
    monkeypatch.setattr(startup.time, "sleep", calls.append)
    monkeypatch.setattr(startup.os, "_exit", ended)
    with pytest.raises(SystemExit):
        startup._refuse_singletons()
    assert calls == [failures.GRACE, 2]


def test_one_rank_of_mpiexec_inside_a_step_of_srun_is_one(hpcred):
    """The step has other ranks, those of mpiexec or of its helpers."""
    run = hpcred("info", PMI_SIZE="1", PMI_RANK="0", SLURM_STEP_NUM_TASKS="4", SLURM_PROCID="0")
    assert run.returncode == 0, run.stderr


@pytest.mark.parametrize("python, system, says", [
    ((3, 11), "Linux x86_64", "and nothing here, on Python 3.11; `uv venv --python 3.12` makes an environment"),
    ((3, 13), "Linux aarch64", "and nothing here, on Linux aarch64; else `conda"),
    ((3, 11), "Darwin arm64", "and nothing here, on Python 3.11 and Darwin arm64;"),
    ((3, 12), "Linux x86_64", "with glibc 2.34 or later; else `conda"),
])  # fmt: skip
def test_it_is_said_where_pip_brings_no_petsc(python, system, says):
    assert says in how_to_install(python, system)


def test_the_extra_and_the_sentence_have_the_same_conditions():
    extra = (Path(__file__).parents[2] / "pyproject.toml").read_text()
    assert "python_version >= '3.12' and sys_platform == 'linux' and platform_machine == 'x86_64'" in extra


PROGRAM = """
import hpcred
from hpcred.parallel.petsc import MPI, PETSc

first = PETSc.Vec().create(MPI.COMM_WORLD)
if MPI.COMM_WORLD.rank:
    first.destroy()
PETSc.Vec().create(MPI.COMM_WORLD)
print(" made ", flush=True)  # ranks may write into one line
"""


def test_ranks_may_lose_their_last_object_of_petsc_at_other_times(hpcred, tmp_path):
    """PETSc gives up its duplicate of the communicator with it, which only all ranks together can make again."""
    (tmp_path / "program.py").write_text(PROGRAM)
    assert hpcred(program=("program.py",), ranks=2, timeout=60).stdout.split() == ["made", "made"]
