"""Estimate the error of a model over the band and values of parameters, and find what its basis misses.

As at one value (see small.error_estimate) the error of a model is seen from a basis that is a block richer. Here
that block is made from the leading directions of the residuals over the band and all training points, solved with the
factor that there is at the last point: close enough to the inverse at all of them, and one block for all.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...parallel.decisions import shared_out
from ..search.residual_blocks import ResidualSpace, mass_images, residual_coefficients, row_scale
from ..small.error_estimate import UNIFORM, Comparison, grid, largest_error, measure_over
from ..small.pseudo_modal import nested
from .affine import AffineProjections

COARSE = UNIFORM // 4  # frequencies of the band, beside those at poles
EACH = 8  # of so many of these one, at which round-off is looked at
NO_MATTER = 1e-4  # of the tolerance: round-off of errors
RESIDUALS = 12  # frequencies at which residuals are taken at each training point, beside those at poles


class Estimate(NamedTuple):
    """The largest error over the band at each of some points (N,), and at which frequencies (N,) in Hz."""

    errors: np.ndarray
    frequencies: np.ndarray


def coarsely(pair: Comparison, settings) -> tuple[float, float]:
    """Return the largest error at some frequencies of the band and at poles, and where it is (Hz); local."""
    S = grid([pair.outer], settings.band, COARSE, None)
    return largest_error(pair, lambda pair: (S, pair.curve(S)), S[::EACH], NO_MATTER * settings.tolerance)


def estimate(projections: AffineProjections, points, count: int, settings) -> Estimate:
    """Return the error at points of the model of the first `count` columns, seen from all. Collective."""

    def at(point):
        models = projections.at(point)
        inner, outer = models.model(count), models.model()
        measure = measure_over(settings.error_measure, settings.band, outer, COARSE)
        return coarsely(Comparison(inner, outer, nested(inner, outer), measure), settings)

    largest = shared_out(projections.form.parametric.comm, at, points)
    return Estimate(*(np.array(arrays) for arrays in zip(*largest, strict=True)))


def residual_block(projections: AffineProjections, framed, points, settings, width):
    """Return the `width` leading directions of the residuals over the band and the points, as a block. Collective.

    `framed`: a model whose factor is to be solved with.
    """
    form = projections.form
    mass = [] if form.has_mass else [(form.parametric.model.M, form.is_symmetric(0, "M"))]
    matrices = mass + [(mat, symmetric) for _, _, mat, symmetric in form.matrices]
    space = ResidualSpace(
        framed.model, framed.rigid, form.loads, projections.basis.columns, matrices, row_scale(framed.model),
        form.restore, None if form.has_mass else mass_images(form.run, projections.basis),
    )  # fmt: skip
    seeds = [[projections.basis.size, place] for place in range(len(points))]
    return space.leading(seeds, lambda place: _coefficients(projections, points[place], settings), width)


def _coefficients(projections, point, settings):
    """Return the coefficients of the residuals at a point, of the loads and of all parts; local."""
    form, models = projections.form, projections.at(point)
    theta, model = form.theta(point), models.model()
    loads, *by_term = residual_coefficients(model, settings, grid([model], settings.band, RESIDUALS, None), COARSE)
    terms = dict.fromkeys(["M", *form.operators[0].terms])
    by_term = dict(zip(terms, [models.turn @ projected for projected in by_term], strict=True))
    mass = [] if form.has_mass else [by_term["M"]]
    return [loads, *mass, *(theta[place] * by_term[key] for key, place, _, _ in form.matrices)]
