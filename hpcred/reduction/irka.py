"""Reduce by the iterative rational Krylov algorithm for second-order models (IRKA).

Each turn interpolates H at mirrored poles of the last reduced model, in the directions of their residues; where the
points stay as they are, the first-order conditions of the H2 norm hold as far as the second-order form lets them:
S. Wyatt, Issues in interpolatory model reduction, Virginia Tech (2012), chapter 4; S. Gugercin, A. Antoulas and
C. Beattie, SIAM J. Matrix Anal. Appl. 30(2) (2008). It needs damping: without it the mirrored poles are poles.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from ..linalg.blocks import add_product, create_block, from_dense
from ..model.damping import Damping, NoDamping, Structural, damping_or_given
from ..model.frames import Frame
from ..model.second_order_model import require_model
from ..parallel.decisions import decided
from ..parallel.declared import as_declared
from ..parallel.failures import InputError
from ..parallel.messages import message
from ..parallel.progress import counted
from ..parallel.ranges import Band
from .components.component import Component
from .reduce import reduce
from .reductor import Reductor
from .result.massless import first_order
from .result.reduced_model import ReducedModel

DAMPED = 1e-9  # least damping ratio of a pole whose mirror image can be a point


@dataclass(frozen=True, kw_only=True)
class TangentialPoints(Component):
    """A(s)^-1 B b for each point s (1/s, as real and imaginary part) and its direction b (p numbers, likewise).

    `outputs`: the directions of C^T in the place of B, for a two-sided projection. Real and imaginary parts both enter,
    so that the conjugate point is matched too (50).
    """

    kind: Literal["tangential_points"] = field(default="tangential_points", repr=False)
    points: tuple[tuple[float, float], ...]
    inputs: tuple[tuple[tuple[float, float], ...], ...]
    outputs: tuple[tuple[tuple[float, float], ...], ...]

    @property
    def point(self) -> complex:
        """The point farthest from 0."""
        return max((complex(*s) for s in self.points), key=abs)

    def columns(self, inputs: int, rigid: int) -> int:
        return 2 * len(self.points)

    def complex_shift(self, damped: bool) -> bool:
        return True

    def extend(self, basis, run) -> None:
        solver, kept = run.solvers.complex(), 0
        with run.progress.stage("solve"):
            loads = from_dense(run.model.B)
            load, solution = (create_block(run.model.K, 2) for _ in range(2))
            for s, weights in zip(self.points, self.outputs if run.is_dual else self.inputs, strict=True):
                add_product(load, loads, np.array(weights), beta=0.0)
                solver.factor(complex(*s) ** 2, complex(*s))
                solver.solve(load, solution)
                kept += basis.extend(solution).kept
        run.note("tangential points", 2 * len(self.points), kept)


@dataclass(frozen=True, kw_only=True)
class IRKA(Reductor):
    """Iterative rational Krylov algorithm, which seeks a small error in the H2 norm over all frequencies.

    Where outputs are not the inputs the projection is two-sided, and may make an unstable model of a stable one: the
    record warns of it.

    Parameters
    ----------
    size : int
        Coordinates, an even number, for half as many resonances.
    band : tuple of two floats
        Hz, where the first points lie; no band of accuracy, which a reduction to a tolerance has.
    frame, damping : Frame and Damping, optional
        As for `reduce`.
    change : float
        It ends where no point moves by more than this part of itself.
    turns : int
        It ends after so many, which the record warns of.
    """

    size: int
    band: Band
    frame: Frame | None = None
    damping: Damping | None = None
    change: float = 1e-6
    turns: int = 50

    def __post_init__(self):
        as_declared(self, "irka.")
        if self.size < 2 or self.size % 2:
            raise InputError(f"irka.size: found {self.size}, expected an even number of at least 2")
        if not (self.change > 0 and self.turns >= 1):
            raise InputError(f"irka: found change = {self.change}, turns = {self.turns}, expected more than 0")

    def reduce(self, model) -> ReducedModel:
        """Reduce a SecondOrderModel. Collective. Raises InputError for a model without viscous damping."""
        # viscous damping, whose poles have mirror images, and outputs that are displacements
        require_model(model)
        damping = damping_or_given(model, self.damping)
        if isinstance(damping, NoDamping | Structural):
            raise InputError(f"irka: found the damping '{damping.kind}', expected a viscous one, such as Rayleigh: "
                             "poles without it have no mirror image; or reduce to a tolerance")  # fmt: skip
        if model.rates:
            raise InputError("irka: found outputs that are velocities or accelerations, expected displacements; reduce "
                             "to a tolerance")  # fmt: skip
        if model.added:
            raise InputError(f"irka: {model.name} has {model.added.plural}, and poles that are not those of a "
                             "quadratic form; reduce to a tolerance")  # fmt: skip
        # points and directions of the next model are mirrored poles and residues of the last one, until they stay
        two_sided = {"projection": "two_sided", "allow_unstable": True} if model.Ct is not None else {}
        points, inputs, outputs = self._first(model)
        reduced, moved = None, np.inf
        for _ in range(self.turns):
            if reduced is not None:
                reduced.close()
            before, basis = points, TangentialPoints(points=pairs(points), inputs=pairs(inputs), outputs=pairs(outputs))
            reduced = reduce(model, basis, self.frame, self.damping, **two_sided)
            points, inputs, outputs = decided(model.comm, mirrored, reduced, self.size // 2)
            if len(points) == len(before):
                moved = np.abs(points - before).max() / np.abs(before).max()
                if moved <= self.change:
                    return reduced
        said = f"irka: after {counted(self.turns, 'turn')} points still move by {moved:.1e} of themselves"
        if model.comm.rank == 0:
            message(logging.WARNING, said)
        return replace(reduced, record=replace(reduced.record, warnings=(*reduced.record.warnings, said)))

    def _first(self, model):
        """Return points over the band with a damping ratio of 2 %, and one input and output after the other."""
        count = self.size // 2
        omega = 2 * np.pi * np.linspace(self.band[0], self.band[1], count + 2)[1:-1]
        turn = np.arange(count)
        inputs, outputs = len(model.input_names), len(model.output_names)
        return omega * (0.02 + 1j), np.eye(inputs)[turn % inputs], np.eye(outputs)[turn % outputs]


def mirrored(reduced: ReducedModel, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return -conj(pole) of the `count` most dominant poles with Im >= 0, by frequency, and the directions (count, p)
    and (count, r) of their residues. Raises InputError where one has no damping."""
    states = first_order(replace(reduced, Cv=None, Ca=None))
    poles, right = np.linalg.eig(states["A"])
    left = np.linalg.inv(right)
    b, c = left @ states["B"], (states["C"] @ right).T  # the residues are c_i b_i
    upper = np.flatnonzero(poles.imag >= 0)
    sharp = np.abs(poles.real[upper]) < DAMPED * np.abs(poles[upper])
    if sharp.any():
        raise InputError(
            f"irka: the model has a pole without damping at {np.abs(poles[upper][sharp][0]) / 2 / np.pi:.4g} Hz, whose "
            "mirror image is itself; give damping, or reduce to a tolerance"
        )
    strength = np.linalg.norm(b[upper], axis=1) * np.linalg.norm(c[upper], axis=1) / np.abs(poles.real[upper])
    chosen = upper[np.argsort(-strength)[:count]]
    chosen = chosen[np.argsort(poles[chosen].imag)]
    b, c = (weights[chosen] / np.linalg.norm(weights[chosen], axis=1, keepdims=True) for weights in (b, c))
    return np.abs(poles[chosen].real) + 1j * poles[chosen].imag, b.conj(), c.conj()


def pairs(values) -> tuple:
    """Return complex numbers as pairs of real and imaginary part, in nested tuples."""
    if np.ndim(values):
        return tuple(map(pairs, values))
    return float(np.real(values)), float(np.imag(values))
