"""Define interface nodes, and find them by name or number: reference nodes with six directions."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np

from ...fe.dofs import DIRECTIONS
from ...parallel.declared import Settings, as_declared, renamed
from ...parallel.failures import InputError
from ...parallel.ranges import Coordinate, Label, Range

Point = tuple[Coordinate, Coordinate, Coordinate]
SIX = DIRECTIONS[:6]
WAYS = ("set", "box", "sphere", "cylinder", "bore", "pin")
NAME = re.compile(r"[A-Za-z_][\w.\-]{0,62}")


def check_word(key: str, name: str):
    """Refuse names that are no words, as files and expressions want them. Raises InputError."""
    if not NAME.fullmatch(name):
        raise InputError(
            f"{key}: found '{name[:80]}', expected a word that begins with a letter, of letters, digits, '_', '-' and "
            "'.', of at most 63 signs"
        )


@dataclass(frozen=True, kw_only=True)
class Nodes(Settings):
    """A choice of nodes, by exactly one of the parameters. Lengths in m.

    Parameters
    ----------
    set : str, optional
        Name of a node set of the model.
    box : tuple of two points, optional
        Two opposite corners (x, y, z); all nodes inside.
    sphere : tuple of point and float, optional
        Centre and radius; all nodes inside.
    cylinder : tuple of two points and float, optional
        The ends of its axis, and its radius; all nodes inside.
    bore : tuple of two points and float, optional
        The same of a hole; the nodes of its surface.
    pin : tuple of two points and float, optional
        The same of an outer cylindrical surface; its nodes.

    Raises
    ------
    InputError
        Unless exactly one is given, and for radii and axes without length.
    """

    set: str | None = None
    box: tuple[Point, Point] | None = None
    sphere: tuple[Point, Coordinate] | None = None
    cylinder: tuple[Point, Point, Coordinate] | None = None
    bore: tuple[Point, Point, Coordinate] | None = None
    pin: tuple[Point, Point, Coordinate] | None = None

    where = "nodes."

    def __post_init__(self):
        super().__post_init__()
        ways = [key for key in WAYS if getattr(self, key) is not None]
        if len(ways) != 1:
            raise InputError(
                f"nodes: found {', '.join(ways) or 'none'}, expected exactly one of {', '.join(WAYS)}, "
                "or node numbers"
            )
        axial = self.cylinder or self.surface
        radius = (self.sphere or axial or (1.0,))[-1]
        if radius <= 0:
            raise InputError(f"nodes: found radius {radius:g} m, expected a positive one")
        if axial is not None and axial[0] == axial[1]:
            raise InputError(f"nodes.{ways[0]}: its two points are the same, expected the ends of its axis")

    @property
    def surface(self) -> tuple[Point, Point, float] | None:
        """The cylinder of a bore or pin."""
        return self.bore or self.pin

    def contain(self, points: np.ndarray) -> np.ndarray:
        """Test whether `points` (k, 3) in m lie in a box, sphere or cylinder, or up to 1e-9 of its size outside."""
        if self.box is not None:
            low, high = np.sort(self.box, axis=0)
            slack = 1e-9 * np.abs(high - low).max()
            return ((points >= low - slack) & (points <= high + slack)).all(axis=1)
        if self.sphere is not None:
            centre, radius = self.sphere
            return np.linalg.norm(points - np.array(centre), axis=1) <= radius * (1 + 1e-9)
        start, end, radius = (np.array(value) for value in self.cylinder)
        length = np.linalg.norm(end - start)
        axis, arm = (end - start) / length, points - start
        along = arm @ axis
        across = np.linalg.norm(arm - along[:, None] * axis, axis=1)
        slack = 1e-9 * max(length, radius)
        return (along >= -slack) & (along <= length + slack) & (across <= radius + slack)


@dataclass(frozen=True, kw_only=True)
class Interface:
    """An interface: a reference node with six directions that represents a set of nodes.

    Parameters
    ----------
    name : str
        A word that begins with a letter. It stands for a node in inputs, outputs and frames.
    nodes : sequence of int, Nodes or str
        Numbers of the nodes, or Nodes; in a job file also the name of a file of numbers.
    at : tuple of three floats, optional
        Position of the reference node in m. By default the centroid of the surface that the set covers, if elements
        have faces on all its nodes; otherwise the mean of the nodes, weighted with a list of `weights`.
    kind : {"averaging", "rigid"}, default "averaging"
        Whether the reference node has the weighted mean motion of the set, or the set follows it rigidly.
    weights : {"equal", "area"} or sequence of float, default "equal"
        Of the nodes of an averaging set: equal, by the area of the surface that belongs to a node (which needs
        elements), or one number for each node in the order of `nodes`.
    directions : sequence of str, default ("x", "y", "z", "rx", "ry", "rz")
        Directions in which the nodes of a rigid set follow.
    node : int, optional
        Number of the reference node; by default the next one that no node, element or set of the model uses.

    Raises
    ------
    InputError
        For values that do not fit each other.

    Notes
    -----
    The motion of an averaging interface is the weighted least-squares rigid motion of its set, as of an RBE3 or a
    distributing coupling; a rigid interface is an RBE2 or a kinematic coupling.
    """

    name: str
    nodes: tuple[Label, ...] | Nodes | str
    at: Point | None = None
    kind: Literal["averaging", "rigid"] = "averaging"
    weights: Literal["equal", "area"] | tuple[Annotated[float, Range(1e-12, 1e12)], ...] = "equal"
    directions: tuple[str, ...] = SIX
    node: Label | None = None

    def __post_init__(self):
        as_declared(self, f"interface '{self.name}': ")
        where = f"interface '{self.name}'"
        check_word("interface.name", self.name)
        if isinstance(self.nodes, tuple) and (not self.nodes or len(set(self.nodes)) < len(self.nodes)):
            raise InputError(f"{where}: nodes: expected at least one number, and each once")
        if not self.directions or not set(self.directions) <= set(SIX) or len(set(self.directions)) < len(
            self.directions
        ):
            raise InputError(f"{where}: directions: found {list(self.directions)}, expected some of {', '.join(SIX)}")
        if self.kind == "averaging" and self.directions != SIX:
            raise InputError(f"{where}: directions belong to kind 'rigid'; an averaging set takes its translations")
        if self.kind == "rigid" and self.weights != "equal":
            raise InputError(f"{where}: weights belong to kind 'averaging'; the nodes of a rigid set all follow")
        listed = len(self.nodes) if isinstance(self.nodes, tuple) else None
        if isinstance(self.weights, tuple) and len(self.weights) != listed:
            raise InputError(f"{where}: weights: a list of numbers needs `nodes` as a list of as many numbers")


@dataclass(frozen=True)
class InterfaceNode:
    """A reference node of a model, as `with_interfaces` makes it.

    Attributes
    ----------
    name : str
        Name of the interface.
    node : int
        Number of the reference node, which no node of the body has.
    position : tuple of three floats
        In m.
    directions : tuple of str
        Directions in which the set moves the reference node.
    definition : Interface or None
        The interface that it was made from; None after reading a result.
    count : int
        Number of nodes of the set; 0 after reading a result.
    warnings : tuple of str
        Warnings.
    """

    name: str
    node: int
    position: Point
    directions: tuple[str, ...] = SIX
    definition: Interface | None = field(default=None, compare=False)
    count: int = field(default=0, compare=False)
    warnings: Annotated[tuple[str, ...], renamed("warnings", "doubts")] = field(default=(), compare=False)


def find_interface(model, node) -> int | None:
    """Return the index of an interface node, given by name or number, in the list of the model; else None."""
    return next((i for i, interface in enumerate(model.interfaces) if node in (interface.name, interface.node)), None)


def warnings_of_interfaces(model) -> list[str]:
    """Return warnings of sets that look unintended, or with nodes without rows, which do not contribute. Collective."""
    warnings = [warning for interface in model.interfaces for warning in interface.warnings]
    sizes = model.set_sizes if model.interfaces else {}
    for interface in model.interfaces:
        nodes = interface.definition and interface.definition.nodes
        name = nodes.set if isinstance(nodes, Nodes) else None
        if interface.count < (total := sizes.get(name, 0)):
            warnings.append(
                f"interface '{interface.name}': {total - interface.count} of the {total} nodes of the set '{name}' "
                f"have no row in {model.name}, since they follow others; it moves with the {interface.count} that have"
            )
    return warnings


def node_number(model, node) -> int:
    """Return the number of a node, or of the interface node of that name. Raises InputError."""
    if not isinstance(node, str):
        return int(node)
    place = find_interface(model, node)
    if place is None:
        known = ", ".join(interface.name for interface in model.interfaces)
        known = f"its interfaces are {known}" if known else "it has none; the job declares them by tables [[interface]]"
        raise InputError(f"'{node}' is no interface of {model.name}; {known}")
    return model.interfaces[place].node
