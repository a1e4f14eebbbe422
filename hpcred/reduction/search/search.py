"""Search for the points, orders and size of a reduction to a tolerance, and prove the error.

One point carries many blocks. It lies at the end of the band, where the negative pivots of K - omega^2 M count the
modes below it. The error is seen from a basis that is some blocks richer: the difference of the two models,
r^T A_Q^-1 r, is exact in the richer one (see pseudo_modal). Each new point first checks the model that was made before
it, since its own blocks give the exact value there, and then extends the basis. Where the model is good and has all
modes of the band, that takes no factor: beside the basis the factor of the point above is close to the inverse, and
conjugate gradients see what it lacks in a step or two (see linalg.solvers.shifted). Last, the basis is compressed to
the few combinations that the tolerance asks for (see outcome). (Panzer & Wolf, 2014; Bonin, Fassbender, Soppa & Zaeh,
2016; Lecomte et al., AIAA J. 41, 2003, for the count of modes.)

Without factors (see linalg.solvers.multigrid) the first point is at 0 Hz, until the basis has the modes of the band;
beside such a basis points in the band are solved for in the same way. With a given D, or many inputs, the blocks of a
point are made from residuals, and the first point lies in the middle of the band.
"""

from __future__ import annotations

from enum import Enum

import numpy as np

from ...linalg.basis import Basis
from ...linalg.conjugate_gradients import NotSolved
from ...linalg.solvers.multigrid import not_definite
from ...model.second_order_model import massless
from ...parallel.decisions import decided, decided_with
from ...parallel.failures import InputError
from ...parallel.progress import counted
from ...parallel.stopping import stop_if_asked
from ..result.accuracy import Proof
from ..run.run import Run
from ..small.error_estimate import apart, rounded
from .expansion import Expansion
from .goal import Adaptive
from .hidden_modes import doubtful_modes, find_hidden
from .judging import Candidate, Judgement
from .point_solver import NoRegularPoint
from .rounds import take_round
from .search_checks import check_massless, check_motions

ROUND_OFF_SEEN = 5e-12  # of the terms of x^T K x, times sharp resonances, over a hundredth of the tolerance
KEPT = 1e-13  # deflation tolerance: what round-off brings is compressed away at the end
KEPT_WITHOUT_MASS = 1e-7  # the same with dofs without mass: round-off there grows by its inverse, and is stiff
ABOVE = 1.5  # of the band: modes that come down to it are followed from there, where they are not counted
PROOF = 1 / 8  # of the band: where models are proven first, whatever damping and tolerance, so that a store serves


def deflation_of_search(model) -> float:
    """Return the deflation tolerance of a search on a model. Collective."""
    return KEPT_WITHOUT_MASS if massless(model) else KEPT


class State(Enum):
    """Where a search is."""

    SEEKING = "the estimate is too large: the next point is taken where it is largest"
    PROVING = "the estimate is small enough: the next point measures the error of the candidate"
    PROVEN = "the tolerance is reached"
    ENDED = "a limit ended the search before that"


