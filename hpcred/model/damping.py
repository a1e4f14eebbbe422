"""Damping laws: which D belongs to a model with M and K."""

from dataclasses import dataclass
from typing import ClassVar

from ..errors import InputError
from ..petsc import SAME


@dataclass(frozen=True)
class NoDamping:
    """D = 0, even if the model has a damping matrix."""

    kind: ClassVar[str] = "none"


@dataclass(frozen=True)
class GivenDamping:
    """The damping matrix of the model."""

    kind: ClassVar[str] = "given"


@dataclass(frozen=True)
class Rayleigh:
    """D = alpha M + beta K (40); alpha in 1/s, beta in s."""

    kind: ClassVar[str] = "rayleigh"
    alpha: float = 0.0
    beta: float = 0.0


def damping_matrix(model, damping):
    """D of a damping law, and whether it is a new matrix that the caller destroys. Collective.

    Raises InputError for negative coefficients or a missing matrix.
    """
    if isinstance(damping, GivenDamping):
        if model.D is None:
            raise InputError(f"damping.kind: 'given' needs a damping matrix, {model.name} has none")
        return model.D, False
    if not isinstance(damping, Rayleigh):
        return None, False
    if damping.alpha < 0 or damping.beta < 0:
        raise InputError(f"damping: found alpha = {damping.alpha:g}, beta = {damping.beta:g}; neither may be negative")
    mat = model.M.duplicate(copy=True)
    mat.scale(damping.alpha)
    mat.axpy(damping.beta, model.K, structure=SAME)
    mat.stateIncrease()
    return mat, True
