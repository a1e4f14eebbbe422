"""Extend a basis by modes of (K, M): the lowest ones, those in a band, or listed ones."""

from dataclasses import asdict, dataclass, field
from typing import Literal

import numpy as np

from ...linalg.basis import Basis, Extension
from ...linalg.blocks import add_product, column_norms, copy_of, create_block, inner, local_rows, times
from ...linalg.eigensolver import lowest_modes, modes_in_interval
from ...linalg.free_motions import free_motions_refused
from ...linalg.known import EXACT, Source
from ...linalg.solvers.base import MOVES_FREELY, DoesNotFit, SingularMatrix
from ...model.damping import ModalDamping
from ...parallel.decisions import decided
from ...parallel.declared import as_declared
from ...parallel.failures import ComputationError, InputError
from ...parallel.petsc import is_complex
from ...parallel.ranges import COUNT, Band, Count, within
from ..run.projection import diagonalise, project, project_columns
from ..run.run_solvers import refusal
from ..run.store import Entry
from .component import Component

INDEPENDENT = 1e-6  # weight of a direction of modes found that is not round-off
MIXED = 0.01  # share of rigid-body motions in a mode, and weight of what is left of it, that are not round-off
SAME = 1e-7  # relative difference of eigenvalues that is none
FAR_SOFTER = 1e-4  # of the eigenvalue of the next mode: solves have lost so many digits for that
KRYLOV = Source(kind="Krylov")  # of modes that nothing counts
AT_FIRST = 16  # modes that are looked for where nobody knows how many lie in a band


@dataclass(frozen=True)
class Modes(Component):
    """Undamped modes: exactly one of `count`, `band` and `index`.

    Parameters
    ----------
    count : int, optional
        The number of lowest modes.
    band : tuple of two floats, optional
        All modes in this band in Hz.
    index : tuple of int, optional
        Modes by number, from 1 as in finite-element programs: rigid-body modes of a free body come first (1 to 6), and
        are never part of the basis.
    dominant : int, optional
        Of these, only so many that contribute most to the transfer function, ranked by approximate Hankel singular
        values of the lightly damped modal model, |b_i| |c_i| / (4 xi_i omega_i^2) (Gawronski, Dynamics and Control of
        Structures, 1998, ch. 4), with xi = 1 % where the model has no damping.
    """

    kind: Literal["modes"] = field(default="modes", kw_only=True, repr=False)
    count: Count | None = None
    band: Band | None = None
    index: tuple[int, ...] | None = None
    dominant: Count | None = None

    def __post_init__(self):
        as_declared(self, "modes.")
        if sum(value is not None for value in (self.count, self.band, self.index)) != 1:
            raise InputError("modes: expected exactly one of count, band and index")
        if self.index is not None and (not self.index or min(self.index) < 1):
            raise InputError(f"modes.index: found {list(self.index)}, expected numbers from 1")
        within("modes.index", self.index, COUNT)

    def columns(self, inputs: int, rigid: int) -> int:
        """Return the number of vectors known beforehand (0 for a band)."""
        known = self.count or len(set(self.index or ()))
        return min(known, self.dominant) if self.dominant else known

    def check(self, size: int, rigid: int) -> None:
        """Refuse what the model cannot have. Raises InputError."""
        if self.index is not None and min(self.index) <= rigid:
            raise InputError(
                f"modes.index: modes 1 to {rigid} of a free body are its rigid-body modes, "
                f"its elastic modes start at {rigid + 1}"
            )
        if self._highest(rigid) > size - rigid:
            raise InputError(f"modes: {self._highest(rigid)} elastic modes asked for, the model has {size - rigid}")

    def _highest(self, rigid):
        """Return how many of the lowest elastic modes have to be known."""
        return self.count or (max(self.index) - rigid if self.index else 0)

    def extend(self, basis, run) -> None:
        """Add the modes to the basis. Collective."""
        rigid = run.framed.rigid_size
        self.check(run.model.size, rigid)
        require_real_modes(run.model)
        facts = {}
        with run.progress.stage("modes", self._name()):
            if self.band is not None:
                claim = KRYLOV if self._slicing(run) is None else EXACT
                values, block, served = kept_modes(run, {"band": self.band}, None, claim, lambda: self._in_band(run))
            else:
                count, rule = self._highest(rigid), {"band": None}
                values, block, served = kept_modes(run, rule, count, KRYLOV, lambda: (*_lowest(run, count), KRYLOV))
                if self.index is not None:
                    chosen = np.array(sorted(set(self.index))) - rigid - 1
                    values, block = values[chosen], choose(run, block, chosen)
            if self.dominant is not None and block is not None:
                values, block, dominance = _dominant(run, values, block, self.dominant)
                facts["dominance"] = tuple(dominance.tolist())
            residual = float(residuals(run, values, block).max(initial=0.0))
        frequencies = tuple((np.sqrt(np.maximum(values, 0.0)) / (2 * np.pi)).tolist())
        new = Extension()
        if block is not None:
            with run.progress.stage("orthogonalise"):
                new = basis.extend(block)
        run.note(self._name(), len(values), new, frequencies_hz=frequencies, residual=residual,
                 from_store=served, **facts)  # fmt: skip

    def _name(self):
        if self.band is not None:
            return f"modes in {self.band[0]:g} to {self.band[1]:g} Hz"
        return f"{self.count} lowest modes" if self.count else f"modes {list(self.index)}"

    def _slicing(self, run):
        """Return the options of SLEPc's spectrum slicing, None where there is no inertia: in complex builds, of some
        packages, and by multigrid."""
        if is_complex() or run.solvers.multigrid:
            return None
        return run.factoring.package.slicing(run.factoring, run.model.comm)

    def _in_band(self, run):
        """Return the modes in the band, and their source."""
        low, high = ((2 * np.pi * f) ** 2 for f in self.band)
        if low == 0:
            low = -0.01 * high  # below the rigid-body modes, where K - low M is definite
        options = self._slicing(run)
        if options is not None and _slices(run):
            values, block = modes_in_interval(run.model.K, run.model.M, low, high, options)
            return *_without_rigid(run, values, block), EXACT
        most = run.model.size - run.framed.rigid_size
        return *all_between(run, low, high, most, lambda count: _lowest(run, count)), KRYLOV


