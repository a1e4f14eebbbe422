"""Diagonalise small symmetric pencils (K, M) whose M may be singular: motions without mass. Everything is local."""

from __future__ import annotations

import numpy as np

MASSLESS = 1e-10  # of x^T (M + tau^2 K) x: x^T M x up to it is none, for the motion is static far beyond the band


def squared_frequencies(stiffnesses: np.ndarray, masses: np.ndarray | None) -> np.ndarray:
    """Return omega^2 (m,) of coordinates with stiffnesses (m,) and masses (m,), by default 1: infinite without mass."""
    if masses is None:
        return stiffnesses
    return np.where(masses > MASSLESS, stiffnesses / np.maximum(masses, MASSLESS), np.inf)


def with_masses(K: np.ndarray, M: np.ndarray, tau: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return X (m, m) with X^T (M + tau^2 K) X = I that makes both matrices diagonal, with these diagonals of K,
    ascending, and of M."""
    G = M + tau**2 * K
    scale = 1 / np.sqrt(np.diag(G))
    factor = np.linalg.inv(np.linalg.cholesky(G * np.outer(scale, scale))).T * scale[:, None]
    inner = factor.T @ K @ factor
    stiffnesses, vectors = np.linalg.eigh((inner + inner.T) / 2)
    X = factor @ vectors
    return stiffnesses, np.einsum("ij,ij->j", X, M @ X), X


def massless_last(K: np.ndarray, M: np.ndarray, tau: float) -> tuple[np.ndarray, np.ndarray]:
    """Return omega^2 (m,), ascending, infinite without mass, and X (m, m) that diagonalises K and M: x^T M x = 1 with
    mass, tau^2 x^T K x = 1 without. Of an unsymmetric K the symmetric part counts."""
    stiffnesses, masses, X = with_masses((K + K.T) / 2, (M + M.T) / 2, tau)
    squares = squared_frequencies(stiffnesses, masses)
    static = ~np.isfinite(squares)
    order = np.argsort(squares, kind="stable")
    return squares[order], (X / np.sqrt(np.where(static, tau**2 * stiffnesses, masses)))[:, order]
