"""Kernels of the BLAS, and cores for its threads."""

import json
import os
import subprocess
import sys

import pytest
from launch import mpi_environment

from hpcred.parallel import processor

JOB = 'model = "model.h5"\n[[basis]]\nkind = "krylov"\nfrequency = 100.0\n'
PROGRAM = """
import json, hpcred
from hpcred.parallel import processor, startup
hpcred.start()
print(json.dumps([processor.blas(), processor.hints(startup.start_mpi())]))
"""


def found(**environment):
    """What a process of its own says of its BLAS, and its hints."""
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, env=mpi_environment(**environment)
    )
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


@pytest.mark.parametrize(
    ("flags", "kernels"),
    [
        ("fpu avx avx2", "Haswell"), ("avx2 avx512f avx512bw", "SkylakeX"),
        ("avx2 avx512bw avx512_bf16 amx_tile", "Cooperlake"), ("sse2", None), ("", None),
    ],
)  # fmt: skip
def test_kernels_for_a_processor_that_is_not_known(flags, kernels):
    said = processor.unknown_processor("OpenBLAS 0.3.21, Prescott", set(flags.split()))
    assert (said or "").endswith(f"set OPENBLAS_CORETYPE={kernels} in the environment") == (kernels is not None)
    assert processor.unknown_processor("OpenBLAS 0.3.21, Haswell", {"avx512bw"}) is None


def test_a_rank_has_fewer_cores_than_threads():
    assert processor.shared_cores("1", 1) is None and processor.shared_cores("many", 1) is None
    assert "OPENBLAS_NUM_THREADS=4, but a rank may use 2 cores: Open MPI" in processor.shared_cores("4", 2)


@pytest.mark.skipif(not found()[0], reason="another BLAS than OpenBLAS")
def test_the_blas_that_is_loaded():
    made, hints = found(OPENBLAS_NUM_THREADS="1")
    assert made.startswith("OpenBLAS 0.") and not [line for line in hints if "threads" in line.lower()]
    most = str(os.cpu_count() + 1)
    assert f"OPENBLAS_NUM_THREADS={most}, but" in found(OPENBLAS_NUM_THREADS=most)[1][-1]
    if os.uname().machine == "x86_64":
        made, hints = found(OPENBLAS_CORETYPE="Prescott")
        assert made.endswith(", Prescott") and not hints, "who names the kernels has chosen them"


def test_a_result_says_it(hpcred, tmp_path):
    assert hpcred("example", "solid", "--cells", 4, 2, 2).returncode == 0
    (tmp_path / "job.toml").write_text(JOB)
    most = str(os.cpu_count() + 1)
    run = hpcred("reduce", "job.toml", "--json", "record.json", ranks=2, OPENBLAS_NUM_THREADS=most)
    assert run.returncode == 0, run.stderr
    record = json.loads((tmp_path / "record.json").read_text())
    assert record["versions"]["blas"] == (found()[0] or "unknown")
    assert not record["versions"]["blas"].startswith("OpenBLAS") or f"OPENBLAS_NUM_THREADS={most}" in run.stdout
