"""Interface nodes: what is to be one enters; reference nodes with six directions, found by name or number, leave."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ..parallel.declared import as_declared
from ..parallel.failures import InputError
from ..parallel.ranges import COORDINATE, LABEL, within
from .dofs import DIRECTIONS, rows_of_node, target_name

Vector = tuple[float, float, float]
SIX = DIRECTIONS[:6]
WAYS = ("set", "box", "sphere", "cylinder", "bore", "pin")
NAME = re.compile(r"[A-Za-z_][\w.\-]{0,62}")


@dataclass(frozen=True, kw_only=True)
class Nodes:
    """Which nodes: exactly one of `set`, the name of a node set; `box`, two corners; `sphere`, centre and radius;
    `cylinder`, two points of its axis, at its ends, and radius; `bore`, the same of a hole, whose surface is taken;
    `pin`, the same of a cylinder that is seen from outside; in m."""

    set: str | None = None
    box: tuple[Vector, Vector] | None = None
    sphere: tuple[Vector, float] | None = None
    cylinder: tuple[Vector, Vector, float] | None = None
    bore: tuple[Vector, Vector, float] | None = None
    pin: tuple[Vector, Vector, float] | None = None

    def __post_init__(self):
        as_declared(self, "interface.nodes.")
        given = [key for key in WAYS if getattr(self, key) is not None]
        if len(given) != 1:
            raise InputError(
                f"interface.nodes: found {', '.join(given) or 'none'}, expected exactly one of {', '.join(WAYS)}, "
                "or node numbers"
            )
        for key in WAYS[1:]:
            within(f"interface.nodes.{key}", getattr(self, key), COORDINATE)
        axial = self.cylinder or self.surface
        radius = (self.sphere or axial or (1.0,))[-1]
        if radius <= 0:
            raise InputError(f"interface.nodes: found radius {radius:g} m, expected a positive one")
        if axial is not None and axial[0] == axial[1]:
            raise InputError(f"interface.nodes.{given[0]}: its two points are the same, expected the ends of its axis")

    @property
    def surface(self) -> tuple[Vector, Vector, float] | None:
        """The cylinder of a bore or a pin."""
        return self.bore or self.pin

    def contain(self, points: np.ndarray) -> np.ndarray:
        """Whether points (k, 3) lie inside, or on the surface up to 1e-9 of its size; of a box, sphere, cylinder."""
        if self.box is not None:
            low, high = np.sort(self.box, axis=0)
            slack = 1e-9 * np.abs(high - low).max()
            return ((points >= low - slack) & (points <= high + slack)).all(axis=1)
        if self.sphere is not None:
            centre, radius = self.sphere
            return np.linalg.norm(points - np.array(centre), axis=1) <= radius * (1 + 1e-9)
        start, end, radius = (np.array(item) for item in self.cylinder)
        length = np.linalg.norm(end - start)
        axis, arm = (end - start) / length, points - start
        along = arm @ axis
        across = np.linalg.norm(arm - along[:, None] * axis, axis=1)
        slack = 1e-9 * max(length, radius)
        return (along >= -slack) & (along <= length + slack) & (across <= radius + slack)


@dataclass(frozen=True, kw_only=True)
class Interface:
    """What an interface node is to be.

    `nodes`: numbers, or Nodes; in a job file also the name of a file of numbers. `at`: its position in m, by default
    the centre of the surface that the set is, where elements have faces on all its nodes, or else the mean of its
    nodes, with given weights the weighted one. `weights` of the nodes: "equal", "area" (of the surface that belongs to
    a node, where elements are known), or one number a node in the order of `nodes`. `directions`: those in which the
    nodes of a rigid set follow. `node`: the number of the reference node, by default the next one that nothing of the
    model names.
    """

    name: str
    nodes: tuple[int, ...] | Nodes | str
    at: Vector | None = None
    kind: Literal["averaging", "rigid"] = "averaging"
    weights: Literal["equal", "area"] | tuple[float, ...] = "equal"
    directions: tuple[str, ...] = SIX
    node: int | None = None

    def __post_init__(self):
        as_declared(self, f"interface '{self.name}': ")
        where = f"interface '{self.name}'"
        if not NAME.fullmatch(self.name):
            raise InputError(
                f"interface.name: found '{self.name[:80]}', expected a word that begins with a letter, of letters, "
                "digits, '_', '-' and '.', of at most 63 signs"
            )
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
        if isinstance(self.weights, tuple):
            if not isinstance(self.nodes, tuple) or len(self.weights) != len(self.nodes):
                raise InputError(f"{where}: weights: a list of numbers needs `nodes` as a list of as many numbers")
            within(f"{where}: weights", self.weights, (1e-12, 1e12, ""))
        if isinstance(self.nodes, tuple):
            within(f"{where}: nodes", self.nodes, LABEL)
        within(f"{where}: node", self.node, LABEL)
        within(f"{where}: at", self.at, COORDINATE)


@dataclass(frozen=True)
class InterfaceNode:
    """A reference node: its `name`, its number `node`, which no node of the body has, and its `position` in m.

    `directions`: those in which its set moves it. `count`: the number of nodes of its set, and `definition`: what it
    was made from; 0 and None after reading a result. `doubts`: sentences on what may not have been meant.
    """

    name: str
    node: int
    position: Vector
    directions: tuple[str, ...] = SIX
    definition: Interface | None = field(default=None, compare=False)
    count: int = field(default=0, compare=False)
    doubts: tuple[str, ...] = field(default=(), compare=False)


def find_interface(model, node) -> int | None:
    """The place of an interface node, given by its name or number, in the list of the model; None for another node."""
    return next((i for i, item in enumerate(model.interfaces) if node in (item.name, item.node)), None)


def doubts_of_interfaces(model) -> list[str]:
    """Sentences on sets that may not be what was meant, or of which some nodes have no row, and so no part in the
    motion of the interface. Collective."""
    made = [item for item in model.interfaces if item.definition and isinstance(item.definition.nodes, Nodes)]
    sizes = model.set_sizes if made else {}
    return [doubt for item in model.interfaces for doubt in item.doubts] + [
        f"interface '{item.name}': {total - item.count} of the {total} nodes of the set '{name}' have no row in "
        f"{model.name}, since they follow others; it moves with the {item.count} that have"
        for item in made if (name := item.definition.nodes.set) and item.count < (total := sizes.get(name, 0))
    ]  # fmt: skip


def node_number(model, node) -> int:
    """The number of a node, or of the interface node of that name. Raises InputError."""
    if not isinstance(node, str):
        return int(node)
    place = find_interface(model, node)
    if place is None:
        known = ", ".join(item.name for item in model.interfaces)
        known = f"its interfaces are {known}" if known else "it has none; the job declares them by tables [[interface]]"
        raise InputError(f"'{node}' is no interface of {model.name}; {known}")
    return model.interfaces[place].node


def interface_targets(interfaces) -> tuple[str, ...]:
    """The names of the inputs that are all directions of all interfaces."""
    return tuple(target_name((item.name, name)) for item in interfaces for name in item.directions)


def single_targets(model, target) -> list:
    """A target of inputs or outputs, or all those of (node, "all") or of the name of an interface, with interface nodes
    by name. Collective. Raises InputError."""
    if isinstance(target, int):
        return [target]
    node, direction = (target, "all") if isinstance(target, str) else target
    place = find_interface(model, node_number(model, node))
    if place is not None:
        node = model.interfaces[place].name
    if direction != "all":
        return [(node, direction)]
    if place is not None:
        return [(node, name) for name in model.interfaces[place].directions]
    return [(int(node), DIRECTIONS[index]) for index in sorted(rows_of_node(model, int(node)))]


def interface_column(model, target) -> int | None:
    """The column of G^T that a target means, None for a dof. Raises InputError."""
    place = find_interface(model, target[0]) if isinstance(target, tuple) else None
    if place is None:
        return None
    known = model.interfaces[place].directions
    if target[1] not in known:
        raise InputError(f"interface '{target[0]}': direction: found {target[1]!r}, expected {', '.join(known)} or all")
    return 6 * place + SIX.index(target[1])
