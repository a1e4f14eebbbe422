"""Compress a projected model to the few combinations of its coordinates that the tolerance asks for."""

from __future__ import annotations

import numpy as np

from ...model.operator import times
from ...parallel.decisions import Place, Team, decided
from ...parallel.failures import agreed
from ...parallel.petsc import MPI
from . import refinement
from .error_estimate import CLEAR, WORTH_SHARING, Comparison
from .pseudo_modal import columns

LARGE = 1e6  # error that counts as any other above it
BALANCES = (1.0, 0.1, 10.0, 0.01, 100.0)  # of the states of inputs beside those of outputs, where these are others
LITTLE = 1e-3  # of the goal: errors that are no matter
WIDE = 0.1  # of the goal: error of the columns that a refinement combines
EACH = 8  # of so many frequencies one, at which round-off of plain subtraction is looked at
AT_A_TIME = 2**10  # columns of states whose products are in the cache
TIE = 0.01  # by how much the first input or output counts less than the last, so that equal directions have an order


def _inverse(scales, tops):
    """Return 1 / scales; a scale of 0 counts as the largest of its column, `tops`."""
    return 1 / np.where(scales > 0, scales, np.where(tops > 0, tops, 1.0))


class States:
    """What columns have to span of one model: states A^-1 L Lb / g and A^-T L Lc / h with the scales of the measure, of
    `pair.outer` at frequencies (S,), weighted where the error is large, without what is in the span of the columns
    `fixed` (m, c); where outputs are measured as C = B^T and A is symmetric only the first.

    `outward`: from coordinates of the model to those of the columns, and `inward` back (m, m), where they are others.
    Inputs and outputs begin with slightly different weights: singular values of a symmetric body come in equal pairs,
    of which round-off would choose the directions where the number of columns parts them. Local. They are those of all
    frequencies by whole(), or a share of them: the others are told first what all have in common.
    """

    def __init__(self, pair: Comparison, frequencies, fixed=None, outward=None, inward=None):
        self.pair, self.frequencies, self._fixed = pair, frequencies, fixed
        self._outward, self._inward = outward, inward
        self._H, drive = pair.outer.responses_once(frequencies)
        self._scales, self._noise = pair.measure.scales(self._H, drive), None
        self._same = pair.outer.is_reciprocal and pair.outer.io.measured_are_same

    @classmethod
    def whole(cls, *arguments, **more) -> States:
        """Return states at all frequencies."""
        states = cls(*arguments, **more)
        states.balance(states.solve(states.tops()))
        return states

    def tops(self) -> list[np.ndarray]:
        """Return the largest scales of outputs (r,) and inputs (p,)."""
        return [scales.max(axis=0, initial=0.0) for scales in self._scales]

    def solve(self, tops) -> np.ndarray:
        """Compute the states; returns the sums of squares of those of outputs and of inputs (2,)."""
        model, (h, g) = self.pair.outer, map(_inverse, self._scales, tops)
        right = model.solve(self.frequencies, model.B) * g[:, None, :]
        states = [right]
        if not self._same:
            left = model.solve(self.frequencies, model.Ct, transposed=True)
            states.append(model.io.rates.transposed(2j * np.pi * self.frequencies, left) * h[:, None, :])
        squares = np.array([np.linalg.norm(each) ** 2 for each in reversed(states)])
        states = np.concatenate(states, axis=2)
        if self._fixed is not None:
            states = states - times(self._fixed, times(self._fixed.T, states))
        self._states, self._inputs, self._width = columns(states), right.shape[2], states.shape[2]
        return squares

    def balance(self, squares) -> tuple[float, ...]:
        """Give inputs and outputs equal parts, of which only the product has a meaning, unless there is nothing of one;
        `squares`: see solve, of all frequencies. Returns weights of inputs that are to be tried."""
        self._even = 1 + TIE * np.linspace(0.0, 1.0, self._width)
        if not self._same and all(squares):
            ratio = (squares[0] / squares[1]) ** 0.25
            self._even[: self._inputs] *= ratio
            self._even[self._inputs :] /= ratio
        self.reset()
        return BALANCES[:1] if self._same else BALANCES

    def reset(self, balance=1.0):
        """Weight all frequencies alike, and the states of inputs by `balance` of those of outputs."""
        self._weights = np.tile(self._even, (len(self.frequencies), 1))
        self._weights[:, : self._inputs] *= balance

    def gram(self) -> np.ndarray:
        """Return the Gram matrix of the rows (m, m) of the weighted states."""
        weights, gram = np.tile(self._weights.ravel(), 2), np.zeros((len(self._states), len(self._states)))
        for start in range(0, len(weights), AT_A_TIME):
            some = slice(start, start + AT_A_TIME)
            flat = self._states[:, some] * weights[some]
            gram += flat @ flat.T
        return gram if self._outward is None else self._outward @ gram @ self._outward.T

    def noise(self, span) -> float:
        """Return the round-off of plain subtraction, for a model on orthonormal columns."""
        inside, at = self._inside(span), self.frequencies[::EACH]
        wrong = self._H[::EACH] - inside.inner.quick_response(at) - inside.difference(at)
        measure = self.pair.measure
        each = measure.scaled(wrong, *(scales[::EACH] for scales in self._scales))
        return float(np.nanmax(measure.total(each), initial=0.0))

    def error(self, span, noise=None) -> float:
        """Return the largest error of a model on orthonormal columns; `noise`: see noise(), by default that of the
        first columns."""
        if noise is None:
            noise = self._noise = self.noise(span) if self._noise is None else self._noise
        inside, measure = self._inside(span), self.pair.measure
        plain = self._H - inside.inner.quick_response(self.frequencies)
        each = measure.scaled(plain, *self._scales)
        # plain subtraction is quick, and serves where its round-off is no matter; a NaN, as at 0 Hz, does not compare
        if not measure.total(each).max(initial=0.0) > CLEAR * noise:
            each = measure.scaled(inside.difference(self.frequencies), *self._scales)
        self._each = np.minimum(each, LARGE)
        return measure.total(self._each).max(initial=0.0)

    def _inside(self, span) -> Comparison:
        return self.pair.within(span if self._inward is None else np.linalg.qr(self._inward @ span)[0])

    def largest_part(self) -> float:
        """Return the largest error of an input or output, of the model whose error was asked for last."""
        return self._parts().max(initial=0.0)

    def weight(self, largest: float):
        """Give weight to where that error is large, compared with the `largest`."""
        self._weights *= np.sqrt(0.05 + self._parts() / max(largest, 1e-300))

    def _parts(self):
        of_inputs, of_outputs = self._each.max(axis=1), self._each.max(axis=2)
        return of_inputs if self._same else np.hstack([of_inputs, of_outputs])