def require_real_modes(model):
    """Refuse modes of an unsymmetric K, which are complex."""
    if not model.is_symmetric("K"):
        raise InputError(f"modes: K of {model.name} is not symmetric, so that its modes are complex; take 'krylov', or "
                         "a tolerance")  # fmt: skip


def _slices(run):
    """Test whether the factors that SLEPc makes of its own fit; refused where nothing else would do."""
    if not run.solvers.multigrid:
        try:
            run.solvers.real().estimate()
        except DoesNotFit as error:
            if not run.solvers.give_up_factors(error):
                raise refusal(error) from error
    if not run.solvers.multigrid:
        run.solvers.release()
    return not run.solvers.multigrid


def kept_modes(run, rule, count, claim, find):
    """Return the first `count` modes, or all, from the store or by `find`, which also returns their source, and whether
    they are from the store; the store then has what was found, in place of fewer, or of those of a source that is
    weaker than the `claim`. `rule`: what tells them from others, with their "band" (None: the lowest)."""
    key = {"kind": "modes", **rule, **run.identity_of("M", "K")}
    entry = run.stored(key)
    if rule["band"] is None:
        run.notes.needs("0.0", "0.0")
    source = entry is not None and entry.facts.get("source")
    if source and Source(**source).serves(claim) and len(entry.facts["values"]) >= (count or 0):
        values, block = np.array(entry.facts["values"]), entry.block
        return (values, block, True) if count is None else (values[:count], choose(run, block, np.arange(count)), True)
    values, block, source = find()
    widths = () if block is None else (len(values),)
    run.keep(key, Entry({"values": values.tolist(), "source": asdict(source)}, widths, block))
    return values, block, False


def all_between(run, low, high, most, find):
    """Return all eigenvalues from `low` to `high` (omega^2) and their modes as a block, or None, by `find(count)` of
    ever more of the lowest, of which there are `most`, until one lies above. Collective."""
    count = AT_FIRST
    while True:
        values, block = find(min(count, most))
        if values[-1] > high or len(values) == most:
            break
        del block  # its memory is for the next one
        count *= 2
    inside = np.flatnonzero((values >= low) & (values <= high))
    return values[inside], choose(run, block, inside)


