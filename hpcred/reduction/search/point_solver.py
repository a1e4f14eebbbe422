"""Solve at the points of a search, and add the solutions to the basis.

A = K - omega^2 M is factored at the point. Where it may be, the factor of another point serves instead, or the
multigrid of K, by conjugate gradients beside the basis (see linalg.solvers.iterative). What the store knows takes no
factor.
"""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np

from ...linalg.blocks import copy_of, create_block, local_rows, random_block
from ...linalg.conjugate_gradients import NegativeCurvature, NotSolved
from ...linalg.known import ModeCount, Source
from ...linalg.solvers.base import MOVES_FREELY, SingularMatrix
from ...parallel.decisions import decided
from ...parallel.failures import ComputationError, InputError
from ..components.krylov import PencilSequence
from ..result.accuracy import Point
from ..run.store import Entry
from ..small.error_estimate import off_poles, rounded
from .goal import Adaptive
from .projections import Projections
from .residual_blocks import residual_block

# columns of loads up to which blocks are filled, to so many: with few a back substitution waits for the factor to pass
# through memory, which takes as long as the arithmetic of more than ten. Blocks of any width come to an end six or
# seven of them after they have the modes: all solves together change by little between four columns and twelve, and
# what is done to the columns grows with them. Not by the clock, for a search takes the same steps each time, on any
# number of ranks. Factors of fewer rows stay in the cache of the processor
FEW, WIDTH, ROWS = 4, 6, 5000
POLE_GAP = 1e-3  # how far a point is moved that lies on an eigenfrequency
TRIES, OUTWARDS = (0, 1, -1, 3), (0, 1, 2, 3)  # how often, in turn; points at the ends of a band out of it
# of its first residual may be left by multigrid, of loads, and of what a basis leaves of them
ROUGH_LOADS, ROUGH = 1e-4, 3e-3
CROSS = 1e-6  # share of the energy that may be left by solves nearby where outputs are not those of the inputs


class NoRegularPoint(ComputationError):
    """Near a point K - omega^2 M is singular, but for round-off."""


class SearchSequence(PencilSequence):
    """The Krylov sequence of a point of a search: of the inputs and outputs together, and of M times random columns
    where these are FEW. What no load moves is found with the rest then."""

    rule = "pencil of inputs, outputs and random columns"

    def _factor(self):
        return self.run.solvers.factored(self._square, self._name, may_give_up=False)

    @property
    def filled(self) -> int:
        """The random columns of the first block."""
        loads = super()._load_columns()
        return WIDTH - loads if loads <= FEW and self.run.model.size >= ROWS else 0

    def _load_columns(self):
        return super()._load_columns() + self.filled

    def _next_load(self):
        if self.ends or not self.filled:
            return super()._next_load()
        model = self.run.model
        block = create_block(model.K, self._load_columns())
        random = self.run.times_mass(random_block(model.K, self.filled))
        with local_rows(block) as rows, local_rows(self._loads) as own, local_rows(random) as more:
            rows[...] = np.hstack([own, more])
        return block