class Snapshots:
    """What columns have to span, beside those that are `fixed` (m, c): `states` of some models, of which each rank of
    `comm` has its share. Collective."""

    balances = BALANCES[:1]  # of several models more weights of inputs would take as many times as long

    def __init__(self, states: list[States], fixed, comm):
        self.fixed, self.size, self._states, self._comm = fixed, len(fixed), states, comm

    def reset(self, balance=1.0):
        """Weight all frequencies alike (see States.reset)."""
        for states in self._states:
            states.reset(balance)

    def leading(self) -> np.ndarray:
        """Return all directions (m, m), the leading ones first."""
        with agreed(self._comm):
            gram = sum(states.gram() for states in self._states)
        gathered = self._comm.gather(gram)
        return decided(self._comm, lambda: _directions(sum(gathered), self.fixed))

    def error(self, U) -> float:
        """Return the largest error of a model on the columns that are fixed and U."""
        span = joined(self.fixed, U)
        with agreed(self._comm):
            error = max((states.error(span) for states in self._states), default=0.0)
        return self._comm.allreduce(float(error), op=MPI.MAX)

    def largest_part(self) -> float:
        """Return the largest error of an input or output, of the model whose error was asked for last."""
        mine = max((states.largest_part() for states in self._states), default=0.0)
        return self._comm.allreduce(float(mine), op=MPI.MAX)

    def weight(self, largest: float):
        """Give weight to where that error is large, compared with the `largest`."""
        for states in self._states:
            states.weight(largest)


class SharedSnapshots:
    """The same of one model, of whose frequencies (S,) each rank of the team of `pair` has its share; on the rank that
    decides."""

    def __init__(self, pair: Comparison, frequencies, fixed):
        self.fixed, self.size, self._noise = fixed, len(fixed), None
        work = len(frequencies) * len(pair.outer) ** 2 * pair.outer.io.inputs.shape[1]
        self._team = pair.team if work >= WORTH_SHARING and len(frequencies) >= pair.team.size else Team()
        # what scales and sizes of states have in common at all frequencies
        tops = self._team.each(_begun, pair, frequencies, fixed)
        squares = self._asked("solve", [np.max(tops_of_one, axis=0) for tops_of_one in zip(*tops, strict=True)])
        self.balances = self._asked("balance", sum(squares))[0]

    def _asked(self, method, *arguments) -> list:
        return self._team.each(_of_states, method, *arguments)

    def reset(self, balance=1.0):
        """Weight all frequencies alike (see States.reset)."""
        self._asked("reset", balance)

    def leading(self) -> np.ndarray:
        """Return all directions (m, m), the leading ones first."""
        return _directions(sum(self._asked("gram")), self.fixed)

    def error(self, U) -> float:
        """Return the largest error of a model on the columns that are fixed and U."""
        span = joined(self.fixed, U)
        if self._noise is None:
            self._noise = max(self._asked("noise", span))
        return float(np.max(self._asked("error", span, self._noise)))  # which is NaN if one is

    def largest_part(self) -> float:
        """Return the largest error of an input or output, of the model whose error was asked for last."""
        return float(np.max(self._asked("largest_part")))

    def weight(self, largest: float):
        """Give weight to where that error is large, compared with the `largest`."""
        self._asked("weight", largest)


def _begun(place: Place, pair, frequencies, fixed):
    place.made.clear()  # the states of the compression before
    place.made["states"] = States(pair, place.share(frequencies), fixed)
    return place.made["states"].tops()


def _of_states(place: Place, method, *arguments):
    return getattr(place.made["states"], method)(*arguments)


def _directions(gram, fixed):
    """Return all directions (m, m) of a Gram matrix beside those that are fixed (m, c), the leading ones first."""
    rest = np.eye(len(gram)) - fixed @ fixed.T
    gram = rest @ gram @ rest
    return np.linalg.eigh((gram + gram.T) / 2)[1][:, ::-1]


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
    snapshots = SharedSnapshots(pair, frequencies, fixed)
    best = fewest(snapshots, goal, rounds, most)
    if most is not None or not rounds or not refinement.is_for(pair.outer):
        return best
    snapshots.reset()
    wide = joined(fixed, _first(snapshots, snapshots.leading(), WIDE * goal))
    return refinement.refined(snapshots, pair, frequencies, wide, best, goal)


def joined(first, others) -> np.ndarray:
    """Return orthonormal columns that span two blocks of them, orthogonal to each other but for round-off."""
    return np.linalg.qr(np.hstack([first, others]))[0] if first.shape[1] else others
