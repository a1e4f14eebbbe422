"""Define prescribed displacements and rotations: their value and rate at a time (m, m/s or rad, rad/s)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from ..parallel.declared import Settings
from ..parallel.failures import InputError
from ..parallel.ranges import Node, Vector
from .time_functions import Constant, Ramp, Sine, Spline


def unit(where, key, vector) -> np.ndarray:
    """Return the unit vector (3,) of an axis. Raises InputError for one without length."""
    length = np.linalg.norm(vector)
    if length == 0:
        raise InputError(f"{where}{key}: found {list(vector)}, which has no direction")
    return np.asarray(vector, dtype=float) / length


@dataclass(frozen=True, kw_only=True)
class Drive(Settings):
    """Base class of drives: the support of a node moves along a direction or rotates about an axis, in inertial axes.

    Parameters
    ----------
    node : int or str
        Number of the node, or name of an interface.
    along : tuple of three floats, optional
        Direction of a displacement (m); exactly one of `along` and `about`.
    about : tuple of three floats, optional
        Axis of a rotation (rad).
    through : tuple of three floats, optional
        A point of the axis in m; by default where the node is held.

    Notes
    -----
    A drive also holds the node in its direction. Drives of one node add up. Subclasses have `longest_step`, the
    longest time step (s) that resolves the motion, and `travel(end)`, the distance or angle covered until `end`.
    """

    node: Node
    along: Vector | None = None
    about: Vector | None = None
    through: Vector | None = None
    where: ClassVar[str] = "drive."

    def __post_init__(self):
        super().__post_init__()
        if (self.along is None) == (self.about is None):
            raise InputError(
                f"drive: node {self.node} needs a direction `along` which it is displaced or an axis `about` which it "
                "turns, one of them"
            )
        if self.through is not None and self.about is None:
            raise InputError(f"drive.through: found {list(self.through)} without `about`, of whose axis it is a point")
        self.direction  # noqa: B018  refused here if it has none

    def __call__(self, t: float) -> tuple[float, float]:
        return self.at(t), self.at(t, 1)

    @property
    def direction(self) -> np.ndarray:
        """The unit vector (3,) of `along` or `about`."""
        return unit("drive.", "along", self.along) if self.about is None else unit("drive.", "about", self.about)


@dataclass(frozen=True, kw_only=True)
class ConstantDrive(Constant, Drive):
    """A constant displacement or rotation from the beginning, with the parameters of Drive and `value` in m or rad."""


@dataclass(frozen=True, kw_only=True)
class RampDrive(Ramp, Drive):
    """A motion whose rate grows smoothly from 0 to a constant value, with the parameters of Drive, `rate` in m/s or
    rad/s, and `duration` of the growth in s, by default 0.

    With a = t / duration the rate is rate (a - sin(2 pi a) / (2 pi)): the acceleration begins and ends with 0.
    """


@dataclass(frozen=True, kw_only=True)
class SineDrive(Sine, Drive):
    """A sinusoidal motion, amplitude sin(2 pi frequency t + phase), with the parameters of Drive, `amplitude` in m or
    rad, `frequency` in Hz, and `phase` in rad, by default 0."""


@dataclass(frozen=True, kw_only=True)
class TableDrive(Spline, Drive):
    """A motion by a cubic spline through a table, at rest before the first and after the last time, with the parameters
    of Drive, `times` in s, ascending, two or more, and `values` in m or rad, one for each time."""


AnyDrive = Annotated[ConstantDrive | RampDrive | SineDrive | TableDrive, Field(discriminator="kind")]
