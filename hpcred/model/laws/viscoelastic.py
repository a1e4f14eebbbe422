"""Define the laws g(s) of viscoelastic materials, of which g(s) - g(0) is added to the static stiffness."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

import numpy as np

from ...parallel.declared import Settings
from ...parallel.failures import InputError
from ...parallel.ranges import Range
from ..operator import Law

Factor = Annotated[float, Range(0.0, 1e30)]
Time = Annotated[float, Range(1e-30, 1e30, "s")]
Exponent = Annotated[float, Range(1e-3, 1.0)]


class ViscoelasticLaw(Settings, Law):
    """A law g(s) of a material, whose coefficient is g(s) - g(0)."""

    where = "law."
    family = "viscoelastic"
    nature = "fractional"

    @property
    @abstractmethod
    def static(self) -> float:
        """The value g(0)."""

    @abstractmethod
    def excess(self, s: np.ndarray) -> np.ndarray:
        """Return g(s) - g(0) of s (...) in 1/s."""

    def coefficient(self, s: np.ndarray) -> np.ndarray:
        """Return g(s) - g(0) of s (...) in 1/s."""
        return self.excess(s)


@dataclass(frozen=True)
class Maxwell(ViscoelasticLaw):
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
    factors: tuple[Factor, ...]
    times: tuple[Time, ...]
    constant: Factor = 0.0

    def __post_init__(self):
        super().__post_init__()
        if len(self.factors) != len(self.times) or not self.factors:
            raise InputError(
                f"law: found {len(self.factors)} factors and {len(self.times)} times, expected one of each for every "
                "Maxwell element"
            )

    @property
    def static(self) -> float:
        """The value g(0)."""
        return self.constant

    @property
    def elements(self) -> tuple[tuple[float, float], ...]:
        """Factor and time of each Maxwell element."""
        return tuple(zip(self.factors, self.times, strict=True))

    def excess(self, s: np.ndarray) -> np.ndarray:
        x = np.asarray(s)[..., None] * np.array(self.times)
        return (np.array(self.factors) * x / (1 + x)).sum(axis=-1)

    def in_units(self, time: float) -> Maxwell:
        return replace(self, times=tuple(value / time for value in self.times))

    def slope(self, s: np.ndarray) -> np.ndarray:
        times = np.array(self.times)
        return (np.array(self.factors) * times / (1 + np.asarray(s)[..., None] * times) ** 2).sum(axis=-1)


class FractionalLaw(ViscoelasticLaw):
    """A law with the static value `low`, and (s time)^exponent."""

    low: float
    time: float
    exponent: float

    @property
    def static(self) -> float:
        """The value g(0)."""
        return self.low

    @property
    def power(self) -> float:
        """The exponent of s near 0."""
        return self.exponent

    def in_units(self, time: float) -> FractionalLaw:
        return replace(self, time=self.time / time)  # type: ignore[type-var]

    def _powers(self, s):
        return (np.asarray(s, dtype=complex) * self.time) ** self.exponent


@dataclass(frozen=True)
class Fractional(FractionalLaw):
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
    low: Factor
    high: Factor
    time: Time
    exponent: Exponent

    def __post_init__(self):
        super().__post_init__()
        if self.high < self.low:
            raise InputError(f"law: found low = {self.low:g} above high = {self.high:g}; damped materials stiffen")

    def excess(self, s: np.ndarray) -> np.ndarray:
        z = self._powers(s)
        return (self.high - self.low) * z / (1 + z)

    def slope(self, s: np.ndarray) -> np.ndarray:
        """Return the derivative of g at s (...) other than 0."""
        z = self._powers(s)
        return (self.high - self.low) * self.exponent * z / (s * (1 + z) ** 2)


@dataclass(frozen=True)
class FractionalKelvinVoigt(FractionalLaw):
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
    low: Factor
    rise: Factor
    time: Time
    exponent: Exponent

    def excess(self, s: np.ndarray) -> np.ndarray:
        return self.rise * self._powers(s)

    def slope(self, s: np.ndarray) -> np.ndarray:
        """Return the derivative of g at s (...) other than 0."""
        return self.exponent * self.excess(s) / s
