"""Check the numbers in the tables of a simulation; errors name the key."""

import numpy as np

from ..parallel.failures import InputError
from ..parallel.ranges import ANYTHING, FREQUENCY, LABEL, within


def require_finite(where, **values):
    """Raise InputError for NaN and Inf, which TOML can write, and for numbers beyond all units; None passes.

    `where` ends with a dot.
    """
    for key, value in values.items():
        within(f"{where}{key}", value, ANYTHING)


def require_node(where, node):
    """Raise InputError for a number that no node has; a name passes."""
    within(f"{where}node", node, LABEL)


def require_sine(where, frequency, phase):
    """Raise InputError unless the frequency (Hz) is above 0 and the phase (rad) in its range."""
    require_positive(where, frequency=frequency)
    within(f"{where}frequency", frequency, FREQUENCY)
    within(f"{where}phase", phase, (-1e6, 1e6, "rad"))


def require_positive(where, **values):
    """Raise InputError for numbers that are not more than 0."""
    for key, value in values.items():
        if value <= 0:
            raise InputError(f"{where}{key}: found {value:g}, expected a number of more than 0")


def require_not_negative(where, **values):
    """Raise InputError for numbers, or lists of them, below 0."""
    for key, value in values.items():
        if (np.asarray(value, dtype=float) < 0).any():
            raise InputError(f"{where}{key}: found {value}, expected nothing below 0")


def require_times(where, times, values):
    """Raise InputError unless there is a value for each of some ascending times."""
    if not times:
        raise InputError(f"{where}times: found an empty list, expected ascending times and a value for each")
    if len(times) != len(values):
        raise InputError(f"{where}values: found {len(values)} values for {len(times)} times, expected as many")
    for early, late in zip(times, times[1:], strict=False):
        if late <= early:
            raise InputError(f"{where}times: found {late:g} s after {early:g} s, expected ascending times")


def shortest_interval(times, end) -> float:
    """Return the shortest interval (s) of ascending times that has a part between 0 and `end`; inf where there is
    none."""
    times = np.asarray(times)
    return np.diff(times)[(times[1:] > 0) & (times[:-1] < end)].min(initial=np.inf)


def unit(where, key, vector) -> np.ndarray:
    """Return the unit vector (3,) of an axis. Raises InputError for one without length."""
    require_finite(where, **{key: vector})
    length = np.linalg.norm(vector)
    if length == 0:
        raise InputError(f"{where}{key}: found {list(vector)}, which has no direction")
    return np.asarray(vector, dtype=float) / length
