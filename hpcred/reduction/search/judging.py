"""Judge the basis of a search: estimate the error over the band, prove it at new points, and choose the next points.

The error of a model is seen from the basis with its newest columns, without which the model is. A new point first
checks the model that was before it, whose error it knows exactly there.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ...linalg.solvers.shifted import NEARBY
from ...parallel.decisions import Team
from ..result.accuracy import Proof
from ..result.measure import Measure
from ..small.error_estimate import ALONE, UNIFORM, Comparison, grid, largest, measure_over, next_point, rounded
from ..small.pseudo_modal import nested
from .goal import Adaptive
from .projections import HELD_BACK, Projections
from .search_checks import check_response

MARGIN = 0.1  # part of the tolerance that the uncompressed basis may use; the rest is left to the compression
COLUMNS = 128  # columns of a point at most,
FILLED = 8  # and so many more for each random one that its blocks are filled with
AHEAD = 32  # columns beyond that, where the rate of the last block promises the goal within them
UNREFINED = 1e-2  # of the goal: where estimates are smaller, their grid is not refined
HAS_MODES = 1e-2  # estimated error below which a basis made at 0 Hz is taken to have the modes of the band


class Candidate(NamedTuple):
    """A model that a new point is to check: its `columns` (places in the basis), and those that its error was estimated
    from (`seen_from`), which have them."""

    columns: np.ndarray
    seen_from: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """The estimated error over the band of the model with the `columns` (places in the basis), without those that are
    held back, inf without such a model; the `noise` of the small models; the proofs of the candidate; whether the point
    is done."""

    estimate: float = np.inf
    noise: float
    columns: np.ndarray
    proofs: tuple[Proof, ...] = ()
    done: bool = False

    @property
    def measured(self) -> float:
        """The largest measured error of the candidate, inf without one."""
        return max((proof.measured for proof in self.proofs), default=np.inf)


@dataclass
class Blocks:
    """The blocks of a point (Hz) so far: `order` of the last one, the columns that are `new` with it, those `added` by
    all, and the estimates (`history`); `proving`: whether the point is to prove the candidate; `filled`: the random
    columns of each; `nearby`: the point (Hz) above it whose factor serves, or None."""

    frequency: float
    proving: bool
    nearby: float | None = None
    order: int = -1
    new: int = 0
    added: int = 0
    history: list[float] = field(default_factory=list)
    filled: int = 0

    def take(self, new):
        """Note a block."""
        self.order, self.new, self.added = self.order + 1, new, self.added + new


class Judge:
    """Judges the models of a search, and keeps what is known of their errors.

    `goal`: the tolerance of the uncompressed basis; `enough`: what serves at 0 Hz, if that is more. Of the last
    judgement `estimate` and `noise`; `lost`: the error by what the basis has lost to round-off; `candidate`: the model
    that the next point checks, or None. Methods that judge are local, for one rank to decide by, with a team, and
    change nothing; those that keep something have to be called on all ranks alike.
    """

    def __init__(self, projections: Projections, settings: Adaptive):
        self.projections, self.settings = projections, settings
        self.goal, self.enough = MARGIN * settings.tolerance, HAS_MODES if projections.run.solvers.multigrid else 0.0
        self.estimate, self.noise, self.lost = np.inf, 0.0, 0.0
        self.candidate: Candidate | None = None

    def keep(self, judged: Judgement):
        """Keep what was judged last."""
        self.estimate, self.noise = judged.estimate, judged.noise

    def check_next(self, columns: np.ndarray, size: int | None = None):
        """Have the next point check the model with the `columns`, which is seen from the first `size` columns, by
        default from all."""
        self.candidate = Candidate(columns, np.arange(self.projections.basis.size if size is None else size))

    def forget(self):
        """Have the next point check nothing: the columns of the candidate are no longer what they were."""
        self.candidate = None

    def note_loss(self, error: float):
        """Keep the error by what the basis has lost to round-off."""
        self.lost = max(self.lost, error)

    def demand_more(self):
        """Ask for a smaller estimate at 0 Hz, since a basis lacked modes."""
        self.enough /= 100

    @property
    def floor(self) -> float:
        """What can be asked for: the goal, or round-off."""
        return max(self.goal, self.noise)

    def is_fine(self, value) -> bool:
        """Test whether an error is about as small as can be asked for."""
        return bool(value <= 3 * self.floor)

    def compare(self, inner, outer, embedding, measure: Measure | None = None, team=ALONE) -> Comparison:
        """Return a model and one that contains it, by a measure, by default that of the search."""
        asked = self.settings
        measure = measure or measure_over(asked.error_measure, asked.band, outer)
        return Comparison(inner, outer, embedding, measure, team)

    def _compared(self, team, columns, among=None) -> Comparison:
        """Return the model of some columns beside that of `among`, by default all of the basis."""
        inner, outer = self.projections.model(columns), self.projections.model(among)
        which = columns if among is None else np.searchsorted(among, columns)
        return self.compare(inner, outer, nested(inner, outer, which), team=team)

    # one point

    def judge(self, team: Team, blocks: Blocks) -> Judgement:
        """Judge the basis after a block, and decide whether the point is done. Raises InputError."""
        columns = np.arange(self.projections.first_held_back)
        judged = Judgement(noise=self.noise, columns=columns)
        if not columns.size and blocks.new:
            return judged
        if not blocks.new:  # nothing new at all: the basis is complete
            columns = np.arange(self.projections.basis.size)
        pair = self._compared(team, columns)
        if blocks.order >= 1:
            rough = self._roughly(pair)
            if rough > 10 * max(self.floor, self._goal_at(blocks)) and self._has_room(blocks):
                return replace(judged, estimate=rough)
        S, curve = self._over_band(pair)
        judged = Judgement(estimate=float(curve.max()), noise=float(pair.noise(S).max()), columns=columns)
        check_response(self.projections, pair.outer, S, judged)
        if self.candidate is not None:
            judged = replace(judged, proofs=(self._proof(blocks.frequency, pair, blocks),))
        return replace(judged, done=self._is_done(blocks, judged))

    def _goal_at(self, blocks):
        """Return the error that the blocks of a point have to reach, unless round-off is larger."""
        return self.goal if blocks.frequency else max(self.goal, self.enough)

    def _limit(self, blocks):
        """Return columns of a point at most."""
        if self.projections.run.solvers.multigrid:
            return self.settings.columns
        return COLUMNS + 2 * self.projections.loads.getActiveColumns()[1] + FILLED * blocks.filled

    def _has_room(self, blocks):
        """Test whether another block may follow that is as large as the last one."""
        new, size = blocks.new, self.projections.basis.size
        return blocks.added + new <= self._limit(blocks) and new and size < self.settings.columns

    def _is_done(self, blocks, judged):
        """Test whether a point needs no more blocks, or may have none."""
        new = blocks.new
        if blocks.order < 1 and new and not (blocks.proving and (blocks.nearby or new >= HELD_BACK)):
            return False
        goal = max(self._goal_at(blocks), judged.noise)
        good = judged.estimate <= goal
        if good and blocks.proving and judged.proofs:  # the measured error has to be nearly exact
            proof = judged.proofs[0]
            good = proof.uncertainty <= max(proof.measured / 10, self.goal / 100, judged.noise)
        promising = _columns_ahead([*blocks.history, judged.estimate], goal, new) <= AHEAD
        most = self._limit(blocks) + (AHEAD if promising else 0)
        full = blocks.added + (0 if promising else new) > most or self.projections.basis.size >= self.settings.columns
        return bool(not new or good or full)

    def _proof(self, f, pair, blocks: Blocks | None = None) -> Proof:
        """Return the estimated error at a new point (Hz) of the candidate, and its error as measured from `pair.outer`;
        the uncertainty of that is the error of `pair.inner`, or a part of that of the basis without the first of the
        `blocks` of the point (see _unseen)."""
        at, columns, among = np.array([f]), *self.candidate
        old, seen_from = (self.projections.model(places) for places in self.candidate)

        def error(inner, outer, which):
            return float(self.compare(inner, outer, nested(inner, outer, which), pair.measure).curve(at)[0])

        uncertainty, unseen = float(pair.curve(at)[0]), self._unseen(blocks)
        if unseen < 1:
            without = np.arange(self.projections.basis.size - blocks.added)
            uncertainty = unseen * error(self.projections.model(without), pair.outer, without)
        return Proof(
            frequency=f, estimated=error(old, seen_from, np.searchsorted(among, columns)),
            measured=error(old, pair.outer, columns), uncertainty=uncertainty,
        )  # fmt: skip

    def _unseen(self, blocks) -> float:
        """Return how much of the error that a basis has at a new point may not be seen from the first block there,
        over what is seen; inf where that is not known.

        The block is x = A^-1 L of real A = K - omega^2 M, but for errors of which NEARBY bounds the energy. With
        proportional damping A(s) = a (A + m M), and beside the basis, where A is above omega0^2 - omega^2 for the point
        omega0 of the factor, the states are x / a but for a part d = |m| / (omega0^2 - omega^2). The response is off by
        the square of both, as Galerkin's projection is (Cea's lemma, in the norm of A), for drive points.
        """
        damping, same = self.projections.damping, self.projections.io.are_same
        if blocks is None or not blocks.nearby or blocks.order or damping.higher or not same:
            return np.inf
        a, b, _ = damping.coefficients(blocks.frequency)
        square = (2 * np.pi * blocks.frequency) ** 2
        d = abs(b / a + square) / ((2 * np.pi * blocks.nearby) ** 2 - square)
        left = (np.sqrt(NEARBY / (1 + NEARBY)) + d) ** 2 * (1 + d) ** 3 / (1 - d) ** 2 if d < 1 else np.inf
        return float(left / (1 - left)) if left < 1 else np.inf

    # the band

    def _over_band(self, pair, band=None):
        """Return frequencies of the band (S,), and the error of the inner model estimated at them."""
        S = grid([pair.outer, pair.inner], band or self.settings.band)
        return largest(pair, S, UNREFINED * self.goal, rounds=2)

    def _roughly(self, pair) -> float:
        """Return the largest estimate at a few frequencies."""
        S = grid([pair.outer], self.settings.band, UNIFORM // 4, None)
        return float(pair.curve(S).max())

    def next_points(self, team: Team, taken, count, band=None) -> list[float]:
        """Return up to `count` points (Hz) in the band, by default the whole one, where the estimate is largest."""
        band = band or self.settings.band
        pair = self._compared(team, self.candidate.columns)
        S, curve = self._over_band(pair, band)
        chosen = []
        for _ in range(count):
            f = next_point(S, curve, [*taken, *chosen], pair.outer, band)
            chosen += [rounded(f, self.settings.band)] if f is not None else []
        return chosen

    # several points at once

    def estimate_of_candidate(self, team: Team) -> float:
        """Return the largest estimate over the band of the candidate, from what it is seen from."""
        return float(self._over_band(self._compared(team, *self.candidate))[1].max())

    def judge_round(self, team: Team, points, columns) -> Judgement:
        """Judge the basis after a round of points, by the model with the `columns`, without those that are held back;
        `points` (Hz) check the candidate, where there is one: a first round of one point proves nothing."""
        pair = self._compared(team, columns)
        S, curve = self._over_band(pair)
        proofs = tuple(self._proof(f, pair) for f in points) if self.candidate is not None else ()
        noise = float(pair.noise(S).max())
        return Judgement(estimate=float(curve.max()), noise=noise, columns=columns, proofs=proofs)


def _columns_ahead(history, goal, width):
    """Return columns until the estimate is below the goal at the rate of the last block."""
    if len(history) < 2 or history[-1] >= history[-2] or history[-1] <= 0:
        return np.inf
    return width * max(0.0, np.log(history[-1] / goal) / np.log(history[-2] / history[-1]))
