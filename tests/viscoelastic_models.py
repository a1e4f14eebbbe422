"""Small models with viscoelastic parts, and their dense truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpcred import SecondOrderModel, Viscoelastic
from hpcred.laws import Fractional, FractionalKelvinVoigt, Maxwell

MAXWELL = Maxwell(factors=[2.0, 5.0, 1.0], times=[1e-2, 3e-4, 2e-5], constant=0.4)
ZENER = Fractional(low=0.5, high=40.0, time=1e-5, exponent=0.6)
SPRINGPOT = FractionalKelvinVoigt(low=1.0, rise=0.2, time=1e-3, exponent=0.4)


def law_at(law, s):
    """g(s) as the textbooks have it."""
    if isinstance(law, Maxwell):
        return law.constant + sum(g * s * t / (1 + s * t) for g, t in zip(law.factors, law.times, strict=True))
    z = (s * law.time) ** law.exponent if s else 0.0
    if isinstance(law, Fractional):
        return (law.low + law.high * z) / (1 + z)
    return law.low + law.rise * z


@dataclass
class Sandwich:
    """K_e, M, D (n, n) or None, B (n, p), Ct (n, r) or None, and pairs of K_v and law."""

    K: np.ndarray
    M: np.ndarray
    B: np.ndarray
    parts: list
    D: np.ndarray | None = None
    Ct: np.ndarray | None = None

    def model(self, comm):
        more = {} if self.Ct is None else {"outputs": self.Ct}
        more |= {"inputs": self.B, "name": "sandwich"}
        with SecondOrderModel.from_scipy(self.K, self.M, self.D, comm, **more) as elastic:
            return elastic.with_viscoelastic([Viscoelastic(Kv, law) for Kv, law in self.parts])

    def stiffness(self, s):
        return self.K + sum(law_at(law, s) * Kv for Kv, law in self.parts)

    def dynamic(self, s, eta=0.0):
        D = 0.0 if self.D is None else self.D
        return s * s * self.M + s * D + self.stiffness(s) + 1j * eta * self.stiffness(0.0)

    def truth(self, frequencies, eta=0.0):
        """H (F, r, p), and b_i^T A^-1 b_i (F, p)."""
        C = self.B if self.Ct is None else self.Ct
        H, drive = [], []
        for f in frequencies:
            A = self.dynamic(2j * np.pi * f, eta)
            X = np.linalg.solve(A, self.B.astype(complex))
            X += np.linalg.solve(A, self.B - A @ X)
            H.append(C.T @ X)
            drive.append((self.B * X).sum(axis=0))
        return np.array(H), np.array(drive)


def chain_matrix(springs):
    """Stiffness (n, n) of springs in a row, the first to the ground."""
    n = len(springs)
    K = np.diag(springs) + np.diag(np.append(springs[1:], 0.0))
    return K - np.diag(springs[1:], 1) - np.diag(springs[1:], -1) if n > 1 else K


def sandwich(laws=(ZENER,), n=40, inputs=1, seed=3, outputs=0, damped=False) -> Sandwich:
    """Two coupled chains, whose links between them and mount are viscoelastic: frequencies of about 20 to 3000 Hz."""
    random = np.random.default_rng(seed)
    half = n // 2
    k = 2e6 * random.uniform(0.5, 2.0, half)
    lower, upper = chain_matrix(k), chain_matrix(np.append(0.0, k[1:]))
    K, none = np.zeros((n, n)), np.zeros((half, half))
    K[:half, :half], K[half:, half:] = lower, upper
    core = np.diag(3e5 * random.uniform(0.5, 2.0, half))
    link = np.block([[core, -core], [-core, core]])
    mount = np.zeros((n, n))
    mount[half - 1, half - 1], mount[n - 1, n - 1] = 2e6, 1e6
    M = np.diag(random.uniform(0.05, 0.2, n))
    B, Ct = random.standard_normal((n, inputs)), random.standard_normal((n, outputs)) if outputs else None
    matrices = [link, mount, np.block([[lower, none], [none, none]])]
    D = 2e-5 * K + np.diag(np.where(np.arange(n) == 4, 30.0, 0.0)) if damped else None
    return Sandwich(K, M, B, list(zip(matrices[: len(laws)], laws, strict=True)), D, Ct)
