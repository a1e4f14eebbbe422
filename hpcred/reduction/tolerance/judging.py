"""Judge what a basis is worth: estimate the error over the band, prove it at new points, and choose the next points.

The error of a model is seen from the basis with its newest columns, without which the model is. A new point first
checks the model that was before it, whose error it knows exactly there.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..measure import Measure
from .accuracy import Adaptive, Proof
from .error_estimate import UNIFORM, Comparison, grid, largest, measure_of, next_point, rounded
from .projections import HELD_BACK, Projections, places
from .pseudo_modal import nested
from .search_checks import check_response

MARGIN = 0.1  # of the tolerance that the big basis is made for; the rest is for the compression
CHAIN = 128  # columns of a point at most, and
AHEAD = 32  # as many more when the estimate promises to arrive with them


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """The estimated error over the band of the model without the columns from `hold` on (or, of a list, of these), inf
    without one; the `noise` of the small models; what was proven of the model before; whether the point is done."""

    estimate: float = np.inf
    noise: float
    hold: int | list[int]
    proofs: tuple[Proof, ...] = ()
    done: bool = False

    @property
    def exact(self) -> float:
        """The largest exact error of the model before, inf without one."""
        return max((proof.exact for proof in self.proofs), default=np.inf)


@dataclass
class Blocks:
    """The blocks of a point (Hz) so far: `order` of the last one, the columns that are `new` with it, those `added` by
    all, and the estimates (`history`); `closing`: whether the point is to prove the model before it."""

    frequency: float
    closing: bool
    order: int = -1
    new: int = 0
    added: int = 0
    history: list[float] = field(default_factory=list)

    def take(self, new):
        """Note a block."""
        self.order, self.new, self.added = self.order + 1, new, self.added + new


class Judge:
    """Judges the models of a search. Methods are local, for one rank to decide by, and change nothing.

    `goal`: the tolerance of the big basis; `enough`: what serves at 0 Hz, if that is more. The search notes what was
    judged last, `rest` (the estimate) and `noise`; the error by what the basis has `lost` to round-off; and in `before`
    the columns (how many, or which) of the model that the next point checks, and of the one that it was seen from.
    """

    def __init__(self, projections: Projections, settings: Adaptive):
        self.projections, self.settings = projections, settings
        self.goal, self.enough = MARGIN * settings.tolerance, 0.0
        self.rest, self.noise, self.lost = np.inf, 0.0, 0.0
        self.before: tuple | None = None

    @property
    def floor(self) -> float:
        """What can be asked for: the goal, or round-off."""
        return max(self.goal, self.noise)

    def is_fine(self, value) -> bool:
        """Whether an error is about as small as can be asked for."""
        return bool(value <= 3 * self.floor)

    def compare(self, inner, outer, embedding, measure: Measure | None = None) -> Comparison:
        """A model and one that contains it, by a measure, that of the outer one if None is given."""
        law, ports = self.projections.law, self.projections.ports
        measure = measure or measure_of(self.settings, outer, law, ports)
        return Comparison(inner, outer, embedding, law, ports, measure)

    # one point

    def judge(self, blocks: Blocks) -> Judgement:
        """What the basis is worth after a block, and whether the point is done. Raises InputError."""
        outer, hold = self.projections.model(), self.projections.hold
        found = Judgement(noise=self.noise, hold=hold)
        if hold == 0 and blocks.new:
            return found
        if not blocks.new:  # nothing new at all: the basis is complete
            hold = len(outer.squares)
        inner = self.projections.model(hold)
        pair = self.compare(inner, outer, nested(inner, outer))
        if blocks.order >= 1:
            rough = self._roughly(pair)
            if rough > 10 * max(self.floor, self._goal_at(blocks)) and self._has_room(blocks):
                return replace(found, estimate=rough)
        S, curve = self._over_band(pair)
        found = Judgement(estimate=float(curve.max()), noise=float(pair.noise(S).max()), hold=hold)
        check_response(self.projections, outer, S, found)
        if self.before is not None:
            found = replace(found, proofs=(self._proof(blocks.frequency, pair, hold),))
        return replace(found, done=self._is_done(blocks, found))

    def _goal_at(self, blocks):
        """What the blocks of a point are to reach, if round-off lets them."""
        return self.goal if blocks.frequency else max(self.goal, self.enough)

    def _limit(self):
        """Columns of a point at most."""
        if self.projections.run.multigrid:
            return self.settings.columns
        return CHAIN + 2 * self.projections.loads.getActiveColumns()[1]

    def _has_room(self, blocks):
        """Whether another block may follow that is as large as the last one."""
        new, size = blocks.new, self.projections.basis.size
        return blocks.added + new <= self._limit() and new and size < self.settings.columns

    def _is_done(self, blocks, found):
        """Whether a point needs no more blocks, or may have none."""
        new = blocks.new
        if blocks.order < 1 and new and not (blocks.closing and new >= HELD_BACK):
            return False
        goal = max(self._goal_at(blocks), found.noise)
        good = found.estimate <= goal
        if good and blocks.closing and found.proofs:  # the value that is called exact has to be
            proof = found.proofs[0]
            good = proof.own <= max(proof.exact / 10, self.goal / 100, found.noise)
        promising = _columns_ahead([*blocks.history, found.estimate], goal, new) <= AHEAD
        most = self._limit() + (AHEAD if promising else 0)
        full = blocks.added + (0 if promising else new) > most or self.projections.basis.size >= self.settings.columns
        return bool(not new or good or full)

    def _proof(self, f, pair, hold) -> Proof:
        """What was said at a new point (Hz) of the model before, and its exact error, seen from `pair.outer`; the rest
        of what is called exact, seen from `pair.inner`, which is of the columns `hold` of the same basis."""
        at, outer = np.array([f]), pair.outer
        old, seen_from = (self.projections.model(columns) for columns in self.before)
        which, among = (places(columns) for columns in self.before)

        def error(one, other, columns):
            return float(self.compare(one, other, nested(one, other, columns), pair.measure).curve(at)[0])

        return Proof(
            frequency=f, exact=error(old, outer, which), said=error(old, seen_from, np.searchsorted(among, which)),
            own=error(pair.inner, outer, places(hold)),
        )  # fmt: skip

    # the band

    def _over_band(self, pair, band=None):
        """Frequencies of the band (S,), and the error of the inner model estimated at them."""
        return largest(pair, grid([pair.outer, pair.inner], pair.law, band or self.settings.band), rounds=2)

    def _roughly(self, pair) -> float:
        """The largest estimate at a few frequencies."""
        S = grid([pair.outer], pair.law, self.settings.band, UNIFORM // 4, None)
        return float(pair.curve(S).max())

    def next_points(self, taken, count, band=None) -> list[float]:
        """Up to `count` points (Hz) in the band, by default the whole one, where the estimate is largest."""
        band = band or self.settings.band
        inner, outer = self.projections.model(self.before[0]), self.projections.model()
        S, curve = self._over_band(self.compare(inner, outer, nested(inner, outer, places(self.before[0]))), band)
        chosen = []
        for _ in range(count):
            f = next_point(S, curve, [*taken, *chosen], outer, band)
            chosen += [rounded(f, self.settings.band)] if f is not None else []
        return chosen

    # several points at once

    def between(self, inner_columns, outer_columns) -> float:
        """The largest estimate for one part of the basis, seen from another that has it."""
        inner, outer = self.projections.model(inner_columns), self.projections.model(outer_columns)
        columns = np.searchsorted(places(outer_columns), places(inner_columns))
        return float(self._over_band(self.compare(inner, outer, nested(inner, outer, columns)))[1].max())

    def judge_round(self, points, hold) -> Judgement:
        """What the basis is worth after a round of points, without the columns that are not in `hold`; `points` (Hz)
        check the model before, where there is one: a first round of one point proves nothing."""
        outer, inner = self.projections.model(), self.projections.model(hold)
        pair = self.compare(inner, outer, nested(inner, outer, hold))
        S, curve = self._over_band(pair)
        proofs = [self._proof(f, pair, hold) for f in points] if self.before is not None else []
        noise = float(pair.noise(S).max())
        return Judgement(estimate=float(curve.max()), noise=noise, hold=hold, proofs=tuple(proofs))


def _columns_ahead(history, goal, width):
    """Columns until the estimate is below the goal at the rate of the last block."""
    if len(history) < 2 or history[-1] >= history[-2] or history[-1] <= 0:
        return np.inf
    return width * max(0.0, np.log(history[-1] / goal) / np.log(history[-2] / history[-1]))
