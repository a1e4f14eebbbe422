"""A big projected model and an accuracy enter; the few combinations of its coordinates that reach it leave."""

from __future__ import annotations

import numpy as np

from .pseudo_modal import (
    Law,
    PseudoModal,
    difference,
    is_symmetric,
    norms,
    relative,
    response,
    restricted,
    solve,
    times,
)

LARGE = 1e6  # relative error that counts as any other above it, such as one at a zero of the response


def columns(states: np.ndarray) -> np.ndarray:
    """Real and imaginary parts of states (S, m, l) side by side: (m, 2 S l), or (m, S l) of real ones."""
    flat = states.transpose(1, 0, 2).reshape(states.shape[1], -1)
    return np.hstack([flat.real, flat.imag]) if np.iscomplexobj(flat) else flat


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
