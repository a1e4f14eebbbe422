"""The error of a reduced model: relative over frequency (55, 56), and its integral Q (57)."""

import numpy as np

from ..parallel.failures import InputError
from ..reduction.weights import weighed


def relative_error(full: np.ndarray, reduced: np.ndarray, weights=None) -> np.ndarray:
    """||H - Hr||_F / ||H||_F for each frequency (55, 56); both (frequencies, r, p). NaN where one of them is NaN.

    `weights`: numbers for the r outputs and for the p inputs, with which H and Hr are multiplied. Raises InputError for
    arrays of other or of different shapes.
    """
    full, reduced = np.asarray(full), np.asarray(reduced)
    if full.ndim != 3 or full.shape != reduced.shape:
        raise InputError(
            f"relative_error: found arrays {full.shape} and {reduced.shape}, expected two (frequencies, outputs, "
            "inputs) of one shape"
        )
    difference = np.linalg.norm(weighed(full - reduced, weights), axis=(1, 2))
    size = np.linalg.norm(weighed(full, weights), axis=(1, 2))
    return np.divide(difference, size, out=np.where(difference > 0, np.inf, difference), where=size > 0)


def error_integral(frequencies: np.ndarray, errors: np.ndarray) -> float:
    """Q (57): the integral of the error (F,) over the frequencies (F,) in Hz by the trapezoidal rule."""
    frequencies, errors = np.asarray(frequencies, dtype=float), np.asarray(errors, dtype=float)
    if frequencies.ndim != 1 or errors.shape != frequencies.shape:
        raise InputError(
            f"error_integral: found {errors.shape} errors for {frequencies.shape} frequencies, expected as many (F,)"
        )
    return float((np.diff(frequencies) * (errors[1:] + errors[:-1]) / 2).sum())
