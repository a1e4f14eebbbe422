"""Reduce random small models to a tolerance, and compare what is claimed with dense solves.

    python benchmarks/hunt.py [KIND ...] [--seeds 0:40] [--json FILE]

One line for each model whose claim is false (its true error is above the estimate, or above the tolerance that is said
to be reached), that is refused, or whose tolerance is not reached; then a table. A kind is a function of a random
generator that returns a Case; it is in KINDS by its name. The exit status is 1 where a claim was false.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

import hpcred

UNIFORM = 400  # frequencies over the band, beside those around poles
ROUND_OFF = 1e-10  # of the dense solves
ROOM = 1.05  # of an estimate: the true error between the frequencies that it was taken at


@dataclass
class Case:
    """A dense model, what it is asked for, and arguments of hpcred.reduce."""

    M: np.ndarray
    K: np.ndarray
    B: np.ndarray
    band: tuple[float, float]
    tolerance: float
    D: np.ndarray | None = None
    C: np.ndarray | None = None
    more: dict = field(default_factory=dict)
    circulatory: bool = False

    def model(self) -> hpcred.SecondOrderModel:
        """Return the model; close it."""
        more = {"circulatory": True} if self.circulatory else {}
        return hpcred.SecondOrderModel(self.M, self.D, self.K, self.B, self.C, **more)

    def dynamic(self, s, eta) -> np.ndarray:
        """Return A(s) with the loss factor eta and the damping that is asked for."""
        damping = self.more.get("damping")
        A = s * s * self.M + (1 + 1j * eta) * self.K
        if isinstance(damping, hpcred.Rayleigh):
            return A + s * (damping.alpha * self.M + damping.beta * self.K)
        return A if self.D is None or isinstance(damping, hpcred.NoDamping | hpcred.Structural) else A + s * self.D

    def responses(self, frequencies, eta):
        """Return H (S, r, p) and the drive points b^T A^-1 b (S, p)."""
        C = self.B.T if self.C is None else self.C
        states = [np.linalg.solve(self.dynamic(2j * np.pi * f, eta), self.B) for f in frequencies]
        return np.array([C @ x for x in states]), np.array([np.einsum("ij,ij->j", self.B, x) for x in states])


def frequencies_of(case, rom, eta) -> np.ndarray:
    """Return places of the band where errors may be large: uniform ones, and around poles of both models."""
    low, high = case.band
    one = np.eye(len(case.M))
    D = (case.dynamic(1.0, 0.0) - case.dynamic(-1.0, 0.0)).real / 2
    s0 = 2 * np.pi * high  # by A - s0 E, which is regular where M is not
    A = np.block([[-s0 * one, one], [-(1 + 1j * eta) * case.K, -D - s0 * case.M]])
    E = np.block([[one, 0 * one], [0 * one, case.M]])
    inverses = np.linalg.eigvals(np.linalg.solve(A, E))
    poles = s0 + 1 / inverses[np.abs(inverses) > 1e-9 * np.abs(inverses).max()]
    poles = poles[(poles.imag > 0) & (poles.imag < 1.2 * s0)] / 2 / np.pi
    beside = [p.imag + abs(p.real) * np.array([-3, -1, -0.3, 0, 0.3, 1, 3]) for p in poles]
    found = np.concatenate([np.linspace(low, high, UNIFORM), *beside, rom.frequencies])
    return np.unique(found[(found >= low) & (found <= high)])


def reduced_responses(rom, case, frequencies, eta) -> np.ndarray:
    """Return H (S, r, p) by the matrices of the result alone."""
    damping = case.more.get("damping")
    of_model = damping is None and case.D is not None
    D = rom.D if of_model or isinstance(damping, hpcred.Rayleigh) or not eta else 0 * rom.D
    s = 2j * np.pi * frequencies
    return np.array([rom.C @ np.linalg.solve(x * x * rom.M + x * D + (1 + 1j * eta) * rom.K, rom.B) for x in s])


def judged(case) -> dict:
    """Reduce a case; return its verdict and numbers."""
    with case.model() as model:
        try:
            rom = hpcred.reduce(model, tolerance=case.tolerance, band=case.band, **case.more)
        except hpcred.InputError as error:
            return {"verdict": "refused", "text": str(error)}
        with rom:
            accuracy = rom.record.accuracy
            eta = accuracy.loss_factor
            S = frequencies_of(case, rom, eta)
            H, drive = case.responses(S, eta)
            true = float(accuracy.measure.eps(H - reduced_responses(rom, case, S, eta), H, drive).max())
    said = accuracy.largest + accuracy.noise
    verdict = "reached" if accuracy.reached else "not reached"
    if true > max(ROOM * said, ROUND_OFF) or (accuracy.reached and true > case.tolerance):
        verdict = "FALSE"
    return {"verdict": verdict, "true": true, "said": said, "coordinates": rom.size, "dofs": len(case.M),
            "text": "" if accuracy.reached else accuracy.sentence}  # fmt: skip


# dofs without mass


def springs(rng, n, more=0):
    """Return K (n, n) of a chain that is held at its first mass, with `more` springs between any of its dofs."""
    K = np.zeros((n, n))
    ends = [(i, i - 1) for i in range(n)] + [tuple(rng.choice(n, 2, replace=False)) for _ in range(more)]
    for i, j in ends:
        e = np.zeros(n)
        e[i] = 1.0
        if j >= 0:
            e[j] = -1.0
        K += 1e4 * np.exp(rng.normal(0.0, 1.0)) * np.outer(e, e)
    return K


def dashpots(rng, n, count, among, strength):
    """Return D (n, n) of dashpots from some dofs to any others or to the ground."""
    D = np.zeros((n, n))
    for _ in range(count):
        e = np.zeros(n)
        e[rng.choice(among)] = 1.0
        if rng.random() < 0.7:
            e[rng.integers(n)] -= 1.0
        D += strength * np.exp(rng.normal(0.0, 1.5)) * np.outer(e, e)
    return D


def band_of(rng, M, K) -> tuple[float, float]:
    """Return a band up to between two of the lower modes."""
    inverses = np.sort(np.linalg.eigvals(np.linalg.solve(K, M)).real)[::-1]
    f = 1 / (2 * np.pi * np.sqrt(inverses[inverses > 1e-9 * inverses[0]]))
    k = int(rng.integers(1, max(2, min(len(f), 8))))
    top = f[k - 1] * rng.uniform(1.05, 1.3)
    return (0.0 if rng.random() < 0.7 else 0.2 * top), float(top)


def loads(rng, n, massless, on_massless):
    """Return unit loads, some of them on dofs without mass where `on_massless`, else on none of these."""
    others = np.setdiff1d(np.arange(n), massless)
    rows = list(rng.choice(massless, min(len(massless), int(rng.integers(1, 3))), replace=False)) if on_massless else []
    if rng.random() < 0.8 or not rows:
        rows += list(rng.choice(others, min(int(rng.integers(1, 4)), len(others)), replace=False))
    B = np.zeros((n, len(rows)))
    B[rows, range(len(rows))] = 10.0 ** rng.integers(-2, 3, len(rows))
    return B


def tolerance_of(rng) -> float:
    return float(10 ** rng.uniform(-6, -2))


def chain_without_mass(rng) -> Case:
    """A net of springs with lumped masses, of which a part is zero: springs in series; forces, outputs and dashpots
    anywhere."""
    n = int(rng.integers(6, 40))
    M = np.diag(np.exp(rng.normal(0.0, 0.7, n)))
    some = rng.choice(n, max(1, int(n * rng.uniform(0.1, 0.6))), replace=False)
    M[some, some] = 0.0
    massless, K = np.sort(some), springs(rng, n, int(rng.integers(0, 5)))
    D, more, C = None, {}, None
    if rng.random() < 0.6:
        among = massless if rng.random() < 0.7 else np.arange(n)
        D = dashpots(rng, n, int(rng.integers(1, 6)), among, 10 ** rng.uniform(0, 3))
    elif rng.random() < 0.5:
        more["damping"] = [hpcred.Rayleigh(0.1, 1e-4), hpcred.Structural(0.02)][rng.integers(2)]
    if rng.random() < 0.3:
        C = np.zeros((int(rng.integers(1, 3)), n))
        C[range(len(C)), rng.choice(n, len(C), replace=False)] = 1.0
    return Case(M, K, loads(rng, n, massless, rng.random() < 0.6), band_of(rng, M, K), tolerance_of(rng), D, C, more)


def skew_without_mass(rng) -> Case:
    """The same in turned axes: M is singular with a full diagonal."""
    case = chain_without_mass(rng)
    Q = np.eye(len(case.M))
    for i in range(0, len(Q) - 1, 2):
        c, s = np.cos(t := rng.uniform(0, np.pi)), np.sin(t)
        Q[i : i + 2, i : i + 2] = [[c, -s], [s, c]]
    M, K, D = (None if A is None else (Q.T @ A @ Q + (Q.T @ A @ Q).T) / 2 for A in (case.M, case.K, case.D))
    C = None if case.C is None else case.C @ Q
    return Case(M, K, Q.T @ case.B, case.band, case.tolerance, D, C, case.more)


def beam_without_inertia(rng) -> Case:
    """An Euler beam with lumped masses and rotations without inertia; forces, moments and rotational dampers."""
    elements = int(rng.integers(3, 20))
    n, L, EI, mass = 2 * elements + 2, 1.0 / elements, rng.uniform(10, 1000), rng.uniform(0.5, 5)
    K, M = np.zeros((n, n)), np.zeros((n, n))
    k = EI / L**3 * np.array([[12, 6 * L, -12, 6 * L], [6 * L, 4 * L * L, -6 * L, 2 * L * L],
                              [-12, -6 * L, 12, -6 * L], [6 * L, 2 * L * L, -6 * L, 4 * L * L]])  # fmt: skip
    for i in range(elements):
        rows = slice(2 * i, 2 * i + 4)
        K[rows, rows] += k
        M[[2 * i, 2 * i + 2], [2 * i, 2 * i + 2]] += mass * L / 2
    hinged = rng.random() < 0.4
    kept = np.delete(np.arange(n), [0, n - 2] if hinged else [0, 1])
    K, M = K[np.ix_(kept, kept)], M[np.ix_(kept, kept)]
    n, massless = len(K), np.flatnonzero(np.diag(M) == 0)
    D = None
    if rng.random() < 0.5:
        D = dashpots(rng, n, int(rng.integers(1, 4)), massless, 10 ** rng.uniform(-3, 0))
    return Case(M, K, loads(rng, n, massless, rng.random() < 0.6), band_of(rng, M, K), tolerance_of(rng), D)


def rotor_without_inertia(rng) -> Case:
    """A chain in two directions with gyroscopic and circulatory terms, and dofs without mass in both."""
    n = int(rng.integers(4, 12))
    masses = np.exp(rng.normal(0.0, 0.5, n))
    masses[rng.choice(n, max(1, n // 3), replace=False)] = 0.0
    turn, K0 = np.array([[0.0, 1.0], [-1.0, 0.0]]), springs(rng, n)
    M, K = np.kron(np.diag(masses), np.eye(2)), np.kron(K0, np.eye(2))
    D = np.kron(np.diag(np.where(masses > 0, rng.uniform(0, 20, n), 0.0)), turn) + 1e-4 * K
    circulatory = rng.random() < 0.5
    symmetric = K
    if circulatory:
        K = K + 1e-3 * np.kron(np.diag(np.diag(K0)), turn)
    massless = np.flatnonzero(np.diag(M) == 0)
    B = loads(rng, 2 * n, massless, rng.random() < 0.6)
    return Case(M, K, B, band_of(rng, M, symmetric), tolerance_of(rng), D, circulatory=circulatory)


KINDS = {
    "chain-without-mass": chain_without_mass,
    "skew-without-mass": skew_without_mass,
    "beam-without-inertia": beam_without_inertia,
    "rotor-without-inertia": rotor_without_inertia,
}


def case_of(kind, seed) -> Case:
    """Return a case of a kind."""
    return KINDS[kind](np.random.default_rng([seed, *kind.encode()]))


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"by default all of {', '.join(KINDS)}")
    parser.add_argument("--seeds", default="0:40", help="first and last plus one")
    parser.add_argument("--json", metavar="FILE", help="all verdicts")
    given = parser.parse_args(arguments)
    first, last = map(int, given.seeds.split(":"))
    counts, rows = Counter(), []
    for kind in given.kinds or KINDS:
        for seed in range(first, last):
            start = time.process_time()
            found = judged(case_of(kind, seed))
            rows.append({"kind": kind, "seed": seed, **found, "seconds": time.process_time() - start})
            counts[kind, found["verdict"]] += 1
            if found["verdict"] != "reached":
                numbers = f"true {found['true']:.1e}, said {found['said']:.1e}; " if "true" in found else ""
                print(f"{kind} {seed}: {found['verdict']}: {numbers}{found['text'][:150]}", flush=True)
    for kind, verdict in sorted(counts):
        print(f"{kind:28s} {verdict:12s} {counts[kind, verdict]}")
    if given.json:
        with open(given.json, "w") as file:
            json.dump(rows, file, indent=1)
    return int(any(row["verdict"] == "FALSE" for row in rows))


if __name__ == "__main__":
    raise SystemExit(main())
