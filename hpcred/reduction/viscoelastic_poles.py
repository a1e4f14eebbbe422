"""Find the poles of small models with viscoelastic parts, s^2 + s D + K(s) in modal coordinates, that oscillate.

No linear eigenproblem has them where a law is fractional. The eigenvalues of K(i omega), sorted, cross omega^2 once
each, since the parts stiffen with frequency; there Newton's method begins (Guettel and Tisseur, Acta Numerica 26, 2017,
section 4).
"""

from __future__ import annotations

import numpy as np

from ..model.viscoelastic import added_stiffness

NODES = 16  # frequencies at which eigenvalues are computed
MOST = 64  # poles, from the lowest, that Newton's method is run for
STEPS = 6
FAR = 0.3  # relative step from the first guess, beyond which another pole may have been found
ZERO = 1e-14  # of the largest eigenvalue: motions without stiffness


def oscillating_poles(eigenvalues: np.ndarray, D: np.ndarray, parts, eta: float = 0.0) -> np.ndarray:
    """Return the poles (k,) above the real axis in rad/s, by imaginary part, up to the frequencies of the model.

    `eigenvalues` (m,) of the static stiffness in (rad/s)^2, V^T M V = I; `D` (m, m); `parts`: Viscoelastic with
    matrices (m, m); `eta`: loss factor of the static stiffness.
    """
    above = eigenvalues[eigenvalues > ZERO * eigenvalues.max(initial=0.0)]
    if not len(above):
        return np.zeros(0, dtype=complex)
    omega = np.geomspace(np.sqrt(above.min()), 1.01 * np.sqrt(above.max()), NODES)
    added = added_stiffness(parts, 1j * omega)
    values, vectors = np.linalg.eigh(np.diag(eigenvalues) + added.real)
    height = np.log(np.maximum(values, above.min() / 2)) - 2 * np.log(omega)[:, None]  # (nodes, m), descends
    falls = (height[:-1] > 0) & (height[1:] <= 0) | (height[:-1] == 0)
    mode = np.flatnonzero(falls.any(axis=0))
    node = falls[:, mode].argmax(axis=0)
    part = height[node, mode] / (height[node, mode] - height[node + 1, mode])
    at = omega[node] * (omega[node + 1] / omega[node]) ** part
    x = vectors[node, :, mode]  # (k, m)
    loss = added.imag[node] + at[:, None, None] * D + eta * np.diag(eigenvalues)
    first = 1j * at * np.sqrt(1 + 1j * np.einsum("ki,kij,kj->k", x, loss, x) / at**2)
    few = np.argsort(at)[:MOST]
    first[few] = _by_newton(eigenvalues, D, parts, eta, first[few], x[few])
    return first[np.argsort(first.imag)]


def _by_newton(eigenvalues, D, parts, eta, first, x):
    """Return poles (k,) near first guesses, with their vectors x (k, m); a guess stays where nothing is near it."""
    s, vectors = first.copy(), x.astype(complex)
    index, matrices = np.arange(len(eigenvalues)), np.array([part.matrix for part in parts])
    for _ in range(STEPS):
        A = added_stiffness(parts, s) + s[:, None, None] * D
        A[:, index, index] += s[:, None] ** 2 + (1 + 1j * eta) * eigenvalues
        slopes = np.array([part.law.slope(s) for part in parts])
        slope = np.tensordot(slopes.T, matrices, axes=1) + D
        slope[:, index, index] += 2 * s[:, None]
        try:
            ahead = np.linalg.solve(A, slope @ vectors[:, :, None])[:, :, 0]
        except np.linalg.LinAlgError:  # at a pole
            break
        vectors = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
        value, size = (np.einsum("ki,kij,kj->k", vectors, matrix, vectors, optimize=True) for matrix in (A, slope))
        s = s - np.divide(value, size, out=np.zeros_like(size), where=size != 0)
        s = np.where((np.abs(s - first) < FAR * np.abs(first)) & (s.imag > 0), s, first)
    return s


