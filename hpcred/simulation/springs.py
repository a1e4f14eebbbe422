"""Define spring-dampers between nodes and the ground, and compute their wrenches, tangents and energies.

A bushing's rotation is the vector t with exp(skew(t)) = R R_start^T. Its energy t^T k t / 2 gives the moment
-J(t)^-T k t, because omega = J(t) t'; see joints for x, R, v and omega, and rotations.rate_matrix for J.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from ..body.node_shapes import NodeShape
from ..body.rotations import rate_derivative, rate_matrix, vector_of
from ..parallel.declared import as_declared
from ..parallel.failures import InputError
from ..parallel.ranges import Node, Number, Vector, not_negative

ZERO = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class LineSpring:
    """A spring-damper along the line from the ground to a node.

    Parameters
    ----------
    node : int or str
        Number of the node, or name of an interface.
    at : tuple of three floats
        The other end, in m.
    stiffness : float
        Along the line, in N/m.
    damping : float, default 0.0
        Along the line, in N s/m.
    length : float, optional
        Free length in m; by default that at the start.
    """

    node: Node
    at: Vector
    stiffness: Annotated[Number, not_negative]
    damping: Annotated[Number, not_negative] = 0.0
    length: Annotated[Number | None, not_negative] = None
    kind: Literal["line"] = field(default="line", kw_only=True, repr=False)

    def __post_init__(self):
        as_declared(self, "spring.")
        _require_something(self)


@dataclass(frozen=True)
class Bushing:
    """Springs and dampers in inertial x, y, z against displacement of a node from a point, and against its rotation.

    Parameters
    ----------
    node : int or str
        Number of the node, or name of an interface.
    stiffness, damping : tuple of three floats, default (0, 0, 0)
        In N/m and N s/m.
    rotational_stiffness, rotational_damping : tuple of three floats, default (0, 0, 0)
        Against the rotation vector from the start, in N m/rad and N m s/rad.
    at : tuple of three floats, optional
        The point in m; by default the initial position of the node.
    """

    node: Node
    stiffness: Annotated[Vector, not_negative] = ZERO
    damping: Annotated[Vector, not_negative] = ZERO
    rotational_stiffness: Annotated[Vector, not_negative] = ZERO
    rotational_damping: Annotated[Vector, not_negative] = ZERO
    at: Vector | None = None
    kind: Literal["bushing"] = field(default="bushing", kw_only=True, repr=False)

    def __post_init__(self):
        as_declared(self, "spring.")
        _require_something(self)

    @property
    def turns_with(self) -> bool:
        """True if it acts on rotations."""
        return bool(np.any([self.rotational_stiffness, self.rotational_damping]))


AnySpring = Annotated[LineSpring | Bushing, Field(discriminator="kind")]


def _require_something(spring):
    keys = [key for key in vars(spring) if key.endswith(("stiffness", "damping"))]
    if not any(np.any(getattr(spring, key)) for key in keys):
        raise InputError(f"spring: node {spring.node} has nothing but zeros in {', '.join(keys)}")


@dataclass
class LineElement:
    """A LineSpring at a node with its free length. For x, R, v, omega see the module."""

    shape: NodeShape
    at: np.ndarray
    stiffness: float
    damping: float
    length: float

    def _line(self, x):
        """Return the direction (3,) from the ground to the node, and the length."""
        length = np.linalg.norm(x - self.at)
        return (x - self.at) / (length or 1.0), length

    def wrench(self, x, R, v, omega):
        """Return force and moment (6,) on the node in inertial axes."""
        line, length = self._line(x)
        tension = self.stiffness * (length - self.length) + self.damping * line @ v
        return np.concatenate([-tension * line, np.zeros(3)])

    def tangents(self, x, R, v):
        """Return stiffness and damping (6, 6): minus the Jacobians of the wrench by displacement and velocity."""
        line, length = self._line(x)
        K, C = np.zeros((6, 6)), np.zeros((6, 6))
        along = np.outer(line, line)
        across, speed = np.eye(3) - along, line @ v
        tension = self.stiffness * (length - self.length) + self.damping * speed
        K[:3, :3] = self.stiffness * along + (
            tension * across + self.damping * np.outer(line, across @ v)) / (length or 1.0)  # fmt: skip
        C[:3, :3] = self.damping * along
        return K, C

    def energy(self, x, R):
        """In J."""
        return 0.5 * self.stiffness * (self._line(x)[1] - self.length) ** 2

    def dissipation(self, x, v, omega):
        """Return power of its damper in W."""
        return self.damping * (self._line(x)[0] @ v) ** 2

    def held(self, x):
        """Return directions (k, 6) in which it resists displacement and rotation of the node."""
        return np.append(self._line(x)[0], np.zeros(3))[None] if self.stiffness else np.zeros((0, 6))

    def twist(self, R):
        """Return the rotation vector (3,) of its twist in rad."""
        return np.zeros(3)


@dataclass
class BushingElement:
    """A Bushing at a node with stiffness and damping (6,) and the rotation `turned` (3, 3) in which it is free."""

    shape: NodeShape
    at: np.ndarray
    turned: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray

    def _deflection(self, x, R):
        turned = vector_of(R @ self.turned.T) if self.stiffness[3:].any() else np.zeros(3)
        return np.concatenate([x - self.at, turned])

    def wrench(self, x, R, v, omega):
        """Return force and moment (6,) on the node in inertial axes."""
        away = self._deflection(x, R)
        force = -self.stiffness * away
        force[3:] = np.linalg.solve(rate_matrix(away[3:]).T, force[3:])
        return force - self.damping * np.concatenate([v, omega])

    def tangents(self, x, R, v):
        """Return stiffness and damping (6, 6): minus the Jacobians of the wrench by displacement and velocity."""
        turned, K = self._deflection(x, R)[3:], np.diag(self.stiffness)
        inverse = np.linalg.inv(rate_matrix(turned))
        moment = inverse.T @ (self.stiffness[3:] * turned)
        K[3:, 3:] = inverse.T @ (K[3:, 3:] - rate_derivative(turned, moment)) @ inverse
        return K, np.diag(self.damping)

    def energy(self, x, R):
        """In J."""
        return 0.5 * self.stiffness @ self._deflection(x, R) ** 2

    def dissipation(self, x, v, omega):
        """Return power of its dampers in W."""
        return self.damping @ np.concatenate([v, omega]) ** 2

    def held(self, x):
        """Return directions (k, 6) in which it resists displacement and rotation of the node."""
        return np.eye(6)[self.stiffness > 0]

    def twist(self, R):
        """Return rotation vector (3,) in rad that it is twisted by, zero where it does not resist."""
        return self._deflection(self.at, R)[3:]


def element_of(spring, shape: NodeShape, place, turned):
    """Return the element of a spring; place (3,) and rotation `turned` (3, 3) of its node at the start.

    Raises InputError for a line without length, and for rotations of a node that has none.
    """
    at = np.array(place if spring.at is None else spring.at, dtype=float)
    if spring.kind == "line":
        length = float(np.linalg.norm(place - at))
        if length == 0 and spring.length != 0:
            raise InputError(
                f"spring.at: the spring at node {shape.label} begins with no length, which has no direction; give "
                "another point, or take kind = 'bushing'"
            )
        free = length if spring.length is None else spring.length
        return LineElement(shape, at, spring.stiffness, spring.damping, free)
    if spring.turns_with and not shape.rotates:
        raise InputError(
            f"spring.rotational_stiffness: node {shape.label} has no rotations; give the model an [[interface]] there, "
            "or leave out rotational_stiffness and rotational_damping"
        )
    stiffness = np.array([*spring.stiffness, *spring.rotational_stiffness])
    damping = np.array([*spring.damping, *spring.rotational_damping])
    return BushingElement(shape, at, turned, stiffness, damping)
