"""Rational block Krylov subspaces of the pencil K + s^2 M (32, 41-46) extend a basis.

At s = i omega the matrix K - omega^2 M is real: damping is left out when the basis is built, which is exact in the
limit of light proportional damping (4.2.1), and enters with the projection.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..errors import InputError
from ..linalg.basis import Basis
from ..linalg.block import copy_of, create_block
from ..linalg.mumps import SingularMatrix


@dataclass(frozen=True)
class Krylov:
    """`order` + 1 blocks at s = i 2 pi frequency (Hz): (K + s^2 M)^-1 B, then repeatedly (K + s^2 M)^-1 M.

    The reduced transfer function and its first `order` derivatives with respect to s^2 match those of the full
    undamped model there; with C = B^T it is 2 (order + 1) moments.
    """

    kind: ClassVar[str] = "krylov"
    frequency: float
    order: int = 0

    def __post_init__(self):
        if not (np.isfinite(self.frequency) and self.frequency >= 0):
            raise InputError(f"krylov.frequency: found {self.frequency:g}, expected Hz, not negative")
        if self.order < 0:
            raise InputError(f"krylov.order: found {self.order}, expected 0 or more")

    def columns(self, inputs: int, rigid: int) -> int:
        """Number of vectors before deflation."""
        return inputs * (self.order + 1)

    def extend(self, basis, context):
        """Add the blocks to the basis. Collective. Raises InputError where the point is an eigenfrequency.

        Block Arnoldi: the chain of the point is kept orthonormal by itself, because (K + s^2 M)^-1 M has to act
        on the whole block and not only on what the basis did not have yet.
        """
        solver, progress = context.solver, context.progress
        try:
            with progress.stage("factor", f"{self.frequency:g} Hz"):
                solver.factor(-((2 * np.pi * self.frequency) ** 2))
            self._arnoldi(basis, context)
        except SingularMatrix as error:
            if self.frequency == 0:
                raise InputError(
                    f"krylov point 0 Hz: K of {context.model.name} is singular, so the body can move freely; "
                    "take frame kind 'buckens' (inertia relief), 'chord' or 'tangent', or a point above 0 Hz"
                ) from error
            raise InputError(
                f"krylov point {self.frequency:.10g} Hz is an eigenfrequency of the undamped model "
                f"(relative distance of its square {error.distance:.1e}); move the point a little"
            ) from error

    def _arnoldi(self, basis, context):
        progress = context.progress
        chain = Basis(context.model.M, tolerance=context.tolerance)
        load = copy_of(context.loads, context.model.K)
        if not load.getActiveColumns()[1]:
            raise InputError(f"krylov: no input loads the free dofs of {context.model.name}")
        for j in range(self.order + 1):
            columns = load.getActiveColumns()[1]
            block = create_block(context.model.K, columns)
            with progress.stage("solve"):
                context.solver.solve(load, block)
            load.destroy()
            with progress.stage("orthogonalise"):
                start = chain.size
                chain.extend(block)
                block.destroy()
                kept = basis.extend(chain.columns_since(start))
            context.note(f"krylov {self.frequency:g} Hz, block {j}", columns, kept)
            if j == self.order or chain.size == start:
                break
            load = context.times_mass(chain.columns_since(start))
        chain.close()


@dataclass(frozen=True)
class StaticCorrection:
    """K^-1 B, the deflection under constant loads (by inertia relief for a free body): Krylov(0 Hz, order 0)."""

    kind: ClassVar[str] = "static_correction"

    def columns(self, inputs: int, rigid: int) -> int:
        return inputs

    def extend(self, basis, context):
        Krylov(frequency=0.0, order=0).extend(basis, context)
