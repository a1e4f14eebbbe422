"""Define a dynamic stiffness by a table over frequency, as measured on mounts and bushings."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

import numpy as np

from ...parallel.declared import Settings
from ...parallel.failures import InputError
from ...parallel.ranges import Number, Range
from ..operator import Law


@dataclass(frozen=True)
class Tabulated(Settings, Law):
    """Complex law g(i 2 pi f), linear between the frequencies of a table, constant beyond them; g(0) is its first real
    part.

    Parameters
    ----------
    frequencies : sequence of float
        Hz, ascending.
    real, imaginary : sequence of float
        g at each of them.

    Raises
    ------
    InputError
        For frequencies that do not ascend, and numbers of values that differ.
    """

    kind: Literal["table"] = field(default="table", kw_only=True, repr=False)
    frequencies: tuple[Annotated[float, Range(0.0, 1e30, "Hz")], ...] = field(repr=False)
    real: tuple[Number, ...] = field(repr=False)
    imaginary: tuple[Number, ...] = field(repr=False)

    family = "tabulated"
    nature = "a table over frequency"
    where = "law."

    def __post_init__(self):
        super().__post_init__()
        if not len(self.frequencies) == len(self.real) == len(self.imaginary) > 0:
            raise InputError(
                f"law: found {len(self.frequencies)} frequencies, {len(self.real)} real and {len(self.imaginary)} "
                "imaginary parts, expected as many of each"
            )
        if (np.diff(self.frequencies) <= 0).any():
            raise InputError("law.frequencies: found frequencies that do not ascend, expected each once, in order")

    @property
    def static(self) -> float:
        """The value g(0)."""
        return self.real[0]

    def coefficient(self, s: np.ndarray) -> np.ndarray:
        """Return g(s) - g(0) at s (...) in 1/s by f = |Im s| / 2 pi, and its conjugate below the real axis."""
        f = np.asarray(s, dtype=complex).imag / (2 * np.pi)
        real, imaginary = (np.interp(np.abs(f), self.frequencies, values) for values in (self.real, self.imaginary))
        return real - self.static + 1j * np.sign(f) * imaginary

    def slope(self, s: np.ndarray) -> np.ndarray:
        """Return the derivative of the coefficient along the imaginary axis at s (...)."""
        f = np.abs(np.asarray(s, dtype=complex).imag) / (2 * np.pi)
        values = np.array(self.real) + 1j * np.array(self.imaginary)
        rises = np.concatenate([[0.0], np.diff(values) / np.diff(self.frequencies), [0.0]])
        return rises[np.searchsorted(self.frequencies, f)] / (2j * np.pi)

    def in_units(self, time: float) -> Tabulated:
        return replace(self, frequencies=tuple(value * time for value in self.frequencies))
