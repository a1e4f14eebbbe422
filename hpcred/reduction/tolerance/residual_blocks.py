"""Find the block of loads that a basis misses most over a band, from its residuals.

It serves many inputs, or a given D, whose Krylov sequence at one point would be blind to the rest of the band. (Halko,
Martinsson & Tropp, SIAM Review 53(2), 2011, for the random directions and the power step.)
"""

from __future__ import annotations

import numpy as np

from ...linalg.blocks import add_product, copy_of, create_block, inner, local_rows, multiply, times
from ...linalg.csr import diagonal_of
from ...parallel.decisions import decided
from ...parallel.petsc import PETSc
from .error_estimate import measure_over
from .pseudo_modal import columns

RESIDUALS = 40  # frequencies at which residuals are taken
WEAKEST = 1e-14  # of the largest eigenvalue of a Gram matrix: below it is round-off


def residual_block(projections, settings, f, width):
    """Return the `width` leading directions of the residuals over the band and at f (Hz), each over the scale of its
    input or output (see the module measure), as a block (n, width): randomised, with one power step. Collective.

    `projections`: of the basis that leaves the residuals; `settings` of the search, with its band and measure.
    """
    comm = projections.run.model.comm
    matrices, scale = _matrices(projections), _row_scale(projections.run.model)
    samples, S = _Samples(), np.unique([*np.linspace(*settings.band, RESIDUALS), f])

    def combine(factors):
        """Return orthonormal directions of the rows of the residuals times a factor, scaled."""
        block = _combined(projections, matrices, factors, scale)
        _orthonormalise(block, comm)
        return block

    def products_with(block):
        return _products_with(block, projections, matrices, scale)

    block = combine(decided(comm, samples.take, projections, settings, S, 2 * width))
    block = combine(decided(comm, samples.power, products_with(block)))
    turn = decided(comm, samples.directions, products_with(block), width)
    multiply(block, turn)
    block.setActiveColumns(0, turn.shape[1])
    with local_rows(block) as rows:
        rows /= scale[:, None]
    return block


def largest_residual(projections, frequencies, damped=True) -> float:
    """Return the largest ||R(s)|| / ||L|| of an input or output at frequencies (Hz), rows scaled by diag(K)^(-1/2).
    Collective."""
    model = projections.run.model
    matrices, scale = _matrices(projections)[: None if damped else 2], _row_scale(model)
    factors = decided(model.comm, _residual_coefficients, projections, None, np.array(frequencies), damped)
    whole = _combined(projections, [], factors[:1], scale)
    rest = _combined(projections, matrices, factors, scale)
    # real and imaginary parts are columns of their own
    rest, whole = (np.hypot(*np.split(np.sqrt(np.diag(inner(block, block))), 2)) for block in (rest, whole))
    return float(decided(model.comm, lambda: np.divide(rest, whole, out=np.zeros_like(rest), where=whole > 0).max()))


class _Samples:
    """Residuals R as the coefficients c of L c_L - M V c_M - K V c_K - ..., which the rank that decides has alone."""

    def take(self, projections, settings, S, count):
        """Return coefficients of `count` random combinations of the residuals at S (Hz)."""
        self._factors = _residual_coefficients(projections, settings, S)
        random = np.random.default_rng(projections.basis.size)
        return self._times(random.standard_normal((self._factors[0].shape[1], count)))

    def power(self, products):
        """Return coefficients of R R^T Y from L^T Y and V^T A^T Y."""
        return self._times(self._transposed_times(products))

    def directions(self, products, width):
        """Return the leading left singular vectors of Y^T R."""
        left = np.linalg.svd(self._transposed_times(products).T, full_matrices=False)[0]
        return left[:, :width]

    def _times(self, factor):
        return [part @ factor for part in self._factors]

    def _transposed_times(self, products):
        """Return R^T Y (N, k)."""
        found = self._factors[0].T @ products[0]
        for part, product in zip(self._factors[1:], products[1:], strict=True):
            found = found - part.T @ product
        return found


def _matrices(projections):
    model = projections.run.model
    return [model.M, model.K, *([model.D] if projections.D is not None else [])]


def _products_with(block, projections, matrices, scale):
    """L^T S Y and V^T A^T S Y for M, K, D, with S the scaling of the rows."""
    model = projections.run.model
    scaled = copy_of(block, model.K)
    with local_rows(scaled) as rows:
        rows *= scale[:, None]
    found = [inner(projections.loads, scaled)]
    for mat in matrices:
        if mat is model.D and not model.symmetric:
            mat = mat.transpose(PETSc.Mat())
        found.append(inner(projections.basis.columns, times(mat, scaled)))
    return found


def _combined(projections, matrices, factors, scale):
    """L c_L - M V c_M - K V c_K - ... for the factors c, equilibrated, with scaled rows, as a block for the caller."""
    run = projections.run
    block = create_block(run.model.K, factors[0].shape[1])
    add_product(block, projections.loads, factors[0], beta=0.0)
    for mat, factor in zip(matrices, factors[1:], strict=True):
        part = create_block(mat, factor.shape[1])
        add_product(part, projections.basis.columns, factor, beta=0.0)
        add_product(block, times(mat, part), np.eye(factor.shape[1]), alpha=-1.0)
    if run.rigid is not None:
        run.rigid.equilibrate(block)
    with local_rows(block) as rows:
        rows *= scale[:, None]
    return block


def _residual_coefficients(projections, settings, S, damped=True):
    """Return coefficients of R = L P w - M V c_M - K V c_K - D V c_D at S (Hz), Re beside Im: P w (l, N), c_M.. (m, N).

    P: inputs and outputs in terms of L, w: one over their scales, 1 without settings.
    """
    model, io = projections.model(), projections.io
    if not damped:
        model = model.without_D()
    P, weights = (io.inputs if io.are_same else np.hstack(io[:2])), 1.0
    if settings is not None:
        h, g = measure_over(settings.error_measure, settings.band, model).scales(*model.responses(S))
        scales = g if io.are_same else np.hstack([g, io.column_scales(2j * np.pi * S, h)])
        weights = np.divide(1.0, scales, out=np.zeros_like(scales), where=scales > 0)[:, None, :]
    states = model.solve(S, model.L @ P) * weights
    a, b, s = model.damping.coefficients(S)
    loads = columns(np.broadcast_to(P.astype(complex), (len(S), *P.shape)) * weights)
    factors = (b, a, s) if model.D is not None else (b, a)
    return [loads, *(model.vectors @ columns(factor[:, None, None] * states) for factor in factors)]


def _row_scale(model):
    """1 / sqrt(diag K) of the rows of this rank."""
    values, typical = np.abs(diagonal_of(model.K)), model.mean_diagonal_of_k
    return 1 / np.sqrt(np.where(values > 1e-12 * typical, values, typical))


def _orthonormalise(block, comm):
    """block <- its orthonormal directions, the weakest of them to round-off left out."""
    for _ in range(2):
        values, vectors = decided(comm, np.linalg.eigh, inner(block, block))
        kept = values > WEAKEST * values.max()
        multiply(block, vectors[:, kept] / np.sqrt(values[kept]))
        block.setActiveColumns(0, int(kept.sum()))
