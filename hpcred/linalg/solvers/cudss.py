"""Factor on a GPU by NVIDIA's cuDSS, through nvmath-python.

The first rank of a communicator (all ranks, or a group) holds the matrix and its factor on a GPU. The others give it
their rows, the pattern once and values for each factor, and whole blocks of columns, in memory that they share on one
node. While it orders and factors the others sleep, and their processors order with it.
"""

from __future__ import annotations

import os
import socket
import time
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec

import numpy as np

from ...parallel import startup
from ...parallel.decisions import decided
from ...parallel.failures import ComputationError, HpcredError, InputError, agreed
from ...parallel.memory import MB
from ...parallel.parts import Parts
from ...parallel.petsc import PETSc
from ..known import EXACT, Source
from .base import DoesNotFit, Factorisation
from .gpu_factor import GpuFactor, runtime

WIDTH = 24  # columns of a solve at most
COPIES = 4  # of them on the GPU: right-hand sides and solutions, residuals and corrections of their refinement
HELP = "`pip install 'hpcred[cuda13]'` (cuda12 for older drivers) brings nvmath-python and cuDSS; or take 'mumps'"
NO_MEMORY = ("alloc_failed", "out of memory", "out_of_memory", "memory_allocation")  # in errors of the library
PERTURBED = Source(kind="approximate factor", accuracy=1e-8)  # with pivots that were too small
SPARE_MB = 512  # of the GPU, beside what the analysis says that the factor takes


