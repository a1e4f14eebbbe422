"""Find modes that no load moves, which inertia counts but a basis misses, by random columns."""

from __future__ import annotations

import numpy as np

from ...linalg.blocks import add_product, create_block
from ...parallel.decisions import decided
from .error_estimate import grid, missing, unsettled
from .judging import Judge
from .point_solver import PointSolver
from .pseudo_modal import nested
from .search_checks import extend_by_random

HIDDEN = 60  # random columns at most
QUIET = 2  # pairs of random columns that show nothing new, after which all is found that there is no count for


def find_hidden(solver: PointSolver, judge: Judge, counted) -> tuple[int, float]:
    """Add random columns, and A^-1 M x of pseudo-modes x that still move, until no mode is missing; returns how many
    still are, and how far the response over the band has moved. Collective. Raises InputError.

    `counted`: points (Hz) with the number of modes below each; `solver`: at one of them, or at 0 Hz.
    """
    projections, run = solver.projections, solver.run
    size, used, moving, quiet = projections.basis.size, 0, None, 0
    while used < HIDDEN:
        before, by_random = projections.basis.size, moving is None
        used += extend_by_random(solver, judge) if moving is None else _extend_by_modes(solver, moving)
        if projections.basis.size == before:
            break
        moving, lack = decided(run.model.comm, _moving, projections, before, counted)
        quiet = quiet + 1 if by_random and moving is None else 0
        if moving is None and lack <= 0 and (solver.counts or quiet == QUIET):
            break
    run.note("modes that no load moves", used, projections.basis.size - size)
    return decided(run.model.comm, _change, judge, size, counted)


def _extend_by_modes(solver, factor):
    """Add A^-1 M x of the combinations x = V factor."""
    run = solver.run
    x = create_block(run.model.K, factor.shape[1])
    add_product(x, solver.projections.basis.columns, factor, beta=0.0)
    return solver.extend_by_basis(lambda: run.times_mass(x))


def _moving(projections, before, counted):
    """Return the pseudo-modes that were not there with the first `before` columns, or None, and how many modes are
    missing."""
    model, old = projections.model(), projections.model(np.arange(before))
    which = unsettled(model, old, max(f for f, _ in counted))
    return model.vectors[:, which] if len(which) else None, missing(model, counted)


def _change(judge, before, counted):
    """Return how many modes are missing, and what the columns from `before` on have changed of the response over the
    band."""
    model, old = judge.projections.model(), judge.projections.model(np.arange(before))
    S = grid([model], judge.settings.band)
    return missing(model, counted), float(judge.compare(old, model, nested(old, model)).curve(S).max())
