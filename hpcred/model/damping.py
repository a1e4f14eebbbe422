"""Damping laws: which D belongs to a model with M and K."""

from copy import copy
from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ..parallel.declared import as_declared, declared
from ..parallel.failures import InputError
from ..parallel.petsc import SAME, PETSc
from ..parallel.ranges import ANYTHING, FREQUENCY, within

RATIO = (0.0, 1e3, "")  # damping ratios and loss factors
ALPHA, BETA = (0.0, 1e12, "1/s"), (0.0, 1e6, "s")


@dataclass(frozen=True)
class NoDamping:
    """D = 0, even if the model has a damping matrix."""

    kind: Literal["none"] = field(default="none", kw_only=True, repr=False)


@dataclass(frozen=True)
class GivenDamping:
    """The damping matrix of the model; `loss_factor`: beside it (1 + i eta) K in frequency responses."""

    kind: Literal["given"] = field(default="given", kw_only=True, repr=False)
    loss_factor: float = 0.0

    def __post_init__(self):
        as_declared(self, "damping.")
        within("damping.loss_factor", self.loss_factor, RATIO)


@dataclass(frozen=True)
class Rayleigh:
    """D = alpha M + beta K (40); alpha in 1/s, beta in s."""

    kind: Literal["rayleigh"] = field(default="rayleigh", kw_only=True, repr=False)
    alpha: float = 0.0
    beta: float = 0.0

    def __post_init__(self):
        as_declared(self, "damping.")
        if min(self.alpha, self.beta) < 0:
            raise InputError(f"damping: found alpha = {self.alpha:g}, beta = {self.beta:g}; neither may be negative")
        within("damping.alpha", self.alpha, ALPHA)
        within("damping.beta", self.beta, BETA)

    @property
    def coefficients(self) -> tuple[float, float]:
        """Those of the Caughey series that it is."""
        return self.alpha, self.beta


@dataclass(frozen=True)
class Caughey:
    """D = M sum_k a_k (M^-1 K)^k (39) with `coefficients` a_0, a_1, ...; a_k in s^(2k-1).

    With more than two terms D is not sparse, and is applied by solves with M.
    """

    kind: Literal["caughey"] = field(default="caughey", kw_only=True, repr=False)
    coefficients: tuple[float, ...]

    def __post_init__(self):
        as_declared(self, "caughey.")
        if not self.coefficients:
            raise InputError("caughey.coefficients: expected at least one number")
        within("caughey.coefficients", self.coefficients, ANYTHING)


@dataclass(frozen=True)
class ModalDamping:
    """Damping ratios of the diagonalised reduced model, 2 xi_i omega_i on the diagonal of D (38, 52).

    Exactly one of `ratio` for all modes, `ratios` mode by mode (the last one holds for all above), and `table` of
    (frequency in Hz, ratio) pairs, interpolated linearly and constant outside.
    """

    kind: Literal["modal"] = field(default="modal", kw_only=True, repr=False)
    ratio: float | None = None
    ratios: tuple[float, ...] | None = None
    table: tuple[tuple[float, float], ...] | None = None

    def __post_init__(self):
        as_declared(self, "damping.")
        given = [value for value in (self.ratio, self.ratios, self.table) if value is not None]
        if len(given) != 1 or given[0] == ():
            raise InputError("damping: kind 'modal' needs exactly one of ratio, ratios and table")
        within("damping.ratio", self.ratio, RATIO)
        within("damping.ratios", self.ratios, RATIO)
        for frequency, ratio in self.table or ():
            within("damping.table", frequency, FREQUENCY)
            within("damping.table", ratio, RATIO)
        if self.table is not None and list(self.table) != sorted(self.table):
            raise InputError("damping.table: expected frequencies in ascending order")

    def at(self, frequencies: np.ndarray) -> np.ndarray:
        """Damping ratios (m,) of modes with these frequencies (Hz)."""
        if self.ratio is not None:
            return np.full(len(frequencies), self.ratio)
        if self.table is not None:
            return np.interp(frequencies, *np.array(self.table).T)
        return np.array([self.ratios[min(i, len(self.ratios) - 1)] for i in range(len(frequencies))])