class Cudss(Factorisation):
    """LDL^T, or LU of unsymmetric matrices, on one GPU a communicator.

    Pivots are sought inside of a supernode only, and tiny ones are perturbed: whoever solves checks the residual.
    Factors that the GPU has no room for are kept in the memory of the host. Options of PETSc do not reach cuDSS.
    """

    name = "cudss"
    tells_inertia = True
    has_single = True

    def __init__(self, matrix, symmetric, prefix, factoring=None, reserved_mb=0.0, inertia=False, null_pivots=False):
        super().__init__(matrix, symmetric, prefix, factoring, reserved_mb, inertia, null_pivots)
        self._comm = matrix.comm.tompi4py()
        self._on_gpu = self._values = self._columns = None
        self._scalar = np.dtype(PETSc.ScalarType)
        if self.factoring.single:
            self._scalar = np.dtype(np.complex64 if self._scalar.kind == "c" else np.float32)
        self._rank_mb = max(self.factoring.limit_mb(self._comm) - reserved_mb, 1.0)  # of the memory of the host

    @classmethod
    def source_of(cls, factoring, prefix):
        accuracy = float(np.finfo(np.float32).eps)
        return Source(kind="approximate factor", accuracy=accuracy) if factoring.single else EXACT

    def approximate(self):
        return super().approximate() or "solver.package: {} by cuDSS; take 'mumps', whose pivots are more stable"

    @classmethod
    def check_build(cls, comm):
        if reason := decided(comm, unusable):
            raise InputError(f"solver.package: 'cudss' {reason}; {HELP}")

    def estimate(self):
        """See Solver: of the memory of the GPUs, by an analysis, which the next factor uses."""
        self._gather_matrix()
        found = None
        with agreed(self._comm):
            if self._leads:
                with _failures():
                    if self._on_gpu is None:
                        self._analyse()
                    found = float(self._need), free_mb(self._gpu) * count_of_gpus()
        return self._comm.bcast(found)

    def _factor(self):
        self._gather_matrix()
        found = None
        try:
            with agreed(self._comm):
                if self._leads:
                    with _failures():
                        found = self._factored()
        except Exception:
            self.release()
            raise
        found = self._comm.bcast(found)
        self.analyses += found.pop("analyses")
        self.source = PERTURBED if found.get("null_pivots") else self.source_of(self.factoring, self.prefix)
        return found

    def _factored(self):
        """Factor on the GPU, with an analysis before the first factor."""
        seconds = 0.0
        if new := self._on_gpu is None:
            start = time.perf_counter()
            self._analyse()
            seconds = time.perf_counter() - start
        else:
            self._on_gpu.take(self._values.whole)
        factor = self._on_gpu
        factor.factorise()
        found = {
            "analyses": int(new), "analysis_seconds": round(seconds, 4), "ordering": "METIS",
            "factor_entries": factor.entries, "memory_mb_estimated_total": self._need,
            "memory_mb_estimated_max_rank": self._need, "memory_mb_used_total": self._need,
            "memory_mb_used_max_rank": self._need,
        }  # fmt: skip
        if self.counts() and self.kind == "LDL^T":
            found |= {"negative_pivots": factor.inertia[1], "null_pivots": factor.perturbed}
        return found

    def _analyse(self):
        """Order and analyse for the GPU; for the memory of the host too where the factor is larger than the GPU.
        Raises DoesNotFit."""
        self._plan(hybrid=False)
        factor, columns = self._on_gpu, COPIES * WIDTH * (len(self._pattern[0]) - 1) * self._scalar.itemsize // MB
        self._need, free = factor.need // MB, free_mb(self._gpu)
        if self._need + columns + SPARE_MB <= free:
            return
        least, host = factor.least // MB, self._need
        self._free()
        if not least or least + columns + SPARE_MB > free or host > self._host_mb:
            raise DoesNotFit(
                f"the factorisation does not fit: it needs about {self._need} MB on the GPU, which has {free:.0f} MB "
                f"free, or {least} MB there and {host} MB on the host, which has {self._host_mb:.0f} MB; take a GPU "
                "with more memory, solver.precision = 'single', or solver.package = 'mumps'"
            )
        self._plan(hybrid=True)

    def _plan(self, hybrid):
        self._on_gpu = GpuFactor(
            self._gpu, *self._pattern, self._values.whole, self.kind == "LDL^T", self._processors, hybrid
        )
        self._on_gpu.analyse()

    def _look_around(self):
        """The first rank has the processors of ranks that sleep beside it, and groups share the GPUs of a node."""
        mine = socket.gethostname(), os.sched_getaffinity(0)
        ranks = self._comm.gather(mine)
        if self._leads:
            beside = [processors for host, processors in ranks if host == mine[0]]
            self._processors, self._host_mb = set().union(*beside), self._rank_mb * len(beside)
            self._gpu = startup.rank_on_node * count_of_gpus() // startup.ranks_on_node

    # The matrix on the first rank in CSR: of symmetric ones the lower triangle

    def _gather_matrix(self):
        """Have the matrix as it is now on the first rank."""
        indptr, column, value = self.matrix.getValuesCSR()
        if self._values is None:
            self._look_around()
            self._gather_pattern(indptr, column)
        self._values.gather(value[self._kept][:, None])

    def _gather_pattern(self, indptr, column):
        """Choose the entries of this rank that the first one gets, and send it their places."""
        lengths, self._kept = np.diff(indptr), slice(None)
        if self.kind == "LDL^T":
            row = np.repeat(np.arange(len(lengths)), lengths)
            self._kept = np.flatnonzero(column <= row + self.matrix.getOwnershipRange()[0])
            lengths = np.bincount(row[self._kept], minlength=len(lengths))
        column = column[self._kept]
        self._values = Parts(self._comm, len(column), 1, self._scalar)
        lengths, column = (self._gathered(array) for array in (lengths, column))
        if self._leads:
            indptr = np.concatenate([[0], np.cumsum(lengths, dtype=np.int64)])
            kind = np.int32 if indptr[-1] < 2**31 else np.int64
            self._pattern = indptr.astype(kind), column.astype(kind, copy=False)

    def _gathered(self, array):
        """The parts of all ranks end to end on the first one."""
        parts = Parts(self._comm, len(array), 1, array.dtype)
        parts.gather(array[:, None])
        whole = parts.whole.copy() if self._leads else None
        parts.close()
        return whole

    # Columns

    def _solve(self, right, solution):
        b, x = right.getDenseArray(readonly=True), solution.getDenseArray()
        for start in range(0, b.shape[1], WIDTH):
            columns = slice(start, min(start + WIDTH, b.shape[1]))
            self._solve_columns(b[:, columns], x[:, columns])

    def _solve_columns(self, b, x):
        if self._columns is None or self._columns.columns < b.shape[1]:
            self._forget_columns()
            self._columns = Parts(self._comm, len(b), b.shape[1], self._scalar)
        self._columns.gather(b)
        decided(self._comm, self._solve_on_gpu, b.shape[1])  # ranks that slept would come late for so short a time
        self._columns.scatter(x)

    def _solve_on_gpu(self, columns):
        """Replace so many right-hand sides by solutions; on the first rank."""
        parts = self._columns
        blocks = [(int(first), parts.place(rank, columns)) for rank, first in enumerate(parts.starts[:-1])]
        with _failures():
            self._on_gpu.lock(parts.whole)
            self._on_gpu.solve(blocks)

    @property
    def _leads(self):
        return self._comm.rank == 0

    def _free(self):
        """Free the GPU. Local."""
        if self._on_gpu is not None:
            with suppress(Exception):  # after an error of a GPU nothing can be freed, and that error counts
                self._on_gpu.free()
        self._on_gpu = None

    def _forget_columns(self):
        """Free the memory of columns on the host."""
        if self._on_gpu is not None:
            with suppress(Exception):
                self._on_gpu.unlock()
        if self._columns is not None:
            self._columns.close()
        self._columns = None

    def release(self):
        self._forget_columns()
        self._free()

    def close(self):
        self.release()
        if self._values is not None:
            self._values.close()
        self._values = None


