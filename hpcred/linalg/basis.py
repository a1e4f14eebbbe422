"""Grow a mass-orthonormal basis, V^T M V = I, by blocks, and count what is dropped as dependent.

Where dofs have no mass, M is no inner product on all motions. Then another matrix, such as M + tau^2 K, takes its place
(`inner`), and what is said of M and of mass images below is said of that.

Block Gram-Schmidt in the inner product of M with repeated projection; the rank of a block is decided on
columns scaled to unit M-norm (Stathopoulos & Wu, SIAM J. Sci. Comput. 23(6), 2002, for the Gram-based step),
and directions that the Gram matrix cannot resolve are separated, projected again and judged by themselves.
The products M V are kept beside V and follow what is done to V, so that a block costs one product with M.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..parallel.decisions import decided
from ..parallel.failures import ComputationError
from ..parallel.petsc import MPI, PETSc
from .blocks import (
    Block,
    View,
    add_product,
    apply,
    copy_of,
    create_block,
    dense,
    fold,
    from_dense,
    inner,
    multiply,
    stacked_inner,
    times,
    unfold,
)
from .csr import diagonal_of

RESOLVED = 1e-4  # eigenvalues of a unit-diagonal Gram matrix above this are safe to divide by
ENLARGED = 3.0  # by how much separation may enlarge round-off of columns that are not projected again
PASSES = 20  # of projection or separation; two or three are usual
NO_MASS = 1e-13  # of x^T diag(M) x: x^T M x below it is round-off, and x moves no mass
NEGATIVE = 1e-10  # the same, which is no round-off if negative
STALE = 10  # how far columns may be cancelled before their mass images are computed anew
ORTHONORMAL = 1e-13  # what a block that is taken as it is may differ by from an orthonormal one


@dataclass(frozen=True)
class Extension:
    """What a block brought: how many `kept` directions were new, and how clear that was.

    A direction's weight is the part of it outside of the basis, relative to the column that brought it, in M-norms:
    `smallest_kept` (inf if none was kept) and `largest_dropped` (0 if none was dropped) lie on both sides of the
    deflation tolerance. `massless`: directions that were dropped since they move no mass (NO_MASS).
    """

    kept: int = 0
    smallest_kept: float = np.inf
    largest_dropped: float = 0.0
    massless: int = 0


class WithMassImages:
    """Columns X with their mass images M X, which linear combinations act on alike.

    `cancelled`: how much smaller a column may have become by subtraction since M was applied; its image has round-off
    so many times larger. All methods are collective.
    """

    def __init__(self, mass: PETSc.Mat, block: Block, mass_images: Block | None = None, cancelled: float = 1.0):
        self._mass, self.cancelled = mass, cancelled
        self.block = copy_of(block, mass)
        if mass_images is not None:
            self.mass_images = copy_of(mass_images, mass)
        else:
            count = self.block.getActiveColumns()[1]
            self.mass_images = create_block(mass, max(count, 1))
            self.mass_images.setActiveColumns(0, count)
            self.renew()

    def copy(self) -> WithMassImages:
        return WithMassImages(self._mass, self.block, self.mass_images, self.cancelled)

    def renew(self):
        """Compute the mass images anew."""
        apply(self._mass, self.block, self.mass_images)
        self.cancelled = 1.0

    def combine(self, factor: np.ndarray, cancelled: float = 1.0):
        """X <- X factor; `cancelled`: how much smaller than before a column has become."""
        for block in (self.block, self.mass_images):
            multiply(block, factor)
            block.setActiveColumns(0, factor.shape[1])
        self.cancelled *= cancelled
        if self.cancelled > STALE and factor.size:
            self.renew()


class Basis:
    """Columns with V^T M V = I, also M-orthogonal to the columns of `deflate` (for rigid-body modes; or None).

    `tolerance`: a direction whose weight (see Extension) is not larger is dropped. `room`: columns to expect. `keeps`:
    whether M V is kept beside V, which takes as much memory as V and saves products with M. `inner`: the matrix of
    another inner product, by default M. All methods are collective, and what they decide is decided once for all
    ranks.
    """

    width = 1  # real columns of a column

    def __init__(self, mass: PETSc.Mat, deflate: Block | None = None, tolerance: float = 1e-12, room: int = 16,
                 keeps: bool = True, inner: PETSc.Mat | None = None):  # fmt: skip
        self.mass, self.tolerance = mass if inner is None else inner, tolerance
        self.comm = mass.comm.tompi4py()
        self._diagonal = _weights_of(mass)
        self._leading = 0
        self._cancelled = 1.0  # how much round-off in M V has grown, as of the images of pending columns
        self.size = 0
        deflated = 0 if deflate is None else np.diff(deflate.getActiveColumns())[0]
        self._block = create_block(mass, deflated + self.width * room)
        self._mass_images = create_block(mass, deflated + self.width * room) if keeps else None
        if deflate is not None:  # motions without force: K adds nothing to them but round-off
            rigid = WithMassImages(mass, deflate)
            self._append(rigid.block, rigid.mass_images)
            self._leading, self.size = deflated, 0

    @staticmethod
    def _gram(product: np.ndarray) -> np.ndarray:
        """X^H Y from the products of the real columns that make up X and Y."""
        return product

    @staticmethod
    def _factor(factor: np.ndarray) -> np.ndarray:
        """Real form of a factor of the columns."""
        return factor

    def _blocks(self):
        return [block for block in (self._block, self._mass_images) if block is not None]

    @property
    def columns(self) -> View:
        """V as it is now (n, width size); its memory is owned by the basis."""
        return self.columns_between(0, self.size)

    def columns_between(self, start: int, stop: int) -> View:
        """A view of the columns start .. stop - 1."""
        return View(self._block, self._leading + self.width * start, self._leading + self.width * stop)

    def mass_images_between(self, start: int, stop: int) -> View | None:
        """A view of M times the columns start .. stop - 1, None where M V is not kept."""
        return None if self._mass_images is None else self.columns_between(start, stop)._replace(bv=self._mass_images)

    def coefficients(self, block: Block) -> np.ndarray:
        """V^H M block (size, columns): the columns of a block in terms of the basis."""
        if self._mass_images is not None:
            return self._gram(inner(self.mass_images_between(0, self.size), block))
        return self._gram(inner(self.columns, WithMassImages(self.mass, block).mass_images))

    @property
    def _end(self):
        return self._leading + self.width * self.size

    def _all(self, bv=None) -> View:
        """All columns, with those that are deflated, or M times these."""
        return View(self._block if bv is None else bv, 0, self._end)

    def extend(self, block: Block | np.ndarray, mass_images: Block | None = None) -> Extension:
        """Add the span of the active columns of `block`, which stays as it is; `mass_images`: M block if known.

        An array has the rows of this rank, (rows, k) or (rows,): see from_dense. Raises ComputationError when a column
        is not finite or M shows a negative norm, and InputError for an array that does not fit.
        """
        if isinstance(block, np.ndarray):
            block = from_dense(block, self.mass)
        first, last = block.getActiveColumns()
        if first == last:
            return Extension()
        start, weight, smallest, largest, massless = self.size, None, np.inf, 0.0, 0
        if mass_images is not None and decided(self.comm, _is_orthonormal, *self._products(block, mass_images)[:2]):
            self._append(block, mass_images)
            return Extension(self.size - start, smallest_kept=1.0)
        pending, taken = self._pending(block, mass_images)
        twice = taken is not None or not self._end  # what V has of the columns was taken out before
        for _ in range(PASSES):
            # X <- X - V V^H M X, with unit columns
            weight, gram, dropped, none = self._project_and_scale(pending, weight, taken)
            largest, massless = max(largest, dropped), massless + none
            if not weight.size:
                break
            # directions that X^H M X resolves join V, the others are looked at again
            scaled, rest, weight, resolved, cancelled = decided(self.comm, _separate, gram, weight)
            smallest = min(smallest, resolved)
            fresh = pending.copy() if weight.size else pending
            fresh.combine(self._factor(scaled), cancelled)
            if cancelled > ENLARGED or not twice:
                self._polish(fresh)
            self._append(fresh.block, fresh.mass_images)
            self._cancelled = max(self._cancelled, fresh.cancelled)
            del fresh  # its memory is for the next one
            if not weight.size:
                break
            pending.combine(self._factor(rest), np.inf)
            twice = False
        else:
            raise ComputationError("a block of basis vectors could not be orthonormalised: is M positive definite?")
        return Extension(self.size - start, float(smallest), float(largest), massless)

    def renew_mass_images(self, start: int, stop: int):
        """Compute the mass images of the columns start .. stop - 1 anew, of which they then are a function."""
        mass_images = self.mass_images_between(start, stop)
        if mass_images is not None and stop > start:
            apply(self.mass, self.columns_between(start, stop), mass_images)

    def restore(self, block: Block, ends):
        """Take over the columns of a basis that was written, in blocks that end before the columns `ends`.

        Raises ComputationError unless they are M-orthonormal.
        """
        self._append(block, block)
        for start, stop in zip([0, *ends], ends, strict=False):
            self.renew_mass_images(start, stop)
        defect = self.comm.bcast(self.defect())
        if not defect <= 1e-10:
            raise ComputationError(f"the columns of an earlier run are not orthonormal (defect {defect:.1e})")

    def defect(self) -> float:
        """max |V^H M V - I|, rigid-body modes included."""
        return self.gram()[1]

    def gram(self, mass: PETSc.Mat | None = None, weights: np.ndarray | None = None) -> tuple[np.ndarray, float]:
        """V^H M V (size, size), and max |V^H M V - I| with the rigid-body modes included; of another `mass` than that
        of the inner product if given, and with `weights` (size,) of the columns, by default 1."""
        # by a product that is not the one that V was made with
        gram = self._gram(inner(self._all(), times(self.mass if mass is None else mass, self._all())))
        first, w = self._leading // self.width, np.ones(len(gram))
        if weights is not None:
            w[first:] = weights
        return gram[first:, first:], float((np.abs(gram - np.eye(len(gram))) * np.outer(w, w)).max(initial=0.0))

    def multiply(self, factor: np.ndarray):
        """V <- V factor (54); factor (size, k), the same on all ranks."""
        for block in self._blocks():
            multiply(self.columns._replace(bv=block), self._factor(factor))
        self.size = factor.shape[1]

    def clear(self):
        """Drop all columns but those that are deflated."""
        self.size = 0

    def _pending(self, block, mass_images):
        """Columns to add, and what was taken out of them at once: V^H M X, or None.

        The mass images of V serve for that, so that M is applied to columns that will not be cancelled much more.
        """
        if mass_images is not None or self._mass_images is None or not self._end:
            return WithMassImages(self.mass, block, mass_images), None
        rest = copy_of(block, self.mass)
        taken = self._gram(inner(self._all(self._mass_images), rest))
        add_product(rest, self._all(), self._factor(taken), alpha=-1.0)
        return WithMassImages(self.mass, rest), taken

    def _products(self, block, mass_images):
        """V^H M X, X^H M X and x^T diag(M) x of a block X with its mass images."""
        *products, squared_norms = stacked_inner((self._all(), block), mass_images, self._diagonal)
        return *map(self._gram, products), np.diag(self._gram(np.diag(squared_norms[0]))).real

    def _project(self, pending):
        """X <- X - V (V^H M X); returns the coefficients, X^H M X and x^T diag(M) x from before."""
        inside, gram, sizes = self._products(pending.block, pending.mass_images)
        add_product(pending.block, self._all(), self._factor(inside), alpha=-1.0)
        if self._mass_images is None:
            pending.renew()
        else:
            add_product(pending.mass_images, self._all(self._mass_images), self._factor(inside), alpha=-1.0)
            pending.cancelled = max(pending.cancelled, self._cancelled)
        return inside, (gram + gram.conj().T) / 2, sizes

    def _project_and_scale(self, pending, weight, taken):
        """Project until the projection takes nothing more, scale to M-norm 1, drop what has become too small.

        `taken`: see _pending; counts where no column has a weight yet. Returns the weights of the columns left, their
        Gram matrix with unit diagonal, the largest weight dropped, and how many columns move no mass.
        """
        largest, massless = 0.0, 0
        for _ in range(PASSES):
            products = self._project(pending)
            scale, weight, gram, done, dropped, none, cancelled = decided(
                self.comm, _judge, *products, weight, taken, self.tolerance
            )
            largest, massless = max(largest, dropped), massless + none
            pending.combine(self._factor(scale), cancelled)
            if done:
                return weight, gram, largest, massless
        raise ComputationError("the projection of basis vectors does not come to rest: is M positive definite?")

    def _polish(self, block):
        """One more projection, and the symmetric orthonormalisation of well-conditioned columns."""
        inside, gram, _ = self._project(block)
        block.combine(self._factor(decided(self.comm, _inverse_root, gram - inside.conj().T @ inside)))

    def _append(self, block, mass_images):
        count = block.getActiveColumns()[1] - block.getActiveColumns()[0]
        end = self._end + count
        for stored, new in zip(self._blocks(), (block, mass_images), strict=False):
            if end > stored.getSizes()[1]:
                stored.resize(max(end, stored.getSizes()[1] * 4 // 3), copy=True)
            with dense(new) as source, dense(View(stored, end - count, end)) as target:
                source.copy(target)
        self.size += count // self.width


class ComplexBasis(Basis):
    """Complex columns with V^H M V = I, kept as pairs of real ones, Re and Im side by side (see blocks.fold).

    Blocks are such pairs too; sizes and factors count complex columns.
    """

    width = 2
    _gram = staticmethod(fold)
    _factor = staticmethod(unfold)


def _is_orthonormal(inside, gram):
    """Whether columns are orthonormal by themselves and to the basis."""
    defects = np.abs(inside).max(initial=0.0), np.abs(gram - np.eye(len(gram))).max(initial=0.0)
    return all(bool(defect <= ORTHONORMAL) for defect in defects)  # NaN is not


def _weights_of(mass):
    """The rows of this rank of |diag M|, with its smallest entry where there is none."""
    values = np.abs(diagonal_of(mass))
    smallest = mass.comm.tompi4py().allreduce(values[values > 0].min(initial=np.inf), op=MPI.MIN)
    return np.where(values > 0, values, smallest if np.isfinite(smallest) else 1.0)


def _judge(inside, gram, sizes, weight, taken, tolerance):
    """Decide which columns to keep after a projection; they have a weight, or something was `taken` of them before.

    `sizes`: x^T diag(M) x of the columns before it. Returns the factor that scales and drops columns, the weights and
    the Gram matrix of those kept, whether another projection would take next to nothing, the largest weight dropped,
    how many columns move no mass, and how much smaller a column has become.
    """
    squared_norms = np.diag(gram).real
    if not np.isfinite(squared_norms).all():
        raise ComputationError("a basis vector has entries that are not finite")
    if (squared_norms < -NEGATIVE * np.maximum(sizes, np.abs(squared_norms).max(initial=0.0))).any():
        raise ComputationError("a basis vector has a negative M-norm: the mass matrix is indefinite")
    massless = int(((squared_norms <= NO_MASS * sizes) & (sizes > 0)).sum())
    norms = np.sqrt(np.where(squared_norms > NO_MASS * sizes, squared_norms, 0.0))
    if weight is None:
        before = squared_norms if taken is None else squared_norms + _squared_norms_taken(taken, inside)
        weight = np.sqrt(np.divide(1.0, before, out=np.ones_like(before), where=before > 0))
    weight = weight * norms
    kept = np.flatnonzero((norms > 0) & (weight > tolerance))
    dropped = np.delete(weight, kept)[np.delete(norms, kept) > 0].max(initial=0.0)
    scale = np.zeros((norms.size, kept.size))
    scale[kept, np.arange(kept.size)] = 1.0 / norms[kept]
    weight, inside = weight[kept], inside @ scale
    gram = scale.T @ gram @ scale - inside.conj().T @ inside
    left = np.diag(gram).real
    least = left.min(initial=1.0)
    cancelled = 1.0 / np.sqrt(least) if least > 0 else np.inf
    if not (left > 0.25).all():  # twice is enough
        return scale, weight, gram, False, dropped, massless, cancelled
    unit = 1.0 / np.sqrt(left)
    return scale * unit, weight / unit, gram * np.outer(unit, unit), True, dropped, massless, cancelled


def _squared_norms_taken(taken, inside):
    """By how much the squared M-norms of columns X have become smaller when V `taken` was taken out of them.

    `inside`: V^H M X that round-off left in them.
    """
    return (np.abs(taken) ** 2 + 2 * (taken.conj() * inside).real).sum(axis=0)


def _separate(gram, weight):
    """Directions of unit columns that their Gram matrix resolves, scaled to be orthonormal, and the rest.

    Returns both as factors, the weights of the rest, the smallest weight of the others, and how much they are enlarged.
    """
    values, vectors = np.linalg.eigh(gram)
    resolved = values > RESOLVED
    sizes = 1.0 / np.sqrt((np.abs(vectors) ** 2 / weight[:, None] ** 2).sum(axis=0))
    smallest = (sizes * np.sqrt(np.maximum(values, 0.0)))[resolved].min(initial=np.inf)
    enlarged = 1.0 / np.sqrt(values[resolved].min(initial=1.0))
    scaled = vectors[:, resolved] / np.sqrt(values[resolved])
    return scaled, vectors[:, ~resolved], sizes[~resolved], smallest, enlarged


def _inverse_root(gram):
    values, vectors = np.linalg.eigh(gram)
    return vectors / np.sqrt(values) @ vectors.conj().T
