"""The automatic reduction: a tolerance and a band enter; points, orders and size are chosen, and the error is proven.

One point carries a long chain of blocks. It lies at the end of the band, where the negative pivots of K - omega^2 M
count the modes below it. The error is seen from a basis that is some blocks richer: the difference of the two models,
r^T A_Q^-1 r, is exact in the richer one (see pseudo_modal). Each new point first checks the model that was made before
it, since its own blocks give the exact value there, and then extends the basis. Where the model is good and has all
modes of the band, that takes no factor: beside the basis the factor of the point above is close to the inverse, and
conjugate gradients come to a small true residual in a few steps (see linalg.solvers.iterative). Last, the basis is
compressed to the few combinations that the tolerance asks for. (Panzer & Wolf, 2014; Bonin, Fassbender, Soppa & Zaeh,
2016; Lecomte et al., AIAA J. 41, 2003, for the count of modes.)

Without factors (see linalg.solvers.multigrid) the first chain is at 0 Hz, until the basis has the modes of the band;
beside such a basis points in the band are solved for in the same way. With a given D, or many inputs, the blocks of a
point are made from residuals, and the first point lies in the middle of the band.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...linalg.basis import Basis
from ...linalg.conjugate_gradients import NotSolved
from ...linalg.solvers.multigrid import not_definite
from ...model.second_order_model import massless
from ...parallel.decisions import decided
from ...parallel.failures import InputError, Owned
from ...parallel.progress import counted
from ...parallel.stopping import stop_if_asked
from ..components.chains_in_groups import chains_in_groups, join_round
from ..components.point_blocks import Part, PointBlocks
from ..run import Run
from .accuracy import UNDAMPED, Accuracy, Adaptive, Direction, Point, Proof, directions_table, law_of
from .compression import compress
from .error_estimate import apart, grid, measure_of, missing, resonances, rounded
from .hidden_modes import find_hidden
from .judging import CHAIN, Blocks, Judge, Judgement
from .point_solver import NoRegularPoint, PointSolver
from .projections import Projections
from .pseudo_modal import Law, response
from .search_checks import check_massless, check_motions, check_support, extend_by_random, is_singular

BLOCK = 16  # columns of a block that is made from residuals
KEPT = 1e-13  # deflation tolerance: what round-off brings is compressed away at the end
KEPT_WITHOUT_MASS = 1e-7  # the same with dofs without mass: round-off there grows by its inverse, and is stiff
UNPROVEN = "exact values above 0 Hz need a factor, or a basis with all modes below, and there was neither"
ENDED = "the search ended before a second point"
HAS_MODES = 0.1  # estimated error below which a basis made at 0 Hz is taken to have the modes of the band
FEW_BELOW = 0.1  # of the upper end of a band: a lower end up to it leaves few modes below the band
HOPELESS = 300  # modes in the band, beyond which a search that may have fewer columns is not begun
ABOVE = 1.5  # of the band: modes that come down to it are followed from there, where they are not counted
MANY, LARGE_PART = 30, 0.2  # modes in the band, and of all modes: beyond both the band is doubted
AT_END = 0.9  # of the band: above it a point counts the modes of the band
MIXING = 1e-14  # round-off of K on the columns of a basis, relative to the highest square of a frequency
TOGETHER = 2**22  # errors of single responses that are held at a time
PROOF = 1 / 8  # of the band: where models are proven first, whatever the law and the tolerance, so that a store serves


def deflation_of_search(model) -> float:
    """The deflation tolerance of a search on a model. Collective."""
    return KEPT_WITHOUT_MASS if massless(model) else KEPT


class Search:
    """The state of one automatic reduction; see search(). Its methods are collective, and what depends on small arrays
    is decided once for all ranks. Raises InputError.

    `projections` of the basis, which grows; the `solver` of its points, and the `judge` of its models; `points` and
    `proofs` so far; how many modes are known to be missing (`lack`); `measured`: with which damping, in words.
    """

    def __init__(self, basis: Basis, run: Run, adaptive: Adaptive, groups: int = 1):
        self.run, self.settings = run, adaptive
        law, damped, self.measured = law_of(run.framed.damping, adaptive.zeta0, adaptive.band)
        check_support(run, adaptive.band)
        self.projections = Projections(run, basis, law, damped)
        self.points: list[Point] = []
        self.proofs: list[Proof] = []
        self.lack = 0
        self.judge = Judge(self.projections, adaptive)
        self.solver = PointSolver(self.projections, adaptive, self.points)
        if not self.solver.counts:
            self.measured += "; modes cannot be counted here, a second proof stands for that"
        inputs = self.projections.loads.getActiveColumns()[1]
        self._by_mass = not damped and inputs <= BLOCK  # else blocks are made from residuals
        self._width = min(4 * inputs if damped else inputs, BLOCK)
        # residuals need the whole basis, which a group does not have
        self._groups = groups if self._by_mass and not self.solver.multigrid else 1
        self._waiting = self._first_points()  # to take before searching
        self._closing = False  # whether the model is good, so that the next point proves it
        self._proves_by_factor = False  # since conjugate gradients did not come to an end
        self._sought = False  # whether modes that no load moves were looked for without a count
        self._made: int | None = None  # factors before the point that is under way
        if self.solver.multigrid:
            self.judge.enough = HAS_MODES  # or less, where a basis with that estimate lacked modes

    def _first_points(self):
        (low, high), asked = self.settings.band, self.settings.points
        if self.solver.multigrid:
            if any(asked):
                raise InputError(f"adaptive.points: found {list(asked)}; {not_definite('points above 0 Hz')}")
            return [0.0]
        if asked:
            return [*asked]
        if self._groups > 1:
            return [low + (i + 0.5) * (high - low) / (self._groups - 1) for i in range(self._groups - 1)] + [high]
        return [high if self._by_mass else float(np.sqrt((low**2 + high**2) / 2))]

    # the loop

    def search(self) -> str:
        """Extend the basis until the tolerance is proven; returns why it ended, "" if it is reached. Collective."""
        judge, high = self.judge, self.settings.band[1]
        while True:
            if not self._waiting:
                return "since no place for another point is left"
            points, self._waiting = self._waiting[: self._groups], self._waiting[self._groups :]
            try:
                found = self._expand_in_groups(points) if self._groups > 1 else self._expand(points[0])
            except NotSolved as error:
                if reason := self._go_on_without(error, points[0]):
                    return reason
                continue
            except NoRegularPoint as error:
                if not self.points:
                    raise
                return f"since {error}"
            check_motions(self.projections, self.points[-1].frequency or high)
            fine = judge.is_fine(found.estimate)
            good = self._closing and fine and judge.is_fine(found.exact)
            hidden = self._seeks_hidden(fine, good)
            if hidden:
                good = self._find_hidden() and good
                check_motions(self.projections, self.points[-1].frequency or high)
            again = good and not self.solver.counts and not self._is_proven_twice()
            if not good or again:
                self._closing = fine
                judge.before = found.hold, self.projections.basis.size
                if reason := self._exhausted():
                    return reason
                good = not self._choose_next(again)
            if good:
                self._check_massless()
                return ""
            if hidden:  # the next point checks the model that has these modes
                judge.before = self.projections.hold, self.projections.basis.size
            stop_if_asked(self.run.model.comm, f"point {len(self.points)}")

    def _go_on_without(self, error, f) -> str:
        """Go on where the basis may lack a mode below a point f that a solve failed at; returns why not, or ""."""
        if not self.solver.is_nearby or not self.solver.goes_on_without(error):
            raise error
        if not self.solver.multigrid:
            self._proves_by_factor = True
            self._waiting.insert(0, f)
        elif self.judge.enough >= self.judge.goal:
            self.judge.enough /= 100
            self._waiting, self._closing = [0.0], False
        elif self._sought:
            return "since modes of the band are missing"
        else:  # those that no load moves
            self._sought = True
            self.solver.go_to(0.0)
            find_hidden(self.solver, self.judge, [(ABOVE * self.settings.band[1], 0)])
            self._waiting.insert(0, f)
        return ""

    def _choose_next(self, again) -> bool:
        """Choose points, if none waits that is to come first; `again`: for a second proof, in the lower half of the
        band. Returns whether there is a place for that."""
        comm, band = self.run.model.comm, self.settings.band
        low, high = band
        taken = [point.frequency for point in self.points]
        first_proof = low + PROOF * (high - low)
        if again:
            second = decided(comm, self.judge.next_points, taken, self._groups, (low, (low + high) / 2))
            self._waiting = second[:1] + self._waiting
            return bool(second)
        if self._closing and max(taken) < AT_END * high:
            self._waiting.insert(0, high)
        elif self._closing and not self._waiting and self._may_prove_nearby() and apart([first_proof], taken, band):
            self._waiting = [rounded(first_proof, band)]
        elif not self._waiting:
            self._waiting = decided(comm, self.judge.next_points, taken, self._groups)
        return True

    def _exhausted(self) -> str:
        settings, size = self.settings, self.projections.basis.size
        own = sum(self.solver.multigrid or point.factor_of is None for point in self.points)
        if own >= settings.factorisations:
            return f"after {settings.factorisations} factorisations"
        if len(self.points) >= 2 * settings.factorisations:
            return f"after {len(self.points)} points"
        if size >= settings.columns:
            return f"with {settings.columns} columns"
        elapsed = self.run.progress.elapsed()
        if settings.seconds is not None and decided(self.run.model.comm, lambda: elapsed > settings.seconds):
            return f"after {settings.seconds:g} s"
        return ""

    def _is_proven_twice(self):
        low, high = self.settings.band
        return len(self.proofs) > 1 and any(proof.frequency <= (low + high) / 2 for proof in self.proofs)

    def _may_prove_nearby(self):
        """Whether the factor of the last point may serve the next one: where it is known that no mode is missing."""
        return self.solver.counts and self._by_mass and self._groups == 1 and not self._proves_by_factor

    def _counted(self) -> list[tuple[float, int]]:
        """The points whose factor has told how many modes lie below them, with these numbers."""
        return [(point.frequency, point.modes_below) for point in self.points if point.modes_below is not None]

    def _look_at_damping(self):
        """Measure with the loss factor of undamped models what a given D leaves without damping; decided once."""
        projections = self.projections
        if projections.D is None or projections.law.eta:
            return
        if decided(self.run.model.comm, self._has_undamped):
            projections.law = Law(eta=2 * self.settings.zeta0)
            self.measured += (
                f" and the loss factor {projections.law.eta:g}, since the damping matrix leaves modes of the band "
                "without damping"
            )

    def _has_undamped(self):
        low, high = self.settings.band
        f, ratio = resonances(self.projections.model(), self.projections.law)
        return bool((ratio[(f >= 0.9 * low) & (f <= 1.1 * high)] < UNDAMPED).any())

    def _note(self, judged):
        """Note what was judged last."""
        self.judge.rest, self.judge.noise = judged.estimate, judged.noise

    # one point

    def _expand(self, f) -> Judgement:
        """Add blocks of a point (Hz) until the estimate over the band is small. Returns what was judged last."""
        run, solver, before = self.run, self.solver, self.projections.basis.size
        self._made = len(run.factorisations) if self._made is None else self._made
        run.progress.step("points", len(self.points))
        if not solver.multigrid:
            solver.nearby = self._point_of_factor(f)
        with Owned(run.model.comm) as owned:
            f, count = solver.open(f)
            self._look_at_count(f, count)
            blocks, chain = Blocks(f, self._closing), None
            if self._by_mass and (solver.nearby is None or not (f or self.points)):
                chain = owned.owns(solver.chain(f))
            judged = self._extend_at(blocks, chain)
            if chain is not None:
                chain.keep()
        records, self._made = run.factorisations[self._made :], None
        stored, columns = not records and solver.nearby is None, self.projections.basis.size - before
        run.needs(str(solver.factored), "0.0")
        run.note(f"adaptive {f:.6g} Hz, {blocks.order + 1} blocks", columns, columns, from_store=stored)
        self.points.append(Point(
            frequency=f, columns=columns, modes_below=count, factors=len(records),
            factor_seconds=float(sum(record.factor_seconds for record in records)),
            estimate=judged.estimate if np.isfinite(judged.estimate) else None, from_store=stored,
            factor_of=solver.nearby,
        ))  # fmt: skip
        self.lack = decided(run.model.comm, lambda: missing(self.projections.model(), self._counted()))
        if f or not solver.multigrid:  # whose models are all exact at 0 Hz
            self.proofs += judged.proofs
        return judged

    def _look_at_count(self, f, count):
        """Doubt a band with a large part of all modes, and refuse one with more than the basis may have, once the first
        point has counted them."""
        low, high = self.settings.band
        if self.points or not count or low > FEW_BELOW * high or f < AT_END * high:
            return
        size, name = self.run.model.size, self.run.model.name
        if count > max(self.settings.columns, HOPELESS):
            raise InputError(
                f"band: {count} of the {size} modes of {name} lie below {f:g} Hz, by the inertia of K - omega^2 M, and "
                f"the basis of a search has at most {self.settings.columns} columns (adaptive.columns); is the band in "
                "Hz, and are M and K in the units of one system? Ask for a lower band"
            )
        if count > MANY and count > LARGE_PART * size:
            self.run.remark(
                f"band: {count} of the {size} modes of {name} lie below {f:g} Hz, by the inertia of K - omega^2 M, so "
                "that the reduced model cannot be small; no mesh follows so many of its modes"
            )

    def _point_of_factor(self, f) -> float | None:
        """The point whose factor serves a point f that is to prove the model, where it may, else None."""
        known = self._closing and self._may_prove_nearby() and self.lack <= 0
        if not known or f >= max(point.frequency for point in self.points):
            return None
        last = self.points[-1]
        return last.frequency if last.factor_of is None else last.factor_of

    def _extend_at(self, blocks, chain) -> Judgement:
        """Add blocks until the estimate is small: those of a chain, or made from residuals."""
        progress, smoothed = self.run.progress, False
        while True:
            new = self.solver.extend_by_loads() if smoothed else self._extend_by_block(blocks, chain)
            if not new:  # the loads and their chain are exhausted: what do random columns reveal?
                new = extend_by_random(self.solver, self.judge)
            blocks.take(new)
            with progress.stage("estimate"):
                self._look_at_damping()
                judged = self._judged(blocks)
            self._note(judged)
            known = ""
            if np.isfinite(judged.estimate):
                blocks.history.append(judged.estimate)
                known = f", estimated error {judged.estimate:.1e}"
            size = self.projections.basis.size
            progress.say(f"{blocks.frequency:.6g} Hz, block {blocks.order}: {size} columns{known}")
            if smoothed or (judged.done and not self._smooth(judged)):
                return judged
            smoothed = judged.done

    def _smooth(self, judged) -> bool:
        """Smooth a basis that round-off on dofs without mass keeps from the tolerance; whether loads are to follow."""
        noisy = judged.noise > self.settings.tolerance / 2 and is_singular(self.run) and not self.solver.is_smooth
        if not (noisy and self.solver.smooth()):
            return False
        self.judge.before = None  # the first columns are no longer the model that this point was to check
        return True

    def _check_massless(self):
        """Refuse a basis that has lost solutions on dofs without mass; one that can hold nothing more is smoothed."""
        points = [point.frequency for point in self.points]
        try:
            lost = check_massless(self.projections, points)
        except InputError:
            if not self.solver.multigrid:
                self.solver.nearby = None  # so that it factors a point of its own
            if self.solver.extend_by_random() or not self.solver.smooth():
                raise
            lost = check_massless(self.projections, points)
        self.judge.lost = max(self.judge.lost, lost)

    def _judged(self, blocks) -> Judgement:
        """What the basis is worth after a block of a point. Raises InputError."""
        try:
            return decided(self.run.model.comm, self.judge.judge, blocks)
        except InputError:  # a response without what moves no mass may be nothing
            if self.projections.basis.size:
                check_massless(self.projections, [blocks.frequency])
            raise

    def _extend_by_block(self, blocks, chain) -> int:
        """Add the next block of a point; returns how many columns are new."""
        f, projections, first = blocks.frequency, self.projections, blocks.order < 0
        if chain is not None:
            place = chain.advance()
            return projections.extend(chain.vectors.columns_between(*place), chain.vectors.images_between(*place))
        by_residuals = not first or (
            self.judge.before is not None and (not self._by_mass or (self.solver.multigrid and not f))
        )
        if projections.basis.size and by_residuals:
            return self.solver.extend_by_residuals(f, self._width)
        return self.solver.extend_by_loads()

    # several points at once

    def _expand_in_groups(self, points) -> Judgement:
        """Have each group of ranks factor a point and make its chain; returns what was judged of all of them.

        A group judges its chain over its part of the band. The estimate holds back the last block of every group. The
        last point of the first round proves the model of the others, and so is added after them.
        """
        run, judge, comm, first = self.run, self.judge, self.run.model.comm, self.projections.basis.size
        width = (self.settings.band[1] - self.settings.band[0]) / len(points)
        arrived, found = chains_in_groups(run, self._groups, points, lambda own, f: self._chain(own, f, width))
        proves = judge.before is None and len(points) > 1
        hold, seen = join_round(self.projections, arrived, proves)
        self._look_at_damping()
        if proves:
            judge.before = [k for k in hold if k < seen], seen
            self._closing = judge.is_fine(decided(comm, judge.between, *judge.before))
        points = [point.frequency for point in found]  # some may have been moved off an eigenfrequency
        judged = decided(comm, judge.judge_round, points[-1:] if proves else points, hold)
        self._note(judged)
        self.points += [*found[:-1], replace(found[-1], estimate=judged.estimate)]
        self.proofs += judged.proofs
        self.lack = decided(comm, lambda: missing(self.projections.model(), self._counted()))
        where, size = ", ".join(f"{f:.6g}" for f in points), self.projections.basis.size
        run.note(f"adaptive {where} Hz", sum(point.columns for point in found), size - first)
        run.progress.say(f"{size} columns, estimated error {judged.estimate:.1e}")
        return judged

    def _chain(self, run, f, width) -> tuple[PointBlocks, Point]:
        """The blocks of a point on the ranks of a group, and what is known of the point."""
        low, high = self.settings.band
        part = max(low, f - width), min(high, f + width)
        vectors = Basis(run.mass, run.framed.rigid_columns, run.tolerance, room=CHAIN, keeps=run.keeps_images)
        search = Search(vectors, run, replace(self.settings, band=part, points=(f,)))
        search._expand(f)
        parts = [Part(f"{f:.6g} Hz", stop - start, start, stop, False) for start, stop in search.projections.blocks]
        return PointBlocks(vectors, parts), replace(search.points[0], estimate=None)

    # modes that no load moves

    def _seeks_hidden(self, fine, good):
        """Whether modes are missing and it is time to look for them: where the model is good else, or before the first
        proof, which then takes no factor."""
        at_end = max(point.frequency for point in self.points) >= AT_END * self.settings.band[1]
        before_proof = fine and at_end and not self._closing and self._may_prove_nearby()
        return self.lack > 0 and (good or before_proof)

    def _find_hidden(self) -> bool:
        """Add modes that no load moves until none is missing; whether the model stays what it was."""
        run, of_modes, made = self.run, self._counted(), len(self.run.factorisations)
        if self._groups > 1:  # whose factors are gone
            self.solver.go_to(max(f for f, _ in of_modes))
            run.needed.append((str(self.solver.factored), "0.0"))
        self.lack, change = find_hidden(self.solver, self.judge, of_modes)
        if count := len(run.factorisations) - made:
            last, seconds = self.points[-1], sum(item.factor_seconds for item in run.factorisations[made:])
            self.points[-1] = replace(last, from_store=False, factors=(last.factors or 0) + count,
                                      factor_seconds=last.factor_seconds + float(seconds))  # fmt: skip
        return self.judge.is_fine(change)

    # the end

    def compress(self, reason, drop_above=None, kept=range(0), beside=0) -> tuple[np.ndarray, Accuracy]:
        """The columns U (m, k) of the basis that the tolerance asks for, and what is known of them. Collective.

        The columns `kept` of the basis stay in the span of U. Pseudo-modes above `drop_above` (Hz) are left out, and
        what that does to the error counts. `beside`: coordinates of rigid-body motion that come later.
        """
        kept = np.eye(self.projections.basis.size)[:, list(kept)]
        with self.run.progress.stage("project"):
            kept = self._project_again(kept)
        with self.run.progress.stage("compress"):
            return decided(self.run.model.comm, self._compress, reason, drop_above, kept, beside)

    def _project_again(self, kept) -> np.ndarray:
        """Project on the pseudo-modes of the basis where round-off of K on stiff columns may have mixed soft ones: what
        that changes is noise. Returns the columns `kept` in terms of the new basis. Collective."""
        projections, comm = self.projections, self.run.model.comm
        for _ in range(2):
            before = decided(comm, projections.model)
            if MIXING * before.squares[-1] <= self.judge.goal * before.squares[0]:
                break
            projections.rotate(before.vectors)
            kept = before.vectors.T @ kept
            noise = decided(comm, self._changed, before)
            if noise <= self.judge.floor:
                break
        else:
            self.judge.noise = max(self.judge.noise, noise)
        return kept

    def _changed(self, before) -> float:
        """How far responses of the model of all columns are from those of one projected before; local."""
        pair = self.judge.compare(before, self.projections.model(), np.eye(len(before.squares)))
        S = grid([before, pair.outer], pair.law, self.settings.band)
        H, drive = pair.responses(S)
        return float(pair.measure.eps(H - response(before, pair.law, S, pair.ports), H, drive).max())

    def _compress(self, reason, drop_above, kept, beside):
        found, judge = compress(self.judge, reason, drop_above, kept, beside), self.judge
        largest = float(found.curve.max()) + (judge.rest if found.reason else min(judge.rest, 3 * judge.floor))
        return found.factor, self.accuracy(
            found.reason, found.pair, found.frequencies, found.curve, largest=largest, noise=found.noise,
        )  # fmt: skip

    def accuracy(self, reason, pair, frequencies, curve, *, largest, noise) -> Accuracy:
        """What is known of the model that a search ends with, for a `reason` where the tolerance is not reached; local.

        `pair`: it and what its error is seen from; `curve` (S,): its error at frequencies (S,) in Hz, with the
        `largest` to be claimed.
        """
        band, multigrid, unproven = self.settings.band, self.solver.multigrid, []
        if not self.proofs and (multigrid or reason):  # no exact value stands behind the estimate
            unproven.append(UNPROVEN if multigrid else ENDED)
        if reason and self.lack > 0:
            unproven.append(f"{counted(self.lack, 'mode')} of the band not found")
        found = Accuracy(
            tolerance=self.settings.tolerance, band=band, reached=not reason, stopped=reason or "reached",
            largest=largest, worst=float(frequencies[curve.argmax()]), noise=noise, measured=self.measured,
            highest=float(pair.inner.frequencies.max()),
            mean=float(((curve[1:] + curve[:-1]) / 2 * np.diff(frequencies)).sum() / (band[1] - band[0])),
            big_size=self.projections.basis.size, missing_modes=max(self.lack, 0), points=tuple(self.points),
            proofs=tuple(self.proofs), frequencies=tuple(frequencies.tolist()), eps=tuple(curve.tolist()),
            loss_factor=pair.law.eta, beside_damping=self.projections.D is not None, multigrid=multigrid,
            unproven="; ".join(unproven), measure=pair.measure,
            directions=directions_of(pair, frequencies, self.settings, self.run.model) if np.isfinite(largest) else (),
        )  # fmt: skip
        return found.with_noise(noise)


def directions_of(pair, frequencies, settings, model) -> tuple[Direction, ...]:
    """How well the outputs of a model are known by themselves, the worst first (see accuracy.Direction); local."""
    by = measure_of(replace(settings, measure="directions"), pair.outer, pair.law, pair.ports)
    parts = np.array_split(frequencies, 1 + len(frequencies) * len(by.outputs) * len(by.inputs) // TOGETHER)
    return directions_table(by, ((part, pair.by(by).each(part), pair.responses(part)[0]) for part in parts),
                            model.output_names, model.input_names)  # fmt: skip
