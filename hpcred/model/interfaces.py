"""Interface nodes: reference nodes with six directions, whose motion is that of a set of nodes of the body."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class InterfaceNode:
    """A reference node: its `name`, its number `node`, which no node of the body has, and its `position` in m."""

    name: str
    node: int
    position: tuple[float, float, float]
