"""Small models on which an automatic reduction is difficult, and the dense truth of what it says.

Matrices are numpy arrays, the same on all ranks; `Case` holds them with the frame, the damping and the band.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hpcred import GivenDamping, NoDamping, NoFrame, Rayleigh, SecondOrderModel
from hpcred.reduction.small.damping import measured_damping


@dataclass
class Case:
    """K, M, D (n, n), B (n, p), Ct (n, r) or None; `band` in Hz; `keywords` of reduce."""

    name: str
    K: np.ndarray
    M: np.ndarray
    B: np.ndarray
    band: tuple[float, float]
    D: np.ndarray | None = None
    Ct: np.ndarray | None = None
    damping: object = field(default_factory=NoDamping)
    frame: object = field(default_factory=NoFrame)

    def model(self, comm):
        more = {} if self.Ct is None else {"outputs": self.Ct}
        names = [f"u{i}" for i in range(self.B.shape[1])]
        outputs = [] if self.Ct is None else [f"y{i}" for i in range(self.Ct.shape[1])]
        return SecondOrderModel.from_scipy(
            self.K, self.M, self.D, comm, inputs=self.B, input_names=names, output_names=outputs, name=self.name, **more
        )

    @property
    def frequencies(self):
        """Eigenfrequencies (n,) in Hz."""
        root = np.linalg.inv(np.linalg.cholesky(self.M))
        return np.sqrt(np.maximum(np.linalg.eigvalsh(root @ self.K @ root.T), 0.0)) / (2 * np.pi)

    def damping_model(self, zeta0=1e-3):
        return measured_damping(self.damping, zeta0, self.band)[0]

    def truth(self, frequencies):
        """H (S, r, p) with the damping that is measured with, by dense elimination with a step of refinement."""
        return self.truth_and_drive(frequencies)[0]

    def truth_and_drive(self, frequencies):
        """H (S, r, p), and b_i^T A^-1 b_i (S, p) of every input."""
        C = self.B if self.Ct is None else self.Ct
        found, drive = [], []
        D = self.D if isinstance(self.damping, GivenDamping) else None
        for A in dynamic(self.K, self.M, D, self.damping_model(), frequencies):
            X = np.linalg.solve(A, self.B.astype(complex))
            X += np.linalg.solve(A, self.B - A @ X)
            found.append(C.T @ X)
            drive.append((self.B * X).sum(axis=0))
        return np.array(found), np.array(drive)


def dynamic(K, M, D, damping, frequencies):
    """A(s), one by one."""
    higher, power = 0.0, K
    for coefficient in damping.higher:
        power = K @ np.linalg.solve(M, power)
        higher = higher + coefficient * power
    for a, b, s in zip(*damping.coefficients(frequencies), strict=True):
        yield a * K + b * M + s * higher + (0.0 if D is None else s * D)


def reduced_response(rom, damping, frequencies, given):
    """H_r (S, r, p) of the reduced model with the damping that is measured with."""
    D = rom.D if given else None
    return np.array([rom.C @ np.linalg.solve(A, rom.B.astype(complex))
                     for A in dynamic(rom.K, rom.M, D, damping, frequencies)])  # fmt: skip


def chain(n, k=1e4, m=1.0, rng=None, spread=0.0, ground=True):
    """K, M of n masses between n + 1 springs, the last of them only with `ground`."""
    springs = k * np.exp(spread * (rng.standard_normal(n + 1) if rng is not None else np.zeros(n + 1)))
    masses = m * np.exp(spread * (rng.standard_normal(n) if rng is not None else np.zeros(n)))
    K = np.diag(springs[:n] + np.append(springs[1:n], springs[n] if ground else 0.0))
    return K - np.diag(springs[1:n], 1) - np.diag(springs[1:n], -1), np.diag(masses)


def unit(n, *rows):
    """Unit loads (n, p)."""
    B = np.zeros((n, len(rows)))
    B[list(rows), range(len(rows))] = 1.0
    return B


def pair(n, i, j):
    """e_i - e_j, where the place n is the ground."""
    e = np.zeros(n + 1)
    e[i], e[j] = 1.0, -1.0
    return e[:n]


def up_to(K, M, mode):
    """A band that ends just above a mode."""
    case = Case("", K, M, K[:, :1], (0.0, 1.0))
    return 0.0, 1.02 * float(case.frequencies[mode])


def dashpots(n, count, rng, strength=(0.5, 20.0)):
    D = np.zeros((n, n))
    for _ in range(count):
        e = pair(n, *rng.choice(n + 1, 2, replace=False))
        D += rng.uniform(*strength) * np.outer(e, e)
    return D


def tied_chains(tie, n=40):
    """Two identical chains with a weak spring between their middles."""
    K, M = chain(n)
    both = np.kron(np.eye(2), K)
    e = pair(2 * n, n // 2, n + n // 2)
    return both + tie * 1e4 * np.outer(e, e), np.kron(np.eye(2), M)


def massless_along(t, load, n=12):
    """A chain in two directions whose masses are felt across `t` only, loaded at one node along `load`."""
    t, (K, M) = np.array(t), chain(n)
    across = np.array([-t[1], t[0]])
    K = np.kron(K, np.outer(across, across) + 2 * np.outer(t, t))
    B = np.zeros((2 * n, 1))
    B[8:10, 0] = load
    return Case("directions without mass", K, np.kron(M, np.outer(across, across)), B, (0.0, 8.0))


def membrane(n=12):
    """A square membrane, whose modes come in pairs."""
    T = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    return 1e4 * (np.kron(T, np.eye(n)) + np.kron(np.eye(n), T)), np.eye(n * n)


def random_case(seed, most=120):
    """A random model and a tolerance: chains with ties or dense matrices, some damped, some with C other than B^T."""
    rng = np.random.default_rng(1000 + seed)
    n = int(rng.integers(20, most))
    if seed % 4 < 2:
        K, M = chain(n, rng=rng, spread=rng.uniform(0, 1))
        for _ in range(int(rng.integers(0, n))):
            e = pair(n, *rng.choice(n, 2, replace=False))
            K += 1e4 * 10 ** rng.uniform(-4, 1) * np.outer(e, e)
    else:
        q = np.linalg.qr(rng.standard_normal((n, n)))[0]
        omega = np.sort(10 ** rng.uniform(1, 2 + 2 * rng.random(), n))
        K, M = q * omega**2 @ q.T, np.eye(n)
        K = (K + K.T) / 2
    p = int(rng.integers(1, 6))
    B = rng.standard_normal((n, p)) if rng.random() < 0.4 else unit(n, *rng.choice(n, p, replace=False))
    case = Case(f"random {seed}", K, M, B, (0.0, 1.0))
    case.band = 0.0, float(case.frequencies[int(rng.integers(0, max(2, n // 2)))] * rng.uniform(0.8, 1.2))
    kind = rng.random()
    if kind < 0.3:
        case.damping = Rayleigh(rng.uniform(0, 2), 10 ** rng.uniform(-5, -3))
    elif kind < 0.5:
        case.D = np.zeros((n, n))
        for _ in range(int(rng.integers(1, 20))):
            e = pair(n, *rng.choice(n, 2, replace=False))
            case.D += 10 ** rng.uniform(-2, 1.5) * np.outer(e, e)
        case.damping = GivenDamping()
    if rng.random() < 0.25:
        case.Ct = unit(n, *rng.choice(n, int(rng.integers(1, 4)), replace=False))
    return case, float(10.0 ** -rng.integers(2, 9))


def fresh(case, rom, seed=5, count=31, beside=3):
    """Fresh frequencies of the band, and some at 1.0003 times pseudo-frequencies."""
    low, high = case.band
    poles = rom.frequencies[(rom.frequencies > low) & (1.0003 * rom.frequencies < high)]
    near = poles[np.linspace(0, len(poles) - 1, beside).astype(int)] * 1.0003 if len(poles) else []
    return np.concatenate([np.random.default_rng(seed).uniform(low, high, count), near])


def estimated_and_true(case, rom, frequencies):
    """eps (S,) as the curve of the result has it there, and by dense solves."""
    damping, given = case.damping_model(), isinstance(case.damping, GivenDamping)
    H, drive = case.truth_and_drive(frequencies)
    accuracy = rom.record.accuracy
    true = accuracy.measure.eps(H - reduced_response(rom, damping, frequencies, given), H, drive)
    curve = np.log(np.maximum(accuracy.eps, 1e-300))
    return np.exp(np.interp(frequencies, accuracy.frequencies, curve)), true


def hard_cases(seed=0):
    """Cases by name; each is made when it is called."""

    def given_dashpots(n=25, mode=12, rows=(3, 20), factor=1.0):
        K, M = chain(n)
        D = factor * dashpots(n, 40, np.random.default_rng(seed))
        return Case("", K, M, unit(n, *rows), up_to(K, M, mode), D=D, damping=GivenDamping())

    def gyroscopic(n=60):
        K, M = chain(n)
        D = np.zeros((n, n))
        D[30, 30], D[10, 10] = 5.0, 10.0
        for i, j, g in ((5, 20, 5.0), (40, 50, 20.0)):
            D[i, j] += g
            D[j, i] -= g
        return Case("", K, M, unit(n, 3, 45), up_to(K, M, 12), D=D, damping=GivenDamping())

    def near_a_node(n=100):
        K, M = chain(n)
        shape = np.abs(np.linalg.eigh(K)[1][:, 4])
        row = next(int(row) for row in shape.argsort() if n // 10 < row < n - n // 10)
        return Case("", K, M, unit(n, row), up_to(K, M, 10))

    def tied(tie, sensors=None):
        K, M = tied_chains(tie)
        K1, M1 = chain(40)
        Ct = None if sensors is None else unit(80, *sensors)
        return Case("", K, M, unit(80, 5), up_to(K1, M1, 12), Ct=Ct)

    def square(rows, mode=30, damping_model=None):
        K, M = membrane()
        return Case("", K, M, unit(len(K), *rows), up_to(K, M, mode), damping=damping_model or NoDamping())

    def cancelling():
        case = square((37, 101), 20)
        case.B[38, 0], case.B[39, 0] = -1.0, 1e-3
        return case

    def nearly_equal():
        case = square((37, 37), 20)
        case.B[38, 1] = 1e-9
        return case

    def localised(n=100):
        K, M = chain(n)
        K[70, 70] += 3e4
        M[50, 50], M[51, 51] = 3.0, 0.3
        for i in (20, 60, 90):
            K[i, i] += 1e4 * np.random.default_rng(seed).uniform(0, 2)
        return Case("", K, M, unit(n, 2), up_to(K, M, 60))

    def oscillators(n=60, m=12):
        rng = np.random.default_rng(seed)
        K, M = chain(n)
        K, M = np.pad(K, (0, m)), np.pad(M, (0, m))
        for i in range(m):
            e = pair(n + m, n + i, 5 * i)
            K += 1e-4 * rng.uniform(100, 4000) * np.outer(e, e)
            M[n + i, n + i] = 1e-4
        return Case("", K, M, unit(n + m, 30), up_to(K, M, 25))

    def other_outputs(units=1.0, damping_model=None, damped=False, n=80):
        rng = np.random.default_rng(seed)
        K, M = chain(n, rng=rng, spread=0.2)
        D = np.diag(rng.uniform(0, 5, n) * (rng.uniform(size=n) < 0.2)) if damped else None
        return Case("", K, M, units * unit(n, 3, 40), up_to(K, M, 16), D=D, Ct=unit(n, 70, 3, 30) / units,
                    damping=GivenDamping() if damped else damping_model or NoDamping())  # fmt: skip

    def in_band(low, high, n=100):
        return Case("", *chain(n), unit(n, 3), (low, high))

    def stiff(n=40):
        K, M = chain(n, ground=False)
        e = pair(n, 20, 21)
        return Case("", K + 1e9 * np.outer(e, e), M, unit(n, n - 1), (0.0, 10.0))

    def quiet():
        return Case("", *chain(60, k=1e8), unit(60, 0), (0.0, 10.0))

    def tiny():
        return Case("", *chain(3), unit(3, 0), (0.0, 40.0))

    made = {
        "25 masses, 40 dashpots": given_dashpots,
        "25 masses, 40 dashpots, one input": lambda: given_dashpots(mode=23, rows=(3,)),
        "25 masses, weak dashpots": lambda: given_dashpots(rows=(3,), factor=0.01),
        "gyroscopic D": gyroscopic,
        "load near a node": near_a_node,
        "chains tied 1e-2": lambda: tied(1e-2),
        "chains tied 1e-5": lambda: tied(1e-5),
        "chains tied 1e-8": lambda: tied(1e-8),
        "chains tied 1e-5, sensor beyond": lambda: tied(1e-5, (47,)),
        "double modes": lambda: square((37, 101)),
        "double modes, one input": lambda: square((37,)),
        "double modes, centre": lambda: square((6 * 12 + 6,), 40),
        "30 inputs": lambda: square(tuple(range(0, 120, 4))),
        "30 inputs, Rayleigh": lambda: square(tuple(range(0, 120, 4)), 15, Rayleigh(2.0, 1e-4)),
        "cancelling loads": cancelling,
        "nearly equal loads": nearly_equal,
        "localised modes": localised,
        "light oscillators": oscillators,
        "other outputs": other_outputs,
        "other outputs, units, Rayleigh": lambda: other_outputs(1e6, Rayleigh(1.0, 1e-4)),
        "other outputs, D": lambda: other_outputs(damped=True),
        "90 modes": lambda: in_band(0.0, up_to(*chain(100), 90)[1]),
        "band above 0": lambda: in_band(8.0, 16.0),
        "narrow band": lambda: in_band(12.0, 12.3),
        "stiffness jump": stiff,
        "quiet band": quiet,
        "tiny": tiny,
    }

    def named(name):
        case = made[name]()
        case.name = name
        return case

    return {name: (lambda name=name: named(name)) for name in made}
