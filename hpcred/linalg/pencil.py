"""Diagonalise small symmetric pencils (K, M) whose M may be singular: motions without mass. Everything is local."""

from __future__ import annotations

import numpy as np

MASSLESS = 1e-10  # of x^T (M + tau^2 K) x: x^T M x up to it is none, for the motion is static far beyond the band
LEAST_MASS = 1e-7  # that coordinates without mass are given, for poles; the refinement of solves has the rest


def squared_frequencies(stiffnesses: np.ndarray, masses: np.ndarray | None, tau: float) -> np.ndarray:
    """Return omega^2 (m,) of coordinates with stiffnesses (m,) and masses (m,), by default 1; without mass the least
    that counts as such, 1 / (MASSLESS tau^2)."""
    if masses is None:
        return stiffnesses
    return np.where(masses > MASSLESS, stiffnesses / np.maximum(masses, MASSLESS), 1 / (MASSLESS * tau**2))


def with_masses(K: np.ndarray, M: np.ndarray, tau: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return X (m, m) with X^T (M + tau^2 K) X = I that makes both matrices diagonal, with these diagonals of K,
    ascending, and of M. Raises LinAlgError where that matrix is not positive definite."""
    G = M + tau**2 * K
    scale = 1 / np.sqrt(np.where(np.diag(G) > 0, np.diag(G), 1.0))
    factor = np.linalg.inv(np.linalg.cholesky(G * np.outer(scale, scale))).T * scale[:, None]
    inner = factor.T @ K @ factor
    stiffnesses, vectors = np.linalg.eigh((inner + inner.T) / 2)
    X = factor @ vectors
    return stiffnesses, np.einsum("ij,ij->j", X, M @ X), X


def massless_last(K: np.ndarray, M: np.ndarray, tau: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Return omega^2 (m,), ascending, X (m, m) that diagonalises K and M, and how many of its last columns have no
    mass: x^T M x = 1 with mass, tau^2 x^T K x = 1 without. Of an unsymmetric K the symmetric part counts."""
    stiffnesses, masses, X = with_masses((K + K.T) / 2, (M + M.T) / 2, tau)
    squares, static = squared_frequencies(stiffnesses, masses, tau), masses <= MASSLESS
    order = np.lexsort((squares, static))
    scale = np.sqrt(np.where(static, tau**2 * stiffnesses, masses))
    return squares[order], (X / scale)[:, order], int(static.sum())


def time_of(K: np.ndarray, M: np.ndarray) -> float:
    """Return a time tau (s) of small matrices K, M (m, m), by their stiffest coordinate with mass."""
    moving = np.diag(M) > 0
    ratio = np.divide(np.abs(np.diag(K)), np.diag(M), out=np.zeros(len(K)), where=moving).max(initial=0.0)
    return 1 / np.sqrt(ratio) if ratio else 1.0


def modes_of(K: np.ndarray, M: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return omega^2 (m,), ascending, and X (m, m) of small matrices K, of which the symmetric part counts, and M,
    which may be singular (see massless_last)."""
    from scipy.linalg import eigh  # which most models do without

    if (np.diag(M) > 0).all():
        try:
            return eigh((K + K.T) / 2, M)
        except np.linalg.LinAlgError:  # some combination has no mass
            pass
    return massless_last(K, M, time_of(K, M))[:2]
