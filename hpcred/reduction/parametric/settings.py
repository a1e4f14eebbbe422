"""Define the settings of a reduction over a range of parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from ...parallel.declared import Settings
from ...parallel.ranges import Least


@dataclass(frozen=True, kw_only=True)
class ParameterSearch(Settings):
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

    points: Annotated[int, Least(2)] | None = None
    most: Annotated[int, Least(3)] = 20

    where = "parameter_search."
