"""Hold a sparse matrix, its factor by cuDSS and columns on a GPU, through the bindings of nvmath-python.

Nothing here is collective: one process owns the factor. Errors are those of the bindings.
"""

from __future__ import annotations

import ctypes
import os
from contextlib import contextmanager, suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from ..refinement import REFINE_ABOVE

KINDS = {"f4": 0, "f8": 1, "c8": 4, "c16": 5, "i4": 10, "i8": 24}  # of numbers, as cudaDataType has them
ESTIMATES = 16  # numbers of the estimate of memory, of which two are used here:
PEAK, LEAST = 1, 4  # of the GPU, and of that where the memory of the host has the factor
REFINED, STEPS = REFINE_ABOVE / 2, 2  # residual that cuDSS refines to, which is cheaper there, in so many steps at most


class GpuFactor:
    """The factor LDL^T, or LU, on a GPU of a matrix in CSR, of whose symmetric ones the lower triangle is given.

    `values` of the matrix, like columns, are arrays of the host; `processors`: for the threads of the analysis;
    `limit`: bytes of the GPU that may be taken where the memory of the host has the factor, 0 where the GPU has it.
    After analyse(): `need`, `least` (bytes): of the GPU, without and with the memory of the host for the factor. After
    factorise(): `entries` of the factor, `inertia` (positive, negative) and `perturbed` pivots. Call free().
    """

    def __init__(self, gpu: int, indptr, indices, values, symmetric: bool, processors, limit=0):
        self._gpu, self._processors, self._dtype, self._index = gpu, processors, values.dtype, indices.dtype
        self.size, self._library = len(indptr) - 1, library()
        self._memory, self._locked, self._columns, self._dense = {}, {}, 0, []
        self._handle = self._config = self._data = self._matrix = 0
        try:
            self._create(indptr, indices, values, symmetric, limit)
        except BaseException:
            with suppress(Exception):  # after an error of a GPU nothing can be freed, and that error counts
                self.free()
            raise

    def _create(self, indptr, indices, values, symmetric, limit):
        cudss = self._library
        runtime("cudaSetDevice", self._gpu)
        self._handle, self._config = cudss.create(), cudss.config_create()
        self._data = cudss.data_create(self._handle)
        if threads := threads_library():
            cudss.set_threading_layer(self._handle, threads)
            self._set("HOST_NTHREADS", len(self._processors))
        if limit:  # by itself cuDSS takes all of the GPU, though others may be there
            self._set("HYBRID_MEMORY_MODE", 1)
            self._set("HYBRID_DEVICE_MEMORY_LIMIT", limit)
        if np.finfo(self._dtype).eps < REFINED:
            self._set("IR_N_STEPS", STEPS)
            self._set("IR_TOL", REFINED)
        kind, view = ("SYMMETRIC", "LOWER") if symmetric else ("GENERAL", "FULL")
        places = [self._copied(name, array) for name, array in (("rows", indptr), ("columns", indices))]
        self._matrix = cudss.matrix_create_csr(
            self.size, self.size, len(indices), places[0], 0, places[1], self._copied("values", values),
            _kind(indptr.dtype), _kind(indices.dtype), _kind(self._dtype), cudss.MatrixType[kind],
            cudss.MatrixViewType[view], cudss.IndexBase.ZERO,
        )  # fmt: skip
        self._make_room(1)

    def analyse(self):
        """Order the matrix, and find out what its factor needs."""
        with on_processors(self._processors):
            self._execute("ANALYSIS")
        estimates = self._get("MEMORY_ESTIMATES", np.zeros(ESTIMATES, np.int64))
        self.need, self.least = int(estimates[PEAK]), int(estimates[LEAST])

    def take(self, values: np.ndarray):
        """Have other values."""
        self._copied("values", values)

    def factorise(self):
        self._execute("FACTORIZATION")
        self.entries = int(self._get("LU_NNZ", np.zeros(1, np.int64))[0])
        self.perturbed = int(self._get("NPIVOTS", np.zeros(1, self._index))[0])
        self.inertia = tuple(map(int, self._get("INERTIA", np.zeros(2, self._index))))

    def solve(self, blocks: list[tuple[int, np.ndarray]]):
        """Replace right-hand sides by solutions: blocks (rows, k) in column order, each with its first row. Residuals
        that stay large are no error here."""
        self._make_room(blocks[0][1].shape[1])
        self._move(blocks, "right", to_gpu=True)
        try:
            self._execute("SOLVE")
        except self._library.cuDSSError as error:
            if "IR_FAILED" not in str(error):
                raise
        self._move(blocks, "solution", to_gpu=False)

    def lock(self, array: np.ndarray):
        """Keep an array of the host, which is copied again and again, at its place in the memory: copies are faster
        then. It must live until unlock() or free()."""
        place = array.ctypes.data
        if array.size and place not in self._locked:
            self._locked[place] = array
            try:
                runtime("cudaHostRegister", place, array.nbytes, 0)
            except RuntimeError:  # a system may not allow that, which is not asked again
                self._locked[place] = None
                with suppress(RuntimeError):  # the call raises the last error, which it has CUDA forget
                    runtime("cudaGetLastError")

    def unlock(self):
        """Let go of these arrays."""
        while self._locked:
            place, array = self._locked.popitem()
            if array is not None:
                runtime("cudaHostUnregister", place)

    def _execute(self, phase):
        runtime("cudaSetDevice", self._gpu)
        right, solution = self._dense
        self._library.execute(
            self._handle, self._library.Phase[phase], self._config, self._data, self._matrix, solution, right
        )
        runtime("cudaDeviceSynchronize")

    def _set(self, name, value):
        value = np.array([value], self._library.get_config_param_dtype(self._library.ConfigParam[name]))
        self._library.config_set(self._config, self._library.ConfigParam[name], value.ctypes.data, value.nbytes)

    def _get(self, name, values):
        size = np.zeros(1, np.uint64)
        self._library.data_get(
            self._handle, self._data, self._library.DataParam[name], values.ctypes.data, values.nbytes, size.ctypes.data
        )
        return values

    def _room(self, name, size) -> int:
        """Have memory of the GPU under a name, which only grows; returns its place."""
        place, room = self._memory.get(name, (0, 0))
        if room < size:
            if place:
                del self._memory[name]
                runtime("cudaFree", place)
            place = runtime("cudaMalloc", size)
            self._memory[name] = place, size
        return place

    def _copied(self, name, array) -> int:
        """Copy an array to the GPU, to its place there."""
        place = self._room(name, array.nbytes)
        runtime("cudaMemcpy", place, array.ctypes.data, array.nbytes, _direction(True))
        return place

    def _make_room(self, columns):
        """Have dense matrices of so many columns."""
        if columns == self._columns:
            return
        self._forget_columns()
        for name in ("right", "solution"):
            place = self._room(name, self.size * columns * self._dtype.itemsize)
            self._dense.append(self._library.matrix_create_dn(
                self.size, columns, self.size, place, _kind(self._dtype), self._library.Layout.COL_MAJOR
            ))  # fmt: skip
        self._columns = columns

    def _forget_columns(self):
        while self._dense:
            self._library.matrix_destroy(self._dense.pop())
        self._columns = 0

    def _move(self, blocks, name, to_gpu):
        """Copy blocks to their rows on the GPU, or from there."""
        width, place = self._dtype.itemsize, self._memory[name][0]
        for first, block in blocks:
            if not block.size:
                continue
            rows, columns = block.shape
            here, there = (block.ctypes.data, rows * width), (place + first * width, self.size * width)
            target, source = (there, here) if to_gpu else (here, there)
            runtime("cudaMemcpy2DAsync", *target, *source, rows * width, columns, _direction(to_gpu), 0)
        runtime("cudaDeviceSynchronize")

    def free(self):
        cudss = self._library
        self._forget_columns()
        if self._matrix:
            cudss.matrix_destroy(self._matrix)
        if self._data:
            cudss.data_destroy(self._handle, self._data)
        if self._config:
            cudss.config_destroy(self._config)
        if self._handle:
            cudss.destroy(self._handle)
        self._handle = self._config = self._data = self._matrix = 0
        while self._memory:
            runtime("cudaFree", self._memory.popitem()[1][0])
        self.unlock()


