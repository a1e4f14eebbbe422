"""The error of a reduced model: relative over frequency (55, 56), and its integral Q (57)."""

import numpy as np


def relative_error(full: np.ndarray, reduced: np.ndarray) -> np.ndarray:
    """||H - Hr||_F / ||H||_F for each frequency (55, 56); both (frequencies, r, p)."""
    full, reduced = np.asarray(full), np.asarray(reduced)
    difference = np.linalg.norm(full - reduced, axis=(1, 2))
    size = np.linalg.norm(full, axis=(1, 2))
    return np.divide(difference, size, out=np.where(difference > 0, np.inf, 0.0), where=size > 0)


def error_integral(frequencies: np.ndarray, errors: np.ndarray) -> float:
    """Q (57): the integral of the error over the frequencies (Hz) by the trapezoidal rule."""
    return float((np.diff(frequencies) * (errors[1:] + errors[:-1]) / 2).sum())
