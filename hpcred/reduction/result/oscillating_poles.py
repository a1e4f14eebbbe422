"""Find the poles of small models with added terms, s^2 + s D + K(s) in modal coordinates, that oscillate.

No linear eigenproblem has them where a law is fractional. The eigenvalues of K(i omega), sorted, cross omega^2 at
most once each, since the parts stiffen with frequency, but less than omega^2; there Newton's method begins (Guettel and
Tisseur, Acta Numerica 26, 2017, section 4). Where two guesses come to one pole, others are found by deflation. Nothing
counts the poles: of those with damping ratios above some 5 % a few in a thousand may be missing.
"""

from __future__ import annotations

import numpy as np

from ...model.operator import Operator

NODES, A_DECADE = 16, 6  # frequencies at which eigenvalues are computed, at least
MOST = 64  # poles, from the lowest, that Newton's method is run for where places are enough
STEPS = 6
STILL = 1e-14  # relative step after which nothing but round-off follows
SETTLED = 1e-8  # relative step after which a pole has been found
SAME = 1e-7  # relative distance of poles that may be one
MORE_STEPS = 20
DAMPED, APART = (0.05, 0.3, 0.7), 0.5  # damping ratios with which other poles are looked for, and their differences
INDEPENDENT = 1e-3  # part of a unit vector outside of the span of others
LEAST = 1e-6  # imaginary part of a pole that oscillates, over its size
FAR = 0.3  # relative step from the first guess, beyond which another pole may have been found
ZERO = 1e-14  # of the largest eigenvalue: motions without stiffness
BEYOND = 4.0  # steps by which the range of the poles is looked for


def oscillating_poles(eigenvalues: np.ndarray, D: np.ndarray, added: Operator, eta: float = 0.0) -> np.ndarray:
    """Return the poles (k,) above the real axis in rad/s, by imaginary part: those that are found, which is nearly all.

    `eigenvalues` (m,) of the static stiffness in (rad/s)^2, V^T M V = I; `D` (m, m); `added`: terms with
    matrices (m, m); `eta`: loss factor of the static stiffness.
    """
    places, are_poles = places_of_poles(eigenvalues, D, added, eta, len(eigenvalues))
    return places[are_poles]


def places_of_poles(eigenvalues, D, added, eta=0.0, most=MOST) -> tuple[np.ndarray, np.ndarray]:
    """Return where poles are (k,), by imaginary part, and which places are poles; others are guesses by single modes,
    as all but the `most` lowest (see oscillating_poles)."""
    low, high = _range_of(eigenvalues, added)
    omega = np.geomspace(low, high, max(NODES, int(A_DECADE * np.log10(high / low))))
    stiffness = added.at(1j * omega)
    values, vectors = np.linalg.eigh(np.diag(eigenvalues) + stiffness.real)
    height = np.log(np.maximum(values, low**2 / 2)) - 2 * np.log(omega)[:, None]  # (nodes, m), descends
    falls = (height[:-1] > 0) & (height[1:] <= 0) | (height[:-1] == 0)
    mode = np.flatnonzero(falls.any(axis=0))
    node = falls[:, mode].argmax(axis=0)
    share = height[node, mode] / (height[node, mode] - height[node + 1, mode])
    at = omega[node] * (omega[node + 1] / omega[node]) ** share
    x = vectors[node, :, mode]  # (k, m)
    loss = stiffness.imag[node] + at[:, None, None] * D + eta * np.diag(eigenvalues)
    first = 1j * at * np.sqrt(1 + 1j * np.einsum("ki,kij,kj->k", x, loss, x) / at**2)
    # poles near the guesses, of which the damping of a single mode may say too much
    lowest, is_pole, x = np.argsort(at)[:most], np.zeros(len(at), dtype=bool), x.astype(complex)
    for guess in (first.copy(), 1j * at):
        left = lowest[~is_pole[lowest]]
        if len(left):
            poles, shapes, settled = _by_newton(eigenvalues, D, added, eta, guess[left], x[left])
            first[left[settled]], x[left[settled]], is_pole[left] = poles[settled], shapes[settled], settled
    # two guesses may have come to one pole: others beside those that are known
    is_pole[is_pole] = _distinct(first[is_pole], x[is_pole])
    left = lowest[~is_pole[lowest]]
    for ratio in DAMPED:
        if len(left):
            start = at[left] * np.exp(1j * (np.pi / 2 + ratio * (1 + APART * np.arange(len(left)) / len(left))))
            poles, settled = _beside(eigenvalues, D, added, eta, start, first[is_pole])
            above = settled & (poles.imag > LEAST * np.abs(poles))
            first[left[above]], is_pole[left[above]], left = poles[above], True, left[~settled]
    order = np.argsort(first.imag)
    return first[order], is_pole[order]


