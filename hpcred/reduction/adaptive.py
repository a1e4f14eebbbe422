"""The automatic reduction: a tolerance and a band enter; points, orders and size are chosen, and the error is proven.

One point carries a long chain of blocks. It lies at the end of the band, where the negative pivots of K - omega^2 M
count the modes below it. The error is seen from a basis that is some blocks richer: the difference of the two models,
r^T A_Q^-1 r, is exact in the richer one (see pseudo_modal). Each new point first checks the model that was made before
it, since its own blocks give the exact value there, and then extends the basis. Where the model is good and has all
modes of the band, that takes no factor: beside the basis the factor of the point above is close to the inverse, and
conjugate gradients come to a small true residual in a few steps (see linalg.iterative_solver). Last, the basis is
compressed to the few combinations that the tolerance asks for. (Panzer & Wolf, 2014; Bonin, Fassbender, Soppa & Zaeh,
2016; Lecomte et al., AIAA J. 41, 2003, for the count of modes.)

Without factors (see linalg.multigrid_solver) the first chain is at 0 Hz, until the basis has the modes of the band;
beside such a basis points in the band are solved for in the same way. With a given D, or many inputs, the blocks of a
point are made from residuals, and the first point lies in the middle of the band.
"""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np

from ..linalg.basis import Basis
from ..linalg.blocks import add_product, copy_of, create_block, random_block
from ..linalg.conjugate_gradients import NegativeCurvature, NotSolved
from ..linalg.factorisation import SingularMatrix
from ..linalg.free_motions import free_motions_refused
from ..linalg.multigrid_solver import not_definite
from ..model.rigid_body_modes import pushed_motions
from ..model.second_order_model import massless
from ..parallel.decisions import decided
from ..parallel.failures import ComputationError, InputError, Owned, agreed
from ..parallel.petsc import is_complex
from ..parallel.progress import counted
from ..parallel.stopping import stop_if_asked
from .accuracy import ROUND_OFF, Accuracy, Adaptive, Point, Proof, law_of
from .chain import Entry
from .compression import compressed
from .error_estimate import (
    UNIFORM,
    apart,
    estimate,
    finer,
    grid,
    is_free,
    is_silent,
    largest,
    missing,
    next_point,
    off_poles,
    resolved,
    unsettled,
)
from .groups import Group, bring
from .krylov import PencilChain
from .point_blocks import Part, PointBlocks
from .ports import loads_and_ports
from .projections import Projections
from .pseudo_modal import difference, nested, relative, response, restricted, worst_pair
from .residual_blocks import largest_residual, residual_block
from .run import Run

MARGIN = 0.1  # of the tolerance that the big basis is made for; the rest is for the compression
BLOCK = 16  # columns of a block that is made from residuals
HELD_BACK = 3  # columns at least that the estimate sees the model from
CHAIN = 128  # columns of a point at most, and
AHEAD = 32  # as many more when the estimate promises to arrive with them
KEPT = 1e-13  # deflation tolerance: what round-off brings is compressed away at the end
KEPT_WITHOUT_MASS = 1e-7  # the same with dofs without mass: round-off there grows by its inverse, and is stiff
HIDDEN = 60  # random columns at most, to find modes that no load moves
UNPROVEN = "exact values above 0 Hz need a factor, or a basis with all modes below, and there was neither"
ENDED = "the search ended before a second point"
HAS_MODES = 0.1  # estimated error below which a basis made at 0 Hz is taken to have the modes of the band
PROOF = 1 / 8  # of the band: where models are proven first, whatever the law and the tolerance, so that a store serves
ZERO = np.finfo(float).eps  # squares of frequencies, relative to the largest, that are round-off, and
NEARLY_ZERO = 1e-12  # that may be, where round-off shows in the estimate too
POLE_GAP = 1e-3  # how far a point is moved that lies on an eigenfrequency
BETWEEN = (0.31, 0.77)  # of the band: where a basis that can hold nothing more is tried, which are no points
COMPLETE = 1e-6  # residual of such a basis, relative to the loads, that is round-off


def deflation_of_search(model) -> float:
    """The deflation tolerance of a search on a model. Collective."""
    return KEPT_WITHOUT_MASS if massless(model) else KEPT


class SearchChain(PencilChain):
    """The chain of a point of a search: of the inputs and outputs together."""

    rule = "pencil of inputs and outputs"

    def _factor(self):
        return self.run.factored(self._square, self._name, may_give_up=False)


