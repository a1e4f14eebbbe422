"""Compress the basis of a reduction over parameters to the few combinations that the tolerance asks for at all of them.

The directions come from states over the band at some points; those where the model misses the goal join them.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from ...parallel.decisions import decided, shared_out
from ...parallel.failures import agreed
from ..search.outcome import SHOWN
from ..small.compression import LITTLE, Snapshots, States, fewest
from ..small.error_estimate import (
    FINE,
    UNIFORM,
    Comparison,
    grid,
    largest,
    largest_error,
    measure_over,
    resolved,
    upper_poles,
)
from .estimate import COARSE, coarsely
from .training import distances, halfway, points_around

TRIALS = 16  # compressions, each with the points where the one before missed the goal
WORST = 6  # points that join at a time
ROUNDS = 3  # of weights for each size that is tried
ALONG = UNIFORM // 2  # frequencies of the band, beside those around poles
CLOSE = 0.5  # of the largest error at few frequencies, above which more are looked at, at the worst
LOOKED_AT = 100  # points
STARTS = 8  # of a search for larger errors, with
STEPS = 4  # along each axis, of
FIRST_STEP = 0.1  # of the ranges, and halves of it
HALVINGS = 8  # of the way between two points, to where a pole is at an end of the band


def snapshots_at(points, projections, settings, fixed, count=None, coarse=False) -> Snapshots:
    """Return the snapshots of models at points, of which each rank has its share. Collective.

    `fixed` (m, c): orthonormal columns of the coordinates of the basis that are spanned anyway; `count`: of the first
    columns of the basis (m), by default all; `coarse`: at few frequencies.
    """
    comm = projections.form.parametric.comm
    with agreed(comm):
        mine = [_states(projections, point, settings, count, coarse) for point in points[comm.rank :: comm.size]]
    return Snapshots(mine, fixed, comm)


def _states(projections, point, settings, count, coarse) -> States:
    pair, outward, inward = turned(projections, point, settings, count, COARSE if coarse else UNIFORM)
    S = grid([pair.outer], settings.band, COARSE, None) if coarse else grid([pair.outer], settings.band, ALONG)
    return States.whole(pair, S, outward=outward, inward=inward)


def turned(projections, point, settings, count=None, uniform=UNIFORM) -> tuple[Comparison, np.ndarray, np.ndarray]:
    """Return the model of the first `count` columns (m, by default all) at a point beside itself, and the turns from
    its pseudo-modal coordinates to those of the basis and back (m, m); `uniform`: see measure_over; local."""
    models = projections.at(point)
    outer, turn = models.model(count), models.turn[:count, :count]
    measure = measure_over(settings.error_measure, settings.band, outer, uniform)
    pair = Comparison(outer, outer, np.eye(len(outer)), measure)
    return pair, turn @ pair.outer.vectors, pair.outer.vectors.T @ np.linalg.inv(turn)


class RangeCompressed(NamedTuple):
    """What a reduction over parameters ends with: the `factor` (m, k) from the basis to its columns, its errors at
    `points` and the frequencies of these; `pair`, `frequencies` and `curve`: as Compressed has them, at the reference;
    the noise at all points; `limited`: why the goal is missed, or ""."""

    factor: np.ndarray
    points: list[tuple[float, ...]]
    errors: np.ndarray
    worst: np.ndarray
    pair: Comparison
    frequencies: np.ndarray
    curve: np.ndarray
    noise: float
    limited: str


def compress(projections, settings, reference, some, points, goal, fixed, beside) -> RangeCompressed:
    """Return the smallest model whose error stays below a goal at all `points`, and at others around the worst of them.
    Collective.

    `some`: of the points, to begin with; `fixed` (m, c): columns of the basis that stay in the span; `beside`:
    coordinates that join the model later.
    """
    comm, size = projections.form.parametric.comm, len(projections.L)
    limited, most = "", None if settings.size is None else settings.size - beside
    for trial in range(TRIALS + 1):
        snapshots = snapshots_at(some, projections, settings, fixed)
        U = fewest(snapshots, goal, ROUNDS) if trial < TRIALS else np.eye(size)
        if most is not None and U.shape[1] > most:
            limited = f"with {settings.size} coordinates"
            U = fewest(snapshots_at(points, projections, settings, fixed), 0.0, most=most)
        inside = partial(_inside, projections, settings, U)
        errors, worst = _errors(inside, points, settings)
        noise = 0.0
        if limited or not (over := _over(errors, goal, points, some)):
            noise = _look_closely(inside, points, settings.band, errors, worst)
            over = _over(errors, goal, points, some)
        if not over:
            around, errors_around, worst_around = _look_around(inside, points, errors, settings)
            points, errors = points + around, np.append(errors, errors_around)
            worst = np.append(worst, worst_around)
            over = _over(errors, goal, points, some)
        if not over or limited:
            break
        some = some + [points[k] for k in over[:WORST]]
    pair, S, curve = decided(comm, _at_reference, projections, reference, settings, U)
    return RangeCompressed(U, points, errors, worst, pair, S, curve, noise, limited)


def at_ends_of_band(projections, points, band) -> list[tuple[float, ...]]:
    """Return points where a pole is at an end of the band, each between one of the points and the nearest other with
    fewer poles above it. Collective.

    Errors grow with the frequency of a pole, and count as soon as it is in the band.
    """
    form = projections.form
    comm, parameters = form.parametric.comm, form.parametric.parameters

    def above(end, point):
        return int((upper_poles(projections.at(point).model()).imag > 2 * np.pi * end).sum())

    def between(end, fewer, more):
        count = above(end, fewer)
        for _ in range(HALVINGS):
            middle = halfway(parameters, fewer, more)
            fewer, more = (fewer, middle) if above(end, middle) > count else (middle, more)
        return fewer if end == band[1] else more

    ends = []
    for end in (end for end in band if end > 0):
        counts = np.array(shared_out(comm, partial(above, end), points))
        ways = []
        for point, count in zip(points, counts, strict=True):
            fewer = [points[k] for k in np.flatnonzero(counts < count)]
            if fewer:
                ways.append((fewer[int(distances(parameters, fewer, [point]).argmin())], point))
        ends += shared_out(comm, lambda way, end=end: between(end, *way), ways)
    return ends


def _over(errors, goal, points, some):
    """Return which points miss the goal and are not among `some`, the worst first."""
    return [k for k in np.argsort(-errors, kind="stable") if errors[k] > 1.02 * goal and points[k] not in some]


def _inside(projections, settings, U, point) -> Comparison:
    """Return the model on U at a point beside that of all columns."""
    pair, _, inward = turned(projections, point, settings)
    return pair.within(np.linalg.qr(inward @ U)[0])


def _errors(inside, points, settings):
    """Return the errors (N,) at the points at few frequencies, and where they are (N,)."""
    comm = inside.args[0].form.parametric.comm
    pairs = shared_out(comm, lambda point: coarsely(inside(point), settings), points)
    return tuple(np.array(arrays) for arrays in zip(*pairs, strict=True))


def _look_closely(inside, points, band, errors, worst) -> float:
    """Look at more frequencies at the points with the largest `errors` (N,); returns the largest noise there."""

    def finely(point):
        pair, little = inside(point), LITTLE * float(errors.max())
        S, few = grid([pair.outer, pair.inner], band), grid([pair.outer], band, COARSE, None)
        error = largest_error(pair, lambda pair: largest(pair, S, little, rounds=2), few)
        return *error, float(pair.noise(few).max())

    high = [k for k in np.argsort(-errors, kind="stable")[:LOOKED_AT] if errors[k] >= CLOSE * errors.max()]
    results = shared_out(inside.args[0].form.parametric.comm, finely, [points[k] for k in high])
    errors[high], worst[high], noise = (np.array(arrays) for arrays in zip(*results, strict=True))
    return float(noise.max())


def _look_around(inside, points, errors, settings) -> tuple[list, np.ndarray, np.ndarray]:
    """Search for larger errors around the worst of the points that are not close to each other, by steps along the
    axes; where another point is much closer than these also from steps of half that distance. Returns the points looked
    at, their errors and at which frequencies these are."""
    parameters = inside.args[0].form.parametric.parameters
    centres, looked_at = _worst_apart(parameters, points, errors), ([], [], [])
    steps = [FIRST_STEP] * len(centres)
    for centre in tuple(centres):
        others = [point for point in points if point != centre]
        step = float(distances(parameters, [centre], others)[0]) / 2 if others else FIRST_STEP
        if step < FIRST_STEP * 2.0**-STEPS:
            centres.append(centre)
            steps.append(step)
    highest = [errors[points.index(point)] for point in centres]
    for _ in range(STEPS):
        rings = [points_around(parameters, *where) for where in zip(centres, steps, strict=True)]
        here = _errors(inside, [point for ring in rings for point in ring], settings)
        for known, new in zip(looked_at, ([point for ring in rings for point in ring], *here), strict=True):
            known.extend(new)
        ends = np.cumsum([len(ring) for ring in rings])[:-1]
        for k, (ring, around) in enumerate(zip(rings, np.split(here[0], ends), strict=True)):
            if around.max(initial=0.0) > highest[k]:
                centres[k], highest[k] = ring[int(around.argmax())], around.max()
            else:
                steps[k] /= 2
    return looked_at[0], np.array(looked_at[1]), np.array(looked_at[2])


def _worst_apart(parameters, points, errors):
    """Return the worst of the points, the others no closer than two steps to one before."""
    chosen = []
    for k in np.argsort(-errors, kind="stable"):
        if len(chosen) == STARTS or errors[k] < CLOSE * errors.max():
            break
        if not chosen or distances(parameters, [points[k]], chosen)[0] >= 2 * FIRST_STEP:
            chosen.append(points[k])
    return chosen


def _at_reference(projections, reference, settings, U):
    small = _inside(projections, settings, U, reference)
    grid_of_both = grid([small.outer, small.inner], settings.band, 2 * UNIFORM, FINE)
    S, curve = largest(small, grid_of_both, LITTLE * settings.tolerance)
    S, curve = resolved(small, S, curve, max(3 * float(small.noise(S).max()), SHOWN * settings.tolerance))
    return small, S, curve
