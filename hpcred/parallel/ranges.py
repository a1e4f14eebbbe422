"""Refuse numbers of a user early that are out of the range that makes sense in their unit."""

from __future__ import annotations

import math

from .failures import InputError

FREQUENCY = (0.0, 1e12, "Hz")
LABEL = (1, 2**31 - 1, "")
COUNT = (1, 2**31 - 1, "")
SAMPLES = (1, 10**6, "")  # values at which something is computed
COORDINATE = (-1e9, 1e9, "m")
RATE = (-1e13, 1e13, "1/s")
ANYTHING = (-1e30, 1e30, "")


def require_band(key: str, band: tuple[float, float] | None):
    """Raise InputError unless a band (Hz) is finite and ascends from 0 or more. None is no band, and passes."""
    if band is not None and not 0 <= band[0] < band[1]:
        raise InputError(f"{key}: found {list(band)}, expected 0 <= lower < upper in Hz")
    within(key, band, FREQUENCY)


def within(key: str, value, range_: tuple):
    """Raise InputError unless a number, or every number in nested tuples, is finite and in a range (low, high, unit).

    None is no number, and passes.
    """
    if isinstance(value, (tuple, list)):
        for item in value:
            within(key, item, range_)
    elif isinstance(value, (int, float)):
        low, high, unit = range_
        if not low <= value <= high:  # NaN too
            shown = f"{value:g}" if isinstance(value, float) or abs(value) < 10**15 else f"{str(value)[:12]}..."
            expected = f"{low:g} to {high:g}{f' {unit}' if unit else ''}"
            finite = "" if isinstance(value, int) or math.isfinite(value) else "a finite number of "
            raise InputError(f"{key}: found {shown}, expected {finite}{expected}")
