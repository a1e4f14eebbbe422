"""Rational block Krylov subspaces of the pencil K + s^2 M (32, 41-46) extend a basis.

Damping is left out when the basis is built, which is exact in the limit of light proportional damping (4.2.1), and
enters with the projection. At s = i omega the matrix K - omega^2 M is real, as it is for real s.
"""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ..linalg.basis import Basis, ComplexBasis
from ..linalg.blocks import apply, as_pairs, copy_of, create_block
from ..linalg.factorisation import SingularMatrix
from ..model.damping import is_proportional
from ..parallel.failures import InputError, Owned
from .ingredient import PointIngredient
from .point_blocks import PointBlocks
from .points import laplace, point_name


@dataclass(frozen=True)
class Krylov(PointIngredient):
    """`order` + 1 blocks at s = decay + i 2 pi frequency (1/s, Hz): (K + s^2 M)^-1 B, then repeatedly (K + s^2 M)^-1 M.

    The reduced transfer function and its first `order` derivatives with respect to s^2 match those of the full
    undamped model there (42, 43); with C = B^T it is 2 (order + 1) moments. `infinity`: M^-1 B, then repeatedly
    M^-1 K, which matches Markov parameters. Points that are neither real nor imaginary give twice the columns (50).
    """

    kind: Literal["krylov"] = field(default="krylov", kw_only=True, repr=False)
    frequency: float | None = None
    order: int = 0
    decay: float | None = None
    infinity: bool = False

    def __post_init__(self):
        if self.infinity == (self.frequency is not None or self.decay is not None):
            raise InputError("krylov: expected frequency (Hz), decay (1/s) or both, or infinity = true")
        if self.order < 0:
            raise InputError(f"krylov.order: found {self.order}, expected 0 or more")
        self.point  # noqa: B018  (refused early)

    @property
    def point(self) -> complex:
        """The expansion point s; infinity is complex infinity."""
        return complex(np.inf) if self.infinity else laplace(self.kind, self.frequency, self.decay)

    @property
    def name(self) -> str:
        return "infinity" if self.infinity else point_name(self.point)

    def _is_complex(self):
        return bool(self.point.real and self.point.imag)

    def columns(self, inputs: int, rigid: int) -> int:
        """Number of vectors before deflation."""
        return (2 if self._is_complex() else 1) * inputs * (self.order + 1)

    def complex_shift(self, damped):
        return self._is_complex()

    def blocks(self, run):
        """The blocks of the point. Collective. Raises InputError where the point is an eigenfrequency.

        Block Arnoldi: the vectors of the point are kept orthonormal by themselves, because (K + s^2 M)^-1 M has to act
        on the whole block and not only on what the basis did not have yet.
        """
        model = run.model
        if self._is_complex() and not is_proportional(model):
            raise InputError(
                f"krylov: the point {self.name} is complex and the damping of {model.name} is not proportional; "
                "kind 'second_order_krylov' fits"
            )
        if not run.loads.getActiveColumns()[1]:
            raise InputError(f"krylov: no input loads the free dofs of {model.name}")
        try:
            with run.progress.stage("factor", self.name):
                solver, next_matrix = self._factored(run)
        except SingularMatrix as error:
            raise self._refusal(model, error) from error
        return self._arnoldi(run, solver, next_matrix)

    def _factored(self, run):
        """The solver of the point, and the matrix that leads from one block to the next load."""
        square = self.point**2
        if self._is_complex():
            run.complex_solver.factor_sum(square)
            return run.complex_solver, run.model.M
        if self.infinity:
            run.solver.factor_mass()
            return run.solver, run.model.K
        run.solver.factor(square.real)
        return run.solver, run.model.M

    def _arnoldi(self, run, solver, next_matrix):
        model, progress = run.model, run.progress
        inputs = run.loads.getActiveColumns()[1]
        kind, load = (ComplexBasis, as_pairs) if self._is_complex() else (Basis, copy_of)
        vectors = kind(model.M, tolerance=run.tolerance, room=inputs * (self.order + 1))
        blocks, load = PointBlocks(vectors), load(run.loads, model.K)
        for j in range(self.order + 1):
            progress.step("blocks", j, self.order + 1)
            with Owned(model.comm) as owned:
                owned.owns(load)
                columns = load.getActiveColumns()[1]
                block = owned.owns(create_block(model.K, columns))
                with progress.stage("solve"):
                    solver.solve(load, block)
                with progress.stage("orthogonalise"):
                    vectors.extend(block)
            start = blocks.add(f"krylov {self.name}, block {j}", columns)
            if j == self.order or vectors.size == start:
                break
            load = create_block(model.K, vectors.width * (vectors.size - start))
            apply(next_matrix, vectors.columns_between(start, vectors.size), load)
        return blocks

    def _refusal(self, model, error):
        if self.infinity:
            return InputError(f"krylov at infinity: the mass matrix of {model.name} is singular; take another point")
        if self.point == 0:
            return InputError(
                f"krylov point 0 Hz: K of {model.name} is singular, so the body can move freely; "
                "take frame kind 'buckens' (inertia relief), 'chord' or 'tangent', or a point above 0 Hz"
            )
        return InputError(
            f"krylov point {self.point.imag / 2 / np.pi:.10g} Hz is an eigenfrequency of the undamped model "
            f"(relative distance of its square {error.distance:.1e}), an undamped pole; move the point a little"
        )


@dataclass(frozen=True)
class StaticCorrection(PointIngredient):
    """K^-1 B, the deflection under constant loads (by inertia relief for a free body): Krylov(0 Hz, order 0)."""

    kind: Literal["static_correction"] = field(default="static_correction", kw_only=True, repr=False)

    def columns(self, inputs: int, rigid: int) -> int:
        return inputs

    def blocks(self, run):
        return Krylov(frequency=0.0, order=0).blocks(run)
