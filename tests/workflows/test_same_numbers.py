"""The same job on any ranks, in groups, on both builds, and again: the same size, the same points, the same numbers."""

import subprocess
import sys

import h5py
import numpy as np
import pytest
from helpers import CHORD_JOB
from launch import TWO_BUILDS, mpi_environment

import hpcred as package
from hpcred.parallel.petsc import MPI

AUTOMATIC = CHORD_JOB.partition("[[basis]]")[0].replace("[frame]", "tolerance = 1e-6\nband = [1.0, 300.0]\n[frame]")
DAMPED = '[damping]\nkind = "rayleigh"\nalpha = 2.0\nbeta = 1e-5\n'  # near undamped poles round-off grows
MIXED = (
    CHORD_JOB + DAMPED + '[[basis]]\nkind = "modes"\nindex = [1, 2, 3]\n[[basis]]\nkind = "krylov"\nfrequency = 250.0\n'
    '[[basis]]\nkind = "krylov"\nfrequency = 20.0\norder = 2\n'
)
FREE = 'model = "model.h5"\ninputs = [[20, "z"], [1, "x"]]\ntolerance = 1e-5\nband = [0.0, 300.0]\n' \
       '[frame]\nkind = "buckens"\n' + DAMPED  # fmt: skip
JOBS = {"automatic": AUTOMATIC, "mixed": MIXED, "free": FREE}
GRID = np.linspace(3.0, 297.0, 25)
WAYS = [(2, 1, "real"), (3, 1, "real"), (4, 1, "real"), (2, 2, "real"), (4, 2, "real"), (4, 4, "real"),
        (1, 1, "complex"), (2, 1, "complex"), (3, 3, "complex")]  # fmt: skip
CORES = ("Haswell", "Sandybridge", "Prescott", "Nehalem")


def decisions(reduced):
    """What was chosen: the size, where points are with their columns, what each component kept."""
    record = reduced.record
    points = [] if record.accuracy is None else [(round(item.frequency, 9), item.columns)
                                                 for item in record.accuracy.points]  # fmt: skip
    return reduced.size, points, [(item.where, item.kept) for item in record.components]


def check_same(one, other, tolerance=1e-10):
    """Pseudo-frequencies above the band are those of shapes that the loads hardly move, and know fewer digits."""
    assert decisions(one) == decisions(other)
    check_numbers(one, other, tolerance)
    inside = one.frequencies < 300.0
    assert np.abs(other.frequencies / one.frequencies - 1)[inside].max() <= tolerance


def check_numbers(one, other, tolerance):
    assert one.size == other.size
    expected, found = (package.frequency_response(item, GRID) for item in (one, other))
    assert np.abs(found - expected).max() <= tolerance * np.abs(expected).max()


def bits(path):
    """All numbers of a result, as bytes."""
    with h5py.File(path) as file:
        return {f"{group}/{name}": item[...].tobytes() for group in ("reduced", "basis", "floating_frame")
                for name, item in file[group].items()}  # fmt: skip


def reduced_by(folder, name, ranks=1, groups=1, build="real"):
    """Run a job by a command of its own; the result."""
    launcher = ["mpiexec", "-n", str(ranks)] if ranks > 1 else []
    command = [*launcher, sys.executable, "-m", "hpcred", "reduce", "job.toml", "--set", f"output='{name}'",
               "--groups", str(groups), *(["--scalar", build] if TWO_BUILDS else [])]  # fmt: skip
    done = subprocess.run(command, cwd=folder, env=mpi_environment(), capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return package.read_result(folder / name).reduced


@pytest.fixture(params=JOBS)
def job(linkage_folder, request):
    (linkage_folder / "job.toml").write_text(JOBS[request.param])
    return linkage_folder


@pytest.mark.mpi
@pytest.mark.parametrize("name, groups", [("mixed", "auto"), pytest.param("automatic", 1, marks=pytest.mark.slow)])
def test_any_ranks_decide_as_one(comm, folder, name, groups):
    """Each rank reduces by itself what all reduce together."""
    with package.linkage(comm) as model:
        package.write_model(folder / "model.h5", model)
    if comm.rank == 0:
        (folder / "job.toml").write_text(JOBS[name])
    comm.Barrier()
    alone, together = folder / f"{comm.rank}.h5", folder / "together.h5"
    package.reduce_job(folder / "job.toml", overrides=[f"output='{alone}'"], comm=MPI.COMM_SELF)
    package.reduce_job(folder / "job.toml", overrides=[f"output='{together}'", f"groups={groups!r}"], comm=comm)
    check_same(*(package.read_result(path, comm).reduced for path in (alone, together)))


@pytest.mark.mpi(ranks=(2,))
def test_three_runs_of_one_process_are_bit_for_bit_equal(comm, folder):
    with package.linkage(comm) as model:
        package.write_model(folder / "model.h5", model)
    if comm.rank == 0:
        (folder / "job.toml").write_text(MIXED)
    comm.Barrier()
    for number in range(3):
        package.reduce_job(folder / "job.toml", overrides=[f"output='{folder / f'{number}.h5'}'"], comm=comm)
    found = [bits(folder / f"{number}.h5") for number in range(3)]
    assert len(found[0]) > 5 and all(other == found[0] for other in found[1:])


@pytest.mark.slow
def test_ranks_groups_and_builds(job):
    """A search in groups takes as many points at a time as there are groups, and that of the complex build, whose
    factors do not count modes, asks another point whether any is missing: they may take other points, to the same
    tolerance."""
    expected = reduced_by(job, "one.h5")
    for ranks, groups, build in WAYS:
        if build == "real" or TWO_BUILDS:
            found = reduced_by(job, "other.h5", ranks, groups, build)
            if expected.record.accuracy is not None and (groups > 1 or build == "complex"):
                check_numbers(expected, found, 2 * expected.record.accuracy.tolerance)
            else:
                check_same(expected, found)


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, 2, 3])
def test_five_runs_are_bit_for_bit_equal(job, ranks):
    found = []
    for number in range(5):
        reduced_by(job, f"{number}.h5", ranks)
        found.append(bits(job / f"{number}.h5"))
    assert all(other == found[0] for other in found[1:])


@pytest.mark.slow
@pytest.mark.parametrize("cores", [CORES[:2], CORES[1:3], CORES[::3]])
def test_mixed_kernels(job, cores):
    """Ranks with kernels of BLAS for different processors, as on a cluster of old and new nodes."""
    launcher = ["mpiexec"]
    words = ["-m", "hpcred", "reduce", "job.toml", "--set", "output='mixed.h5'"]
    for core in cores:
        launcher += [*([":"] if len(launcher) > 1 else []), "-n", "1", "-x", f"OPENBLAS_CORETYPE={core}",
                     sys.executable, *words]  # fmt: skip
    done = subprocess.run(launcher, cwd=job, env=mpi_environment(), capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    check_same(reduced_by(job, "one.h5", 2), package.read_result(job / "mixed.h5").reduced)
