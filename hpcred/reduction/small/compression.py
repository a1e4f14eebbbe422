"""Compress a projected model to the few combinations of its coordinates that the tolerance asks for."""

from __future__ import annotations

import numpy as np

from ...model.operator import times
from ...parallel.decisions import decided
from ...parallel.failures import agreed
from ...parallel.petsc import MPI
from ..result.measure import Measure
from . import refinement
from .error_estimate import CLEAR, Comparison
from .pseudo_modal import PseudoModal, columns

LARGE = 1e6  # error that counts as any other above it
BALANCES = (1.0, 0.1, 10.0, 0.01, 100.0)  # of the states of inputs beside those of outputs, where these are others
LITTLE = 1e-3  # of the goal: errors that are no matter
WIDE = 0.1  # of the goal: error of the columns that a refinement combines
EACH = 8  # of so many frequencies one, at which round-off of plain subtraction is looked at
TIE = 0.01  # by how much the first input or output counts less than the last, so that equal directions have an order


def snapshots(model: PseudoModal, frequencies, measure: Measure) -> np.ndarray:
    """Return states A^-1 L Lb / g and A^-T L Lc / h with the scales of a measure, (S, m, p + r); where outputs are
    measured as C = B^T and A is symmetric only the first."""
    right = model.solve(frequencies, model.B)
    h, g = measure.scales(*model.responses(frequencies))
    right *= _inverse(g)[:, None, :]
    if model.is_reciprocal and model.io.measured_are_same:
        return right
    left = model.io.rates.transposed(2j * np.pi * frequencies, model.solve(frequencies, model.Ct, transposed=True))
    left *= _inverse(h)[:, None, :]
    # only the product of the two scales has a meaning: equal parts, unless there is nothing of one
    sizes = np.linalg.norm(left), np.linalg.norm(right)
    balance = (sizes[0] / sizes[1]) ** 0.5 if all(sizes) else 1.0
    return np.concatenate([right * balance, left / balance], axis=2)


def _inverse(scales):
    """Return 1 / scales; a scale of 0 counts as the largest of its column."""
    scales = np.where(scales > 0, scales, np.where((top := scales.max(axis=0)) > 0, top, 1.0))
    return 1 / scales