@dataclass(frozen=True)
class Structural:
    """Structural (hysteretic) damping: (1 + i eta) K in frequency responses, none in time; eta = loss_factor."""

    kind: Literal["structural"] = field(default="structural", kw_only=True, repr=False)
    loss_factor: float

    def __post_init__(self):
        as_declared(self, "damping.")
        within("damping.loss_factor", self.loss_factor, RATIO)


def loss_factor_of(damping) -> float:
    """eta of (1 + i eta) K in frequency responses with a damping law."""
    return damping.loss_factor if isinstance(damping, Structural | GivenDamping) else 0.0


def doubts_of_damping(damping) -> tuple[str, ...]:
    """Ratios and loss factors that look like per cent: a body that does not vibrate at all is no use of either."""
    if isinstance(damping, ModalDamping):
        largest = max([ratio for _, ratio in damping.table or ()] or damping.ratios or [damping.ratio])
        what = "the ratio {:g}, where 1 is critical damping, beyond which nothing vibrates"
    elif isinstance(damping, Structural | GivenDamping):
        largest, what = damping.loss_factor, "the loss factor {:g}, twice the damping ratio at a resonance"
    else:
        return ()
    return (f"damping: found {what.format(largest)}; 0.01 is 1 %",) if largest >= 1 else ()


def with_damping(model, damping):
    """The model with the D of a damping law, without one for the laws that have no sparse matrix. Collective.

    Raises InputError when there is none to be given.
    """
    damping = declared("damping", damping, Damping | None)
    if isinstance(damping, GivenDamping):
        if model.D is None:
            raise InputError(f"damping.kind: 'given' needs a damping matrix, {model.name} has none")
        return model.with_damping_matrix(copy(model.D))
    if not isinstance(damping, Rayleigh | Caughey) or caughey_terms(damping) is not None:
        return model.with_damping_matrix(None)
    alpha, beta = (*damping.coefficients, 0.0)[:2]
    mat = model.M.duplicate(copy=True)
    mat.scale(alpha)
    mat.axpy(beta, model.K, structure=SAME)
    mat.stateIncrease()
    return model.with_damping_matrix(mat)


def caughey_terms(damping) -> tuple[float, ...] | None:
    """The coefficients of a Caughey series that is not a sparse matrix, else None."""
    if isinstance(damping, Caughey) and len(damping.coefficients) > 2:
        return damping.coefficients
    return None


def is_proportional(model) -> bool:
    """Whether D is a combination of M and K, by two random vectors; True without D. Collective."""
    if model.D is None:
        return True
    random = PETSc.Random().create(model.K.comm)
    random.setFromOptions()
    vectors = {key: mat.createVecLeft() for key, mat in model.matrices.items()}
    x = model.K.createVecRight()
    proportional = True
    for _ in range(2):
        x.setRandom(random)
        for key, mat in model.matrices.items():
            mat.mult(x, vectors[key])
        m, k, d = (vectors[key] for key in "MKD")
        gram = np.array([[m.dot(m), m.dot(k)], [k.dot(m), k.dot(k)]]).real
        scale = 1 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
        right = np.array([m.dot(d), k.dot(d)]).real * scale
        alpha, beta = np.linalg.lstsq(gram * np.outer(scale, scale), right, rcond=None)[0] * scale
        size = d.norm()
        d.axpy(-alpha, m)
        d.axpy(-beta, k)
        proportional = proportional and d.norm() <= 1e-6 * size
    for item in (*vectors.values(), x, random):
        item.destroy()
    return bool(proportional)


Damping = Annotated[
    NoDamping | GivenDamping | Rayleigh | Caughey | ModalDamping | Structural, Field(discriminator="kind")
]


def damping_or_given(model, damping) -> Damping:
    """A damping law that a user gave, or None for that of the damping matrix of the model, if it has one."""
    if declared("damping", damping, Damping | None) is not None:
        return damping
    return NoDamping() if model.D is None else GivenDamping()
