"""Random small models at the edges of the measure, and their dense truth."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import scipy.linalg

import hpcred

KINDS = ("fractional", "silent", "signs", "vanishing")
UNIFORM = 200  # frequencies that floors are the medians of
STATIC = 1e-3  # of a median, below which a static response is a zero and no floor


@dataclass
class EdgeCase:
    """Matrices with terms of parameters as (of, matrix, factor), viscoelastic parts as (K_v, law), a band from 0 Hz."""

    K: np.ndarray
    M: np.ndarray
    D: np.ndarray
    B: np.ndarray
    C: np.ndarray
    band: tuple[float, float]
    tolerance: float
    parts: list = field(default_factory=list)
    parameters: tuple = ()
    terms: list = field(default_factory=list)

    @contextmanager
    def reduced(self):
        """The reduced model."""
        asked = {"tolerance": self.tolerance, "band": self.band, "damping": hpcred.GivenDamping()}
        with hpcred.SecondOrderModel(self.M, self.D, self.K, self.B, self.C) as plain:
            if self.parts:
                with plain.with_viscoelastic([hpcred.Viscoelastic(*part) for part in self.parts]) as model:
                    yield hpcred.reduce(model, **asked)
            elif self.parameters:
                terms = [hpcred.Term(*term) for term in self.terms]
                with hpcred.ParametricModel(plain, self.parameters, terms) as model:
                    yield hpcred.reduce(model, **asked)
            else:
                yield hpcred.reduce(plain, **asked)

    def at(self, values) -> dict[str, np.ndarray]:
        """Return the matrices at values of the parameters."""
        found = {key: getattr(self, key) for key in "KMDBC"}
        for of, matrix, factor in self.terms:
            found[of] = found[of] + eval(factor.replace("^", "**"), {"sqrt": np.sqrt, "sin": np.sin}, values) * matrix
        return found

    def responses(self, matrices, parts, f):
        """Return H (S, r, p), and the drive-point responses (S, p)."""
        H, drive = [], []
        for s in 2j * np.pi * np.asarray(f):
            A = s * s * matrices["M"] + s * matrices["D"] + matrices["K"]
            for K_v, law in parts:  # K has g(0) K_v in the reduced model, and K_e alone here
                A = A + law(s) * K_v
            x = np.linalg.solve(A, matrices["B"])
            H.append(matrices["C"] @ x)
            drive.append(np.einsum("np,np->p", matrices["B"], x))
        return np.array(H), np.array(drive)

    def largest_error(self, rom, rng) -> tuple[float, str]:
        """Return the largest error by directions, of outputs that are not left out, and where it is."""
        silent = set(rom.record.accuracy.silent)
        kept = [j for j, name in enumerate(rom.output_names) if name not in silent]
        worst = 0.0, ""
        for values in self._values(rng):
            error, f = self._at_values(rom, values, kept, rng)
            if not error <= worst[0]:
                worst = error, f"{f:.3g} Hz {values or ''}"
        return worst

    def _values(self, rng):
        """Values of the parameters: random ones, ends, references, and those where a static response passes zero."""
        if not self.parameters:
            return [{}]
        (item,) = self.parameters
        along = np.linspace(*item.range, 101)
        static = []
        for p in along:
            at = self.at({item.name: p})
            static.append((at["C"] @ np.linalg.solve(at["K"], at["B"])).ravel())
        static = np.array(static)
        found = [*rng.uniform(*item.range, 6), *item.range, item.reference]
        for k, j in zip(*np.nonzero(static[:-1] * static[1:] < 0), strict=True):
            zero = along[k] + (along[k + 1] - along[k]) * static[k, j] / (static[k, j] - static[k + 1, j])
            size = np.abs(np.median(static[:, j])) / max(np.abs(static[k + 1, j] - static[k, j]), 1e-300)
            for part in (-0.1, -0.01, -0.002, 0.002, 0.01, 0.1):
                found.append(float(np.clip(zero + part * size * (along[1] - along[0]), *item.range)))
        return [{item.name: float(p)} for p in found]

    def _at_values(self, rom, values, kept, rng):
        low, high = self.band
        full = self.at(values)
        small = rom.matrices(values) if values else {key: getattr(rom, key) for key in "KMDBC"}
        laws = [(K_v, lambda s, law=law: law.static + law.excess(s)) for K_v, law in self.parts]
        small_laws = [(part.matrix, part.law.excess) for part in rom.viscoelastic]
        # scales, by the definition of docs/theory/error.md
        H, drive = self.responses(full, laws, np.linspace(low, high, UNIFORM))
        H = H[:, kept]
        floor_in = _floors(np.abs(drive))
        if not H.any() or not (floor_in > 0).any():
            return 0.0, 0.0
        moved = floor_in > 0
        g = np.sqrt(np.where(moved, np.maximum(np.abs(drive), floor_in), np.inf))
        floor_out = _floors((np.abs(H) / g[:, None, :]).max(axis=2))
        # fresh frequencies, close to 0 Hz and to resonances too
        static = full["K"] + sum(law.static * K_v for K_v, law in self.parts)
        poles = np.sqrt(np.abs(scipy.linalg.eigvals(static, full["M"]))) / (2 * np.pi)
        poles = poles[poles < high]
        f = [rng.uniform(low, high, 60), [low, high], high * 10.0 ** rng.uniform(-14, 0, 40 if self.parts else 8),
             np.repeat(poles, 5) * (1 + rng.normal(size=5 * len(poles)) * 0.01)]  # fmt: skip
        f = np.clip(np.concatenate(f), low, high)
        H, drive = self.responses(full, laws, f)
        Hr, _ = self.responses(small, small_laws, f)
        g = np.sqrt(np.where(moved, np.maximum(np.abs(drive), floor_in), np.inf))
        h = np.maximum((np.abs(H[:, kept]) / g[:, None, :]).max(axis=2), floor_out)
        error = np.abs(H - Hr)[:, kept][:, :, moved]
        scale = h[:, :, None] * g[:, None, moved]
        error = np.divide(error, scale, out=np.zeros_like(error), where=error > 0).max(axis=(1, 2))
        return float(error.max()), float(f[error.argmax()])


def _floors(size):
    median = np.median(size, axis=0)
    return np.where(size[0] > STATIC * median, np.minimum(median, size[0]), median)


def random_case(kind: str, seed: int) -> EdgeCase:
    """Return the model of a seed of one of KINDS."""
    rng = np.random.default_rng([KINDS.index(kind), seed])
    n = int(rng.integers(6, 24))
    K, M = _body(rng, n)
    D = 10.0 ** rng.uniform(-6, -4) * K + rng.uniform(0.01, 1.0) * M
    inputs, outputs = int(rng.integers(1, 3)), int(rng.integers(1, 4))
    B, C = _places(rng, n, inputs), _places(rng, n, outputs).T
    poles = np.sqrt(scipy.linalg.eigvalsh(K, M)) / (2 * np.pi)
    band = (0.0, float(poles[int(rng.integers(1, max(2, n // 3)))] * rng.uniform(0.8, 1.2)))
    case = EdgeCase(K, M, D, B, C, band, float(10.0 ** rng.uniform(-5, -2)))
    {"fractional": _fractional, "silent": _silent, "signs": _signs, "vanishing": _vanishing}[kind](case, rng)
    return case


def _body(rng, n):
    """A chain with random springs and masses, and some springs across."""
    k, m = 10.0 ** rng.uniform(3, 5, n + 1), 10.0 ** rng.uniform(-1, 1, n)
    K = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    for _ in range(int(rng.integers(0, 4))):
        i, j = rng.choice(n, 2, replace=False)
        e = np.zeros(n)
        e[i], e[j] = 1.0, -1.0
        K = K + 10.0 ** rng.uniform(2, 5) * np.outer(e, e)
    return K, np.diag(m)


def _places(rng, n, count):
    """Columns at dofs that differ, in units of their own."""
    found = np.zeros((n, count))
    found[rng.choice(n, count, replace=False), np.arange(count)] = 10.0 ** rng.uniform(-4, 4, count)
    return found


def _fractional(case, rng):
    n = len(case.K)
    for _ in range(int(rng.integers(1, 4))):
        columns = rng.normal(size=(n, int(rng.integers(1, n))))
        K_v = columns @ columns.T * 10.0 ** rng.uniform(1, 5) / n
        time, exponent = 10.0 ** rng.uniform(-6, 1), rng.uniform(0.05, 1.0)
        law = hpcred.FractionalKelvinVoigt(rng.choice([0.0, 1.0]), 10.0 ** rng.uniform(-2, 0.5), time, exponent)
        if rng.random() < 0.4:
            law = hpcred.Fractional(rng.uniform(0, 1), rng.uniform(1, 20), time, exponent)
        elif rng.random() < 0.2:
            law = hpcred.Maxwell([rng.uniform(0.1, 5.0)], [10.0 ** rng.uniform(-5, 4)], rng.uniform(0, 1))
        case.parts.append((K_v, law))


def _silent(case, rng):
    """Two bodies with a weak tie, or a body and its mirror image; all dofs in units of their own."""
    n = len(case.K)
    K, M = _body(rng, n)
    mirrored = rng.random() < 0.5
    if mirrored:
        K, M = case.K, case.M
    both, N = np.zeros((2 * n, 2 * n)), 2 * n
    both[:n, :n], both[n:, n:] = case.K, K
    i, j = (int(rng.integers(n)) for _ in range(2))
    e = np.zeros(N)
    e[i], e[n + (i if mirrored else j)] = 1.0, -1.0
    tie = 1.0 if mirrored else rng.choice([0.0, 10.0 ** rng.uniform(-18, -1)])
    both += tie * 1e4 * np.outer(e, e)
    mass = scipy.linalg.block_diag(case.M, M)
    units = 10.0 ** rng.integers(-3, 4, N)
    B, C = np.zeros((N, 1)), np.zeros((2, N))
    place, near, far = (int(rng.integers(n)) for _ in range(3))
    B[place], C[0, near], C[1, n + far] = 1.0, 1.0, 1.0
    if mirrored:
        B[n + place], C[1, far] = 1.0, -1.0
    case.K, case.M = both * units[:, None] * units, mass * units[:, None] * units
    case.D = 1e-4 * case.K + 0.1 * case.M
    case.B, case.C = B * units[:, None], C * units * 10.0 ** rng.uniform(-3, 3, (2, 1))


def _signs(case, rng):
    """Outputs and stiffness by which static responses change their signs."""
    n, e = len(case.K), np.zeros(len(case.K))
    case.parameters = (hpcred.Parameter("b", (-1.0, float(rng.uniform(0.5, 2.0)))),)
    what = rng.integers(3)
    if what == 0:
        case.terms = [("C", _places(rng, n, len(case.C)).T, "b")]
    elif what == 1:
        case.terms = [("B", _places(rng, n, case.B.shape[1]), "b")]
    else:  # springs to the ground and across, some of them negative
        case.C = case.C - case.C[:, ::-1] * rng.uniform(0.2, 2.0)
    i, j = rng.choice(n, 2, replace=False)
    e[i], e[j] = 1.0, -rng.uniform(0.0, 1.0)
    case.terms.append(("K", 0.4 * np.diag(case.K).min() * np.outer(e, e), "b^2" if rng.random() < 0.5 else "1 + b"))


def _vanishing(case, rng):
    """Loads or outputs whose factor is zero at a value that is a training point, or somewhere else."""
    case.parameters = (hpcred.Parameter("b", (-2.0, 2.0), float(rng.choice([0.0, 1.0]))),)
    factor = str(rng.choice(["b", "b^2 - 1", "b - 1.23", "sin(b)"]))
    of = str(rng.choice(["B", "C"]))
    matrix = getattr(case, of).copy()
    which = int(rng.integers(matrix.shape["CB".index(of)]))
    rest = np.delete(np.arange(matrix.shape["CB".index(of)]), which)
    matrix[(slice(None), rest) if of == "B" else (rest, slice(None))] = 0.0
    constant = getattr(case, of) - matrix
    setattr(case, of, constant + (matrix if rng.random() < 0.5 else 0.0 * matrix))
    case.terms = [(of, matrix, factor), ("K", 0.2 * case.K, "b^2")]
