"""Random affine models, and the dense truth of what is said of their reductions. Matrices are the same on all ranks."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from adaptive_models import chain, dashpots, dynamic, pair, unit
from mpi4py import MPI

from hpcred import GivenDamping, NoDamping, Parameter, ParametricModel, Rayleigh, SecondOrderModel, Term, Viscoelastic
from hpcred.laws import Fractional, FractionalKelvinVoigt, Maxwell
from hpcred.reduction.result.measure import MEASURES
from hpcred.reduction.small.damping import measured_damping
from hpcred.reduction.small.error_estimate import measure_over
from hpcred.reduction.small.pseudo_modal import InputsOutputs, diagonalised


@dataclass
class AffineCase:
    """Constant parts K, M, D (n, n), B (n, p), Ct (n, r) or None; `terms`: (of, matrix, factor); `band` in Hz; `parts`:
    whose static stiffness is in K already."""

    name: str
    K: np.ndarray
    M: np.ndarray
    B: np.ndarray
    band: tuple[float, float]
    parameters: list[Parameter]
    terms: list[tuple[str, np.ndarray, str]]
    D: np.ndarray | None = None
    Ct: np.ndarray | None = None
    damping: object = field(default_factory=NoDamping)
    circulatory: bool = False
    parts: list[Viscoelastic] = field(default_factory=list)

    def model(self, comm=None):
        outputs = {} if self.Ct is None else {"outputs": self.Ct, "output_names": self.names("y", self.Ct)}
        model = SecondOrderModel.from_scipy(
            self.K, self.M, self.D, comm or MPI.COMM_WORLD, inputs=self.B, input_names=self.names("u", self.B),
            name=self.name, circulatory=self.circulatory, **outputs
        )
        excess = [replace(part, law=in_k(part.law)) for part in self.parts]
        with model, model.with_viscoelastic(excess) as whole:
            return ParametricModel(whole, self.parameters, [Term(*item) for item in self.terms])

    @staticmethod
    def names(letter, columns):
        return [f"{letter}{i}" for i in range(columns.shape[1])]

    def matrices(self, values):
        """M, D, K, B, Ct at values of the parameters; D is zero where there is none."""
        n = len(self.K)
        found = {"M": self.M, "K": self.K, "D": np.zeros((n, n)) if self.D is None else self.D, "B": self.B,
                 "C": self.B.T if self.Ct is None else self.Ct.T}  # fmt: skip
        for of, matrix, factor in self.terms:
            theta = Term(of, matrix, factor).expression.at(values)
            found[of] = found[of] + theta * matrix
            if of == "B" and self.Ct is None:
                found["C"] = found["C"] + theta * matrix.T
        return found

    def eps(self, rom, pairs):
        """The true error of a reduced model at pairs (f, values), with the damping that it was measured with."""
        given = isinstance(self.damping, GivenDamping)
        damping = measured_damping(self.damping, 1e-3, self.band, bool(self.parts))[0]
        if (given or self.parts) and rom.record.accuracy.loss_factor:
            damping = damping._replace(eta=rom.record.accuracy.loss_factor)
        errors = []
        for f, values in pairs:
            full = self.matrices(values)
            A = next(dynamic(full["K"], full["M"], full["D"] if given else None, damping, np.array([f])))
            A = A + sum(part.law.excess(2j * np.pi * f) * part.matrix for part in self.parts)
            X = np.linalg.solve(A, full["B"].astype(complex))
            X += np.linalg.solve(A, full["B"] - A @ X)
            H, drive = full["C"] @ X, (full["B"] * X).sum(axis=0)
            at = rom.at(**values)
            small = next(dynamic(at.K, at.M, at.D if given else None, damping, np.array([f])))
            small = small + sum(part.law.excess(2j * np.pi * f) * part.matrix for part in at.viscoelastic)
            reduced = at.C @ np.linalg.solve(small, at.B.astype(complex))
            measure = self.measure(at, damping, given)
            errors.append(float(measure.eps((H - reduced)[None], H[None], drive[None])[0]))
        return np.array(errors)

    def measure(self, at, damping, given):
        """The measure by directions with the floors of a reduced model, which are medians of its responses."""
        L = at.B if self.Ct is None else np.hstack([at.B, at.C.T])
        p = at.B.shape[1]
        inputs = np.eye(L.shape[1])[:, :p]
        io = InputsOutputs(inputs, inputs if self.Ct is None else np.eye(L.shape[1])[:, p:])
        model = diagonalised(
            at.K, L, at.D if given else None, damping, io, at.added, symmetric=not self.circulatory
        )
        return measure_over(MEASURES["directions"], self.band, model)


def random_affine(seed, most=60):
    """A random affine model with 1 to 3 parameters, and a tolerance."""
    rng = np.random.default_rng(7000 + seed)
    n = int(rng.integers(15, most))
    K, M = chain(n, rng=rng, spread=rng.uniform(0, 1))
    for _ in range(int(rng.integers(0, n // 2))):
        e = pair(n, *rng.choice(n, 2, replace=False))
        K += 1e4 * 10 ** rng.uniform(-4, 0.5) * np.outer(e, e)
    p = int(rng.integers(1, 4))
    B = rng.standard_normal((n, p)) if rng.random() < 0.4 else unit(n, *rng.choice(n, p, replace=False))
    count = int(rng.integers(1, 4))
    parameters, terms, damping, D, Ct = [], [], NoDamping(), None, None
    kind = rng.random()
    given = kind >= 0.5
    if kind < 0.25:
        damping = Rayleigh(rng.uniform(0, 2), 10 ** rng.uniform(-5, -3))
    elif given:
        damping, D = GivenDamping(), dashpots(n, int(rng.integers(0, 10)), rng, (0.1, 20.0))
    for i in range(count):
        low, high = (0.0, 1.0) if rng.random() < 0.6 else (10 ** rng.uniform(-2, 0), 10 ** rng.uniform(0.5, 2))
        parameters.append(Parameter(f"p{i}", (low, high)))
        of = rng.choice(["K", "K", "K", "M", "D", "G", "B", "omega"] if given else ["K", "K", "K", "M", "B"])
        if i == 0 and of == "B":
            of = "K"
        factor = str(rng.choice([f"p{i}", f"p{i}^2", f"1 + 0.3*p{i}", f"sqrt(p{i})"]))
        springs = np.zeros((n, n))
        for _ in range(int(rng.integers(1, 6))):
            e = pair(n, *rng.choice(n + 1, 2, replace=False))
            springs += 10 ** rng.uniform(-1, 0.5) * np.outer(e, e)
        G = np.zeros((n, n))
        for _ in range(int(rng.integers(1, 8))):
            j, k = rng.choice(n, 2, replace=False)
            G[j, k] += rng.uniform(0, 40) / high
        G = G - G.T
        if of == "K":
            terms.append(("K", springs * 1e4 / high, factor))
        elif of == "M":
            terms.append(("M", np.diag(rng.uniform(0, 2, n) * (rng.random(n) < 0.3)) / high, factor))
        elif of == "D":
            terms.append(("D", springs * 10 / high, factor))
        elif of == "G":
            terms.append(("D", G, factor))
        elif of == "B":
            terms.append(("B", rng.standard_normal((n, p)) / high, factor))
        else:
            terms += [("D", G, f"p{i}"), ("K", springs * 1e3 / high**2, f"-p{i}^2")]
    if rng.random() < 0.25:
        Ct = unit(n, *rng.choice(n, int(rng.integers(1, 4)), replace=False))
    case = AffineCase(f"affine {seed}", K, M, B, (0.0, 1.0), parameters, terms, D, Ct, damping)
    values = {item.name: item.reference for item in parameters}
    full = case.matrices(values)
    root = np.linalg.inv(np.linalg.cholesky(full["M"]))
    frequencies = np.sqrt(np.maximum(np.linalg.eigvalsh(root @ full["K"] @ root.T), 0)) / (2 * np.pi)
    case.band = 0.0, float(frequencies[int(rng.integers(1, max(3, n // 3)))] * rng.uniform(0.8, 1.2))
    for ends in product(*(item.range for item in parameters)):
        full = case.matrices(dict(zip(values, ends, strict=True)))
        if np.linalg.eigvalsh(full["K"])[0] <= 0:  # at some of the values the response at 0 Hz is infinite
            case.band = 0.05 * case.band[1], case.band[1]
    return case, float(10.0 ** -rng.integers(2, 7))


def random_circulatory(seed, most=60):
    """A random affine model with circulatory terms as well, some of them unsymmetric, and its tolerance."""
    case, tolerance = random_affine(seed, most)
    rng, n = np.random.default_rng(9000 + seed), len(case.K)
    case.name, case.circulatory = f"circulatory {seed}", True

    def circulatory(strength):
        N = np.zeros((n, n))
        for _ in range(int(rng.integers(1, 8))):
            j, k = rng.choice(n, 2, replace=False)
            N[j, k] += rng.uniform(-1, 1)
        return strength * (N - N.T if rng.random() < 0.7 else N)

    if rng.random() < 0.4:
        case.K = case.K + circulatory(1e4 * 10 ** rng.uniform(-4, -1))
    for item in case.parameters[: int(rng.integers(1, 3))]:
        factor = str(rng.choice([item.name, f"{item.name}^2", f"2 - 0.5*{item.name}"]))
        largest = max(abs(Term("K", None, factor).expression.at({item.name: end})) for end in item.range)
        case.terms.append(("K", circulatory(1e4 * 10 ** rng.uniform(-4, -0.5)) / largest, factor))
    return case, tolerance


def in_k(law):
    """The same law without its static value."""
    if isinstance(law, Fractional):
        return replace(law, low=0.0, high=law.high - law.low)
    return replace(law, **{"constant" if isinstance(law, Maxwell) else "low": 0.0})


def random_viscoelastic(seed, most=60):
    """A random affine model with viscoelastic parts, and its tolerance."""
    case, tolerance = random_affine(seed, most)
    rng, n = np.random.default_rng(11000 + seed), len(case.K)
    case.name = f"viscoelastic {seed}"
    unsymmetric = any(np.abs(matrix - matrix.T).max() > 0 for of, matrix, _ in case.terms if of == "D")
    negative = any(factor.startswith("-") for *_, factor in case.terms)
    omega = 2 * np.pi * case.band[1]
    for _ in range(int(rng.integers(1, 3))):
        Kv = np.zeros((n, n))
        for _ in range(int(rng.integers(1, n))):
            e = pair(n, *rng.choice(n + 1, 2, replace=False))
            Kv += 1e4 * 10 ** rng.uniform(-3, 0) * np.outer(e, e)
        times = (10 ** rng.uniform(-2, 2, int(rng.integers(1, 4))) / omega).tolist()
        laws = [Maxwell(factors=[1.0] * len(times), times=times)]
        if not (unsymmetric or negative):
            exponent = float(rng.uniform(0.2, 0.9))
            laws += [Fractional(low=0.0, high=5.0, time=times[0], exponent=exponent),
                     FractionalKelvinVoigt(low=0.0, rise=0.3, time=times[0], exponent=exponent)]  # fmt: skip
        case.parts.append(Viscoelastic(Kv, laws[int(rng.integers(len(laws)))]))
    return case, tolerance


def fresh_pairs(case, count=24, seed=5):
    """Random pairs of a frequency and values, corners of the ranges among them, and pairs near resonances."""
    rng = np.random.default_rng(seed)
    pairs = []
    for k in range(count):
        values = {}
        for item in case.parameters:
            low, high = item.range
            part = rng.choice([0.0, 1.0]) if k % 8 == 0 else rng.random()
            logarithmic = low > 0 and k % 2
            values[item.name] = float(np.clip(low * (high / low) ** part if logarithmic else low + part * (high - low),
                                              low, high))  # fmt: skip
        f = float(rng.uniform(*case.band))
        if k % 4 == 1:  # near an eigenfrequency
            full = case.matrices(values)
            root = np.linalg.inv(np.linalg.cholesky(full["M"]))
            own = np.sqrt(np.maximum(np.linalg.eigvalsh(root @ full["K"] @ root.T), 0)) / (2 * np.pi)
            own = own[(own > case.band[0]) & (1.0003 * own < case.band[1])]
            f = float(1.0003 * rng.choice(own)) if len(own) else f
        pairs.append((f, values))
    return pairs
