"""Extend a basis by second-order Krylov subspaces (47-50) in two-level orthogonal form.

The blocks R_0 = A^-1 B, R_1 = -A^-1 (2 s M + D) R_0, R_l = -A^-1 ((2 s M + D) R_(l-1) + M R_(l-2)) are the moments of
(s^2 M + s D + K)^-1 B. The pairs (R_l, R_(l-1)) are a Krylov sequence of the linearised system; they are kept as
coefficients in an orthonormal basis Q of all R_l, and the coefficients are orthonormalised as well (TOAR: Lu, Su and
Bai, SIAM J. Matrix Anal. Appl. 37(1), 2016). The bare recurrence would lose everything but the dominant modes.
"""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ...linalg.basis import ComplexBasis
from ...linalg.blocks import add_product, as_pairs, create_block, inner, times, unfold
from ...linalg.solvers.base import MOVES_FREELY, SingularMatrix
from ...model.damping import caughey_terms
from ...parallel.decisions import decided
from ...parallel.declared import as_declared
from ...parallel.failures import InputError
from .component import PointComponent
from .krylov import Krylov, Order, laplace, point_name
from .krylov_sequence import KrylovSequence
from .point_blocks import PointBlocks

SMALL = 1e-13  # singular value below which a direction of the coefficients is dependent


@dataclass(frozen=True)
class SecondOrderKrylov(PointComponent):
    """Blocks of the second-order Krylov subspace at s = decay + i 2 pi frequency, or at `s`, for any damping matrix.

    With viscoelastic parts c(s) is linear from the point on, so that blocks 0 and 1 match. The real and the imaginary
    part of each block both enter the real basis (50), so that a complex point gives twice the columns and its conjugate
    is matched as well.

    Parameters
    ----------
    frequency : float, optional
        Hz.
    decay : float, optional
        Laplace variable in 1/s.
    order : int
        It adds order + 1 blocks.
    s : tuple of two floats, optional
        (re, im) in rad/s, in place of the two.
    """

    kind: Literal["second_order_krylov"] = field(default="second_order_krylov", kw_only=True, repr=False)
    frequency: float | None = None
    decay: float | None = None
    order: Order = 0
    s: tuple[float, float] | None = None

    def __post_init__(self):
        as_declared(self, "second_order_krylov.")
        if self.frequency is None and self.decay is None and self.s is None:
            raise InputError("second_order_krylov: expected a point: frequency (Hz), decay (1/s), or s = [re, im]")
        self.point  # noqa: B018  (refused early)

    @property
    def point(self) -> complex:
        """The expansion point s."""
        return laplace(self.kind, self.frequency, self.decay, self.s)

    def columns(self, inputs: int, rigid: int) -> int:
        """Return the number of vectors before deflation."""
        return (2 if self.point.imag else 1) * inputs * (self.order + 1)

    def complex_shift(self, damped: bool) -> bool:
        return bool(self.point.imag) and (damped or bool(self.point.real))

    def blocks(self, run) -> PointBlocks:
        """Return the blocks of the point. Collective. Raises InputError where the point is a pole."""
        s, model = self.point, run.model
        if caughey_terms(run.framed.damping) is not None:
            raise InputError(
                "second_order_krylov: a Caughey series with more than two terms has no sparse damping matrix; "
                "it is proportional, so that kind 'krylov' fits"
            )
        if model.D is None and not model.added:
            # without damping these R_l are combinations of (A^-1 M)^k A^-1 B, k <= l: the same span
            return Krylov(s.imag / 2 / np.pi, self.order, s.real or None).blocks(run)
        sequence = SecondOrderSequence(run, s, wanted=self.order + 1)
        try:
            return sequence.blocks(self.order + 1, f"second-order krylov {point_name(s)}")
        except SingularMatrix as error:
            raise InputError(
                f"second_order_krylov: the point {point_name(s)} is a pole of the model"
                + (f", whose K is singular: {MOVES_FREELY}" if s == 0 else "")
            ) from error


