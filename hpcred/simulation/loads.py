"""Define forces and moments over time at the nodes of a body, and loads that are inputs of its reduction."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from ..body.body import resultants_of
from ..body.node_shapes import NodeShape
from ..parallel.declared import as_declared, nearest
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


@dataclass(frozen=True)
class ConstantLoad:
    """An input of the reduction with a constant factor, such as a load.

    Parameters
    ----------
    name : str
        Name of the input in the result.
    value : float
        Factor of the load; of an input that is a direction of a node, force in N or moment in N m in axes of the body.
    """

    name: str
    value: float
    kind: Literal["constant"] = _kind("constant")

    def __post_init__(self):
        as_declared(self, "load.")
        require_finite("load.", value=self.value)

    def __call__(self, t):
        return self.value

    def longest_step(self, end: float = np.inf) -> float:
        return np.inf


@dataclass(frozen=True)
class SineLoad:
    """An input of the reduction with the factor amplitude sin(2 pi frequency t + phase).

    Parameters
    ----------
    name : str
        Name of the input in the result.
    amplitude : float
        As the value of ConstantLoad.
    frequency : float
        In Hz.
    phase : float, default 0.0
        In rad.
    """

    name: str
    amplitude: float
    frequency: float
    phase: float = 0.0
    kind: Literal["sine"] = _kind("sine")

    def __post_init__(self):
        as_declared(self, "load.")
        require_finite("load.", amplitude=self.amplitude)
        require_sine("load.", self.frequency, self.phase)

    def __call__(self, t):
        return self.amplitude * np.sin(2 * np.pi * self.frequency * t + self.phase)

    def longest_step(self, end: float = np.inf) -> float:
        return 1 / (8 * self.frequency)


@dataclass(frozen=True)
class TableLoad:
    """An input of the reduction with factors of a table, linear between the times, constant before and after.

    Parameters
    ----------
    name : str
        Name of the input in the result.
    times : sequence of float
        In s, ascending.
    values : sequence of float
        One factor for each time, as the value of ConstantLoad.
    """

    name: str
    times: tuple[float, ...]
    values: tuple[float, ...]
    kind: Literal["table"] = _kind("table")

    def __post_init__(self):
        as_declared(self, "load.")
        require_finite("load.", times=self.times, values=self.values)
        require_times("load.", self.times, self.values)

    def __call__(self, t):
        return float(np.interp(t, self.times, self.values))

    def longest_step(self, end: float = np.inf) -> float:
        return shortest_interval(self.times, end)


AnyInputLoad = Annotated[ConstantLoad | SineLoad | TableLoad, Field(discriminator="kind")]
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


@dataclass(frozen=True)
class Push:
    """A load of the whole body: `value(t)` times a generalised force (6 + m,) in the coordinates of (v, w, u)."""

    value: object
    force: np.ndarray


def push_of(item, body) -> Push:
    """Return the Push of an input of a Body. Raises InputError for an unknown name, and without resultants.

    Its force and moment move the body frame in the axes of the body, and its column of V^T B deforms the body.
    """
    reduced = body.reduced
    if item.name not in reduced.input_names:
        raise InputError(f"load.name: the result has no input '{item.name}'{nearest(item.name, reduced.input_names)}; "
                         f"it has {', '.join(reduced.input_names)}")  # fmt: skip
    if reduced.resultants is None:
        raise InputError(
            f"load '{item.name}': the result does not have the sums of its inputs, since an earlier version made it or "
            "terms of B change them; reduce the model again, at these values"
        )
    place = reduced.input_names.index(item.name)
    return Push(item, np.concatenate([resultants_of(body)[place], reduced.B[:, place]]))
