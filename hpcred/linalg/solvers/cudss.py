"""Factor on a GPU by NVIDIA's cuDSS, through nvmath-python.

The first rank of a communicator (all ranks, or a group) holds the matrix and its factor on a GPU. The others send it
their rows, the pattern once and values for each factor, and whole blocks of columns, which MPI puts in their places in
one array and takes from there. While the first rank works the others sleep, and their processors order with it.
"""

from __future__ import annotations

import logging
import os
import socket
import time
from contextlib import contextmanager
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import scipy.sparse

from ...parallel import startup
from ...parallel.decisions import decided
from ...parallel.failures import ComputationError, HpcredError, InputError, agreed
from ...parallel.memory import MB
from ...parallel.petsc import MPI, PETSc
from ..known import EXACT, Source
from .base import DoesNotFit, Factorisation

WIDTH = 12  # columns of a solve, fixed at the start: so many take little longer than one
HELP = "`pip install 'hpcred[cuda13]'` (cuda12 for older drivers) brings nvmath-python and cuDSS; or take 'mumps'"
NO_MEMORY = ("alloc_failed", "out of memory", "out_of_memory", "memory_allocation")  # in errors of the library
LOGGER = logging.getLogger("hpcred.cudss")
LOGGER.setLevel(logging.ERROR)  # its warnings tell programmers what a call costs
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
        self._solver = self._pattern = self._kept = None
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
        matrix, found = self._gathered_matrix(), None
        with agreed(self._comm):
            if self._leads:
                with _failures():
                    if self._solver is None:
                        self._analyse(matrix)
                    found = float(self._need), free_mb(self._gpu) * count_of_gpus()
        return self._comm.bcast(found)

    def _factor(self):
        matrix, found = self._gathered_matrix(), None
        try:
            with agreed(self._comm):
                if self._leads:
                    with _failures():
                        found = self._factored(matrix)
        except Exception:
            self.release()
            raise
        found = self._comm.bcast(found)
        self.analyses += found.pop("analyses")
        self.source = PERTURBED if found.get("null_pivots") else self.source_of(self.factoring, self.prefix)
        return found

    def _factored(self, matrix):
        """Factor on the GPU, with an analysis before the first factor."""
        seconds = 0.0
        if new := self._solver is None:
            start = time.perf_counter()
            self._analyse(matrix)
            seconds = time.perf_counter() - start
        else:
            self._solver.reset_operands(a=matrix)
        info = self._solver.factorize()
        found = {
            "analyses": int(new), "analysis_seconds": round(seconds, 4), "ordering": "METIS",
            "factor_entries": int(info.lu_nnz), "memory_mb_estimated_total": self._need,
            "memory_mb_estimated_max_rank": self._need, "memory_mb_used_total": self._need,
            "memory_mb_used_max_rank": self._need,
        }  # fmt: skip
        if self.counts() and self.kind == "LDL^T":
            found |= {"negative_pivots": int(info.inertia[1]), "null_pivots": int(info.npivots)}
        return found

    def _analyse(self, matrix):
        """Order and analyse for the GPU; for the memory of the host too where the factor is larger than the GPU.
        Raises DoesNotFit."""
        self._plan(matrix, hybrid=False)
        memory = self._solver.plan_info.memory_estimates
        self._need, free = int(memory.peak_device_memory) // MB, free_mb(self._gpu)
        if self._need + SPARE_MB <= free:
            return
        least, host = int(memory.hybrid_min_device_memory) // MB, self._need
        self.release()
        if not least or least + SPARE_MB > free or host > self._host_mb:
            raise DoesNotFit(
                f"the factorisation does not fit: it needs about {self._need} MB on the GPU, which has {free:.0f} MB "
                f"free, or {least} MB there and {host} MB on the host, which has {self._host_mb:.0f} MB; take a GPU "
                "with more memory, solver.precision = 'single', or solver.package = 'mumps'"
            )
        self._plan(matrix, hybrid=True)

    def _plan(self, matrix, hybrid):
        sparse = direct_solvers()
        symmetric = self.kind == "LDL^T"
        options = sparse.DirectSolverOptions(
            sparse_system_type=getattr(sparse.DirectSolverMatrixType, "SYMMETRIC" if symmetric else "GENERAL"),
            sparse_system_view=getattr(sparse.DirectSolverMatrixViewType, "LOWER" if symmetric else "FULL"),
            multithreading_lib=threads_library(), logger=LOGGER,
        )
        memory = sparse.HybridMemoryModeOptions(hybrid_memory_mode=hybrid)
        execution = sparse.ExecutionCUDA(device_id=self._gpu, hybrid_memory_mode_options=memory)
        self._columns = np.zeros((matrix.shape[0], WIDTH), dtype=self._scalar, order="F")
        self._solver = sparse.DirectSolver(matrix, self._columns, options=options, execution=execution)
        if options.multithreading_lib:
            self._solver.plan_config.host_nthreads = len(self._processors)
        with on_processors(self._processors):
            self._solver.plan()

    def _look_around(self):
        """The first rank has the processors of ranks that sleep beside it, and groups share the GPUs of a node."""
        mine = socket.gethostname(), os.sched_getaffinity(0)
        ranks = self._comm.gather(mine)
        if self._leads:
            beside = [processors for host, processors in ranks if host == mine[0]]
            self._processors, self._host_mb = set().union(*beside), self._rank_mb * len(beside)
            self._gpu = startup.rank_on_node * count_of_gpus() // startup.ranks_on_node

    # The matrix on the first rank in CSR: of symmetric ones the lower triangle

    def _gathered_matrix(self):
        """The matrix as it is now, on the first rank; None on others."""
        indptr, column, value = self.matrix.getValuesCSR()
        if self._kept is None:
            self._look_around()
            self._gather_pattern(indptr, column)
        values = self._gathered(value[self._kept].astype(self._scalar, copy=False))
        if not self._leads:
            return None
        indptr, column = self._pattern
        return scipy.sparse.csr_matrix((values, column, indptr), shape=(len(indptr) - 1,) * 2, copy=False)

    def _gather_pattern(self, indptr, column):
        """Choose the entries of this rank that the first one gets, and send it their places."""
        lengths, self._kept = np.diff(indptr), slice(None)
        if self.kind == "LDL^T":
            row = np.repeat(np.arange(len(lengths)), lengths)
            self._kept = np.flatnonzero(column <= row + self.matrix.getOwnershipRange()[0])
            lengths = np.bincount(row[self._kept], minlength=len(lengths))
        lengths, column = self._gathered(lengths), self._gathered(column[self._kept])
        if self._leads:
            indptr = np.concatenate([[0], np.cumsum(lengths, dtype=np.int64)])
            kind = np.int32 if indptr[-1] < 2**31 else np.int64
            self._pattern = indptr.astype(kind), column.astype(kind)

    def _gathered(self, part):
        """The parts of all ranks end to end on the first one; None on others."""
        if self._comm.size == 1:
            return part
        counts, requests, whole = self._comm.gather(len(part)), [], None
        if self._leads:
            whole, ends = np.empty(sum(counts), part.dtype), np.cumsum(counts)
            for rank in range(1, self._comm.size):
                requests.append(self._comm.Irecv(whole[ends[rank - 1] : ends[rank]], source=rank))
            whole[: ends[0]] = part
        else:
            requests.append(self._comm.Isend(np.ascontiguousarray(part), dest=0))
        MPI.Request.Waitall(requests)
        return whole

    # Columns

    def _solve(self, right, solution):
        b, x = right.getDenseArray(readonly=True), solution.getDenseArray()
        for start in range(0, b.shape[1], WIDTH):
            part = slice(start, min(start + WIDTH, b.shape[1]))
            self._move(np.asfortranarray(b[:, part], self._scalar), self._columns if self._leads else None)
            whole = None
            with agreed(self._comm):
                if self._leads:
                    with _failures():
                        self._columns[:, part.stop - start :] = 0.0
                        self._solver.reset_operands(b=self._columns)
                        whole = self._solver.solve()
            found = np.empty((b.shape[0], part.stop - start), self._scalar, order="F")
            self._move(found, whole, back=True)
            x[:, part] = found

    @property
    def _leads(self):
        return self._comm.rank == 0

    def _move(self, rows, whole, back=False):
        """Send rows (m, columns) of all ranks to their places in `whole` (n, at least so many columns) on the first
        one, or `back`; both in column order."""
        first, last = self.matrix.getOwnershipRange()
        if not self._leads:
            move = self._comm.Irecv if back else self._comm.Isend
            move(rows.T, 0).Wait()
            return
        requests, kinds, starts = [], [], self.matrix.getOwnershipRanges()
        entries, size = whole.reshape(-1, order="F"), whole.itemsize  # a view
        for rank in range(1, self._comm.size):
            low, high = starts[rank], starts[rank + 1]
            block = MPI.BYTE.Create_contiguous((high - low) * size)
            kinds += [block, block.Create_hvector(rows.shape[1], 1, len(whole) * size).Commit()]
            move = self._comm.Isend if back else self._comm.Irecv
            requests.append(move([entries[low:], 1, kinds[-1]], rank))
        if back:
            rows[...] = whole[first:last, : rows.shape[1]]
        else:
            whole[first:last, : rows.shape[1]] = rows
        MPI.Request.Waitall(requests)
        for kind in kinds:
            kind.Free()

    def release(self):
        if self._solver is not None:
            self._solver.free()
        self._solver = self._columns = None


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


