"""A growing mass-orthonormal basis: blocks enter, V with V^T M V = I leaves, and what was dropped is counted.

Block Gram-Schmidt in the inner product of M with repeated projection; the rank of a block is decided on
columns scaled to unit M-norm (Stathopoulos & Wu, SIAM J. Sci. Comput. 23(6), 2002, for the Gram-based step),
and directions that the Gram matrix cannot resolve are separated, projected again and judged by themselves.
"""

from contextlib import contextmanager

import numpy as np

from ..errors import ComputationError
from ..petsc import PETSc, SLEPc
from .block import add_product, apply, copy_of, create_block, dense, inner, turn

RESOLVED = 1e-4  # eigenvalues of a unit-diagonal Gram matrix above this are safe to divide by


class Basis:
    """Columns with V^T M V = I, also M-orthogonal to the columns of `deflate` (for rigid-body modes; or None).

    `tolerance`: a direction whose part outside the span is smaller than this, relative to the M-norm of the
    column that brought it, is dropped. Owns PETSc objects: call close(). All methods are collective.
    """

    def __init__(self, mass: PETSc.Mat, deflate: SLEPc.BV | None = None, tolerance: float = 1e-12):
        self.mass = mass
        self.tolerance = tolerance
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
        self._block.setActiveColumns(self._leading, self._leading + self.size)
        return self._block

    def columns_since(self, start: int) -> SLEPc.BV:
        """The columns from `start` on as active columns of the same block."""
        self._block.setActiveColumns(self._leading + start, self._leading + self.size)
        return self._block

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
            turn(fresh, vectors[:, resolved] / np.sqrt(values[resolved]))
            fresh.setActiveColumns(0, int(resolved.sum()))
            rest = vectors[:, ~resolved]
            turn(pending, rest)
            pending.setActiveColumns(0, rest.shape[1])
            weight = 1.0 / np.sqrt((rest**2 / weight[:, None] ** 2).sum(axis=0))
            self._polish(fresh)
            self._append(fresh)
            fresh.destroy()
        pending.destroy()
        return self.size - start

    def defect(self) -> float:
        """max |V^T M V - I|, rigid-body modes included."""
        self._block.setActiveColumns(0, self._leading + self.size)
        gram = self._gram(self._block)
        return float(np.abs(gram - np.eye(len(gram))).max(initial=0.0))

    def turn(self, factor: np.ndarray):
        """V <- V factor (54); factor (size, k) with orthonormal columns."""
        turn(self.columns, factor)
        self.size = factor.shape[1]

    def _gram(self, block):
        with self._times_mass(block) as product:
            return inner(block, product)

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
        """block <- block - V (V^T M block); returns the coefficients and block^T M block from before."""
        self._block.setActiveColumns(0, self._leading + self.size)
        with self._times_mass(block) as product:
            inside, gram = inner(self._block, product), inner(block, product)
        add_product(block, self._block, inside, alpha=-1.0)
        return inside, (gram + gram.T) / 2

    def _project_and_scale(self, block, weight):
        """Project until the projection takes nothing more, scale to M-norm 1, drop what has become too small.

        Returns the weights of the columns left and their Gram matrix with unit diagonal.
        """
        while True:
            inside, gram = self._project(block)
            squares = np.diag(gram)
            if not np.isfinite(squares).all():
                raise ComputationError("a basis vector has entries that are not finite")
            if (squares < -1e-10 * np.abs(squares).max(initial=0.0)).any():
                raise ComputationError("a basis vector has a negative M-norm: the mass matrix is indefinite")
            norms = np.sqrt(np.maximum(squares, 0.0))
            weight = np.ones(norms.size) if weight is None else weight * norms
            kept = np.flatnonzero((norms > 0) & (weight > self.tolerance))
            scale = np.zeros((norms.size, kept.size))
            scale[kept, np.arange(kept.size)] = 1.0 / norms[kept]
            turn(block, scale)
            block.setActiveColumns(0, kept.size)
            weight, inside = weight[kept], inside @ scale
            gram = scale.T @ gram @ scale - inside.T @ inside
            left = np.diag(gram)
            if (left > 0.25).all():  # twice is enough
                scale = 1.0 / np.sqrt(left)
                turn(block, np.diag(scale))
                return weight / scale, gram * np.outer(scale, scale)

    def _polish(self, block):
        """One more projection, and the symmetric orthonormalisation of well-conditioned columns."""
        inside, gram = self._project(block)
        values, vectors = np.linalg.eigh(gram - inside.T @ inside)
        turn(block, vectors / np.sqrt(values) @ vectors.T)

    def _append(self, block):
        count = block.getActiveColumns()[1] - block.getActiveColumns()[0]
        end = self._leading + self.size + count
        if end > self._block.getSizes()[1]:
            self._block.resize(max(end, 2 * self._block.getSizes()[1]), copy=True)
        self._block.setActiveColumns(end - count, end)
        with dense(block) as source, dense(self._block) as target:
            source.copy(target)
        self.size += count
