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
from ...parallel.petsc import PETSc
from ..small.error_estimate import measure_over
from ..small.pseudo_modal import columns

RESIDUALS = 40  # frequencies at which residuals are taken
WEAKEST = 1e-14  # of the largest eigenvalue of a Gram matrix: below it is round-off


class ResidualSpace(NamedTuple):
    """What residuals L c_L - A_1 V c_1 - A_2 V c_2 - ... are made of; methods are collective.

    `model`: whose rows blocks have, equilibrated for the rigid-body modes `rigid` (or None); `loads` L; `columns` V;
    `matrices` A_k with whether each is symmetric; `scale`: of the rows of this rank; `restore`: T of a frame, where V
    stands for T V and A_k has the rows of that, else None.
    """

    model: object
    rigid: object
    loads: Block
    columns: Block
    matrices: list[tuple[PETSc.Mat, bool]]
    scale: np.ndarray
    restore: PETSc.Mat | None = None

    def combined(self, factors):
        """Return L c_L - A_1 V c_1 - ... for the factors c, equilibrated, with scaled rows, as a block."""
        block = create_block(self.model.K, factors[0].shape[1])
        add_product(block, self.loads, factors[0], beta=0.0)
        for (mat, _), factor in zip(self.matrices, factors[1:], strict=True):
            part = create_block(self.model.K, factor.shape[1])
            add_product(part, self.columns, factor, beta=0.0)
            add_product(block, self._times(mat, part), np.eye(factor.shape[1]), alpha=-1.0)
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
        found = [inner(self.loads, scaled)]
        for mat, symmetric in self.matrices:
            product = self._times(mat if symmetric else mat.transpose(PETSc.Mat()), scaled)
            found.append(inner(self.columns, product))
        return found

    def _times(self, mat, block):
        if self.restore is None:
            return times(mat, block)
        product = times(mat, times(self.restore, block))
        result = create_block(self.model.K, product.getActiveColumns()[1])
        with dense(product) as source, dense(result) as target:
            self.restore.transposeMatMult(source).copy(target)
        return result

    def leading(self, samples, width, power=True):
        """Return the `width` leading directions of residuals, as a block (n, width): randomised, with one `power` step;
        without it those of the random combinations alone, for a quarter of the products.

        `samples` of the residuals: take(2 width) gives factors of as many random combinations, power(products) those of
        R R^T Y and directions(products, width) the turn of Y to the leading ones, all the same on all ranks.
        """
        comm = self.model.comm
        block = self.combined(samples.take(2 * width))
        _orthonormalise(block, comm, 2 * width if power else width)
        if power:
            block = self.combined(samples.power(self.products_with(block)))
            _orthonormalise(block, comm, 2 * width)
            turn = samples.directions(self.products_with(block), width)
            multiply(block, turn)
            block.setActiveColumns(0, turn.shape[1])
        with local_rows(block) as rows:
            rows /= self.scale[:, None]
        return block


def residual_block(projections, settings, f, width, power=True):
    """Return the `width` leading directions of the residuals over the band and at f (Hz), each over the scale of its
    input or output (see the module measure), as a block (n, width). Collective.

    `projections`: of the basis that leaves the residuals; `settings` of the search, with its band and measure; `power`:
    see ResidualSpace.leading.
    """
    S = np.unique([*np.linspace(*settings.band, RESIDUALS), f])
    return _space(projections).leading(_Samples(projections, settings, S), width, power)


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


class _Samples:
    """Residuals R as the coefficients c of L c_L - M V c_M - K V c_K - ..., which the rank that decides has alone."""

    def __init__(self, projections, settings, S):
        self._projections, self._known = projections, (projections, settings, S)

    def take(self, count):
        """Return coefficients of `count` random combinations of the residuals at S (Hz)."""
        return self._decided(self._taken, count)

    def power(self, products):
        """Return coefficients of R R^T Y from L^T Y and V^T A^T Y."""
        return self._decided(lambda: self._times(transposed_times(self._factors, products)))

    def directions(self, products, width):
        """Return the leading left singular vectors of Y^T R."""
        return self._decided(lambda: self._leading(transposed_times(self._factors, products).T, width))

    def _decided(self, function, *arguments):
        return decided(self._projections.run.model.comm, function, *arguments)

    def _taken(self, count):
        self._factors = _coefficients(*self._known)
        random = np.random.default_rng(self._projections.basis.size)
        return self._times(random.standard_normal((self._factors[0].shape[1], count)))

    def _leading(self, products, width):
        return np.linalg.svd(products, full_matrices=False)[0][:, :width]

    def _times(self, factor):
        return [part @ factor for part in self._factors]


def transposed_times(factors, products):
    """Return R^T Y (N, k) for the coefficients of residuals R and the products L^T Y, V^T A_k^T Y."""
    found = factors[0].T @ products[0]
    for part, product in zip(factors[1:], products[1:], strict=True):
        found = found - part.T @ product
    return found


def _space(projections, damped=True) -> ResidualSpace:
    run, model = projections.run, projections.run.model
    matrices = [(model.M, True), (model.K, projections.symmetric)]
    if damped:
        matrices += [(mat, key != "D" or model.is_symmetric(key)) for key, mat in projections.beside.matrices.items()]
    return ResidualSpace(model, run.rigid, projections.loads, projections.basis.columns, matrices, row_scale(model))


def _coefficients(projections, settings, S, damped=True):
    model = projections.model()
    return residual_coefficients(model if damped else model.without_D(), settings, S)


def residual_coefficients(model, settings, S):
    """Return coefficients of R = L P w - M V c_M - K V c_K - D V c_D - K_v V c_v at S (Hz), Re beside Im: P w (l, N),
    c_M.. (m, N).

    `model`: that of V; P: inputs and outputs in terms of L, w: one over their scales, 1 without settings.
    """
    io = model.io
    P, weights = (io.inputs if io.are_same else np.hstack(io[:2])), 1.0
    if settings is not None:
        h, g = measure_over(settings.error_measure, settings.band, model).scales(*model.responses(S))
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
