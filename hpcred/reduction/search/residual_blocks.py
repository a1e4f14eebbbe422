"""Find the block of loads that a basis misses most over a band, from its residuals.

It serves many inputs, or a given D, whose Krylov sequence at one point would be blind to the rest of the band. (Halko,
Martinsson & Tropp, SIAM Review 53(2), 2011, for the random directions and the power step.)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...linalg.blocks import (
    Block,
    add_product,
    copy_of,
    create_block,
    dense,
    inner,
    local_rows,
    multiply,
    times,
)
from ...linalg.csr import diagonal_of
from ...parallel.decisions import decided
from ...parallel.failures import agreed
from ...parallel.petsc import PETSc
from ..small.error_estimate import UNIFORM, measure_over
from ..small.pseudo_modal import columns

RESIDUALS = 40  # frequencies at which residuals are taken
WEAKEST = 1e-14  # of the largest eigenvalue of a Gram matrix: below it is round-off


class ResidualSpace(NamedTuple):
    """What residuals L c_L - A_1 V c_1 - A_2 V c_2 - ... are made of; methods are collective.

    `model`: whose rows blocks have, equilibrated for the rigid-body modes `rigid` (or None); `loads` L; `columns` V;
    `matrices` A_k with whether each is symmetric; `scale`: of the rows of this rank; `restore`: T of a frame, where V
    stands for T V and A_k has the rows of that, else None; `mass_images`: A_1 V, where the basis keeps that, else None.
    """

    model: object
    rigid: object
    loads: Block
    columns: Block
    matrices: list[tuple[PETSc.Mat, bool]]
    scale: np.ndarray
    restore: PETSc.Mat | None = None
    mass_images: Block | None = None

    def combined(self, factors):
        """Return L c_L - A_1 V c_1 - ... for the factors c, equilibrated, with scaled rows, as a block."""
        block = create_block(self.model.K, factors[0].shape[1])
        add_product(block, self.loads, factors[0], beta=0.0)
        rest = list(zip(self.matrices, factors[1:], strict=True))
        if rest and self.mass_images is not None:
            add_product(block, self.mass_images, factors[1], alpha=-1.0)
            rest = rest[1:]
        for (mat, _), factor in rest:
            copied = create_block(self.model.K, factor.shape[1])
            add_product(copied, self.columns, factor, beta=0.0)
            add_product(block, self._times(mat, copied), np.eye(factor.shape[1]), alpha=-1.0)
        if self.rigid is not None:
            self.rigid.equilibrate(block)
        with local_rows(block) as rows:
            rows *= self.scale[:, None]
        return block

    def products_with(self, block):
        """L^T S Y and V^T A_k^T S Y of a block Y, with S the scaling of the rows."""
        scaled = copy_of(block, self.model.K)
        with local_rows(scaled) as rows:
            rows *= self.scale[:, None]
        products, rest = [inner(self.loads, scaled)], self.matrices
        if rest and self.mass_images is not None:
            products.append(inner(self.mass_images, scaled))
            rest = rest[1:]
        for mat, symmetric in rest:
            product = self._times(mat if symmetric else mat.transpose(PETSc.Mat()), scaled)
            products.append(inner(self.columns, product))
        return products

    def _times(self, mat, block):
        if self.restore is None:
            return times(mat, block)
        product = times(mat, times(self.restore, block))
        result = create_block(self.model.K, product.getActiveColumns()[1])
        with dense(product) as source, dense(result) as target:
            self.restore.transposeMatMult(source).copy(target)
        return result

    def leading(self, seeds, coefficients, width, power=True):
        """Return the `width` leading directions of residuals, as a block (n, width): randomised, with one `power` step;
        without it those of the random combinations alone, for a quarter of the products.

        `coefficients(place)`: of the residuals of one of several models, each computed by one rank; `seeds` of their
        random combinations, by place.
        """
        comm, samples = self.model.comm, _Samples(self, seeds, coefficients)
        # Y <- random combinations of R, then R R^T Y
        block = self.combined(samples.combinations(2 * width))
        _orthonormalise(block, comm, 2 * width if power else width)
        if power:
            block = self.combined(samples.power(self.products_with(block)))
            _orthonormalise(block, comm, 2 * width)
            # Y <- Y U with the left singular vectors U of Y^T R
            turn = samples.directions(self.products_with(block), width)
            multiply(block, turn)
            block.setActiveColumns(0, turn.shape[1])
        with local_rows(block) as rows:
            rows /= self.scale[:, None]
        return block


class _Samples:
    """Residuals R = L c_L - A_1 V c_1 - ... of several models as coefficients c, of which each rank has its share.

    Methods are collective, and give the same on all ranks.
    """

    def __init__(self, space: ResidualSpace, seeds, coefficients):
        self._comm = space.model.comm
        first, last = space.columns.getActiveColumns()
        self._rows = [space.loads.getActiveColumns()[1], *[last - first] * len(space.matrices)]
        mine = range(len(seeds))[self._comm.rank :: self._comm.size]
        with agreed(self._comm):
            self._factors = [coefficients(place) for place in mine]
        self._randoms = [np.random.default_rng(seeds[place]) for place in mine]

    def combinations(self, count):
        """Return coefficients of `count` random combinations."""
        widths = [factors[0].shape[1] for factors in self._factors]
        draws = [random.standard_normal((width, count)) for random, width in zip(self._randoms, widths, strict=True)]
        return self._summed(draws, count)

    def power(self, products):
        """Return coefficients of R R^T Y from L^T Y and V^T A_k^T Y."""
        return self._summed([transposed_times(own, products) for own in self._factors], products[0].shape[1])

    def directions(self, products, width):
        """Return the leading left singular vectors of Y^T R."""
        blocks = [transposed_times(own, products) for own in self._factors]
        mine = np.vstack([np.zeros((0, products[0].shape[1])), *blocks])
        gathered = self._comm.gather(np.linalg.qr(mine, mode="r") if len(blocks) > 1 else mine)  # fewer rows of many
        return decided(self._comm, lambda: np.linalg.svd(np.vstack(gathered).T, full_matrices=False)[0][:, :width])

    def _summed(self, combinations, width):
        """Return the sum over models and ranks of their coefficients times a matrix of each."""
        total = [np.zeros((rows, width)) for rows in self._rows]
        for factors, combination in zip(self._factors, combinations, strict=True):
            for target, factor in zip(total, factors, strict=True):
                target += factor @ combination
        gathered = self._comm.gather(total)
        return decided(self._comm, lambda: [sum(each) for each in zip(*gathered, strict=True)])


def residual_block(projections, settings, f, width, power=True):
    """Return the `width` leading directions of the residuals over the band and at f (Hz), each over the scale of its
    input or output (see the module measure), as a block (n, width). Collective.

    `projections`: of the basis that leaves the residuals; `settings` of the search, with its band and measure; `power`:
    see ResidualSpace.leading.
    """
    S = np.unique([*np.linspace(*settings.band, RESIDUALS), f])
    return _space(projections).leading(
        [projections.basis.size], lambda _: _coefficients(projections, settings, S), width, power
    )


def largest_residual(projections, frequencies, damped=True) -> float:
    """Return the largest ||R(s)|| / ||L|| of an input or output at frequencies (Hz), rows scaled by diag(K)^(-1/2).
    Collective."""
    model = projections.run.model
    space = _space(projections, damped)
    factors = decided(model.comm, _coefficients, projections, None, np.array(frequencies), damped)
    whole = space._replace(matrices=[]).combined(factors[:1])
    rest = space.combined(factors)
    # real and imaginary parts are columns of their own
    rest, whole = (np.hypot(*np.split(np.sqrt(np.diag(inner(block, block))), 2)) for block in (rest, whole))
    return float(decided(model.comm, lambda: np.divide(rest, whole, out=np.zeros_like(rest), where=whole > 0).max()))


def transposed_times(factors, products):
    """Return R^T Y (N, k) for the coefficients of residuals R and the products L^T Y, V^T A_k^T Y."""
    total = factors[0].T @ products[0]
    for factor, product in zip(factors[1:], products[1:], strict=True):
        total = total - factor.T @ product
    return total


def _space(projections, damped=True) -> ResidualSpace:
    run, model = projections.run, projections.run.model
    matrices = [(model.M, True), (model.K, projections.symmetric)]
    if damped:
        matrices += [(mat, key != "D" or model.is_symmetric(key)) for key, mat in projections.beside.matrices.items()]
    return ResidualSpace(model, run.rigid, projections.loads, projections.basis.columns, matrices, row_scale(model),
                         mass_images=mass_images(run, projections.basis))  # fmt: skip


def mass_images(run, basis):
    """Return M V of a basis, if it keeps that, else None."""
    return None if run.tau else basis.mass_images_between(0, basis.size)


def _coefficients(projections, settings, S, damped=True):
    model = projections.model()
    return residual_coefficients(model if damped else model.without_D(), settings, S)


def residual_coefficients(model, settings, S, uniform=UNIFORM):
    """Return coefficients of R = L P w - M V c_M - K V c_K - D V c_D - K_v V c_v at S (Hz), Re beside Im: P w (l, N),
    c_M.. (m, N).

    `model`: that of V; P: inputs and outputs in terms of L, w: one over their scales, 1 without settings.
    """
    io = model.io
    P, weights = (io.inputs if io.are_same else np.hstack(io[:2])), 1.0
    if settings is not None:
        h, g = measure_over(settings.error_measure, settings.band, model, uniform).scales(*model.responses(S))
        scales = g if io.are_same else np.hstack([g, io.column_scales(2j * np.pi * S, h)])
        weights = np.divide(1.0, scales, out=np.zeros_like(scales), where=scales > 0)[:, None, :]
    states = model.solve(S, model.L @ P) * weights
    a, b, s = model.damping.coefficients(S)
    loads = columns(np.broadcast_to(P.astype(complex), (len(S), *P.shape)) * weights)
    factors = (b, a, *model.operator.coefficients(s))
    return [loads, *(model.vectors @ columns(factor[:, None, None] * states) for factor in factors)]


def row_scale(model):
    """1 / sqrt(diag K) of the rows of this rank."""
    values, typical = np.abs(diagonal_of(model.K)), model.mean_diagonal_of_k
    return 1 / np.sqrt(np.where(values > 1e-12 * typical, values, typical))


def _orthonormalise(block, comm, most):
    """block <- its strongest orthonormal directions, at most so many, the weakest to round-off left out."""
    for _ in range(2):
        values, vectors = decided(comm, np.linalg.eigh, inner(block, block))
        kept = np.flatnonzero(values > WEAKEST * values.max())[-most:]
        multiply(block, vectors[:, kept] / np.sqrt(values[kept]))
        block.setActiveColumns(0, kept.size)
