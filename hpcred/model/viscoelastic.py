"""Describe stiffness that depends on frequency, K(s) = K_e + sum g(s) K_v, by the laws g of viscoelastic materials.

A model holds the static stiffness K = K_e + sum g(0) K_v, and what its parts add to it, (g(s) - g(0)) K_v.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from ..linalg.csr import compress
from ..linalg.matrix_estimates import extreme_quotients, symmetry_defect
from ..parallel.declared import as_declared, declared
from ..parallel.failures import InputError, agreed
from ..parallel.petsc import PETSc
from ..parallel.ranges import within
from .checked_arrays import check_finite, coordinates
from .cut_outputs import cut_output_of
from .petsc_matrices import taken

if TYPE_CHECKING:
    from scipy.sparse import sparray, spmatrix

FACTOR, TIME, EXPONENT = (0.0, 1e30, ""), (1e-30, 1e30, "s"), (1e-3, 1.0, "")
SYMMETRIC_TO, NEGATIVE = 1e-10, 1e-7  # symmetry defect of K_v; x^T K_v x of its diagonal, by round-off of files
KEY = "Kv"  # of the matrices K_v of a model by name: Kv1, Kv2, ...


@dataclass(frozen=True)
class Maxwell:
    """Generalised Maxwell model, g(s) = constant + sum_k factors_k s times_k / (1 + s times_k).

    Parameters
    ----------
    factors : sequence of float
        Stiffness of each Maxwell element over that of K_v, not negative.
    times : sequence of float
        Relaxation time of each in s.
    constant : float, default 0.0
        Static value g(0), of the spring beside the elements.

    Raises
    ------
    InputError
        For negative numbers, and numbers of factors and times that differ.
    """

    kind: Literal["maxwell"] = field(default="maxwell", kw_only=True, repr=False)
    factors: tuple[float, ...]
    times: tuple[float, ...]
    constant: float = 0.0

    def __post_init__(self):
        as_declared(self, "law.")
        if len(self.factors) != len(self.times) or not self.factors:
            raise InputError(
                f"law: found {len(self.factors)} factors and {len(self.times)} times, expected one of each for every "
                "Maxwell element"
            )
        within("law.factors", self.factors, FACTOR)
        within("law.times", self.times, TIME)
        within("law.constant", self.constant, FACTOR)

    @property
    def static(self) -> float:
        """The value g(0)."""
        return self.constant

    def excess(self, s: np.ndarray) -> np.ndarray:
        """Return g(s) - g(0) of s (...) in 1/s."""
        x = np.asarray(s)[..., None] * np.array(self.times)
        return (np.array(self.factors) * x / (1 + x)).sum(axis=-1)

    def in_units(self, time: float) -> Maxwell:
        """Return the law with times in another unit of so many seconds."""
        return replace(self, times=tuple(value / time for value in self.times))

    def slope(self, s: np.ndarray) -> np.ndarray:
        """Return the derivative of g at s (...)."""
        times = np.array(self.times)
        return (np.array(self.factors) * times / (1 + np.asarray(s)[..., None] * times) ** 2).sum(axis=-1)


@dataclass(frozen=True)
class Fractional:
    """Fractional Zener model, g(s) = (low + high (s time)^exponent) / (1 + (s time)^exponent).

    Parameters
    ----------
    low, high : float
        Static value g(0), and the limit at high frequencies, not below it.
    time : float
        Relaxation time in s.
    exponent : float
        Of the derivative, above 0 and at most 1.

    Raises
    ------
    InputError
        For numbers that are out of range.
    """

    kind: Literal["fractional"] = field(default="fractional", kw_only=True, repr=False)
    low: float
    high: float
    time: float
    exponent: float

    def __post_init__(self):
        as_declared(self, "law.")
        within("law.low", self.low, FACTOR)
        within("law.high", self.high, FACTOR)
        within("law.time", self.time, TIME)
        within("law.exponent", self.exponent, EXPONENT)
        if self.high < self.low:
            raise InputError(f"law: found low = {self.low:g} above high = {self.high:g}; damped materials stiffen")

    @property
    def static(self) -> float:
        """The value g(0)."""
        return self.low

    def excess(self, s: np.ndarray) -> np.ndarray:
        """Return g(s) - g(0) of s (...) in 1/s."""
        z = _power(s, self.time, self.exponent)
        return (self.high - self.low) * z / (1 + z)

    def in_units(self, time: float) -> Fractional:
        """Return the law with its time in another unit of so many seconds."""
        return replace(self, time=self.time / time)

    def slope(self, s: np.ndarray) -> np.ndarray:
        """Return the derivative of g at s (...) other than 0."""
        z = _power(s, self.time, self.exponent)
        return (self.high - self.low) * self.exponent * z / (s * (1 + z) ** 2)


@dataclass(frozen=True)
class FractionalKelvinVoigt:
    """Fractional Kelvin-Voigt model, g(s) = low + rise (s time)^exponent.

    Parameters
    ----------
    low : float
        Static value g(0).
    rise : float
        Factor of the fractional derivative.
    time : float
        In s.
    exponent : float
        Of the derivative, above 0 and at most 1, which is viscous damping.

    Raises
    ------
    InputError
        For numbers that are out of range.
    """

    kind: Literal["fractional_kelvin_voigt"] = field(default="fractional_kelvin_voigt", kw_only=True, repr=False)
    low: float
    rise: float
    time: float
    exponent: float

    def __post_init__(self):
        as_declared(self, "law.")
        within("law.low", self.low, FACTOR)
        within("law.rise", self.rise, FACTOR)
        within("law.time", self.time, TIME)
        within("law.exponent", self.exponent, EXPONENT)

    @property
    def static(self) -> float:
        """The value g(0)."""
        return self.low

    def excess(self, s: np.ndarray) -> np.ndarray:
        """Return g(s) - g(0) of s (...) in 1/s."""
        return self.rise * _power(s, self.time, self.exponent)

    def in_units(self, time: float) -> FractionalKelvinVoigt:
        """Return the law with its time in another unit of so many seconds."""
        return replace(self, time=self.time / time)

    def slope(self, s: np.ndarray) -> np.ndarray:
        """Return the derivative of g at s (...) other than 0."""
        return self.exponent * self.excess(s) / s


Law = Annotated[Maxwell | Fractional | FractionalKelvinVoigt, Field(discriminator="kind")]


@dataclass(frozen=True, eq=False)
class Viscoelastic:
    """A part of a body with a stiffness that depends on frequency, g(s) K_v.

    Parameters
    ----------
    matrix : SciPy sparse matrix, ndarray or PETSc.Mat, shape (n, n)
        K_v, symmetric and positive semidefinite.
    law : Maxwell, Fractional or FractionalKelvinVoigt
        g(s).
    name : str, default ""
        Name in messages and records, by default "Kv1", "Kv2" and so on.
    within : bool, default False
        Whether K of the model has K_v already, as that of elements with the modulus of their material, for which g is
        1; K_e is K - K_v then.

    Raises
    ------
    InputError
        For what is no law.
    """

    matrix: spmatrix | sparray | np.ndarray | PETSc.Mat
    law: Law
    name: str = ""
    within: bool = False

    def __post_init__(self):
        object.__setattr__(self, "law", declared("law", self.law, Law))
        object.__setattr__(self, "name", declared("name", self.name, str))

    @property
    def in_words(self) -> str:
        """Name and law."""
        return f"{self.name}: {self.law!r}"


@dataclass(frozen=True, kw_only=True)
class NamedLaw:
    """The law of a part by name, for records."""

    name: str
    law: Law


def laws_of(parts) -> tuple[NamedLaw, ...]:
    """Return names and laws of viscoelastic parts."""
    return tuple(NamedLaw(name=part.name, law=part.law) for part in parts)


def excesses(parts, s) -> np.ndarray:
    """Return g(s) - g(0) of each part (parts, ...) at s (...) in 1/s."""
    s = np.asarray(s, dtype=complex)
    return np.array([part.law.excess(s) for part in parts]).reshape(len(parts), *s.shape)


def added_stiffness(parts, s) -> np.ndarray:
    """Return the sum of (g(s) - g(0)) K_v (..., m, m) of small parts at s (...) in 1/s."""
    return np.tensordot(np.moveaxis(excesses(parts, s), 0, -1), np.array([part.matrix for part in parts]), axes=1)


def transformed(parts, transform) -> tuple[Viscoelastic, ...]:
    """Return the parts with transform(matrix) for each matrix."""
    return tuple(replace(part, matrix=transform(part.matrix)) for part in parts)


def matrices_by_key(parts) -> dict:
    """Return the matrices of parts by the keys that they have among those of a model."""
    return {f"{KEY}{number}": part.matrix for number, part in enumerate(parts, 1)}


def parts_from(parts, matrices: dict) -> tuple[Viscoelastic, ...]:
    """Return the parts with other matrices, by their keys among those of a model."""
    return tuple(replace(part, matrix=matrices[key]) for key, part in zip(matrices_by_key(parts), parts, strict=True))


def with_viscoelastic(model, parts):
    """Return the model, whose K is K_e, with viscoelastic parts; see SecondOrderModel.with_viscoelastic. Collective.
    Raises InputError."""
    parts = tuple(declared("parts", parts, tuple[Viscoelastic, ...]))
    if model.viscoelastic:
        raise InputError(f"{model.name}: it has viscoelastic parts already; give all of them at once")
    if not parts:
        return model.shared()
    if any(cut_output_of(name) for name in model.own_output_names):
        raise cuts_refused(model)
    named = tuple(replace(part, name=part.name or f"{KEY}{number}") for number, part in enumerate(parts, 1))
    names = [part.name for part in named]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise InputError(f"{model.name}: found two viscoelastic parts with the name '{twice}', expected one of each "
                         "name; give another one a name of its own")  # fmt: skip
    given = {key: _of_rows(model, mat, part.name)
             for part, (key, mat) in zip(named, matrices_by_key(named).items(), strict=True)}  # fmt: skip
    mats, _ = taken(model.matrices | given, None, model.name)
    found = parts_from(named, mats)
    for part in found:
        _check(model, part)
    K = mats["K"].copy()
    for part in found:
        if more := part.law.static - part.within:
            K.axpy(more, part.matrix, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
    K.stateIncrease()
    return model.with_fields(M=mats["M"], K=K, D=mats.get("D"), viscoelastic=found)


def cuts_refused(model) -> InputError:
    """Return the error for section forces of a model with viscoelastic parts."""
    return InputError(
        f"outputs: {model.name} has viscoelastic parts, and the force of a cut is that of the static stiffness alone; "
        "leave the outputs of cuts out"
    )


def _of_rows(model, matrix, name) -> PETSc.Mat:
    """Return a matrix that every rank has as one with the rows of the model; PETSc's stays as it is. Collective."""
    if isinstance(matrix, PETSc.Mat):
        return matrix
    with agreed(model.comm):
        i, j, v, size = coordinates(name, matrix)
        if size != model.size:
            raise InputError(f"{name}: found {size} rows of K_v, expected {model.size} as K of {model.name} has")
    first, last = model.first_row, model.first_row + model.local_rows
    mine = (i >= first) & (i < last) & (v != 0)
    indptr, indices, found = compress({"": (i[mine], j[mine], v[mine])}, first, last, model.size)
    csr = (indptr.astype(PETSc.IntType), indices.astype(PETSc.IntType), found[""])
    return PETSc.Mat().createAIJ(model.K.getSizes(), csr=csr, comm=model.K.comm)


def _check(model, part):
    """Refuse a K_v that is not symmetric and positive semidefinite, or has no numbers. Collective."""
    with agreed(model.comm):
        indptr, _, values = part.matrix.getValuesCSR()
        check_finite(indptr, {part.name: values}, model.first_row, model.name, model.dofs)
    if not part.matrix.norm(PETSc.NormType.FROBENIUS) > 0:
        raise InputError(f"{part.name}: K_v is zero, expected the stiffness of the viscoelastic parts of {model.name}")
    if (defect := symmetry_defect(part.matrix)) > SYMMETRIC_TO:
        raise InputError(
            f"{part.name}: found an unsymmetric K_v (a_ij and a_ji differ by {defect:.1e} of them), expected a "
            "symmetric one, as stiffness of a material is"
        )
    low, high = extreme_quotients(part.matrix)
    if low < -NEGATIVE * max(high, 1.0):
        raise InputError(
            f"{part.name}: x^T K_v x comes down to {low:.1e} of its diagonal, expected none below zero: K_v would put "
            "energy in"
        )


def _power(s, time, exponent):
    return (np.asarray(s, dtype=complex) * time) ** exponent
