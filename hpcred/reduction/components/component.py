"""What an ingredient of a basis owes: its columns, its checks, its blocks. A new method is a new module with one."""

from __future__ import annotations

from typing import ClassVar

from ...linalg.basis import Basis
from ..run import Run
from .point_blocks import PointBlocks


class Ingredient:
    """Base class; an ingredient is a frozen dataclass with a field `kind`, which names it in a job file.

    `per_direction`: how many vectors it has for each direction of the interfaces besides columns(); None for an
    ingredient that needs no interfaces.
    """

    per_direction: ClassVar[int | None] = None

    def columns(self, inputs: int, rigid: int) -> int:
        """Number of vectors before deflation, as far as it is known beforehand, for `inputs` columns of B."""
        raise NotImplementedError

    def check(self, size: int, rigid: int):
        """Raise InputError for what a model with `size` free dofs and `rigid` rigid-body modes cannot have."""

    def complex_shift(self, damped: bool) -> bool:
        """Whether it needs a complex A(s), given whether the model has a damping matrix."""
        return False

    def extend(self, basis: Basis, run: Run):
        """Add its vectors to the basis. Collective. Raises InputError or ComputationError."""
        raise NotImplementedError


class PointIngredient(Ingredient):
    """An ingredient whose blocks belong to one expansion point, and can be made by a group of ranks."""

    def blocks(self, run: Run) -> PointBlocks:
        """The blocks of the point, orthonormal among themselves. Collective."""
        raise NotImplementedError

    def extend(self, basis, run):
        self.blocks(run).join(basis, run)
