"""Kernels of the BLAS, and cores for its threads."""

import ctypes.util
import json
import os
import platform
import subprocess
import sys

import pytest
from launch import TWO_BUILDS, mpi_environment
from mpi4py import MPI

import hpcred as package
from hpcred.parallel import processor
from hpcred.parallel.startup import start

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


ALL = ("Cooperlake", "SkylakeX", "Haswell")


@pytest.mark.parametrize(
    ("flags", "has", "kernels"),
    [
        ("fpu avx avx2", ALL, "Haswell"), ("avx2 avx512f avx512bw", ALL, "SkylakeX"),
        ("avx2 avx512bw avx512_bf16 amx_tile", ALL, "Cooperlake"),
        ("avx2 avx512bw avx512_bf16", ("SkylakeX", "Haswell"), "SkylakeX"),  # an older OpenBLAS
    ],
)  # fmt: skip
def test_kernels_for_a_processor_that_is_not_known(monkeypatch, flags, has, kernels):
    monkeypatch.delenv("OPENBLAS_CORETYPE", raising=False)
    said = processor.unknown_processor("OpenBLAS 0.3.21, Prescott", has, set(flags.split()))
    assert said.startswith("OpenBLAS 0.3.21 takes the kernels of an old processor")
    assert said.endswith(f"set OPENBLAS_CORETYPE={kernels} in the environment")
    assert processor.unknown_processor("OpenBLAS 0.3.21, Haswell", has, set(flags.split())) is None
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Prescott")
    assert processor.unknown_processor("OpenBLAS 0.3.21, Prescott", has, set(flags.split())) is None, "it was chosen"


def test_old_kernels_that_a_setting_does_not_change(monkeypatch):
    monkeypatch.delenv("OPENBLAS_CORETYPE", raising=False)
    said = processor.unknown_processor("OpenBLAS 0.3.21, Prescott", (), {"avx2"})
    assert said.endswith("take a newer OpenBLAS, or one built with DYNAMIC_ARCH") and "CORETYPE" not in said
    for flags in ({"sse2"}, set()):  # of an old processor; unknown, as on ARM and macOS
        assert processor.unknown_processor("OpenBLAS 0.3.21, Prescott", ALL, flags) is None


def test_a_rank_has_fewer_cores_than_threads():
    for fine in ("1", "many", "\u00b2", ""):
        assert processor.shared_cores("OMP_NUM_THREADS", fine, 1) is None
    said = processor.shared_cores("OMP_NUM_THREADS", "4", 2)
    assert "OMP_NUM_THREADS=4, but a rank may use 2 cores: where" in said


@pytest.mark.parametrize(
    "made, another, slow, variable",
    [
        ("libblas.so.3.11.0", False, True, "OMP"), ("libblas.3.dylib", False, True, "OMP"),
        ("libpetsc.so.3.20.1", False, True, "OMP"), ("libblas.so.3", True, False, "OMP"),
        ("libmkl_rt.so.2", True, False, "MKL"), ("libblis.so.4", False, False, "OMP"),
        ("libflexiblas.so.3.3", False, False, "OMP"), ("", False, False, "OMP"),
        ("OpenBLAS 0.3.21, Zen", False, False, "OPENBLAS"),
    ],
)  # fmt: skip
def test_a_reference_blas_is_named_and_each_is_told_its_threads(monkeypatch, made, another, slow, variable):
    for name in ("OPENBLAS", "MKL", "OMP"):
        monkeypatch.setenv(f"{name}_NUM_THREADS", "1")
    monkeypatch.setenv(f"{variable}_NUM_THREADS", "7")
    assert (processor.reference_blas(made, another) is not None) == slow
    assert processor.threads_of(made) == (f"{variable}_NUM_THREADS", "7")


class Library:
    """A BLAS with the functions of OpenBLAS: how it was built, and for what."""

    def __init__(self, config, corename):
        self.openblas_get_config, self.openblas_get_corename = (lambda: config), (lambda: corename)


@pytest.mark.parametrize(
    ("config", "said"),
    [
        (b"OpenBLAS 0.3.26.dev NO_LAPACKE DYNAMIC_ARCH Zen", "OpenBLAS 0.3.26.dev, Zen"),
        (b"NO_LAPACKE DYNAMIC_ARCH NO_AFFINITY", "OpenBLAS, Zen"), (b"", "OpenBLAS, Zen"),  # before 0.2.20
    ],
)  # fmt: skip
def test_what_openblas_says_of_itself(monkeypatch, config, said):
    monkeypatch.setattr(processor, "_library", lambda: Library(config, b"Zen"))
    assert processor.blas() == said


def test_another_blas_is_known_by_its_file(monkeypatch):
    made = ctypes.util.find_library("m")
    library = ctypes.CDLL(made)
    assert processor._file_of(library, "cos").startswith("libm"), "the file of a function of C"
    assert processor._file_of(library, "dgemm_of_nobody") == ""
    monkeypatch.setattr(processor, "_library", lambda: library)
    assert processor.blas() == "" and processor.hints(MPI.COMM_SELF) == ()


