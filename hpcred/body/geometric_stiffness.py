"""Hold the geometric stiffness of a body for unit states of load, and the second-order motion that it stands for.

Under loads the stiffness of a body is K + sum_i c_i K_i, with K_i of the stress of the i-th unit state and its value
c_i. For a load f, -q^T K_i q / 2 is the work of f on the displacements of second order (the foreshortening of a beam
that bends), so that the K_i are Hessians:

    K_i of an acceleration   of the first moment of mass, as Ct is the first one
    K_i of a force           of the negative displacement of its node

A StiffenedFrame and nodes with phi1 and psi1 contain them as such. Equations of motion made of these conserve energy
and momentum, and forces of constraints stiffen the body like applied ones. Sources: O. Wallrapp and R. Schwertassek,
Int. J. Numer. Meth. Eng. 32 (1991) 1751; O. Wallrapp, Mech. Struct. Mach. 22 (1994) 283, for the terms of SID files.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from ..fe.dofs import DIRECTIONS, SAME_PLACE, target_of
from ..model.units import Units
from ..parallel.failures import InputError
from .floating_frame import FloatingFrame
from .node_shapes import NodeShape

ACCELERATIONS = ("ax", "ay", "az")  # of the body frame, m/s^2
ANGULAR_ACCELERATIONS = ("alphax", "alphay", "alphaz")  # rad/s^2
VELOCITIES = ("wx^2", "wy^2", "wz^2", "wx wy", "wy wz", "wx wz")  # products of angular velocities, in the order of Oe
OF_BODY = ACCELERATIONS + ANGULAR_ACCELERATIONS + VELOCITIES
SIX = DIRECTIONS[:6]


@dataclass
class GeometricStiffness:
    """Geometric stiffness matrices V^T K_sigma V of unit states, in body axes.

    Attributes
    ----------
    states : tuple of str
        ax, ay, az: accelerations of the body frame in m/s^2; alphax, alphay, alphaz: angular accelerations in rad/s^2;
        wx^2, wy^2, wz^2, wx wy, wy wz, wx wz: products of angular velocities in (rad/s)^2; and such as crank:x or
        20:rz, forces (N) and moments (N m) at the interface node of that name or number.
    matrices : ndarray, shape (states, m, m)
        Symmetric. A state that is not there has no stress.
    origin : ndarray, shape (3,)
        Origin of the body frame in m, about which the body rotates.

    Raises
    ------
    InputError
        For matrices that do not fit, and states that are not known or twice there.
    """

    states: tuple[str, ...]
    matrices: np.ndarray
    origin: np.ndarray

    def __post_init__(self):
        self.states, self.matrices = tuple(self.states), np.asarray(self.matrices, dtype=float)
        self.origin = np.asarray(self.origin, dtype=float)
        shape = self.matrices.shape
        if len(shape) != 3 or shape[0] != len(self.states) or shape[1] != shape[2]:
            raise InputError(
                f"geometric stiffness: found matrices {shape} for {len(self.states)} states, expected a square one each"
            )
        for state in self.states:
            check_state(state)
        if len(set(self.states)) < len(self.states):
            raise InputError(f"geometric stiffness: found a state twice in {', '.join(self.states)}")

    @property
    def size(self) -> int:
        """Return the number of coordinates."""
        return self.matrices.shape[1]

    def check(self, size: int, origin) -> None:
        """Raise InputError unless the matrices are those of `size` coordinates and of a body frame at `origin` (3,) in
        m."""
        if self.size != size:
            raise InputError(
                f"geometric stiffness: found matrices of {self.size} coordinates, expected {size}: it belongs to "
                "another basis"
            )
        if np.abs(self.origin - origin).max() > SAME_PLACE * max(np.abs(self.origin).max(), np.abs(origin).max()):
            raise InputError(
                f"geometric stiffness: found the origin {self.origin.tolist()} m, expected that of the body frame, "
                f"{np.asarray(origin).tolist()} m, about which the body rotates"
            )

    def of(self, states: Sequence[str]) -> np.ndarray:
        """Return the matrices (len(states), m, m) of some `states`, such as "wz^2", zero for those that are not there.
        """
        known = dict(zip(self.states, self.matrices, strict=True))
        shape = self.matrices.shape[1:]
        return np.array([known.get(state, np.zeros(shape)) for state in states]).reshape(-1, *shape)

    def without(self, states: Sequence[str]) -> GeometricStiffness:
        """Return all but these `states`."""
        kept = [place for place, state in enumerate(self.states) if state not in states]
        return replace(self, states=[self.states[place] for place in kept], matrices=self.matrices[kept])

    def in_coordinates(self, X: np.ndarray) -> GeometricStiffness:
        """Return the stiffness in the coordinates z (k,) with q = X z, X (m, k)."""
        return replace(self, matrices=X.T @ self.matrices @ X)

    def of_node(self, node: NodeShape) -> np.ndarray:
        """Return the matrices (6, m, m) of unit forces and moments at a `node`, by its displacements."""
        return self.of([f"{node.label}:{direction}" for direction in SIX])

    def sum(self, values: dict[str, float]) -> np.ndarray:
        """Return sum c_i K_i (m, m) with the `values` c_i by name of the state. Raises InputError for a state that is
        not there."""
        missing = [state for state in values if state not in self.states]
        if missing:
            raise InputError(
                f"geometric stiffness: found no state '{missing[0]}'; there are {', '.join(self.states) or 'none'}"
            )
        return np.tensordot(np.array(list(values.values())), self.of(tuple(values)), axes=1)


def check_state(state: str):
    """Raise InputError for a name that no state has."""
    target = target_of(state)
    if state not in OF_BODY and not (isinstance(target, tuple) and target[1] in SIX):
        raise InputError(
            f"geometric stiffness: found the state '{state[:40]}', expected one of {', '.join(OF_BODY)}, or node and "
            f"direction, such as crank:x or 20:rz"
        )


def unit_of_state(state: str, units: Units) -> float:
    """Return the unit of a state in SI: an acceleration of 1 mm/s^2 is 1e-3 of one in SI."""
    if state in ACCELERATIONS:
        return units.length / units.time**2
    if state in OF_BODY:
        return 1 / units.time**2
    force = units.mass * units.length / units.time**2
    return force * units.length if target_of(state)[1].startswith("r") else force


class StiffenedFrame(FloatingFrame):
    """Floating-frame quantities that contain displacements of second order: Ct1, Cr1, Oe1 and J2 with stiffness."""

    def __init__(self, frame: FloatingFrame, stiffness: GeometricStiffness):
        super().__init__(**{attribute.name: getattr(frame, attribute.name) for attribute in fields(FloatingFrame)})
        self._stiffness = stiffness

    @property
    def stiffened_by_rotation(self) -> bool:
        """Tell whether angular velocities change the stiffness."""
        return any(state in VELOCITIES for state in self._stiffness.states)

    def _of(self, states):
        """Return matrices of states (m, m, states)."""
        return np.moveaxis(self._stiffness.of(states), 0, -1)

    @cached_property
    def Ct1(self) -> np.ndarray:
        return self._of(ACCELERATIONS)

    @cached_property
    def Cr1(self) -> np.ndarray:
        return super().Cr1 + self._of(ANGULAR_ACCELERATIONS)

    @cached_property
    def Oe1(self) -> np.ndarray:
        return super().Oe1 + self._of(VELOCITIES)

    @cached_property
    def J2(self) -> np.ndarray:
        """(m, m, 3, 3): centrifugal forces are half the derivative of J(q), and minus those of Oe."""
        inertia, stiffness = super().J2.copy(), self._of(VELOCITIES)
        for column, (a, b) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))):
            inertia[..., a, b] -= stiffness[..., column] / (1 if a == b else 2)
            inertia[..., b, a] = inertia[..., a, b]
        return inertia


def stiffened_node(node: NodeShape, stiffness: GeometricStiffness) -> NodeShape:
    """Return a node with its displacements of second order."""
    second = -stiffness.of_node(node)
    return replace(node, phi1=second[:3], psi1=second[3:]) if second.any() else node
