"""Define the settings by which a basis becomes a reduced model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from ..parallel.declared import Settings
from ..parallel.failures import InputError
from ..parallel.ranges import COUNT, FREQUENCY, Range, within


@dataclass(frozen=True, kw_only=True)
class Reduction(Settings):
    """How a basis becomes a reduced model.

    Parameters
    ----------
    deflation_tolerance : float
        Relative size of the new part of a vector below which it is dropped as dependent.
    drop_above : float, optional
        Pseudo-modes above this frequency (Hz) are cut after the diagonalisation.
    projection : {"one_sided", "two_sided"}
        W = V; or, where the outputs differ from the inputs, W from C^T (33) with W^T M V = I: twice as many moments
        match if there are as many outputs as inputs, else fewer. The result may then be unstable.
    allow_unstable : bool
        Write a model that is unstable, which is refused otherwise.
    groups : int or "auto"
        Groups of ranks that factor different expansion points at the same time, each with a copy of the matrices;
        "auto" makes as many as points, ranks and memory allow.
    coordinates : {"modal", "interface"}
        Pseudo-modal coordinates, or the displacements of the interfaces first, which other finite-element programs
        take as dofs.
    """

    deflation_tolerance: Annotated[float, Range(1e-16, 0.999)] = 1e-9
    drop_above: float | None = None
    projection: Literal["one_sided", "two_sided"] = "one_sided"
    allow_unstable: bool = False
    groups: int | str = 1
    coordinates: Literal["modal", "interface"] = "modal"

    def __post_init__(self):
        super().__post_init__()
        if self.drop_above is not None and not 0 < self.drop_above < float("inf"):
            raise InputError(f"drop_above: found {self.drop_above:g}, expected a positive frequency in Hz")
        within("drop_above", self.drop_above, FREQUENCY)
        if self.groups != "auto" and (isinstance(self.groups, str) or self.groups < 1):
            raise InputError(f"groups: found '{str(self.groups)[:20]}', expected a whole number from 1, or 'auto'")
        within("groups", self.groups, COUNT)
