"""A growing mass-orthonormal basis: blocks enter, V with V^T M V = I leaves, and what was dropped is counted.

Block Gram-Schmidt in the inner product of M with repeated projection; the rank of a block is decided on
columns scaled to unit M-norm (Stathopoulos & Wu, SIAM J. Sci. Comput. 23(6), 2002, for the Gram-based step),
and directions that the Gram matrix cannot resolve are separated, projected again and judged by themselves.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from ..parallel.decisions import decided
from ..parallel.failures import ComputationError, Owned
from ..parallel.petsc import PETSc, SLEPc
from .blocks import add_product, apply, copy_of, create_block, dense, fold, inner, multiply, unfold

RESOLVED = 1e-4  # eigenvalues of a unit-diagonal Gram matrix above this are safe to divide by
PASSES = 20  # of projection or separation; two or three are usual


@dataclass(frozen=True)
class Extension:
    """What a block brought: how many `kept` directions were new, and how clear that was.

    A direction's weight is the part of it outside of the basis, relative to the column that brought it, in M-norms:
    `smallest_kept` (inf if none was kept) and `largest_dropped` (0 if none was dropped) lie on both sides of the
    deflation tolerance.
    """

    kept: int = 0
    smallest_kept: float = np.inf
    largest_dropped: float = 0.0


class Basis:
    """Columns with V^T M V = I, also M-orthogonal to the columns of `deflate` (for rigid-body modes; or None).

    `tolerance`: a direction whose weight (see Extension) is not larger is dropped. `room`: columns to expect. Owns
    PETSc objects: call close(). All methods are collective, and what they decide is decided once for all ranks.
    """

    width = 1  # real columns of a column

    def __init__(self, mass: PETSc.Mat, deflate: SLEPc.BV | None = None, tolerance: float = 1e-12, room: int = 16):
        self.mass, self.tolerance = mass, tolerance
        self.comm = mass.comm.tompi4py()
        self._leading = 0
        self.size = 0
        deflated = 0 if deflate is None else np.diff(deflate.getActiveColumns())[0]
        self._block = create_block(mass, deflated + self.width * room)
        if deflate is not None:
            self._append(deflate)
            self._leading, self.size = self.size, 0

    @staticmethod
    def _gram(product: np.ndarray) -> np.ndarray:
        """X^H Y from the products of the real columns that make up X and Y."""
        return product

    @staticmethod
    def _factor(factor: np.ndarray) -> np.ndarray:
        """What does to the real columns what `factor` does to the columns."""
        return factor

    def close(self):
        self._block.destroy()

    @property
    def columns(self) -> SLEPc.BV:
        """V as a block whose active columns are the basis (n, width size); owned by the basis."""
        return self.columns_between(0, self.size)

    def columns_between(self, start: int, stop: int) -> SLEPc.BV:
        """The columns start .. stop - 1 as active columns of the same block."""
        first = self._leading + self.width * start
        self._block.setActiveColumns(first, self._leading + self.width * stop)
        return self._block

    def coefficients(self, block: SLEPc.BV) -> np.ndarray:
        """V^H M block (size, columns): the columns of a block in terms of the basis."""
        with self._times_mass(block) as product:
            return self._gram(inner(self.columns, product))

    @property
    def _end(self):
        return self._leading + self.width * self.size

    def extend(self, block: SLEPc.BV) -> Extension:
        """Add the span of the active columns of `block`, which stays as it is.

        Raises ComputationError when a column is not finite or M shows a negative norm.
        """
        first, last = block.getActiveColumns()
        if first == last:
            return Extension()
        start, weight, smallest, largest = self.size, None, np.inf, 0.0
        with Owned(self.comm) as owned:
            pending = owned.owns(copy_of(block, self.mass))
            for _ in range(PASSES):
                weight, gram, dropped = self._project_and_scale(pending, weight)
                largest = max(largest, dropped)
                if not weight.size:
                    break
                scaled, rest, weight, resolved = decided(self.comm, _separate, gram, weight)
                smallest = min(smallest, resolved)
                with Owned(self.comm) as inner_owned:
                    fresh = inner_owned.owns(copy_of(pending, self.mass))
                    self._combine(fresh, scaled)
                    self._polish(fresh)
                    self._append(fresh)
                self._combine(pending, rest)
                if not weight.size:
                    break
            else:
                raise ComputationError("a block of basis vectors could not be orthonormalised: is M positive definite?")
        return Extension(self.size - start, float(smallest), float(largest))

    def restore(self, block: SLEPc.BV):
        """Take over the columns of a basis that was written; raises ComputationError unless they are M-orthonormal."""
        self._append(block)
        defect = self.comm.bcast(self.defect())
        if not defect <= 1e-10:
            raise ComputationError(f"the columns of an earlier run are not orthonormal (defect {defect:.1e})")

    def defect(self) -> float:
        """max |V^H M V - I|, rigid-body modes included."""
        return self.gram()[1]

    def gram(self) -> tuple[np.ndarray, float]:
        """V^H M V (size, size), and max |V^H M V - I| with the rigid-body modes included."""
        self._block.setActiveColumns(0, self._end)
        with self._times_mass(self._block) as product:
            gram = self._gram(inner(self._block, product))
        first = self._leading // self.width
        return gram[first:, first:], float(np.abs(gram - np.eye(len(gram))).max(initial=0.0))

    def multiply(self, factor: np.ndarray):
        """V <- V factor (54); factor (size, k), the same on all ranks."""
        multiply(self.columns, self._factor(factor))
        self.size = factor.shape[1]

    def _combine(self, block, factor):
        """block <- block factor, with the new number of columns active."""
        multiply(block, self._factor(factor))
        block.setActiveColumns(0, self.width * factor.shape[1])

    @contextmanager
    def _times_mass(self, block):
        first, last = block.getActiveColumns()
        with Owned(self.comm) as owned:
            product = owned.owns(create_block(self.mass, last - first))
            apply(self.mass, block, product)
            yield product

    def _project(self, block):
        """block <- block - V (V^H M block); returns the coefficients and block^H M block from before."""
        self._block.setActiveColumns(0, self._end)
        with self._times_mass(block) as product:
            inside, gram = (self._gram(inner(left, product)) for left in (self._block, block))
        add_product(block, self._block, self._factor(inside), alpha=-1.0)
        return inside, (gram + gram.conj().T) / 2

    def _project_and_scale(self, block, weight):
        """Project until the projection takes nothing more, scale to M-norm 1, drop what has become too small.

        Returns the weights of the columns left, their Gram matrix with unit diagonal, and the largest weight dropped.
        """
        largest = 0.0
        for _ in range(PASSES):
            inside, gram = self._project(block)
            scale, weight, gram, done, dropped = decided(self.comm, _judge, inside, gram, weight, self.tolerance)
            largest = max(largest, dropped)
            self._combine(block, scale)
            if done:
                return weight, gram, largest
        raise ComputationError("the projection of basis vectors does not come to rest: is M positive definite?")

    def _polish(self, block):
        """One more projection, and the symmetric orthonormalisation of well-conditioned columns."""
        inside, gram = self._project(block)
        self._combine(block, decided(self.comm, _inverse_root, gram - inside.conj().T @ inside))

    def _append(self, block):
        count = block.getActiveColumns()[1] - block.getActiveColumns()[0]
        end = self._end + count
        if end > self._block.getSizes()[1]:
            self._block.resize(max(end, 2 * self._block.getSizes()[1]), copy=True)
        self._block.setActiveColumns(end - count, end)
        with dense(block) as source, dense(self._block) as target:
            source.copy(target)
        self.size += count // self.width


class ComplexBasis(Basis):
    """Complex columns with V^H M V = I, kept as pairs of real ones, Re and Im side by side (see blocks.fold).

    Blocks are such pairs too; sizes and factors count complex columns.
    """

    width = 2
    _gram = staticmethod(fold)
    _factor = staticmethod(unfold)


def _judge(inside, gram, weight, tolerance):
    """What one projection left of some columns.

    Returns the factor that scales and drops columns, the weights and the Gram matrix of those kept, whether another
    projection would take next to nothing, and the largest weight dropped.
    """
    squares = np.diag(gram).real
    if not np.isfinite(squares).all():
        raise ComputationError("a basis vector has entries that are not finite")
    if (squares < -1e-10 * np.abs(squares).max(initial=0.0)).any():
        raise ComputationError("a basis vector has a negative M-norm: the mass matrix is indefinite")
    norms = np.sqrt(np.maximum(squares, 0.0))
    weight = np.ones(norms.size) if weight is None else weight * norms
    kept = np.flatnonzero((norms > 0) & (weight > tolerance))
    dropped = np.delete(weight, kept)[np.delete(norms, kept) > 0].max(initial=0.0)
    scale = np.zeros((norms.size, kept.size))
    scale[kept, np.arange(kept.size)] = 1.0 / norms[kept]
    weight, inside = weight[kept], inside @ scale
    gram = scale.T @ gram @ scale - inside.conj().T @ inside
    left = np.diag(gram).real
    if not (left > 0.25).all():  # twice is enough
        return scale, weight, gram, False, dropped
    unit = 1.0 / np.sqrt(left)
    return scale * unit, weight / unit, gram * np.outer(unit, unit), True, dropped


def _separate(gram, weight):
    """Directions of unit columns that their Gram matrix resolves, scaled to be orthonormal, and the rest.

    Returns both as factors, the weights of the rest, and the smallest weight of the others.
    """
    values, vectors = np.linalg.eigh(gram)
    resolved = values > RESOLVED
    sizes = 1.0 / np.sqrt((np.abs(vectors) ** 2 / weight[:, None] ** 2).sum(axis=0))
    smallest = (sizes * np.sqrt(np.maximum(values, 0.0)))[resolved].min(initial=np.inf)
    return vectors[:, resolved] / np.sqrt(values[resolved]), vectors[:, ~resolved], sizes[~resolved], smallest


def _inverse_root(gram):
    values, vectors = np.linalg.eigh(gram)
    return vectors / np.sqrt(values) @ vectors.conj().T
