"""Define what a reduction to a tolerance is to reach, and what it may take."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...parallel.declared import as_declared
from ...parallel.failures import InputError
from ...parallel.ranges import COUNT, Band, Frequency, within
from ..result.measure import Measure, measure_called


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What an automatic reduction may take. Where a limit ends the search the tolerance is not reached.

    Parameters
    ----------
    factorisations : int
        At most so many.
    columns : int
        At most so many in the uncompressed model.
    size : int, optional
        At most so many coordinates of the result.
    seconds : float, optional
        At most so much time.
    zeta0 : float
        The response of an undamped model is measured with the loss factor 2 zeta0.
    points : tuple of float
        Hz; expansion points that are taken first, before the search chooses.
    """

    factorisations: int = 14
    columns: int = 600
    size: int | None = None
    seconds: float | None = None
    zeta0: float = 1e-3
    points: tuple[Frequency, ...] = ()

    def __post_init__(self):
        as_declared(self, "adaptive.")
        for key in ("factorisations", "columns", "size", "seconds", "zeta0"):
            if getattr(self, key) is not None and not 0 < getattr(self, key) < np.inf:
                raise InputError(f"adaptive.{key}: found {getattr(self, key)}, expected more than 0")
        if self.factorisations < 2:
            raise InputError(f"adaptive.factorisations: found {self.factorisations}, expected at least 2")
        if not 1e-12 <= self.zeta0 < 1:
            raise InputError(f"adaptive.zeta0: found {self.zeta0:g}, expected a damping ratio below 1")
        for key in ("factorisations", "columns", "size"):
            within(f"adaptive.{key}", getattr(self, key), COUNT)
        within("adaptive.seconds", self.seconds, (1e-6, 1e9, "s"))


@dataclass(frozen=True, kw_only=True)
class Adaptive(Limits):
    """Reduction to an accuracy: eps(f) <= `tolerance` over `band`, within Limits.

    Parameters
    ----------
    tolerance : float
        The largest eps that is allowed over the band.
    band : tuple of two floats
        Hz.
    measure : {"directions", "paper"} or Measure
        What eps is: each response over the drive points of its input and output, or the Frobenius norm (55).
    static : {"tolerance", "exact"}
        With "exact" the deflection at 0 Hz under every input is that of the full model to round-off, which takes a
        factor of K and at least as many coordinates as there are inputs.
    factorisations, columns, size, seconds, zeta0, points
        Those of Limits.
    """

    tolerance: float
    band: Band
    measure: Literal["directions", "paper"] | Measure = "directions"
    static: Literal["tolerance", "exact"] = "tolerance"

    @property
    def error_measure(self) -> Measure:
        """What `measure` stands for."""
        return measure_called(self.measure)

    def __post_init__(self):
        as_declared(self, keys=("tolerance", "band", "measure", "static"))
        super().__post_init__()
        if not 1e-15 <= self.tolerance < 1:
            raise InputError(f"tolerance: found {self.tolerance:g}, expected a relative error such as 1e-4")
