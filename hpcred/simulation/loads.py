"""Forces and moments over time at the nodes of a body: tables of a simulation enter, wrenches (6,) leave."""

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
    """A force in N at a node; in inertial axes, or with axes = "body" in those of the node, which turn with it."""

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
    """amplitude sin(2 pi frequency t + phase) at a node; N, Hz, rad. `axes`: see ConstantForce."""

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
    """Forces in N at ascending times in s, linear between them, constant before the first and after the last.

    `axes`: see ConstantForce.
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
    """A moment in N m at a node with rotations; otherwise like ConstantForce."""

    key: ClassVar[str] = "moment"


@dataclass(frozen=True)
class SineMoment(SineForce):
    """A moment in N m at a node with rotations; otherwise like SineForce."""

    key: ClassVar[str] = "moment"


@dataclass(frozen=True)
class TableMoment(TableForce):
    """Moments in N m at a node with rotations; otherwise like TableForce."""

    key: ClassVar[str] = "moment"


AnyForce = Annotated[ConstantForce | SineForce | TableForce, Field(discriminator="kind")]
AnyMoment = Annotated[ConstantMoment | SineMoment | TableMoment, Field(discriminator="kind")]


@dataclass(frozen=True)
class Load:
    """A force or a moment at a node: `value(t)` (3,) in inertial axes, or in those of the node where it `follows`."""

    shape: NodeShape
    value: object
    moment: bool = False
    follows: bool = False

    def wrench(self, t, R):
        """Force and moment (6,) on the node in inertial axes; R (3, 3): its rotation."""
        value = self.value(t)
        result = np.zeros(6)
        result[3 * self.moment :][:3] = R @ value if self.follows else value
        return result


def load_of(item, shape: NodeShape) -> Load:
    """The load that a table says. Raises InputError for a node without the rotations that it needs."""
    moment = item.key == "moment"
    if not shape.rotates and (moment or item.axes == "body"):
        needs = "a moment" if moment else "axes = 'body'"
        raise InputError(
            f"{item.key}.node: node {shape.label} has no rotations, which {needs} needs; give the model an "
            "[[interface]] there, or take forces at nodes in inertial axes"
        )
    return Load(shape, item, moment, item.axes == "body")
