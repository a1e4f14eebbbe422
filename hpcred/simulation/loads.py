"""Define forces and moments over time at the nodes of a body, and compute their wrenches (6,)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from ..body.node_shapes import NodeShape
from ..parallel.declared import as_declared
from ..parallel.failures import InputError
from .checks import require_finite, require_node, require_sine, require_times, shortest_interval

Vector = tuple[float, float, float]
Axes = Literal["inertial", "body"]


def _kind(name):
    return field(default=name, kw_only=True, repr=False)


@dataclass(frozen=True)
class ConstantForce:
    """A constant force at a node.

    Parameters
    ----------
    node : int or str
        Number of the node, or name of an interface.
    value : tuple of three floats
        In N, for moments in N m.
    axes : {"inertial", "body"}, default "inertial"
        Axes of the components; "body": they rotate with the node, which needs rotations.
    """

    node: int | str
    value: Vector
    axes: Axes = field(default="inertial", kw_only=True)
    kind: Literal["constant"] = _kind("constant")
    key: ClassVar[str] = "force"

    def __post_init__(self):
        as_declared(self, f"{self.key}.")
        require_node(f"{self.key}.", self.node)
        require_finite(f"{self.key}.", value=self.value)

    def __call__(self, t):
        return np.asarray(self.value)

    def longest_step(self, end: float = np.inf) -> float:
        return np.inf


@dataclass(frozen=True)
class SineForce:
    """A sinusoidal force at a node, amplitude sin(2 pi frequency t + phase).

    Parameters
    ----------
    node : int or str
        Number of the node, or name of an interface.
    amplitude : tuple of three floats
        In N, for moments in N m.
    frequency : float
        In Hz.
    phase : float, default 0.0
        In rad.
    axes : {"inertial", "body"}, default "inertial"
        Axes of the components; "body": they rotate with the node, which needs rotations.
    """

    node: int | str
    amplitude: Vector
    frequency: float
    phase: float = 0.0
    axes: Axes = field(default="inertial", kw_only=True)
    kind: Literal["sine"] = _kind("sine")
    key: ClassVar[str] = "force"

    def __post_init__(self):
        as_declared(self, f"{self.key}.")
        require_node(f"{self.key}.", self.node)
        require_finite(f"{self.key}.", amplitude=self.amplitude)
        require_sine(f"{self.key}.", self.frequency, self.phase)

    def __call__(self, t):
        return np.asarray(self.amplitude) * np.sin(2 * np.pi * self.frequency * t + self.phase)

    def longest_step(self, end: float = np.inf) -> float:
        return 1 / (8 * self.frequency)


@dataclass(frozen=True)
class TableForce:
    """A force at a node from a table, linear between the times, constant before the first and after the last.

    Parameters
    ----------
    node : int or str
        Number of the node, or name of an interface.
    times : sequence of float
        In s, ascending.
    values : sequence of three floats each
        One force for each time, in N, for moments in N m.
    axes : {"inertial", "body"}, default "inertial"
        Axes of the components; "body": they rotate with the node, which needs rotations.
    """

    node: int | str
    times: tuple[float, ...]
    values: tuple[Vector, ...]
    axes: Axes = field(default="inertial", kw_only=True)
    kind: Literal["table"] = _kind("table")
    key: ClassVar[str] = "force"

    def __post_init__(self):
        as_declared(self, f"{self.key}.")
        require_node(f"{self.key}.", self.node)
        require_finite(f"{self.key}.", times=self.times, values=self.values)
        require_times(f"{self.key}.", self.times, self.values)

    def __call__(self, t):
        return np.array([np.interp(t, self.times, column) for column in zip(*self.values, strict=True)])

    def longest_step(self, end: float = np.inf) -> float:
        return shortest_interval(self.times, end)


@dataclass(frozen=True)
class ConstantMoment(ConstantForce):
    """A constant moment in N m at a node with rotations, with the parameters of ConstantForce."""

    key: ClassVar[str] = "moment"


@dataclass(frozen=True)
class SineMoment(SineForce):
    """A sinusoidal moment in N m at a node with rotations, with the parameters of SineForce."""

    key: ClassVar[str] = "moment"


@dataclass(frozen=True)
class TableMoment(TableForce):
    """A moment in N m from a table at a node with rotations, with the parameters of TableForce."""

    key: ClassVar[str] = "moment"


AnyForce = Annotated[ConstantForce | SineForce | TableForce, Field(discriminator="kind")]
AnyMoment = Annotated[ConstantMoment | SineMoment | TableMoment, Field(discriminator="kind")]


@dataclass(frozen=True)
class Load:
    """A force or moment at a node: `value(t)` (3,) in inertial axes, or in axes of the node if it `follows`."""

    shape: NodeShape
    value: object
    moment: bool = False
    follows: bool = False

    def wrench(self, t, R):
        """Return force and moment (6,) on the node in inertial axes; R (3, 3): its rotation."""
        value = self.value(t)
        result = np.zeros(6)
        result[3 * self.moment :][:3] = R @ value if self.follows else value
        return result


def load_of(item, shape: NodeShape) -> Load:
    """Return the load of a table at a node. Raises InputError if the node lacks the rotations that it needs."""
    moment = item.key == "moment"
    if not shape.rotates and (moment or item.axes == "body"):
        needs = "a moment" if moment else "axes = 'body'"
        raise InputError(
            f"{item.key}.node: node {shape.label} has no rotations, which {needs} needs; give the model an "
            "[[interface]] there, or take forces at nodes in inertial axes"
        )
    return Load(shape, item, moment, item.axes == "body")