def _range_of(eigenvalues, added) -> tuple[float, float]:
    """Return frequencies below and above all at which an eigenvalue of K(i omega) is omega^2.

    They begin at those of the static stiffness. Parts that stiffen raise the highest ones, and what has no static
    stiffness may have a frequency below the others.
    """

    def values_at(omega):
        return np.linalg.eigvalsh(np.diag(eigenvalues) + added.at(1j * omega).real)

    above = eigenvalues[eigenvalues > ZERO * eigenvalues.max(initial=0.0)]
    low, high = (0.99 * above.min() ** 0.5, 1.01 * above.max() ** 0.5) if len(above) else (1.0, 1.0)
    while ((values := values_at(high)) > high**2).any():
        high *= BEYOND
    stiff, least = (values > ZERO * values.max(initial=0.0)).sum(), ZERO**0.5 * low
    while (values_at(low) > low**2).sum() < stiff and low > least:
        low /= BEYOND
    return low, max(high, BEYOND * low)


def _by_newton(eigenvalues, D, added, eta, first, x):
    """Return poles (k,) near first guesses with vectors x (k, m), their vectors, and which of them Newton's method has
    come to."""
    s, vectors = first.copy(), x
    settled = np.zeros(len(s), dtype=bool)
    for _ in range(STEPS):
        A, slope = _with_slope(eigenvalues, D, added, eta, s)
        try:
            ahead = np.linalg.solve(A, slope @ vectors[:, :, None])[:, :, 0]
        except np.linalg.LinAlgError:  # at a pole
            break
        vectors = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
        rows = vectors[:, None, :]
        value, size = ((rows @ matrix @ vectors[:, :, None])[:, 0, 0] for matrix in (A, slope))
        before = s
        s = s - np.divide(value, size, out=np.zeros_like(size), where=size != 0)
        near = (np.abs(s - first) < FAR * np.abs(first)) & (s.imag > 0)
        step = np.abs(s - before)
        settled = near & (step <= SETTLED * np.abs(s))
        s = np.where(near, s, first)
        if (step <= STILL * np.abs(s)).all():
            break
    return s, vectors, settled


def _with_slope(eigenvalues, D, added, eta, s):
    """Return A(s) and its derivative (k, m, m) at s (k,)."""
    index = np.arange(len(eigenvalues))
    A, slope = added.at(s) + s[:, None, None] * D, added.summed(added.slopes(s)) + D
    A[:, index, index] += s[:, None] ** 2 + (1 + 1j * eta) * eigenvalues
    slope[:, index, index] += 2 * s[:, None]
    return A, slope


def _distinct(poles, vectors):
    """Return which of the poles (k,) are not the same as others before: a multiple one has independent vectors (k, m).
    """
    distinct = np.ones(len(poles), dtype=bool)
    for k, pole in enumerate(poles):
        same = np.flatnonzero(distinct[:k] & (np.abs(poles[:k] - pole) <= SAME * np.abs(pole)))
        if len(same):
            span = np.linalg.qr(vectors[same].T)[0]
            distinct[k] = np.linalg.norm(vectors[k] - span @ (span.conj().T @ vectors[k])) > INDEPENDENT
    return distinct


def _beside(eigenvalues, D, added, eta, first, known):
    """Return poles (k,) that are others than the `known` ones and each other, real ones too, and which of them the
    iteration of Ehrlich and Aberth has come to (Bini and Noferini, Linear Algebra and its Applications 439, 2013)."""
    s, step = first.copy(), np.full(len(first), np.inf)
    for _ in range(MORE_STEPS):
        moving = np.flatnonzero(step > STILL * np.abs(s))
        if not len(moving):
            break
        A, slope = _with_slope(eigenvalues, D, added, eta, s[moving])
        try:
            of_all = np.trace(np.linalg.solve(A, slope), axis1=1, axis2=2)  # f' / f of f = det A
        except np.linalg.LinAlgError:  # at a pole
            break
        away = s[moving, None] - np.concatenate([known, s])
        of_others = np.divide(1.0, away, out=np.zeros_like(away), where=away != 0).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):  # where nothing else attracts
            change = 1 / (of_all - of_others)
        s[moving] -= change
        s.imag = np.abs(s.imag)  # of a pair the upper one
        step[moving] = np.abs(change)
    away = np.abs(s[:, None] - np.concatenate([known, s]))
    away[np.arange(len(s)), len(known) + np.arange(len(s))] = np.inf
    return s, (step <= SETTLED * np.abs(s)) & (away > SAME * np.abs(s)[:, None]).all(axis=1)
