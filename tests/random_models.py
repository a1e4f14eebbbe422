"""Random small models of many classes, by seed, and their dense truth: what benchmarks/hunt.py reduces."""

from __future__ import annotations

import decimal
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import scipy.linalg

import hpcred
from hpcred.reduction.result.measure import Directions, drive_points

UNIFORM = 200  # frequencies over the band
BESIDE = np.array([-3, -1, -0.3, 0, 0.3, 1, 3])  # places around a pole, in half widths of its resonance
AT_A_TIME = 2**22  # numbers of dynamic stiffness matrices
STEPS, REFINED = 30, 1e-13  # of solves, and the change that ends them
LEADING = 26  # bits of the leading part of an entry of K


@dataclass
class Case:
    """A dense model, what it is asked for, and its truth.

    `terms` of parameters as (of, matrix, factor), viscoelastic `parts` as (K_v, law); `free`: K is singular, and the
    response at 0 Hz is left out.
    """

    K: np.ndarray
    M: np.ndarray
    D: np.ndarray | None
    B: np.ndarray
    C: np.ndarray | None
    band: tuple[float, float]
    tolerance: float
    parts: list = field(default_factory=list)
    parameters: tuple = ()
    terms: list = field(default_factory=list)
    damping: hpcred.Damping | None = None
    circulatory: bool = False
    free: bool = False

    @contextmanager
    def reduced(self, **search):
        """The reduced model; `search`: keywords for models with parameters."""
        asked = {"tolerance": self.tolerance, "band": self.band, "damping": self.damping}
        more = {"circulatory": True} if self.circulatory else {}
        with hpcred.SecondOrderModel(self.M, self.D, self.K, self.B, self.C, **more) as plain:
            if self.parts:
                with plain.with_viscoelastic([hpcred.Viscoelastic(*part) for part in self.parts]) as model:
                    yield hpcred.reduce(model, **asked)
            elif self.parameters:
                terms = [hpcred.Term(*term) for term in self.terms]
                with hpcred.ParametricModel(plain, self.parameters, terms) as model:
                    yield hpcred.reduce(model, **asked, **search)
            else:
                yield hpcred.reduce(plain, **asked)

    def at(self, values) -> dict[str, np.ndarray]:
        """Return the matrices at values of the parameters, with the damping that was asked for."""
        found = {"K": self.K, "M": self.M, "D": 0.0 * self.K, "B": self.B, "C": self.B.T if self.C is None else self.C}
        if self.D is not None:
            found["D"] = self.D
        for of, matrix, factor in self.terms:
            found[of] = found[of] + eval(factor.replace("^", "**"), {"sqrt": np.sqrt, "sin": np.sin}, values) * matrix
        if isinstance(self.damping, hpcred.Rayleigh):
            found["D"] = self.damping.alpha * found["M"] + self.damping.beta * found["K"]
        if self.C is None:
            found["C"] = found["B"].T
        return found

    def largest_error(self, rom, rng) -> tuple[float, str]:
        """Return the largest error by directions, of outputs that are not left out, and where it is."""
        worst = 0.0, ""
        for values in self._values(rng):
            error, f = self._at_values(rom, values, rng)
            if not error <= worst[0]:
                worst = error, f"{f:.6g} Hz {values or ''}"
        return worst

    def change_by_last_digits(self, rom, rng) -> float:
        """Return the largest error of the full model with other last digits of K: no model can be better."""
        signs = np.triu(rng.choice([-1.0, 1.0], self.K.shape))
        signs = signs + np.triu(signs, 1).T
        other = replace(self, K=self.K * (1 + np.finfo(float).eps * signs))
        known = {key: getattr(rom, key) for key in ("record", "output_names", "frequencies")}
        return self.largest_error(SimpleNamespace(**other.at({}), viscoelastic=self.parts, **known), rng)[0]

    def modes_below(self, f) -> int:
        """Return how many undamped modes lie below a frequency in Hz, by the inertia of K - (2 pi f)^2 M."""
        at = self.at({item.name: item.reference for item in self.parameters})
        K = at["K"] + sum(law.static * K_v for K_v, law in self.parts)
        return int((scipy.linalg.eigvalsh((K + K.T) / 2 - (2 * np.pi * f) ** 2 * at["M"]) < 0).sum())

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

    def _at_values(self, rom, values, rng):
        accuracy, full = rom.record.accuracy, self.at(values)
        small = rom.matrices(values) if values else {key: getattr(rom, key) for key in "KMDBC"}
        eta = accuracy.loss_factor
        if eta and not accuracy.beside_damping:
            full, small = ({**item, "D": 0.0 * item["K"]} for item in (full, small))
        laws = [(K_v, lambda s, law=law: law.static + law.excess(s)) for K_v, law in self.parts]
        small_laws = [(part.matrix, part.law.excess) for part in rom.viscoelastic]
        # scales, by the definition of docs/theory/error.md
        low, high = self.band
        if self.free:
            low = max(low, 1e-3 * high)
        f, names = np.linspace(low, high, UNIFORM), list(rom.output_names)
        H, drive = responses(full, laws, eta, f)
        silent = [names.index(name) for name in accuracy.silent]
        measure = Directions().over(f, H, drive, drive_points(full["B"], full["C"].T), silent)
        # fresh frequencies, close to 0 Hz and to resonances too
        static = {**full, "K": full["K"] + sum(law.static * K_v for K_v, law in self.parts)}
        down = 14 if self.parts else 3 if self.free else 6
        f = [rng.uniform(low, high, 60), f, beside_poles(static, eta, high, rng), rom.frequencies,
             high * 10.0 ** rng.uniform(-down, 0, 40 if self.parts else 8)]  # fmt: skip
        f = np.unique(np.clip(np.concatenate(f), low, high))
        H, drive = responses(full, laws, eta, f)
        error = measure.eps(H - responses(small, small_laws, eta, f)[0], H, drive)
        return float(error.max()), float(f[error.argmax()])


