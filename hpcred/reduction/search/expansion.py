"""Grow the basis of a search by the blocks of one point after another, each until the estimate is small."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...linalg.basis import Basis
from ...linalg.known import ModeCount
from ...parallel.decisions import decided, decided_with
from ...parallel.failures import InputError
from ..components.point_blocks import Part, PointBlocks
from ..result.accuracy import Point
from ..run.run import Run
from ..small.damping import UNDAMPED, measured_damping
from ..small.error_estimate import missing, resonances
from .goal import Adaptive
from .judging import COLUMNS, Blocks, Judge, Judgement
from .point_solver import PointSolver
from .projections import Projections
from .search_checks import check_massless, check_support, extend_by_random, is_singular
from .silent_outputs import silent_columns

BLOCK = 16  # columns of a block that is made from residuals
WHOLE = 150  # dofs up to which the basis is the whole space where blocks would be: one is dearer than all coordinates
FEW_BELOW = 0.1  # of the upper end of a band: a lower end up to it leaves few modes below the band
HOPELESS = 300  # modes in the band, beyond which a search that may have fewer columns is not begun
MANY, LARGE_PART = 30, 0.2  # modes in the band, and of all modes: beyond both the band looks wrong
NEAR_END = 0.9  # of the band: where a point that does not count modes is to be


class Expansion:
    """The basis of a search, and the `points` (in order) that it came from. Methods are collective. Raises InputError.

    `projections` of the basis, the `solver` of its points, and the `judge` of its models; `by_mass`: blocks of a point
    are those of a Krylov sequence, else they are made from residuals.
    """

    def __init__(self, basis: Basis, run: Run, settings: Adaptive):
        self.run, self.settings = run, settings
        damping, damped, self._measured = measured_damping(
            run.framed.damping, settings.zeta0, settings.band, run.model.added.plural
        )
        check_support(run, settings.band)
        self._asked_damping = damping
        self.projections = Projections(run, basis, damping, damped)
        self.points: list[Point] = []
        self.judge = Judge(self.projections, settings)
        self.solver = PointSolver(self.projections, settings, self.points)
        inputs = self.projections.loads.getActiveColumns()[1]
        coupled = self.projections.is_damped or not self.projections.symmetric
        self.by_mass = not coupled and inputs <= BLOCK
        self._width = min(4 * inputs if coupled else inputs, BLOCK)
        self._whole = coupled and not self.solver.multigrid and run.model.size <= min(WHOLE, settings.columns)
        self._accounted = len(run.factorisations)  # those that belong to a point, or to what was before the search

    @property
    def measured(self) -> str:
        """With which damping responses are measured, in words."""
        found, eta = self._measured, self.projections.damping.eta
        if not self.solver.counts or (self.is_at_end and not self.is_counted):
            rough = f" by such factors ({self.run.solvers.source.in_words})" if self.solver.counts else ""
            found += f"; modes cannot be counted here{rough}, a second verification replaces the count"
        if eta == self._asked_damping.eta:
            return found
        leave = f"{self.run.model.added.plural} leave" if self.run.model.added else "damping matrix leaves"
        return f"{found} and the loss factor {eta:g}, since the {leave} modes of the band without damping"

    @property
    def counts(self) -> list[ModeCount]:
        """What the factors of points have told of the modes below them."""
        return [point.count for point in self.points if point.count is not None]

    @property
    def highest_count(self) -> ModeCount | None:
        """The count at the end of the band or the next above it, else that nearest to the end; None without one."""
        high = self.settings.band[1]
        return min(self.counts, key=lambda count: (count.below < high, abs(count.below - high)), default=None)

    @property
    def is_at_end(self) -> bool:
        """Whether a point counts all modes of the band, or lies near its end where points do not count."""
        end = self.settings.band[1] * (1.0 if self.solver.counts else NEAR_END)
        return any(point.frequency >= end for point in self.points)

    @property
    def is_counted(self) -> bool:
        """Whether all modes of the band are counted."""
        found = self.highest_count
        return found is not None and found.below >= self.settings.band[1]

    def missing_modes(self, among=None) -> int:
        """Return how many modes of the band that points have counted the basis misses; local. `among`: the columns of
        the model before, by default those that are not held back."""
        projections = self.projections
        before = np.arange(projections.first_held_back) if among is None else among
        return missing(projections.model(), self.counts, self.settings.band, lambda: projections.model(before))

    def at(self, f, proving=False, nearby: float | None = None) -> Judgement:
        """Add blocks of a point (Hz) until the estimate over the band is small; returns what was judged last.

        `proving`: whether the point is to prove the candidate; `nearby`: the point whose factor serves.
        """
        run, solver, before = self.run, self.solver, self.projections.basis.size
        run.progress.step("points", len(self.points))
        f, count = solver.open(f, nearby)
        self._look_at_count(count)
        blocks, sequence = Blocks(f, proving, solver.nearby or None), None
        if self.by_mass and solver.nearby is None:
            sequence = solver.sequence(f)
            blocks.filled = sequence.filled
        judged = self._extend(blocks, sequence)
        if sequence is not None:
            sequence.keep()
        made = self._unaccounted()
        stored, columns = not made and solver.nearby is None, self.projections.basis.size - before
        run.notes.needs(str(solver.factored), "0.0")
        run.note(f"adaptive {f:.6g} Hz, {blocks.order + 1} blocks", columns, columns, from_store=stored)
        self.points.append(Point(
            frequency=f, columns=columns, modes_below=None if count is None else count.modes,
            source=None if count is None else count.source, factors=len(made), factor_seconds=_seconds(made),
            estimate=judged.estimate if np.isfinite(judged.estimate) else None, from_store=stored,
            factor_of=solver.nearby,
        ))  # fmt: skip
        return judged

    def take(self, points: list[Point]):
        """Take over points that groups of ranks have made."""
        self.points += points
        self._unaccounted()

    def account(self):
        """Count the factors that were made since the last point for that one."""
        if made := self._unaccounted():
            last = self.points[-1]
            self.points[-1] = replace(
                last, from_store=False, factors=(last.factors or 0) + len(made),
                factor_seconds=last.factor_seconds + _seconds(made),
            )  # fmt: skip

    def _unaccounted(self):
        records = self.run.factorisations
        made, self._accounted = records[self._accounted :], len(records)
        return made

    @property
    def few_below(self) -> bool:
        """Whether few modes lie below the band, so that a count of those below its end is one of the band."""
        low, high = self.settings.band
        return low <= FEW_BELOW * high

    def _look_at_count(self, found: ModeCount | None):
        """Refuse a band with more modes than the basis may have, once a point has counted them, and warn once of one
        that has a large part of all modes."""
        if found is None or not self.few_below:
            return
        size, name, count, f = self.run.model.size, self.run.model.name, found.modes, found.below
        if count > max(self.settings.columns, HOPELESS):
            raise InputError(
                f"band: {count} of the {size} modes of {name} lie below {f:g} Hz, by the inertia of K - omega^2 M, and "
                f"the basis of a search has at most {self.settings.columns} columns (adaptive.columns); is the band in "
                "Hz, and are M and K in the units of one system? Ask for a lower band"
            )
        if not self.points and count > MANY and count > LARGE_PART * size:
            self.run.remark(
                f"band: {count} of the {size} modes of {name} lie below {f:g} Hz, by the inertia of K - omega^2 M, so "
                "that the reduced model cannot be small; no mesh follows so many of its modes"
            )

    def _extend(self, blocks, sequence) -> Judgement:
        """Add blocks until the estimate is small: those of a Krylov sequence, or made from residuals."""
        progress, smoothed = self.run.progress, False
        while True:
            new = self.solver.extend_by_loads() if smoothed else self._extend_by_block(blocks, sequence)
            if not new:  # the loads and their sequence are exhausted: what do random columns reveal?
                new = extend_by_random(self.solver, self.judge)
            blocks.take(new)
            with progress.stage("estimate"):
                self.look_at_damping()
                self.look_at_outputs()
                judged = self._judged(blocks)
            self.judge.keep(judged)
            known = ""
            if np.isfinite(judged.estimate):
                blocks.history.append(judged.estimate)
                known = f", estimated error {judged.estimate:.1e}"
            size = self.projections.basis.size
            progress.say(f"{blocks.frequency:.6g} Hz, block {blocks.order}: {size} columns{known}", minor=True)
            if smoothed or (judged.done and not self._smooth(judged)):
                return judged
            smoothed = judged.done

    def _extend_by_block(self, blocks, sequence) -> int:
        """Add the next block of a point; returns how many columns are new."""
        f, projections, first = blocks.frequency, self.projections, blocks.order < 0
        if sequence is not None:
            place, vectors = sequence.advance(), sequence.vectors
            return projections.extend(vectors.columns_between(*place), vectors.mass_images_between(*place))
        if self._whole and first and not projections.basis.size:
            return self.solver.extend_by_all_dofs()
        by_residuals = not first or (
            self.judge.candidate is not None and (not self.by_mass or (self.solver.multigrid and not f))
        )
        if projections.basis.size and by_residuals:
            return self.solver.extend_by_residuals(f, self._width)
        return self.solver.extend_by_loads()

    def _judged(self, blocks) -> Judgement:
        """Judge the basis after a block of a point."""
        try:
            return decided_with(self.run.model.comm, self.judge.judge, blocks)
        except InputError:  # a response without what moves no mass may be nothing
            if self.projections.basis.size:
                check_massless(self.projections, [blocks.frequency])
            raise

    def _smooth(self, judged) -> bool:
        """Smooth a basis that round-off on dofs without mass keeps from the tolerance; return whether that was done."""
        noisy = judged.noise > self.settings.tolerance / 2 and is_singular(self.run) and not self.solver.is_smooth
        if not (noisy and self.solver.smooth()):
            return False
        self.judge.forget()
        return True

    def look_at_damping(self):
        """Measure with the loss factor of undamped models what a given D leaves without damping; decided once."""
        projections = self.projections
        undamped = projections.is_damped and not projections.damping.eta
        if undamped and decided(self.run.model.comm, self._has_undamped):
            projections.add_loss_factor(2 * self.settings.zeta0)

    def look_at_outputs(self):
        """Find the outputs whose responses are round-off."""
        if self.projections.basis.size:
            self.projections.note_silent(*silent_columns(self.projections, self.settings.band))

    def look_at_outputs_again(self):
        """Find others whose responses are round-off by models that have more digits."""
        projections, known = self.projections, self.projections.io
        silent, quiet = silent_columns(projections, self.settings.band)
        projections.note_silent(tuple(sorted({*known.silent, *silent})), known.quiet or quiet)

    def _has_undamped(self):
        low, high = self.settings.band
        f, ratio = resonances(self.projections.model())
        return bool((ratio[(f >= 0.9 * low) & (f <= 1.1 * high)] < UNDAMPED).any())


def expanded(run: Run, settings: Adaptive, f) -> tuple[PointBlocks, Point]:
    """Return the blocks of one point (Hz) on a basis of its own, and what is known of the point. Collective."""
    vectors = run.new_basis(COLUMNS)
    expansion = Expansion(vectors, run, replace(settings, points=(f,)))
    expansion.at(f)
    parts = [Part(f"{f:.6g} Hz", stop - start, start, stop, False) for start, stop in expansion.projections.blocks]
    return PointBlocks(vectors, parts), replace(expansion.points[0], estimate=None)


def _seconds(records) -> float:
    return float(sum(record.factor_seconds for record in records))
