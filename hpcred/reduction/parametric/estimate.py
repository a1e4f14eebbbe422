"""Estimate the error of a model over the band and values of parameters, and find what its basis misses.

As at one value (see small.error_estimate) the error of a model is seen from a basis that is a block richer. Here
that block is made from the leading directions of the residuals over the band and all training points, solved with the
factor that there is at the last point: close enough to the inverse at all of them, and one block for all.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...parallel.decisions import decided, shared_out
from ...parallel.failures import agreed
from ..search.residual_blocks import ResidualSpace, residual_coefficients, row_scale, transposed_times
from ..small.error_estimate import UNIFORM, Comparison, grid, measure_over
from ..small.pseudo_modal import nested
from .affine import AffineProjections

COARSE = UNIFORM // 4  # frequencies of the band, beside those at poles
RESIDUALS = 12  # frequencies at which residuals are taken at each training point, beside those at poles


class Estimate(NamedTuple):
    """The largest error over the band at each of some points (N,), and at which frequencies (N,) in Hz."""

    errors: np.ndarray
    frequencies: np.ndarray


def coarsely(pair: Comparison, band) -> tuple[float, float]:
    """Return the largest error at some frequencies of a band (Hz) and at poles, and where it is; local."""
    S = grid([pair.outer], band, COARSE, None)
    curve = pair.curve(S)
    return float(curve.max()), float(S[curve.argmax()])


def estimate(projections: AffineProjections, points, count: int, settings) -> Estimate:
    """Return the error at points of the model of the first `count` columns, seen from all. Collective."""

    def at(point):
        models = projections.at(point)
        inner, outer = models.model(count), models.model()
        measure = measure_over(settings.error_measure, settings.band, outer, COARSE)
        return coarsely(Comparison(inner, outer, nested(inner, outer), measure), settings.band)

    found = shared_out(projections.form.parametric.comm, at, points)
    return Estimate(*(np.array(part) for part in zip(*found, strict=True)))


def residual_block(projections: AffineProjections, framed, points, settings, width):
    """Return the `width` leading directions of the residuals over the band and the points, as a block. Collective.

    `framed`: a model whose factor is to be solved with.
    """
    form = projections.form
    matrices = [(mat, symmetric) for _, _, mat, symmetric in form.matrices]
    if not form.has_mass:
        matrices.insert(0, (form.parametric.model.M, True))
    space = ResidualSpace(
        framed.model, framed.rigid, form.loads, projections.basis.columns, matrices, row_scale(framed.model),
        form.restore,
    )  # fmt: skip
    return space.leading(_Samples(projections, points, settings), width)


class _Samples:
    """Residuals at points, of which each rank has its share (see ResidualSpace)."""

    def __init__(self, projections, points, settings):
        self._projections, self._points, self._settings = projections, points, settings
        self._comm = projections.form.parametric.comm

    def take(self, count):
        places = list(range(len(self._points)))[self._comm.rank :: self._comm.size]
        with agreed(self._comm):
            self._factors = [self._coefficients(place) for place in places]
        seeds = [[self._projections.basis.size, place] for place in places]
        draws = [np.random.default_rng(seed).standard_normal((factors[0].shape[1], count))
                 for seed, factors in zip(seeds, self._factors, strict=True)]  # fmt: skip
        return self._summed(draws, count)

    def power(self, products):
        factors = [transposed_times(factors, products) for factors in self._factors]
        return self._summed(factors, products[0].shape[1])

    def directions(self, products, width):
        """Return the leading left singular vectors of Y^T R, by its Gram matrix."""
        parts = [transposed_times(factors, products) for factors in self._factors]
        gram = sum((part.T @ part for part in parts), np.zeros((products[0].shape[1],) * 2))
        gram = self._sum([gram])[0]
        return decided(self._comm, lambda: np.linalg.eigh(gram)[1][:, ::-1][:, :width])

    def _summed(self, factors, width):
        """Return the sum over points of their coefficients times a factor of each."""
        form, basis = self._projections.form, self._projections.basis
        shapes = [form.loads.getActiveColumns()[1]]
        shapes += [basis.size] * (len(form.matrices) + (not form.has_mass))
        found = [np.zeros((rows, width)) for rows in shapes]
        for own, factor in zip(self._factors, factors, strict=True):
            for target, part in zip(found, own, strict=True):
                target += part @ factor
        return self._sum(found)

    def _sum(self, arrays):
        """Return the sums over ranks of arrays, the same on all."""
        gathered = self._comm.gather(arrays)
        found = None if gathered is None else [sum(each) for each in zip(*gathered, strict=True)]
        return self._comm.bcast(found)

    def _coefficients(self, place):
        """Return the coefficients of the residuals at a point, of the loads and of all parts."""
        projections, settings = self._projections, self._settings
        form = projections.form
        theta = form.theta(self._points[place])
        models = projections.at(self._points[place])
        model = models.model()
        S = grid([model], settings.band, RESIDUALS, None)
        loads, *by_matrix = residual_coefficients(model, settings, S)
        there = dict.fromkeys(["M", *form.operators[0].terms])
        by_matrix = dict(zip(there, [models.turn @ part for part in by_matrix], strict=True))
        found = [loads] if form.has_mass else [loads, by_matrix["M"]]
        return found + [theta[place] * by_matrix[key] for key, place, _, _ in form.matrices]