def responses(matrices, laws, eta, f) -> tuple[np.ndarray, np.ndarray]:
    """Return H (S, r, p) and the drive-point responses (S, p) by solves that are refined in extended precision."""
    K, M, D, B, C = (np.asarray(matrices[key], dtype=np.longdouble) for key in "KMDBC")
    shape, H, drive = (1, *K.shape), [], []
    for part in np.array_split(f, int(np.ceil(len(f) * K.size / AT_A_TIME)) or 1):
        s = (2j * np.pi * np.asarray(part)).astype(np.clongdouble)[:, None, None]
        beside, loss = s * s * M.reshape(shape) + s * D.reshape(shape), 1 + 1j * np.longdouble(eta)
        for K_v, law in laws:  # K has g(0) K_v in the reduced model, and K_e alone here
            beside = beside + np.array([law(value) for value in s[:, 0, 0].astype(complex)])[:, None, None] * K_v
        inverse = np.linalg.inv((beside + loss * K).astype(complex))
        x = (inverse @ B.astype(float)).astype(np.clongdouble)
        for _ in range(STEPS):  # at sharp resonances of soft modes each has few digits
            change = inverse @ (B - beside @ x - loss * _product(K, x)).astype(complex)
            x = x + change
            known = (np.linalg.norm(change, axis=1) <= REFINED * np.linalg.norm(x, axis=1)).all(axis=1)
            if known.all():
                break
        for k in np.flatnonzero(~known):  # where the inverse has no digit of the softest motion
            x[k] = _by_many_digits(beside[k], loss, K, B)
        H.append((C @ x).astype(complex))
        drive.append(np.einsum("np,snp->sp", B, x).astype(complex))
    return np.concatenate(H), np.concatenate(drive)


def _by_many_digits(beside, loss, K, B) -> np.ndarray:
    """Solve (beside + loss K) x = B, in its real form, by elimination with 50 digits."""
    with decimal.localcontext(prec=50):
        re, im = (_decimals(part(beside)) + _decimals(part(loss)) * _decimals(K) for part in (np.real, np.imag))
        A, n = np.block([[re, -im], [im, re]]), len(K)
        X = np.concatenate([_decimals(B), _decimals(0 * B)])
        for i in range(2 * n):
            pivot = i + int(np.abs(A[i:, i]).argmax())
            A[[i, pivot]], X[[i, pivot]] = A[[pivot, i]], X[[pivot, i]]
            factors = (A[i + 1 :, i] / A[i, i])[:, None]
            A[i + 1 :], X[i + 1 :] = A[i + 1 :] - factors * A[i], X[i + 1 :] - factors * X[i]
        for i in reversed(range(2 * n)):
            X[i] = (X[i] - A[i, i + 1 :] @ X[i + 1 :]) / A[i, i]
        return X[:n].astype(float) + 1j * X[n:].astype(float)