def direct_solvers():
    """The module of nvmath-python that has DirectSolver, with the libraries that cuDSS looks for."""
    from cuda.pathfinder import load_nvidia_dynamic_lib

    for name in ("cublasLt", "cublas", "nvrtc"):
        load_nvidia_dynamic_lib(name)
    import nvmath.sparse.advanced

    return nvmath.sparse.advanced


@cache
def unusable() -> str | None:
    """Why this process cannot factor by cuDSS, found by a system of two equations; None where it can."""
    if find_spec("nvmath") is None:
        return "needs nvmath-python, which is not installed"
    try:
        if not count_of_gpus():
            return "found no GPU of NVIDIA, or CUDA_VISIBLE_DEVICES hides it"
        sparse, right = direct_solvers(), np.ones((2, 1), order="F")
        matrix, options = scipy.sparse.csr_matrix(np.diag([1.0, 2.0])), sparse.DirectSolverOptions(logger=LOGGER)
        with sparse.DirectSolver(matrix, right, options=options) as solver:
            solver.plan()
            solver.factorize()
            solution = solver.solve()
        return None if np.allclose(solution[:, 0], [1.0, 0.5]) else "solves two equations wrongly here"
    except Exception as error:
        text = " ".join(str(error).split())[:200]
        return f"cannot be used here ({type(error).__name__}: {text})"


