"""A fault on one rank ends the job on all, and an error of all is told once."""

import os
import threading

import pytest

from hpcred.parallel import decisions, failures
from hpcred.parallel.decisions import decided, decided_with
from hpcred.parallel.failures import InputError, Owned, agreed


@pytest.mark.parametrize("error, reason, memory", [
    (OSError(22, "Invalid argument", "/proc/self/mem"), "Invalid argument", False),  # a file that cannot be read so
    (OSError("file read failed: errno = 22, offset = 9223372036854775808)"), None, False),  # of a damaged file
    (OSError("file read failed: errno = 22, buf = 0x7,\n offset = 2048)"), "Invalid argument", False),
    (OSError("file read failed: errno = 22, error message = 'Invalid argument'"), None, False),
    (OSError("file read failed: errno = 5"), "Input/output error", False), (ValueError("errno 22"), None, False),
    (MemoryError(), None, True), (RuntimeError("MUMPS: INFOG(1)=-13"), None, False),
])  # fmt: skip
def test_what_the_system_refuses(error, reason, memory):
    assert failures.reason_of(error) == reason and failures.is_out_of_memory(error) == memory


@pytest.mark.parametrize("code, text, memory", [
    (55, "out of memory", True), (76, "MUMPS error in solve phase: INFOG(1)=-13, INFO(2)=4", True),
    (76, "error in numerical factorization: INFOG(1)=-7", True), (76, "INFOG(1)=-137", False),
    (76, "INFOG(1)=-10", False), (62, "INFOG(1)=-13", False),
])  # fmt: skip
def test_memory_that_petsc_and_mumps_did_not_get(code, text, memory, capsys):
    error = RuntimeError(text)
    error.ierr = code
    assert failures.is_out_of_memory(error) == memory
    failures._say(error)
    assert ("out of memory; take more ranks" in capsys.readouterr().err) == memory


PROGRAM = """
import hpcred, time
from hpcred.parallel.petsc import MPI
hpcred.linkage()
if MPI.COMM_WORLD.rank == 1:
    raise {error}
MPI.COMM_WORLD.Barrier()
time.sleep(200)
"""


@pytest.mark.parametrize("error", ["ValueError('only here')", "hpcred.InputError('only here')"])
def test_an_exception_on_one_rank_ends_the_job_on_all(hpcred, tmp_path, error):
    (tmp_path / "program.py").write_text(PROGRAM.format(error=error))
    run = hpcred(program=("program.py",), ranks=2, timeout=100)
    assert run.returncode != 0
    assert "only here" in run.stderr and "program.py\", line 6, in <module>" in run.stderr
    assert "hpcred: this error (rank 1) is not that of all ranks, and ends the job" in run.stderr


def test_what_was_printed_is_read_before_the_job_ends(tmp_path):
    """A launcher ends all at once, also what it has not passed on; nobody waits for ever for one that does not read."""
    reading, writing = os.pipe()
    with open(reading) as reader, open(writing, "w") as stream:
        stream.write("only here\n")
        failures.await_reader(stream, patience=0.02)
        waiting = threading.Thread(target=failures.await_reader, args=(stream, 60.0))
        waiting.start()
        waiting.join(0.05)
        assert waiting.is_alive() and reader.readline() == "only here\n"
        waiting.join(30.0)
        assert not waiting.is_alive()
    with open(tmp_path / "log", "w") as stream:
        stream.write("only here\n")
        failures.await_reader(stream, 60.0)
        assert (tmp_path / "log").read_text() == "only here\n"
    failures.await_reader(stream, 60.0)  # closed
    failures.await_reader(None, 60.0)


def test_an_error_of_all_ranks_is_told_once(hpcred):
    run = hpcred("reduce", "missing.toml", ranks=2)
    assert run.returncode == 2
    assert run.stderr.count("missing.toml: no such file") == 1
    assert "Traceback" not in run.stderr


UNLOADED = """
import os, sys
if "1" in (os.environ.get("OMPI_COMM_WORLD_RANK"), os.environ.get("PMI_RANK")):  # of Open MPI, MPICH
    sys.modules["h5py"] = None
from hpcred.__main__ import main
main()
"""


def test_a_module_that_one_rank_cannot_load_ends_the_job_on_all(hpcred, tmp_path):
    """MPI is there by then, and waits at the end of a process for the others."""
    (tmp_path / "program.py").write_text(UNLOADED)
    run = hpcred("--version", program=("program.py",), ranks=2, timeout=100)
    assert run.returncode == 1
    said = [line for line in run.stderr.splitlines() if line.startswith("hpcred: ")]
    assert any("h5py" in line for line in said) and "Traceback" not in run.stderr


