"""Fixtures, and the plugin that runs the tests marked mpi on several ranks."""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from launch import mpi_environment

pytest_plugins = ["mpi_items"]

DATA = Path(__file__).parent / "data"


@pytest.fixture(scope="session")
def comm():
    from hpcred.parallel.petsc import MPI

    return MPI.COMM_WORLD


@pytest.fixture
def linkage(comm):
    """The example of the paper, 20 nodes and 120 dofs, free."""
    import hpcred

    with hpcred.linkage(comm) as model:
        yield model


@pytest.fixture
def solid(comm):
    """A clamped block with 144 dofs and three inputs."""
    import hpcred

    with hpcred.solid((4, 2, 3), inputs=3, comm=comm) as model:
        yield model


@pytest.fixture
def folder(comm):
    """An empty folder that all ranks share."""
    path = comm.bcast(tempfile.mkdtemp() if comm.rank == 0 else None)
    yield Path(path)
    comm.Barrier()
    if comm.rank == 0:
        shutil.rmtree(path, ignore_errors=True)


@pytest.fixture
def hpcred(tmp_path):
    """Run the command line in a fresh folder on some ranks: hpcred("reduce", "job.toml", ranks=2)."""

    def run(*arguments, ranks=1, timeout=300, program=("-m", "hpcred"), **environment):
        launcher = ["mpiexec", "-n", str(ranks)] if ranks > 1 else []
        return subprocess.run(
            [*launcher, sys.executable, *program, *map(str, arguments)],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=timeout,
            env=mpi_environment(**environment),
        )

    return run
