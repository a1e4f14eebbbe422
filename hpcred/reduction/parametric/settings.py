"""Define the settings of a reduction over a range of parameters."""

from __future__ import annotations

from dataclasses import dataclass

from ...parallel.declared import as_declared
from ...parallel.failures import InputError
from ...parallel.ranges import COUNT, within


@dataclass(frozen=True, kw_only=True)
class ParameterSearch:
    """How the values of parameters are chosen at which a model is factored.

    Parameters
    ----------
    points : int, optional
        Number of training points, at which the error is estimated; by default 33 for one parameter, 9 x 9 for two, and
        100 for more.
    most : int, default 20
        Values of the parameters at which the model may be factored; where they do not suffice, the tolerance is not
        reached.

    Raises
    ------
    InputError
        For less than 2 training points, or less than 3 values.
    """

    points: int | None = None
    most: int = 20

    def __post_init__(self):
        as_declared(self, "parameter_search.")
        for key, least in (("points", 2), ("most", 3)):
            value = getattr(self, key)
            within(f"parameter_search.{key}", value, COUNT)
            if value is not None and value < least:
                raise InputError(f"parameter_search.{key}: found {value}, expected at least {least}")
