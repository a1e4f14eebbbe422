"""Fixtures, and the end of the whole job when a test fails on one of several ranks."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

DATA = Path(__file__).parent / "data"


@pytest.fixture(scope="session")
def comm():
    from hpcred.parallel.petsc import MPI

    return MPI.COMM_WORLD


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

    def run(*arguments, ranks=1, timeout=120, program=("-m", "hpcred"), **environment):
        launcher = ["mpiexec", "-n", str(ranks)] if ranks > 1 else []
        return subprocess.run(
            [*launcher, sys.executable, *program, *map(str, arguments)],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=timeout,
            env={**mpi_environment(), **environment},
        )

    return run


def mpi_environment():
    """Open MPI refuses root and more ranks than cores unless told."""
    return {
        **os.environ,
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "OMPI_MCA_rmaps_base_oversubscribe": "1",
    }


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    if report.failed and "mpi4py.MPI" in sys.modules:
        from mpi4py import MPI

        if MPI.COMM_WORLD.size > 1:
            # the other ranks may wait for this one for ever
            print(f"\nrank {MPI.COMM_WORLD.rank}: {item.nodeid}\n{report.longreprtext}", file=sys.stderr, flush=True)
            MPI.COMM_WORLD.Abort(1)
    return report
