"""Choose values of the parameters at which a model is factored, until a basis serves for the band and all values.

At each of them the search over the band (see search.search) begins with the columns found so far, and first checks
the model that was before: its blocks give the exact response there. Blocks for all values follow from the same factor
(see estimate). The next values are those where the error is estimated to be largest. The end is reached where two new
points in a row have proven the model, and the estimate is small everywhere.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from typing import Protocol

import numpy as np

from ...linalg.basis import Basis
from ...linalg.blocks import copy_of
from ...linalg.eigensolver import congruent, graded_eigenpairs
from ...parallel.decisions import decided, shared_out
from ...parallel.stopping import stop_if_asked
from ..result.parameter_accuracy import ParameterPoint, in_words
from ..run.run import Run
from ..search.goal import Adaptive
from ..search.judging import Candidate
from ..search.outcome import project_again
from ..search.search import Search, State
from ..search.search_checks import is_singular
from ..search.silent_outputs import quiet_columns
from ..small.compression import compressed, fewest
from ..small.damping import UNDAMPED
from ..small.error_estimate import grid, resonances
from .affine import AffineForm, AffineProjections
from .compression import snapshots_at
from .estimate import Estimate, estimate, residual_block
from .settings import ParameterSearch
from .singular import check_static
from .training import corner_points, distances, fresh_points, training_points
from .zeros import beside_zeros

WIDTH = 16  # columns of a block for all values
BLOCKS = 4  # blocks for all values with one factor, at most
FASTER = 3.0  # by which each of them has to reduce the error, for another to follow
FRESH = 8  # new points at which the error is estimated after each factor
CHECKS = {1: 32, 2: 64}  # new points of the last estimate, by the number of parameters
MANY = 256  # the same for more parameters
CORNERS = 32  # corners of the ranges join the last estimate, unless they are more
TRIM = 0.1  # part of the goal that leaving out columns after each factor may cost
SPREAD = 12  # training points at which that is measured, beside the visited ones
INDEPENDENT = 1e-3  # of modes at several points
PROOFS = 2  # new points in a row that have to prove the model


class OpenRun(Protocol):
    """Opens a run at a point, which is closed at the end of the block; collective."""

    def __call__(self, point, visited) -> AbstractContextManager[Run]: ...


class Greedy:
    """A reduction over parameters under way: the columns `basis` (orthonormal at the reference), their projections, and
    `visited` points. `reason`: why it ended before the tolerance was reached, or "". Methods are collective.

    `run`: at the reference values, with which it begins; `open_run`: see OpenRun; `kept`: how many of the first columns
    stay in the span; `terms`: what tells the model from others in keys of a store.
    """

    def __init__(
        self, parametric, basis: Basis, run: Run, goal: Adaptive, search: ParameterSearch, open_run: OpenRun, kept: int,
        terms: list,
    ):  # fmt: skip
        self.parametric, self.basis, self.run, self.goal, self.search = parametric, basis, run, goal, search
        self.kept, self._terms = kept, terms
        self.comm, self._open_run = run.model.comm, open_run
        self.points = training_points(parametric.parameters, search.points)
        self.reference = tuple(parametric.reference.values())
        self.first: Search | None = None  # the search at the reference
        self.visited: list[tuple[float, ...]] = []
        self.known: list[ParameterPoint] = []
        self.searches: list[Search] = []
        self.reason = ""
        self.estimated = Estimate(np.zeros(0), np.zeros(0))
        self.ratio = 1.0  # by how much measured errors exceed estimated ones
        self.lost = 0.0  # error by the columns that were left out last, which no estimate has seen
        self._zeros: list[tuple[float, ...]] = []  # points beside zeros of responses
        self._count: int  # columns of the model that the next point checks
        self._proofs = 0  # new points in a row that have proven it

    def run_to_end(self):
        """Visit points until the model is proven over all ranges or a limit is met."""
        self.first = Search(self.basis, self.run, self.goal)
        self.first.run_to_end()
        with self.run.progress.stage("parameters"):
            self.first.projections.rotate(decided(self.comm, self._trimmed_first))
            if self.first.projections.io.quiet and not self.kept:
                project_again(self.first, np.zeros((self.basis.size, 0)))
        damping, damped = self.first.projections.damping, self.first.projections.damped
        self.form = AffineForm(self.parametric, self.run, damped)
        self.projections = AffineProjections(self.form, self.basis, damping)
        check_static(self.projections, self.points, self.goal.band)
        self._look_at_damping()
        self._visited(self.first, self.reference, 0)
        self.run.solvers.release()
        while not (self.reason or self._is_proven()):
            point = decided(self.comm, self._next)
            if point is None:
                self.reason = f"after {len(self.visited)} values of the parameters"
                return
            self._visit(point)
            stop_if_asked(self.comm, f"point {len(self.visited)} of the parameters")

    # one point

    def _visit(self, point):
        """Check the model at a point, and extend its basis there."""
        with self._open_run(point, self.visited) as run:
            if self.form.has_mass:
                basis = run.new_basis(self.basis.size)
                count, size = self._count, self.basis.size
                basis.extend(copy_of(self.basis.columns_between(0, count), run.model.K))
                self._count = basis.size
                if size > count:
                    basis.extend(copy_of(self.basis.columns_between(count, size), run.model.K))
            else:
                basis = self.basis
            before = basis.size
            candidate = Candidate(np.arange(self._count), np.arange(before))
            search = Search(basis, run, replace(self.goal, points=()), candidate=candidate)
            search.projections.add_loss_factor(self.projections.damping.eta)
            search.run_to_end()
            self._visited(search, point, before)

    def _visited(self, search, point, before):
        """Take over what a search found at a point, and make blocks for all values with its factor."""
        # how many new points in a row have proven the model, and how far measured errors exceed estimated ones
        self.searches.append(search)
        proofs, fine = search.proofs, search.judge.is_fine
        proven = search.state is State.PROVEN and all(fine(proof.measured) for proof in proofs)
        others = len(search.expansion.points) - len(proofs)  # points that were not to prove a model
        self._proofs = self._proofs + 1 if proven and others == search.expansion.solver.multigrid else 0
        checked = proofs[0] if proofs and before else None
        if checked is not None and checked.estimated > 0.01 * search.judge.goal:
            self.ratio = max(1.0, checked.measured / checked.estimated)
        # the new columns, and blocks for all values
        self._join(search, before)
        self.projections.note_quiet(quiet_columns(search.projections, self.goal.band))
        self.visited.append(point)
        self._look_at_zeros()
        self._extend_everywhere(search)
        values = dict(zip(self.parametric.reference, point, strict=True))
        self.known.append(ParameterPoint(
            values=values, factorisations=sum(point.factors or 0 for point in search.expansion.points),
            columns=self.basis.size - before,
            estimated=checked and checked.estimated, measured=checked and checked.measured,
        ))  # fmt: skip
        # new points to estimate at, and fewer columns
        with self.run.progress.stage("parameters"):
            check_static(self.projections, self.points, self.goal.band)
            self._add_points(self._count)
            self._trim()
        if search.state is State.ENDED:
            self.reason = f"{search.reason} at {in_words(values)}"
        elif self.basis.size >= self.goal.columns:
            self.reason = f"with {self.basis.size} columns"
        self.run.progress.say(
            f"{in_words(values)}: {self.basis.size} columns, estimated error over all values {self.estimate:.1e}"
        )

    def _join(self, search, before):
        """Add the new columns of the basis of a search to the basis."""
        basis = search.projections.basis
        again = is_singular(search.run)  # whose basis may have been smoothed
        if basis is not self.basis:
            start = 0 if again else before
            self.basis.extend(copy_of(basis.columns_between(start, basis.size), self.run.model.K))
        if again:
            self.projections.restart()
        else:
            self.projections.project_new()

    def _look_at_zeros(self):
        """Estimate errors beside zeros of responses, too, where these are as the basis knows them now."""
        with self.run.progress.stage("parameters"):
            points = [point for point in self.points if point not in self._zeros]
            self._zeros = beside_zeros(self.projections, points, self.goal.band)
            self.points = list(dict.fromkeys([*points, *self._zeros]))

    def _extend_everywhere(self, search):
        """Add blocks that serve all values, with the factor of a search, while they make the error smaller fast."""
        solver, last = search.expansion.solver, np.inf
        if solver.nearby is not None:  # solves take the factor itself
            solver.go_to(solver.nearby)
        points, visited = ([list(point) for point in some] for some in (self.points, self.visited))
        rule = {"training": points, "visited": visited, "terms": self._terms}
        make_load = partial(residual_block, self.projections, search.run.framed, self.points, self.goal, WIDTH)
        for _ in range(BLOCKS):
            before, start = self.basis.size, search.projections.basis.size
            with self.run.progress.stage("parameters"):
                new = solver.extend_by_basis(make_load, **rule)
                if new:
                    self._join(search, start)
                self.estimated = estimate(self.projections, self.points, before, self.goal)
            self._count = before
            if not new or self.estimate <= search.judge.goal or self.estimate > last / FASTER:
                break
            if self.basis.size >= self.goal.columns:
                break
            last = self.estimate

    # fewer columns

    def _trimmed_first(self) -> np.ndarray:
        """Return the combinations of the columns of the first search that matter at the reference; local."""
        judge = self.first.judge
        outer = judge.projections.model()
        whole = judge.compare(outer, outer, np.eye(len(outer)))
        modes = np.eye(len(outer))[:, self._counted(outer)]
        fixed = _independent(np.hstack([outer.vectors.T[:, : self.kept], modes]))
        goal = TRIM * max(judge.goal, judge.noise)
        return outer.vectors @ compressed(whole, grid([outer], self.goal.band), goal, fixed, rounds=0)

    def _trim(self):
        """Keep the combinations of the columns before the newest block that matter at the visited points and some
        others. What the rest needs in addition, estimates and blocks that follow see.

        Where outputs hardly feel the inputs, all columns: combinations of parts that hardly couple are errors of these.
        """
        isolated = self.projections.quiet and not self.kept
        count = self.basis.size if isolated else self._count
        if count < 2:
            return
        points = self._spread()
        fixed = decided(self.comm, self._fixed, count)
        snapshots = snapshots_at(points, self.projections, self.goal, fixed, count, coarse=True)
        U = fewest(snapshots, TRIM * max(self.first.judge.goal, self.first.judge.noise), rounds=0)
        self.lost = snapshots.error(U[:, fixed.shape[1] :])
        if isolated:
            U = decided(self.comm, self._pseudo_modes, U)
        size, kept = self.basis.size, U.shape[1]
        factor = np.zeros((size, kept + size - count))
        factor[:count, :kept] = U
        factor[count:, kept:] = np.eye(size - count)
        if isolated:
            self.projections.rotate(factor)
        else:
            self.basis.multiply(factor)
            self.projections.turn(factor)
        self._count = kept

    def _pseudo_modes(self, U):
        """Return the pseudo-modes at the reference in the span of columns U (count, k) of the basis; local."""
        K = self.projections.at(self.reference).K[: len(U), : len(U)]
        return U @ graded_eigenpairs(congruent((K + K.T) / 2, U))[1]

    def _fixed(self, count):
        """Return columns (count, c) that stay in the span: those that are kept anyway, and the modes of the band at the
        visited points, which factors count; local."""
        columns = [np.eye(count)[:, : self.kept]]
        for point in self.visited:
            models = self.projections.at(point)
            model = models.model(count)
            columns.append(models.turn[:count, :count] @ model.vectors[:, self._counted(model)])
        return _independent(np.hstack(columns))

    def _counted(self, model):
        """The modes of the band that factors count."""
        count = int((model.frequencies < self.goal.band[1]).sum()) if self.first.expansion.is_counted else 0
        return slice(count)

    def _spread(self):
        """Return the visited points, those beside zeros of responses, where errors count most, and SPREAD
        training points far from them and each other."""
        chosen = [*self.visited, *self._zeros]
        for _ in range(min(SPREAD, len(self.points))):
            chosen.append(self.points[int(distances(self.parametric.parameters, self.points, chosen).argmax())])
        return list(dict.fromkeys(chosen))

    def _add_points(self, count):
        """Estimate the error at fresh points; those where it is larger than elsewhere, and too large, stay."""
        fresh = fresh_points(self.parametric.parameters, FRESH * len(self.visited), FRESH)
        there = estimate(self.projections, fresh, count, self.goal)
        limit = max(float(self.estimated.errors.max()), self.first.judge.goal)
        more = [k for k in range(FRESH) if there.errors[k] > limit]
        self.points += [fresh[k] for k in more]
        self.estimated = Estimate(*(np.append(old, new[more]) for old, new in zip(self.estimated, there, strict=True)))

    # where it is going

    @property
    def estimate(self) -> float:
        """The largest estimated error, as measured errors let expect it."""
        return self.ratio * float(self.estimated.errors.max())

    def _is_proven(self):
        return self._proofs >= PROOFS and self.first.judge.is_fine(self.estimate)

    def _next(self):
        """Return the point to visit next, None where there is none: of the largest estimate, or if that is small or
        proves for the second time the one farthest from all others."""
        if len(self.visited) >= self.search.most:
            return None
        away = distances(self.parametric.parameters, self.points, self.visited)
        free = np.flatnonzero((away > 1e-6) & [self.form.has_responses(point) for point in self.points])
        if not len(free):
            return fresh_points(self.parametric.parameters, FRESH * len(self.visited), 1)[0]
        errors = self.estimated.errors[free]
        if self.first.judge.is_fine(self.estimate) and self._proofs:
            return self.points[free[away[free].argmax()]]
        return self.points[free[errors.argmax()]]

    def checks(self) -> list[tuple[float, ...]]:
        """Return corners, and points at which nothing was estimated; local."""
        parameters = self.parametric.parameters
        count = CHECKS.get(len(parameters), MANY)
        return corner_points(parameters, CORNERS) + fresh_points(parameters, FRESH * len(self.visited), count)

    def _look_at_damping(self):
        """Measure with the loss factor of undamped models where a given D or added terms leave modes of the band
        without damping at any of the values."""
        if not self.first.projections.is_damped or self.projections.damping.eta:
            return
        low, high = self.goal.band

        def has_undamped(point):
            f, ratio = resonances(self.projections.at(point).model())
            return bool((ratio[(f >= 0.9 * low) & (f <= 1.1 * high)] < UNDAMPED).any())

        if any(shared_out(self.comm, has_undamped, self.points)):
            eta = 2 * self.goal.zeta0
            self.projections.damping = self.projections.damping._replace(eta=eta)
            self.first.projections.add_loss_factor(eta)


def _independent(columns) -> np.ndarray:
    """Return orthonormal columns for the directions of columns, those that nearly depend on others left out; the first
    ones span what the first of them span."""
    columns = columns / np.linalg.norm(columns, axis=0)
    basis = np.zeros((len(columns), 0))
    for column in columns.T:
        rest = column - basis @ (basis.T @ column)
        rest -= basis @ (basis.T @ rest)
        if np.linalg.norm(rest) > INDEPENDENT:
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
    return basis
