"""Find modes that no load moves, which inertia counts but a basis misses, by random columns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...linalg.blocks import add_product, create_block
from ...parallel.decisions import decided
from ..small.error_estimate import grid, unsettled
from ..small.pseudo_modal import nested
from .judging import Judge
from .point_solver import PointSolver
from .search_checks import extend_by_random

UNCOUNTED = 60  # random columns at most where no count tells that modes are missing
QUIET = 2  # pairs of random columns that show nothing new, after which all is found that there is no count for
FEW, MOST = (2, 4), 16  # columns of a block, random ones and modes, if few are missing, and at most


def find_hidden(
    solver: PointSolver, judge: Judge, band, lack_of: Callable[[np.ndarray | None], int] | None,
    is_over: Callable[[], bool],
) -> tuple[int, float]:  # fmt: skip
    """Add random columns, and A^-1 M x of pseudo-modes x that still move, until no mode is missing or the search
    `is_over`; returns how many still are, and how far the response over the band has moved. Collective. Raises
    InputError.

    `band`: frequencies (Hz) between which modes are looked for; `lack_of(before)`: how many of those that are counted
    the basis misses, seen from a model of the columns `before`, or None where nothing is counted; `solver`: at a point
    of the band or above it, or at 0 Hz.
    """
    projections, run = solver.projections, solver.run
    size, used, moving, quiet = projections.basis.size, 0, None, 0
    lack = decided(run.model.comm, lack_of, None) if lack_of is not None else 0
    while used < UNCOUNTED or lack_of is not None:
        before = projections.basis.size
        if moving is None:
            used += extend_by_random(solver, judge, min(max(FEW[0], lack), MOST))
        else:
            used += _extend_by_modes(solver, moving)
        if projections.basis.size == before:
            if moving is None:
                break
            moving = None  # these modes are all there, as one of each multiple eigenvalue is
            continue
        quiet = quiet + 1 if moving is None else 0
        moving, lack = decided(run.model.comm, _moving, projections, np.arange(before), band, lack_of)
        quiet = quiet if moving is None else 0
        if moving is None and (lack <= 0 if lack_of is not None else quiet == QUIET):
            break
        if is_over():
            break
    run.note("modes that no load moves", used, projections.basis.size - size)
    return lack, decided(run.model.comm, _change, judge, np.arange(size))


def _extend_by_modes(solver, factor):
    """Add A^-1 M x of the combinations x = V factor."""
    run = solver.run
    x = create_block(run.model.K, factor.shape[1])
    add_product(x, solver.projections.basis.columns, factor, beta=0.0)
    return solver.extend_by_basis(lambda: run.times_mass(x))


def _moving(projections, before, band, lack_of):
    """Return the pseudo-modes of the band that were not there with the columns `before`, or None, and how many modes
    are missing."""
    lack = 0 if lack_of is None else lack_of(before)
    model, old = projections.model(), projections.model(before)
    which = unsettled(model, old, band[1], min(max(FEW[1], lack), MOST), band[0])
    return model.vectors[:, which] if len(which) else None, lack


def _change(judge, before) -> float:
    """Return what the columns that were not there `before` have changed of the response over the band."""
    model, old = judge.projections.model(), judge.projections.model(before)
    S = grid([model], judge.settings.band)
    return float(judge.compare(old, model, nested(old, model)).curve(S).max())
