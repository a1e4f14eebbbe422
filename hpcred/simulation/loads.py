"""Define forces and moments over time at the nodes of a body, and loads that are inputs of its reduction."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from ..body.body import resultants_of
from ..body.node_shapes import NodeShape
from ..fe.dofs import QUANTITIES
from ..model.loads.kinds import motions_of
from ..parallel.declared import Settings, nearest
from ..parallel.failures import InputError
from ..parallel.ranges import Node, Vector
from .time_functions import Constant, Sine, Table

Axes = Literal["inertial", "body"]


@dataclass(frozen=True)
class Force(Settings):
    """Base class of forces at a node.

    Parameters
    ----------
    node : int or str
        Number of the node, or name of an interface.
    axes : {"inertial", "body"}, default "inertial"
        Axes of the components; "body": they rotate with the node, which needs rotations.
    """

    node: Node
    axes: Axes = field(default="inertial", kw_only=True)
    key: ClassVar[str] = "force"
    where: ClassVar[str] = "force."

    def __call__(self, t: float) -> Any:
        return self.at(t)


@dataclass(frozen=True)
class ConstantForce(Constant, Force):
    """A constant force at a node: `node`, `value` (three floats, N) and `axes`, "inertial" or "body", which rotate with
    the node."""

    value: Vector


@dataclass(frozen=True)
class SineForce(Sine, Force):
    """A sinusoidal force at a node, amplitude sin(2 pi frequency t + phase): as ConstantForce, with `amplitude` (three
    floats, N), `frequency` in Hz, and `phase` in rad, by default 0."""

    amplitude: Vector


@dataclass(frozen=True)
class TableForce(Table, Force):
    """A force at a node from a table, linear between the times, constant before the first and after the last: as
    ConstantForce, with `times` in s, ascending, and `values`, three floats (N) for each time."""

    values: tuple[Vector, ...]


@dataclass(frozen=True)
class ConstantMoment(ConstantForce):
    """A constant moment in N m at a node with rotations, with the parameters of ConstantForce."""

    key, where = "moment", "moment."


@dataclass(frozen=True)
class SineMoment(SineForce):
    """A sinusoidal moment in N m at a node with rotations, with the parameters of SineForce."""

    key, where = "moment", "moment."


@dataclass(frozen=True)
class TableMoment(TableForce):
    """A moment in N m from a table at a node with rotations, with the parameters of TableForce."""

    key, where = "moment", "moment."


@dataclass(frozen=True)
class InputLoad(Settings):
    """Base class of inputs of the reduction that act over time.

    Parameters
    ----------
    name : str
        Name of the input in the result.
    quantity : {"acceleration", "velocity", "displacement"}
        Of an input that is the motion of a base: what its values are, by default accelerations.
    """

    name: str
    quantity: Literal["acceleration", "velocity", "displacement"] = field(default="acceleration", kw_only=True)
    where: ClassVar[str] = "load."

    def __call__(self, t: float) -> Any:
        return self.at(t, 2 - QUANTITIES.index(self.quantity))

    @property
    def jump(self) -> float:
        """The velocity of a base at t = 0, before which it is at rest."""
        order = 1 - QUANTITIES.index(self.quantity)
        return self.at(0.0, order) if order >= 0 else 0.0


@dataclass(frozen=True)
class ConstantLoad(Constant, InputLoad):
    """An input of the reduction, by `name`, with a constant factor `value`; of an input that is a direction of a node,
    force in N or moment in N m in axes of the body."""


@dataclass(frozen=True)
class SineLoad(Sine, InputLoad):
    """An input of the reduction, by `name`, with the factor amplitude sin(2 pi frequency t + phase): `amplitude` as the
    value of ConstantLoad, `frequency` in Hz, and `phase` in rad, by default 0."""


@dataclass(frozen=True)
class TableLoad(Table, InputLoad):
    """An input of the reduction, by `name`, with factors of a table, linear between the times, constant before and
    after: `times` in s, ascending, and `values`, one for each time, as the value of ConstantLoad."""


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


def load_of(entry, shape: NodeShape) -> Load:
    """Return the load of a table at a node. Raises InputError if the node lacks the rotations that it needs."""
    moment = entry.key == "moment"
    if not shape.rotates and (moment or entry.axes == "body"):
        needs = "a moment" if moment else "axes = 'body'"
        raise InputError(
            f"{entry.key}.node: node {shape.label} has no rotations, which {needs} needs; give the model an "
            "[[interface]] there, or take forces at nodes in inertial axes"
        )
    return Load(shape, entry, moment, entry.axes == "body")


@dataclass(frozen=True)
class Push:
    """A load of the whole body: `value(t)` times a generalised force (6 + m,) in the coordinates of (v, w, u), and
    `value.jump` times it at once at t = 0."""

    value: InputLoad
    force: np.ndarray


def push_of(load, body) -> Push:
    """Return the Push of an input of a Body. Raises InputError for an unknown name, and without resultants.

    Its force and moment move the body frame in the axes of the body, and its column of V^T B deforms the body.
    """
    reduced = body.reduced
    if load.name not in reduced.input_names:
        raise InputError(f"load.name: the result has no input '{load.name}'{nearest(load.name, reduced.input_names)}; "
                         f"it has {', '.join(reduced.input_names)}")  # fmt: skip
    moves = motions_of(reduced.record.loads) if reduced.record is not None else ()
    if load.quantity != QUANTITIES[-1] and load.name not in moves:
        raise InputError(f"load.quantity: found {load.quantity} for '{load.name}', which is no motion of a base; leave "
                         "it out")  # fmt: skip
    if reduced.resultants is None:
        raise InputError(
            f"load '{load.name}': the result does not have the sums of its inputs, since an earlier version made it or "
            "terms of B change them; reduce the model again, at these values"
        )
    place = reduced.input_names.index(load.name)
    return Push(load, np.concatenate([resultants_of(body)[place], reduced.B[:, place]]))