class SecondOrderSequence(KrylovSequence):
    """The blocks R_l of the second-order Krylov subspace at `s`.

    `upper` and `lower` (size, b): coefficients of R_l and R_(l-1); `states` (2 size, total): all so far. `scale`: time
    is in units of 1 / scale, |s| in general, which makes both halves of the states weigh alike.
    """

    kind = ComplexBasis
    rule = "second order"

    def __init__(self, run, s, wanted=None):
        self._s, self._scale = s, abs(s)
        self._upper = self._lower = self._states = None
        key = run.identity_of("M", "K", "D", "damping", "transposed", "inputs")
        super().__init__(run, wanted, s=[s.real, s.imag], **key)
        self.labels = (str(s.real**2), str(s.real)) if self._is_real() else (str(s * s), str(s))

    def _is_real(self):
        real = self._s.imag == 0 and (self._s == 0 or self.run.rigid is None)
        return real and (self._s == 0 or not self.run.model.added)

    def _load_columns(self):
        return self.run.loads.getActiveColumns()[1]

    def _factor(self):
        s, run = self._s, self.run
        if self._is_real():
            return run.solvers.factored(s.real**2, point_name(s), s.real)
        solver = run.solvers.complex()
        with run.progress.stage("factor", point_name(s), solver.known):
            solver.factor_at(s)
            return solver

    def _next_load(self):
        """Return -((2 s M + D) Q upper + M Q lower) as pairs."""
        model = self.run.model
        if not self.ends:
            return as_pairs(self.run.loads, model.K)
        s, scale, upper, lower = self._s, self._scale, self._upper, self._lower
        columns = upper.shape[1]
        load = create_block(model.K, 2 * columns)
        terms = [(model.M, scale * (2 * s * upper + scale * lower))]
        if model.D is not None:
            terms.append((model.D, scale * upper))
        for term in model.added:
            if s or term.law.elements is not None:  # others have no derivative at 0
                terms.append((term.matrix, scale * term.law.slope(s) * upper))
        for mat, coefficients in terms:
            combined = create_block(model.K, 2 * columns)
            add_product(combined, self.vectors.columns, unfold(coefficients), beta=0.0)
            add_product(load, times(mat, combined), np.eye(2 * columns), alpha=-1.0)
        return load

    def _took(self, load, block):
        model = self.run.model
        self._scale = self._scale or _rayleigh_frequency(load, block, model.M)
        new = self.vectors.coefficients(block)
        self._upper, self._lower, self._states = decided(model.comm, _next_state, new, self._upper, self._states)
        self.complete = not self._upper.shape[1]

    def _offers(self, columns):
        return columns if self._s.imag else columns // 2

    def _state(self):
        return {"upper": self._upper, "lower": self._lower, "states": self._states, "scale": np.array(self._scale)}

    def _go_on_from(self, state):
        self._upper, self._lower, self._states = (state[key] for key in ("upper", "lower", "states"))
        self._scale = float(state["scale"])


def _rayleigh_frequency(load, block, mass):
    """Return sqrt(x^T K x / x^T M x) in rad/s of the static deflections x = K^-1 load."""
    square = np.trace(inner(load, block)) / np.trace(inner(block, times(mass, block)))
    return float(np.sqrt(abs(square)))


def _next_state(new, upper, states):
    """Return orthonormal coefficients of the next pairs (R_l, R_(l-1)), and all of them so far.

    `new` (size, b): the new block in terms of Q; `upper`: what it came from. Returns the upper and lower half of
    the new states (size, b'), and all states (2 size, total).
    """
    size = len(new)
    before = np.zeros((size, new.shape[1]), dtype=complex)
    if upper is not None:
        before[: len(upper)] = upper
    state = np.concatenate([new, before])
    if states is None:
        states = np.zeros((2 * size, 0), dtype=complex)
    else:
        half = len(states) // 2
        padded = np.zeros((2 * size, states.shape[1]), dtype=complex)
        padded[:half], padded[size : size + half] = states[:half], states[half:]
        states = padded
    norms = np.linalg.norm(state, axis=0)
    state = state / np.where(norms > 0, norms, 1.0)
    for _ in range(2):
        state = state - states @ (states.conj().T @ state)
    left, values, _ = np.linalg.svd(state, full_matrices=False)
    state = left[:, values > SMALL]
    return state[:size], state[size:], np.concatenate([states, state], axis=1)
