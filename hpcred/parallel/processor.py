"""What is made of the processor: the kernels of the BLAS that MUMPS computes with, and cores for its threads."""

import ctypes
import os
import re
from pathlib import Path

UNKNOWN = "Prescott"  # of 2004: what OpenBLAS takes on an x86-64 that it does not know
KERNELS = (("avx512_bf16", "Cooperlake"), ("avx512bw", "SkylakeX"), ("avx2", "Haswell"))  # flag, who had it first


def blas() -> str:
    """Name, version and kernels of PETSc's BLAS, such as "OpenBLAS 0.3.21, Haswell"; others than OpenBLAS: ""."""
    library = _library()
    if not hasattr(library, "openblas_get_corename"):
        return ""
    name, version = _text(library.openblas_get_config).split()[:2]
    return f"{name} {version}, {_text(library.openblas_get_corename)}"


def hints(comm) -> tuple[str, ...]:
    """What slows the BLAS down on some rank, and what to do about it. Collective."""
    found = []
    made = blas()
    if made:
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        found += [unknown_processor(made), shared_cores(os.environ.get("OPENBLAS_NUM_THREADS", "1"), cores)]
    return tuple(dict.fromkeys(line for lines in comm.allgather(found) for line in lines if line))


def unknown_processor(made, flags=None) -> str | None:
    """The hint for a BLAS (see blas) whose kernels are those for unknown processors; `flags` of this one."""
    if not made.endswith(f", {UNKNOWN}") or os.environ.get("OPENBLAS_CORETYPE"):
        return None
    flags = _flags() if flags is None else flags
    kernels = next((kernels for flag, kernels in KERNELS if flag in flags), None)
    if kernels is None:
        return None
    return (
        f"{made.partition(',')[0]} does not know this processor and takes the kernels of an old one ({UNKNOWN}), which "
        f"are several times slower: set OPENBLAS_CORETYPE={kernels} in the environment"
    )


def shared_cores(threads, cores) -> str | None:
    """The hint for a rank with fewer cores than threads asked for, of which OpenBLAS then has no more than cores."""
    if not threads.isdigit() or int(threads) <= cores:
        return None
    return (
        f"OPENBLAS_NUM_THREADS={threads}, but a rank may use {cores} core{'s' * (cores > 1)}: Open MPI gives it more, "
        "where there are more, by `mpiexec --bind-to none`"
    )


def _library():
    """PETSc, by which the functions of its BLAS are found."""
    from petsc4py import PETSc

    return ctypes.CDLL(PETSc.__file__)


def _text(function):
    function.restype = ctypes.c_char_p
    return function().decode()


def _flags():
    """What the processor is able to, as Linux says it."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return set()
    found = re.search(r"^flags\s*:(.*)", text, re.MULTILINE)
    return set(found[1].split()) if found else set()