@contextmanager
def _failures():
    """Errors of the library as ours. Raises DoesNotFit, ComputationError."""
    try:
        yield
    except HpcredError:
        raise
    except Exception as error:
        text = " ".join(str(error).split())[:300]
        if isinstance(error, MemoryError) or any(words in text.lower() for words in NO_MEMORY):
            raise DoesNotFit("the factorisation does not fit: the GPU has no more memory; take one with more, "
                             "solver.precision = 'single', or solver.package = 'mumps'") from error  # fmt: skip
        raise ComputationError(f"cuDSS failed: {type(error).__name__}: {text}") from error


@cache
def unusable() -> str | None:
    """Why this process cannot factor by cuDSS, found by a system of two equations; None where it can."""
    if find_spec("nvmath") is None:
        return "needs nvmath-python, which is not installed"
    try:
        if not count_of_gpus():
            return "found no GPU of NVIDIA, or CUDA_VISIBLE_DEVICES hides it"
        indptr, columns = np.array([[0, 1, 2], [0, 1, -1]], np.int32)
        factor = GpuFactor(0, indptr, columns[:2], np.array([1.0, 2.0]), True, os.sched_getaffinity(0))
        try:
            factor.analyse()
            factor.factorise()
            factor.solve([(0, solution := np.ones((2, 1), order="F"))])
        finally:
            with suppress(Exception):
                factor.free()
        return None if np.allclose(solution[:, 0], [1.0, 0.5]) else "solves two equations wrongly here"
    except Exception as error:
        text = " ".join(str(error).split())[:200]
        return f"cannot be used here ({type(error).__name__}: {text})"


def count_of_gpus() -> int:
    """How many GPUs this process sees."""
    return runtime("cudaGetDeviceCount")


def free_mb(gpu: int) -> float:
    """Free memory of a GPU."""
    runtime("cudaSetDevice", gpu)
    return runtime("cudaMemGetInfo")[0] / MB


def gpus_in_words() -> str:
    """The GPUs that this process sees, with their memory, and the library; or why there is nothing to use."""
    if reason := unusable():
        return f"not used: cuDSS {reason}"
    found = []
    for gpu in range(count_of_gpus()):
        properties = runtime("cudaGetDeviceProperties", gpu)
        found.append(f"{properties.name.decode()} ({properties.totalGlobalMem / 2**30:.0f} GB)")
    return f"{', '.join(found)}; nvmath-python {version('nvmath-python')}"
