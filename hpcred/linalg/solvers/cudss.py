"""Factor on a GPU by NVIDIA's cuDSS, through nvmath-python.

The first rank of a communicator (all ranks, or a group) holds the matrix and its factor on a GPU. The others give it
their rows, the pattern once and values for each factor, and whole blocks of columns, in memory that they share on one
node. While it has the GPU work the others sleep, and their processors order with it.
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
from .base import IN_HOST, DoesNotFit, Factorisation
from .gpu_factor import GpuFactor, count_of_gpus, library, runtime

WIDTH = 24  # columns of a solve at most
COPIES = 4  # of them on the GPU: right-hand sides and solutions, residuals and corrections of their refinement
HELP = "`pip install 'hpcred[cuda13]'` (cuda12 for older drivers) brings nvmath-python and cuDSS; or take 'mumps'"
NO_GPU = "found no GPU of NVIDIA with its driver, or CUDA_VISIBLE_DEVICES hides it"
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
    _known = ""  # on the first rank

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
            what_helps = "`nvidia-smi` lists what there is; or take 'mumps'" if reason == NO_GPU else HELP
            raise InputError(f"solver.package: 'cudss' {reason}; {what_helps}")

    def estimate(self):
        """See Solver: of the memory of the GPUs, by an analysis, which the next factor uses."""
        return self._by_first_rank(self._estimated)

    def _estimated(self):
        if self._on_gpu is None:
            self._analyse()
        return float(self._need), free_mb(self._gpu)

    def known(self):
        """See Solver: where the factor will be, by the analysis."""
        return self._known, None

    def side_by_side(self):
        """See Solver: one on each GPU that some rank sees."""
        return len(set().union(*self._comm.allgather(gpus_seen())))

    def _factor(self):
        facts = self._by_first_rank(self._factored)
        self.analyses += facts.pop("analyses")
        self.source = PERTURBED if facts.get("null_pivots") else self.source_of(self.factoring, self.prefix)
        return facts

    def _by_first_rank(self, function):
        """What a function of the first rank returns, which has the matrix as it is now, on all; others sleep."""
        self._gather_matrix()
        result = None
        try:
            with agreed(self._comm):
                if self._leads:
                    with _failures():
                        result = function()
        except Exception:
            self.release()
            raise
        return self._comm.bcast(result)

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
        facts = {
            "analyses": int(new), "analysis_seconds": round(seconds, 4), "ordering": "METIS",
            "factor_entries": factor.entries, "memory_mb_estimated_total": self._need,
            "memory_mb_estimated_max_rank": self._need, "memory_mb_used_total": self._need,
            "memory_mb_used_max_rank": self._need,
        }  # fmt: skip
        if self._in_host:
            facts["package_because"] = self._in_host
        if self.counts() and self.kind == "LDL^T":
            facts |= {"negative_pivots": factor.inertia[1], "null_pivots": factor.perturbed}
        return facts

    def _analyse(self):
        """Order and analyse for the GPU; for the memory of the host too where the factor is larger than the GPU.
        Raises DoesNotFit."""
        self._plan()
        factor, columns = self._on_gpu, COPIES * WIDTH * (len(self._pattern[0]) - 1) * self._scalar.itemsize // MB
        self._need, self._in_host, free = factor.need // MB, "", free_mb(self._gpu)
        limit = free - columns - SPARE_MB
        if self._need <= limit:
            self._known = f"by cuDSS on GPU {self._gpu}, {self._need} MB"
            return
        least, host = factor.least // MB, self._need
        self._free()
        if not least or least > limit or host > self._host_mb:
            raise DoesNotFit(
                f"the factorisation does not fit: it needs about {self._need} MB on the GPU, which has {free:.0f} MB "
                f"free, or {least} MB there and {host} MB on the host, which has {self._host_mb:.0f} MB; take a GPU "
                "with more memory, solver.precision = 'single', or solver.package = 'mumps'"
            )
        self._in_host = f"{IN_HOST} of {self._need} MB, since the GPU has {free:.0f} MB free"
        self._plan(limit=int(limit * MB))
        self._known = f"by cuDSS on GPU {self._gpu}; {self._in_host}"

    def _plan(self, limit=0):
        self._on_gpu = GpuFactor(
            self._gpu, *self._pattern, self._values.whole, self.kind == "LDL^T", self._processors, limit
        )
        self._on_gpu.analyse()

    def _look_around(self):
        """The first rank has the processors of ranks that sleep beside it, and groups share the GPUs of a node."""
        mine = socket.gethostname(), os.sched_getaffinity(0)
        ranks = self._comm.gather(mine)
        if self._leads:
            beside = [processors for host, processors in ranks if host == mine[0]]
            self._processors, self._host_mb = _processors_of(beside), self._rank_mb * len(beside)
            self._gpu = own_gpu()

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
        shared = Parts(self._comm, len(array), 1, array.dtype)
        shared.gather(array[:, None])
        whole = shared.whole.copy() if self._leads else None
        shared.close()
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
        with agreed(self._comm):
            if self._leads:
                self._solve_on_gpu(b.shape[1])
        self._columns.scatter(x)

    def _solve_on_gpu(self, columns):
        """Replace so many right-hand sides by solutions; on the first rank."""
        shared = self._columns
        blocks = [(int(first), shared.place(rank, columns)) for rank, first in enumerate(shared.starts[:-1])]
        with _failures():
            self._on_gpu.lock(shared.whole)
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


def _processors_of(beside: list[set[int]]) -> set[int]:
    """The processors of ranks; where a launcher leaves all of a node to each rank, other groups have their part."""
    cores, ranks = sorted(set().union(*beside)), startup.ranks_on_node
    if len(cores) < ranks or any(processors != beside[0] for processors in beside):
        return set(cores)
    start = startup.rank_on_node * len(cores) // ranks
    return set(cores[start : start + len(beside) * len(cores) // ranks])


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
            return NO_GPU
        indptr, columns = np.array([[0, 1, 2], [0, 1, -1]], np.int32)
        factor = GpuFactor(own_gpu(), indptr, columns[:2], np.array([1.0, 2.0]), True, os.sched_getaffinity(0))
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


def own_gpu() -> int:
    """The GPU of this rank: ranks of a node share those that they see in turn, a group by its first rank. A launcher
    that binds a GPU to each rank shows it one."""
    return startup.rank_on_node * count_of_gpus() // startup.ranks_on_node


def gpus_seen() -> set[bytes]:
    """What tells the GPUs that this process sees from those of others."""
    if find_spec("nvmath") is None:
        return set()
    with suppress(Exception):
        return {runtime("cudaGetDeviceProperties", gpu).uuid.bytes for gpu in range(count_of_gpus())}
    return set()


def free_mb(gpu: int) -> float:
    """Free memory of a GPU."""
    runtime("cudaSetDevice", gpu)
    return runtime("cudaMemGetInfo")[0] / MB


def gpus_in_words() -> str:
    """The GPUs that this process sees, with their memory, and the library; or why there is nothing to use."""
    if reason := unusable():
        return f"not used: cuDSS {reason}"
    gpus = []
    for gpu in range(count_of_gpus()):
        properties = runtime("cudaGetDeviceProperties", gpu)
        gpus.append(f"{properties.name.decode()} ({properties.totalGlobalMem / 2**30:.0f} GB)")
    cudss = ".".join(str(library().get_property(part)) for part in range(3))
    return f"{', '.join(gpus)}; cuDSS {cudss} by nvmath-python {version('nvmath-python')}"