def _runtime(name, *arguments):
    """Call a function of CUDA's runtime."""
    from cuda.bindings import runtime

    code, *found = getattr(runtime, name)(*arguments)
    if code != runtime.cudaError_t.cudaSuccess:
        raise RuntimeError(f"{name}: {runtime.cudaGetErrorString(code)[1].decode()}")
    return found[0] if len(found) == 1 else found


def count_of_gpus() -> int:
    """How many GPUs this process sees."""
    return _runtime("cudaGetDeviceCount")


def free_mb(gpu: int) -> float:
    """Free memory of a GPU."""
    _runtime("cudaSetDevice", gpu)
    return _runtime("cudaMemGetInfo")[0] / MB


def gpus_in_words() -> str:
    """The GPUs that this process sees, with their memory, and the library; or why there is nothing to use."""
    if reason := unusable():
        return f"not used: cuDSS {reason}"
    found = []
    for gpu in range(count_of_gpus()):
        properties = _runtime("cudaGetDeviceProperties", gpu)
        found.append(f"{properties.name.decode()} ({properties.totalGlobalMem / 2**30:.0f} GB)")
    return f"{', '.join(found)}; nvmath-python {version('nvmath-python')}"


def threads_library() -> str | None:
    """The library by which cuDSS orders with several threads, beside that of its wheel; or the user's choice."""
    if chosen := os.environ.get("CUDSS_THREADING_LIB"):
        return chosen
    wheels = find_spec("nvidia")
    folders = [] if wheels is None else map(Path, wheels.submodule_search_locations)
    found = [path for folder in folders for path in sorted(folder.glob("c*/lib/libcudss_mtlayer_gomp.so.*"))]
    return str(found[0]) if found else None


@contextmanager
def on_processors(processors):
    """Let the threads that start meanwhile run on processors that a launcher gave to ranks that sleep."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, processors)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)
