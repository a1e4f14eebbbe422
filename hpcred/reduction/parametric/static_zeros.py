"""Find values of parameters close to those at which a static response passes zero.

The floor of a measure is the static response where that is smaller than the median over the band, but not where it
counts as a zero (see measure.STATIC). Beside such a zero the floor is a thousandth of what it is elsewhere, and errors
there are the largest ones, in ranges too narrow for training points to meet.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ...parallel.decisions import shared_out
from ..result.measure import STATIC
from ..small.error_estimate import UNIFORM
from .training import place_of, point_at

BESIDE = (1.05, 1.3, 5.0)  # times STATIC of the median: static responses at the points beside a zero
STEPS = 40  # of the search for one
CLOSE = 1e-6  # of the way between two points, at which a zero is found
ALL_DIGITS, MORE_DIGITS = 17, 3  # of values in the search, and of points beside a zero, than tell them from the zero
FEWEST_AND_MOST = (6, 12)


def beside_static_zeros(projections, points, band) -> list[tuple[float, ...]]:
    """Return points beside those at which static responses of a model are zero, between some of the `points`. None in a
    band (Hz) that begins above 0. Collective."""
    form = projections.form
    if band[0]:
        return []
    comm, parameters = form.parametric.comm, form.parametric.parameters
    known = shared_out(comm, partial(_static, projections), points)
    places = np.array([place_of(parameters, point) for point in points])
    ways = []
    for k in range(len(known[0])):
        ways += [(points[a], points[b], k) for a, b in _opposite(places, np.array([each[k] for each in known]))]
    points_beside = shared_out(comm, lambda way: _beside(projections, band, *way), ways) if ways else []
    return list(dict.fromkeys(point for some in points_beside for point in some))


def _static(projections, point, frequencies=(0.0,)) -> list[np.ndarray]:
    """Return for each output the responses (S, p) over the drive points of the inputs, and the drive-point response
    (S, 1) of each input; those at 0 Hz alone (p,) and (1,)."""
    model = projections.at(point).model()
    H, drive = model.responses(np.array(frequencies))
    g = np.sqrt(np.abs(drive))
    over = np.divide(H, g[:, None, :], out=np.zeros_like(H), where=g[:, None, :] > 0)
    responses = [] if model.io.are_same else list(over.transpose(1, 0, 2))
    responses += [drive[:, [i]] for i in range(drive.shape[1])]
    if len(frequencies) > 1:
        return responses
    return [np.where(np.isfinite(each[0]), each[0].real, 0.0) for each in responses]


def _opposite(places, values) -> list[tuple[int, int]]:
    """Return pairs of points whose values (N, p) have opposite directions, each the nearest such one of the other."""
    products = values @ values.T
    distance = np.linalg.norm(places[:, None] - places, axis=2)
    distance[products >= 0] = np.inf
    nearest = distance.argmin(axis=1)
    each = np.arange(len(places))
    mutual = np.isfinite(distance[each, nearest]) & (nearest[nearest] == each) & (each < nearest)
    return [(int(a), int(nearest[a])) for a in np.flatnonzero(mutual)]


def _beside(projections, band, one, other, k) -> list[tuple[float, ...]]:
    """Return points close to the zero of the static response `k` between two points; local."""
    parameters = projections.form.parametric.parameters
    first, last = place_of(parameters, one), place_of(parameters, other)

    def at(t, digits=ALL_DIGITS):
        return point_at(parameters, np.clip(first + t * (last - first), 0.0, 1.0), digits)

    def value(t):
        return _static(projections, at(t))[k]

    # where the part along the difference of both ends is zero, by bisection and the rule of false position in turn
    ends = value(0.0), value(1.0)
    along = (ends[0] - ends[1]) / np.linalg.norm(ends[0] - ends[1])
    low, high, (at_low, at_high) = 0.0, 1.0, (float(each @ along) for each in ends)
    for step in range(STEPS):
        if high - low < CLOSE or not at_low > at_high:
            break
        part = 0.5 if step % 2 else np.clip(at_low / (at_low - at_high), 0.01, 0.99)
        t = low + part * (high - low)
        here = float(value(t) @ along)
        low, high, at_low, at_high = (t, high, here, at_high) if here > 0 else (low, t, at_low, here)
    zero, slope = (low + high) / 2, (at_low - at_high) / max(high - low, CLOSE / 10)
    # on both sides, where the response is so much of its median
    size = np.abs(_static(projections, at(zero), np.linspace(*band, UNIFORM))[k]).max(axis=1)
    median = float(np.median(size[np.isfinite(size)]))
    if not (slope > 0 and median > 0):
        return []
    away = np.array(BESIDE) * STATIC * median / slope
    digits = int(np.clip(MORE_DIGITS - np.log10(away[0]), *FEWEST_AND_MOST))
    return [at(t, digits) for t in (*(zero - away), *(zero + away)) if 0 <= t <= 1]
