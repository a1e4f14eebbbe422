"""Diagnose BLAS, threads and page sizes of the machine."""

import ctypes
import os
import re
from pathlib import Path

UNKNOWN = "Prescott"  # of 2004: what OpenBLAS may take on an x86-64 that it does not know
PAGES = Path("/sys/kernel/mm/transparent_hugepage/enabled")
HUGE_PAGES = "glibc.malloc.hugetlb=1"  # asks for them, since glibc 2.35
CORETYPE = "OPENBLAS_CORETYPE"  # OpenBLAS reads it when it is loaded
SINCE_2013 = {  # kernels, from new to old, and the flag of a processor that supports them
    "SapphireRapids": "amx_bf16", "Cooperlake": "avx512_bf16", "SkylakeX": "avx512bw", "Haswell": "avx2",
}  # fmt: skip
PROCESSORS = Path("/proc/cpuinfo")
OTHERS = ("MKL_Get_Version", "bli_info_get_version_str", "ATL_buildinfo", "flexiblas_get_version", "armplversion")


class _Place(ctypes.Structure):
    """Dl_info of dladdr."""

    _fields_ = [
        ("file", ctypes.c_char_p), ("base", ctypes.c_void_p), ("name", ctypes.c_char_p), ("at", ctypes.c_void_p),
    ]  # fmt: skip


def blas() -> str:
    """PETSc's BLAS: "OpenBLAS 0.3.21, Haswell" with version and kernels, of others the file that has it, or ""."""
    library = _library()
    config = _config(library)
    if config is None:
        return _file_of(library, "dgemm_")
    version = re.search(r"OpenBLAS (\S+)", config)
    return f"OpenBLAS{' ' + version[1] if version else ''}, {_text(library.openblas_get_corename)}"


def hints(comm) -> tuple[str, ...]:
    """What slows the BLAS down on some rank, and what to do about it. Collective."""
    library = _library()
    config, made = _config(library), blas()
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if config is None:
        slow = reference_blas(made, any(hasattr(library, name) for name in OTHERS))
    else:
        there = [name for name in SINCE_2013 if hasattr(library, f"gotoblas_{name.upper()}")]
        slow = unknown_processor(made, there)
    mine = [slow, shared_cores(*threads_of(made), cores)]
    return tuple(dict.fromkeys(line for lines in comm.allgather(mine) for line in lines if line))


def flags() -> set[str]:
    """The flags of the processor, as Linux lists them; empty elsewhere."""
    try:
        return set(re.search(r"^flags.*", PROCESSORS.read_text(errors="replace"), re.MULTILINE)[0].split())
    except (OSError, TypeError):
        return set()


def unknown_processor(made, has, supported=None) -> str | None:
    """The hint for a BLAS (see blas) whose kernels are old ones; `has`: its better ones; `supported`: the flags of the
    processor."""
    if not made.endswith(f", {UNKNOWN}") or os.environ.get(CORETYPE):
        return None
    supported = flags() if supported is None else supported
    able = [name for name, flag in SINCE_2013.items() if flag in supported]
    if not able:
        return None
    better = next((name for name in able if name in has), None)
    return (
        f"{made.partition(',')[0]} takes the kernels of an old processor ({UNKNOWN}), with which factorisations of "
        "large models take about 1.5 times as long: "
        + (f"set {CORETYPE}={better} in the environment" if better else
           "it has none for this one; take a newer OpenBLAS, or one built with DYNAMIC_ARCH")
    )  # fmt: skip


def reference_blas(made, another: bool) -> str | None:
    """The hint for a BLAS (see blas) that is the reference one, of plain loops; `another`: has functions of others."""
    if another or not re.match(r"lib(blas|refblas|petsc)\b|libpetsc", made):
        return None
    return (
        f"the BLAS is the reference one ({made}), with which factorisations take several times as long: install "
        "OpenBLAS or another one that is made for the processor, and see to it that PETSc takes it"
    )


def threads_of(made) -> tuple[str, str]:
    """The variable by which a BLAS (see blas) is told its threads, and what it says."""
    name = "OPENBLAS" if made.startswith("OpenBLAS") else "MKL" if "mkl" in made else "OMP"
    return f"{name}_NUM_THREADS", os.environ.get(f"{name}_NUM_THREADS", "1")


def shared_cores(variable, threads, cores) -> str | None:
    """The hint for a rank with fewer cores than threads asked for, of which a BLAS then has no more than cores."""
    if not threads.isdecimal() or int(threads) <= cores:
        return None
    return (
        f"{variable}={threads}, but a rank may use {cores} core{'s' * (cores > 1)}: where there are more, "
        "Open MPI gives it more by `mpiexec --bind-to none`, and SLURM by --cpus-per-task"
    )


def small_pages() -> str | None:
    """The hint for a Linux that gives huge pages to those only who ask, where this process does not."""
    try:
        on_request = "[madvise]" in PAGES.read_text()
        name, _, version = (os.confstr("CS_GNU_LIBC_VERSION") or "").partition(" ")
    except (OSError, ValueError, AttributeError):
        return None
    able = name == "glibc" and tuple(map(int, re.findall(r"\d+", version))) >= (2, 35)
    if not (on_request and able) or "glibc.malloc.hugetlb" in os.environ.get("GLIBC_TUNABLES", ""):
        return None
    return f"memory comes in small pages: GLIBC_TUNABLES={HUGE_PAGES} saves large models a twentieth of the time"


def _library():
    """The library that PETSc has dgemm from, with those that it needs; PETSc where it is not known.

    LAPACK may be that of another BLAS, whose functions PETSc has too.
    """
    from petsc4py import PETSc

    petsc = ctypes.CDLL(PETSc.__file__)
    path = _path_of(petsc, "dgemm_")
    return ctypes.CDLL(path) if path else petsc


def _config(library):
    """How OpenBLAS was built; None: another BLAS, or one whose functions PETSc keeps to itself."""
    names = ("openblas_get_config", "openblas_get_corename")
    return _text(library.openblas_get_config) if all(hasattr(library, name) for name in names) else None


def _text(function):
    function.restype = ctypes.c_char_p
    return (function() or b"").decode(errors="replace").strip()


def _file_of(library, name):
    """The name of the file that a function of the library is in, or ""."""
    return Path(os.path.realpath(path)).name if (path := _path_of(library, name)) else ""


def _path_of(library, name):
    """The file that a function of the library is in, or ""."""
    here, place = ctypes.CDLL(None), _Place()
    if not hasattr(library, name) or not hasattr(here, "dladdr"):
        return ""
    if not here.dladdr(ctypes.cast(getattr(library, name), ctypes.c_void_p), ctypes.byref(place)):
        return ""
    return os.fsdecode(place.file)
