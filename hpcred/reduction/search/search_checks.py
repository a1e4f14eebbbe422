"""Refuse what a search cannot reduce: free motions, silent outputs, and bases that have lost part of the response.

All functions but check_response are collective.
"""

from __future__ import annotations

import numpy as np

from ...linalg.free_motions import free_motions_refused
from ...model.rigid_body.modes import pushed_motions
from ...model.rigid_body.support import ROUND_OFF
from ...model.second_order_model import massless
from ...parallel.decisions import decided
from ...parallel.failures import InputError
from ..small.error_estimate import is_free, is_silent
from ..small.pseudo_modal import NEARLY_ZERO
from .residual_blocks import largest_residual

ZERO = np.finfo(float).eps  # squared frequencies, relative to the largest, that are round-off; up to NEARLY_ZERO where
# round-off shows in the estimate too
BETWEEN = (0.31, 0.77)  # of the band: where a basis that can hold nothing more is tried, which are no points
RESIDUALS = 4  # directions of residuals that are tried where random columns add nothing
LACKING = 1e-8  # residual of such a basis that solves alone do not leave
LOST = 1e-2  # residual of such a basis, relative to the loads: round-off has come to 1e-5, what is lost leaves 0.1


def check_support(run, band):
    """Refuse outputs that see free rigid motions which inputs push, in a band (Hz) that begins at 0 Hz.

    Of a model without nodes whose rows do not go node by node only pseudo-modes show it (see check_response).
    """
    model = run.model
    if band[0] or run.rigid is not None:
        return
    loads, io = run.independent_loads
    pushed = pushed_motions(model, loads)
    of_inputs, of_outputs = (pushed @ columns for columns in io[:2])
    if np.abs(of_outputs.T @ of_inputs).max(initial=0.0) > 0:
        raise _infinite(model)


def check_response(projections, model, frequencies, found):
    """Refuse an infinite response at 0 Hz, if that is the first of the frequencies (Hz), and one that is zero: of a
    `model` of the basis whose error was `found`. Local."""
    run = projections.run
    noisy = found.noise > found.estimate
    if frequencies[0] == 0 and is_free(model, frequencies, NEARLY_ZERO if noisy else ZERO):
        raise _infinite(run.model) if run.rigid is None else free_motions_refused(run.model, run.rigid)
    if is_silent(model, frequencies[[0, -1]]):
        raise InputError(
            f"{run.model.name}: no output measures what the inputs move; the response is zero but for round-off"
        )


def _infinite(model):
    nodes = "" if model.dofs is not None else ", which needs nodes"
    frame = f"take frame 'buckens'{nodes}, " if model.is_symmetric("K") else ""  # else it has none
    by_nodes = f" (or held by springs that meet less than {ROUND_OFF:g} of K)" if model.dofs is not None else ""
    return InputError(
        f"{model.name}: the response at 0 Hz is infinite, for the body is free{by_nodes}; {frame}hold "
        "the body, or give a band that begins above 0"
    )


def check_motions(projections, among):
    """Refuse a free body that has more free motions than its own, where a pseudo-mode is near 0 Hz (see
    Run.check_free_motions); `among` (Hz)."""
    run = projections.run
    if run.rigid is not None:
        lowest = decided(run.model.comm, lambda: float(projections.model().frequencies[0]))
        run.check_free_motions(lowest, among)


def extend_by_random(solver, judge, width=2) -> int:
    """Add `width` random columns, or what residuals over the band leave where these are in the basis; returns how many
    are new. Refuse a basis that they add nothing to and that has lost part of the responses.

    What damps motions without mass moves them by forces that M has no part in.

    Where M is singular, round-off on dofs without mass may hide what is new, and what the basis has of their static
    deflection is an accident of its columns: both are decided on smooth ones.
    """
    new, projections = solver.extend_by_random(width), solver.projections
    if not new and is_singular(projections.run) and not solver.is_smooth and solver.smooth():
        new = solver.extend_by_random(width)
        if new:  # the first columns are no longer the model that the next point was to check
            judge.forget()
    if not new and projections.run.tau:
        new = solver.extend_by_residuals(judge.settings.band[1], RESIDUALS)
    if not new:
        judge.note_loss(check_complete(projections, judge.settings.band))
    return new


def check_complete(projections, band) -> float:
    """Refuse a basis that can hold nothing more, since M has no higher rank, and lacks part of the responses over the
    band (Hz); returns the error that it may have for that reason."""
    run, (low, high) = projections.run, band
    if projections.basis.size >= run.model.size - run.framed.rigid_size:
        return 0.0
    residual = largest_residual(projections, [low + share * (high - low) for share in BETWEEN])
    run.notes.incomplete |= residual > LACKING
    error = _error_lost(projections, residual)
    return 0.0 if run.tau else error  # where residuals have joined the basis


def check_massless(projections, points) -> float:
    """Refuse a basis that has lost solutions of its points (Hz): those that move no mass, or to round-off on dofs
    without mass, which it is not orthonormal on; returns the error that it may have for that reason."""
    run = projections.run
    if not is_singular(run):
        return 0.0
    error = _error_lost(projections, largest_residual(projections, points, damped=False))
    run.notes.massless = False  # nothing was lost
    return error


def _error_lost(projections, residual) -> float:
    """Return the error by what a basis leaves as a residual: r^T A^-1 r, second order in that. Refused where all may be
    lost."""
    if residual > LOST:
        raise _lost(projections)
    return residual**2


def is_singular(run) -> bool:
    """Test whether M is known to be singular, and is the inner product of the basis."""
    return not run.tau and bool(run.notes.massless or massless(run.model))


def _lost(projections):
    model, size = projections.run.model, projections.basis.size
    if not is_singular(projections.run):
        return InputError(
            f"{model.name}: a basis of {size} columns, to which solutions add nothing, has lost part of the responses "
            "to round-off, as of a nearly free body close to its lowest frequency; take other points, or a band that "
            "begins higher"
        )
    return InputError(
        f"{model.name}: M is singular, and a basis of {size} mass-orthonormal columns, which a Caughey series of more "
        "than two terms needs, has lost static deflection of motions without mass; take two terms (Rayleigh), modal "
        "ratios or a loss factor, or give them some mass"
    )
