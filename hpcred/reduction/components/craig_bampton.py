"""Extend a basis by component modes of the interface nodes: constraint, fixed-interface and attachment modes.

Constraint modes solve K x = G^T lambda with G x = e for each direction e of the interfaces (Craig & Bampton, AIAA J.
6(7), 1968; without modes, Guyan, AIAA J. 3(2), 1965); fixed-interface modes are those of (K, M) with G x = 0. Both come
from the factor of K for the whole body, here X = K^-1 G^T, since G K^-1 (f + G^T lambda) = g is small. A free body has
its motions R besides, x = X lambda + K^+ f + R c with R^T (f + G^T lambda) = 0, and K^+ by inertia relief.

Residual attachment modes (Rubin, AIAA J. 13(8), 1975; MacNeal, 1971), K^-1 G^T beside free-interface modes, are the
Krylov block of order 0 at 0 Hz with the loads of the interfaces.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np

from ...fe.dofs import DIRECTIONS
from ...linalg.basis import Basis
from ...linalg.blocks import add_product, create_block, dense, from_dense, inner
from ...linalg.solvers.base import SingularMatrix
from ...parallel.decisions import decided
from ...parallel.declared import as_declared
from ...parallel.failures import InputError
from ...parallel.ranges import COUNT, Band
from ..run.run import Run
from ..run.store import Entry
from .component import Component
from .modes import KRYLOV, all_between, kept_modes, lowest_modes_by, require_real_modes

DEPENDENT_DIRECTION = 1e-12  # eigenvalue of the scaled G K^+ G^T below which one of the interfaces depends on others


@dataclass(frozen=True)
class ConstraintModes(Component):
    """The static shapes of the body for a unit displacement of each direction of the interfaces, the others held."""

    kind: Literal["constraint_modes"] = field(default="constraint_modes", kw_only=True, repr=False)

    per_direction = 1

    def columns(self, inputs: int, rigid: int) -> int:
        return 0

    def extend(self, basis, run) -> None:
        _add_constraint_modes(basis, run, InterfaceSolver(run))


@dataclass(frozen=True)
class Guyan(ConstraintModes):
    """Static condensation to the interfaces: the constraint modes alone, by its name."""

    kind: Literal["guyan"] = field(default="guyan", kw_only=True, repr=False)


@dataclass(frozen=True)
class FixedInterfaceModes(Component):
    """Undamped modes of the body with all interfaces held.

    Parameters
    ----------
    count : int, optional
        The number of lowest modes.
    band : tuple of two floats, optional
        All modes in this band in Hz, in place of `count`.
    """

    kind: Literal["fixed_interface_modes"] = field(default="fixed_interface_modes", kw_only=True, repr=False)
    count: Annotated[int | None, COUNT] = None
    band: Band | None = None

    per_direction = 0

    def __post_init__(self):
        as_declared(self, f"{self.kind}.")
        if (self.count is None) == (self.band is None):
            raise InputError(f"{self.kind}: expected exactly one of count and band")

    def columns(self, inputs: int, rigid: int) -> int:
        return self.count or 0

    def extend(self, basis, run) -> None:
        self._add_modes(basis, run, InterfaceSolver(run))

    def _add_modes(self, basis, run, solver):
        require_real_modes(run.model)
        free = run.model.size - solver.size
        if (self.count or 0) > free:
            raise InputError(f"{self.kind}: {self.count} modes asked for, the held body has {free}")
        where = f"{self.count} fixed-interface modes" if self.count else (
            f"fixed-interface modes in {self.band[0]:g} to {self.band[1]:g} Hz")  # fmt: skip
        with run.progress.stage("modes", where):
            rule = {"held": "interfaces", "band": self.band}
            values, block, served = kept_modes(run, rule, self.count, KRYLOV, lambda: self._modes(run, solver, free))
        frequencies = tuple((np.sqrt(np.maximum(values, 0.0)) / (2 * np.pi)).tolist())
        if block is None:
            run.note(where, 0, 0, frequencies_hz=(), from_store=served)
            return
        with run.progress.stage("orthogonalise"):
            extension = basis.extend(block)
        run.note(where, len(values), extension, frequencies_hz=frequencies, from_store=served)

    def _modes(self, run, solver, free):
        if self.count:
            return *lowest_modes_by(run, self.count, free, solver.solve), KRYLOV
        low, high = ((2 * np.pi * f) ** 2 for f in self.band)
        modes = all_between(run, low, high, free, lambda count: lowest_modes_by(run, count, free, solver.solve))
        return *modes, KRYLOV


@dataclass(frozen=True)
class CraigBampton(FixedInterfaceModes):
    """Constraint modes and fixed-interface modes.

    Parameters
    ----------
    count : int, optional
        The number of lowest fixed-interface modes.
    band : tuple of two floats, optional
        All fixed-interface modes in this band in Hz, in place of `count`.
    """

    kind: Literal["craig_bampton"] = field(default="craig_bampton", kw_only=True, repr=False)

    per_direction = 1

    def extend(self, basis, run) -> None:
        solver = InterfaceSolver(run)
        _add_constraint_modes(basis, run, solver)
        self._add_modes(basis, run, solver)


@dataclass(frozen=True)
class ResidualAttachment(Component):
    """K^-1 G^T, by inertia relief for a free body: with modes before it, Rubin's and MacNeal's method.

    The same as a Krylov block of order 0 at 0 Hz whose inputs are the loads of the interfaces: what the modes leave of
    it is the residual flexibility.
    """

    kind: Literal["residual_attachment"] = field(default="residual_attachment", kw_only=True, repr=False)

    per_direction = 1

    def columns(self, inputs: int, rigid: int) -> int:
        return 0

    def extend(self, basis, run) -> None:
        solver = InterfaceSolver(run)
        with run.progress.stage("orthogonalise"):
            new = basis.extend(solver.flexible)
        run.note("residual attachment modes", solver.size, new, from_store=solver.from_store)


class InterfaceSolver:
    """Solves K x = f + G^T lambda, G x = g with the factor of K that the run has; `size`: 6k directions.

    `flexible`: X = K^-1 G^T (n, 6k) as a block. Collective throughout. Raises InputError for a singular K, and for
    directions that depend on each other.
    """

    def __init__(self, run: Run):
        model, self._run = run.model, run
        check_directions(model)
        self._forces = interface_forces(model)
        self.size = self._forces.getActiveColumns()[1]
        self.flexible = create_block(model.K, self.size)
        self.from_store = self._take_flexible()
        small = inner(self._forces, self.flexible)
        rigid = inner(self._forces, run.rigid.R) if run.rigid is not None else np.zeros((self.size, 0))
        self._system, self._scale = decided(model.comm, _interface_system, small, rigid, model.interfaces)

    def _factored(self):
        """Return the solver of the run with the factor of K."""
        try:
            return self._run.solvers.factored(0.0, "0 Hz")
        except SingularMatrix as error:
            model, frame = self._run.model, "take frame kind 'buckens', with which coordinates = 'interface' keep the "
            advice = frame + "rigid-body motion" if model.is_symmetric("K") else "hold it"  # which K pushes
            raise InputError(f"basis: K of {model.name} is singular, so the body can move freely; {advice}") from error

    def _take_flexible(self) -> bool:
        """Take X from the store, or else compute it; return whether it is from the store."""
        run = self._run
        key = {"kind": "attachment modes", **run.identity_of("M", "K")}  # of the interfaces among the nodes
        entry = run.stored(key)
        run.notes.needs("0.0", "0.0")
        if entry is not None:
            with dense(entry.block) as source, dense(self.flexible) as X:
                source.copy(X)
            return True
        solver = self._factored()
        with run.progress.stage("solve"):
            solver.solve(self._forces, self.flexible, steps=1)
        run.keep(key, Entry({}, (self.size,), self.flexible))
        return False

    def constraint_modes(self):
        """Return x (n, 6k) with f = 0 and g = I, as a new block."""
        shapes = create_block(self._run.model.K, self.size)
        self._complete(shapes, np.eye(self.size), None, beta=0.0)
        return shapes

    def solve(self, load, solution, steps=0):
        """Set solution = x with g = 0 for the columns of a load."""
        self._factored().solve(load, solution, steps)
        # twice, against what round-off leaves of the motion of the interfaces
        for f in (load, None):
            self._complete(solution, -inner(self._forces, solution), f)

    def _complete(self, block, motion, load, beta=1.0):
        """Add to the block what moves the interfaces by `motion` (6k, columns), in equilibrium with a load."""
        rigid = self._run.rigid
        count = motion.shape[1]
        pushed = np.zeros((0 if rigid is None else rigid.count, count))
        if rigid is not None and load is not None:
            pushed = -inner(rigid.R, load)
        forces, scale = np.concatenate([motion, pushed]), self._scale[:, None]
        shares = decided(self._run.model.comm, lambda: scale * np.linalg.solve(self._system, scale * forces))
        add_product(block, self.flexible, shares[: self.size], beta=beta)
        if rigid is not None:
            add_product(block, rigid.R, shares[self.size :])


def _interface_system(flexibility, rigid, interfaces):
    """Return the matrix of lambda and c, [G K^+ G^T, G R; (G R)^T, 0], scaled to a unit diagonal, and the scale;
    refused where a direction of the interfaces depends on others."""
    count = rigid.shape[1]
    scale = 1 / np.sqrt(np.maximum(np.diag(flexibility), 1e-300))
    of_rigid = 1 / np.maximum(np.linalg.norm(scale[:, None] * rigid, axis=0), 1e-300)
    scale = np.concatenate([scale, of_rigid])
    matrix = np.block([[flexibility, rigid], [rigid.T, np.zeros((count, count))]]) * np.outer(scale, scale)
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    weakest = np.abs(values).argmin()
    if np.abs(values[weakest]) < DEPENDENT_DIRECTION:
        place = int(np.abs(vectors[: len(flexibility), weakest]).argmax())
        raise InputError(
            f"interface '{interfaces[place // 6].name}': its direction {DIRECTIONS[place % 6]} cannot be moved by "
            "itself; its motion depends on other interfaces, or the set is held there"
        )
    return matrix, scale


def check_directions(model):
    """Refuse an interface whose set does not move it in all directions."""
    for interface in model.interfaces:
        if len(interface.directions) < 6:
            raise InputError(
                f"interface '{interface.name}': its set moves it in {', '.join(interface.directions)} only, but "
                "component modes and interface coordinates need all six directions; couple more directions, or take "
                "kind 'averaging'"
            )


def interface_forces(model):
    """Return G^T as a new block (n, 6k). Collective."""
    return from_dense(model.Gt.copy().convert("dense"))


def _add_constraint_modes(basis: Basis, run: Run, solver: InterfaceSolver):
    with run.progress.stage("orthogonalise"):
        extension = basis.extend(solver.constraint_modes())
    run.note("constraint modes", solver.size, extension, from_store=solver.from_store)
