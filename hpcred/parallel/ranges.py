"""Refuse numbers of a user early that are out of the range that makes sense in their unit."""

from __future__ import annotations

import math
import sys
from typing import Annotated, NamedTuple

from .failures import InputError


class Range(NamedTuple):
    """The numbers from `low` to `high` in a unit. In the annotation of a field (Annotated) it is checked as all that
    is declared of the field: see declared.as_declared."""

    low: float
    high: float
    unit: str = ""

    def __call__(self, key, value):
        within(key, value, self)


class Least(NamedTuple):
    """The whole numbers from `least`, in the annotation of a field, as Range is."""

    least: int

    def __call__(self, key, value):
        if value is not None and value < self.least:
            raise InputError(f"{key}: found {value}, expected at least {self.least}")
        within(key, value, COUNT)


SMALLEST = sys.float_info.min  # normal number
FREQUENCY = Range(0.0, 1e12, "Hz")
LABEL = Range(1, 2**31 - 1)
COUNT = Range(1, 2**31 - 1)
SAMPLES = Range(1, 10**6)  # values at which something is computed
COORDINATE = Range(-1e9, 1e9, "m")
RATE = Range(-1e13, 1e13, "1/s")
ANYTHING = Range(-1e30, 1e30)

Count = Annotated[int, Least(1)]
Frequency = Annotated[float, FREQUENCY]
Coordinate = Annotated[float, COORDINATE]
Number = Annotated[float, ANYTHING]  # finite, and not beyond all units
Vector = tuple[Number, Number, Number]
Label = Annotated[int, LABEL]
Node = Label | str  # by number, or by the name of an interface


def positive(key: str, value):
    """Raise InputError for a number that is not more than 0; in annotations, as Range is."""
    if value <= 0:
        raise InputError(f"{key}: found {value:g}, expected a number of more than 0")


def not_negative(key: str, value):
    """Raise InputError for a number, or numbers in a tuple, below 0; in annotations, as Range is."""
    if value is not None and min(value if isinstance(value, tuple) else (value,)) < 0:
        raise InputError(f"{key}: found {value}, expected nothing below 0")


def require_band(key: str, band: tuple[float, float] | None):
    """Raise InputError unless a band (Hz) is finite and ascends from 0 or more. None is no band, and passes."""
    if band is not None and not 0 <= band[0] < band[1]:
        raise InputError(f"{key}: found {list(band)}, expected 0 <= lower < upper in Hz")
    within(key, band, FREQUENCY)


Band = Annotated[tuple[float, float], require_band]  # Hz


def within(key: str, value, range_: tuple):
    """Raise InputError unless a number, or every number in nested tuples, is finite and in a range (low, high, unit).

    None is no number, and passes.
    """
    if isinstance(value, (tuple, list)):
        for entry in value:
            within(key, entry, range_)
    elif isinstance(value, (int, float)):
        low, high, unit = range_
        if not low <= value <= high:  # NaN too
            shown = f"{value:g}" if isinstance(value, float) or abs(value) < 10**15 else f"{str(value)[:12]}..."
            expected = f"{low:g} to {high:g}{f' {unit}' if unit else ''}"
            finite = "" if isinstance(value, int) or math.isfinite(value) else "a finite number of "
            raise InputError(f"{key}: found {shown}, expected {finite}{expected}")
        if 0 < abs(value) < SMALLEST:
            raise InputError(f"{key}: found {value:g}, which is too small to have all its digits; expected 0 or at "
                             f"least {SMALLEST:.2g} in size")  # fmt: skip
