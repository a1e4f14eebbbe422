"""A big projected model and an accuracy enter; the few combinations of its coordinates that reach it leave."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..parallel.failures import InputError
from .error_estimate import finer, grid, largest, resolved
from .judging import Judge
from .pseudo_modal import (
    Law,
    PseudoModal,
    columns,
    difference,
    is_symmetric,
    norms,
    relative,
    response,
    restricted,
    solve,
    times,
    worst_pair,
)

TRIALS = 5  # compressions, each with the frequencies where the one before was too bad, until the big model is kept
LARGE = 1e6  # relative error that counts as any other above it, such as one at a zero of the response


def snapshots(model: PseudoModal, law: Law, frequencies, ports) -> np.ndarray:
    """States A^-1 L Lb and A^-T L Lc over |H|^(1/2), (S, m, p + r); with C = B^T and symmetric A only the first."""
    Lb, Lc = ports
    right = solve(model, law, frequencies, model.L @ Lb)
    size = norms(response(model, law, frequencies, ports))
    scale = np.where(size > 0, size, size.max(initial=0.0) or 1.0) ** -0.5
    right *= scale[:, None, None]
    if Lb is Lc and is_symmetric(model.D):
        return right
    left = solve(model, law, frequencies, model.L @ Lc, transposed=True) * scale[:, None, None]
    # C and B may have any units: equal parts
    balance = (np.linalg.norm(left) / np.linalg.norm(right)) ** 0.5
    return np.concatenate([right * balance, left / balance], axis=2)


def compressed(model: PseudoModal, law: Law, frequencies, ports, goal: float, fixed=None, rounds=8, most=None):
    """Orthonormal columns U (m, k), as few as `goal` allows for max |H_Q - H_U| / |H_Q| over the frequencies (S,).

    Leading left singular vectors of the snapshots, beside the orthonormal columns `fixed` (m, c), which are in the span
    of U. First k is found by bisection; then one column less is tried again and again, with the snapshots weighted anew
    (at most `rounds` times) where the error is large. With `most` so many columns, whatever error they have.
    """
    fixed = np.zeros((len(model.squares), 0)) if fixed is None else fixed
    states = snapshots(model, law, frequencies, ports)
    states = states - times(fixed, times(fixed.T, states))
    H = response(model, law, frequencies, ports)

    def leading(weights):
        flat = columns(states * weights[:, None, None])
        return np.linalg.eigh(flat @ flat.T)[1][:, ::-1]

    def error(U):
        inner, embedding = restricted(model, joined(fixed, U), law)
        return np.minimum(relative(difference(inner, model, embedding, law, frequencies, ports), H), LARGE)

    even = leading(np.ones(len(frequencies)))
    if most is not None:
        return joined(fixed, even[:, : max(most - fixed.shape[1], 0)])
    low, high = 0, len(model.squares) - fixed.shape[1]
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if error(even[:, :middle]).max() <= goal else (middle, high)
    best = even[:, :high]
    while best.shape[1] > 1:
        weights, U = np.ones(len(frequencies)), even[:, : best.shape[1] - 1]
        for _ in range(rounds):
            curve = error(U)
            if curve.max() <= goal:
                break
            weights *= np.sqrt(0.05 + curve / curve.max())
            U = leading(weights)[:, : U.shape[1]]
        else:
            break
        best = U
    return joined(fixed, best)


def joined(first, others) -> np.ndarray:
    """Orthonormal columns that span two blocks of them, orthogonal to each other but for round-off."""
    return np.linalg.qr(np.hstack([first, others]))[0] if first.shape[1] else others


class Restricted(NamedTuple):
    """A model on combinations of the coordinates of a big one (`embedding`), and its error against that (`curve`, (S,))
    at frequencies (S,)."""

    model: PseudoModal
    embedding: np.ndarray
    frequencies: np.ndarray
    curve: np.ndarray


class Compressed(NamedTuple):
    """What a search ends with: the `factor` (m, k) from the basis to the columns of the reduced model, its highest
    pseudo-frequency, its error against the big model, the noise of the two, output and input (from 0) whose response is
    worst by itself, with its error; and why the tolerance is not reached, or ""."""

    factor: np.ndarray
    highest: float
    frequencies: np.ndarray
    curve: np.ndarray
    noise: float
    worst_pair: tuple[int, int, float]
    reason: str


def compress(judge: Judge, reason: str, drop_above: float | None, kept: list[int]) -> Compressed:
    """The few combinations of a basis that the tolerance asks for, after a search; local.

    `reason`: why the search ended before the tolerance was reached, or "". The columns `kept` of the basis stay in the
    span. Pseudo-modes above `drop_above` (Hz) are left out, and what that does to the error counts. Raises InputError.
    """
    law, ports, eps = judge.projections.law, judge.projections.ports, judge.settings.tolerance
    outer, est, noise = judge.projections.model(), judge.rest, judge.noise
    goal = max(0.9 * eps - est - noise, 0.3 * eps, noise) if not reason else max(0.9 * eps, min(0.5 * est, 1.0))
    found, limited = _reach(judge, outer, goal, outer.vectors[kept].T)
    reason = reason or limited
    if drop_above is not None and found.model.frequencies[-1] > drop_above:
        found = _without_modes_above(drop_above, found, outer, law, ports)
        if not reason and found.curve.max() + est + noise > eps:
            reason = f"without the pseudo-frequencies above {drop_above:g} Hz (drop_above)"
    H = response(outer, law, found.frequencies, ports)
    E = difference(found.model, outer, found.embedding, law, found.frequencies, ports)
    roundoff = H - response(found.model, law, found.frequencies, ports) - E
    return Compressed(
        outer.vectors @ found.embedding, float(found.model.frequencies.max()), found.frequencies, found.curve,
        max(noise, float(relative(roundoff, H).max())), worst_pair(H, H - E), reason,
    )  # fmt: skip


def _reach(judge, outer, goal, fixed) -> tuple[Restricted, str]:
    """The smallest model whose error stays below the goal between the frequencies as well, and why the size that was
    asked for does not let it, or ""; `fixed`: see compressed()."""
    settings, law, ports, noise = judge.settings, judge.projections.law, judge.projections.ports, judge.noise
    S, limited, most = grid([outer], law, settings.band), "", settings.size
    if most is not None and fixed.shape[1]:  # interface coordinates, which those of rigid-body motion join
        most -= judge.projections.run.framed.rigid_size
    for trial in range(TRIALS + 1):
        U = compressed(outer, law, S, ports, goal, fixed) if trial < TRIALS else np.eye(len(outer.squares))
        if most is not None and U.shape[1] > most:
            limited = f"with {settings.size} coordinates"
            U = compressed(outer, law, S, ports, 0.0, fixed, most=most)
        inner, embedding = restricted(outer, U, law)
        fine = finer(grid([outer, inner], law, settings.band), 4)
        fine, curve = largest(inner, outer, embedding, law, fine, ports)
        if curve.max() <= 1.02 * goal:
            fine, curve = resolved(inner, outer, embedding, law, fine, curve, ports, 3 * noise)
        if curve.max() <= 1.02 * goal or most == U.shape[1]:
            break
        S = np.unique(np.concatenate([S, fine[curve > 0.8 * goal]]))
    return Restricted(inner, embedding, fine, curve), limited


def _without_modes_above(limit, found: Restricted, outer, law, ports) -> Restricted:
    kept = found.model.frequencies <= limit
    if not kept.any():
        raise InputError(f"drop_above: no pseudo-frequency lies below {limit:g} Hz")
    inner, turn = restricted(found.model, np.eye(len(kept))[:, kept], law)
    embedding = found.embedding @ turn
    return Restricted(inner, embedding, *largest(inner, outer, embedding, law, found.frequencies, ports))
