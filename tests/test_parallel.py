"""That nothing hangs, and the same numbers on all ranks and builds."""

import time

import numpy as np
import pytest
from launch import TWO_BUILDS


def test_the_numbers_are_the_same_on_all_ranks_and_builds(hpcred, tmp_path):
    """Responses to 1e-9, on 1, 2, 3 and 4 ranks and in both builds."""
    import hpcred as package

    (tmp_path / "job.toml").write_text(
        """
        model = "model.h5"
        inputs = [[20, "z"], [1, "x"]]
        [frame]
        kind = "buckens"
        [damping]
        kind = "rayleigh"
        alpha = 2.0
        beta = 1e-5
        [[basis]]
        kind = "modes"
        count = 6
        [[basis]]
        kind = "krylov"
        frequency = 100.0
        order = 2
        """
    )
    assert hpcred("example", "linkage").returncode == 0
    cases = [(1, None), (2, None), (3, None), (4, None)]
    if TWO_BUILDS:
        cases += [(1, "complex"), (2, "complex")]
    responses = []
    for ranks, scalar in cases:
        run = hpcred(
            "reduce",
            "job.toml",
            *(["--scalar", scalar] if scalar else []),
            "--set",
            f"output=r{ranks}{scalar}.h5",
            ranks=ranks,
        )
        assert run.returncode == 0, run.stderr
        rom = package.read_result(tmp_path / f"r{ranks}{scalar}.h5")
        responses.append(package.frequency_response(rom, np.linspace(5, 300, 40)))
    for response in responses[1:]:
        assert package.relative_error(responses[0], response).max() < 1e-9


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