def _lowest(run, count):
    try:
        return lowest(run, count)
    except SingularMatrix as error:
        if run.rigid is not None:
            raise free_motions_refused(run.model, run.rigid) from error
        raise InputError(f"basis: K of {run.model.name} is singular: {MOVES_FREELY}") from error


def lowest(run, count, shift=0.0):
    """Return the `count` lowest elastic eigenvalues (count,) of (K, M), and the M-orthonormal modes as a block.
    Collective.

    Found by solves with K + shift M. Raises SingularMatrix.
    """
    solver = run.solvers.factored(shift, "0 Hz" if not shift else "a shift")
    return lowest_modes_by(run, count, run.model.size - run.framed.rigid_size, solver.solve, shift)


def lowest_modes_by(run, count, most, solve, shift=0.0):
    """Return the `count` lowest modes, omega^2 (count,) and a block, on the space of dimension `most` in which
    `solve(load, solution, steps)` inverts K + shift M.

    Beside far softer modes solves have no digits left for stiff ones: these are looked for again in what is
    M-orthogonal to the soft ones. Collective. Raises ComputationError.
    """
    values, block = _lowest_at_once(run, count, most, solve, shift)
    soft = decided(run.model.comm, _far_softer, values, shift)
    if not soft:
        return values, block
    softer = Basis(run.mass, room=soft)
    softer.extend(choose(run, block, np.arange(soft)))
    values = diagonalise(softer, project(run.model.K, softer.columns))
    beside = _SolvesBeside(softer, solve)
    del block  # its memory is for the next one
    others, stiffer = lowest_modes_by(run, count - soft, most - soft, beside.solve, shift)
    both = create_block(run.model.K, count)
    with local_rows(softer.columns) as first, local_rows(stiffer) as last, local_rows(both) as rows:
        rows[:, :soft], rows[:, soft:] = first, last
    return np.append(values, others), both


def _far_softer(values, shift) -> int:
    """Return how many of the ascending eigenvalues are FAR_SOFTER than the next one."""
    sizes = np.abs(values + shift)
    return int(np.argmax(np.append(sizes[:-1] < FAR_SOFTER * sizes[1:], True)) + 1) % len(values) if len(values) else 0


class _SolvesBeside:
    """Solves in the space that is M-orthogonal to the columns of a basis."""

    def __init__(self, basis, solve):
        self._basis, self._solve = basis, solve

    def solve(self, load, solution, steps=0):
        """solution = P K^-1 P^T load with P = I - V V^T M. Collective."""
        basis = self._basis
        right, images = copy_of(load, basis.mass), times(basis.mass, basis.columns)
        add_product(right, images, inner(basis.columns, right), alpha=-1.0)
        self._solve(right, solution, steps=steps)
        for _ in range(2):  # the second time for what round-off leaves
            add_product(solution, basis.columns, inner(images, solution), alpha=-1.0)


def _lowest_at_once(run, count, most, solve, shift):
    """The same, without a look at how soft they are.

    A Krylov sequence from one vector has one mode of a repeated eigenvalue, and others of it by round-off alone. Beside
    the modes found another sequence therefore begins from another vector, until it finds none below the last of them.
    """
    right, left = (create_block(run.model.K, 1) for _ in range(2))
    vectors = Basis(run.mass, tolerance=INDEPENDENT, room=count + 1)
    values = np.zeros(0)

    def invert(x, y):
        with local_rows(right) as rows:
            rows[:, 0] = x.getArray(readonly=True)
        solve(right, left)
        if vectors.size:
            add_product(left, vectors.columns, vectors.coefficients(left), alpha=-1.0)
        with local_rows(left) as rows:
            y.setArray(rows[:, 0])

    wanted = count
    while wanted:
        known, before = vectors.size, values[:count]
        _, block = lowest_modes(
            run.model.K, run.model.M, wanted, most - known, invert,
            monitor=lambda more, known=known: run.progress.step("modes", min(known + more, count), count),
        )  # fmt: skip
        values = values if block is None else _with_modes(run, vectors, block, solve)
        if vectors.size == known < count:
            raise ComputationError(f"only {known} of the {count} modes found are independent")
        # one that was missing moves others up to the last, and the rounded zeros of a free body say nothing
        if known >= count and not (values[:count] < before - SAME * (np.abs(before).max(initial=0.0) + shift)).any():
            break
        # one more tells whether there are others; where there are, they may be many
        wanted = min(max(count - vectors.size, 2 * wanted if known else 1), most - vectors.size)
    return values[:count], copy_of(vectors.columns_between(0, count), run.model.K) if count else None


