"""Define what is known of the accuracy of a reduction over ranges of parameters, beside that of its frequencies."""

from __future__ import annotations

from dataclasses import dataclass


def in_words(values: dict[str, float]) -> str:
    """Return values of parameters as text, such as omega = 300."""
    return ", ".join(f"{name} = {value:.6g}" for name, value in values.items())


@dataclass(frozen=True, kw_only=True)
class ParameterPoint:
    """Values of the parameters at which the model was factored: how often, and the columns that it brought; the error
    at a point of the band of the model that was before it, as it was `estimated` and as it is `measured`, None at the
    first."""

    values: dict[str, float]
    factorisations: int
    columns: int
    estimated: float | None = None
    measured: float | None = None


@dataclass(frozen=True, kw_only=True)
class ParameterAccuracy:
    """Over which ranges of parameters an accuracy holds, and how that is known.

    `ranges`: lowest and highest values by name; `reference`: values of the model that the other figures belong to;
    `points`: where the model was factored, in order; `checked`: number of values at which the error over the band was
    estimated; `worst`: values where it is largest.
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
