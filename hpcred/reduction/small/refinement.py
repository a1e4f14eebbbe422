"""Turn the columns of a compression by nonlinear least squares, until fewer of them reach the same error.

Damping that is not proportional gives the states over the band real and imaginary parts of different directions. Their
singular vectors span both as well as so many columns can, but the error of the responses is what counts, a product of
two residuals, and other columns may have it smaller. With states x = U y of the model on orthonormal columns U, and

    y = (U^T A U)^-1 U^T B,   r = B - A U y,      z = (U^T A U)^-T U^T C^T,   l = C^T - A^T U z,

the response H_U = C U y of that model changes with U by

    dH_U = l^T dU y + z^T dU^T r,

for which only changes dU orthogonal to U matter (Grassmann manifold). Levenberg-Marquardt steps, with the damping of
H. B. Nielsen (1999), let the p-norm of all errors fall, p = POWER, which comes near to their maximum.

Everything is dense NumPy and local. The columns are combinations of those of a compression to a smaller error, so that
unknowns are few.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...model.operator import times
from .pseudo_modal import NUMBERS_AT_A_TIME, PseudoModal

POWER = 6  # of the errors whose sum is to fall
STEPS = 50  # of a number of columns that is tried
FIRST_DAMPING = 1e-2  # of the diagonal of the normal equations
WORK = 5e8  # multiplications for the normal equations of a step, above which fewer columns are not tried
EACH = 3  # of the frequencies, at which columns are turned first
HOPELESS = 2.0  # times the goal: what is left at few frequencies, after which all of them are not tried
NOTICED = 0.05  # of the largest error: smaller ones weigh less than 1e-5 of it in the normal equations


def is_for(model: PseudoModal) -> bool:
    """Return whether columns of a model are to be refined: where damping is not proportional, or K has a skew part, and
    its projection is a model."""
    return (bool(model.operator) or model.N is not None) and not model.damping.higher


def refined(snapshots, pair, frequencies, wide, best, goal: float) -> np.ndarray:
    """Return orthonormal columns (m, k), combinations of `wide` (m, w) and as few as the goal allows for the error of
    `snapshots` (see compression.SharedSnapshots), those of `pair` at frequencies (S,); `best` (m, k) if fewer are not
    found.

    The columns `wide` are orthonormal and in the order of what they matter, those that stay in the span first.
    """
    kept, w = snapshots.fixed.shape[1], wide.shape[1]
    if len(frequencies) * w * w > NUMBERS_AT_A_TIME:
        return best
    errors = Errors(pair, frequencies, wide, kept)
    few = Errors(pair, frequencies[::EACH], wide, kept)
    for count in range(best.shape[1] - 1, kept, -1):
        if not errors.are_finite or errors.count * ((w - count) * (count - kept)) ** 2 > WORK:
            break
        # at few frequencies, which ask for less, and at all of them from there, or from the start
        start = np.eye(w)[:, :count]
        begun = _turned(few, start, goal)
        if begun.largest > HOPELESS * goal:
            break
        found = _turned(errors, begun.U, goal) if begun.largest <= goal else begun
        found = _turned(errors, start, goal) if found.largest > goal else found
        if found.largest > goal or snapshots.error((wide @ found.U)[:, kept:]) > goal:
            break
        best = wide @ found.U
    return best


class Iterate(NamedTuple):
    """The model on columns U (w, k): its errors (S, q), the `largest` that the measure makes of them, and y, r, z, l
    (S, ...) of the head of this module."""

    U: np.ndarray
    errors: np.ndarray
    largest: float
    y: np.ndarray
    r: np.ndarray
    z: np.ndarray
    l: np.ndarray


class Errors:
    """Errors of models on combinations of columns `wide` (m, w), in the scales of the measure of `pair`, at frequencies
    (S,) in Hz; the first `fixed` of the columns stay in the span. Local."""

    def __init__(self, pair, frequencies, wide, fixed=0):
        outer, s = pair.outer, 2j * np.pi * frequencies
        self.fixed, self._measure = fixed, pair.measure
        self._same = outer.is_reciprocal and outer.io.measured_are_same
        # A(s) is a sum of few terms: products with U are made of theirs, which do not depend on s
        self._terms = outer.terms().projected(wide)
        self._factors = outer.factors(frequencies)
        self._B = np.broadcast_to(wide.T @ outer.B, (len(s), wide.shape[1], outer.B.shape[1]))
        columns = np.broadcast_to(wide.T @ outer.Ct, (len(s), wide.shape[1], outer.Ct.shape[1]))
        self._Ct = outer.io.rates.transposed(s, columns)
        h, g = pair.measure.scales(*outer.responses(frequencies))
        scale = h[:, :, None] * g[:, None, :]
        self._scale = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
        self._X = _solved(self._terms.summed(self._factors), self._B)
        self._rest = pair.within(wide).difference(frequencies)
        # responses of reciprocal models come in equal pairs
        every = np.indices(scale.shape[1:]).reshape(2, -1)
        self._of = np.triu_indices(scale.shape[1]) if self._same else (every[0], every[1])

    @property
    def count(self) -> int:
        """How many real numbers the errors are."""
        return 2 * len(self._B) * len(self._of[0])

    @property
    def are_finite(self) -> bool:
        """Whether there are responses at all frequencies, as a free body has none at 0 Hz."""
        return bool(np.isfinite(self._X).all() and np.isfinite(self._rest).all())

    def at(self, U) -> Iterate:
        """Return the model on orthonormal columns U (w, k)."""
        A = self._terms.projected(U).summed(self._factors)
        y = _solved(A, U.T @ self._B)
        r = self._B - self._applied(lambda T: T @ U, y)
        z, l = y, r
        if not self._same:
            z = _solved(A.transpose(0, 2, 1), U.T @ self._Ct)
            l = self._Ct - self._applied(lambda T: T.T @ U, z)
        # H - H_U without its cancellation
        E = (self._rest + l.transpose(0, 2, 1) @ (self._X - U @ y)) * self._scale
        j, i = self._of
        return Iterate(U, E[:, j, i], float(self._measure.total(np.abs(E)).max()), y, r, z, l)

    def _applied(self, product, states) -> np.ndarray:
        """Return the sum of the terms, as `product` makes them of matrices, times states (S, k, l)."""
        return sum(factor[:, None, None] * times(product(term.matrix), states)
                   for factor, term in zip(self._factors, self._terms, strict=True))  # fmt: skip

    def derivative(self, at: Iterate, N, of) -> np.ndarray:
        """Return the derivative (e, (w - k) (k - fixed)) of the errors that a mask `of` (S, q) takes, for changes N d
        of the columns U that are not fixed, N (w, w - k) orthogonal to U, d (w - k, k - fixed)."""
        s, q = np.nonzero(of)
        j, i = self._of[0][q], self._of[1][q]
        y, z, r, l = at.y[:, self.fixed :], at.z[:, self.fixed :], N.T @ at.r, N.T @ at.l
        l, r = l[s, :, j] * -self._scale[s, j, i][:, None], r[s, :, i] * -self._scale[s, j, i][:, None]
        return (l[:, :, None] * y[s, :, i][:, None] + r[:, :, None] * z[s, :, j][:, None]).reshape(len(s), -1)


def _turned(errors: Errors, start, goal):
    """Return the model on columns (w, k) with errors within a goal, by steps from those to start with, or the best that
    was found."""
    here, damping, growth, system = errors.at(start), FIRST_DAMPING, 2.0, None
    for _ in range(STEPS):
        if here.largest <= goal:
            break
        if system is None:
            top = np.abs(here.errors).max()
            if not np.isfinite(top):
                break
            N = np.linalg.qr(here.U, mode="complete")[0][:, here.U.shape[1] :]
            noticed = np.abs(here.errors) > NOTICED * top
            system = _normal_equations(here.errors[noticed] / top, errors.derivative(here, N, noticed) / top)
            if not np.isfinite(system[0]).all() or not system[0].any():  # beyond single precision: no step is known
                break
            before = _sum_of_powers(here, top)
        matrix, gradient = system
        diagonal = np.diag(matrix)
        step = -np.linalg.solve(matrix + np.diag(damping * diagonal + 1e-12 * diagonal.max()), gradient)
        new = here.U.copy()
        new[:, errors.fixed :] += N @ step.reshape(N.shape[1], -1)
        there = errors.at(np.linalg.qr(new)[0])
        after = _sum_of_powers(there, top)
        if after < before:
            gain = (before - after) / max(-(gradient @ step) - step @ matrix @ step / 2, 1e-300)
            damping *= max(1 / 3, 1 - (2 * min(gain, 1.0) - 1) ** 3)
            here, growth, system = there, 2.0, None
        else:
            damping, growth = damping * growth, 2 * growth
    return here


def _sum_of_powers(at: Iterate, top):
    """Return the sum of |e / top|^p / p."""
    return float((np.abs(at.errors / top) ** POWER).sum()) / POWER


def _normal_equations(e, J) -> tuple[np.ndarray, np.ndarray]:
    """Return matrix and gradient of sum |e|^p / p for complex errors e (N,) with derivatives J (N, u), but for second
    derivatives of e: p - 1 times as stiff along e as across it."""
    size = np.abs(e)
    along = J * (size ** (POWER / 2 - 1) * np.exp(-1j * np.angle(e)))[:, None]
    gradient = along.real.T @ size ** (POWER / 2)
    # in single precision, as a step is tried before it is taken; contiguous: the BLAS makes half of a symmetric product
    real, imaginary = along.real.astype(np.float32), along.imag.astype(np.float32)
    return ((POWER - 1) * (real.T @ real) + imaginary.T @ imaginary).astype(float), gradient


def _solved(A, right):
    """Return A^-1 right (S, k, l), infinite where any A is singular."""
    try:
        return np.linalg.solve(A, right)
    except np.linalg.LinAlgError:
        return np.full(right.shape, np.inf, dtype=complex)
