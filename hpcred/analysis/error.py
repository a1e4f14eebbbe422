"""The error of a reduced model over frequency, direction by direction or as in the paper (55), and its integral Q (57)."""

import numpy as np

from ..parallel.failures import InputError
from ..reduction.measure import NO_INPUT, PAPER, Measure, directions


def relative_error(full, reduced, measure: Measure | str = "directions", *, drive=None, frequencies=None) -> np.ndarray:
    """Return the error eps (F,) of responses `reduced` of the responses `full`, both (F, r, p).

    Parameters
    ----------
    full, reduced : array_like, complex, shape (F, r, p)
    measure : Measure or {"directions", "paper"}
        What eps is (see reduction.measure): the errors of single responses over the drive points of their output and
        input, or ||H - Hr||_F / ||H||_F (55). By name the floors are those of `full` at these frequencies.
    drive : array_like, complex, shape (F, p), optional
        The drive-point responses of the inputs; by default the diagonal of `full`, which then has to have as many
        outputs as inputs, at the same places.
    frequencies : array_like, shape (F,), optional
        Hz, ascending; a first one of 0 makes the floors those with a static response.

    Returns
    -------
    ndarray, shape (F,)
        NaN where one of the responses is NaN.

    Raises
    ------
    InputError
        For arrays of other or of different shapes, and drive points that cannot be known.
    """
    full, reduced = np.asarray(full), np.asarray(reduced)
    if full.ndim != 3 or full.shape != reduced.shape:
        raise InputError(
            f"relative_error: found arrays {full.shape} and {reduced.shape}, expected two (frequencies, outputs, "
            "inputs) of one shape"
        )
    if measure == "paper":
        measure = PAPER
    if measure != PAPER:
        measure, drive = _by_directions(measure, full, drive, frequencies)
    unknown = ~(np.isfinite(full).all(axis=(1, 2)) & np.isfinite(reduced).all(axis=(1, 2)))
    with np.errstate(invalid="ignore"):
        eps = measure.eps(full - reduced, full, drive)
    return np.where(unknown & ~np.isinf(eps), np.nan, eps)


def _by_directions(measure, full, drive, frequencies):
    outputs, inputs = full.shape[1:]
    if drive is None:
        if outputs != inputs:
            raise InputError(
                f"relative_error: {outputs} outputs and {inputs} inputs are not the same places; give the drive-point "
                "responses of the inputs (drive), or measure = 'paper'"
            )
        drive, of = np.einsum("fii->fi", full), (np.arange(inputs), np.ones(inputs))
    else:
        drive, of = np.asarray(drive), (np.full(outputs, NO_INPUT), np.ones(outputs))
        if drive.shape != full.shape[::2]:
            raise InputError(f"relative_error: found drive {drive.shape}, expected {full.shape[::2]}")
    if not isinstance(measure, Measure):
        if measure != "directions":
            raise InputError(f"measure: found {measure!r}, expected 'directions' or 'paper'")
        measure = directions(np.ones(1) if frequencies is None else np.asarray(frequencies), full, drive, of)
    return measure, drive


def error_integral(frequencies: np.ndarray, errors: np.ndarray) -> float:
    """Q (57): the integral of the error (F,) over the frequencies (F,) in Hz by the trapezoidal rule."""
    frequencies, errors = np.asarray(frequencies, dtype=float), np.asarray(errors, dtype=float)
    if frequencies.ndim != 1 or errors.shape != frequencies.shape:
        raise InputError(
            f"error_integral: found {errors.shape} errors for {frequencies.shape} frequencies, expected as many (F,)"
        )
    return float((np.diff(frequencies) * (errors[1:] + errors[:-1]) / 2).sum())