class Search:
    """The state of one automatic reduction; see search(). Its methods are collective, and what depends on small arrays
    is decided once for all ranks. Call close()."""

    def __init__(self, basis: Basis, run: Run, adaptive: Adaptive, groups: int = 1):
        self.basis, self.run, self.settings = basis, run, adaptive
        self.law, self.damped, self.measured = law_of(run.framed.damping, adaptive.zeta0, adaptive.band)
        self.loads, self.ports = loads_and_ports(run)
        if self._moves_freely():
            self.close()
            raise self._infinite()
        self.projections = Projections(run, basis, self.loads, self.law, self.damped)
        self.goal = MARGIN * adaptive.tolerance
        self.points: list[Point] = []
        self.proofs: list[Proof] = []
        self.starts: list[int] = []  # first columns of the blocks
        # columns (how many, or which) of the model that the next point checks, and of the one that it was seen from
        self.before: tuple | None = None
        self.noise, self.lack, self.closing = 0.0, 0, False
        self.rest = np.inf  # the estimated error of the basis without its newest columns, over the band
        self._static = run.multigrid  # solves at 0 Hz, and elsewhere beside a basis that has the modes below,
        self._enough = HAS_MODES  # which it has once the estimate is as small as this
        # an LU of an unsymmetric model and a complex one have no signs of pivots
        self._counts = not is_complex() and run.model.symmetric and not self._static
        if not self._counts:
            self.measured += "; modes cannot be counted here, a second proof stands for that"
        low, high = adaptive.band
        inputs = self.loads.getActiveColumns()[1]
        self._by_mass = not self.damped and inputs <= BLOCK
        first = high if self._by_mass else float(np.sqrt((low**2 + high**2) / 2))
        self.waiting = [*adaptive.points] or [first]  # points to take before searching
        self._width = min(4 * inputs if self.damped else inputs, BLOCK)
        self._random = 0
        self._mass = 0.0  # -omega^2 of the point that solves are for
        # the point (Hz) whose factor they take, None where it is the same
        self._near_at: float | None = 0.0 if self._static else None
        self._proves_by_factor = False  # since conjugate gradients did not come to an end
        self._made: int | None = None  # factors before the point that is under way
        # blocks made from residuals need the whole basis, which a group does not have
        self.groups = groups if self._by_mass and not self._static else 1
        if self._static:
            if any(adaptive.points):
                raise InputError(f"adaptive.points: found {list(adaptive.points)}; {not_definite('points above 0 Hz')}")
            self.waiting = [0.0]
        elif self.groups > 1 and not adaptive.points:
            self.waiting = [low + (i + 0.5) * (high - low) / (self.groups - 1) for i in range(self.groups - 1)] + [high]

    def close(self):
        self.loads.destroy()

    def _moves_freely(self) -> bool:
        """Whether outputs see free rigid motions that inputs push, in a band that begins at 0 Hz.

        Of a model without nodes only pseudo-modes show it.
        """
        model, band = self.run.model, self.settings.band
        if band[0] or self.run.rigid is not None or model.dofs is None:
            return False
        pushed = pushed_motions(model, self.loads)
        of_inputs, of_outputs = (pushed @ part for part in self.ports)
        return bool(np.abs(of_outputs.T @ of_inputs).max(initial=0.0) > 0)

    def _infinite(self):
        return InputError(
            f"{self.run.model.name}: the response at 0 Hz is infinite, for the body is free; take frame 'buckens', "
            "hold the body, or give a band that begins above 0"
        )

    # the loop

    def search(self) -> str:
        """Extend the basis until the tolerance is proven; returns why it ended, "" if it is reached. Collective."""
        low, high = band = self.settings.band
        first_proof = low + PROOF * (high - low)
        while True:
            if not self.waiting:
                return "since no place for another point is left"
            if self.groups > 1:
                points, self.waiting = self.waiting[: self.groups], self.waiting[self.groups :]
                found = self._expand_in_groups(points)
            else:
                f = self.waiting.pop(0)
                try:
                    found = self._expand(f, self.closing)
                except NotSolved as error:  # the basis may lack a mode below the point
                    if self._mass == self._factored or not self._goes_on_without(error):
                        raise
                    if not self._static:
                        self._proves_by_factor = True
                        self.waiting.insert(0, f)
                        continue
                    if self._enough < self.goal:
                        return "since modes of the band are missing"
                    self._enough /= 100
                    self.waiting, self.closing = [0.0], False
                    continue
            self._check_free_motions()
            fine = found["est"] <= 3 * self._floor()
            good = self.closing and fine and found["exact"] <= 3 * self._floor()
            # also before the first proof, which then takes no factor
            at_end = max(point.frequency for point in self.points) >= 0.9 * high
            hidden = self.lack > 0 and (good or (fine and at_end and not self.closing and self._may_prove_nearby()))
            if hidden:
                good = self._find_hidden() and good
                self._check_free_motions()
            taken = [point.frequency for point in self.points]
            below = any(proof.frequency <= (low + high) / 2 for proof in self.proofs)
            again = good and not self._counts and not (below and len(self.proofs) > 1)
            if good and not again:
                self._check_massless()
                return ""
            self.closing = bool(found["est"] <= 3 * self._floor())
            self.before = found["hold"], self.basis.size
            if reason := self._exhausted():
                return reason
            if again:
                second = decided(self.run.model.comm, self._next, taken, (low, (low + high) / 2))
                if not second:
                    self._check_massless()
                    return ""
                self.waiting = second[:1] + self.waiting
            elif self.closing and max(taken) < 0.9 * high:
                self.waiting.insert(0, high)
            elif self.closing and not self.waiting and self._may_prove_nearby() and apart([first_proof], taken, band):
                self.waiting = [_rounded(first_proof)]
            elif not self.waiting:
                self.waiting = decided(self.run.model.comm, self._next, taken)
            if hidden:  # the next point checks the model that has these modes
                self.before = self._hold(), self.basis.size
            stop_if_asked(self.run.model.comm, f"point {len(self.points)}")

    def _check_free_motions(self):
        """Refuse a free body that has more free motions than its own, where a pseudo-mode is near 0 Hz."""
        run, point = self.run, self.points[-1].frequency
        if run.rigid is not None:
            lowest = decided(run.model.comm, lambda: float(self.projections.model().frequencies[0]))
            run.check_free_motions(lowest, point or self.settings.band[1])

    def _counted(self) -> list[tuple[float, int]]:
        """The points whose factor has told how many modes lie below them, with these numbers."""
        return [(point.frequency, point.modes_below) for point in self.points if point.modes_below is not None]

    def _hold(self):
        """Where the newest blocks begin that are held back."""
        return next((start for start in reversed(self.starts) if self.basis.size - start >= HELD_BACK), 0)

    def _floor(self):
        """What can be asked for: the goal, or round-off."""
        return max(self.goal, self.noise)

    def _wanted(self, f):
        """What the blocks of a point are to reach."""
        return max(self._floor(), self._enough) if self._static and not f else self._floor()

    def _exhausted(self) -> str:
        settings = self.settings
        own = sum(self._static or point.factor_of is None for point in self.points)
        if own >= settings.factorisations:
            return f"after {settings.factorisations} factorisations"
        if len(self.points) >= 2 * settings.factorisations:
            return f"after {len(self.points)} points"
        if self.basis.size >= settings.columns:
            return f"with {settings.columns} columns"
        elapsed = self.run.progress.elapsed()
        if settings.seconds is not None and decided(self.run.model.comm, lambda: elapsed > settings.seconds):
            return f"after {settings.seconds:g} s"
        return ""

    def _next(self, taken, band=None):
        band = band or self.settings.band
        model = self.projections.model()
        inner_model = self.projections.model(self.before[0])
        S = grid([model], self.law, band)
        embedding = nested(inner_model, model, _places(self.before[0]))
        curve, _ = estimate(inner_model, model, embedding, self.law, S, self.ports)
        chosen = []
        for _ in range(self.groups):
            f = next_point(S, curve, [*taken, *chosen], model, band)
            chosen += [_rounded(f)] if f is not None else []
        return chosen

    # one point

    def _expand(self, f, closing):
        """Add blocks of a point until the estimate over the band is small. Returns what was judged last."""
        run, before = self.run, self.basis.size
        self._made = len(run.factorisations) if self._made is None else self._made
        run.progress.step("points", len(self.points))
        if not self._static:
            known = closing and self._may_prove_nearby() and self.lack <= 0
            self._near_at = None
            if known and f < max(point.frequency for point in self.points):
                last = self.points[-1]
                self._near_at = last.frequency if last.factor_of is None else last.factor_of
        with Owned(run.model.comm) as owned:
            f, count = self._open(f)
            chain = None
            if self._by_mass and (self._near_at is None or not (f or self.points)):
                chain = owned.owns(SearchChain(run, self._mass, f"{f:.6g} Hz", None, self.loads, ("inputs", "outputs")))
            order, judged = self._extend_at(f, closing, chain)
            if chain is not None:
                chain.keep()
        records, self._made = run.factorisations[self._made :], None
        stored = not records and self._near_at is None
        run.needs(str(self._factored), "0.0")
        name = f"adaptive {f:.6g} Hz, {order + 1} blocks"
        run.note(name, self.basis.size - before, self.basis.size - before, from_store=stored)
        self.points.append(Point(
            frequency=f, columns=self.basis.size - before, modes_below=count, factors=len(records),
            factor_seconds=float(sum(record.factor_seconds for record in records)),
            estimate=_finite(judged["est"]), from_store=stored, factor_of=self._near_at,
        ))  # fmt: skip
        self.lack = decided(run.model.comm, lambda: missing(self.projections.model(), self._counted()))
        if self.before is not None and not (self._static and not f):  # all models are exact at 0 Hz then
            self.proofs.append(Proof(frequency=f, **{key: float(judged[key]) for key in ("said", "exact", "own")}))
        return judged

    def _extend_at(self, f, closing, chain):
        """Add blocks until the estimate is small: those of a chain, or made from residuals. Returns the order of the
        last one, and what was judged then."""
        run, progress = self.run, self.run.progress
        before, history, order = self.basis.size, [], -1
        while True:
            order += 1
            start = self.basis.size
            if chain is not None:
                vectors, block = chain.vectors, chain.advance()
                new = self.projections.extend(vectors.columns_between(*block), vectors.images_between(*block))
            elif start and (order or self.before is not None) and (
                order or not self._by_mass or (self._static and not f)
            ):
                new = self._extend_by_solution(self._history(), lambda: self._residual_block(f))
            else:
                new = self._extend_by_solution({}, lambda: copy_of(self.loads, run.model.K))
            if not new:  # the loads and their chain are exhausted: what do random columns reveal?
                new = self._extend_by_random()
            if new:
                self.starts.append(start)
            else:
                self._check_complete()
            limit = CHAIN + 2 * self.loads.getActiveColumns()[1] if not self._static else self.settings.columns
            added = self.basis.size - before
            with progress.stage("estimate"):
                judged = decided(run.model.comm, self._judge, f, order, new, added, limit, closing, history)
            history = judged.pop("history")
            self.noise, self.rest = judged["noise"], judged["est"]
            progress.say(
                f"{f:.6g} Hz, block {order}: {self.basis.size} columns"
                + (f", estimated error {judged['est']:.1e}" if np.isfinite(judged["est"]) else "")
            )
            if judged["stop"]:
                return order, judged

    def _open(self, f):
        """Begin a point, off the poles; its place and the modes below it. It is factored here unless the store knows
        that it can be and how many those are, else when a solve needs it."""
        run = self.run
        if self.basis.size:
            moved = decided(run.model.comm, lambda: off_poles(f, self.projections.model(), self.settings.band))
            f = f if moved in (None, f) else _rounded(moved)
        if self._near_at:
            self._mass = _mass_at(f)
            return float(f), None
        for trial in (f, f * (1 + POLE_GAP), f * (1 - POLE_GAP), f * (1 + 3 * POLE_GAP)):
            self._mass = _mass_at(trial)
            key = {"kind": "count", "square": self._mass, **run.identity_of("M", "K")}
            known = run.stored(key)
            pivots = None if known is None else known.facts["negative_pivots"]
            if known is None or (self._counts and pivots is None):
                try:
                    self._factor()
                except SingularMatrix as error:
                    if self._static:
                        raise InputError(
                            f"K of {run.model.name} is singular, so the body can move freely; take frame kind "
                            "'buckens' (inertia relief), 'chord' or 'tangent'"
                        ) from error
                    continue
                pivots = run.solver.negative_pivots if self._counts else None
                run.keep(key, Entry({"negative_pivots": pivots}))
            count = None
            if self._counts:
                count = pivots - (run.rigid.count if run.rigid is not None and trial else 0)
            return float(trial), count
        raise ComputationError(f"no point near {f:g} Hz could be factored: is it among many eigenfrequencies?")

    def _factor(self):
        """The solver with the factor of K - omega^2 M at the point, or at the one near it."""
        mass = self._factored
        # another search begins by multigrid where a factor does not fit
        return self.run.factored(mass, f"{(-mass) ** 0.5 / (2 * np.pi):.6g} Hz", may_give_up=self._static)

    @property
    def _factored(self):
        """-omega^2 of the factor that solves take."""
        return self._mass if self._near_at is None else _mass_at(self._near_at)

    def _may_prove_nearby(self):
        """Whether the factor of the last point may serve the next one: where it is known that no mode is missing."""
        return self._counts and self._by_mass and self.groups == 1 and not self._proves_by_factor

    def _goes_on_without(self, error):
        """Whether the search goes on where a solve nearby failed: by a factor of its own, or with blocks at 0 Hz."""
        return not self._static or isinstance(error, NegativeCurvature)

    def _extend_by_solution(self, rule, make_load) -> int:
        """Add A^-1 times a load, at the point; returns how many columns are new. `rule`: what tells the load in the key
        of the store from others at the point; `make_load` gives a block that is destroyed here."""
        run = self.run
        nearby = self._mass != self._factored
        key = {"kind": "solution", "square": self._mass, **rule, **run.identity_of("M", "K", "inputs", "outputs")}
        if nearby:  # whose residuals are not those of a factor
            key["nearby"] = True
        failed = key | {"failed": True} | self._history()  # for it is the basis that makes a solve nearby fail
        with Owned(run.model.comm) as owned:
            entry = run.stored(key)
            if entry is None and nearby and run.stored(failed) is not None:
                raise NegativeCurvature("as in an earlier run")
            if entry is not None:
                block = owned.owns(entry).block
            else:
                solver, load = self._factor(), owned.owns(make_load())
                block = owned.owns(create_block(run.model.K, load.getActiveColumns()[1]))
                with run.progress.stage("solve"):
                    if nearby:
                        try:
                            solver.solve_below(self._mass, load, block, self.basis.columns, self.projections.K)
                        except NotSolved as error:
                            if self._goes_on_without(error):
                                run.keep(failed, Entry({}))
                            raise
                    else:
                        solver.solve(load, block)
                run.keep(key, Entry({}, (block.getActiveColumns()[1],), block))
            return self.projections.extend(block)

    def _history(self) -> dict:
        """What a load depends on that is made from the basis."""
        points = [[point.frequency, point.columns] for point in self.points]
        return {"asked": asdict(self.settings), "points": points, "size": self.basis.size,
                **self.run.identity_of("D", "damping", "basis")}  # fmt: skip

    def _extend_by_random(self) -> int:
        run = self.run
        self._random += 1
        with Owned(run.model.comm) as owned:
            x = owned.owns(random_block(run.model.K, 2, seed=self._random))
            return self._extend_by_solution({"random": self._random}, lambda: run.times_mass(x))

    def _check_complete(self):
        """Refuse a basis that can hold nothing more, since M has no higher rank, and lacks part of the responses."""
        run, (low, high) = self.run, self.settings.band
        if self.basis.size >= run.model.size - run.framed.rigid_size:
            return
        places = [low + part * (high - low) for part in BETWEEN]
        if largest_residual(self.projections, run, self.ports, places) > COMPLETE:
            raise self._lost_without_mass()

    def _check_massless(self):
        """Refuse a basis that has lost solutions of its points to round-off on dofs without mass, which it is not
        orthonormal on."""
        run = self.run
        if not massless(run.model):
            return
        points = [point.frequency for point in self.points]
        if largest_residual(self.projections, run, self.ports, points, damped=False) > COMPLETE:
            raise self._lost_without_mass()

    def _lost_without_mass(self):
        return InputError(
            f"{self.run.model.name}: M is singular, and a basis of {self.basis.size} mass-orthonormal columns has lost "
            "the static deflection of dofs without mass, by forces on them or by round-off; give them a little mass, "
            "take them out by static condensation, or ask for a lower band"
        )

    def _judge(self, f, order, new, added, limit, closing, history):
        """What the basis is worth after a block, and whether the point is done; on one rank."""
        history = list(history)
        outer = self.projections.model()
        m = len(outer.squares)
        hold = self._hold()
        result = {"est": np.inf, "noise": self.noise, "own": np.inf, "exact": np.inf, "said": np.inf, "hold": hold,
                  "history": history, "stop": False}  # fmt: skip
        if hold == 0 and new:
            return result
        if not new:  # nothing new at all: the basis is complete
            result["hold"] = hold = m
        inner_model = self.projections.model(hold)
        U = nested(inner_model, outer)
        band, law, ports = self.settings.band, self.law, self.ports
        if order >= 1:
            S = grid([outer], law, band, UNIFORM // 4, [0.0])
            rough = estimate(inner_model, outer, U, law, S, ports)[0].max()
            if rough > 10 * self._wanted(f) and added + new <= limit and new and m < self.settings.columns:
                history.append(rough)
                return result | {"est": rough}
        S = grid([outer], law, band)
        curve, noise = estimate(inner_model, outer, U, law, S, ports)
        est, noise = float(curve.max()), float(noise.max())
        zero = NEARLY_ZERO if noise > est else ZERO
        if S[0] == 0 and is_free(outer, law, S, ports, zero):
            if self.run.rigid is not None:
                raise free_motions_refused(self.run.model, self.run.rigid)
            raise self._infinite()
        if noise > est and is_silent(outer, law, S, ports):
            raise InputError(f"{self.run.model.name}: no output measures what the inputs move; the response is zero")
        goal = max(self.goal, noise)
        result |= {"est": est, "noise": noise}
        if self._static and not f:
            goal = max(goal, self._enough)
        if self.before is not None:
            result |= self._check(f, inner_model, _places(hold), outer)
        history.append(est)
        if order < 1 and new and not (closing and new >= HELD_BACK):
            return result
        done = est <= goal and (
            not closing or result["own"] <= max(result["exact"] / 10, self.goal / 100, noise)
        )
        ahead = _columns_ahead(history, goal, new)
        promising = ahead <= AHEAD
        full = added + (0 if promising else new) > limit + (AHEAD if promising else 0) or m >= self.settings.columns
        return result | {"stop": bool(not new or done or full)}

    def _check(self, f, inner_model, hold, outer):
        """The model of before at a new point: what was said of it, the exact error, the rest of what is called so.

        `inner_model`: of the places `hold` of the columns of `outer`.
        """
        at, law, ports = np.array([f]), self.law, self.ports
        old, seen_from = (self.projections.model(columns) for columns in self.before)
        which, among = (_places(columns) for columns in self.before)

        def error(one, other, columns):
            E = difference(one, other, nested(one, other, columns), law, at, ports)
            return relative(E, response(other, law, at, ports))[0]

        return {"exact": error(old, outer, which), "said": error(old, seen_from, np.searchsorted(among, which)),
                "own": error(inner_model, outer, hold)}  # fmt: skip

    # several points at once

    def _expand_in_groups(self, points):
        """Have each group of ranks factor a point and make its chain; returns what was judged of all of them.

        A group judges its chain over its part of the band. The estimate holds back the last block of every group. The
        last point of the first round proves the model of the others.
        """
        run, comm = self.run, self.run.model.comm
        width = (self.settings.band[1] - self.settings.band[0]) / len(points)
        with Owned(comm) as owned:
            group = owned.owns(Group(run.framed, self.groups))
            own = owned.owns(run.on_group(group.framed))
            made = None
            with agreed(comm), Owned(group.comm):
                if group.number < len(points):
                    made = self._chain(own, points[group.number], width)
            arrived, facts = [], comm.allgather(made[1] if made and group.leads else None)
            for number in range(len(points)):
                mine = made[0] if made and group.number == number else None
                with run.progress.stage("merge"):
                    arrived.append(bring(run.model, group, mine))
            for told in comm.allgather(own.told() if group.leads else None):
                if told is not None:
                    run.add(*told[:2], [], *told[3:])
        found = [item for item in facts if item is not None]
        first, lasts = self.basis.size, set()
        proves = self.before is None and len(points) > 1
        # the model that is to be proven must be all of the others', so that the proving group comes after them
        for some in (arrived[:-1], arrived[-1:]) if proves else (arrived,):
            seen = self.basis.size
            for chosen in (slice(-1), slice(-1, None)):
                for blocks in some:
                    for part in blocks.parts[chosen]:
                        self.starts.append(self.basis.size)
                        self.projections.extend(blocks.between(part.start, part.stop))
                        if chosen.start == -1:
                            lasts.update(range(self.starts[-1], self.basis.size))
        for blocks in arrived:
            blocks.close()
        hold = [k for k in range(self.basis.size) if k not in lasts]
        if proves:
            self.before = [k for k in hold if k < seen], seen
            self.closing = bool(decided(comm, self._estimate_between, *self.before) <= 3 * self._floor())
        points = [point.frequency for point in found]  # some may have been moved off an eigenfrequency
        self.points += found
        judged = decided(comm, self._judge_round, points[-1:] if proves else points, hold)
        self.noise, self.rest = judged["noise"], judged["est"]
        self.lack = decided(comm, lambda: missing(self.projections.model(), self._counted()))
        self.points[-1] = replace(self.points[-1], estimate=judged["est"])
        self.proofs += judged.pop("proofs")
        where = ", ".join(f"{f:.6g}" for f in points)
        run.note(f"adaptive {where} Hz", sum(point.columns for point in found), self.basis.size - first)
        run.progress.say(f"{self.basis.size} columns, estimated error {judged['est']:.1e}")
        return judged

    def _chain(self, run, f, width):
        """The blocks of a point on the ranks of a group, and what is known of the point."""
        low, high = self.settings.band
        part = max(low, f - width), min(high, f + width)
        rigid = run.rigid.R if run.rigid is not None else None
        vectors = Basis(run.mass, rigid, run.tolerance, room=CHAIN, keeps=run.keeps_images)
        with Owned(run.model.comm) as owned:
            search = owned.owns(Search(vectors, run, replace(self.settings, band=part, points=(f,))))
            search._expand(f, False)
        blocks = PointBlocks(vectors)
        for start, stop in zip(search.starts, [*search.starts[1:], vectors.size], strict=True):
            blocks.parts.append(Part(f"{f:.6g} Hz", stop - start, start, stop))
        return blocks, replace(search.points[0], estimate=None)

    def _estimate_between(self, inner_columns, outer_columns) -> float:
        one, other = self.projections.model(inner_columns), self.projections.model(outer_columns)
        embedding = nested(one, other, np.searchsorted(_places(outer_columns), _places(inner_columns)))
        S = grid([other], self.law, self.settings.band)
        return float(estimate(one, other, embedding, self.law, S, self.ports)[0].max())

    def _judge_round(self, checked, hold):
        outer, inner_model = self.projections.model(), self.projections.model(hold)
        S = grid([outer], self.law, self.settings.band)
        curve, noise = estimate(inner_model, outer, nested(inner_model, outer, hold), self.law, S, self.ports)
        proofs = []
        for f in checked if self.before is not None else ():  # a first round of one point proves nothing
            found = self._check(f, inner_model, hold, outer)
            proofs.append(Proof(frequency=f, **{key: float(value) for key, value in found.items()}))
        return {"est": float(curve.max()), "noise": float(noise.max()), "hold": hold, "proofs": proofs,
                "exact": max((proof.exact for proof in proofs), default=np.inf)}  # fmt: skip

    # modes that no load moves

    def _find_hidden(self) -> bool:
        """Add random columns and A^-1 M x of pseudo-modes x that still move until no mode is missing; whether the model
        stays what it was. Collective."""
        run, size, used, made = self.run, self.basis.size, 0, len(self.run.factorisations)
        top = max(f for f, _ in self._counted())
        moving = None
        if self.groups > 1:  # whose factors are gone
            self._mass = _mass_at(top)
            run.needed.append((str(self._mass), "0.0"))
        while used < HIDDEN:
            before = self.basis.size
            if moving is None:
                used += self._extend_by_random()
            else:
                with Owned(run.model.comm) as owned:
                    x = owned.owns(create_block(run.model.K, moving.shape[1]))
                    add_product(x, self.basis.columns, moving, beta=0.0)
                    used += self._extend_by_solution(self._history(), lambda x=x: run.times_mass(x))
            if self.basis.size == before:
                self._check_complete()
                break
            self.starts.append(before)
            moving, lack = decided(run.model.comm, self._moving, before, top)
            if moving is None and lack <= 0:
                break
        self.lack, change = decided(run.model.comm, self._change, size)
        run.note("modes that no load moves", used, self.basis.size - size)
        if count := len(run.factorisations) - made:
            last, seconds = self.points[-1], sum(item.factor_seconds for item in run.factorisations[made:])
            self.points[-1] = replace(last, from_store=False, factors=(last.factors or 0) + count,
                                      factor_seconds=last.factor_seconds + float(seconds))  # fmt: skip
        return change <= 3 * self._floor()

    def _moving(self, before, top):
        model, old = self.projections.model(), self.projections.model(before)
        which = unsettled(model, old, top)
        return model.vectors[:, which] if len(which) else None, missing(model, self._counted())

    def _change(self, size):
        model, old = self.projections.model(), self.projections.model(size)
        S = grid([model], self.law, self.settings.band)
        E = difference(old, model, nested(old, model), self.law, S, self.ports)
        return missing(model, self._counted()), float(relative(E, response(model, self.law, S, self.ports)).max())

    def _residual_block(self, f):
        with self.run.progress.stage("residuals"):
            return residual_block(self.projections, self.run, self.ports, self.settings.band, f, self._width)

    # the end

    def doubts(self, reason) -> dict:
        """What of an Accuracy says that there were no factors, and that no exact value stands behind the estimate of a
        search that ended for a reason."""
        unproven = ""
        if not self.proofs:
            unproven = UNPROVEN if self._static else ENDED if reason else ""
        if reason and self.lack > 0:
            unproven = "; ".join(filter(None, [unproven, f"{counted(self.lack, 'mode')} of the band not found"]))
        return {"multigrid": self._static, "unproven": unproven}

    def compress(self, reason, drop_above=None, kept=range(0)) -> tuple[np.ndarray, Accuracy]:
        """The columns U (m, k) of the basis that the tolerance asks for, and what is known of them. Collective.

        The columns `kept` of the basis stay in the span of U. Pseudo-modes above `drop_above` (Hz) are left out, and
        what that does to the error counts.
        """
        with self.run.progress.stage("compress"):
            return decided(self.run.model.comm, self._compress, reason, drop_above, list(kept))

    def _compress(self, reason, drop_above, kept):
        settings, law, ports, band = self.settings, self.law, self.ports, self.settings.band
        outer = self.projections.model()
        fixed = outer.vectors[kept].T
        S = grid([outer], law, band)
        est, noise = self.rest, self.noise
        eps = settings.tolerance
        goal = max(0.9 * eps - est - noise, 0.3 * eps, noise) if not reason else max(0.9 * eps, min(0.5 * est, 1.0))
        for trial in range(6):
            U = compressed(outer, law, S, ports, goal, fixed) if trial < 5 else np.eye(len(outer.squares))
            if settings.size is not None and U.shape[1] > settings.size:
                reason = reason or f"with {settings.size} coordinates"
                U = compressed(outer, law, S, ports, 0.0, fixed, most=settings.size)
            inner_model, embedding = restricted(outer, U, law)
            fine = finer(grid([outer, inner_model], law, band), 4)
            fine, curve = largest(inner_model, outer, embedding, law, fine, ports)
            if curve.max() <= 1.02 * goal:
                fine, curve = resolved(inner_model, outer, embedding, law, fine, curve, ports, 3 * noise)
            if curve.max() <= 1.02 * goal or settings.size == U.shape[1]:
                break
            S = np.unique(np.concatenate([S, fine[curve > 0.8 * goal]]))
        if drop_above is not None and inner_model.frequencies[-1] > drop_above:
            kept = inner_model.frequencies <= drop_above
            if not kept.any():
                raise InputError(f"drop_above: no pseudo-frequency lies below {drop_above:g} Hz")
            inner_model, turn = restricted(inner_model, np.eye(len(kept))[:, kept], law)
            embedding = embedding @ turn
            fine, curve = largest(inner_model, outer, embedding, law, fine, ports)
            if not reason and curve.max() + est + noise > eps:
                reason = f"without the pseudo-frequencies above {drop_above:g} Hz (drop_above)"
        H = response(outer, law, fine, ports)
        E = difference(inner_model, outer, embedding, law, fine, ports)
        roundoff = H - response(inner_model, law, fine, ports) - E
        i, j, own = worst_pair(H, H - E)
        noise = max(noise, float(relative(roundoff, H).max()))
        claim = float(curve.max()) + (est if reason else min(est, 3 * self._floor()))
        reached = not reason and claim + noise <= eps
        if not reason and not reached:
            reason = ROUND_OFF
        return outer.vectors @ embedding, Accuracy(
            tolerance=eps, band=band, reached=reached, stopped=reason or "reached", largest=claim,
            worst=float(fine[curve.argmax()]), noise=noise, measured=self.measured, big_size=len(outer.squares),
            mean=float(((curve[1:] + curve[:-1]) / 2 * np.diff(fine)).sum() / (band[1] - band[0])),
            highest=float(inner_model.frequencies.max()), missing_modes=max(self.lack, 0), points=tuple(self.points),
            worst_pair=(self.run.model.output_names[i], self.run.model.input_names[j], own),
            proofs=tuple(self.proofs), frequencies=tuple(fine.tolist()), eps=tuple(curve.tolist()),
            loss_factor=law.eta, **self.doubts(reason),
        )  # fmt: skip


def _mass_at(f):
    """-omega^2 of a point (Hz), without a negative zero."""
    return 0.0 - (2 * np.pi * f) ** 2


def _rounded(f):
    """A frequency that the search chose, to six digits: the same on any number of ranks, whose last digits differ."""
    return float(f"{f:.6g}")


def _finite(value):
    return float(value) if np.isfinite(value) else None


def _places(columns):
    """The first so many columns of a basis, or a list of them, as their places."""
    return np.arange(columns) if np.ndim(columns) == 0 else np.array(columns, dtype=int)


def _columns_ahead(history, goal, width):
    """Columns until the estimate is below the goal at the rate of the last block."""
    if len(history) < 2 or history[-1] >= history[-2] or history[-1] <= 0:
        return np.inf
    return width * max(0.0, np.log(history[-1] / goal) / np.log(history[-2] / history[-1]))
