"""A basis that grows and what is known of it: blocks enter; V^T K V, V^T L and V^T D V leave, as far as it goes."""

from __future__ import annotations

import numpy as np

from ..linalg.basis import Basis
from ..linalg.blocks import copy_of, inner
from ..parallel.failures import Owned
from .projection import project
from .pseudo_modal import Law, PseudoModal, diagonalised
from .run import Run


class Projections:
    """Projections on a mass-orthonormal basis, extended block by block. All methods are collective.

    `K` (m, m) = V^T K V, `L` (m, l) = V^T L for a block L of loads, `D` (m, m) = V^T D V, or None unless `damped`:
    small arrays, the same on all ranks. Models of the leading columns of the basis are parts of them.
    """

    def __init__(self, run: Run, basis: Basis, loads, law: Law, damped: bool):
        self._run, self.basis, self.loads, self.law = run, basis, loads, law
        self.K = np.zeros((0, 0))
        self.L = np.zeros((0, loads.getActiveColumns()[1]))
        self.D = np.zeros((0, 0)) if damped else None
        self._project(0)

    def extend(self, block, images=None) -> int:
        """Add the span of a block to the basis; returns how many columns are new. `images`: M block where known."""
        start = self.basis.size
        with self._run.progress.stage("orthogonalise"):
            self.basis.extend(block, images)
        self._project(start)
        return self.basis.size - start

    def _project(self, start):
        """Take in the columns of the basis from `start` on."""
        model, stop = self._run.model, self.basis.size
        if stop == start:
            return
        with self._run.progress.stage("project"), Owned(model.comm) as owned:
            new = owned.owns(copy_of(self.basis.columns_between(start, stop), model.K))
            self.L = np.vstack([self.L, inner(new, self.loads)])
            right = project(model.K, new, self.basis.columns)
            self.K = np.block([[self.K, right[:start]], [right[:start].T, right[start:]]])
            if self.D is not None:
                right = project(model.D, new, self.basis.columns)
                left = right[:start].T if model.symmetric else self._transposed(new, start)
                self.D = np.block([[self.D, right[:start]], [left, right[start:]]])

    def _transposed(self, new, start):
        """W^T D V (new, start) of the columns before."""
        if not start:
            return np.zeros((new.getActiveColumns()[1], 0))
        return project(self._run.model.D, self.basis.columns_between(0, start), new)

    def model(self, columns=None) -> PseudoModal:
        """The model of the first so many `columns` of the basis, or of listed ones, by default of all; local."""
        count = self.basis.size if columns is None else columns
        k = np.arange(count) if np.ndim(count) == 0 else np.array(count, dtype=int)
        D = None if self.D is None else self.D[np.ix_(k, k)]
        return diagonalised(self.K[np.ix_(k, k)], self.L[k], D, self.law)
