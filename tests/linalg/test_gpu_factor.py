"""The calls of GpuFactor, on the memory of the processor: what is copied where, and that all of it is freed."""

import ctypes
import os
import sys
from enum import Enum
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse
import scipy.sparse.linalg

from hpcred.linalg.solvers import gpu_factor
from hpcred.linalg.solvers.gpu_factor import GpuFactor

CONFIGURED = {"HOST_NTHREADS": np.int32, "HYBRID_MEMORY_MODE": np.int32, "HYBRID_DEVICE_MEMORY_LIMIT": np.int64,
              "IR_N_STEPS": np.int32, "IR_TOL": np.float64}  # fmt: skip
KINDS = {number: np.dtype(name) for name, number in gpu_factor.KINDS.items()}


class Device:
    """Memory of a GPU and cuDSS on the processor; `error` of solves."""

    class cuDSSError(Exception):  # noqa: N801  (as there)
        pass

    Phase = Enum("Phase", "ANALYSIS FACTORIZATION SOLVE")
    DataParam = Enum("DataParam", "MEMORY_ESTIMATES LU_NNZ NPIVOTS INERTIA")
    ConfigParam = Enum("ConfigParam", list(CONFIGURED))
    MatrixType = Enum("MatrixType", "SYMMETRIC GENERAL")
    MatrixViewType = Enum("MatrixViewType", "LOWER FULL")
    IndexBase, Layout = SimpleNamespace(ZERO=0), SimpleNamespace(COL_MAJOR=0)

    def __init__(self, monkeypatch, error=None):
        self.memory, self.objects, self.locked, self.config, self.error = {}, {}, set(), {}, error
        monkeypatch.setattr(gpu_factor, "library", lambda: self)
        monkeypatch.setattr(gpu_factor, "runtime", lambda name, *arguments: getattr(self, name)(*arguments))
        monkeypatch.setattr(gpu_factor, "threads_library", lambda: None)
        monkeypatch.setattr(gpu_factor, "_direction", lambda to_gpu: to_gpu)

    # of CUDA's runtime

    def cudaMalloc(self, size):  # noqa: N802
        array = np.full(size, 0xFF, np.uint8)  # no number
        self.memory[array.ctypes.data] = array
        return array.ctypes.data

    def cudaFree(self, place):  # noqa: N802
        del self.memory[place]

    def cudaMemcpy(self, target, source, size, to_gpu):  # noqa: N802
        assert size <= len(self.memory[target if to_gpu else source])
        ctypes.memmove(target, source, size)

    def cudaMemcpy2DAsync(self, target, step, source, pace, width, height, to_gpu, stream):  # noqa: N802
        for column in range(height):
            ctypes.memmove(target + column * step, source + column * pace, width)

    def cudaHostRegister(self, place, size, flags):  # noqa: N802
        self.locked.add(place)

    def cudaHostUnregister(self, place):  # noqa: N802
        self.locked.remove(place)

    def cudaSetDevice(self, gpu):  # noqa: N802
        assert gpu == 0

    def cudaDeviceSynchronize(self):  # noqa: N802
        pass

    # of cuDSS

    def _made(self, *what):
        self.objects[key := 1 + max(self.objects, default=0)] = what
        return key

    def create(self):
        return self._made("handle")

    config_create = create

    def data_create(self, handle):
        return self._made("data")

    def matrix_create_csr(self, rows, columns, entries, starts, ends, places, values, *kinds):
        return self._made(rows, entries, starts, places, values, *kinds)

    def matrix_create_dn(self, rows, columns, step, values, kind, layout):
        assert step == rows
        return self._made(rows, columns, values, kind)

    def destroy(self, *keys):
        del self.objects[keys[-1]]

    config_destroy = data_destroy = matrix_destroy = destroy

    def get_config_param_dtype(self, name):
        return CONFIGURED[name.name]

    def config_set(self, config, name, place, size):
        self.config[name.name] = _array(place, 1, CONFIGURED[name.name])[0]

    def data_get(self, handle, data, name, place, size, written):
        found = {"MEMORY_ESTIMATES": [7, 100, 7, 7, 50, *[0] * 11], "LU_NNZ": [9], "NPIVOTS": [0], "INERTIA": [2, 1]}
        values = found[name.name]
        _array(place, len(values), {8: np.int64, 4: np.int32}[size // len(values)])[:] = values

    def execute(self, handle, phase, config, data, matrix, solution, right):
        rows, entries, starts, places, values, offset, index, kind, mtype, view, base = self.objects[matrix]
        A = scipy.sparse.csr_matrix((
            _array(values, entries, KINDS[kind]), _array(places, entries, KINDS[index]),
            _array(starts, rows + 1, KINDS[offset]),
        ), shape=(rows, rows))  # fmt: skip
        assert (mtype.name, view.name) in (("SYMMETRIC", "LOWER"), ("GENERAL", "FULL"))
        if mtype.name == "SYMMETRIC":
            A = A + scipy.sparse.tril(A, -1).T
        if phase.name == "SOLVE":
            b, x = (_array(place, rows * columns, KINDS[kind]).reshape((rows, columns), order="F")
                    for rows, columns, place, kind in (self.objects[right], self.objects[solution]))  # fmt: skip
            x[...] = np.linalg.solve(A.toarray(), b)
            if self.error:
                raise self.error


def _array(place, count, dtype):
    """The numbers at a place of the memory."""
    return np.frombuffer((ctypes.c_char * (count * np.dtype(dtype).itemsize)).from_address(place), dtype)


def factor_of(A, symmetric, limit=0):
    lower = scipy.sparse.csr_matrix(np.tril(A) if symmetric else A)
    return GpuFactor(0, lower.indptr, lower.indices, lower.data, symmetric, os.sched_getaffinity(0), limit), lower


@pytest.mark.parametrize("real", [False, pytest.param(True, marks=pytest.mark.cuda)])
@pytest.mark.parametrize("limit", [0, 2**30])
@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("dtype", [float, complex, np.float32, np.complex64])
def test_solutions_for_other_widths_and_values(monkeypatch, symmetric, dtype, limit, real):
    """Rows of ranks are blocks of the columns, one of them empty; all is freed at the end."""
    device, random = None if real else Device(monkeypatch), np.random.default_rng(5)
    A = (random.standard_normal((6, 6)) + 6 * np.eye(6)).astype(dtype)
    A = A + A.T if symmetric else A
    factor, matrix = factor_of(A, symmetric, limit)
    before = os.sched_getaffinity(0)
    factor.analyse()
    assert os.sched_getaffinity(0) == before
    assert factor.need > 0 and factor.least >= 0 if real else (factor.need, factor.least) == (100, 50)
    for scale in (1.0, 3.0):
        factor.take((scale * matrix.data).astype(dtype))
        factor.factorise()
        assert factor.perturbed == 0
        if not real:
            assert (factor.entries, factor.inertia) == (9, (2, 1))
        elif symmetric and np.isrealobj(A):
            negative = int((np.linalg.eigvalsh(A) < 0).sum())
            assert factor.inertia == (len(A) - negative, negative)
        for columns in (2, 5, 1):
            b = random.standard_normal((6, columns)).astype(dtype)
            blocks = [(start, np.array(b[start:stop], order="F")) for start, stop in ((0, 4), (4, 4), (4, 6))]
            for _, block in blocks:
                factor.lock(block)
            factor.solve(blocks)
            found = np.vstack([block for _, block in blocks])
            single = np.finfo(dtype).eps > 1e-10
            assert np.allclose(scale * A @ found, b, atol=1e-4 if single else 1e-10 if real else 1e-12)
            factor.unlock()
    factor.free()
    if real:
        return
    assert ("IR_TOL" in device.config) == (not single)  # whose residuals do not come down so far
    assert device.config.get("HYBRID_MEMORY_MODE", 0) == (limit > 0)
    assert device.config.get("HYBRID_DEVICE_MEMORY_LIMIT", 0) == limit
    assert not device.memory and not device.objects and not device.locked


@pytest.mark.parametrize("words, raises", [("IR_FAILED (7)", False), ("EXECUTION_FAILED (5)", True)])
def test_residuals_that_stay_large_are_no_error(monkeypatch, words, raises):
    """Who solves looks at them."""
    device = Device(monkeypatch, Device.cuDSSError(words))
    factor, _ = factor_of(np.diag([1.0, 2.0]), True)
    block = np.ones((2, 1), order="F")
    if raises:
        with pytest.raises(Device.cuDSSError):
            factor.solve([(0, block)])
    else:
        factor.solve([(0, block)])
        assert np.allclose(block[:, 0], [1.0, 0.5])
    factor.free()
    assert not device.memory and not device.objects


def test_a_matrix_that_cannot_be_created_leaves_nothing(monkeypatch):
    device = Device(monkeypatch)
    monkeypatch.setattr(device, "matrix_create_csr", lambda *arguments: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        factor_of(np.diag([1.0, 2.0]), True)
    assert not device.memory and not device.objects


def test_memory_that_cannot_be_locked_is_not_asked_for_again(monkeypatch):
    """And CUDA forgets that error, which it would give later calls."""
    device, calls = Device(monkeypatch), []

    def refuse(name):
        def call(*arguments):
            calls.append(name)
            raise RuntimeError(f"{name}: operation not supported")

        return call

    for name in ("cudaHostRegister", "cudaGetLastError"):
        monkeypatch.setattr(device, name, refuse(name), raising=False)
    factor, _ = factor_of(np.diag([1.0, 2.0]), True)
    block = np.ones((2, 1), order="F")
    for _ in range(2):
        factor.lock(block)
        factor.solve([(0, block)])
    assert calls == ["cudaHostRegister", "cudaGetLastError"]
    factor.unlock()
    factor.lock(block)  # another array may be there by now
    factor.free()
    assert calls == ["cudaHostRegister", "cudaGetLastError"] * 2 and not device.locked


def test_a_gpu_that_frees_nothing_after_an_error_tells_that_error(monkeypatch):
    device = Device(monkeypatch)
    monkeypatch.setattr(device, "matrix_create_csr", lambda *arguments: 1 / 0)
    monkeypatch.setattr(device, "config_destroy", lambda *arguments: [][0])
    with pytest.raises(ZeroDivisionError):
        factor_of(np.diag([1.0, 2.0]), True)


def test_a_cudss_that_the_bindings_are_not_for(monkeypatch):
    """Which they do not look at by themselves."""

    def refuse():
        raise RuntimeError("nvmath-python requires cuDSS version 0.8, while you have cuDSS version 0.7.")

    loaded, bindings = [], SimpleNamespace()
    solver = SimpleNamespace(_check_cudss_version=refuse)
    for name, module in {
        "cuda": SimpleNamespace(), "cuda.pathfinder": SimpleNamespace(load_nvidia_dynamic_lib=loaded.append),
        "nvmath": SimpleNamespace(), "nvmath.bindings": SimpleNamespace(cudss=bindings),
        "nvmath.sparse": SimpleNamespace(), "nvmath.sparse.advanced": SimpleNamespace(),
        "nvmath.sparse.advanced.direct_solver": solver,
    }.items():  # fmt: skip
        monkeypatch.setitem(sys.modules, name, module)
    with pytest.raises(RuntimeError, match="while you have cuDSS version 0.7"):
        gpu_factor.library()
    solver._check_cudss_version = lambda: None
    assert gpu_factor.library() is bindings and loaded == 2 * ["cublasLt", "cublas", "nvrtc"]


@pytest.mark.parametrize("driver, error, count", [
    (0, "CUDA driver version is insufficient for CUDA runtime version (cudaErrorInsufficientDriver)", 0),
    (13000, "no CUDA-capable device is detected (cudaErrorNoDevice)", 0),
    (11000, "CUDA driver version is insufficient for CUDA runtime version (cudaErrorInsufficientDriver)", None),
    (13000, None, 2),
])  # fmt: skip
def test_gpus_are_counted_without_any(monkeypatch, driver, error, count):
    """An old driver is no lack of GPUs."""

    def runtime(name):
        if name == "cudaDriverGetVersion":
            return driver
        if error:
            raise RuntimeError(f"{name}: {error}")
        return 2

    monkeypatch.setattr(gpu_factor, "runtime", runtime)
    if count is None:
        with pytest.raises(RuntimeError, match="driver version is insufficient"):
            gpu_factor.count_of_gpus()
    else:
        assert gpu_factor.count_of_gpus() == count
