"""Define hysteretic damping by a table, K (1 + i eta(f)): a loss factor that depends on frequency."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

import numpy as np

from ...parallel.declared import Settings
from ...parallel.failures import InputError
from ...parallel.ranges import Range
from ..operator import Law


@dataclass(frozen=True)
class Hysteretic(Settings, Law):
    """Hysteretic law g(i 2 pi f) = 1 + i eta(f), and 1 at rest; the loss factor eta is linear between the frequencies
    of a table, and constant beyond them.

    Parameters
    ----------
    frequencies : sequence of float
        Hz, ascending.
    loss_factors : sequence of float
        eta at each of them, not negative.

    Raises
    ------
    InputError
        For frequencies that do not ascend, negative numbers, and numbers of both that differ.
    """

    kind: Literal["hysteretic"] = field(default="hysteretic", kw_only=True, repr=False)
    frequencies: tuple[Annotated[float, Range(0.0, 1e30, "Hz")], ...]
    loss_factors: tuple[Annotated[float, Range(0.0, 1e3)], ...]

    family = "hysteretic"
    nature = "a table of loss factors"
    power = 0.0
    static = 1.0
    where = "law."

    def __post_init__(self):
        super().__post_init__()
        if len(self.frequencies) != len(self.loss_factors) or not self.frequencies:
            raise InputError(
                f"law: found {len(self.frequencies)} frequencies and {len(self.loss_factors)} loss_factors, expected "
                "one loss factor for every frequency"
            )
        if (np.diff(self.frequencies) <= 0).any():
            raise InputError(f"law.frequencies: found {self.frequencies}, expected frequencies that ascend")

    def coefficient(self, s: np.ndarray) -> np.ndarray:
        """Return i eta(f) at s (...) in 1/s, f = |Im s| / 2 pi, and its conjugate below the real axis."""
        f = np.asarray(s, dtype=complex).imag / (2 * np.pi)
        return 1j * np.sign(f) * np.interp(np.abs(f), self.frequencies, self.loss_factors)

    def slope(self, s: np.ndarray) -> np.ndarray:
        """Return the derivative of the coefficient along the imaginary axis at s (...)."""
        f = np.abs(np.asarray(s, dtype=complex).imag) / (2 * np.pi)
        rises = np.concatenate([[0.0], np.diff(self.loss_factors) / np.diff(self.frequencies), [0.0]])
        return rises[np.searchsorted(self.frequencies, f)] / (2 * np.pi) + 0j

    def in_units(self, time: float) -> Hysteretic:
        return replace(self, frequencies=tuple(value * time for value in self.frequencies))