def _kind(dtype) -> int:
    return KINDS[np.dtype(dtype).str[1:]]


def _direction(to_gpu):
    from cuda.bindings import runtime

    kinds = runtime.cudaMemcpyKind
    return kinds.cudaMemcpyHostToDevice if to_gpu else kinds.cudaMemcpyDeviceToHost


def library():
    """The bindings of cuDSS, with the libraries that it looks for. Raises RuntimeError for a cuDSS that they are not
    for."""
    from cuda.pathfinder import load_nvidia_dynamic_lib

    for name in ("cublasLt", "cublas", "nvrtc"):
        load_nvidia_dynamic_lib(name)
    from nvmath.bindings import cudss

    # the version is looked at by the class DirectSolver alone: other ones have the same name, and other arguments
    module = import_module("nvmath.sparse.advanced.direct_solver")
    getattr(module, "_check_cudss_version", lambda: None)()
    return cudss


def runtime(name, *arguments):
    """Call a function of CUDA's runtime."""
    from cuda.bindings import runtime

    code, *results = getattr(runtime, name)(*arguments)
    if code != runtime.cudaError_t.cudaSuccess:
        raise RuntimeError(f"{name}: {runtime.cudaGetErrorString(code)[1].decode()} ({code.name})")
    return results[0] if len(results) == 1 else results


def count_of_gpus() -> int:
    """How many GPUs this process sees: none where there is no driver, or where it finds none. Raises RuntimeError."""
    if not runtime("cudaDriverGetVersion"):
        return 0
    try:
        return runtime("cudaGetDeviceCount")
    except RuntimeError as error:
        if "cudaErrorNoDevice" in str(error):
            return 0
        raise


def threads_library() -> str | None:
    """The library by which cuDSS orders with several threads, beside that of its wheel; or the user's choice."""
    if chosen := os.environ.get("CUDSS_THREADING_LIB"):
        return chosen
    wheels = find_spec("nvidia")
    folders = [] if wheels is None else map(Path, wheels.submodule_search_locations)
    libraries = [path for folder in folders for path in sorted(folder.glob("c*/lib/libcudss_mtlayer_gomp.so.*"))]
    return str(libraries[0]) if libraries else None


@contextmanager
def on_processors(processors):
    """Let threads run on processors that a launcher gave to ranks that sleep, as many as these, however many this rank
    was given (OMP_NUM_THREADS)."""
    before, openmp = os.sched_getaffinity(0), None
    with suppress(OSError):
        openmp = ctypes.CDLL("libgomp.so.1")
    threads = openmp.omp_get_max_threads() if openmp else 1
    os.sched_setaffinity(0, processors)
    if openmp:
        openmp.omp_set_num_threads(len(processors))
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)
        if openmp:
            openmp.omp_set_num_threads(threads)
