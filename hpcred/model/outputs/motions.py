"""Define outputs that are displacements, velocities or accelerations of dofs, and tell them from their names."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ...fe.dofs import direction_index, named_quantity, quantity_name, target_name, target_of
from ...parallel.declared import Settings
from ...parallel.failures import InputError
from ...parallel.ranges import Label, Node


@dataclass(frozen=True, kw_only=True)
class MotionOutput(Settings):
    """An output that is the displacement, the velocity or the acceleration of a dof.

    Parameters
    ----------
    node : int or str, optional
        Number of a node, or name of an interface.
    direction : str, optional
        "x", "y", "z", "rx", "ry", "rz", or "all" for every direction of the node.
    dof : int, optional
        Number of a dof from 1, in place of node and direction.
    quantity : {"displacement", "velocity", "acceleration"}, default "displacement"
        What is measured, in m, m/s or m/s^2, of rotations in rad, rad/s or rad/s^2.

    Raises
    ------
    InputError
        For other quantities and directions, and unless either a node with its direction or a dof is given.
    """

    node: Node | None = None
    direction: str | None = None
    dof: Label | None = None
    quantity: Literal["displacement", "velocity", "acceleration"] = "displacement"

    where = "outputs."

    def __post_init__(self):
        super().__post_init__()
        by_node = self.node is not None and self.direction is not None and self.dof is None
        if not by_node and (self.dof is None or self.node is not None or self.direction is not None):
            keys = ", ".join(key for key in ("node", "direction", "dof") if getattr(self, key) is not None)
            raise InputError(f"outputs: found {keys or 'no place'}, expected a node and its direction, or a dof")
        if by_node and self.direction != "all":
            direction_index(self.direction, "outputs.direction")

    @property
    def target(self) -> int | tuple:
        """The place, as SecondOrderModel.with_inputs takes it."""
        return (self.node, self.direction) if self.dof is None else self.dof

    @property
    def name(self) -> str:
        """The name as output: "acceleration 20:z", or "20:z" of a displacement."""
        return quantity_name(self.quantity, target_name(self.target))


def motion_output_of(name: str) -> MotionOutput | None:
    """Return the velocity or acceleration that an output is by its name, or None."""
    quantity, place = named_quantity(name)
    target = target_of(place)
    if quantity == "displacement" or target is None:
        return None
    at = {"dof": target} if isinstance(target, int) else {"node": target[0], "direction": target[1]}
    return MotionOutput(**at, quantity=quantity)
