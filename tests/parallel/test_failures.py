"""A fault on one rank ends the job on all, and an error of all is told once."""

import time

import pytest

PROGRAM = """
import hpcred, time
from hpcred.parallel.petsc import MPI
hpcred.linkage()
if MPI.COMM_WORLD.rank == 1:
    raise {error}
MPI.COMM_WORLD.Barrier()
time.sleep(60)
"""


@pytest.mark.parametrize("error", ["ValueError('only here')", "hpcred.InputError('only here')"])
def test_an_exception_on_one_rank_ends_the_job_on_all(hpcred, tmp_path, error):
    (tmp_path / "program.py").write_text(PROGRAM.format(error=error))
    start = time.monotonic()
    run = hpcred(program=("program.py",), ranks=2, timeout=50)
    assert run.returncode != 0
    assert "only here" in run.stderr
    assert time.monotonic() - start < 20


def test_an_error_of_all_ranks_is_told_once(hpcred):
    start = time.monotonic()
    run = hpcred("reduce", "missing.toml", ranks=2)
    assert run.returncode == 2
    assert run.stderr.count("missing.toml: no such file") == 1
    assert "Traceback" not in run.stderr
    assert time.monotonic() - start < 20
