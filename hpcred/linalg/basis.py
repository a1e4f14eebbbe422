"""A growing mass-orthonormal basis: blocks enter, V with V^T M V = I leaves, and what was dropped is counted.

Block Gram-Schmidt in the inner product of M with repeated projection; the rank of a block is decided on
columns scaled to unit M-norm (Stathopoulos & Wu, SIAM J. Sci. Comput. 23(6), 2002, for the Gram-based step),
and directions that the Gram matrix cannot resolve are separated, projected again and judged by themselves.
"""

from __future__ import annotations

from contextlib import contextmanager

import numpy as np

from ..parallel.failures import ComputationError
from ..parallel.petsc import PETSc, SLEPc
from .blocks import add_product, apply, copy_of, create_block, dense, fold, inner, turn, unfold

RESOLVED = 1e-4  # eigenvalues of a unit-diagonal Gram matrix above this are safe to divide by


class Basis:
    """Columns with V^T M V = I, also M-orthogonal to the columns of `deflate` (for rigid-body modes; or None).

    `tolerance`: a direction whose part outside the span is smaller than this, relative to the M-norm of the
    column that brought it, is dropped. `pairs`: blocks are pairs Re, Im of complex columns (see block.fold), the
    basis is complex with V^H M V = I, and sizes count complex columns (`width` real ones). Owns PETSc objects: call
    close(). All methods are collective.
    """

    def __init__(self, mass: PETSc.Mat, deflate: SLEPc.BV | None = None, tolerance: float = 1e-12, pairs=False):
        self.mass = mass
        self.tolerance = tolerance
        self.width = 2 if pairs else 1
        self._fold, self._unfold = (fold, unfold) if pairs else (np.asarray, np.asarray)
        self._leading = 0
        self.size = 0
        self._block = create_block(mass, 32)
        if deflate is not None:
            self._append(deflate)
            self._leading, self.size = self.size, 0

    def close(self):
        self._block.destroy()

    @property
    def columns(self) -> SLEPc.BV:
        """V as a block whose active columns are the basis (n, size); owned by the basis."""
        return self.columns_since(0)

    def columns_since(self, start: int) -> SLEPc.BV:
        """The columns from `start` on as active columns of the same block."""
        return self.columns_between(start, self.size)

    def columns_between(self, start: int, stop: int) -> SLEPc.BV:
        """The columns start .. stop - 1 as active columns of the same block."""
        first = self._leading + self.width * start
        self._block.setActiveColumns(first, self._leading + self.width * stop)
        return self._block

    def coefficients(self, block: SLEPc.BV) -> np.ndarray:
        """V^H M block (size, columns): the columns of a block in terms of the basis."""
        with self._times_mass(block) as product:
            return self._fold(inner(self.columns, product))

    @property
    def _end(self):
        return self._leading + self.width * self.size

    def extend(self, block: SLEPc.BV) -> int:
        """Add the span of the active columns of `block`, which stays as it is; return how many were new.

        Raises ComputationError when a column is not finite or M shows a negative norm.
        """
        start = self.size
        if block.getActiveColumns()[0] == block.getActiveColumns()[1]:
            return 0
        pending = copy_of(block, self.mass)
        # weight: what is left of a column relative to what came in, hence how many digits it still carries
        weight = None
        while pending.getActiveColumns()[1]:
            weight, gram = self._project_and_scale(pending, weight)
            if not weight.size:
                break
            values, vectors = np.linalg.eigh(gram)
            resolved = values > RESOLVED
            fresh = copy_of(pending, self.mass)
            self._combine(fresh, vectors[:, resolved] / np.sqrt(values[resolved]))
            rest = vectors[:, ~resolved]
            self._combine(pending, rest)
            weight = 1.0 / np.sqrt((np.abs(rest) ** 2 / weight[:, None] ** 2).sum(axis=0))
            self._polish(fresh)
            self._append(fresh)
            fresh.destroy()
        pending.destroy()
        return self.size - start

    def defect(self) -> float:
        """max |V^T M V - I|, rigid-body modes included."""
        return self.gram()[1]

    def gram(self) -> tuple[np.ndarray, float]:
        """V^H M V (size, size), and max |V^H M V - I| with the rigid-body modes included."""
        self._block.setActiveColumns(0, self._end)
        with self._times_mass(self._block) as product:
            gram = self._fold(inner(self._block, product))
        first = self._leading // self.width
        return gram[first:, first:], float(np.abs(gram - np.eye(len(gram))).max(initial=0.0))

    def turn(self, factor: np.ndarray):
        """V <- V factor (54); factor (size, k)."""
        turn(self.columns, factor)
        self.size = factor.shape[1]

    def _combine(self, block, factor):
        """block <- block factor, with the new number of columns active."""
        turn(block, self._unfold(factor))
        block.setActiveColumns(0, self.width * factor.shape[1])

    @contextmanager
    def _times_mass(self, block):
        first, last = block.getActiveColumns()
        product = create_block(self.mass, last - first)
        apply(self.mass, block, product)
        try:
            yield product
        finally:
            product.destroy()

    def _project(self, block):
        """block <- block - V (V^H M block); returns the coefficients and block^H M block from before."""
        self._block.setActiveColumns(0, self._end)
        with self._times_mass(block) as product:
            inside, gram = (self._fold(inner(left, product)) for left in (self._block, block))
        add_product(block, self._block, self._unfold(inside), alpha=-1.0)
        return inside, (gram + gram.conj().T) / 2

    def _project_and_scale(self, block, weight):
        """Project until the projection takes nothing more, scale to M-norm 1, drop what has become too small.

        Returns the weights of the columns left and their Gram matrix with unit diagonal.
        """
        while True:
            inside, gram = self._project(block)
            squares = np.diag(gram).real
            if not np.isfinite(squares).all():
                raise ComputationError("a basis vector has entries that are not finite")
            if (squares < -1e-10 * np.abs(squares).max(initial=0.0)).any():
                raise ComputationError("a basis vector has a negative M-norm: the mass matrix is indefinite")
            norms = np.sqrt(np.maximum(squares, 0.0))
            weight = np.ones(norms.size) if weight is None else weight * norms
            kept = np.flatnonzero((norms > 0) & (weight > self.tolerance))
            scale = np.zeros((norms.size, kept.size))
            scale[kept, np.arange(kept.size)] = 1.0 / norms[kept]
            self._combine(block, scale)
            weight, inside = weight[kept], inside @ scale
            gram = scale.T @ gram @ scale - inside.conj().T @ inside
            left = np.diag(gram).real
            if (left > 0.25).all():  # twice is enough
                scale = 1.0 / np.sqrt(left)
                self._combine(block, np.diag(scale))
                return weight / scale, gram * np.outer(scale, scale)

    def _polish(self, block):
        """One more projection, and the symmetric orthonormalisation of well-conditioned columns."""
        inside, gram = self._project(block)
        values, vectors = np.linalg.eigh(gram - inside.conj().T @ inside)
        self._combine(block, vectors / np.sqrt(values) @ vectors.conj().T)

    def _append(self, block):
        count = block.getActiveColumns()[1] - block.getActiveColumns()[0]
        end = self._end + count
        if end > self._block.getSizes()[1]:
            self._block.resize(max(end, 2 * self._block.getSizes()[1]), copy=True)
        self._block.setActiveColumns(end - count, end)
        with dense(block) as source, dense(self._block) as target:
            source.copy(target)
        self.size += count // self.width