FAULTS = {
    "in agreed, alone": """
with agreed(comm):
    if comm.rank == 1:
        raise {error}
""",
    "among collective calls": """
with hpcred.linkage() as model:
    basis = Basis(model.M)
    block = from_dense(model.B)
    if comm.rank == 1:
        def fault(*_):
            raise {error}
        basis._append = fault
    with Owned(comm):
        for _ in range(3):
            basis.extend(block)
            comm.allreduce(1.0)
""",
    "while a file is written": """
with writing("out.h5", comm) as file:
    file.attribute("format", "x")
    if comm.rank == 1:
        raise {error}
    file.rows("data", np.ones(5))
""",
    "in a group of ranks": """
with hpcred.linkage() as model:
    solve = ShiftedSolver.solve
    def fault(self, *arguments):
        if comm.rank == comm.size - 1:
            raise {error}
        return solve(self, *arguments)
    ShiftedSolver.solve = fault
    hpcred.reduce(model, [hpcred.Krylov(50.0, 3), hpcred.Krylov(150.0, 3)], hpcred.Buckens(), groups=2)
""",
}
HEAD = """
import numpy as np
import hpcred
from hpcred.files.hdf5 import writing
from hpcred.linalg.basis import Basis
from hpcred.linalg.blocks import from_dense
from hpcred.linalg.solvers.shifted import ShiftedSolver
from hpcred.parallel.failures import Owned, agreed
from hpcred.parallel.petsc import MPI
comm = MPI.COMM_WORLD
"""


@pytest.mark.parametrize("error", [
    "MemoryError('only here')", pytest.param("KeyboardInterrupt('only here')", marks=pytest.mark.slow)])
@pytest.mark.parametrize("place", FAULTS)
def test_a_fault_of_one_rank_ends_all_in_seconds(hpcred, tmp_path, place, error):
    (tmp_path / "program.py").write_text(HEAD + FAULTS[place].format(error=error))
    run = hpcred(program=("program.py",), ranks=2, timeout=100)
    assert run.returncode != 0
    assert not list(tmp_path.glob("*.tmp-*")) and not (tmp_path / "out.h5").exists()


@pytest.mark.mpi(ranks=(2, 3))
def test_an_error_of_one_rank_is_raised_on_all(comm):
    with pytest.raises(InputError, match="rank 1 says no"), agreed(comm):
        if comm.rank == 1:
            raise InputError("rank 1 says no")
    assert comm.allreduce(1) == comm.size


@pytest.mark.mpi(ranks=(2, 3))
def test_an_error_that_cannot_be_sent_is_told_all_the_same(comm):
    class Local(Exception):
        pass

    with pytest.raises(Exception, match="not to be sent"), agreed(comm):
        if comm.rank == 1:
            raise Local("not to be sent")


@pytest.mark.mpi
def test_decisions_are_those_of_rank_0(comm):
    assert decided(comm, lambda: comm.rank) == 0
    with pytest.raises(ZeroDivisionError):
        decided(comm, lambda: 1 // comm.rank)


@pytest.mark.mpi
def test_owned_things_are_closed_after_a_common_error(comm):
    closed = []

    class Thing:
        def close(self):
            closed.append(1)

    with pytest.raises(InputError), Owned(comm) as owned:
        owned.owns(Thing())
        raise InputError("on all ranks")
    assert closed == [1]


def test_the_reason_of_petsc_is_said(capsys):
    """Of its lines the first has the code only, the last what was wrong."""
    from hpcred.parallel.petsc import PETSc

    with pytest.raises(PETSc.Error) as caught:
        PETSc.Vec().create(comm=PETSc.COMM_SELF).setType("nonsense")
    failures._say(caught.value)
    assert "Unknown vector type: nonsense" in capsys.readouterr().err


@pytest.mark.parametrize(
    "value, shown", [("1", True), ("yes", True), ("0", False), ("", False), ("false", False), ("No", False)]
)
def test_the_environment_switches_tracebacks_on_and_off(monkeypatch, capsys, value, shown):
    monkeypatch.setenv("HPCRED_TRACEBACK", value)
    failures.fail(failures.common_to(failures.MPI.COMM_WORLD, InputError("a sentence")))
    said = capsys.readouterr().err
    assert said.endswith("hpcred: error: a sentence\n")
    assert ("InputError: a sentence" in said) == shown


def ranks_of(place, items):
    place.made["sum"] = place.made.get("sum", 0) + len(place.share(items))
    return place.rank, place.made["sum"]


def fails_on(place, rank):
    if place.rank == rank:
        raise ValueError(f"no such number on rank {place.rank}")


@pytest.mark.mpi(ranks=(1, 2, 3))
@pytest.mark.parametrize("most", [32, 2])
def test_a_team_computes_parts_of_a_decision(comm, most, monkeypatch):
    """Each rank its share, and with what it has made before; rank 0 alone decides, and ranks beyond the most follow."""
    monkeypatch.setattr(decisions, "MOST", most)

    def decision(team, count):
        first, second = team.each(ranks_of, range(count)), team.each(ranks_of, range(count))
        return [rank for rank, _ in first], sum(made for _, made in second)

    for _ in range(2):  # nothing is left of the first for the second
        assert decided_with(comm, decision, 7) == (list(range(min(comm.size, most))), 14)


@pytest.mark.mpi(ranks=(2, 3))
@pytest.mark.parametrize("rank", [0, 1])
def test_what_a_member_of_a_team_raises_is_raised_on_all(comm, rank):
    with pytest.raises(ValueError, match=f"no such number on rank {rank}"):
        decided_with(comm, lambda team: team.each(fails_on, rank))
    with pytest.raises(ZeroDivisionError):
        decided_with(comm, lambda team: 1 // comm.rank)
    assert decided_with(comm, lambda team: team.size) == comm.size
