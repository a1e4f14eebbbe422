"""Find modes that no load moves, which inertia counts but a basis misses, by random columns.

A pseudo-mode counts for the mode that it stands for, however far below it that is: one of 0.3 Hz may stand for a soft
mode of 1e-4 Hz, and hide that it is missing. Its residual shows that it is none.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...linalg.blocks import add_product, create_block, local_rows, times
from ...parallel.decisions import decided
from ...parallel.sums import summed
from ..small.error_estimate import grid, unsettled
from ..small.pseudo_modal import NEARLY_ZERO, nested
from .judging import Judge
from .point_solver import PointSolver
from .residual_blocks import row_scale
from .search_checks import extend_by_random

UNCOUNTED = 60  # random columns at most where no count tells that modes are missing
QUIET = 2  # pairs of random columns that show nothing new, after which all is found that there is no count for
FEW, MOST = (2, 4), 16  # columns of a block, random ones and modes, if few are missing, and at most
PASSES = 3  # by residuals
# r^T diag(K)^-1 r over x^T K x of a pseudo-mode x, above which it may be no mode: up to 1e-16 of a good basis, 3e-8 of
# one that is off by 5 percent; a mode in doubt costs a solve with a column
DOUBTFUL = 1e-10


def find_hidden(
    solver: PointSolver, judge: Judge, band, lack_of: Callable[[np.ndarray | None], int] | None,
    is_over: Callable[[], bool], doubtful: np.ndarray | None = None,
) -> tuple[int, float]:  # fmt: skip
    """Add random columns, and A^-1 M x of pseudo-modes x that still move, until no mode is missing or the search
    `is_over`; returns how many still are, and how far the response over the band has moved. Collective. Raises
    InputError.

    `band`: frequencies (Hz) between which modes are looked for; `lack_of(before)`: how many of those that are counted
    the basis misses, seen from a model of the columns `before`, or None where nothing is counted; `solver`: at a point
    of the band or above it, or at 0 Hz; `doubtful`: pseudo-modes to begin with (see doubtful_modes).
    """
    projections, run = solver.projections, solver.run
    size, used, moving, quiet, passes = projections.basis.size, 0, doubtful, 0, 1
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
        if moving is None and lack <= 0 and passes < PASSES and not solver.multigrid:  # soft ones move by little
            moving, passes = doubtful_modes(projections, judge.settings.band), passes + 1
        quiet = quiet if moving is None else 0
        if moving is None and (lack <= 0 if lack_of is not None else quiet == QUIET):
            break
        if is_over():
            break
    run.note("modes that no load moves", used, projections.basis.size - size)
    return lack, decided(run.model.comm, _change, judge, np.arange(size))


def doubtful_modes(projections, band) -> np.ndarray | None:
    """Return the pseudo-modes of a band (Hz) that may be no modes, by their residuals, as combinations (m, k) of
    the basis; at most MOST, the worst first, None without any. Collective."""
    model = decided(projections.run.model.comm, projections.model)
    which = np.flatnonzero((model.frequencies >= band[0]) & (model.frequencies < band[1]))
    if not (len(which) and projections.symmetric):
        return None
    chunks = np.array_split(which, -(-len(which) // MOST))  # which bounds the memory
    ratio = np.concatenate([_residuals(projections, model, chunk) for chunk in chunks])
    worst = decided(projections.run.model.comm, _largest, ratio)
    return model.vectors[:, which[worst]] if len(worst) else None


def _largest(ratio):
    worst = np.argsort(-ratio, kind="stable")[:MOST]
    return worst[ratio[worst] > DOUBTFUL]


def _residuals(projections, model, which) -> np.ndarray:
    """Return r^T diag(K)^-1 r over x^T K x of the pseudo-modes `which`, r = K x - omega^2 M x."""
    full, x = projections.run.model, _combined(projections, model.vectors[:, which])
    products, scale = (times(full.K, x), times(full.M, x)), row_scale(full)[:, None]
    with local_rows(x) as rows, local_rows(products[0]) as Kx, local_rows(products[1]) as Mx:
        residual = Kx - (2 * np.pi * model.frequencies[which]) ** 2 * Mx
        norms = np.array([np.abs(scale * residual) ** 2, (rows * Kx).real, np.abs(rows / scale) ** 2])
        rest, energy, terms = summed(full.comm, norms.sum(axis=1))
    for block in (x, *products):
        block.destroy()
    return rest / np.maximum(energy, NEARLY_ZERO * terms)  # K of a free motion is round-off


def _combined(projections, factor):
    """Return the combinations V factor as a block."""
    x = create_block(projections.run.model.K, factor.shape[1])
    add_product(x, projections.basis.columns, factor, beta=0.0)
    return x


def _extend_by_modes(solver, factor):
    """Add A^-1 M x of the combinations x = V factor."""
    x = _combined(solver.projections, factor)
    return solver.extend_by_basis(lambda: solver.run.times_mass(x))


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
