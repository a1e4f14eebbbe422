"""Turn added terms of Maxwell's law into states: the displacements of the dashpots of their elements.

With K_v = L L^T an element of a term is a spring factor K_v in series with a dashpot, whose displacement w follows from
time w' = L^T x - w. Together with the coordinates x these are (x, w) of a symmetric second-order model,

    [M 0] [x'']   [D    0   ] [x']   [K + c L L^T  -c L] [x]   [B]
    [0 0] [w''] + [0  c time] [w'] + [  -c L^T      c  ] [w] = [0] u,        c = factor
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...model.operator import Operator
from ...parallel.failures import InputError

RANK = 1e-14  # of the largest eigenvalue of K_v, below which it is round-off


@dataclass(frozen=True, eq=False)
class MaxwellStates:
    """Elements of added terms: `L` (m, w), the `factors` and `times` (s) of the w states."""

    L: np.ndarray
    factors: np.ndarray
    times: np.ndarray

    @property
    def size(self) -> int:
        return len(self.times)

    def state_matrix(self, inverse, D, K) -> np.ndarray:
        """Return A (2m + w, 2m + w) of (x, x', w)' = A (x, x', w), with M^-1."""
        m, w = self.L.shape
        pull = self.factors * self.L
        return np.block([
            [np.zeros((m, m)), np.eye(m), np.zeros((m, w))],
            [-inverse @ (K + pull @ self.L.T), -inverse @ D, inverse @ pull],
            [self.L.T / self.times[:, None], np.zeros((w, m)), np.diag(-1 / self.times)],
        ])  # fmt: skip

    def second_order(self, M, D, K) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return M, D, K (m + w, m + w) of the coordinates (x, w)."""
        pull = self.factors * self.L
        return (
            _beside(M, np.zeros((self.size, self.size))), _beside(D, np.diag(self.factors * self.times)),
            np.block([[K + pull @ self.L.T, -pull], [-pull.T, np.diag(self.factors)]]),
        )  # fmt: skip

    def from_rest(self, M, D, K) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return M, D, K (m + w, m + w) of the coordinates (x, w) with a mass for each: time w'' = L^T x' - w', which
        is the same for a start at rest."""
        pull, w = self.factors * self.L, self.size
        D = _beside(D, np.diag(1 / self.times))
        D[-w:, :-w] = -self.L.T / self.times[:, None]
        K = np.block([[K + pull @ self.L.T, -pull], [np.zeros((w, len(K) + w))]])
        return _beside(M, np.eye(w)), D, K


def maxwell_states(terms, where="a state space") -> MaxwellStates:
    """Return the states of added terms with matrices (m, m). Raises InputError, which names `where` they were to
    go, for laws that have none."""
    columns, factors, times = [], [], []
    for term in terms:
        if term.law.elements is None:
            raise InputError(
                f"{term.law.family}: the law of {term.name} is {term.law.nature}, which no finite number of states has "
                f"in {where}; take kind 'maxwell' with elements that follow it over the band"
            )
        values, vectors = np.linalg.eigh((term.matrix + term.matrix.T) / 2)
        kept = values > RANK * values.max(initial=0.0)
        root = vectors[:, kept] * np.sqrt(values[kept])
        for factor, time in term.law.elements:
            if factor:
                columns.append(root)
                factors += [factor] * root.shape[1]
                times += [time] * root.shape[1]
    size = max(len(term.matrix) for term in terms)
    return MaxwellStates(np.hstack([np.zeros((size, 0)), *columns]), np.array(factors), np.array(times))


def with_maxwell_states(reduced, where="a state space", from_rest=False):
    """Return a reduced model without added terms, whose last coordinates are the states, and their number; also
    of a parametric one, with its constant parts and terms, on which the states do not depend.

    By MaxwellStates.second_order, whose mass is singular, or `from_rest`. Raises InputError for laws without states.
    """
    states = maxwell_states(reduced.added, where)
    form = states.from_rest if from_rest else states.second_order
    only_x = np.eye(reduced.size, reduced.size + states.size)  # x = [I, 0] (x, w)
    wide = reduced.in_coordinates(only_x, columns=None, left_columns=None, model=None)
    changed = {}
    if hasattr(reduced, "terms"):
        square = dict(zip("MDK", form(*map(reduced.constant.get, "MDK")), strict=True))
        changed["constant"] = wide.constant | square
    return replace(wide, operator=Operator.of(*form(reduced.M, reduced.D, reduced.K)), **changed), states.size


def _beside(first, last):
    a, b = len(first), len(last)
    return np.block([[first, np.zeros((a, b))], [np.zeros((b, a)), last]])
