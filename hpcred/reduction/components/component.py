"""Define a component of a basis: its columns, its checks, its blocks."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

from ...linalg.basis import Basis
from ..result.record import BasisPart
from ..run.run import Run
from .point_blocks import PointBlocks


class Component(BasisPart):
    """Base class; a component is a frozen dataclass with a field `kind`, which names it in a job file.

    `per_direction`: how many vectors it has for each direction of the interfaces besides columns(); None for a
    component that needs no interfaces.
    """

    per_direction: ClassVar[int | None] = None

    @abstractmethod
    def columns(self, inputs: int, rigid: int) -> int:
        """Return the number of vectors before deflation, as far as it is known beforehand, for `inputs` columns of B
        and `rigid` rigid-body modes."""

    def check(self, size: int, rigid: int) -> None:  # noqa: B027  (most have nothing to refuse)
        """Raise InputError for what a model with `size` free dofs and `rigid` rigid-body modes cannot have."""

    def complex_shift(self, damped: bool) -> bool:
        """Test whether it needs a complex A(s); `damped`: whether the model has a damping matrix."""
        return False

    @abstractmethod
    def extend(self, basis: Basis, run: Run) -> None:
        """Add its vectors to the `basis`; `run`: the model in its frame, its solvers and its loads. Collective. Raises
        InputError or ComputationError."""


class PointComponent(Component):
    """A component whose blocks belong to one expansion point, and can be made by a group of ranks."""

    @abstractmethod
    def blocks(self, run: Run) -> PointBlocks:
        """Return the blocks of the point, orthonormal among themselves; `run`: see extend. Collective."""

    def extend(self, basis, run) -> None:
        self.blocks(run).join(basis, run)
