"""Find values of parameters close to those at which an input or output hardly has a response.

The floor of a measure is the median response over the band, or the static response where that is smaller, but not
where it counts as a zero (see measure.STATIC). Where a static response passes zero the floor falls to a thousandth of
what it is elsewhere, and where the responses at most frequencies pass zero together, as those of C_0 + p C_1 with a
small C_0 do, the median falls too. Errors there are the largest ones, in ranges too narrow for training points to meet.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import scipy  # whose optimize is slow to import

from ...parallel.decisions import shared_out
from ..result.measure import STATIC
from ..small.error_estimate import UNIFORM
from .training import digits_for, place_of, point_at

BESIDE = (1.05, 1.3, 5.0)  # times STATIC of the median: static responses at the points beside a zero
AROUND = (0.0, 0.5, 1.0, 2.0, 4.0)  # half widths of the range in which the median is small, at the points around it
NARROW = 0.25  # of the way between two points: half widths that these do not see
COARSE = UNIFORM // 4  # frequencies of the band at which responses of all points are kept
FEW = 8  # numbers that are kept at each frequency
STEPS = 40  # of the search for a zero
FOUND = 1e-9  # of the way between two points, at which a zero is found
CLOSE = 1e-6  # of the way between two points, on which the slope beside a zero is taken
ALL_DIGITS = 17  # of values in the search


def beside_zeros(projections, points, band) -> list[tuple[float, ...]]:
    """Return points beside those at which static responses of a model are zero, in a band (Hz) from 0, and around those
    at which its responses at most frequencies are small, between some of the `points`. Collective."""
    form = projections.form
    comm, parameters = form.parametric.comm, form.parametric.parameters
    places = np.array([place_of(parameters, point) for point in points])
    by_pass = []
    for responses, beside in ((_static, _beside), (_over_band, _around)):
        if responses is _static and band[0]:
            continue
        known = shared_out(comm, partial(responses, projections, band), points)
        ways = []
        for k in range(len(known[0])):
            ways += [(points[a], points[b], k) for a, b in _opposite(places, np.array([each[k] for each in known]))]
        by_pass += shared_out(comm, lambda way, beside=beside: beside(projections, band, *way), ways) if ways else []
    return list(dict.fromkeys(point for some in by_pass for point in some))


def _static(projections, band, point) -> list[np.ndarray]:
    """Return for each output the static responses (1, p) over the drive points of the inputs, and the drive-point
    response (1, 1) of each input."""
    return [each.real for each in _responses(projections.at(point).model(), np.zeros(1))]


def _responses(model, frequencies) -> list[np.ndarray]:
    """Return the same at frequencies (S,) in Hz: (S, p), and (S, 1) of each input."""
    H, drive = model.responses(frequencies)
    g = np.sqrt(np.abs(drive))
    over = np.divide(H, g[:, None, :], out=np.zeros_like(H), where=g[:, None, :] > 0)
    responses = [] if model.io.are_same else list(over.transpose(1, 0, 2))
    responses += [drive[:, [i]] for i in range(drive.shape[1])]
    return [np.where(np.isfinite(each), each, 0.0) for each in responses]


def _over_band(projections, band, point) -> list[np.ndarray]:
    """Return the same over the band (S, p), FEW sums of these where p is more; for inputs the responses at all loads,
    which are linear in the load."""
    model, frequencies = projections.at(point).model(), np.linspace(*band, COARSE)
    energy = np.sqrt(np.abs(model.eigenvalues) + (2 * np.pi * band[1]) ** 2)[:, None]
    size = np.linalg.norm(model.L / energy, axis=0)[:, None]  # of loads of any unit
    over = np.divide(model.L.T, size, out=np.zeros_like(model.L.T), where=size > 0)
    moved = np.concatenate([over @ model.solve(chunk, model.B) for chunk in model.parts_of(frequencies)])
    outputs = [] if model.io.are_same else _responses(model, frequencies)[: -moved.shape[2]]
    return [_few(each) for each in (*outputs, *np.nan_to_num(moved.transpose(2, 0, 1), posinf=0.0, neginf=0.0))]


def _few(values):
    """Return FEW sums with other signs of values (S, p) if they are more."""
    if values.shape[1] <= FEW:
        return values
    return values @ np.random.default_rng(0).choice([-1.0, 1.0], (values.shape[1], FEW))


def _opposite(places, values) -> list[tuple[int, int]]:
    """Return pairs of points whose values (N, S, p) have opposite directions at most frequencies, each the nearest such
    one of the other."""
    size = np.linalg.norm(values, axis=2, keepdims=True)
    unit = np.divide(values, size, out=np.zeros_like(values), where=size > 0)
    products = np.array([np.median(np.einsum("sp,nsp->ns", direction.conj(), unit).real, axis=1) for direction in unit])
    distance = np.linalg.norm(places[:, None] - places, axis=2)
    distance[products >= 0] = np.inf
    nearest = distance.argmin(axis=1)
    each = np.arange(len(places))
    mutual = np.isfinite(distance[each, nearest]) & (nearest[nearest] == each) & (each < nearest)
    return [(int(a), int(nearest[a])) for a in np.flatnonzero(mutual)]


class _Way:
    """The way between two points: where on it, of 1, the median part of the `values` (S, p) along the difference of
    both ends is `zero`, or None; the median size of that difference, their `change` on the way, and the `slope` at the
    zero. Local."""

    def __init__(self, projections, start, end, values):
        self.parameters = projections.form.parametric.parameters
        self.first, self.last = place_of(self.parameters, start), place_of(self.parameters, end)
        ends = values(self.at(0.0)), values(self.at(1.0))
        change = ends[0] - ends[1]
        square = (np.abs(change) ** 2).sum(axis=1)

        def part(value):
            shares = (change.conj() * value).sum(axis=1).real
            return float(np.median(np.divide(shares, square, out=np.zeros_like(square), where=square > 0)))

        known = {0.0: part(ends[0]), 1.0: part(ends[1])}  # which brentq asks for again

        def value(t):
            return known[t] if t in known else part(values(self.at(t)))

        self.change, self.zero, self.slope = float(np.median(np.sqrt(square))), None, 0.0
        if known[0.0] > 0 > known[1.0]:
            self.zero = scipy.optimize.brentq(value, 0.0, 1.0, xtol=FOUND, rtol=FOUND, maxiter=STEPS, disp=False)
            low, high = max(self.zero - CLOSE, 0.0), min(self.zero + CLOSE, 1.0)
            self.slope = (value(low) - value(high)) / (high - low) * self.change

    def at(self, t, digits=ALL_DIGITS):
        return point_at(self.parameters, np.clip(self.first + t * (self.last - self.first), 0.0, 1.0), digits)

    def points(self, away) -> list[tuple[float, ...]]:
        """Return the points so far away from the zero (k,), on both sides."""
        digits = digits_for(away[away > 0].min())
        return [self.at(t, digits) for t in (*(self.zero - away), *(self.zero + away)) if 0 <= t <= 1]


def _beside(projections, band, start, end, k) -> list[tuple[float, ...]]:
    """Return points close to the zero of the static response `k` between two points; local."""
    way = _Way(projections, start, end, lambda point: _static(projections, band, point)[k])
    if way.slope <= 0:
        return []
    # on both sides, where the response is so much of its median
    median = _median(_responses(projections.at(way.at(way.zero)).model(), np.linspace(*band, UNIFORM))[k])
    return way.points(np.array(BESIDE) * STATIC * median / way.slope) if median > 0 else []


def _around(projections, band, start, end, k) -> list[tuple[float, ...]]:
    """Return points around the one between two others at which the responses `k` over the band are small, if they do
    not see it; local."""
    way = _Way(projections, start, end, lambda point: _over_band(projections, band, point)[k])
    median = _median(_over_band(projections, band, way.at(way.zero))[k]) if way.zero is not None else 0.0
    return way.points(np.array(AROUND) * median / way.change) if 0 < median < NARROW * way.change else []


def _median(values):
    """Return the median size of values (S, p) over frequencies."""
    return float(np.median(np.abs(values).max(axis=1)))
