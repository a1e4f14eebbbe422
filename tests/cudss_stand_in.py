"""A factor on a GPU as hpcred uses it, on the processor by SciPy, and failures that a GPU may have."""

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from hpcred.linalg.solvers import cudss


class Gpu:
    """A GPU that does not exist, with so much memory; `failing`: the phase that fails, with which error."""

    def __init__(self, free_mb=1000.0, need_mb=100, least_mb=50, failing=None, error=None, spoil=0.0):
        self.free_mb, self.need_mb, self.least_mb = free_mb, need_mb, least_mb
        self.failing, self.error, self.spoil = failing, error, spoil
        self.analyses, self.factors, self.freed, self.limit = 0, 0, 0, None

    def used_by(self, monkeypatch, count=1):
        """Have cuDSS be found, with this GPU `count` times."""
        monkeypatch.setattr(cudss, "unusable", lambda: None)
        monkeypatch.setattr(cudss, "count_of_gpus", lambda: count)
        monkeypatch.setattr(cudss, "gpus_seen", lambda: set(range(count)))
        monkeypatch.setattr(cudss, "free_mb", lambda gpu: self.free_mb)
        monkeypatch.setattr(cudss, "GpuFactor", lambda *arguments: Factor(self, *arguments))
        return self

    def enters(self, phase):
        if phase == self.failing:
            raise self.error


class Factor:
    """As GpuFactor: the pattern stays, and only the lower triangle is looked at of symmetric matrices."""

    def __init__(self, gpu, number, indptr, indices, values, symmetric, processors, limit=0):
        assert len(processors) and len(indices) == len(values)
        self.gpu, self.symmetric, self.locked = gpu, symmetric, []
        self.size, gpu.limit = len(indptr) - 1, limit
        self.pattern = indices.copy(), indptr.copy()
        self.take(values)
        assert self.matrix.has_canonical_format and (not symmetric or scipy.sparse.triu(self.matrix, 1).nnz == 0)

    def analyse(self):
        self.gpu.enters("analyse")
        self.gpu.analyses += 1
        self.need, self.least = self.gpu.need_mb * 2**20, self.gpu.least_mb * 2**20

    def take(self, values):
        self.matrix = scipy.sparse.csr_matrix((values.copy(), *self.pattern), shape=(self.size, self.size))

    def factorise(self):
        self.gpu.enters("factorise")
        self.gpu.factors += 1
        whole = self.matrix
        if self.symmetric:
            whole = whole + scipy.sparse.tril(whole, -1).T
        self.factor = scipy.sparse.linalg.splu(whole.tocsc())
        negative = 0
        if self.symmetric and whole.dtype.kind == "f":
            negative = int((np.linalg.eigvalsh(whole.toarray()) < 0).sum())
        self.entries, self.inertia, self.perturbed = self.factor.nnz, (self.size - negative, negative), 0

    def solve(self, blocks):
        self.gpu.enters("solve")
        starts = [first for first, _ in blocks]
        assert starts == np.cumsum([0, *(len(block) for _, block in blocks)])[:-1].tolist()
        assert all(block.flags.f_contiguous and block.dtype == self.matrix.dtype for _, block in blocks)
        solution = self.factor.solve(np.vstack([block for _, block in blocks]))
        if self.gpu.spoil:
            solution = solution * (1 + self.gpu.spoil * np.random.default_rng(1).standard_normal(solution.shape))
        for first, block in blocks:
            block[...] = solution[first : first + len(block)]

    def lock(self, array):
        if not any(array is item for item in self.locked):
            self.locked.append(array)

    def unlock(self):
        self.locked.clear()

    def free(self):
        self.gpu.freed += 1
        self.unlock()
        self.factor = None
        self.gpu.enters("free")
