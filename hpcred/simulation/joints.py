"""Define joints between nodes and the ground, and make holonomic constraints of them.

A node with shapes phi, psi is at x = r + A (c + phi q) and has the rotation R = A exp(skew(psi q)), exact for the small
vector psi q. Its velocities are v = x' and omega with R' = skew(omega) R. A joint holds x and R to a support, which is
fixed or moved by the drives at the node: it rotates by G(t) about an axis through a point, and is displaced. A
constraint is a function of x, R and t that must be zero; N (v, omega) = N (v, omega of the support) is its derivative,
so that velocities that satisfy this preserve the constraint.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ..body.node_shapes import NodeShape
from ..body.rotations import cross, of_vector, vector_of
from ..parallel.declared import as_declared
from ..parallel.failures import InputError
from ..parallel.ranges import Node, Vector
from .drives import Drive, unit

AXES = ("x", "y", "z")
ONE_AXIS = ("revolute", "prismatic", "cylindrical")
PARALLEL = 1e-6  # sine of the angle below which two axes count as one
Kind = Literal["point", "spherical", "fixed", "revolute", "universal", "prismatic", "cylindrical"]


@dataclass(frozen=True)
class Joint:
    """A joint between a node and the ground. The node keeps its initial rotation in the held directions.

    Parameters
    ----------
    node : int or str
        Number of the node, or name of an interface.
    directions : sequence of {"x", "y", "z"}, optional
        Held displacements of kind "point"; by default all.
    at : tuple of three floats, optional
        The point in m where the node is held; by default its initial position.
    kind : str, default "point"
        "point": holds displacements in `directions`; "spherical": all displacements; "fixed": everything; "revolute":
        all but the rotation about `axis`; "prismatic": all but the displacement along `axis`; "cylindrical": all but
        both; "universal": all displacements, and the angle between two axes.
    axis : tuple of three floats, optional
        Of kinds "revolute", "prismatic" and "cylindrical": inertial axis at the start, of any length.
    axes : tuple of two axes, optional
        Of kind "universal": inertial axes at the start, the first fixed to the ground, the second to the node.

    Raises
    ------
    InputError
        For a missing axis, and keys that do not belong to the kind.
    """

    node: Node
    directions: tuple[str, ...] | None = None
    at: Vector | None = None
    kind: Kind = field(default="point", kw_only=True)
    axis: Vector | None = field(default=None, kw_only=True)
    axes: tuple[Vector, Vector] | None = field(default=None, kw_only=True)

    def __post_init__(self):
        as_declared(self, "constraint.")
        for key, kinds in (("directions", ("point",)), ("axis", ONE_AXIS), ("axes", ("universal",))):
            value = getattr(self, key)
            if value is not None and self.kind not in kinds:
                raise InputError(
                    f"constraint.{key}: found {value} at a joint of kind '{self.kind}', expected it only with "
                    f"{', '.join(kinds)}"
                )
            if value is None and self.kind in kinds and key != "directions":
                raise InputError(f"constraint.{key}: missing; a joint of kind '{self.kind}' needs it, in inertial axes")
        names = self.held_directions
        if not names or any(name not in AXES for name in names):
            raise InputError(f"constraint.directions: found {list(names)}, expected some of x, y, z")
        if len(set(names)) < len(names):
            raise InputError(f"constraint.directions: found {list(names)}, expected each once")
        units = self.unit_axes
        if len(units) == 2 and np.linalg.norm(np.cross(*units)) < PARALLEL:
            raise InputError(f"constraint.axes: found {self.axes}, which are parallel, expected two axes of a cross")

    @property
    def held_directions(self) -> tuple[str, ...]:
        return AXES if self.directions is None else self.directions

    @property
    def unit_axes(self) -> list[np.ndarray]:
        """Unit vectors of its axis or axes."""
        if self.axes is not None:
            return [unit("constraint.", "axes", axis) for axis in self.axes]
        return [] if self.axis is None else [unit("constraint.", "axis", self.axis)]

    @property
    def turns_with(self) -> bool:
        """True if it holds rotations."""
        return self.kind not in ("point", "spherical")

    def held(self) -> tuple[np.ndarray, np.ndarray]:
        """Return held directions (k, 3) of displacements and (j, 3) of rotations, without that of a universal joint."""
        every, none = np.eye(3), np.zeros((0, 3))
        if self.kind in ONE_AXIS:
            across = _complement(self.unit_axes[0][None])
            translations = every if self.kind == "revolute" else across
            return translations, every if self.kind == "prismatic" else across
        return every[[AXES.index(name) for name in self.held_directions]], every if self.kind == "fixed" else none


def _complement(rows):
    """Return orthonormal rows (3 - k, 3) perpendicular to the k directions that rows span."""
    if not len(rows):
        return np.eye(3)
    _, values, right = np.linalg.svd(rows)
    return right[int((values > PARALLEL).sum()) :]


@dataclass
class Support:
    """The support of a node: `shifts` and `turns` are drives, the latter about one axis through `centre` (3,).

    It keeps its last state, for which several functions ask at the same time.
    """

    shifts: tuple[Drive, ...] = ()
    turns: tuple[Drive, ...] = ()
    centre: np.ndarray | None = None
    _last: tuple = field(default=(None, None), init=False, repr=False)

    @property
    def axis(self):
        return self.turns[0].direction

    def state(self, t):
        """Return displacement (3,), its rate (3,), rotation G (3, 3) and angular velocity (3,) in inertial axes."""
        if self._last[0] != (time := t if self.shifts or self.turns else 0.0):
            self._last = time, self._state(time)
        return self._last[1]

    def _state(self, t):
        moved = np.array([np.outer(drive(t), drive.direction) for drive in self.shifts]).reshape(-1, 2, 3).sum(axis=0)
        if not self.turns:
            return *moved, np.eye(3), np.zeros(3)
        angle, rate = np.sum([np.multiply(drive(t), drive.direction @ self.axis) for drive in self.turns], axis=0)
        return *moved, of_vector(angle * self.axis), rate * self.axis


@dataclass
class Hold:
    """Constraints of one joint, or of a drive, on one node: c = k + j numbers that must be zero.

    translations (k, 3) and rotations (j, 3): directions of the support at t = 0 without drives, in which the node is
    held at `place` (3,) with rotation `turned` (3, 3). cross: the two axes of a universal joint instead of rotations.
    """

    shape: NodeShape
    label: str
    support: Support
    place: np.ndarray
    turned: np.ndarray
    translations: np.ndarray
    rotations: np.ndarray
    cross: tuple[np.ndarray, np.ndarray] | None = None

    def __len__(self):
        return len(self.translations) + (len(self.rotations) if self.cross is None else 1)

    def _cross(self, R, G):
        """Return the current axes of the cross, of the support and of the node."""
        return G @ self.cross[0], R @ self.turned.T @ self.cross[1]

    def directions(self, t, R):
        """Return N (c, 6): the held components of velocity and angular velocity of the node, in inertial axes."""
        G = self.support.state(t)[2]
        N = np.zeros((len(self), 6))
        k = len(self.translations)
        N[:k, :3] = self.translations @ G.T
        if self.cross is None:
            N[k:, 3:] = self.rotations @ G.T
        else:
            mine, other = self._cross(R, G)
            N[k, 3:] = cross(other, mine) / np.linalg.norm(np.cross(*self.cross))
        return N

    def cross_by_rotation(self, t, R):
        """Return the derivative (3, 3) of the direction that a universal joint holds by the rotation of the node; None
        of other joints."""
        if self.cross is None:
            return None
        mine, other = self._cross(R, self.support.state(t)[2])
        return (np.outer(other, mine) - (mine @ other) * np.eye(3)) / np.linalg.norm(np.cross(*self.cross))

    def velocity(self, t, x):
        """Return velocity and angular velocity (6,) of the support at the position x (3,) of the node."""
        shift, rate, _, omega = self.support.state(t)
        if not omega.any():
            return np.concatenate([rate, omega])
        return np.concatenate([rate + cross(omega, x - self.support.centre - shift), omega])

    def gap(self, t, x, R):
        """Return the constraint violations (c,): m for displacements, rad for rotations."""
        shift, _, G, _ = self.support.state(t)
        centre = self.place if self.support.centre is None else self.support.centre
        place = centre + shift + G @ (self.place - centre)
        away = self.translations @ G.T @ (x - place)
        if self.cross is not None:
            mine, other = self._cross(R, G)
            angle = (mine @ other - self.cross[0] @ self.cross[1]) / np.linalg.norm(np.cross(*self.cross))
            return np.append(away, angle)
        if len(self.rotations) == 2:
            axis = cross(*self.rotations)
            turned = cross(G @ axis, R @ self.turned.T @ axis)
        elif len(self.rotations):
            turned = vector_of(R @ self.turned.T @ G.T)
        else:
            return away
        return np.concatenate([away, self.rotations @ G.T @ turned])

    def components(self) -> np.ndarray:
        """Return which components (6,) of force and moment in inertial axes it can transmit."""
        if self.support.turns:
            return np.repeat([len(self.translations) > 0, len(self) > len(self.translations)], 3)
        forces = np.abs(self.translations).sum(axis=0) > PARALLEL
        moments = np.ones(3, dtype=bool) if self.cross else np.abs(self.rotations).sum(axis=0) > PARALLEL
        return np.concatenate([forces, moments])


def holds_of(joints, drives, start) -> list[Hold]:
    """Return the constraints of joints and drives. `start`: for each node its shape, place (3,) and rotation (3, 3) at
    first.

    Raises InputError for joints at nodes without rotations, and drives of rotations that no joint at the node holds.
    """
    holds = []
    for node in dict.fromkeys(each.node for each in (*joints, *drives)):
        shape, place, turned = start[node]
        own = [each for each in joints if each.node == node]
        moved = [each for each in drives if each.node == node]
        support = _support(shape.label, moved, place if not own or own[0].at is None else np.array(own[0].at))
        for each in own:
            if each.turns_with and not shape.rotates:
                raise InputError(
                    f"constraint.kind: node {shape.label} has no rotations, which a joint of kind '{each.kind}' holds; "
                    "give the model an [[interface]] there, or hold several nodes by joints of kind 'point'"
                )
            at = place if each.at is None else np.array(each.at)
            cross = tuple(each.unit_axes) if each.kind == "universal" else None
            holds.append(Hold(shape, f"{each.kind} at {shape.label}", support, at, turned, *each.held(), cross))
        if moved:
            translations, rotations = _driven(shape.label, own, support)
            at = place if not own or own[0].at is None else np.array(own[0].at)
            if len(translations) + len(rotations):
                holds.append(Hold(shape, f"drive of {shape.label}", support, at, turned, translations, rotations))
    return holds


def _support(node, drives, place) -> Support:
    turns = tuple(drive for drive in drives if drive.about is not None)
    centre = None
    if turns:
        if any(np.linalg.norm(np.cross(drive.direction, turns[0].direction)) > PARALLEL for drive in turns):
            raise InputError(f"drive.about: node {node} has drives about different axes, expected one axis a node")
        points = {drive.through for drive in turns}
        if len(points) > 1:
            raise InputError(f"drive.through: node {node} has drives through different points, expected one axis")
        (through,) = points
        centre = place if through is None else np.array(through)
    return Support(tuple(drive for drive in drives if drive.along is not None), turns, centre)


def _driven(node, joints, support):
    """Return directions of displacements and rotations that drives hold beside the joints at their node."""
    rows = [joint.held() for joint in joints]
    held, turned = (np.concatenate([np.zeros((0, 3)), *blocks]) for blocks in zip(*rows, strict=True)) if rows else (
        np.zeros((0, 3)), np.zeros((0, 3)))  # fmt: skip
    free = _complement(held)
    wanted = np.array([drive.direction for drive in support.shifts]).reshape(-1, 3) @ free.T @ free
    _, values, right = np.linalg.svd(wanted)
    translations = right[: int((values > PARALLEL).sum())]
    if not support.turns:
        return translations, np.zeros((0, 3))
    axes, axis = _complement(turned), support.axis
    if len(axes) > 1 or any(joint.kind == "universal" for joint in joints):
        raise InputError(
            f"drive.about: node {node} has no joint that holds its other rotations; add one of kind 'fixed', "
            "'prismatic', 'revolute' or 'cylindrical' there"
        )
    along = float(np.abs(axes @ axis).max(initial=0.0))
    if along < PARALLEL:
        return translations, np.zeros((0, 3))
    if along < 1 - PARALLEL:
        raise InputError(
            f"drive.about: the axis at node {node} is oblique to the one about which its joint leaves it free, "
            "expected the same or a perpendicular one"
        )
    return translations, axes
