"""Fixtures, and the plugin that runs the tests marked mpi on several ranks."""

import gc
import logging
import os
import shutil
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path
from zlib import crc32

import pytest
from launch import mpi_environment

pytest_plugins = ["mpi_items", "item_times"]

DATA = Path(__file__).parent / "data"


NUMERICAL = {"linalg", "reduction", "analysis", "fe", "model"}  # rooms of `make test-kernels`, on 1 rank
OTHERS = ("2-ranks", "3-ranks", "complex")


def pytest_addoption(parser):
    parser.addoption("--share", metavar="K/N", help="of N shares of the tests the K-th, by checksums of their names")
    text = "without this share of the numerical tests on 1 rank, which runs with another kernel"
    parser.addoption("--but-share", metavar="K/N", action="append", default=[], help=text)


def is_in(item, share):
    number, count = map(int, share.split("/"))
    return crc32(item.nodeid.encode()) % count == number - 1


def runs_with_kernels(item):
    """Whether `make test-kernels` runs an item in one of its shares."""
    return item.path.parent.name in NUMERICAL and not any(word in item.nodeid.lower() for word in OTHERS)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Thousands of items and modules that stay to the end: no garbage is looked for among them, now or later."""
    gc.disable()
    result = yield
    gc.freeze()
    gc.enable()
    return result


def pytest_collection_modifyitems(config, items):
    share, elsewhere = config.getoption("share"), config.getoption("but_share")
    left = [item for item in items if not share or is_in(item, share)]
    left = [item for item in left if not (runs_with_kernels(item) and any(is_in(item, other) for other in elsewhere))]
    config.hook.pytest_deselected(items=list(set(items).difference(left)))
    items[:] = left


def pytest_runtest_setup(item):
    """Skip tests marked peers(package, ...) where a package is missing; `make test-peers` calls that a failure."""
    names = [name for mark in item.iter_markers("peers") for name in mark.args]
    if missing := [name for name in names if find_spec(name) is None]:
        refuse = pytest.fail if os.environ.get("HPCRED_TEST_PEERS") else pytest.skip
        refuse(f"needs {', '.join(missing)}: make test-peers")


    if any(item.iter_markers("cuda")):
        from hpcred.linalg.solvers.cudss import unusable

        if reason := unusable():
            (pytest.fail if os.environ.get("HPCRED_TEST_CUDA") else pytest.skip)(f"cuDSS {reason}: make test-cuda")


@pytest.fixture(scope="session")
def comm():
    from hpcred.parallel.petsc import MPI

    return MPI.COMM_WORLD


@pytest.fixture(scope="session", autouse=True)
def forks():
    """The program that looks at HDF5 files, a fork of this process instead of a start of Python (forks.py)."""
    from forks import Forked

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(subprocess, "Popen", Forked)
        yield Forked


@pytest.fixture
def forked_commands(forks, monkeypatch):
    """Commands of hpcred on one rank, such as the runs of a sweep, as forks."""
    monkeypatch.setattr(forks, "commands", True)


@pytest.fixture(scope="session", autouse=True)
def coarse_pictures():
    """Pictures with few dots and margins as they come: tests look at what is drawn, not at how finely or where."""
    from hpcred.report import figures, mode_pictures, set_pictures

    load = figures._matplotlib

    def without_layout():
        found = load()
        from matplotlib.axes import Axes
        from matplotlib.figure import Figure

        # three quarters of the time of a figure: it is drawn once more to find its layout, and the place of a title is
        # found by that of all ticks
        Figure.get_layout_engine = Axes._update_title_position = lambda *_: None
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(figures, "_matplotlib", without_layout)
        for module in (figures, mode_pictures, set_pictures):
            patch.setattr(module, "DOTS", 60)
        patch.setattr(mode_pictures, "MOVING_DOTS", 40)
        yield


@pytest.fixture(scope="session", autouse=True)
def flags_of_fmus():
    """The C compiler optimises no FMU, which takes it five times longer; returns the flags with which it does."""
    from hpcred.writers import fmu

    flags = fmu.FLAGS
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fmu, "FLAGS", tuple("-O0" if flag == "-O3" else flag for flag in flags))
        yield flags


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


def shared_folder(comm):
    path = comm.bcast(tempfile.mkdtemp() if comm.rank == 0 else None)
    yield Path(path)
    comm.Barrier()
    if comm.rank == 0:
        shutil.rmtree(path, ignore_errors=True)


@pytest.fixture
def folder(comm):
    """An empty folder that all ranks share."""
    yield from shared_folder(comm)


@pytest.fixture(scope="module")
def module_folder(comm):
    """An empty folder that all ranks share, for what the tests of a module need once."""
    yield from shared_folder(comm)


@pytest.fixture
def logger():
    """The logger "hpcred"; it and the root logger are afterwards as a session begins with them."""
    found = logging.getLogger("hpcred")
    yield found
    for each in (found, logging.getLogger()):
        for handler in each.handlers[:]:
            each.removeHandler(handler)
            handler.close()
    logging.disable(logging.NOTSET)
    found.disabled = False
    found.setLevel(logging.NOTSET)


@pytest.fixture
def reduced_linkage(folder, comm):
    """A function that makes a job of the linkage in the folder that all ranks share, and returns its result."""
    from helpers import MODES_JOB

    import hpcred as package
    from hpcred.cli.main import run

    with package.linkage(comm) as model:
        package.write_model(folder / "model.h5", model)

    def make(job=MODES_JOB):
        if comm.rank == 0:
            (folder / "job.toml").write_text(job)
        comm.Barrier()
        assert run(["reduce", str(folder / "job.toml")]) == 0
        return folder / "result.h5"

    return make


@pytest.fixture
def linkage_folder(tmp_path, monkeypatch):
    """A folder with the linkage as model.h5 and a good job."""
    from helpers import CHORD_JOB

    import hpcred as package

    monkeypatch.chdir(tmp_path)
    with package.linkage() as model:
        package.write_model("model.h5", model)
    Path("job.toml").write_text(CHORD_JOB)
    return tmp_path


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