class States:
    """What columns have to span of one model: states of `pair.outer` at frequencies (S,), weighted where the error is
    large, without what is in the span of the columns `fixed` (m, c).

    `outward`: from coordinates of the model to those of the columns, and `inward` back (m, m), where they are others.
    Inputs and outputs begin with slightly different weights: singular values of a symmetric body come in equal pairs,
    of which round-off would choose the directions where the number of columns parts them. Local.
    """

    def __init__(self, pair: Comparison, frequencies, fixed=None, outward=None, inward=None):
        self.pair, self.frequencies, self._outward, self._inward = pair, frequencies, outward, inward
        states = snapshots(pair.outer, frequencies, pair.measure)
        if fixed is not None:
            states = states - times(fixed, times(fixed.T, states))
        self._states, self._width = columns(states), states.shape[2]
        self._H, drive = pair.outer.responses(frequencies)
        self._scales, self._noise = pair.measure.scales(self._H, drive), None
        self._ties = 1 + TIE * np.linspace(0.0, 1.0, states.shape[2])
        self.balances = BALANCES if states.shape[2] > self._inputs else BALANCES[:1]
        self.reset()

    @property
    def _inputs(self) -> int:
        return self.pair.outer.io.inputs.shape[1]

    def reset(self, balance=1.0):
        """Weight all frequencies alike, and the states of inputs by `balance` of those of outputs."""
        self._weights = np.tile(self._ties, (len(self.frequencies), 1, 1))
        self._weights[:, :, : self._inputs] *= balance

    def gram(self) -> np.ndarray:
        """Return the Gram matrix of the rows (m, m) of the weighted states."""
        weights = self._weights.ravel()
        flat = self._states * np.tile(weights, self._states.shape[1] // len(weights))
        gram = flat @ flat.T
        return gram if self._outward is None else self._outward @ gram @ self._outward.T

    def error(self, span) -> float:
        """Return the largest error of a model on orthonormal columns."""
        inside = self.pair.within(span if self._inward is None else np.linalg.qr(self._inward @ span)[0])
        measure = self.pair.measure
        plain = self._H - inside.inner.quick_response(self.frequencies)
        each = measure.scaled(plain, *self._scales)
        # plain subtraction is quick, and serves where its round-off is no matter; a NaN, as at 0 Hz, does not compare
        if self._noise is None:
            some = slice(None, None, EACH)
            wrong = plain[some] - inside.difference(self.frequencies[some])
            of_these = measure.total(measure.scaled(wrong, *(scales[some] for scales in self._scales)))
            self._noise = float(np.nanmax(of_these, initial=0.0))
        if not measure.total(each).max() > CLEAR * self._noise:
            each = measure.scaled(inside.difference(self.frequencies), *self._scales)
        self._each = np.minimum(each, LARGE)
        return measure.total(self._each).max()

    def largest_part(self) -> float:
        """Return the largest error of an input or output, of the model whose error was asked for last."""
        return self._parts().max()

    def weight(self, largest: float):
        """Give weight to where that error is large, compared with the `largest`."""
        self._weights *= np.sqrt(0.05 + self._parts() / max(largest, 1e-300))[:, None, :]

    def _parts(self):
        of_inputs, of_outputs = self._each.max(axis=1), self._each.max(axis=2)
        return of_inputs if self._width == self._inputs else np.hstack([of_inputs, of_outputs])


class Snapshots:
    """What columns have to span, beside those that are `fixed` (m, c): `states` of some models, of which each rank of
    `comm` has its share, or of one model on this rank. Collective."""

    def __init__(self, states: list[States], fixed, comm=None):
        self.states, self.fixed, self.size, self._comm = states, fixed, len(fixed), comm or MPI.COMM_SELF
        # weights of inputs that are tried: of several models more of them would take as many times as long
        self.balances = BALANCES[:1] if comm is not None else states[0].balances
        self._rest = np.eye(self.size) - fixed @ fixed.T

    def reset(self, balance=1.0):
        """Weight all frequencies alike (see States.reset)."""
        for states in self.states:
            states.reset(balance)

    def leading(self) -> np.ndarray:
        """Return all directions (m, m), the leading ones first."""
        with agreed(self._comm):
            gram = sum(states.gram() for states in self.states)
        gathered = self._comm.gather(gram)
        return decided(self._comm, lambda: self._directions(sum(gathered)))

    def _directions(self, gram):
        gram = self._rest @ gram @ self._rest
        return np.linalg.eigh((gram + gram.T) / 2)[1][:, ::-1]

    def error(self, U) -> float:
        """Return the largest error of a model on the columns that are fixed and U."""
        span = joined(self.fixed, U)
        with agreed(self._comm):
            error = max((states.error(span) for states in self.states), default=0.0)
        return self._comm.allreduce(float(error), op=MPI.MAX)

    def largest_part(self) -> float:
        """Return the largest error of an input or output, of the model whose error was asked for last."""
        mine = max((states.largest_part() for states in self.states), default=0.0)
        return self._comm.allreduce(float(mine), op=MPI.MAX)

    def weight(self, largest: float):
        """Give weight to where that error is large, compared with the `largest`."""
        for states in self.states:
            states.weight(largest)


def fewest(snapshots, goal: float, rounds=8, most=None) -> np.ndarray:
    """Return orthonormal columns U (m, k), as few as `goal` allows for the largest error, beside the columns that are
    fixed, which are in the span of U.

    Leading left singular vectors of the snapshots. First k is found by bisection; then one column less is tried again
    and again, with the snapshots weighted anew (at most `rounds` times) where the error is large. The error is a
    product of what the columns leave of the states of inputs and of outputs: where these differ, either may take the
    larger part (BALANCES). With `most` so many columns, whatever error they have.
    """
    fixed, even = snapshots.fixed, snapshots.leading()
    if most is not None:
        return joined(fixed, even[:, : max(most - fixed.shape[1], 0)])
    best, balances = _first(snapshots, even, goal), [*snapshots.balances]
    while best.shape[1] > 1 and (found := _weighted(snapshots, best.shape[1] - 1, goal, rounds, balances)) is not None:
        best, balance = found
        balances.sort(key=lambda other: other != balance)  # what had success comes first
    return joined(fixed, best)


def _first(snapshots, directions, goal):
    """Return the first of the directions (m, m), as many as `goal` asks for, by bisection."""
    low, high = 0, snapshots.size - snapshots.fixed.shape[1]
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if snapshots.error(directions[:, :middle]) <= goal else (middle, high)
    return directions[:, :high]


def _weighted(snapshots, count, goal, rounds, balances):
    """Return so many columns whose error is within the goal, by snapshots weighted where it is large, and the balance
    of these; None without success."""
    for balance in balances:
        snapshots.reset(balance)
        for _ in range(rounds):
            U = snapshots.leading()[:, :count]
            if snapshots.error(U) <= goal:
                return U, balance
            snapshots.weight(snapshots.largest_part())
    return None


def compressed(pair: Comparison, frequencies, goal: float, fixed=None, rounds=8, most=None) -> np.ndarray:
    """Return orthonormal columns U (m, k) of the coordinates of `pair.outer`, as few as `goal` allows for the largest
    error over the frequencies (S,); the orthonormal columns `fixed` (m, c) are in their span (see fewest). They are
    refined where A(s) is not diagonal, unless `rounds` is 0 or `most` is given."""
    fixed = np.zeros((len(pair.outer), 0)) if fixed is None else fixed
    snapshots = Snapshots([States(pair, frequencies, fixed)], fixed)
    best = fewest(snapshots, goal, rounds, most)
    if most is not None or not rounds or not refinement.is_for(pair.outer):
        return best
    snapshots.reset()
    wide = joined(fixed, _first(snapshots, snapshots.leading(), WIDE * goal))
    return refinement.refined(snapshots, wide, best, goal)


def joined(first, others) -> np.ndarray:
    """Return orthonormal columns that span two blocks of them, orthogonal to each other but for round-off."""
    return np.linalg.qr(np.hstack([first, others]))[0] if first.shape[1] else others
