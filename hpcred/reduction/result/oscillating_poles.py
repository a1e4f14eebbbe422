"""Find the poles of small models with added terms, s^2 + s D + K(s) in modal coordinates, that oscillate.

No linear eigenproblem has them where a law is fractional. The eigenvalues of K(i omega), sorted, cross omega^2 at
most once each, since the parts stiffen with frequency, but less than omega^2; there Newton's method begins (Guettel and
Tisseur, Acta Numerica 26, 2017, section 4).
"""

from __future__ import annotations

import numpy as np

from ...model.operator import Operator

NODES, A_DECADE = 16, 6  # frequencies at which eigenvalues are computed, at least
MOST = 64  # poles, from the lowest, that Newton's method is run for
STEPS = 6
STILL = 1e-14  # relative step after which nothing but round-off follows
FAR = 0.3  # relative step from the first guess, beyond which another pole may have been found
ZERO = 1e-14  # of the largest eigenvalue: motions without stiffness
BEYOND = 4.0  # steps by which the range of the poles is looked for


def oscillating_poles(eigenvalues: np.ndarray, D: np.ndarray, added: Operator, eta: float = 0.0) -> np.ndarray:
    """Return the poles (k,) above the real axis in rad/s, by imaginary part.

    `eigenvalues` (m,) of the static stiffness in (rad/s)^2, V^T M V = I; `D` (m, m); `added`: terms with
    matrices (m, m); `eta`: loss factor of the static stiffness.
    """
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
    left = np.argsort(at)[:MOST]
    for guess in (first.copy(), 1j * at):  # the damping of a single mode may say too much
        if not len(left):
            break
        poles = _by_newton(eigenvalues, D, added, eta, guess[left], x[left])
        near = poles != guess[left]
        first[left[near]], left = poles[near], left[~near]
    return first[np.argsort(first.imag)]


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
    """Return poles (k,) near first guesses, with their vectors x (k, m); a guess stays where nothing is near it."""
    s, vectors = first.copy(), x.astype(complex)
    index = np.arange(len(eigenvalues))
    for _ in range(STEPS):
        A = added.at(s) + s[:, None, None] * D
        A[:, index, index] += s[:, None] ** 2 + (1 + 1j * eta) * eigenvalues
        slope = added.summed(added.slopes(s)) + D
        slope[:, index, index] += 2 * s[:, None]
        try:
            ahead = np.linalg.solve(A, slope @ vectors[:, :, None])[:, :, 0]
        except np.linalg.LinAlgError:  # at a pole
            break
        vectors = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
        rows = vectors[:, None, :]
        value, size = ((rows @ matrix @ vectors[:, :, None])[:, 0, 0] for matrix in (A, slope))
        before = s
        s = s - np.divide(value, size, out=np.zeros_like(size), where=size != 0)
        s = np.where((np.abs(s - first) < FAR * np.abs(first)) & (s.imag > 0), s, first)
        if (np.abs(s - before) <= STILL * np.abs(s)).all():
            break
    return s


