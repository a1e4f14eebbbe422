"""Extend a basis block by block, and project the matrices on what is new each time."""

from __future__ import annotations

import numpy as np

from ...linalg.basis import Basis
from ...linalg.blocks import inner
from ..projection import project, project_stiffness
from ..run import Run
from .pseudo_modal import Proportional, PseudoModal, diagonalised

HELD_BACK = 3  # columns at least that an estimate sees the model from


def extended(small, mat, new, columns, symmetric=True) -> np.ndarray:
    """Return V^T A V (m, m) of `columns` V, of which the last are the block `new`, from that of the others, `small`;
    exactly symmetric where A is `symmetric` but for round-off. Collective."""
    start = len(small)
    right = project(mat, new, columns)
    left = right[:start].T if symmetric or not start else project(mat, columns.between(0, start), new)
    corner = right[start:]
    corner = (corner + corner.T) / 2 if symmetric else corner
    return np.block([[small, right[:start]], [left, corner]])


class Projections:
    """Projections on a mass-orthonormal basis, extended block by block. All methods are collective unless they say so.

    `K` (m, m) = V^T K V, which may be `symmetric`, `L` (m, l) = V^T L for the block `loads` L of the run, `D` (m, m) =
    V^T D V, or None unless `damped`, `M` (m, m) = V^T M V, or None where it is the identity, and `added` terms
    V^T K_v V: small arrays, the same on all ranks. Models of columns of the basis are parts of them. `io`: inputs and
    outputs in terms of L; `damping`: the proportional damping of the models. Raises InputError (see io).
    """

    def __init__(self, run: Run, basis: Basis, damping: Proportional, damped: bool):
        self.run, self.basis, self.damping = run, basis, damping
        self.loads, self.io = run.independent_loads
        self._starts: list[int] = []  # first columns of the blocks
        self.K = np.zeros((0, 0))
        self.L = np.zeros((0, self.loads.getActiveColumns()[1]))
        self.D = np.zeros((0, 0)) if damped else None
        self.M = np.zeros((0, 0)) if run.tau else None
        self.added = self._none_added()
        self.symmetric = run.model.is_symmetric("K")
        self._project(0)

    def extend(self, block, mass_images=None) -> int:
        """Add the span of a block to the basis; returns how many columns are new. `mass_images`: M block if known."""
        start = self.basis.size
        with self.run.progress.stage("orthogonalise"):
            self.run.notes.massless |= self.basis.extend(block, mass_images).massless > 0
        self._project(start)
        if self.basis.size > start:
            self._starts.append(start)
        return self.basis.size - start

    def add_loss_factor(self, eta: float):
        """Measure responses with a loss factor besides the damping matrix; local."""
        self.damping = self.damping._replace(eta=eta)

    def note_silent(self, columns: tuple[int, ...]):
        """Keep which columns of C^T have responses that are round-off; local."""
        self.io = self.io._replace(silent=columns)

    def rotate(self, turn):
        """Replace the basis by its combinations `turn` (m, m), orthonormal like itself, and project on these."""
        self.basis.multiply(turn)
        self._project_all()

    def replace(self, block):
        """Replace the basis by the span of a block."""
        self.basis.clear()
        self.basis.extend(block)
        self._project_all()

    def _project_all(self):
        self._starts, self.K, self.L = [0], np.zeros((0, 0)), self.L[:0]
        self.D = None if self.D is None else np.zeros((0, 0))
        self.M = None if self.M is None else np.zeros((0, 0))
        self.added = self._none_added()
        self._project(0)

    def _none_added(self):
        return self.run.model.added.map(lambda _: np.zeros((0, 0)))

    @property
    def is_damped(self) -> bool:
        """Whether A(s) has parts that are not proportional to M and K; local."""
        return self.D is not None or bool(self.added)

    @property
    def blocks(self) -> list[tuple[int, int]]:
        """First column and end of each block that extended the basis; local."""
        return list(zip(self._starts, [*self._starts[1:], self.basis.size], strict=False))

    @property
    def first_held_back(self) -> int:
        """Where the newest blocks begin that are held back, to see the model of the columns before them; local."""
        return next((start for start in reversed(self._starts) if self.basis.size - start >= HELD_BACK), 0)

    def _project(self, start):
        """Take in the columns of the basis from `start` on."""
        model, stop = self.run.model, self.basis.size
        if stop == start:
            return
        with self.run.progress.stage("project"):
            new = self.basis.columns_between(start, stop)
            self.L = np.vstack([self.L, inner(new, self.loads)])
            if start or not self.symmetric:
                self.K = extended(self.K, model.K, new, self.basis.columns, self.symmetric)
            else:
                self.K = project_stiffness(model.K, new, self.run.cancels)
                self.K = (self.K + self.K.T) / 2
            self.added = self.added.with_matrices({
                key: extended(self.added[key], mat, new, self.basis.columns)
                for key, mat in model.added.matrices.items()
            })  # fmt: skip
            if self.M is not None:
                self.M = extended(self.M, self.run.mass, new, self.basis.columns)
            if self.D is not None:
                self.D = extended(self.D, model.D, new, self.basis.columns, model.is_symmetric("D"))

    def dynamic_stiffness(self, mass: float) -> np.ndarray:
        """Return V^T (K + mass M) V (m, m); local."""
        return self.K + mass * (np.eye(len(self.K)) if self.M is None else self.M)

    def model(self, columns=None) -> PseudoModal:
        """Return the model of `columns` (places) of the basis, by default of all; local."""
        k = np.arange(self.basis.size) if columns is None else columns
        D, M = (None if matrix is None else matrix[np.ix_(k, k)] for matrix in (self.D, self.M))
        added = self.added.map(lambda matrix: matrix[np.ix_(k, k)])
        given = D, self.damping, self.io, added, self.symmetric
        return diagonalised(self.K[np.ix_(k, k)], self.L[k], *given, M, self.run.tau)
