"""Compute the error of a reduced model over frequency, by directions or as in the paper (55), and Q (57)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..fe.dofs import named_quantity
from ..model.damping import Damping, ModalDamping, Structural
from ..model.outputs.rates import orders_of
from ..parallel.failures import InputError
from ..reduction.result.directions import Direction, directions_table
from ..reduction.result.measure import (
    IDLE,
    NO_INPUT,
    PAPER,
    Directions,
    Measure,
    directions,
    measure_called,
    silent_outputs,
)
from ..reduction.result.reduced_model import ReducedModel, with_zero_D
from ..reduction.small.damping import measured_damping

NUMBERS_AT_A_TIME = 2**20  # of the matrices of reduced models


def relative_error(full, reduced, measure: Measure | str = "directions", *, drive=None, frequencies=None) -> np.ndarray:
    """Return the error eps (F,) of responses `reduced` of the responses `full`, both (F, r, p).

    Parameters
    ----------
    full, reduced : array_like, complex, shape (F, r, p)
    measure : Measure or {"directions", "paper"}
        What eps is: the errors of single responses over the drive points of their output and
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
    measure = measure_called(measure)
    if isinstance(measure, Directions):
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
    if not measure.inputs:  # it has no floors yet
        measure = directions(np.ones(1) if frequencies is None else np.asarray(frequencies), full, drive, of)
    return measure, drive


@dataclass(frozen=True, eq=False)
class Errors:
    """The error `eps` (F,) of a reduced model by a `measure`, and how well each output is known by itself."""

    eps: np.ndarray
    measure: Measure
    directions: tuple[Direction, ...]


def errors_of(
    reduced: ReducedModel, frequencies, full, of_reduced, drive, measure: str | Measure | None = None, anew=False
) -> Errors:
    """Return the errors of responses `of_reduced` (F, r, p) of a reduced model, of those of the `full` one, at
    frequencies (F,) in Hz, ascending.

    `drive` (F, p): drive-point responses of the full model. `measure`: by default that which the model was reduced
    with, else "directions", whose floors are those of `full` where the reduction states none; with `anew` always.
    """
    full, of_reduced = (_of_displacements(reduced, frequencies, H) for H in (full, of_reduced))
    asked = None if measure is None else measure_called(measure)
    record = reduced.record
    accuracy = record.accuracy if record is not None else None
    known = accuracy.measure if accuracy is not None else PAPER
    if isinstance(known, Directions) and not anew:
        by = known
    else:
        nothing = np.flatnonzero((full == 0).all(axis=(0, 2)))
        silent = {*_silent(reduced, frequencies, known), *nothing.tolist()}
        by = directions(frequencies, full, drive, _places(reduced), sorted(silent))
        floors = known.inputs if isinstance(known, Directions) else ()
        idle = [k < len(floors) and floors[k] == IDLE for k in range(len(by.inputs))]
        by = replace(by, inputs=tuple(IDLE if no else value for no, value in zip(idle, by.inputs, strict=True)))
    used = asked or (by if accuracy is None or anew else known)
    used = by if isinstance(used, Directions) else used
    each = by.each(full - of_reduced, full, drive)
    worst, first = np.where(np.isnan(each), np.inf, each).argmax(axis=2), (each[0], full[0])
    names = reduced.output_names, reduced.input_names
    table = directions_table(by, frequencies, each.max(axis=2), worst, first, *names)
    return Errors(relative_error(full, of_reduced, used, drive=drive), used, table)


def _silent(reduced, frequencies, known):
    """Return the outputs that the reduction found to be round-off, or where it did not look, those that seem so."""
    if isinstance(known, Directions):
        return known.silent
    count = 1 + len(frequencies) * reduced.size**2 // NUMBERS_AT_A_TIME
    states = (reduced.states(2j * np.pi * some) for some in np.array_split(frequencies, count))
    rows = np.concatenate(reduced.output_parts)
    quiet = np.isin(np.arange(len(rows)), silent_outputs(rows, states)).reshape(-1, len(reduced.C)).all(axis=0)
    return np.flatnonzero(quiet).tolist()


def _of_displacements(reduced, frequencies, H):
    """Return responses (F, r, p) without the factors s and s^2 of velocities and accelerations; 0 at 0 Hz, where these
    are zero and nothing is known of the displacement."""
    orders = orders_of(reduced.output_parts)
    if not (orders > 0).any():
        return H
    factors = (2j * np.pi * np.asarray(frequencies))[:, None] ** np.maximum(orders, 0)
    return np.divide(H, factors[:, :, None], out=np.zeros_like(H), where=factors[:, :, None] != 0)


def _places(reduced):
    """Return for each output the input at the same place, by name, and the ratio of the two (see measure.drive_points).
    """
    inputs = {name: i for i, name in enumerate(reduced.input_names)}
    places = (named_quantity(name)[1] for name in reduced.output_names)
    which = np.array([inputs.get(place, NO_INPUT) for place in places], dtype=int)
    return which, np.ones(len(which))


def as_compared(reduced: ReducedModel, band) -> tuple[ReducedModel, Damping, str]:
    """Return a reduced model as it can be set beside the full one over a band (Hz), the damping of that, and words on
    it: modal ratios, of which the full model has no response, are the loss factor of the smallest over the band."""
    damping = reduced.record.damping
    if not isinstance(damping, ModalDamping):
        return reduced, damping, ""
    by, _, words = measured_damping(damping, 0.0, band)
    structural = replace(with_zero_D(reduced), loss_factor=by.eta, columns=None, left_columns=None)
    return structural, Structural(by.eta), words


def error_integral(frequencies: np.ndarray, errors: np.ndarray) -> float:
    """Return the integral Q (57) of the error over frequency, by the trapezoidal rule.

    Parameters
    ----------
    frequencies : array_like, shape (F,)
        Hz.
    errors : array_like, shape (F,)

    Returns
    -------
    float
        Hz.

    Raises
    ------
    InputError
        For arrays of different shapes.
    """
    frequencies, errors = np.asarray(frequencies, dtype=float), np.asarray(errors, dtype=float)
    if frequencies.ndim != 1 or errors.shape != frequencies.shape:
        raise InputError(
            f"error_integral: found {errors.shape} errors for {frequencies.shape} frequencies, expected as many (F,)"
        )
    return float((np.diff(frequencies) * (errors[1:] + errors[:-1]) / 2).sum())
