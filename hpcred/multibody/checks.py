"""Numbers of a simulation's tables enter; what cannot be is refused with its key."""

import numpy as np

from ..parallel.failures import InputError


def require_finite(where, **values):
    """Raise InputError for NaN and Inf, which TOML can write; None and empty values pass. `where` ends with a dot."""
    for key, value in values.items():
        if value is not None and not np.isfinite(np.asarray(value, dtype=float)).all():
            raise InputError(f"{where}{key}: found NaN or Inf among {value}, expected finite numbers")


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
    if len(times) != len(values) or not times:
        raise InputError(f"{where}values: found {len(values)} values for {len(times)} times, expected as many")
    if any(late <= early for early, late in zip(times, times[1:], strict=False)):
        raise InputError(f"{where}times: expected ascending times")


def unit(where, key, vector) -> np.ndarray:
    """The unit vector (3,) of an axis. Raises InputError for one without length."""
    require_finite(where, **{key: vector})
    length = np.linalg.norm(vector)
    if length == 0:
        raise InputError(f"{where}{key}: found {list(vector)}, which has no direction")
    return np.asarray(vector, dtype=float) / length
