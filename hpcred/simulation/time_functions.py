"""Define numbers and vectors over time, `at(t)`, and the longest time step (s) that resolves them; of numbers also the
derivatives, `at(t, order)`, and how far they travel up to a time."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np

from ..parallel.declared import Settings
from ..parallel.failures import InputError
from ..parallel.ranges import FREQUENCY, Number, Range, not_negative, positive


def _kind(name):
    return field(default=name, kw_only=True, repr=False)


@dataclass(frozen=True)
class Constant(Settings):
    """A constant from the beginning.

    Parameters
    ----------
    value : float or tuple of three floats
        In N, N m, m or rad, or the factor of an input.
    """

    value: Number
    kind: Literal["constant"] = _kind("constant")

    def at(self, t: float, order: int = 0) -> Any:
        return np.asarray(self.value)[()] * (order == 0)

    def longest_step(self, end: float = np.inf) -> float:
        return np.inf

    def travel(self, end: float) -> float:
        return 0.0


@dataclass(frozen=True)
class Ramp(Settings):
    """A growth whose rate goes smoothly from 0 to a constant value.

    Parameters
    ----------
    rate : float
        Final rate in m/s or rad/s.
    duration : float, default 0.0
        Time in s until the rate is reached.

    Notes
    -----
    With a = t / duration the rate is rate (a - sin(2 pi a) / (2 pi)): the acceleration begins and ends with 0.
    """

    rate: Number
    duration: Annotated[Number, not_negative] = 0.0
    kind: Literal["ramp"] = _kind("ramp")

    def at(self, t: float, order: int = 0) -> Any:
        if t >= self.duration:
            return self.rate * (t - self.duration / 2, 1.0, 0.0)[order]
        a, turn = max(t, 0.0) / self.duration, 2 * np.pi
        if order == 2:
            return self.rate * (1 - np.cos(turn * a)) / self.duration
        if order:
            return self.rate * (a - np.sin(turn * a) / turn)
        return self.rate * self.duration * (a * a / 2 + (np.cos(turn * a) - 1) / turn**2)

    def longest_step(self, end: float = np.inf) -> float:
        return self.duration / 8 or np.inf

    def travel(self, end: float) -> float:
        return abs(self.rate) * max(end - self.duration / 2, 0.0)


@dataclass(frozen=True)
class Sine(Settings):
    """A sine, amplitude sin(2 pi frequency t + phase).

    Parameters
    ----------
    amplitude : float or tuple of three floats
        As the value of a constant.
    frequency : float
        In Hz.
    phase : float, default 0.0
        In rad.
    """

    amplitude: Number
    frequency: Annotated[float, positive, FREQUENCY]
    phase: Annotated[float, Range(-1e6, 1e6, "rad")] = 0.0
    kind: Literal["sine"] = _kind("sine")

    def at(self, t: float, order: int = 0) -> Any:
        omega = 2 * np.pi * self.frequency
        return np.asarray(self.amplitude) * omega**order * np.sin(omega * t + self.phase + order * np.pi / 2)

    def longest_step(self, end: float = np.inf) -> float:
        return 1 / (8 * self.frequency)

    def travel(self, end: float) -> float:
        return 4 * abs(self.amplitude) * self.frequency * end


@dataclass(frozen=True)
class Table(Settings):
    """A table, linear between the times, constant before the first and after the last. Its derivatives are those of a
    cubic spline, at rest before the first and after the last time.

    Parameters
    ----------
    times : sequence of float
        In s, ascending.
    values : sequence of float, or of three floats each
        One for each time, as the value of a constant.
    """

    times: tuple[Number, ...]
    values: tuple[Number, ...]
    kind: Literal["table"] = _kind("table")

    def __post_init__(self):
        super().__post_init__()
        if not self.times:
            raise InputError(f"{self.where}times: found an empty list, expected ascending times and a value for each")
        if len(self.times) != len(self.values):
            raise InputError(f"{self.where}values: found {len(self.values)} values for {len(self.times)} times, "
                             "expected as many")  # fmt: skip
        for early, late in zip(self.times, self.times[1:], strict=False):
            if late <= early:
                raise InputError(f"{self.where}times: found {late:g} s after {early:g} s, expected ascending times")

    @cached_property
    def _columns(self):
        return np.array(self.times), np.reshape(self.values, (len(self.times), -1)).T

    @cached_property
    def _spline(self):
        from scipy.interpolate import CubicSpline  # slow to import

        return CubicSpline(self.times, self.values, bc_type="clamped")

    def at(self, t: float, order: int = 0) -> Any:
        if order:
            return float(self._spline(t, order)) if self.times[0] < t < self.times[-1] else 0.0
        times, columns = self._columns
        return np.reshape([np.interp(t, times, column) for column in columns], np.shape(self.values[0]))[()]

    def longest_step(self, end: float = np.inf) -> float:
        """The shortest interval that has a part between 0 and `end`; inf where there is none."""
        times = np.asarray(self.times)
        return np.diff(times)[(times[1:] > 0) & (times[:-1] < end)].min(initial=np.inf)


@dataclass(frozen=True)
class Spline(Table):
    """A cubic spline through a table, at rest before the first and after the last time.

    Parameters
    ----------
    times : sequence of float
        In s, ascending; two or more.
    values : sequence of float
        One for each time, in m or rad.
    """

    def __post_init__(self):
        super().__post_init__()
        if len(self.times) < 2:
            raise InputError(f"{self.where}times: found one time, expected two or more; one value is kind = 'constant'")

    def at(self, t: float, order: int = 0) -> Any:
        return super().at(t, order) if order else float(self._spline(np.clip(t, self.times[0], self.times[-1])))

    def travel(self, end: float) -> float:
        return float(np.abs(np.diff(self.values)).sum())
