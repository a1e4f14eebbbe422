"""Define prescribed displacements and rotations: their value and rate at a time (m, m/s or rad, rad/s)."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ..parallel.declared import as_declared
from ..parallel.failures import InputError
from .checks import (
    require_finite,
    require_node,
    require_not_negative,
    require_sine,
    require_times,
    shortest_interval,
    unit,
)
from .loads import Vector


@dataclass(frozen=True, kw_only=True)
class Drive:
    """Base class of drives: the support of a node moves along a direction or rotates about an axis, in inertial axes.

    Parameters
    ----------
    node : int or str
        Number of the node, or name of an interface.
    along : tuple of three floats, optional
        Direction of the displacement (m).
    about : tuple of three floats, optional
        Axis of the rotation (rad); exactly one of `along` and `about`.
    through : tuple of three floats, optional
        A point of the axis in m; by default where the node is held.

    Notes
    -----
    A drive also holds the node in its direction. Drives of one node add up. Subclasses have `longest_step`, the
    longest time step (s) that resolves the motion, and `travel(end)`, the distance or angle covered until `end`.
    """

    node: int | str
    along: Vector | None = None
    about: Vector | None = None
    through: Vector | None = None

    def __post_init__(self):
        as_declared(self, "drive.")
        if (self.along is None) == (self.about is None):
            raise InputError(
                f"drive: node {self.node} needs a direction `along` which it is displaced or an axis `about` which it "
                "turns, one of them"
            )
        if self.through is not None and self.about is None:
            raise InputError(f"drive.through: found {list(self.through)} without `about`, of whose axis it is a point")
        require_node("drive.", self.node)
        require_finite("drive.", through=self.through)
        self.direction  # noqa: B018  refused here if it has none

    @property
    def direction(self) -> np.ndarray:
        """The unit vector (3,) of `along` or `about`."""
        return unit("drive.", "along", self.along) if self.about is None else unit("drive.", "about", self.about)


@dataclass(frozen=True, kw_only=True)
class ConstantDrive(Drive):
    """A constant displacement or rotation from the beginning.

    Parameters
    ----------
    node : int or str
        Number of the node, or name of an interface.
    along, about : tuple of three floats, optional
        Direction of a displacement, or axis of a rotation; exactly one of the two.
    through : tuple of three floats, optional
        A point of the axis in m; by default where the node is held.
    value : float
        In m or rad.
    """

    value: float
    kind: Literal["constant"] = field(default="constant", repr=False)

    def __post_init__(self):
        super().__post_init__()
        require_finite("drive.", value=self.value)

    def __call__(self, t):
        return self.value, 0.0

    def longest_step(self, end: float = np.inf) -> float:
        return np.inf

    def travel(self, end: float) -> float:
        return 0.0


@dataclass(frozen=True, kw_only=True)
class RampDrive(Drive):
    """A motion whose rate grows smoothly from 0 to a constant value.

    Parameters
    ----------
    node : int or str
        Number of the node, or name of an interface.
    along, about : tuple of three floats, optional
        Direction of a displacement, or axis of a rotation; exactly one of the two.
    through : tuple of three floats, optional
        A point of the axis in m; by default where the node is held.
    rate : float
        Final rate in m/s or rad/s.
    duration : float, default 0.0
        Time of the growth in s.

    Notes
    -----
    With a = t / duration the rate is rate (a - sin(2 pi a) / (2 pi)): the acceleration begins and ends with 0.
    """

    rate: float
    duration: float = 0.0
    kind: Literal["ramp"] = field(default="ramp", repr=False)

    def __post_init__(self):
        super().__post_init__()
        require_finite("drive.", rate=self.rate, duration=self.duration)
        require_not_negative("drive.", duration=self.duration)

    def __call__(self, t):
        end = self.duration
        if t >= end:
            return self.rate * (t - end / 2), self.rate
        a = max(t, 0.0) / end
        turn = 2 * np.pi
        value = a * a / 2 + (np.cos(turn * a) - 1) / turn**2
        return self.rate * end * value, self.rate * (a - np.sin(turn * a) / turn)

    def longest_step(self, end: float = np.inf) -> float:
        return self.duration / 8 or np.inf

    def travel(self, end: float) -> float:
        return abs(self.rate) * max(end - self.duration / 2, 0.0)


@dataclass(frozen=True, kw_only=True)
class SineDrive(Drive):
    """A sinusoidal motion, amplitude sin(2 pi frequency t + phase).

    Parameters
    ----------
    node : int or str
        Number of the node, or name of an interface.
    along, about : tuple of three floats, optional
        Direction of a displacement, or axis of a rotation; exactly one of the two.
    through : tuple of three floats, optional
        A point of the axis in m; by default where the node is held.
    amplitude : float
        In m or rad.
    frequency : float
        In Hz.
    phase : float, default 0.0
        In rad.
    """

    amplitude: float
    frequency: float
    phase: float = 0.0
    kind: Literal["sine"] = field(default="sine", repr=False)

    def __post_init__(self):
        super().__post_init__()
        require_finite("drive.", amplitude=self.amplitude)
        require_sine("drive.", self.frequency, self.phase)

    def __call__(self, t):
        omega = 2 * np.pi * self.frequency
        angle = omega * t + self.phase
        return self.amplitude * np.sin(angle), self.amplitude * omega * np.cos(angle)

    def longest_step(self, end: float = np.inf) -> float:
        return 1 / (8 * self.frequency)

    def travel(self, end: float) -> float:
        return 4 * abs(self.amplitude) * self.frequency * end


@dataclass(frozen=True, kw_only=True)
class TableDrive(Drive):
    """A motion by a cubic spline through a table, at rest before the first and after the last time.

    Parameters
    ----------
    node : int or str
        Number of the node, or name of an interface.
    along, about : tuple of three floats, optional
        Direction of a displacement, or axis of a rotation; exactly one of the two.
    through : tuple of three floats, optional
        A point of the axis in m; by default where the node is held.
    times : sequence of float
        In s, ascending; two or more.
    values : sequence of float
        One value for each time, in m or rad.
    """

    times: tuple[float, ...]
    values: tuple[float, ...]
    kind: Literal["table"] = field(default="table", repr=False)

    def __post_init__(self):
        super().__post_init__()
        require_finite("drive.", times=self.times, values=self.values)
        require_times("drive.", self.times, self.values)
        if len(self.times) < 2:
            raise InputError("drive.times: found one time, expected two or more; one value is kind = 'constant'")

    @cached_property
    def _spline(self):
        from scipy.interpolate import CubicSpline  # slow to import

        return CubicSpline(self.times, self.values, bc_type="clamped")

    def __call__(self, t):
        if not self.times[0] < t < self.times[-1]:
            return self.values[0 if t <= self.times[0] else -1], 0.0
        return float(self._spline(t)), float(self._spline(t, 1))

    def longest_step(self, end: float = np.inf) -> float:
        return shortest_interval(self.times, end)

    def travel(self, end: float) -> float:
        return float(np.abs(np.diff(self.values)).sum())


AnyDrive = Annotated[ConstantDrive | RampDrive | SineDrive | TableDrive, Field(discriminator="kind")]