def _decimals(values):
    """Numbers of extended precision as decimals: two doubles have their digits."""
    leading = np.asarray(values).astype(float)
    rest = (values - leading).astype(float)
    return np.vectorize(lambda a, b: decimal.Decimal(a) + decimal.Decimal(b), otypes=[object])(leading, rest)


def _product(K, x) -> np.ndarray:
    """Return K x (S, n, p) of a real K, of whose terms little may be left: products of leading bits have no round-off.
    """
    parts, bits = np.concatenate([x.real, x.imag], axis=2), np.finfo(np.longdouble).nmant - LEADING
    rows, columns = np.abs(K).max(axis=1, keepdims=True), np.abs(parts).max(axis=1, keepdims=True)
    first, leading = _rounded(K, LEADING, rows), _rounded(parts, bits - int(np.ceil(np.log2(len(K)))), columns)
    found = (K - first) @ parts + first @ (parts - leading) + first @ leading
    return found[..., : x.shape[2]] + 1j * found[..., x.shape[2] :]


def _rounded(values, bits, largest):
    """Return values rounded to multiples of 2^-bits of the next power of two above the `largest`."""
    unit = np.exp2(np.ceil(np.log2(np.where(largest > 0, largest, 1.0))) - bits)
    return np.rint(values / unit) * unit


def beside_poles(matrices, eta, high, rng) -> np.ndarray:
    """Return frequencies in Hz at and around the poles below `high` of matrices, of which M may be singular."""
    K, M, D = (matrices[key] for key in "KMD")
    one, s0 = np.eye(len(K)), 2 * np.pi * high  # by A - s0 E, which is regular where M is not
    A = np.block([[-s0 * one, one], [-(1 + 1j * eta) * K, -D - s0 * M]])
    inverses = np.linalg.eigvals(np.linalg.solve(A, scipy.linalg.block_diag(one, M)))
    poles = s0 + 1 / inverses[np.abs(inverses) > 1e-9 * np.abs(inverses).max()]
    poles = poles[(poles.imag > 0) & (poles.imag < 1.2 * s0)] / 2 / np.pi
    if len(poles) > 40:
        poles = rng.choice(poles, 40, replace=False)
    width = np.clip(np.abs(poles.real), 1e-5 * poles.imag, 0.1 * poles.imag)
    return (poles.imag[:, None] + width[:, None] * BESIDE).ravel()


def random_case(kind: str, seed: int) -> Case:
    """Return the model of a seed of one of KINDS."""
    return KINDS[kind](np.random.default_rng([list(KINDS).index(kind), seed]))


# the measure at its edges


