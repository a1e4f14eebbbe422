"""Follow the poles of a small second-order model over a parameter, from value to value, through crossings.

Poles of the upper half plane and real ones are followed; each stands for its conjugate too. Of a model with Maxwell
elements those with a damping ratio above RELAXING are not: they are relaxations of the elements, some of which turn
slowly by gyroscopic forces. Two values are compared by the modal assurance criterion of state vectors (x, lambda x) in
the energy norm of the first value, in which the modes of an undamped gyroscopic model are orthogonal, and where that
does not decide by the distance of poles. A step between values is halved until each pole has one successor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy
from scipy.linalg import eigh, polar

SURE = 0.8  # of the modal assurance criterion: no second pole has so much
SAME = 1e-6  # relative distance of poles that count as one
NARROW = 1e-3  # of a frequency: modes that come so close and keep their shapes cross
FINEST = 2.0**-14  # of the whole range: the smallest step
REAL = 1e-9  # of the largest pole: imaginary parts below it are none
ZERO = 1e-7  # of the largest pole: double zeros, which the root of round-off spreads
RELAXING = 0.9  # damping ratio beyond which poles of a model with Maxwell elements are left out
UNDAMPED = 1e-13  # of the largest pole: real parts below it are none


@dataclass(frozen=True, eq=False)
class Poles:
    """The poles (u,) of a value of the parameter, imaginary parts of at least 0, with their displacements `shapes`
    (m, u) and their `states` (2m, u), of length 1 in the energy norm. `single` (u,): whether no other pole is the
    same. `size`: the largest absolute value of all."""

    value: float
    poles: np.ndarray
    shapes: np.ndarray
    states: np.ndarray
    single: np.ndarray
    size: float


class PoleTracker:
    """Follows the poles of s^2 M + s D + K. `matrices(value)`: M, D, K (m, m) there, in the same coordinates for all
    values, and MaxwellStates in these if there are some. `limit`: frequency in rad/s above which it does not matter
    which pole follows which."""

    def __init__(self, matrices, first: float, limit: float):
        self.matrices, self.limit = matrices, limit
        M, _, K = (np.asarray(matrix, dtype=float) for matrix in matrices(first)[:3])
        squares, vectors = eigh((K + K.T) / 2, (M + M.T) / 2)
        squares = np.maximum(np.abs(squares), 1e-12 * np.abs(squares).max() or 1.0)
        self._to_modes = vectors.T @ ((M + M.T) / 2)
        self._roots = np.sqrt(squares)[:, None]

    def at(self, value: float) -> Poles:
        """Return the poles of a value, not compared with others."""
        # A of the states (x, x' / scale), and those of Maxwell elements
        M, D, K, *elements = self.matrices(value)
        size = len(M)
        to_acceleration = np.linalg.solve(M, np.hstack([K, D]))
        scale = np.sqrt(np.linalg.norm(to_acceleration[:, :size])) or 1.0  # states x, x' / scale have like numbers
        if elements:
            A = elements[0].state_matrix(np.linalg.inv(M), D, K)
            A[:, size : 2 * size] *= scale
            A[size : 2 * size] /= scale
        else:
            A = np.block([[np.zeros((size, size)), scale * np.eye(size)],
                          [-to_acceleration[:, :size] / scale, -to_acceleration[:, size:]]])  # fmt: skip
        # poles but for round-off of real and imaginary parts, without relaxations, of each pair the upper one
        s, vectors = np.linalg.eig(A)
        largest = np.abs(s).max(initial=0.0)
        s = np.where(np.abs(s.imag) <= REAL * largest, s.real, s)
        if elements:
            moving = -s.real <= np.maximum(RELAXING * np.abs(s), ZERO * largest)
            s, vectors = s[moving], vectors[:, moving]
            largest = np.abs(s).max(initial=0.0)
        s = np.where(np.abs(s.real) <= UNDAMPED * largest, 1j * s.imag, s)
        upper = np.flatnonzero(s.imag >= 0)
        upper = upper[np.lexsort((s[upper].real, s[upper].imag))]
        s, shapes = s[upper].astype(complex), vectors[:size, upper]
        # states (x, s x) of unit energy
        modal = self._to_modes @ shapes
        states = np.concatenate([self._roots * modal, s * modal])
        length = np.linalg.norm(states, axis=0)
        poles = Poles(value, s, shapes / length, states / length, np.ones(len(s), dtype=bool), largest)
        return _orthonormal(poles)

    def next(self, before: Poles, value: float) -> tuple[Poles, np.ndarray, bool]:
        """Return the poles of a value, the place there of each pole before (-1: none), and whether these are sure."""
        after = self.at(value)
        direct, turned = (np.abs(before.states.conj().T @ x) ** 2 for x in (after.states, after.states.conj()))
        alike = np.maximum(direct, turned)
        apart = np.abs(before.poles[:, None] - after.poles)
        apart = np.minimum(apart / np.maximum(np.abs(before.poles)[:, None], 1e-300), 1.0)
        rows, columns = scipy.optimize.linear_sum_assignment(0.01 * apart - alike)
        places = np.full(len(before.poles), -1)
        places[rows] = columns
        of_before, of_after = _together(before.poles) @ alike, alike @ _together(after.poles)
        sure = np.maximum(of_before, of_after)[rows, columns] >= SURE
        matters = (np.abs(before.poles[rows].imag) <= self.limit) | (np.abs(after.poles[columns].imag) <= self.limit)
        ends = before.poles[rows[matters]], after.poles[columns[matters]]
        exchanged = _exchanged(*ends, (turned > direct)[rows[matters], columns[matters]])
        return _continued(after, before, places), places, bool((sure | ~matters).all()) and not exchanged

    def over(self, values) -> tuple[list[Poles], list[np.ndarray], list[float]]:
        """Return the poles at ascending `values` and those between that were needed, the branch of each pole as arrays
        of numbers, and the values where the smallest step did not decide."""
        smallest = FINEST * (values[-1] - values[0])
        steps, unsure = [self.at(values[0])], []
        branches = [np.arange(len(steps[0].poles))]
        count, waiting = len(branches[0]), list(values[:0:-1])
        while waiting:
            before, value = steps[-1], waiting[-1]
            after, places, sure = self.next(before, value)
            if not sure and value - before.value > smallest:
                waiting.append((before.value + value) / 2)
                continue
            if not sure:
                unsure.append(value)
            numbers = np.full(len(after.poles), -1)
            numbers[places[places >= 0]] = branches[-1][places >= 0]
            new = numbers < 0
            numbers[new] = count + np.arange(new.sum())
            count += int(new.sum())
            steps.append(after)
            branches.append(numbers)
            waiting.pop()
        return steps, branches, unsure

    def growth(self, value: float) -> tuple[float, complex]:
        """Return the largest real part of the poles below the limit, less what is round-off, and that pole."""
        return growth_of(self.at(value), self.limit)


def growth_of(poles: Poles, limit: float) -> tuple[float, complex]:
    """Return the largest real part of the poles below a limit (rad/s), less what is round-off, and that pole."""
    chosen = poles.poles[np.abs(poles.poles.imag) <= limit]
    if not len(chosen):
        return -np.inf, 0j
    # a double zero, of rigid-body motion, is spread by the root of round-off
    margin = np.where(np.abs(chosen) < ZERO * poles.size, np.inf, 1e-10 * np.abs(chosen) + 1e-12 * poles.size)
    growth = chosen.real - margin
    worst = int(np.argmax(growth))
    return float(growth[worst]), complex(chosen[worst])


def _exchanged(before, after, turned) -> bool:
    """Test whether frequencies of poles change their order, or pass zero and become those of their conjugates
    (`turned`), in a step that is too large to tell whether they cross, or meet and part again with other shapes or
    with growth."""
    size = np.maximum.outer(before.imag, before.imag)
    gaps = [np.subtract.outer(poles.imag, poles.imag) for poles in (before, after)]
    gaps = [np.where(np.abs(gap) > SAME * size, gap, 0.0) for gap in gaps]
    cross = (gaps[0] * gaps[1] < 0) & (np.abs(gaps).sum(axis=0) > NARROW * size)
    passes = turned & (before.imag * after.imag > 0) & (before.imag + after.imag > NARROW * size.max(initial=0.0))
    return bool(cross.any() or passes.any())


def _together(poles):
    """Return which poles (u, u) are the same."""
    size = np.maximum(np.abs(poles), 1e-300)
    return (np.abs(poles[:, None] - poles) <= SAME * np.maximum(size[:, None], size)).astype(float)


def _groups(poles):
    """Yield the places of poles that are the same, where there are two or more."""
    left = set(range(len(poles)))
    for k, row in enumerate(_together(poles)):
        group = [j for j in np.flatnonzero(row) if j in left]
        if k in left and len(group) > 1:
            yield np.array(group)
            left -= set(group)


def _orthonormal(poles: Poles) -> Poles:
    """Return the poles with orthonormal states for those that are the same, whose vectors are any mixture."""
    shapes, states, single = poles.shapes.copy(), poles.states.copy(), poles.single.copy()
    for group in _groups(poles.poles):
        single[group] = False
        q, r = np.linalg.qr(states[:, group])
        if np.abs(np.diag(r)).min() > 1e-6:  # else there is one vector for all
            states[:, group] = q
            shapes[:, group] = np.linalg.solve(r.T, shapes[:, group].T).T
    return replace(poles, shapes=shapes, states=states, single=single)


def _continued(after: Poles, before: Poles, places) -> Poles:
    """Return the poles with vectors that continue those before, where poles coincide and any mixture is one."""
    source = np.full(len(after.poles), -1)
    source[places[places >= 0]] = np.flatnonzero(places >= 0)
    shapes, states, single = after.shapes.copy(), after.states.copy(), after.single.copy()
    for group in _groups(after.poles):
        origin = source[group]
        if (origin < 0).any():
            continue
        turn = states[:, group].conj().T @ before.states[:, origin]
        if np.linalg.svd(turn, compute_uv=False).min() < SURE:
            continue
        turn = polar(turn)[0]
        states[:, group], shapes[:, group] = states[:, group] @ turn, shapes[:, group] @ turn
        single[group] = before.single[origin]
    return replace(after, shapes=shapes, states=states, single=single)


def damping_ratios(poles) -> np.ndarray:
    """Return -Re / |s| of poles s; 0 for s = 0."""
    size = np.abs(poles)
    return np.where(size > 0, -np.real(poles) / np.where(size > 0, size, 1.0), 0.0) + 0 * size