def test_the_blas_that_is_loaded():
    made, hints = found(OPENBLAS_NUM_THREADS="1")
    if not made.startswith("OpenBLAS"):
        pytest.skip(f"another BLAS than OpenBLAS: {made}")
    assert not [line for line in hints if "threads" in line.lower()]
    most = str(os.cpu_count() + 1)
    assert f"OPENBLAS_NUM_THREADS={most}, but" in found(OPENBLAS_NUM_THREADS=most)[1][-1]


def test_a_blas_beside_the_lapack_of_openblas_is_not_taken_for_it(monkeypatch, tmp_path):
    """As where Debian's alternatives name the reference BLAS: LAPACK brings OpenBLAS along, which computes nothing."""
    start()  # whose petsc4py is asked
    (tmp_path / "blas.c").write_text("void dgemm_(void) {} void stray(void) {}")
    made = tmp_path / "libblas.so.3.9"
    if subprocess.run(["cc", "-shared", "-fPIC", "-o", made, tmp_path / "blas.c"], capture_output=True).returncode:
        pytest.skip("no C compiler")
    plain = ctypes.CDLL(str(made))
    assert processor._path_of(plain, "stray") == str(made)
    monkeypatch.setattr(processor, "_path_of", lambda library, name: str(made))
    assert processor.blas() == "libblas.so.3.9"
    assert processor.hints(MPI.COMM_SELF)[0].startswith("the BLAS is the reference one (libblas.so.3.9)")


def test_debians_blas_takes_the_kernels_that_it_is_told():
    made, hints = found(OPENBLAS_CORETYPE="Prescott")
    if not TWO_BUILDS or platform.machine() != "x86_64" or not made.startswith("OpenBLAS"):
        pytest.skip("another PETSc, BLAS or processor")
    assert made.endswith(", Prescott") and not hints, "who names the kernels has chosen them"


def test_a_result_says_it(hpcred, tmp_path):
    package.write_model(tmp_path / "model.h5", package.solid((4, 2, 2)))
    (tmp_path / "job.toml").write_text(JOB)
    most = str(os.cpu_count() + 1)
    run = hpcred("reduce", "job.toml", "--json", "record.json", "--details", OPENBLAS_NUM_THREADS=most)
    assert run.returncode == 0, run.stderr
    record = json.loads((tmp_path / "record.json").read_text())
    assert record["versions"]["blas"] == (found()[0] or "unknown")
    assert not record["versions"]["blas"].startswith("OpenBLAS") or f"OPENBLAS_NUM_THREADS={most}" in run.stdout


@pytest.mark.parametrize(
    ("enabled", "glibc", "tunables", "said"),
    [
        ("always [madvise] never", "glibc 2.36", "", True),
        ("always [madvise] never", "glibc 2.36", "glibc.malloc.check=1", True),
        ("always [madvise] never", "glibc 2.36", "glibc.malloc.hugetlb=1", False),
        ("always [madvise] never", "glibc 2.36", "glibc.malloc.check=1:glibc.malloc.hugetlb=0", False),  # it was chosen
        ("always [madvise] never", "glibc 2.34", "", False),
        ("always [madvise] never", None, "", False),  # another C library
        ("[always] madvise never", "glibc 2.36", "", False),
        ("always madvise [never]", "glibc 2.36", "", False),
        (None, "glibc 2.36", "", False),  # a Linux without them
    ],
)  # fmt: skip
def test_pages_that_a_setting_makes_large(monkeypatch, tmp_path, enabled, glibc, tunables, said):
    if enabled is not None:
        (tmp_path / "enabled").write_text(enabled)
    monkeypatch.setattr(processor, "PAGES", tmp_path / "enabled")
    monkeypatch.setattr(os, "confstr", lambda name: glibc)
    monkeypatch.setenv("GLIBC_TUNABLES", tunables)
    found = processor.small_pages()
    assert (found is not None) == said
    assert not said or "GLIBC_TUNABLES=glibc.malloc.hugetlb=1 saves" in found


@pytest.mark.parametrize("given", [{}, {"OPENBLAS_NUM_THREADS": "2"}, {"OMP_NUM_THREADS": "2"}], ids=str)
def test_a_blas_that_numpy_has_loaded_before_takes_one_thread_too(given):
    """Unless the environment says how many."""
    threads = "{row['num_threads'] for row in threadpoolctl.threadpool_info() if row['user_api'] == 'blas'}"
    program = f"import numpy, threadpoolctl; before = {threads}; import hpcred; print(before, {threads}, sep='; ')"
    environment = {key: value for key, value in os.environ.items() if not key.endswith("_NUM_THREADS")}
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment | given)
    before, after = run.stdout.strip().split("; ")
    assert after == (before if given else "{1}")
