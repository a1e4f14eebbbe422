"""The wheel and the source distribution, installed where there is nothing else and on top of a PETSc."""

import subprocess
import sys
import venv
from pathlib import Path

import pytest
from launch import mpi_environment

pytestmark = pytest.mark.wheel

ROOT = Path(__file__).parents[1]
JOB = """
model = "model.h5"
output = "result.h5"
band = [0.0, 2000.0]
tolerance = 1e-3
frame = {kind = "buckens"}
interface = [{name = "crank", nodes = {set = "BIG_EYE"}}]
"""


def call(*command, cwd, **more):
    return subprocess.run([*map(str, command)], cwd=cwd, capture_output=True, text=True, **more)


def checked(*command, cwd, **more):
    done = call(*command, cwd=cwd, **more)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def distributions(tmp_path_factory):
    """The wheel, built from the source distribution, and that."""
    folder = tmp_path_factory.mktemp("dist")
    checked(sys.executable, "-m", "build", "--outdir", folder, ROOT, cwd=folder)
    (wheel,), (source,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    return wheel, source


def environment(folder, what, on_system):
    """The folder of the commands of a new environment in which pip has installed something."""
    venv.EnvBuilder(system_site_packages=on_system, with_pip=True).create(folder)
    checked(folder / "bin/python", "-m", "pip", "install", "-q", what, cwd=folder)
    return folder / "bin"


def test_without_petsc_it_says_what_is_missing(distributions, tmp_path):
    """Installed from the wheel, and then from the source distribution."""
    bin_ = environment(tmp_path / "empty", distributions[0], False)
    for again in (False, True):
        if again:
            checked(bin_ / "python", "-m", "pip", "install", "-q", "--no-deps", "--force-reinstall", distributions[1],
                    cwd=tmp_path)  # fmt: skip
        for command in ([bin_ / "hpcred", "info", "x.h5"], [bin_ / "python", "-c", "import hpcred; hpcred.reduce"]):
            done = call(*command, cwd=tmp_path)
            assert done.returncode == 1
            assert "found no mpi4py; hpcred needs petsc4py, slepc4py and mpi4py" in done.stderr.splitlines()[-1]


def test_on_top_of_a_petsc_it_reduces_reports_and_exports(distributions, tmp_path):
    """With data files that are part of the package: those of reports and of FMUs."""
    bin_ = environment(tmp_path / "with", distributions[0], True)
    (tmp_path / "job.toml").write_text(JOB)
    run = {"cwd": tmp_path, "env": mpi_environment()}
    assert "site-packages" in checked(bin_ / "python", "-c", "import hpcred; print(hpcred.__file__)", **run)
    checked(bin_ / "hpcred", "example", "crank", "--dofs", 1000, "-o", "model.h5", **run)
    assert "(uncompressed model)" in checked("mpiexec", "-n", 2, bin_ / "hpcred", "reduce", "job.toml", **run)
    checked(bin_ / "hpcred", "report", "result.h5", "-o", "report.html", **run)
    assert (tmp_path / "report.html").stat().st_size > 1e5
    assert "SID_FEM" in checked(bin_ / "hpcred", "export", "result.h5", "--format", "sid", **run)