class Search:
    """An automatic reduction under way: a state machine, whose `state` changes after each point.

    Its `expansion` is the basis and what is known of it; `proofs`: estimates against measured errors, so far;
    `missing_modes`: of the band, that the basis is known to miss; `reason`: why it ended before the tolerance was
    reached, or ""; `kept`: how many columns, first in the basis, stay in its span. With a `candidate`, a model of the
    columns that the basis has already, the search begins by proving it. Methods are collective, and what depends on
    small arrays is decided once for all ranks. Raises InputError.
    """

    def __init__(
        self, basis: Basis, run: Run, settings: Adaptive, groups: int = 1, candidate: Candidate | None = None,
        kept: int = 0,
    ):  # fmt: skip
        self.run, self.settings, self.kept = run, settings, kept
        run.cancels = ROUND_OFF_SEEN / settings.tolerance
        self.expansion = Expansion(basis, run, settings)
        self.projections, self.judge = self.expansion.projections, self.expansion.judge
        self.state, self.reason = State.SEEKING, ""
        self.proofs: list[Proof] = []
        self.missing_modes = 0
        self._solver, self._points = self.expansion.solver, self.expansion.points
        # residuals need the whole basis, which a group does not have
        self._groups = groups if self.expansion.by_mass and not self._solver.multigrid else 1
        if candidate is not None:
            self.judge.candidate = candidate
            # multigrid begins at 0 Hz, where all its models are exact
            self.state = State.SEEKING if self._solver.multigrid else State.PROVING
        self._next = self._first_points()
        self._has_modes = False  # whether all pseudo-modes of the band are known to be its modes
        self._sought_unmoved = False  # whether modes that no load moves were looked for without a count

    def _first_points(self):
        (low, high), asked = self.settings.band, self.settings.points
        if self._solver.multigrid:
            if any(asked):
                raise InputError(f"adaptive.points: found {list(asked)}; {not_definite('points above 0 Hz')}")
            return [0.0]
        if asked:
            return [*asked]
        if self._groups > 1:
            return [low + (i + 0.5) * (high - low) / (self._groups - 1) for i in range(self._groups - 1)] + [high]
        proving = self.state is State.PROVING
        return [high if self.expansion.by_mass or proving else float(np.sqrt((low**2 + high**2) / 2))]

    def run_to_end(self):
        """Take points until the tolerance is proven or a limit is met."""
        while self.state in (State.SEEKING, State.PROVING):
            if not self._next:
                self._end("since no place for another point is left")
                return
            points, self._next = self._next[: self._groups], self._next[self._groups :]
            try:
                judged = self._take(points)
            except NotSolved as error:
                self._go_on_without(error, points[0])
                continue
            except NoRegularPoint as error:
                if not self._points:
                    raise
                self._end(f"since {error}")
                return
            self._decide(judged)

    def _end(self, reason):
        self.state, self.reason = State.ENDED, reason

    # after a point

    def _decide(self, judged):
        """Go to the next state by what was judged of a point."""
        judge, proving = self.judge, self.state is State.PROVING
        fine = judge.is_fine(judged.estimate)
        proven = proving and fine and judge.is_fine(judged.measured)
        # modes that inertia counts and the basis misses, once it is good else
        hidden, doubtful = self._seeks_hidden(fine, proven)
        if hidden and self._lacks_lower_count():
            hidden, proven = False, False
            self._next.insert(0, self.settings.band[0])
        if hidden:
            proven = self._find_hidden(doubtful) and proven
            self._check_motions()
            if self.missing_modes > 0:
                lack, are = counted(self.missing_modes, "mode"), "is" if self.missing_modes == 1 else "are"
                self._end(f"since {lack} of the band {are} missing {self._columns_or_time_met()}".rstrip())
                return
        # not proven, or not twice where nothing is counted: another point
        again = proven and not self.expansion.is_counted and not self._is_proven_twice()
        if not proven or again:
            self.state = State.PROVING if fine else State.SEEKING
            judge.check_next(judged.columns)
            if reason := self._limit_met():
                self._end(reason)
                return
            proven = not self._choose_next(again)
        if proven:
            self._check_massless()
            self.state = State.PROVEN
            return
        if hidden:  # the next point checks the model that has these modes
            judge.check_next(np.arange(self.projections.first_held_back))
        stop_if_asked(self.run.model.comm, f"point {len(self._points)}")

    def _go_on_without(self, error, f):
        """Go on where the basis may lack a mode below a point f that a solve failed at, or end."""
        solver = self._solver
        if not solver.is_nearby or not solver.goes_on_without(error):
            raise error
        if not solver.multigrid:  # the same point, by a factor of its own
            self._next.insert(0, f)
        elif self.judge.enough >= self.judge.goal:
            self.judge.demand_more()
            self._next, self.state = [0.0], State.SEEKING
        elif self._sought_unmoved:
            self._end("since modes of the band are missing")
        else:
            self._sought_unmoved = True
            solver.go_to(0.0)
            find_hidden(solver, self.judge, (0.0, ABOVE * self.settings.band[1]), None, self._is_over)
            self._next.insert(0, f)

    def _choose_next(self, again) -> bool:
        """Choose points, if none waits that is to come first; `again`: for a second proof, in the lower half of the
        band. Returns whether there is a place for that."""
        comm, band, proving = self.run.model.comm, self.settings.band, self.state is State.PROVING
        low, high = band
        taken = [point.frequency for point in self._points]
        first_proof = low + PROOF * (high - low)
        if again:
            second = decided_with(comm, self.judge.next_points, taken, self._groups, (low, (low + high) / 2))
            self._next = second[:1] + self._next
            return bool(second)
        if proving and not self.expansion.is_at_end and high not in self._next:
            self._next.insert(0, high)
        elif proving and not self._next and self._may_prove_nearby() and apart([first_proof], taken, band):
            self._next = [rounded(first_proof, band)]
        elif not self._next:
            self._next = decided_with(comm, self.judge.next_points, taken, self._groups)
        return True

    def _limit_met(self) -> str:
        """Return the limit that ends the search, in words, or ""."""
        settings = self.settings
        own = sum(self._solver.multigrid or point.factor_of is None for point in self._points)
        if own >= settings.factorisations:
            return f"after {settings.factorisations} factorisations"
        if len(self._points) >= 2 * settings.factorisations:
            return f"after {len(self._points)} points"
        return self._columns_or_time_met()

    def _columns_or_time_met(self) -> str:
        """Return the limit of columns or time that is met, in words, or ""."""
        settings = self.settings
        if self.projections.basis.size >= settings.columns:
            return f"with {settings.columns} columns"
        elapsed = self.run.progress.elapsed()
        if settings.seconds is not None and decided(self.run.model.comm, lambda: elapsed > settings.seconds):
            return f"after {settings.seconds:g} s"
        return ""

    def _is_over(self) -> bool:
        """Test whether no more columns may join the basis."""
        stop_if_asked(self.run.model.comm, f"point {len(self._points)}")
        return bool(self._columns_or_time_met())

    def _is_proven_twice(self):
        low, high = self.settings.band
        return len(self.proofs) > 1 and any(proof.frequency <= (low + high) / 2 for proof in self.proofs)

    # points

    def _take(self, points) -> Judgement:
        """Add the blocks of points (Hz) to the basis; returns what was judged last."""
        if self._groups > 1:
            judged, fine = take_round(self.expansion, self._groups, points)
            if fine is not None:  # of a candidate that the last point of the round has measured
                self.state = State.PROVING if fine else State.SEEKING
        else:
            proving = self.state is State.PROVING
            judged = self.expansion.at(points[0], proving, self._point_of_factor(points[0]))
        self.missing_modes = decided(self.run.model.comm, self.expansion.missing_modes)
        if self._points[-1].frequency or not self._solver.multigrid:  # whose models are all exact at 0 Hz
            self.proofs += judged.proofs
        self._check_motions()
        return judged

    def _check_motions(self):
        check_motions(self.projections, self._points[-1].frequency or self.settings.band[1])

    def _may_prove_nearby(self):
        """Test whether the factor of the last point may serve the next one: where it is known that no mode is missing.
        """
        solver = self._solver
        return self.expansion.is_counted and self.expansion.by_mass and self._groups == 1 and not solver.failed_nearby

    def _point_of_factor(self, f) -> float | None:
        """Return the point whose factor serves a point f that is to prove the candidate, where it may, else None."""
        known = self.state is State.PROVING and self._may_prove_nearby() and self.missing_modes <= 0
        if not known or f >= max((point.frequency for point in self._points), default=0.0):
            return None
        last = self._points[-1]
        return last.frequency if last.factor_of is None else last.factor_of

    # modes that no load moves, or no mass

    def _seeks_hidden(self, fine, proven) -> tuple[bool, np.ndarray | None]:
        """Test whether modes are missing, or pseudo-modes may be none, and it is time to look for them: where the model
        is good else, or before the first proof, which then takes no factor. Also returns these pseudo-modes."""
        before_proof = fine and self.state is State.SEEKING and self._may_prove_nearby()
        if not (proven or before_proof):
            return False, None
        # multigrid's first point sees the lowest modes
        look = not self._solver.multigrid and (self._solver.is_smooth or not self._has_modes)
        doubtful = doubtful_modes(self.projections, self.settings.band) if look else None
        # where there are as many pseudo-modes as modes are counted, and each is one, more columns do not change that
        self._has_modes |= look and doubtful is None and self.missing_modes <= 0 and self.expansion.is_counted
        return self.missing_modes > 0 or doubtful is not None, doubtful

    def _find_hidden(self, doubtful) -> bool:
        """Add modes that no load moves, at first by `doubtful` pseudo-modes, until none is missing; whether the model
        stays what it was."""
        if self._solver.is_nearby:  # beside a basis that lacks modes below the point, the matrix is indefinite
            self._solver.go_to(self._solver.nearby)
        found, (low, high) = self.expansion.highest_count, self.settings.band
        below, lack_of = (high, None) if found is None else (found.below, self.expansion.missing_modes)
        if self._groups > 1:  # whose factors are gone; the end of the band may be an eigenfrequency
            self._solver.go_to(self._points[-1].frequency if found is None else below)
            self.run.notes.needs(str(self._solver.factored), "0.0", again=True)
        band = (low if any(count.below <= low for count in self.expansion.counts) else 0.0, below)
        self.missing_modes, change = find_hidden(self._solver, self.judge, band, lack_of, self._is_over, doubtful)
        self.expansion.account()
        return self.judge.is_fine(change)

    def _lacks_lower_count(self) -> bool:
        """Test whether the missing modes may lie below the band, where a point at its lower end would tell."""
        low = self.settings.band[0]
        uncounted = not self.expansion.few_below and all(point.frequency > low for point in self._points)
        return self.missing_modes > 0 and uncounted

    def _check_massless(self):
        """Refuse a basis that has lost solutions on dofs without mass; one that can hold nothing more is smoothed."""
        points = [point.frequency for point in self._points]
        try:
            lost = check_massless(self.projections, points)
        except InputError:
            self._solver.factor_own()
            if self._solver.extend_by_random() or not self._solver.smooth():
                raise
            lost = check_massless(self.projections, points)
        self.judge.note_loss(lost)
