"""Define what is known of the accuracy of a reduction over ranges of parameters, beside that of its frequencies."""

from __future__ import annotations

from dataclasses import dataclass


def in_words(values: dict[str, float]) -> str:
    """Return values of parameters as text, such as omega = 300."""
    return ", ".join(f"{name} = {value:.6g}" for name, value in values.items())


@dataclass(frozen=True, kw_only=True)
class ParameterPoint:
    """Values of the parameters at which the model was factored.

    Attributes
    ----------
    values : dict
        By name.
    factorisations, columns : int
        How often the model was factored there, and the columns that this brought.
    estimated, measured : float or None
        The error at a point of the band of the model before; None at the first.
    """

    values: dict[str, float]
    factorisations: int
    columns: int
    estimated: float | None = None
    measured: float | None = None


@dataclass(frozen=True, kw_only=True)
class ParameterAccuracy:
    """Over which ranges of parameters an accuracy holds, and how that is known.

    Attributes
    ----------
    ranges : dict
        Lowest and highest values by name.
    reference : dict
        Values of the model that the other figures belong to.
    points : tuple of ParameterPoint
        Where the model was factored, in order.
    checked : int
        The number of values at which the error over the band was estimated.
    worst : dict
        Values where the error is largest.
    """

    ranges: dict[str, tuple[float, float]]
    reference: dict[str, float]
    points: tuple[ParameterPoint, ...]
    checked: int
    worst: dict[str, float]

    @property
    def ranges_in_words(self) -> str:
        """The ranges as text, such as omega 0 to 800."""
        return ", ".join(f"{name} {low:.6g} to {high:.6g}" for name, (low, high) in self.ranges.items())