class PointSolver:
    """Solves at one point after another, begun by open(); `points`: those that are done, a list of the search.

    `nearby`: the point (Hz) whose factor solves take, or 0 Hz with multigrid; None where the point has its own.
    `failed_nearby`: whether conjugate gradients beside the factor of another point have not come to an end. Methods are
    collective.
    """

    def __init__(self, projections: Projections, settings: Adaptive, points: list[Point]):
        self.projections, self.run = projections, projections.run
        self._settings, self._points = settings, points
        self.multigrid = self.run.solvers.multigrid  # at 0 Hz, and elsewhere beside a basis with the modes below
        self.counts = self.run.solvers.counts
        self.nearby: float | None = 0.0 if self.multigrid else None
        self.failed_nearby = False
        self._mass = 0.0  # -omega^2 of the point
        self._random, self._smooth = 0, -1  # pairs of random columns; size of the basis that was smoothed

    @property
    def is_smooth(self) -> bool:
        """Whether nothing has joined the basis since it was smoothed."""
        return self._smooth == self.projections.basis.size

    @property
    def factored(self) -> float:
        """-omega^2 of the factor that solves take."""
        return self._mass if self.nearby is None else _mass_at(self.nearby)

    @property
    def is_nearby(self) -> bool:
        """Whether solves at the point are by conjugate gradients beside the basis."""
        return self._mass != self.factored

    def open(self, f, nearby: float | None = None) -> tuple[float, ModeCount | None]:
        """Begin a point off the poles; return its place and the count of modes below it. It is factored here unless
        the store knows that it can be and how many those are, else when a solve needs it, or with the factor of the
        point `nearby`. A point at an end of the band leaves no mode of it uncounted. Raises InputError, NoRegularPoint.
        """
        run = self.run
        if not self.multigrid:
            self.nearby = nearby
        if self.projections.basis.size:
            f = decided(run.model.comm, self._off_poles, f)
        # the factor of another point serves, and counts nothing here
        if self.nearby:
            self.go_to(f)
            return float(f), None
        # a factor of its own, of the first place beside f that is no eigenfrequency
        outwards = self._outwards(f)
        for steps in [outwards * k for k in OUTWARDS] if outwards else TRIES:
            trial = f * (1 + steps * POLE_GAP)
            self.go_to(trial)
            try:
                pivots = self._pivots()
            except SingularMatrix as error:
                if self.multigrid:
                    raise InputError(f"K of {run.model.name} is singular: {MOVES_FREELY}") from error
                continue
            rigid = run.framed.rigid_size if trial else 0
            count = pivots and replace(pivots, modes=pivots.modes - rigid, below=float(trial))
            return float(trial), count
        raise NoRegularPoint(
            f"no point near {f:g} Hz could be factored: it is among many eigenfrequencies, or the body is nearly free, "
            "so that round-off of K hides where its lowest ones are"
        )

    def _outwards(self, f) -> int:
        """Return the direction (1, -1) out of the band for a point (Hz) at one of its ends, else 0."""
        low, high = self._settings.band
        return 1 if f >= high else -1 if f <= low else 0

    def _off_poles(self, f) -> float:
        """Return a place beside f (Hz) off the pseudo-frequencies, f where there is none; local."""
        band, outwards = self._settings.band, self._outwards(f)
        moved = off_poles(f, self.projections.model(), band, outwards)
        return f if moved in (None, f) else rounded(moved, band, inside=not outwards)

    def go_to(self, f):
        """Have solves be at a point, which a solve factors where that is not done."""
        self._mass = _mass_at(f)

    def factor_own(self):
        """Have solves factor the point itself, where there are factors."""
        if not self.multigrid:
            self.nearby = None

    def _pivots(self) -> ModeCount | None:
        """Return the negative pivots at the point, None where they do not count modes; from the store where that has
        them from a source as good as that of a factor made now."""
        run, claim = self.run, self.run.solvers.source if self.counts else None
        key = {"kind": "count", "square": self._mass, **run.identity_of("M", "K")}
        known = run.stored(key)
        if known is not None:
            facts = known.facts
            source = facts.get("source") and Source(**facts["source"])
        if known is None or (claim is not None and not (source and source.serves(claim))):
            source, facts = claim, {"negative_pivots": self._factor().inertia, "source": claim and asdict(claim)}
            run.keep(key, Entry(facts))
        if claim is None or facts["negative_pivots"] is None:
            return None
        return ModeCount(modes=facts["negative_pivots"], below=0.0, source=source)

    def _factor(self):
        """Return the solver with the factor of K - omega^2 M at the point, or at the one near it."""
        mass = self.factored
        # another search begins by multigrid where a factor does not fit
        return self.run.solvers.factored(mass, f"{(-mass) ** 0.5 / (2 * np.pi):.6g} Hz", may_give_up=self.multigrid)

    def sequence(self, f) -> SearchSequence:
        """Return the Krylov sequence of blocks of the point."""
        loads = self.projections.loads
        return SearchSequence(self.run, self._mass, f"{f:.6g} Hz", None, loads, ("inputs", "outputs"))

    def goes_on_without(self, error: NotSolved) -> bool:
        """Test whether a search goes on where a solve nearby failed: by a factor of its own, or with blocks at 0 Hz."""
        return not self.multigrid or isinstance(error, NegativeCurvature)

    def extend_by(self, rule: dict, make_load, rough=0.0) -> int:
        """Add A^-1 times a load, at the point; returns how many columns are new. `rule`: what tells the load in the key
        of the store from others at the point; `make_load` gives it as a block; `rough`: what multigrid may leave of
        it: the response of a basis is off by the square of that. Raises NotSolved."""
        run = self.run
        roughly = [rough] if rough and self.multigrid else []  # which only multigrid takes
        if roughly:
            rule = self._history() | rule | {"rough": rough}
        key = {"kind": "solution", "square": self._mass, **rule, **run.identity_of("M", "K", "inputs", "outputs")}
        if self.is_nearby:  # whose errors are small beside what the basis had
            key |= {"nearby": True, **run.identity_of("basis")}
        failed = key | {"failed": True} | self._history()  # for it is the basis that makes a solve nearby fail
        entry, basis = run.stored(key), self._basis()
        if entry is not None and self.is_nearby and not _has_all(entry.facts.get("of"), basis):
            entry = None
        if entry is None and self.is_nearby and run.stored(failed) is not None:
            self.failed_nearby = True
            raise NegativeCurvature("as in an earlier run")
        if entry is not None:
            block = entry.block
        else:
            solver, load = self._factor(), make_load()
            block = create_block(run.model.K, load.getActiveColumns()[1])
            with run.progress.stage("solve"):
                self._solve(solver, load, block, failed, roughly)
            run.keep(key, Entry({"of": basis}, (block.getActiveColumns()[1],), block))
        return self.projections.extend(block)

    def _solve(self, solver, load, block, failed, roughly):
        """block = A^-1 load; a solve nearby that fails is kept in the store under `failed`."""
        if not self.is_nearby:
            solver.solve(load, block, 0, *roughly)
            return
        try:
            V, small = self.projections.basis.columns, self.projections.dynamic_stiffness(self._mass)
            if not self.multigrid and not self.projections.io.are_same:  # responses may be far below energies
                roughly = [CROSS]
            solver.solve_below(self._mass, load, block, V, small, *roughly)
        except NotSolved as error:
            self.failed_nearby = True
            if self.goes_on_without(error):
                self.run.keep(failed, Entry({}))
            raise

    def extend_by_loads(self) -> int:
        """extend_by() the inputs and outputs."""
        return self.extend_by({}, lambda: copy_of(self.projections.loads, self.run.model.K), ROUGH_LOADS)

    def extend_by_basis(self, make_load, rough=0.0, **rule) -> int:
        """extend_by() a load that is made from the basis."""
        return self.extend_by(self._history() | rule, make_load, rough)

    def extend_by_all_dofs(self) -> int:
        """Add all coordinates of a small model, beside rigid-body motion; returns how many columns are new."""
        model, rigid = self.run.model, self.run.rigid
        block = create_block(model.K, model.size)
        with local_rows(block) as rows:
            rows[...] = np.eye(model.size)[model.first_row : model.first_row + len(rows)]
        if rigid is not None:
            rigid.project(block)
        return self.projections.extend(block)

    def extend_by_residuals(self, f, width) -> int:
        """extend_by() `width` directions of what the basis leaves of the loads over the band and at f (Hz)."""

        def make_load():
            with self.run.progress.stage("residuals"):
                return residual_block(self.projections, self._settings, f, width, power=not self.multigrid)

        return self.extend_by_basis(make_load, ROUGH)

    def extend_by_random(self, width=2) -> int:
        """extend_by() M times random columns, others each time."""
        self._random += 1
        x = random_block(self.run.model.K, width, seed=self._random)
        return self.extend_by({"random": self._random, "width": width}, lambda: self.run.times_mass(x))

    def smooth(self) -> bool:
        """Replace the basis by A^-1 M times its pseudo-modes, which spans the same where it can hold nothing more, but
        without the round-off that columns have on dofs without mass. Returns whether that could be done."""
        run, projections = self.run, self.projections
        if self.multigrid or not projections.basis.size:
            return False
        projections.rotate(decided(run.model.comm, projections.model).vectors)
        load = run.times_mass(projections.basis.columns)
        block = create_block(run.model.K, projections.basis.size)
        self._factor().solve(load, block)
        projections.replace(block)
        self._smooth = projections.basis.size
        return True

    def _basis(self) -> dict:
        """The points that the basis is of, with their columns, and its size."""
        points = [[point.frequency, point.columns] for point in self._points]
        return {"points": points, "size": self.projections.basis.size}

    def _history(self) -> dict:
        """What a load depends on that is made from the basis."""
        return {"asked": asdict(self._settings), **self._basis(), **self.run.identity_of("D", "damping", "basis")}


def _has_all(theirs: dict | None, ours: dict) -> bool:
    """Test whether a basis has all columns of another, by PointSolver._basis() of both: sequences at the same points
    that are as long or longer, and as many columns beside."""
    if theirs is None or [f for f, _ in theirs["points"]] != [f for f, _ in ours["points"]]:
        return False
    longer = [theirs["size"] - ours["size"]]
    longer += [more - columns for (_, more), (_, columns) in zip(theirs["points"], ours["points"], strict=True)]
    return min(longer) >= 0 and longer[0] == sum(longer[1:])


def _mass_at(f):
    """Return -omega^2 of a point (Hz), without a negative zero."""
    return 0.0 - (2 * np.pi * f) ** 2
