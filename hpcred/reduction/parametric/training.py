"""Choose the values of parameters at which errors are estimated, and those at which a model is factored.

A point is a tuple of values, one of each parameter; its place is in the unit cube. Everything here is local.
"""

from __future__ import annotations

from itertools import product

import numpy as np

DEFAULTS = {1: 33, 2: 81}  # training points for so many parameters
MANY = 100  # the same for more
MORE_DIGITS, FEWEST_AND_MOST = 3, (6, 12)  # of values, than tell points apart
LOGARITHMIC = 20.0  # ratio of the ends of a range, both above 0, beyond which places are logarithms


def training_points(parameters, count: int | None = None) -> list[tuple[float, ...]]:
    """Return `count` points that fill the ranges, corners included as far as they are not too many: a grid for one or
    two parameters, else corners and a sequence of low discrepancy."""
    number = len(parameters)
    count = count or DEFAULTS.get(number, MANY)
    if number <= 2:
        along = np.linspace(0, 1, max(2, round(count ** (1 / number))))
        places = np.array(list(product(along, repeat=number)))
    else:
        places = _corners(number, count)
        places = np.vstack([places, low_discrepancy(number, count - len(places))])
    return [point_at(parameters, place) for place in places]


def corner_points(parameters, most: int) -> list[tuple[float, ...]]:
    """Return the corners of the ranges, none where they are more than `most`."""
    return [point_at(parameters, place) for place in _corners(len(parameters), most)]


def _corners(number, most):
    return np.array(list(product((0.0, 1.0), repeat=number))) if 2**number <= most else np.zeros((0, number))


def fresh_points(parameters, first: int, count: int) -> list[tuple[float, ...]]:
    """Return `count` points of a sequence of low discrepancy, from its place `first`."""
    places = low_discrepancy(len(parameters), first + count)[first:]
    return [point_at(parameters, place) for place in places]


def low_discrepancy(number: int, count: int) -> np.ndarray:
    """Return `count` places of an additive recurrence (count, number), whose steps are powers of the root of
    x^(number + 1) = x + 1 (Roberts, 2018)."""
    root = 2.0
    for _ in range(60):
        root = (1 + root) ** (1 / (number + 1))
    steps = root ** -np.arange(1.0, number + 1)
    return (0.5 + np.outer(np.arange(1, count + 1), steps)) % 1.0


def points_around(parameters, point, step: float) -> list[tuple[float, ...]]:
    """Return the points a `step` away in the unit cube along each axis, as far as they are in the ranges."""
    place, steps = place_of(parameters, point), step * np.eye(len(parameters))
    digits = digits_for(step)
    around = [point_at(parameters, np.clip(place + shift, 0.0, 1.0), digits) for shift in (*steps, *-steps)]
    return [near for near in dict.fromkeys(around) if near != point]


def halfway(parameters, one, other) -> tuple[float, ...]:
    """Return the point halfway between two."""
    return point_at(parameters, (place_of(parameters, one) + place_of(parameters, other)) / 2)


def point_at(parameters, place, digits: int = 6) -> tuple[float, ...]:
    """Return the point at a place, with values of so many digits at most that are exact at the ends."""
    point = []
    for parameter, share in zip(parameters, place, strict=True):
        low, high = parameter.range
        value = low * (high / low) ** share if _is_logarithmic(parameter) else low + (high - low) * share
        rounded = float(f"{value - low:.{digits}g}") + low
        point.append(low if share == 0 else high if share == 1 else float(np.clip(rounded, low, high)))
    return tuple(point)


def digits_for(step: float) -> int:
    """Return how many digits values have that tell points apart which are a `step` away in the unit cube."""
    return int(np.clip(MORE_DIGITS - np.log10(step), *FEWEST_AND_MOST))


def place_of(parameters, point) -> np.ndarray:
    """Return the place of a point."""
    place = []
    for parameter, value in zip(parameters, point, strict=True):
        low, high = parameter.range
        share = np.log(value / low) / np.log(high / low) if _is_logarithmic(parameter) else (value - low) / (high - low)
        place.append(share)
    return np.array(place)


def distances(parameters, points, taken) -> np.ndarray:
    """Return how far each of the points is from the nearest of those that are taken, in the unit cube."""
    here, there = (np.array([place_of(parameters, point) for point in some]) for some in (points, taken))
    return np.linalg.norm(here[:, None] - there, axis=2).min(axis=1)


def _is_logarithmic(parameter):
    low, high = parameter.range
    return low > 0 and high / low >= LOGARITHMIC