def _with_modes(run, vectors, block, solve):
    """Add modes to others, improved by a refined step of inverse iteration; return Rayleigh-Ritz values, ascending, as
    the vectors are.

    What follows modes in a basis is the small rest that they leave, and shares their round-off. The columns of the
    block span the modes; there may be more of them, dependent ones. They are separated before the step: it
    multiplies what a stiff mode has of a soft one by the quotient of their eigenvalues.
    """
    modes = Basis(run.mass, tolerance=INDEPENDENT, room=block.getSizes()[1])
    modes.extend(block)
    diagonalise(modes, project(run.model.K, modes.columns))
    step = create_block(run.model.K, modes.size)
    solve(run.times_mass(modes.columns), step, steps=1)
    vectors.extend(step)
    return diagonalise(vectors, project(run.model.K, vectors.columns))


def _dominant(run, values, block, count):
    """Return the `count` modes with the largest contribution, in the order of frequency, and what they contribute."""
    model = run.model
    size = np.maximum(np.sqrt(np.diag(project(model.M, block))), 1e-300)
    loads = np.linalg.norm(project_columns(block, model.B), axis=1) / size
    sensors = loads if model.Ct is None else np.linalg.norm(project_columns(block, model.Ct), axis=1) / size
    omega = np.sqrt(np.maximum(values, np.finfo(float).tiny))
    ratio = np.full(len(values), 0.01)
    if model.D is not None:
        ratio = np.maximum(np.diag(project(model.D, block)) / size**2 / (2 * omega), 1e-6)
    elif isinstance(run.framed.damping, ModalDamping):
        ratio = np.maximum(run.framed.damping.at(omega / (2 * np.pi)), 1e-6)
    value = loads * sensors / (4 * ratio * omega**2)
    chosen = decided(model.comm, lambda: np.sort(np.argsort(-value, kind="stable")[:count]))
    return values[chosen], choose(run, block, chosen), value[chosen]


def choose(run, block, columns):
    """Return the chosen columns as a new block, None for none."""
    if not len(columns):
        return None
    chosen = create_block(run.model.K, len(columns))
    with local_rows(block) as source, local_rows(chosen) as target:
        target[...] = source[:, columns]
    return chosen


def _without_rigid(run, values, block):
    """Return the modes without the rigid-body motions in their span, with Rayleigh quotients for values.

    Other motions without force share their eigenvalue, zero, with those: single modes are any mixture of both.
    """
    if block is None or run.rigid is None:
        return values, block
    product = run.times_mass(block)
    share = (inner(run.rigid.R, product) ** 2).sum(axis=0) / np.diag(inner(block, product))
    elastic, quotients = np.flatnonzero(share < MIXED), np.zeros(0)
    vectors = Basis(run.mass, run.rigid.R, MIXED, len(values))
    mixed = choose(run, block, np.flatnonzero(share >= MIXED))
    if mixed is not None:
        vectors.extend(mixed)
        quotients = np.diag(project(run.model.K, vectors.columns)) if vectors.size else quotients
    values = np.concatenate([quotients, values[elastic]])
    if not len(values):
        return values, None
    modes = create_block(run.model.K, len(values))
    with local_rows(vectors.columns) as first, local_rows(block) as others, local_rows(modes) as rows:
        rows[:, : vectors.size], rows[:, vectors.size :] = first, others[:, elastic]
    run.rigid.project(modes)
    return values, modes


def residuals(run, values, block) -> np.ndarray:
    """Return ||K x - lambda M x|| / (lambda ||M x||) of the modes. Collective."""
    if block is None:
        return np.zeros(0)
    product, force = run.times_mass(block), times(run.model.K, block)
    size = column_norms(product)
    add_product(force, product, np.diag(values), alpha=-1.0)
    return column_norms(force) / np.maximum(np.abs(values) * size, 1e-300)
