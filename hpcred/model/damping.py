"""Define the damping models, and make the damping matrix D of a model with M and K."""

from copy import copy
from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ..parallel.declared import Settings, as_declared, declared
from ..parallel.failures import InputError
from ..parallel.petsc import SAME, PETSc
from ..parallel.ranges import Frequency, Number, Range, within

Ratio = Annotated[float, Range(0.0, 1e3)]  # a damping ratio or a loss factor
ALPHA, BETA = Range(0.0, 1e12, "1/s"), Range(0.0, 1e6, "s")


class DampingSettings(Settings):
    """Base of the damping models."""

    where = "damping."


@dataclass(frozen=True)
class NoDamping:
    """No damping: D = 0, also if the model has a damping matrix."""

    kind: Literal["none"] = field(default="none", kw_only=True, repr=False)


@dataclass(frozen=True)
class GivenDamping(DampingSettings):
    """The damping matrix of the model.

    Parameters
    ----------
    loss_factor : float, default 0.0
        eta of additional structural damping: K is (1 + i eta) K in frequency responses.

    Raises
    ------
    InputError
        For a value outside of 0 to 1000.
    """

    kind: Literal["given"] = field(default="given", kw_only=True, repr=False)
    loss_factor: Ratio = 0.0


@dataclass(frozen=True)
class Rayleigh:
    """Rayleigh damping, D = alpha M + beta K (40).

    Parameters
    ----------
    alpha : float, default 0.0
        Coefficient of M in 1/s.
    beta : float, default 0.0
        Coefficient of K in s.

    Raises
    ------
    InputError
        For negative coefficients.

    Notes
    -----
    The damping ratio at the frequency f is alpha / (4 pi f) + beta pi f.
    """

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
        """The coefficients as those of a Caughey series."""
        return self.alpha, self.beta


@dataclass(frozen=True)
class Caughey(Settings):
    """Caughey series, D = M sum_k a_k (M^-1 K)^k (39).

    Parameters
    ----------
    coefficients : sequence of float
        a_0, a_1, ...; a_k in s^(2k-1).

    Raises
    ------
    InputError
        Without a coefficient.

    Notes
    -----
    With more than two terms D is not sparse, and is applied by solves with M.
    """

    kind: Literal["caughey"] = field(default="caughey", kw_only=True, repr=False)
    coefficients: tuple[Number, ...]

    where = "caughey."

    def __post_init__(self):
        super().__post_init__()
        if not self.coefficients:
            raise InputError("caughey.coefficients: expected at least one number")


@dataclass(frozen=True)
class ModalDamping(DampingSettings):
    """Damping ratios of the diagonalised reduced model, 2 xi_i omega_i on the diagonal of D (38, 52).

    Parameters
    ----------
    ratio : float, optional
        One ratio for all modes; 0.01 is 1 %.
    ratios : sequence of float, optional
        One ratio for each mode; the last one holds for all above.
    table : sequence of (float, float), optional
        Pairs of a frequency in Hz, ascending, and a ratio; linear between them, constant outside.

    Raises
    ------
    InputError
        Unless exactly one of the three is given.
    """

    kind: Literal["modal"] = field(default="modal", kw_only=True, repr=False)
    ratio: Ratio | None = None
    ratios: tuple[Ratio, ...] | None = None
    table: tuple[tuple[Frequency, Ratio], ...] | None = None

    def __post_init__(self):
        super().__post_init__()
        ways = [value for value in (self.ratio, self.ratios, self.table) if value is not None]
        if len(ways) != 1 or ways[0] == ():
            raise InputError("damping: kind 'modal' needs exactly one of ratio, ratios and table")
        if self.table is not None and list(self.table) != sorted(self.table):
            raise InputError("damping.table: expected frequencies in ascending order")

    def at(self, frequencies: np.ndarray) -> np.ndarray:
        """Return the damping ratios (m,) of modes with these `frequencies` (m,) in Hz."""
        if self.ratio is not None:
            return np.full(len(frequencies), self.ratio)
        if self.table is not None:
            return np.interp(frequencies, *np.array(self.table).T)
        return np.array([self.ratios[min(i, len(self.ratios) - 1)] for i in range(len(frequencies))])


@dataclass(frozen=True)
class Structural(DampingSettings):
    """Structural (hysteretic) damping: K is (1 + i eta) K in frequency responses; there is none in time.

    Parameters
    ----------
    loss_factor : float
        eta, twice the damping ratio at a resonance.

    Raises
    ------
    InputError
        For a value outside of 0 to 1000.
    """

    kind: Literal["structural"] = field(default="structural", kw_only=True, repr=False)
    loss_factor: Ratio


def loss_factor_of(damping) -> float:
    """Return eta of (1 + i eta) K in frequency responses with a damping model."""
    return damping.loss_factor if isinstance(damping, Structural | GivenDamping) else 0.0


def warnings_of_damping(damping) -> tuple[str, ...]:
    """Return warnings of ratios and loss factors of 1 and more, which were probably meant as per cent."""
    if isinstance(damping, ModalDamping):
        largest = max([ratio for _, ratio in damping.table or ()] or damping.ratios or [damping.ratio])
        what = "the ratio {:g}, where 1 is critical damping, beyond which nothing vibrates"
    elif isinstance(damping, Structural | GivenDamping):
        largest, what = damping.loss_factor, "the loss factor {:g}, twice the damping ratio at a resonance"
    else:
        return ()
    return (f"damping: found {what.format(largest)}; 0.01 is 1 %",) if largest >= 1 else ()


def with_damping(model, damping):
    """Return the model with the D of a damping model, without D for those that have no sparse matrix. Collective.

    Raises InputError for "given" damping of a model without damping matrix.
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
    """Return the coefficients of a Caughey series that is not a sparse matrix, else None."""
    if isinstance(damping, Caughey) and len(damping.coefficients) > 2:
        return damping.coefficients
    return None


def is_proportional(model) -> bool:
    """Test by two random vectors whether D is a combination of M and K; True without D. Collective."""
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
    return bool(proportional)


Damping = Annotated[
    NoDamping | GivenDamping | Rayleigh | Caughey | ModalDamping | Structural, Field(discriminator="kind")
]


def damping_or_given(model, damping) -> Damping:
    """Return the damping model of a user, or for None the default: the damping matrix of the model, if it has one."""
    if declared("damping", damping, Damping | None) is not None:
        return damping
    return NoDamping() if model.D is None else GivenDamping()
