"""Frequency responses of banded models with one dashpot, with 50 digits, and what last digits do to their peaks."""

import decimal
from decimal import Decimal

import numpy as np


def exact_response(K, M, D, rows, f):
    """H (2, 2) of forces and displacements at two rows, with 50 digits; the dashpot acts on the first."""
    n = len(K)
    with decimal.localcontext(prec=50):
        square = (2 * Decimal(np.pi) * Decimal(float(f))) ** 2
        A = [{j: Decimal(K[i, j]) - square * Decimal(M[i, j]) for j in range(i, min(i + 4, n))} for i in range(n)]
        X = [[Decimal(int(i == row)) for row in rows] for i in range(n)]
        for i, pivot in enumerate(A):  # elimination of a symmetric band
            for j in range(i + 1, min(i + 4, n)):
                part = pivot[j] / pivot[i]
                for k in range(j, min(i + 4, n)):
                    A[j][k] -= part * pivot[k]
                X[j] = [a - part * b for a, b in zip(X[j], X[i], strict=True)]
        for i in reversed(range(n)):
            for j in range(i + 1, min(i + 4, n)):
                X[i] = [a - A[i][j] * b for a, b in zip(X[i], X[j], strict=True)]
            X[i] = [a / A[i][i] for a in X[i]]
        rest = np.array([[float(x) for x in X[row]] for row in rows])
    damper = 2 * np.pi * f * D[rows[0], rows[0]]
    return rest - 1j * damper * np.outer(rest[:, 0], rest[0]) / (1 + 1j * damper * rest[0, 0])


def at_peaks(rom, count):
    """Frequencies (Hz) at the lowest resonances, and half a width of the peak beside them."""
    poles = np.array(sorted(rom.poles(), key=lambda pole: pole.imag))
    poles = poles[poles.imag > 0][:count]
    return ((poles.imag + np.array([[-1], [0], [1]]) * poles.real) / (2 * np.pi)).ravel()


def with_other_last_digits(K):
    """Return K with entries that are one unit in the last place larger or smaller, at random."""
    signs = np.triu(np.sign(np.random.default_rng(2).standard_normal(K.shape)))
    return K * (1 + np.finfo(float).eps * (signs + np.triu(signs, 1).T))
