"""What hpcred uses of nvmath.sparse.advanced, on the processor by SciPy, and failures that a GPU may have."""

from types import SimpleNamespace

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from hpcred.linalg.solvers import cudss


class Gpu:
    """A GPU that does not exist, with so much memory; `failing`: the phase that fails, with which error."""

    def __init__(self, free_mb=1000.0, need_mb=100, least_mb=50, failing=None, error=None, spoil=0.0):
        self.free_mb, self.need_mb, self.least_mb = free_mb, need_mb, least_mb
        self.failing, self.error, self.spoil = failing, error, spoil
        self.plans, self.factors, self.freed, self.hybrid = 0, 0, 0, None

    def used_by(self, monkeypatch, count=1):
        """Have cuDSS be found, with this GPU `count` times."""
        monkeypatch.setattr(cudss, "unusable", lambda: None)
        monkeypatch.setattr(cudss, "count_of_gpus", lambda: count)
        monkeypatch.setattr(cudss, "free_mb", lambda gpu: self.free_mb)
        monkeypatch.setattr(cudss, "direct_solvers", self.library)
        monkeypatch.setattr(cudss, "threads_library", lambda: None)
        return self

    def library(self):
        def solver(*arguments, **keywords):
            return DirectSolver(self, *arguments, **keywords)

        return SimpleNamespace(
            DirectSolver=solver, DirectSolverOptions=SimpleNamespace, ExecutionCUDA=SimpleNamespace,
            HybridMemoryModeOptions=SimpleNamespace,
            DirectSolverMatrixType=SimpleNamespace(SYMMETRIC="symmetric", GENERAL="general"),
            DirectSolverMatrixViewType=SimpleNamespace(LOWER="lower", FULL="full"),
        )  # fmt: skip

    def enters(self, phase):
        if phase == self.failing:
            raise self.error


IN_MEMORY = SimpleNamespace(hybrid_memory_mode_options=SimpleNamespace(hybrid_memory_mode=False))


class DirectSolver:
    """As that of nvmath-python: the pattern and the number of columns stay, and only the lower triangle is looked at
    where that is the view."""

    def __init__(self, gpu, a, b, options, execution=IN_MEMORY):
        assert scipy.sparse.issparse(a) and a.format == "csr" and a.has_canonical_format
        assert b.flags.f_contiguous and b.dtype == a.dtype
        gpu.hybrid = execution.hybrid_memory_mode_options.hybrid_memory_mode
        self.gpu, self.lower = gpu, getattr(options, "sparse_system_view", "full") == "lower"
        assert self.lower == (getattr(options, "sparse_system_type", "general") == "symmetric")
        self.a, self.b, self.plan_config = a, b.copy(order="F"), SimpleNamespace()
        self.plan_info = SimpleNamespace(
            memory_estimates=SimpleNamespace(
                peak_device_memory=gpu.need_mb * 2**20, hybrid_min_device_memory=gpu.least_mb * 2**20
            )
        )
        assert not self.lower or scipy.sparse.triu(a, 1).nnz == 0

    def plan(self):
        self.gpu.enters("plan")
        self.gpu.plans += 1
        return self.plan_info

    def reset_operands(self, a=None, b=None):
        if a is not None:
            assert np.array_equal(a.indices, self.a.indices) and np.array_equal(a.indptr, self.a.indptr)
            assert a.dtype == self.a.dtype
            self.a = a
        if b is not None:
            assert b.shape == self.b.shape and b.dtype == self.b.dtype and b.flags.f_contiguous
            self.b = b.copy(order="F")

    def factorize(self):
        self.gpu.enters("factorize")
        self.gpu.factors += 1
        whole = self.a
        if self.lower:
            whole = whole + scipy.sparse.tril(whole, -1).T
        self.factor = scipy.sparse.linalg.splu(whole.tocsc())
        negative = 0
        if self.lower and whole.dtype.kind == "f":
            negative = int((np.linalg.eigvalsh(whole.toarray()) < 0).sum())
        return SimpleNamespace(lu_nnz=self.factor.nnz, inertia=(whole.shape[0] - negative, negative), npivots=0)

    def solve(self):
        self.gpu.enters("solve")
        solution = np.asfortranarray(self.factor.solve(self.b))
        if self.gpu.spoil:
            solution *= 1 + self.gpu.spoil * np.random.default_rng(1).standard_normal(solution.shape)
        return solution.astype(self.b.dtype)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.free()

    def free(self):
        self.gpu.freed += 1
        self.factor = None
