"""The error of a reduced model: relative over frequency (55, 56), and its integral Q (57)."""

import numpy as np

NOTHING = 1e-3  # of the geometric mean of the largest responses of an output and of an input


def relative_error(full: np.ndarray, reduced: np.ndarray) -> np.ndarray:
    """||H - Hr||_F / ||H||_F for each frequency (55, 56); both (frequencies, r, p)."""
    full, reduced = np.asarray(full), np.asarray(reduced)
    difference = np.linalg.norm(full - reduced, axis=(1, 2))
    size = np.linalg.norm(full, axis=(1, 2))
    return np.divide(difference, size, out=np.where(difference > 0, np.inf, 0.0), where=size > 0)


def error_integral(frequencies: np.ndarray, errors: np.ndarray) -> float:
    """Q (57): the integral of the error over the frequencies (Hz) by the trapezoidal rule."""
    return float((np.diff(frequencies) * (errors[1:] + errors[:-1]) / 2).sum())


def worst_pair(full: np.ndarray, reduced: np.ndarray) -> tuple[int, int, float]:
    """Output and input (from 0) whose response is worst by itself, and its error: max |H - Hr| / max |H| over f.

    eps weighs all pairs by the size of their responses, in SI units, so that stiff directions may be less accurate. A
    pair that symmetry makes nothing of is set beside the responses of the same output and of the same input.
    """
    largest = np.abs(full).max(axis=0)
    beside = np.sqrt(largest.max(axis=1)[:, None] * largest.max(axis=0))
    errors = np.abs(full - reduced).max(axis=0) / np.maximum(largest, np.maximum(NOTHING * beside, 1e-300))
    i, j = np.unravel_index(errors.argmax(), errors.shape)
    return int(i), int(j), float(errors[i, j])
