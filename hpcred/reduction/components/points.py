"""Define expansion points: where in the complex plane a Krylov subspace matches moments."""

import numpy as np

from ...parallel.failures import InputError
from ...parallel.ranges import FREQUENCY, RATE, within


def laplace(kind, frequency, decay, s=None) -> complex:
    """Return s = decay + i 2 pi frequency (Hz, 1/s), or given as (real, imaginary). Raises InputError."""
    if s is not None:
        if frequency is not None or decay is not None:
            raise InputError(f"{kind}: expected s, or frequency and decay, not both")
        point = complex(*s)
    else:
        point = complex(decay or 0.0, 2 * np.pi * (frequency or 0.0))
    if not np.isfinite(point):
        raise InputError(f"{kind}: found the point {point}, expected finite numbers")
    if point.imag < 0:
        raise InputError(f"{kind}.frequency: found {point.imag / 2 / np.pi:g}, expected Hz, not negative")
    if point.real < 0:
        raise InputError(f"{kind}.decay: found {point.real:g}, expected 1/s, not negative: poles lie there")
    within(f"{kind}.decay", point.real, RATE)
    within(f"{kind}.frequency", point.imag / (2 * np.pi), FREQUENCY)
    return point


def point_name(s: complex) -> str:
    """ "150 Hz", "150 Hz + 20 1/s", "20 1/s"."""
    words = [f"{s.imag / 2 / np.pi:g} Hz"] if s.imag or not s.real else []
    return " + ".join(words + ([f"{s.real:g} 1/s"] if s.real else []))