def _edge(rng) -> Case:
    n = int(rng.integers(6, 24))
    K, M = _body(rng, n)
    D = 10.0 ** rng.uniform(-6, -4) * K + rng.uniform(0.01, 1.0) * M
    inputs, outputs = int(rng.integers(1, 3)), int(rng.integers(1, 4))
    B, C = _places(rng, n, inputs), _places(rng, n, outputs).T
    poles = np.sqrt(scipy.linalg.eigvalsh(K, M)) / (2 * np.pi)
    band = (0.0, float(poles[int(rng.integers(1, max(2, n // 3)))] * rng.uniform(0.8, 1.2)))
    return Case(K, M, D, B, C, band, float(10.0 ** rng.uniform(-5, -2)), damping=hpcred.GivenDamping())


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


def fractional(rng) -> Case:
    """Laws with a branch point at 0 Hz, and some Maxwell elements."""
    case = _edge(rng)
    n = len(case.K)
    for _ in range(int(rng.integers(1, 4))):
        columns = rng.normal(size=(n, int(rng.integers(1, n))))
        K_v = columns @ columns.T * 10.0 ** rng.uniform(1, 5) / n
        time, exponent = 10.0 ** rng.uniform(-6, 1), rng.uniform(0.05, 1.0)
        law = hpcred.laws.FractionalKelvinVoigt(rng.choice([0.0, 1.0]), 10.0 ** rng.uniform(-2, 0.5), time, exponent)
        if rng.random() < 0.4:
            law = hpcred.laws.Fractional(rng.uniform(0, 1), rng.uniform(1, 20), time, exponent)
        elif rng.random() < 0.2:
            law = hpcred.laws.Maxwell([rng.uniform(0.1, 5.0)], [10.0 ** rng.uniform(-5, 4)], rng.uniform(0, 1))
        case.parts.append((K_v, law))
    return case


def silent(rng) -> Case:
    """Two bodies with a weak tie, or a body and its mirror image; all dofs in units of their own."""
    case = _edge(rng)
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
    return case


def signs(rng) -> Case:
    """Outputs and stiffness by which static responses change their signs."""
    case = _edge(rng)
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
    return case


def vanishing(rng) -> Case:
    """Loads or outputs whose factor is zero at a value that is a training point, or somewhere else."""
    case = _edge(rng)
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
    return case


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
    D, damping, C = None, None, None
    if rng.random() < 0.6:
        among = massless if rng.random() < 0.7 else np.arange(n)
        D = dashpots(rng, n, int(rng.integers(1, 6)), among, 10 ** rng.uniform(0, 3))
    elif rng.random() < 0.5:
        damping = [hpcred.Rayleigh(0.1, 1e-4), hpcred.Structural(0.02)][rng.integers(2)]
    if rng.random() < 0.3:
        C = np.zeros((int(rng.integers(1, 3)), n))
        C[range(len(C)), rng.choice(n, len(C), replace=False)] = 1.0
    B, band = loads(rng, n, massless, rng.random() < 0.6), band_of(rng, M, K)
    return Case(K, M, D, B, C, band, tolerance_of(rng), damping=damping)


def skew_without_mass(rng) -> Case:
    """The same in turned axes: M is singular with a full diagonal."""
    case = chain_without_mass(rng)
    Q = np.eye(len(case.M))
    for i in range(0, len(Q) - 1, 2):
        c, s = np.cos(t := rng.uniform(0, np.pi)), np.sin(t)
        Q[i : i + 2, i : i + 2] = [[c, -s], [s, c]]
    M, K, D = (None if A is None else (Q.T @ A @ Q + (Q.T @ A @ Q).T) / 2 for A in (case.M, case.K, case.D))
    C = None if case.C is None else case.C @ Q
    return replace(case, K=K, M=M, D=D, B=Q.T @ case.B, C=C)


def parameters_without_mass(rng) -> Case:
    """The same with springs, dashpots, masses and loads that depend on a parameter, most of them on dofs without mass.
    """
    case = chain_without_mass(rng)
    n, massless = len(case.K), np.flatnonzero(np.diag(case.M) == 0)
    case.parameters = (hpcred.Parameter("b", (0.0, float(rng.uniform(1.0, 3.0))), float(rng.choice([0.0, 0.5]))),)
    spring = np.zeros(n)
    spring[rng.choice(massless)] = 1.0
    spring[rng.integers(n)] -= 1.0
    case.terms = [("K", 0.5 * np.diag(case.K).max() * np.outer(spring, spring), "b")]
    if case.D is not None:
        case.terms.append(("D", dashpots(rng, n, 2, massless, 10 ** rng.uniform(0, 3)), "b"))
    if rng.random() < 0.3:
        mass = np.zeros((n, n))
        mass[massless[0], massless[0]] = rng.uniform(0.1, 1.0)
        case.terms.append(("M", mass, "b"))
    if rng.random() < 0.3:
        case.terms.append(("B", loads(rng, n, massless, True)[:, :1] @ np.eye(1, case.B.shape[1]), "b"))
    return case


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
    B, band = loads(rng, n, massless, rng.random() < 0.6), band_of(rng, M, K)
    return Case(K, M, D, B, None, band, tolerance_of(rng))


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
    return Case(K, M, D, B, None, band_of(rng, M, symmetric), tolerance_of(rng), circulatory=circulatory)


# free or held, soft beside stiff


def free_chain(rng, n):
    """Return K and M (n, n) of a chain without supports, with some springs across."""
    K, M = _body(rng, n)
    ends = np.zeros((n, n))
    ends[[0, -1], [0, -1]] = K.sum(axis=1)[[0, -1]]
    K = K - ends
    return K - np.diag(K.sum(axis=1)), M


def shuffled(rng, case) -> Case:
    """Return a case with its dofs in another order."""
    p = rng.permutation(len(case.K))
    turned = {key: None if (A := getattr(case, key)) is None else A[np.ix_(p, p)] for key in "KMD"}
    return replace(case, **turned, B=case.B[p], C=None if case.C is None else case.C[:, p])


def damped(rng, K, M) -> dict:
    """Return D and the damping of a case: none, proportional, structural or any dashpots."""
    n, size = len(K), np.diag(K).max()
    rayleigh = hpcred.Rayleigh(10.0 ** rng.uniform(-3, 0), 10.0 ** rng.uniform(-7, -5))
    kind = rng.integers(5)
    D = [None, 1e-5 * K, dashpots(rng, n, 3, np.arange(n), 1e-4 * np.sqrt(size)), None, None][kind]
    return {"D": D, "damping": [None, None, None, rayleigh, hpcred.Structural(0.02)][kind]}


def eigenfrequencies(K, M) -> np.ndarray:
    """Return the undamped eigenfrequencies in Hz, ascending."""
    return np.sqrt(np.abs(scipy.linalg.eigvalsh(K, M))) / (2 * np.pi)


def soft_mounts(rng) -> Case:
    """Stiff chains on springs that are softer by 1e-3 to 1e-11, and some soft ones among themselves; bands from 0 Hz
    or beside the lowest modes, up to these or to elastic ones."""
    parts = int(rng.integers(1, 5))
    bodies = [free_chain(rng, int(rng.integers(5, 18))) for _ in range(parts)]
    K, M = (scipy.linalg.block_diag(*(body[i] for body in bodies)) for i in range(2))
    first = np.cumsum([0, *(len(body[0]) for body in bodies)])
    softness = 10.0 ** rng.uniform(-11, -3)
    soft = np.diag(K).max() * softness
    for i in range(parts):
        for _ in range(int(rng.integers(1, 3))):
            e = np.zeros(len(K))
            e[rng.integers(first[i], first[i + 1])] = 1.0
            if i and rng.random() < 0.3:
                e[rng.integers(first[i])] = -1.0
            K = K + soft * 10.0 ** rng.uniform(-1, 1) * np.outer(e, e)
    f = eigenfrequencies(K, M)
    # the masses on their mounts alone, or with some elastic modes
    top = f[parts - 1] * 2 if rng.random() < 0.3 else f[min(parts + int(rng.integers(0, 6)), len(f) - 1)] * 1.1
    band = (0.0 if rng.random() < 0.6 else float(rng.choice([0.01, 0.3])) * top, top)
    B = _places(rng, len(K), int(rng.integers(1, 4)))
    C = None if rng.random() < 0.7 else _places(rng, len(K), 2).T
    tolerance = max(tolerance_of(rng), 1e-14 / softness)  # K's own last digits bound what can be known
    return shuffled(rng, Case(K, M, B=B, C=C, band=band, tolerance=tolerance, **damped(rng, K, M)))


def free_parts(rng) -> Case:
    """A held or free part under loads, and one to three free ones that nothing pushes, or loads in equilibrium."""
    held = rng.random() < 0.7
    driven = (_body if held else free_chain)(rng, int(rng.integers(8, 25)))
    bodies = [driven, *(free_chain(rng, int(rng.integers(4, 18))) for _ in range(int(rng.integers(1, 4))))]
    K, M = (scipy.linalg.block_diag(*(body[i] for body in bodies)) for i in range(2))
    n, loaded = len(K), len(driven[0])
    B = np.zeros((n, int(rng.integers(1, 4))))
    B[:loaded] = _places(rng, loaded, B.shape[1])
    if rng.random() < 0.4:
        pair = np.zeros((n, 1))
        pair[rng.choice(np.arange(loaded, loaded + len(bodies[1][0])), 2, replace=False), 0] = 1.0, -1.0
        B = np.hstack([B, pair])
    f = eigenfrequencies(driven[0], driven[1])
    top = f[int(rng.integers(2, 7))] * 1.1
    band = (0.0 if held and rng.random() < 0.7 else 0.05 * top, top)
    more = damped(rng, K, M)
    if more["D"] is not None:  # dashpots to the ground would push rigid motions
        more["D"] = 1e-5 * K
    return shuffled(rng, Case(K, M, B=B, C=None, band=band, tolerance=tolerance_of(rng), free=True, **more))


# multiplicities and hidden modes


def equal_blades(rng) -> Case:
    """Equal blades on a hub, or each on its own root; a load on a blade, or on all."""
    blades, n = int(rng.integers(3, 20)), int(rng.integers(3, 10))
    k, m = 1e4 * np.exp(rng.normal()), np.exp(rng.normal())
    one = k * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    one[-1, -1] = k
    N = blades * n + 1
    K, M = np.zeros((N, N)), np.eye(N) * m
    K[:-1, :-1] = np.kron(np.eye(blades), one)
    K[-1, -1] = blades * k + k * 10.0 ** rng.uniform(-2, 6)
    if rng.random() < 0.7:
        roots = np.arange(blades) * n
        K[-1, roots] = K[roots, -1] = -k
    M[-1, -1] = m * 10.0 ** rng.uniform(-1, 3)
    B = np.zeros((N, int(rng.integers(1, 4))))
    for column in range(B.shape[1]):
        if rng.random() < 0.3:
            B[np.arange(blades) * n + n - 1, column] = 1.0
        else:
            B[rng.integers(N), column] = 1.0
    f = np.unique(np.round(eigenfrequencies(K, M), 9))
    top = f[min(int(rng.integers(0, 6)), len(f) - 1)] * 1.1
    band = (0.0 if rng.random() < 0.6 else 0.5 * top, float(top))
    return shuffled(rng, Case(K, M, B=B, C=None, band=band, tolerance=tolerance_of(rng), **damped(rng, K, M)))


def hidden_modes(rng) -> Case:
    """A chain under loads, and up to 80 modes in the band and 20 above it that no load moves, or hardly."""
    n = int(rng.integers(10, 40))
    K1, M1 = _body(rng, n)
    f = eigenfrequencies(K1, M1)
    top = f[int(rng.integers(1, n // 2))] * 1.05
    hidden = np.concatenate([rng.uniform(0.05, 0.999, int(rng.integers(1, 80))), rng.uniform(1.001, 9, 20)]) * top
    if rng.random() < 0.3:
        hidden[: len(hidden) // 3] = hidden[0]
    K = scipy.linalg.block_diag(K1, np.diag((2 * np.pi * hidden) ** 2))
    M = scipy.linalg.block_diag(M1, np.eye(len(hidden)))
    if rng.random() < 0.4:  # weak ties to the chain
        weak = 10.0 ** rng.uniform(-9, -3)
        for j in range(n, len(K)):
            e = np.zeros(len(K))
            e[j], e[rng.integers(n)] = 1.0, -1.0
            K = K + weak * K[j, j] * np.outer(e, e)
    B = np.zeros((len(K), int(rng.integers(1, 4))))
    B[:n] = _places(rng, n, B.shape[1])
    band = (0.0 if rng.random() < 0.7 else 0.1 * top, top)
    more = damped(rng, K, M) | {"D": None}
    return shuffled(rng, Case(K, M, B=B, C=None, band=band, tolerance=tolerance_of(rng), **more))


KINDS = {  # the place of one is part of its seed
    "fractional": fractional,
    "silent": silent,
    "signs": signs,
    "vanishing": vanishing,
    "chain-without-mass": chain_without_mass,
    "skew-without-mass": skew_without_mass,
    "beam-without-inertia": beam_without_inertia,
    "rotor-without-inertia": rotor_without_inertia,
    "soft-mounts": soft_mounts,
    "free-parts": free_parts,
    "equal-blades": equal_blades,
    "hidden-modes": hidden_modes,
    "parameters-without-mass": parameters_without_mass,
}
